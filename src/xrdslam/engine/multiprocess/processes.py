"""The processes of a run: started together, watched, ended together."""

import logging
import signal
import time
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any

from xrdslam.core.errors import RunError, XrdslamError
from xrdslam.core.shared_algorithm import serve
from xrdslam.engine.multiprocess.channels import Channels
from xrdslam.engine.multiprocess.signals import deaf
from xrdslam.engine.multiprocess.worker import Failure, LogRecord, Work, work

__all__ = ["Processes", "WorkerError"]

log = logging.getLogger(__name__)
PATIENCE_S = 0.5
"""How long to look for the cause once one process has ended: the others fail because of it, and may be seen first."""


class WorkerError(Exception):
    """What a worker raised; the text is its traceback."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


@dataclass
class _Process:
    process: SpawnProcess
    report: Connection
    failure: Failure | None = None


class Processes:
    """The server of the shared algorithm, and the workers; none of them outlives this object's `end`."""

    def __init__(self, channels: Channels) -> None:
        self.channels = channels
        self._context = get_context("spawn")
        self._running: dict[str, _Process] = {}
        resource_tracker.ensure_running()  # else it would be started below, and unblock what is blocked there

    def start_server(self) -> None:
        """Start the server and wait until it listens."""
        self._start("server", serve, (self.channels.address, self.channels.key))
        server = self._running["server"]
        ready = wait([server.report, server.process.sentinel], timeout=60)
        if server.report not in ready or not server.report.poll():
            raise RunError("the server of the shared algorithm did not start; its last words are above")
        server.report.recv()

    def start_worker(self, role: str, packed: bytes, task: Work) -> None:
        """Start a worker; `packed` is its Job."""
        self._start(role, work, (packed, task, self.channels))

    def _start(self, role: str, target: Any, args: tuple[Any, ...]) -> None:  # noqa: ANN401  # a process's target
        ours, theirs = self._context.Pipe(duplex=False)
        process = self._context.Process(target=target, args=(*args, theirs), name=f"xrdslam-{role}", daemon=True)
        self._running[role] = _Process(process, ours)
        with deaf():
            process.start()
        theirs.close()  # the worker's is then the only one: when it ends, so does the pipe

    def watch(self, timeout_s: float) -> None:
        """Wait for reports; hand on what was logged. RunError (or the worker's own) where a process failed."""
        sentinels = {p.process.sentinel: role for role, p in self._running.items()}
        reports = {p.report: role for role, p in self._running.items() if not p.report.closed}
        for ready in wait([*sentinels, *reports], timeout_s):
            if isinstance(ready, Connection):
                self._receive(reports[ready])
        failed = {role for role, p in self._running.items() if p.failure or p.process.exitcode not in (None, 0)}
        if failed:
            raise self._cause()

    def has_ended(self, role: str) -> bool:
        """Say whether a worker has ended as it should."""
        return self._running[role].process.exitcode == 0

    def _receive(self, role: str) -> None:
        """Read what a worker said, until it says nothing more for now."""
        held = self._running[role]
        try:
            while not held.report.closed and held.report.poll():
                said = held.report.recv()
                if isinstance(said, LogRecord):
                    logging.getLogger(said.name).log(said.level, "%s", said.message)
                elif isinstance(said, Failure):
                    held.failure = said
        except (EOFError, OSError):
            held.report.close()

    def _cause(self) -> Exception:
        """Find which process failed first: one that was killed, else one that says more than that others are gone."""
        time.sleep(PATIENCE_S)
        for role in self._running:
            self._receive(role)
        killed = {r: p for r, p in self._running.items() if (p.process.exitcode or 0) < 0}
        raised = {r: p.failure for r, p in self._running.items() if p.failure}
        for role, held in killed.items():
            number = -(held.process.exitcode or 0)
            hint = "; the system does that where memory runs out" if number == signal.SIGKILL else ""
            return RunError(f"the {role} was killed by {signal.Signals(number).name}{hint}")
        if raised:
            return _error_of(raised)
        role, held = next((r, p) for r, p in self._running.items() if p.process.exitcode not in (None, 0))
        return RunError(f"the {role} ended with exit status {held.process.exitcode}; its last words are above")

    def end(self, timeout_s: float = 2.0) -> None:
        """End whatever still runs: the workers first, so that the server knows all that they said."""
        for role in sorted(self._running, key=lambda role: role == "server"):
            self._end(role, timeout_s)

    def end_workers(self) -> None:
        """End all but the server."""
        for role in [role for role in self._running if role != "server"]:
            self._end(role, 2.0)

    def _end(self, role: str, timeout_s: float) -> None:
        held = self._running[role]
        if held.process.pid is not None:
            held.process.kill()
            held.process.join(timeout_s)
            held.process.close()
        held.report.close()
        del self._running[role]


def _error_of(raised: Mapping[str, Failure]) -> Exception:
    """Return what the first worker that failed by itself raised; a lost connection is the others' doing."""
    lost = ("EOFError", "ConnectionResetError", "ConnectionRefusedError", "BrokenPipeError")
    role = min(raised, key=lambda role: raised[role].summary.startswith(lost))
    failure = raised[role]
    log.error("the %s failed:\n%s", role, failure.trace)
    error: XrdslamError = failure.error or RunError(f"the {role} failed: {failure.summary}")
    error.__cause__ = WorkerError(failure.trace)
    return error
