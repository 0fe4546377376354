"""One run: check, build, go, save, evaluate, summarise."""

import logging
import os
import random
import signal
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np
import torch

from xrdslam.core.config import RunConfig
from xrdslam.core.errors import XrdslamError
from xrdslam.core.registry import Registry, installed
from xrdslam.engine.build import build_algorithm, build_dataset, resolve_device
from xrdslam.engine.context import Run
from xrdslam.engine.directory import RunDirectory
from xrdslam.engine.results import evaluate, save_map, save_report, save_trajectories
from xrdslam.engine.sequential import run_sequential
from xrdslam.evaluation import EvalMetrics, Metrics

__all__ = ["RunSummary", "run"]

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RunSummary:
    """How a run ended."""

    metrics: Metrics
    run_dir: Path
    was_interrupted: bool = False

    @property
    def exit_status(self) -> int:
        """0, or 130 for an interrupted run, as a shell reports SIGINT."""
        return 130 if self.was_interrupted else 0


def run(config: RunConfig, run_dir: Path, registry: Registry | None = None) -> RunSummary:
    """Carry out a run and write its directory.

    Everything that can be refused is refused before the first frame. Whatever ends the run early (Ctrl-C, SIGTERM, an
    error of a method), what was computed is saved first; an error is raised again after that.
    """
    device = resolve_device(config.device)
    prepare(config)
    registry = registry or installed()
    dataset = build_dataset(config, registry)
    algorithm = build_algorithm(config.algo, config.seed, device, registry, config.evaluation.held_out)
    this = Run(config, RunDirectory(run_dir), dataset, algorithm, registry, device)
    algorithm.check(this.scene)
    EvalMetrics(config.evaluation).check()
    this.directory.write_config(config)
    this.directory.write_environment(config, device)
    with _log_to(run_dir / "log.txt"), _watched(config, registry):
        return _carry_out(this)


def _carry_out(this: Run) -> RunSummary:
    this.registry.notify("xrdslam_run_started", run=this)
    was_interrupted = False
    try:
        with _terminable():
            run_sequential(this)
    except KeyboardInterrupt:
        was_interrupted = True
        log.warning("interrupted after %d frames; saving what there is", len(this.algorithm.trajectory))
    except Exception as error:
        done = len(this.algorithm.trajectory)
        trace = not isinstance(error, XrdslamError)  # what a user can mend needs no traceback
        log.error("the run failed after %d frames (%s); saving what there is", done, error, exc_info=trace)
        _save(this)
        raise
    _save(this)
    metrics = evaluate(this, with_rendering=not was_interrupted) if len(this.algorithm.trajectory) else {}
    if this.config.report:
        save_report(this)
    this.registry.notify("xrdslam_run_finished", run=this, metrics=metrics)
    return RunSummary(metrics, this.directory.path, was_interrupted)


def _save(this: Run) -> None:
    """Save trajectories first: they are small, and nothing after them can lose them."""
    save_trajectories(this)
    if len(this.algorithm.trajectory):
        save_map(this)


def prepare(config: RunConfig) -> None:
    """Set threads and every source of random numbers."""
    import numba

    threads = config.threads or len(os.sched_getaffinity(0))
    numba.set_num_threads(min(threads, int(numba.config.NUMBA_NUM_THREADS)))  # type: ignore[attr-defined]  # set late
    torch.set_num_threads(threads)  # after numba, whose start sets the OpenMP pool that both share to all cores
    random.seed(config.seed)
    np.random.seed(config.seed)  # noqa: NPY002  # libraries that a plugin uses may draw from numpy's global stream
    torch.manual_seed(config.seed)


@contextmanager
def _watched(config: RunConfig, registry: Registry) -> Iterator[None]:
    """Let the chosen viewer hear of the run; an extra that is missing is named before the first frame."""
    if config.viewer.name == "none":
        yield
        return
    viewer = registry.viewer(config.viewer.name).load()(config.viewer)
    with closing(viewer), registry.listening(viewer, f"viewer={config.viewer.name}"):
        yield


@contextmanager
def _log_to(path: Path) -> Iterator[None]:
    """Write everything that is logged into a run's log.txt as well."""
    handler = logging.FileHandler(path)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    root = logging.getLogger()
    root.addHandler(handler)
    try:
        yield
    finally:
        root.removeHandler(handler)
        handler.close()


@contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM end a run as Ctrl-C does (only the main thread can ask for signals)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
