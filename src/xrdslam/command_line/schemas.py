"""Typed schemas of everything installed, put where Hydra composes from. Imports settings only, no torch."""

from collections.abc import Iterable

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf, open_dict

from xrdslam.command_line.groups import OVERLAYS, options
from xrdslam.command_line.ledger import cores, folder_name
from xrdslam.command_line.settings import CommandLineConfig
from xrdslam.core.config import EngineConfig, MultiprocessConfig, ViewerConfig
from xrdslam.core.errors import PluginError
from xrdslam.core.records import AlgorithmInfo, DatasetInfo, Info, MappingMethodInfo, TrackingMethodInfo, ViewerInfo
from xrdslam.core.registry import BrokenPlugin, Registry
from xrdslam.evaluation.config import EvaluationConfig

__all__ = ["register_resolvers", "store_schemas"]

PROVIDER = "xrdslam"


def store_schemas(registry: Registry) -> None:
    """Store the run's schema, one option per registered name, and one per dataset family's settings and per preset."""
    _store("schema", "run", CommandLineConfig)
    _store("engine", "sequential", EngineConfig)
    _store("engine", "multiprocess", MultiprocessConfig)
    _store("evaluation", "default", EvaluationConfig)
    _store("viewer", "none", ViewerConfig)
    for algorithm in registry.all(AlgorithmInfo).values():
        _store_choice(registry, algorithm, "algo", {"tracking": algorithm.tracking, "mapping": algorithm.mapping})
    for method in (*registry.all(TrackingMethodInfo).values(), *registry.all(MappingMethodInfo).values()):
        _store_choice(registry, method, method.group)
    for viewer in registry.all(ViewerInfo).values():
        _store_choice(registry, viewer, viewer.group)
    for family in registry.all(DatasetInfo).values():
        _store_choice(registry, family, "schema/dataset")
    _store_names("settings", {"none", *registry.all(DatasetInfo), *_overlay_names("settings")})
    _store_names("preset", {"published", *_overlay_names("presets")})


def register_resolvers() -> None:
    """Register what `config.yaml` and the launchers say with `${xrdslam.…:}`; `_root_` is what was chosen so far."""

    def family(*, _root_: DictConfig) -> str:
        """Name the settings of the chosen dataset's family, or none."""
        chosen = "" if OmegaConf.is_missing(_root_, "dataset") else str(_root_.get("dataset", ""))
        name = chosen.partition("/")[0]
        return name if f"{name}.yaml" in ConfigStore.instance().list("settings") else "none"

    def settings(group: str, *, _root_: DictConfig) -> str:
        return f"{_choice(_root_, group)}/{_root_.get('settings') or family(_root_=_root_)}"

    def preset(group: str, *, _root_: DictConfig) -> str:
        return f"{_choice(_root_, group)}/{_root_.get('preset', 'published')}"

    OmegaConf.register_new_resolver("xrdslam.family", family, replace=True)
    OmegaConf.register_new_resolver("xrdslam.settings", settings, replace=True)
    OmegaConf.register_new_resolver("xrdslam.preset", preset, replace=True)
    OmegaConf.register_new_resolver("xrdslam.folder_name", folder_name, replace=True)
    OmegaConf.register_new_resolver("xrdslam.side_by_side", lambda jobs: jobs or cores(), replace=True)


def _choice(choices: DictConfig, group: str) -> str:
    return "none" if OmegaConf.is_missing(choices, group) else str(choices.get(group))


def _store(group: str, name: str, node: object, package: str | None = None) -> None:
    ConfigStore.instance().store(group=group, name=name, node=node, package=package, provider=PROVIDER)


def _store_choice(registry: Registry, info: Info, group: str, parts: dict[str, str] | None = None) -> None:
    """Store the schema of a registered name; one whose configuration does not import costs a warning.

    `parts` are the sub-groups that it chooses unless told otherwise; what its dataclass has in their places is for
    those who build it in Python, and gives way here so that any other option fits.
    """
    try:
        node = OmegaConf.structured(info.load_config())
    except PluginError as error:
        registry.refuse(BrokenPlugin(info.name, info.distribution, error))
        return
    if parts:
        with open_dict(node):
            node.update(dict.fromkeys(parts))
            node.defaults = ["_self_", *({part: chosen} for part, chosen in parts.items())]
    _store(group, info.name, node)


def _store_names(group: str, names: Iterable[str]) -> None:
    """Store options that only say their own name, so that a choice is checked, completed and written down."""
    for name in names:
        _store(group, name, {group: name}, package="_global_")


def _overlay_names(folder: str) -> set[str]:
    return {option.rpartition("/")[2] for part in OVERLAYS.values() for option in options(f"{folder}/{part}")}
