"""What an earlier run left in a folder, held against the run that is wanted there now."""

import json
from pathlib import Path
from typing import Any

from xrdslam.core.config import RunConfig
from xrdslam.core.errors import XrdslamError
from xrdslam.core.registry import Registry, installed
from xrdslam.core.saved_state import read_header
from xrdslam.engine.authorship import check_authorship
from xrdslam.engine.build import settings_of
from xrdslam.engine.checkpoints import newest_checkpoint
from xrdslam.engine.directory import RunDirectory
from xrdslam.engine.recorded import read_config

__all__ = ["left_behind"]

IRRELEVANT = ("run_dir", "report", "viewer", "engine.progress", "engine.checkpoint_every")
"""Settings that no figure depends on."""


def left_behind(config: RunConfig, run_dir: Path, registry: Registry | None = None) -> tuple[str, str]:
    """Return what a folder holds of the very run that is wanted, and else why it is of no use.

    `results` of one that passed every frame; a `checkpoint` of one that did not and can be resumed with the same bits;
    `nothing`: the settings differ, or it was written by other versions, or it did not come that far. Where `threads`
    is 0, those that the earlier run had are as good as any.
    """
    registry = registry or installed()
    if not (run_dir / "config.yaml").is_file():
        return "nothing", "an earlier call did not begin it"
    try:
        differs = _difference(config, read_config(run_dir))
        if differs:
            return "nothing", f"an earlier run there had {differs}; run anew"
        checkpoint = newest_checkpoint(run_dir)
        ended = RunDirectory(run_dir).trajectory_state
        path = checkpoint or (ended if ended.is_file() else None)
        if path is None:
            return "nothing", "an earlier run there left neither results nor a checkpoint; run anew"
        header = read_header(path)
        check_authorship(header, config.algo, registry, path, same_bits=True)
    except XrdslamError as error:
        return "nothing", f"{error}; run anew"
    if checkpoint is not None:
        return "checkpoint", ""
    if header["has_ended"] and _has_figures(run_dir):
        return "results", ""
    return "nothing", "an earlier run there did not come to its end; run anew"


def _has_figures(run_dir: Path) -> bool:
    try:
        return bool(json.loads((run_dir / "metrics.json").read_text()))
    except (OSError, ValueError):
        return False


def _difference(config: RunConfig, recorded: dict[str, Any]) -> str:
    """Return the first setting that differs, as it was; empty where all that count are the same."""
    wanted = _flat(json.loads(json.dumps(settings_of(config))))
    had = _flat(json.loads(json.dumps(recorded)))
    for key in sorted(wanted.keys() | had.keys()):
        free = any(f"{key}.".startswith(f"{name}.") for name in IRRELEVANT) or (key == "threads" and not config.threads)
        if not free and wanted.get(key) != had.get(key):
            return f"{key}={had.get(key)}"
    return ""


def _flat(settings: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in settings.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return flat
