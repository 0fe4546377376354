"""The visualizer, seen from the parent: started, told, listened to, and never waited for."""

import logging
import pickle
import signal
import time
from contextlib import suppress
from multiprocessing import get_context

import numpy as np
import torch

from xrdslam.core.hookspecs import hookimpl
from xrdslam.engine.context import Run
from xrdslam.engine.multiprocess.channels import Channels
from xrdslam.engine.multiprocess.child import Done, Failure, LogRecord, start
from xrdslam.engine.multiprocess.roles import Role
from xrdslam.engine.multiprocess.shared_state import SharedState
from xrdslam.engine.multiprocess.visualizer import METRICS, TRAJECTORY, UP, Order, show_all
from xrdslam.engine.multiprocess.worker import Job

__all__ = ["Visualizer"]

log = logging.getLogger(__name__)
START_S = 30.0
"""How long the first frame waits for a viewer that is being made."""
PATIENCE_S = 5.0
"""How long a viewer may take to close; one that hangs is ended."""


class Visualizer:
    """The process that a run's viewer lives in. Whatever happens to it costs the run a warning, and the viewer frames.

    What a viewer refuses while it is made (an extra that is missing, a port that is taken) ends the run before its
    first frame, as it does where the viewer lives in the run's own process.
    """

    def __init__(self, job: Job, channels: Channels) -> None:
        """Start it; the viewer is made there, meanwhile."""
        self.name = f"viewer={job.config.viewer.name}"
        self.is_settled = False
        """Whether the viewer is made, or is not waited for."""
        self.has_ended = False
        self._farewell = SharedState()
        self._failure: Failure | None = None
        self._is_done = False
        self._waits_until = time.monotonic() + START_S
        orders, self._orders = get_context("spawn").Pipe(duplex=False)
        args = (pickle.dumps(job), channels, orders, self._farewell)
        self._process, self._report = start(Role.VISUALIZER, show_all, *args)
        orders.close()

    def attend(self) -> None:
        """Hand on what it logged; say once that it has ended. What a viewer refused while it was made is raised."""
        if self.has_ended:
            return
        exit_status = self._process.exitcode  # before its last words are read
        self._listen()
        if exit_status is not None:
            self._has_ended_with(exit_status)
        self.is_settled |= time.monotonic() > self._waits_until

    def _listen(self) -> None:
        with suppress(EOFError, OSError):
            while self._report.poll():
                said = self._report.recv()
                if isinstance(said, LogRecord):
                    logging.getLogger(said.name).log(said.level, "%s", said.message)
                elif isinstance(said, Failure):
                    self._failure = said
                self.is_settled |= said == UP
                self._is_done |= isinstance(said, Done)

    def _has_ended_with(self, exit_status: int) -> None:
        self.has_ended = True
        failure, was_made = self._failure, self.is_settled
        self.is_settled = True
        if failure is not None and failure.error is not None and not was_made:
            raise failure.error
        if exit_status < 0:
            why = f"was killed by {signal.Signals(-exit_status).name}"
        else:
            why = f"failed ({failure.summary})" if failure else f"ended with exit status {exit_status}"
        log.warning("%s %s; the run goes on without it", self.name, why)

    @hookimpl
    def xrdslam_run_finished(self, run: Run, metrics: object) -> None:
        """Let the viewer hear of the end."""
        told = np.frombuffer(pickle.dumps(metrics), np.uint8).copy()
        poses = {f"{TRAJECTORY}{name}": tensor for name, tensor in run.algorithm.trajectory.state_dict().items()}
        self._farewell.publish({**poses, METRICS: torch.from_numpy(told)})
        self._order(Order.FINISHED)

    def _order(self, order: Order) -> None:
        with suppress(OSError):  # it has ended; `attend` says so
            self._orders.send(order)

    def close(self) -> None:
        """End it, in order if it does so soon."""
        if not self.has_ended:
            self._order(Order.CLOSE)
            self._process.join(PATIENCE_S)
            self._listen()
            if self._process.exitcode is None:
                log.warning("%s does not close within %g s; it is ended", self.name, PATIENCE_S)
                self._process.kill()
                self._process.join()
            elif not self._is_done:
                self._has_ended_with(self._process.exitcode)
            self.has_ended = True
        self._process.close()
        self._report.close()
        self._orders.close()
