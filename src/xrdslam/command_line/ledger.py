"""What a sweep leaves on disk beside its runs: which jobs it was asked for, and how each of them ended.

Files and not return values: they outlive a worker that was killed, and go with every launcher.
"""

import hashlib
import json
import os
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from xrdslam.core.errors import RunError
from xrdslam.core.files import write_text

__all__ = ["LEDGER", "OUTCOME", "Ledger", "Outcome", "cores", "folder_name", "read_ledger", "read_outcome"]

LEDGER = "sweep.json"
"""In the folder of a sweep."""
OUTCOME = "job.json"
"""In the folder of each job that was begun."""
LONGEST_NAME = 200
"""Characters of a folder's name; file systems take 255."""


@dataclass(frozen=True)
class Ledger:
    """What one call of a sweep was asked for."""

    call: str
    """Tells one call from another in the same folder."""
    jobs: dict[str, list[str]]
    """The overrides of each job, by the name of its folder."""
    side_by_side: int
    """How many of them may run at once on one machine."""

    def write(self, folder: Path) -> None:
        """Write it into the folder of a sweep."""
        write_text(folder / LEDGER, json.dumps(asdict(self), indent=2) + "\n")


@dataclass(frozen=True)
class Outcome:
    """How a job ended, or that it was begun."""

    call: str
    overrides: list[str]
    status: str
    """running, done, failed or interrupted; one that says running with nobody there was killed."""
    reason: str = ""
    seconds: float = 0.0
    was_skipped: bool = False
    """Whether an earlier call had done it."""
    run_dir: Path = field(default=Path(), compare=False)

    def write(self) -> None:
        """Write it into the job's folder."""
        text = json.dumps({key: value for key, value in asdict(self).items() if key != "run_dir"}, indent=2)
        write_text(self.run_dir / OUTCOME, text + "\n")


def read_ledger(folder: Path) -> Ledger:
    """Return what the newest call of a sweep was asked for."""
    try:
        return Ledger(**json.loads((folder / LEDGER).read_text()))
    except (OSError, TypeError, ValueError) as error:
        raise RunError(f"{folder / LEDGER}: cannot be read ({error}); begin the sweep anew") from error


def read_outcome(run_dir: Path) -> Outcome | None:
    """Return how a job ended, None where none was begun in that folder."""
    path = run_dir / OUTCOME
    if not path.is_file():
        return None
    try:
        return Outcome(**json.loads(path.read_text()), run_dir=run_dir)
    except (OSError, TypeError, ValueError) as error:
        raise RunError(f"{path}: cannot be read ({error}); remove that folder to run the job again") from error


def folder_name(overrides: str) -> str:
    """Return the name of a job's folder: what its overrides say, as far as a file system takes it."""
    name = re.sub(r"[^\w.=,+-]+", "-", overrides).strip("-") or "run"
    if len(name) <= LONGEST_NAME:
        return name
    return f"{name[:LONGEST_NAME]}-{hashlib.sha256(overrides.encode()).hexdigest()[:8]}"


def cores() -> int:
    """Return the cores that this process may use."""
    return len(os.sched_getaffinity(0))


def names_of(jobs: Sequence[Sequence[str]], swept: Sequence[str]) -> list[str]:
    """Return the folder of each job, named as Hydra will name it: its overrides of swept keys, sorted."""
    return [folder_name(",".join(sorted(o for o in job if o.partition("=")[0].lstrip("+~") in swept))) for job in jobs]
