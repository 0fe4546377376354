"""Which runs were asked for: folders, and the jobs of sweeps, finished or not."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from xrdslam.core.errors import RunError
from xrdslam.report.run_files import RunFiles, is_run, read_run, runs_in

__all__ = ["Asked", "asked_for"]

LEDGER, OUTCOME = "sweep.json", "job.json"
"""Where a sweep wrote what it was asked for, and each of its jobs how it ended."""


@dataclass(frozen=True, eq=False)
class Asked:
    """Runs that can be read, and a line on each that has no figures."""

    runs: list[RunFiles]
    missing: list[str]


def asked_for(folders: Sequence[Path]) -> Asked:
    """Read the runs in folders. RunError where a folder holds none."""
    asked = Asked([], [])
    for folder in folders:
        if not folder.is_dir():
            raise RunError(f"{folder}: no such folder; give the run_dir of a run, or of a sweep")
        found = list(runs_in(folder))
        if not found and not (folder / LEDGER).is_file():
            raise RunError(f"{folder}: holds no run (no config.yaml in it or below); give the run_dir of a run")
        _take(asked, found)
        if (folder / LEDGER).is_file() and not is_run(folder):
            asked.missing.extend(_never_begun(folder, found))
    return asked


def _take(asked: Asked, found: Sequence[Path]) -> None:
    """Take runs in; those that did not come to their end have no figures that stand beside the others'."""
    for path in found:
        try:
            run = read_run(path)
        except RunError as error:
            asked.missing.append(str(error))
            continue
        who, outcome = f"{path.name} ({run.title}, seed {run.seed})", _json(path / OUTCOME)
        if outcome.get("status", "done") not in ("done", "running"):
            asked.missing.append(f"{who} {_ended(outcome)}")
            continue
        asked.runs.append(run)
        if not run.is_finished:
            asked.missing.append(f"{who} has no figures: it runs yet or was ended")


def _never_begun(folder: Path, found: Sequence[Path]) -> Iterator[str]:
    for name, overrides in _json(folder / LEDGER).get("jobs", {}).items():
        if folder / name not in found:
            outcome = _json(folder / name / OUTCOME)
            yield f"{name} ({' '.join(overrides)}) {_ended(outcome) if outcome else 'was not started'}"


def _ended(outcome: dict[str, Any]) -> str:
    reason = outcome.get("reason", "")
    return f"{outcome.get('status')}: {reason}" if reason else f"was {outcome.get('status')}"


def _json(path: Path) -> dict[str, Any]:
    """Return what a file of a sweep says, nothing where there is none; RunError where it is damaged."""
    try:
        found = json.loads(path.read_text()) if path.is_file() else {}
    except (OSError, ValueError) as error:
        raise RunError(f"{path}: cannot be read ({error}); remove it to do without") from error
    return found if isinstance(found, dict) else {}
