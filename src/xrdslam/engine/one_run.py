"""One run: check, build, go, save, evaluate, summarise."""

import logging
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from xrdslam.core.config import RunConfig
from xrdslam.core.errors import RunError, XrdslamError
from xrdslam.core.files import remove_unfinished
from xrdslam.core.registry import Registry, installed
from xrdslam.core.saved_state import read_header
from xrdslam.engine.authorship import check_format
from xrdslam.engine.build import algorithm_of, build_dataset, resolve_device
from xrdslam.engine.checkpoints import Checkpoints, newest_checkpoint
from xrdslam.engine.conclusion import conclude
from xrdslam.engine.context import Run
from xrdslam.engine.directory import RunDirectory
from xrdslam.engine.multiprocess.parent import run_multiprocess
from xrdslam.engine.overrides import overridden
from xrdslam.engine.recorded import typed_config
from xrdslam.engine.restoring import restore
from xrdslam.engine.seeding import num_threads, prepare
from xrdslam.engine.sequential import run_sequential
from xrdslam.evaluation import EvalMetrics, Metrics

__all__ = ["RunSummary", "resume", "run"]

log = logging.getLogger(__name__)

ENGINES = {"sequential": run_sequential, "multiprocess": run_multiprocess}


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
    this = _built(config, run_dir, registry or installed())
    this.directory.clear()
    Checkpoints(this).remove()
    return _go(this)


def resume(run_dir: Path, overrides: Sequence[str] = (), registry: Registry | None = None) -> RunSummary:
    """Go on with a run that was killed, interrupted or failed, after the frame of its newest checkpoint.

    The settings are those of the checkpoint; `overrides` (`key=value`) may touch nothing that the result depends on.
    The result is that of the uninterrupted run, to the bit.
    """
    registry = registry or installed()
    path = newest_checkpoint(run_dir)
    if path is None:
        state = "has ended" if (run_dir / "metrics.json").is_file() else "left no checkpoint"
        raise RunError(f"resume={run_dir}: the run there {state}; begin a new one")
    remove_unfinished(run_dir)
    header = read_header(path)
    check_format(header, path)
    settings = overridden({**header["config"], "run_dir": str(run_dir)}, overrides)
    this = _built(typed_config(settings, registry), run_dir, registry)
    restore(this, path)
    return _go(this)


def _built(config: RunConfig, run_dir: Path, registry: Registry) -> Run:
    device = resolve_device(config.device)
    prepare(config.seed, num_threads(config.threads))
    dataset = build_dataset(config, registry)
    algorithm = algorithm_of(config, device, registry)
    this = Run(config, RunDirectory(run_dir), dataset, algorithm, registry, device)
    algorithm.check(this.scene)
    EvalMetrics(config.evaluation).check()
    return this


def _go(this: Run) -> RunSummary:
    run_dir = this.directory.path
    try:
        this.directory.write_settings(this.config, this.device)
        log_file = _log_file(run_dir / "log.txt")
    except OSError as error:
        raise RunError(
            f"run_dir={run_dir}: cannot be written ({error}); free space, or choose another folder"
        ) from error
    with _logging_to(log_file), this.interruption, _closing(this), _watched(this.config, this.registry):
        if this.resumed_after:
            log.info("resumed after frame %d", this.resumed_after[-1])
        return _carry_out(this)


@contextmanager
def _closing(this: Run) -> Iterator[None]:
    """Close what an engine left open, undisturbed: it may be a process."""
    try:
        yield
    finally:
        with this.interruption.shielded():
            this.closing.close()


def _carry_out(this: Run) -> RunSummary:
    with this.interruption.breaking(0.0):  # a hook may take for ever
        this.registry.notify("xrdslam_run_started", run=this)
    was_interrupted, failure = False, None
    try:
        ENGINES[this.config.engine.name](this)
        this.has_ended = True
    except KeyboardInterrupt:
        was_interrupted = True
        log.warning("interrupted after %d frames; saving what there is", len(this.algorithm.trajectory))
    except Exception as error:
        failure, done = error, len(this.algorithm.trajectory)
        trace = not isinstance(error, XrdslamError)  # what a user can mend needs no traceback
        log.error("the run failed after %d frames (%s); saving what there is", done, error, exc_info=trace)
    end = conclude(this, is_hurried=was_interrupted or failure is not None)
    if failure is not None:
        raise failure
    end.raise_fault(this)
    if not (was_interrupted or end.was_interrupted):
        Checkpoints(this).remove()
    with this.interruption.breaking(0.0):
        this.registry.notify("xrdslam_run_finished", run=this, metrics=end.metrics)
    return RunSummary(end.metrics, this.directory.path, was_interrupted or end.was_interrupted)


class _LogFile(logging.FileHandler):
    """A run's log.txt; on a full disk it is the run that goes on, not the log."""

    def handleError(self, record: logging.LogRecord) -> None:  # logging's name
        sys.stderr.write(f"{self.baseFilename} cannot be written: it lacks what follows\n")
        logging.getLogger().removeHandler(self)


def _log_file(path: Path) -> logging.Handler:
    handler = _LogFile(path)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    return handler


@contextmanager
def _watched(config: RunConfig, registry: Registry) -> Iterator[None]:
    """Let the chosen viewer hear of the run; an extra that is missing is named before the first frame.

    A viewer lives in this process, unless the engine has one for it.
    """
    name = config.viewer.name
    if name == "none":
        yield
        return
    record = registry.viewer(name)
    if config.engine.name == "multiprocess":
        yield
        return
    viewer = record.load()(config.viewer)
    try:
        with registry.listening(viewer, f"viewer={name}"):
            yield
    finally:
        try:
            viewer.close()
        except Exception as error:  # everything is saved by now
            log.warning("viewer=%s could not be closed: %s: %s", name, type(error).__name__, error)


@contextmanager
def _logging_to(handler: logging.Handler) -> Iterator[None]:
    """Write everything that is logged into a run's log.txt as well."""
    root = logging.getLogger()
    root.addHandler(handler)
    try:
        yield
    finally:
        root.removeHandler(handler)
        with suppress(OSError):  # a full disk has been reported
            handler.close()
