"""The settings of an earlier run, read back as the objects that they were."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from xrdslam.core.config import EngineConfig, MultiprocessConfig, RunConfig, ViewerConfig
from xrdslam.core.errors import ConfigError, RunError
from xrdslam.core.records import Info
from xrdslam.core.registry import Registry, installed
from xrdslam.evaluation import EvaluationConfig

__all__ = ["read_config", "typed_config"]


def read_config(run_dir: Path) -> dict[str, Any]:
    """Return what config.yaml of a run says, as plain data; `run_dir` is where it lies now."""
    path = run_dir / "config.yaml"
    try:
        plain = OmegaConf.to_container(OmegaConf.load(path))
    except FileNotFoundError as error:
        raise RunError(f"{run_dir}: no run was begun there (it has no config.yaml); give the run_dir of one") from error
    except (OSError, OmegaConfBaseException) as error:
        raise RunError(f"{path}: cannot be read ({error})") from error
    if not isinstance(plain, dict) or not {"algo", "dataset"} <= plain.keys():
        raise RunError(f"{path}: not the settings of a run; give the run_dir of one")
    return {**{str(key): value for key, value in plain.items()}, "run_dir": str(run_dir)}


def typed_config(plain: Mapping[str, Any], registry: Registry | None = None) -> RunConfig:
    """Return the objects of plain settings; what the installed versions do not know or refuse is a ConfigError."""
    registry = registry or installed()
    algo, dataset = plain["algo"], plain["dataset"]
    schema = OmegaConf.structured(RunConfig)
    with open_dict(schema):
        schema.algo = _schema(registry.algorithm(algo["name"]))
        schema.algo.tracking = _schema(registry.tracking_method(algo["tracking"]["name"]))
        schema.algo.mapping = _schema(registry.mapping_method(algo["mapping"]["name"]))
        schema.dataset = _schema(registry.dataset(dataset["family"]))
        schema.engine = MultiprocessConfig if plain["engine"]["name"] == "multiprocess" else EngineConfig
        schema.evaluation = EvaluationConfig
        viewer = plain["viewer"]["name"]
        schema.viewer = ViewerConfig if viewer == "none" else _schema(registry.viewer(viewer))
    try:
        config = OmegaConf.to_object(OmegaConf.merge(schema, OmegaConf.create(dict(plain))))
    except OmegaConfBaseException as error:
        raise ConfigError(
            f"{error.full_key}: the recorded setting does not fit what is installed ({str(error).splitlines()[0]}); "
            "install the versions that wrote it, which environment.json names"
        ) from error
    assert isinstance(config, RunConfig), "the schema is that of a run"
    return config


def _schema(record: Info) -> Any:  # noqa: ANN401  # OmegaConf's node
    return OmegaConf.structured(record.load_config())
