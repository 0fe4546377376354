"""A sweep as its parent process sees it: what is asked for at the start, what became of it at the end."""

import fcntl
import logging
import os
import shlex
import signal
import sys
import textwrap
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import FrameType

from hydra.errors import HydraException
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console

from xrdslam.command_line.explain import in_one_line
from xrdslam.command_line.ledger import LEDGER, Ledger, Outcome, cores, names_of, read_outcome
from xrdslam.command_line.swept import RUNNING, STOP
from xrdslam.core.errors import ConfigError, XrdslamError
from xrdslam.core.files import write_text

__all__ = ["Sweep", "SweepCallback", "supervised"]

SIDE_BY_SIDE = ("joblib", "ray", "submitit_local")
"""Launchers that run jobs side by side on this machine; a queue's jobs have the cores that the queue gives them."""
ENDING_S = 30.0
"""How long jobs may take to save what there is."""
log = logging.getLogger(__name__)


@dataclass
class Sweep:
    """One call of a sweep: its folder, and what it was asked for."""

    folder: Path
    ledger: Ledger
    arguments: list[str]
    """What stood on the command line."""
    was_interrupted: bool = False

    def begin(self) -> None:
        """Write down what is asked for."""
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / STOP).unlink(missing_ok=True)
        self.ledger.write(self.folder)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._interrupt)

    def _interrupt(self, _number: int, _frame: FrameType | None) -> None:
        """Let the jobs end, and so the launcher; the second time, leave the launcher."""
        if self.was_interrupted:
            raise KeyboardInterrupt
        self.was_interrupted = True
        (self.folder / STOP).touch()
        log.warning("the sweep is to end: its jobs save what there is; asked again, it does not wait for its launcher")

    def stop(self) -> None:
        """Tell jobs to end, and wait until those of this machine have."""
        write_text(self.folder / STOP, "")
        deadline = time.monotonic() + ENDING_S
        with (self.folder / RUNNING).open("w") as file:
            while time.monotonic() < deadline:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    return
                except BlockingIOError:
                    time.sleep(0.1)
        log.warning("jobs of %s have not ended within %g s", self.folder, ENDING_S)

    def outcomes(self) -> Iterator[tuple[str, Outcome | None]]:
        """Yield the folder of each job and how the job ended in this call, None where it was not begun."""
        for name in self.ledger.jobs:
            found = read_outcome(self.folder / name)
            yield name, found if found is not None and found.call == self.ledger.call else None

    def conclude(self) -> int:
        """Show what became of each job, make the report, and return the exit status: 1 where any is not done."""
        outcomes = dict(self.outcomes())
        done = [outcome for outcome in outcomes.values() if outcome is not None and outcome.status == "done"]
        before = sum(outcome.was_skipped for outcome in done)
        say = Console(soft_wrap=True, highlight=False, markup=False).print
        say(f"{len(done)} of {len(outcomes)} jobs done" + (f", {before} of them before" if before else ""))
        for name, outcome in outcomes.items():
            if outcome is None or outcome.status != "done":
                reason = f": {outcome.reason}" if outcome is not None and outcome.reason else ""
                say(f"  {_fate(outcome)}  {self.folder / name}{reason}")
        if done:
            say(_report(self.folder))
        if len(done) == len(outcomes):
            return 0
        say(f"the others once more: python -m xrdslam {shlex.join(self._again())}")
        return 1

    def _again(self) -> list[str]:
        """Return the arguments that go on with this sweep."""
        ours = ("sweep.dir=", "sweep.skip_done=")
        kept = [argument for argument in self.arguments if not argument.startswith(ours)]
        return [*kept, f"sweep.dir={self.folder}", "sweep.skip_done=true"]


def _fate(outcome: Outcome | None) -> str:
    if outcome is None:
        return "not started"
    return "killed" if outcome.status == "running" else outcome.status


def _report(folder: Path) -> str:
    """Write the table of a sweep into its folder and return where, or the command that does where that fails."""
    from xrdslam.report.comparison import write_comparison

    try:
        written = write_comparison(folder)
    except Exception as error:  # a fault of a table must not fail a sweep that took days
        return f"no report ({type(error).__name__}: {error}); try: python -m xrdslam.report {folder} --split"
    return "report: " + " ".join(map(str, written))


@dataclass
class Supervision:
    """The sweep of this process, if its arguments ask for one."""

    sweep: Sweep | None = None


supervision = Supervision()
"""Where Hydra, which makes the callback itself, and the command line meet."""


class SweepCallback(Callback):
    """Called by Hydra when a sweep begins."""

    def on_multirun_start(self, config: DictConfig, **_: object) -> None:
        """Refuse what no sweep can do, write down what is asked for, and let folders' names say what is swept."""
        try:
            supervision.sweep = _begun(config)
        except (XrdslamError, HydraException) as error:
            sys.exit(f"xrdslam: {in_one_line(error)}")  # Hydra would go on after anything else
        except Exception:  # a defect
            traceback.print_exc()
            sys.exit(1)


def _begun(config: DictConfig) -> Sweep:
    OmegaConf.to_object(config.sweep)  # refuses nonsense
    jobs, swept = _jobs(config)
    choices = config.hydra.runtime.choices
    folder = Path(str(config.sweep.dir)).absolute()
    _check(config, choices, folder)
    names = names_of(jobs, swept)
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ConfigError(f"{twice}: stands for more than one job of the sweep; each combination once is enough")
    limit = config.sweep.jobs or (cores() if choices["launcher"] in SIDE_BY_SIDE else 1)
    call = f"{datetime.now().isoformat()} {os.getpid()}"
    sweep = Sweep(folder, Ledger(call, dict(zip(names, jobs, strict=True)), min(limit, len(jobs))), sys.argv[1:])
    sweep.begin()
    others = sorted({o.partition("=")[0].lstrip("+~") for job in jobs for o in job} - set(swept))
    with open_dict(config):
        config.hydra.sweep.dir = str(folder)
        config.hydra.overrides.hydra += [  # what the settings of each job are composed with
            f"hydra.sweep.dir={_quoted(str(folder))}",
            f"hydra.job.config.override_dirname.exclude_keys=[{','.join(others)}]",
        ]
    return sweep


@contextmanager
def supervised() -> Iterator[None]:
    """Surround Hydra: a sweep that begins inside is brought to its end, whatever its launcher does."""
    try:
        yield
    except BaseException as error:
        if supervision.sweep is None or isinstance(error, HydraException | OmegaConfBaseException):
            raise  # no job was begun: Hydra composes them all before it launches the first
        log.warning("the launcher of the sweep ended early (%s); jobs that run yet save what there is", _named(error))
        supervision.sweep.stop()
        supervision.sweep.conclude()
        sys.exit(130 if supervision.sweep.was_interrupted else 1)
    if supervision.sweep is not None:
        status = supervision.sweep.conclude()
        sys.exit(130 if supervision.sweep.was_interrupted else status)


def _named(error: BaseException) -> str:
    said = textwrap.shorten(str(error), 200)
    return f"{type(error).__name__}: {said}" if said else type(error).__name__


def _check(config: DictConfig, choices: DictConfig, folder: Path) -> None:
    launcher, stock = str(choices["launcher"]), str(choices["hydra/launcher"])
    tasks = [str(override) for override in config.hydra.overrides.task]
    if any(override.startswith("run_dir=") for override in tasks):
        raise ConfigError("run_dir: a sweep makes a folder for each job; say sweep.dir=<folder> for all of them")
    if launcher == "basic" and stock != "basic" and not config.threads:
        raise ConfigError(
            f"hydra/launcher={stock}: how many jobs share the cores is not known; "
            f"say launcher={stock} if --help lists it, or threads=<of each job>"
        )
    if launcher == "basic" and stock == "basic" and config.sweep.jobs > 1:
        raise ConfigError(
            f"sweep.jobs={config.sweep.jobs}: launcher=basic runs one job after another; "
            "launcher=joblib runs them side by side"
        )
    if config.sweep.skip_done and not (folder / LEDGER).is_file():
        known = sorted(folder.parent.glob(f"*/{LEDGER}"))
        last = f"; the last one is {known[-1].parent}" if known else ""
        raise ConfigError(f"sweep.skip_done=true: {folder} holds no sweep; say which one with sweep.dir=<folder>{last}")


def _jobs(config: DictConfig) -> tuple[list[list[str]], list[str]]:
    """Return the overrides of each job, in Hydra's order, and the keys that are swept."""
    from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
    from hydra.core.override_parser.overrides_parser import OverridesParser

    parsed = OverridesParser.create().parse_overrides([str(o) for o in config.hydra.overrides.task])
    batches = BasicSweeper.split_arguments(parsed, max_batch_size=None)
    return [list(job) for batch in batches for job in batch], [o.key_or_group for o in parsed if o.is_sweep_override()]


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"
