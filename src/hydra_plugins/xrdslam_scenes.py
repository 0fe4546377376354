"""Lets completion and messages see scenes: `dataset=replica/room0` is an option, its file lies a folder deeper."""

from hydra.core.object_type import ObjectType
from hydra.plugins.config_source import ConfigResult, ConfigSource

__all__ = ["SceneSource"]


class SceneSource(ConfigSource):
    """Lists every `<family>/<scene>` as an option of the group `dataset`; the files themselves come from elsewhere."""

    @staticmethod
    def scheme() -> str:
        return "xrdslam-scenes"

    def available(self) -> bool:
        return True

    def is_group(self, config_path: str) -> bool:
        return config_path == "dataset"

    def is_config(self, config_path: str) -> bool:
        return False

    def list(self, config_path: str, results_filter: ObjectType | None) -> list[str]:
        """Return the scenes of all installed families."""
        from xrdslam.command_line.groups import options

        if not self.is_group(config_path) or results_filter == ObjectType.GROUP:
            return []
        return sorted(options("dataset"))

    def load_config(self, config_path: str) -> ConfigResult:
        """Never called: this source has no file."""
        raise LookupError(config_path)
