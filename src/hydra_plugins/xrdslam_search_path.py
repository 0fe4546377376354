"""Lets Hydra see what is installed, however it is started: the command line, completion, `compose` in a notebook."""

from hydra.core.config_search_path import ConfigSearchPath
from hydra.plugins.search_path_plugin import SearchPathPlugin

__all__ = ["XrdslamSearchPath"]


class XrdslamSearchPath(SearchPathPlugin):
    """Appends every plugin's package of YAML and stores every registered schema."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Called by Hydra once per start; imports are inside because Hydra imports this module for any application."""
        from xrdslam.command_line.groups import CONF_GROUP, conf_packages
        from xrdslam.command_line.schemas import register_resolvers, store_schemas
        from xrdslam.core.registry import installed

        if not any(entry.path == f"pkg://{CONF_GROUP}" for entry in search_path.get_path()):
            return  # somebody else's application
        register_resolvers()
        store_schemas(installed())
        for package in conf_packages():
            if package != CONF_GROUP:
                search_path.append(provider=package, path=f"pkg://{package}")
        search_path.append(provider="xrdslam", path="xrdslam-scenes://")
