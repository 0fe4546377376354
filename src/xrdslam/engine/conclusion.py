"""The end of a run, whichever end it is: save and measure all that can be."""

import errno
import logging
from collections.abc import Callable
from dataclasses import dataclass, field

from xrdslam.core.errors import RunError, XrdslamError
from xrdslam.engine.context import Run
from xrdslam.engine.results import evaluate, save_map, save_report, save_trajectories
from xrdslam.evaluation import Metrics

__all__ = ["Conclusion", "conclude"]

log = logging.getLogger(__name__)


@dataclass
class Conclusion:
    """What was measured, and what went wrong on the way."""

    metrics: Metrics = field(default_factory=dict)
    was_interrupted: bool = False
    faults: dict[str, Exception] = field(default_factory=dict)
    """What could not be saved or measured, and why."""

    def raise_fault(self, run: Run) -> None:
        """Raise what went wrong, if anything; what a system refuses (a full disk) as a RunError."""
        for what, error in self.faults.items():
            if isinstance(error, OSError):
                raise RunError(
                    f"run_dir={run.directory.path}: the run is over, but {what} could not be written ({error}); "
                    f"{'free space' if error.errno == errno.ENOSPC else 'mend that'} and run again"
                ) from error
            raise error


def conclude(run: Run, is_hurried: bool) -> Conclusion:
    """Save trajectories first: they are small, and nothing after them can lose them; then the map, then the figures.

    What fails keeps nothing else from being saved. In a hurry (the run failed or was stopped) whatever takes long is
    left out: mesh, renderings and the report. An interruption begins the step that it met again, in a hurry; a second
    one ends it.
    """
    done = Conclusion(was_interrupted=False)
    steps: dict[str, Callable[[bool], Metrics | None]] = {}
    if not run.directory.is_there:
        log.warning("run_dir=%s was removed during the run, and with it what had been written", run.directory.path)
        steps["the settings"] = lambda _: run.directory.write_settings(run.config, run.device)
    steps["the trajectories"] = lambda _: save_trajectories(run)
    if len(run.algorithm.trajectory):
        steps["the map"] = lambda is_hurried: save_map(run, with_mesh=not is_hurried)
        steps["the figures"] = lambda is_hurried: evaluate(run, with_rendering=not is_hurried)
        if run.config.report:
            steps["the report"] = lambda is_hurried: None if is_hurried else save_report(run)
    for what, step in steps.items():
        try:
            try:
                with run.interruption.breaking(0.0):
                    found = step(is_hurried or done.was_interrupted)
            except KeyboardInterrupt:
                log.warning("interrupted while saving %s; leaving out what takes long", what)
                done.was_interrupted = True
                with run.interruption.breaking(0.0):
                    found = step(True)
            done.metrics = found or done.metrics
        except Exception as error:
            log.error("%s: %s", what, error, exc_info=not isinstance(error, XrdslamError | OSError))
            done.faults[what] = error
    return done
