"""What may be set anew when a run is resumed: nothing that its result depends on."""

from collections.abc import Mapping, Sequence
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from xrdslam.core.errors import ConfigError

__all__ = ["overridden"]

FREE = ("engine.progress", "engine.checkpoint_every", "evaluation", "report", "viewer", "dataset.root", "dataset.path")
"""How a run is shown, saved and measured, and where its data lies now."""
BOUND = ("evaluation.held_out",)
"""What is among those and changes the run all the same: frames kept from the map."""
CHOICES = {
    "algo": "algo.name",
    "algo/tracking": "algo.tracking.name",
    "algo/mapping": "algo.mapping.name",
}
"""Options that are chosen by group, and where the settings say which was."""


def overridden(settings: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """Return recorded settings with `key=value` laid over; ConfigError for one that would change the result.

    A value that is as recorded may be given again.
    """
    config = OmegaConf.create(dict(settings))
    for override in overrides:
        key, equals, value = override.partition("=")
        if not equals or not key.replace(".", "").replace("/", "").replace("_", "").isalnum():
            raise ConfigError(f"{override}: resume=<run dir> takes settings as key=value and nothing else")
        if key == "dataset":
            _hold_to(config, ("dataset.family", "dataset.scene"), value.partition("/")[::2], override)
        elif key == "viewer":
            config.viewer = {"name": value}
        elif key == "engine":
            _choose_engine(config, value, override)
        elif key in CHOICES:
            _hold_to(config, (CHOICES[key],), (value,), override)
        else:
            _set(config, key, override)
    return {str(key): value for key, value in OmegaConf.to_container(config).items()}  # type: ignore[union-attr]


def _set(config: Any, key: str, override: str) -> None:  # noqa: ANN401  # OmegaConf's containers
    try:
        wanted = OmegaConf.select(OmegaConf.from_dotlist([override]), key)
    except (OmegaConfBaseException, YAMLError) as error:
        raise ConfigError(f"{override}: no value that can be read ({' '.join(str(error).split())})") from error
    missing = object()
    recorded = OmegaConf.select(config, key, default=missing)
    if recorded is missing:
        raise ConfigError(f"{override}: the run has no setting {key}")
    if recorded == wanted:
        return
    if key in BOUND or not any(f"{key}.".startswith(f"{free}.") for free in FREE):
        _refuse(override, f"{key}={recorded}")
    OmegaConf.update(config, key, wanted)


def _choose_engine(config: Any, name: str, override: str) -> None:  # noqa: ANN401  # OmegaConf's containers
    """Let another engine go on: turn by turn both give the same bits. Tracking that runs ahead is another run."""
    recorded = config.engine
    if name == recorded.name:
        return
    if OmegaConf.select(recorded, "sync", default="strict") != "strict":
        _refuse(override, f"engine={recorded.name} engine.sync={recorded.sync}")
    config.engine = {key: recorded[key] for key in ("progress", "checkpoint_every")} | {"name": name}


def _hold_to(config: Any, keys: Sequence[str], values: Sequence[str], override: str) -> None:  # noqa: ANN401
    recorded = [str(OmegaConf.select(config, key)) for key in keys]
    if recorded != list(values):
        _refuse(override, f"{override.partition('=')[0]}={'/'.join(recorded)}")


def _refuse(override: str, recorded: str) -> None:
    raise ConfigError(
        f"{override}: would change the result of a run that was begun with {recorded}; begin a new run, or resume "
        f"without it (what may be set: {', '.join(FREE)}, and engine, where it is turn by turn)"
    )
