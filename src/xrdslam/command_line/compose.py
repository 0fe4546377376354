"""From what Hydra composed to the typed settings of a run, everything checked."""

from collections.abc import Mapping
from pathlib import Path

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf

from xrdslam.command_line.groups import OVERLAYS, options
from xrdslam.command_line.settings import CommandLineConfig
from xrdslam.core.config import RunConfig
from xrdslam.core.errors import ConfigError

__all__ = ["check_preset", "run_config"]


def run_config(cfg: DictConfig, choices: Mapping[str, str | None], run_dir: Path) -> RunConfig:
    """Return the settings as objects; a value that makes no sense is a ConfigError with its dotted name.

    `choices` are the options that were chosen, by group; `run_dir` is where Hydra says that this job's results go.
    """
    check_preset(choices)
    cfg.run_dir = str(run_dir)
    config = OmegaConf.to_object(cfg)
    assert isinstance(config, CommandLineConfig), "config.yaml begins with the schema of the command line"
    return config.run()


def check_preset(choices: Mapping[str, str | None]) -> None:
    """Refuse a preset that changes nothing: none of the chosen methods has it, though another method may.

    One that the user wrote (`preset/<name>.yaml` under `--config-dir`) is not among the stored ones and is let through.
    """
    preset = choices["preset"]
    if preset == "published" or f"{preset}.yaml" not in ConfigStore.instance().list("preset"):
        return
    methods = {group: choices[group] for group in OVERLAYS}
    offered = {name for group, method in methods.items() for name in options(f"presets/{OVERLAYS[group]}/{method}")}
    if preset not in offered:
        raise ConfigError(
            f"preset={preset}: none of {', '.join(f'{group}={method}' for group, method in methods.items())} has it; "
            f"there is {', '.join(sorted({'published', *offered}))}"
        )
