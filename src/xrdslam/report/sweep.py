"""Which runs were asked for: folders, and the jobs of Hydra sweeps, finished or not."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from omegaconf import OmegaConf

from xrdslam.core.errors import RunError
from xrdslam.report.run_files import RunFiles, is_run, read_run, runs_in

__all__ = ["Asked", "asked_for"]

LEDGER = "multirun.yaml"
"""Where Hydra writes what a sweep was asked for."""


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
            asked.missing.extend(_never_started(folder, found))
    return asked


def _take(asked: Asked, found: Sequence[Path]) -> None:
    for path in found:
        try:
            run = read_run(path)
        except RunError as error:
            asked.missing.append(str(error))
            continue
        asked.runs.append(run)
        if not run.is_finished:
            asked.missing.append(f"{path.name} ({run.title}, seed {run.seed}) has no figures: it runs yet or was ended")


def _never_started(folder: Path, found: Sequence[Path]) -> Iterator[str]:
    started = {path.relative_to(folder).parts[0].partition("_")[0] for path in found}
    for number, overrides in enumerate(_jobs(folder / LEDGER)):
        if str(number) not in started:
            yield f"job {number} ({' '.join(overrides)}) was not started"


def _jobs(ledger: Path) -> list[list[str]]:
    """Return the overrides of each job of a sweep, in Hydra's order."""
    from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
    from hydra.core.override_parser.overrides_parser import OverridesParser

    overrides = list(OmegaConf.load(ledger).hydra.overrides.task)
    parsed = OverridesParser.create().parse_overrides(overrides)
    return [job for batch in BasicSweeper.split_arguments(parsed, max_batch_size=None) for job in batch]
