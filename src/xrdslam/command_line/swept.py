"""One job of a sweep as its launcher's worker sees it: left out if done, else run in a process of its own.

Its own process, because then memory and threads are this job's alone, and a job that is killed costs no other.
"""

import fcntl
import json
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import IO

from omegaconf import DictConfig

from xrdslam.command_line.compose import run_config
from xrdslam.command_line.explain import in_one_line
from xrdslam.command_line.ledger import Ledger, Outcome, cores, read_ledger, read_outcome
from xrdslam.core.config import RunConfig
from xrdslam.core.errors import XrdslamError

__all__ = ["OUTPUT", "RUNNING", "STOP", "carry_out_job", "what_to_do"]

OUTPUT = "output.txt"
"""In a job's folder: what it would have shown."""
RUNNING = ".running"
"""In a sweep's folder: locked by each job that runs."""
STOP = ".stop"
"""In a sweep's folder: its jobs are to end."""
POLL_S = 0.3
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
log = logging.getLogger(__name__)


def carry_out_job(
    cfg: DictConfig, choices: Mapping[str, str | None], run_dir: Path, sweep_dir: Path, overrides: Sequence[str]
) -> None:
    """Carry out a job, unless the sweep was stopped. How it ended stands in its folder; nothing is raised for it."""
    if (sweep_dir / STOP).exists():
        return
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a worker: its sweep hears of Ctrl-C, too, and says
    ledger = read_ledger(sweep_dir)
    begun = Outcome(ledger.call, list(overrides), "running", run_dir=run_dir)
    skip_done = cfg.sweep.skip_done
    try:
        config = run_config(cfg, choices, run_dir)
        what, why = what_to_do(config, run_dir) if skip_done else ("run", "")
    except XrdslamError as error:
        _end(replace(begun, status="failed", reason=in_one_line(error)))
        return
    if what == "skip":
        _end(replace(begun, status="done", was_skipped=True))
        return
    if why:
        log.info("%s: %s", run_dir.name, why)
    config.threads = config.threads or max(1, cores() // ledger.side_by_side)
    begun.write()
    began = time.monotonic()
    with _counted(sweep_dir):
        code = _in_a_process(config, what == "resume", begun, ledger, sweep_dir)
    ended = read_outcome(run_dir)
    if ended is None or ended.status == "running":
        seconds = round(time.monotonic() - began, 1)
        ended = replace(begun, status="failed", reason=_last_word(code, run_dir), seconds=seconds)
    _end(ended)


def what_to_do(config: RunConfig, run_dir: Path) -> tuple[str, str]:
    """Return skip, resume or run, and why where an earlier call left something that is of no use."""
    earlier = read_outcome(run_dir)
    if earlier is None:
        return "run", ""
    from xrdslam.engine.earlier import left_behind  # torch: only where there is something to look at

    left, why = left_behind(config, run_dir)
    if left == "results":
        return ("skip", "") if earlier.status == "done" else ("run", "an earlier call did not finish it; run again")
    return ("resume", "") if left == "checkpoint" else ("run", why)


def _in_a_process(config: RunConfig, is_resumed: bool, begun: Outcome, ledger: Ledger, sweep_dir: Path) -> int:
    """Run, and return the exit status; stop the run where the sweep is stopped."""
    asked = {
        "settings": asdict(config),
        "resume": is_resumed,
        "outcome": {key: value for key, value in asdict(begun).items() if key != "run_dir"},
    }
    environment = os.environ | dict.fromkeys(THREADS, str(config.threads))
    with _output(begun.run_dir, ledger.side_by_side) as output:
        job = subprocess.Popen(
            [sys.executable, "-m", "xrdslam.command_line.job"],
            stdin=subprocess.PIPE,
            stdout=output,
            stderr=subprocess.STDOUT if output else None,
            env=environment,
            start_new_session=True,  # Ctrl-C is for the sweep, which ends its jobs
        )
    assert job.stdin is not None
    try:
        job.stdin.write(json.dumps(asked).encode() + b"\n")
        job.stdin.flush()  # and stays open: the job ends when it closes
        return _wait(job, sweep_dir)
    except KeyboardInterrupt:
        job.send_signal(signal.SIGTERM)
        job.wait()
        raise
    finally:
        job.stdin.close()


def _wait(job: "subprocess.Popen[bytes]", sweep_dir: Path) -> int:
    is_told = False
    while True:
        try:
            return job.wait(POLL_S)
        except subprocess.TimeoutExpired:
            if not is_told and (sweep_dir / STOP).exists():
                job.send_signal(signal.SIGTERM)
                is_told = True


@contextmanager
def _output(run_dir: Path, side_by_side: int) -> Iterator[IO[bytes] | None]:
    """Yield where a job's output goes: a file where several would write over one another, else where ours goes."""
    if side_by_side == 1:
        yield None
        return
    with (run_dir / OUTPUT).open("wb") as file:
        yield file


@contextmanager
def _counted(sweep_dir: Path) -> Iterator[None]:
    with (sweep_dir / RUNNING).open("w") as file:
        fcntl.flock(file, fcntl.LOCK_SH)
        yield


def _last_word(code: int, run_dir: Path) -> str:
    """Say how a process ended that did not say so itself."""
    if code < 0:
        return f"killed by {signal.Signals(-code).name}" + (" (out of memory?)" if code == -signal.SIGKILL else "")
    output = run_dir / OUTPUT
    lines = output.read_text(errors="replace").split("\n") if output.is_file() else []
    said = next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")
    return f"ended with exit status {code}: {said}"


def _end(outcome: Outcome) -> None:
    outcome.write()
    said = f": {outcome.reason}" if outcome.reason else f" in {outcome.seconds:.0f} s"
    log.info("%s %s", outcome.run_dir.name, "was done before" if outcome.was_skipped else f"{outcome.status}{said}")
