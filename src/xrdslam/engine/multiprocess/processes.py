"""The processes of a run: started together, watched, ended together."""

import logging
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

from xrdslam.core.errors import RunError, XrdslamError
from xrdslam.core.shared_algorithm import LISTENING, serve
from xrdslam.engine.multiprocess.channels import Channels
from xrdslam.engine.multiprocess.child import Asked, Done, Failure, LogRecord, start
from xrdslam.engine.multiprocess.roles import Role
from xrdslam.engine.multiprocess.worker import Work, work

__all__ = ["Processes", "WorkerError"]

log = logging.getLogger(__name__)
PATIENCE_S = 0.5
"""How long to look for the cause once one process has ended: the others fail because of it, and may be seen first."""
START_S = 60.0
"""How long the server may take until it listens; it imports next to nothing."""
END_S = 5.0
"""How long a process may take to be gone once it is killed: its memory is given back meanwhile."""


class WorkerError(Exception):
    """What a worker raised; the text is its traceback."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


@dataclass
class _Process:
    process: SpawnProcess
    report: Connection
    failure: Failure | None = None
    is_ready: bool = False
    is_done: bool = False


class Processes:
    """The server of the shared algorithm, and the workers; none of them outlives this object's `end`."""

    def __init__(self, channels: Channels) -> None:
        self.channels = channels
        self._running: dict[str, _Process] = {}
        self._is_asked = False
        resource_tracker.ensure_running()  # else it would be started below, and unblock what is blocked there

    def start_server(self, readers: Sequence[str]) -> None:
        """Start the server; `readers` are the processes that repeat the steps."""
        self._start(Role.SERVER, serve, self.channels.address, self.channels.key, readers)

    def wait_for_server(self) -> None:
        """Wait until the server listens."""
        until = time.monotonic() + START_S
        while not self._running[Role.SERVER].is_ready:
            self.watch(timeout_s=until - time.monotonic())
            if time.monotonic() > until:
                raise RunError(f"the {Role.SERVER} does not listen after {START_S:g} s; is this machine overloaded?")

    def start_worker(self, role: str, packed: bytes, task: Work) -> None:
        """Start a worker, which waits for `Channels.event_begin`; `packed` is its Job."""
        self._start(role, work, packed, task, self.channels)

    def _start(self, role: str, function: Callable[..., None], *args: object) -> None:
        self._running[role] = _Process(*start(role, function, *args))

    def watch(self, timeout_s: float, is_asked: bool = False) -> None:
        """Wait for reports; hand on what was logged.

        RunError (or the worker's own) where a process failed, KeyboardInterrupt where one was asked to end, unless the
        run is known to be (`is_asked`).
        """
        sentinels = [p.process.sentinel for p in self._running.values() if not p.is_done]
        reports = [p.report for p in self._running.values() if not p.report.closed]
        wait([*sentinels, *reports], max(0.0, timeout_s))
        failed = self._failed()
        if self._is_asked and not is_asked:
            raise KeyboardInterrupt
        if failed:
            raise self._cause()

    def _failed(self) -> dict[str, _Process]:
        """Return the processes that ended otherwise than they should, everything read that they said.

        One that has done its work may be killed too before what it handed on has left it: a queue's thread writes last.
        """
        ended = {role: held.process.exitcode for role, held in self._running.items()}
        for role, held in self._running.items():
            self._receive(role, held)
        return {r: p for r, p in self._running.items() if p.failure or ended[r] not in (None, 0 if p.is_done else None)}

    @contextmanager
    def explaining(self) -> Iterator[None]:
        """Surround what talks to the server: where it breaks off, say which process is the cause."""
        try:
            yield
        except (EOFError, OSError):
            until = time.monotonic() + 2 * PATIENCE_S
            while time.monotonic() < until:
                self.watch(until - time.monotonic())
            raise

    def _receive(self, role: str, held: _Process) -> None:
        """Read what a process said, until it says nothing more for now."""
        try:
            while not held.report.closed and held.report.poll():
                said = held.report.recv()
                if isinstance(said, LogRecord):
                    logging.getLogger(said.name).log(said.level, "%s", said.message)
                elif isinstance(said, Failure):
                    held.failure = said
                elif isinstance(said, Asked):
                    log.warning("the %s was sent %s", role, signal.Signals(said.number).name)
                    self._is_asked = True
                held.is_ready |= said == LISTENING
                held.is_done |= isinstance(said, Done)
        except (EOFError, OSError):
            held.report.close()

    def _cause(self) -> Exception:
        """Find which process failed first: one that was killed, else one that says more than that others are gone."""
        time.sleep(PATIENCE_S)
        failed = self._failed()
        for role, held in failed.items():
            if (number := -(held.process.exitcode or 0)) > 0:
                hint = "; the system does that where memory runs out" if number == signal.SIGKILL else ""
                return RunError(f"the {role} was killed by {signal.Signals(number).name}{hint}")
        silent = {role: held for role, held in failed.items() if held.failure is None}
        raised = {role: held.failure for role, held in failed.items() if held.failure is not None}
        if silent and all(failure.is_lost for failure in raised.values()):
            role, held = next(iter(silent.items()))
            status = f"exit status {held.process.exitcode}"
            return RunError(f"the {role} ended before its work was done, with {status}; its last words are above")
        return _error_of(raised)

    def end(self) -> None:
        """End whatever still runs: the workers first, so that the server knows all that they said."""
        self.end_workers()
        self._end([*self._running])

    def end_workers(self) -> None:
        """End all but the server."""
        self._end([role for role in self._running if role != Role.SERVER])

    def _end(self, roles: Iterable[str]) -> None:
        """Kill some processes; what they had logged by then is handed on."""
        ending = {role: self._running.pop(role) for role in roles}
        for held in ending.values():
            held.process.kill()
        until = time.monotonic() + END_S
        for role, held in ending.items():
            held.process.join(max(0.0, until - time.monotonic()))
            if held.process.exitcode is None:
                log.error("the %s (process %s) is killed and does not end", role, held.process.pid)
            else:
                held.process.close()
            self._receive(role, held)
            held.report.close()


def _error_of(raised: Mapping[str, Failure]) -> Exception:
    """Return what the first worker that failed by itself raised; a lost connection is the others' doing."""
    role = min(raised, key=lambda role: raised[role].is_lost)
    failure = raised[role]
    log.error("the %s failed:\n%s", role, failure.trace)
    error: XrdslamError = failure.error or RunError(f"the {role} failed: {failure.summary}")
    error.__cause__ = WorkerError(failure.trace)
    return error
