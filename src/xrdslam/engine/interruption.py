"""Ending a run when it is told to: at a moment that loses nothing, or at once where it is asked again."""

import logging
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType

__all__ = ["GRACE_S", "Interruption"]

GRACE_S = 5.0
"""How long the frame under way may take to end."""
AGAIN_S = 0.5
"""Signals that follow one another faster are one: a scheduler signals a process and then its group."""
STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
log = logging.getLogger(__name__)


class Interruption:
    """While it is entered, SIGINT, SIGTERM and SIGHUP ask a run to end; the run says where it lets itself be ended.

    `check` raises KeyboardInterrupt where the run was asked. Inside `breaking` it is raised by itself, wherever the run
    is, once a grace is over. Asked again, the run ends at once, but for what is `shielded`: ending processes, closing
    files. Only the main thread can be sent signals; elsewhere nothing is changed. A signal that was ignored when the
    run began stays so, as a shell's background job ignores SIGINT and one under nohup SIGHUP.
    """

    def __init__(self, again_s: float = AGAIN_S) -> None:
        self._again_s = again_s
        self._is_asked = False
        self._heard_s = -1e9
        self._grace_s: float | None = None
        self._is_shielded = False
        self._before: dict[int, object] = {}

    def __enter__(self) -> "Interruption":
        if threading.current_thread() is threading.main_thread():
            for number in STOPPING:
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._ask)
            self._before[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._alarm)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]  # what signal.signal returned
        self._before.clear()

    def check(self) -> None:
        """Raise KeyboardInterrupt where the run was asked to end, once for each time."""
        if self._is_asked:
            self._is_asked = False
            raise KeyboardInterrupt

    @contextmanager
    def breaking(self, grace_s: float) -> Iterator[None]:
        """Let KeyboardInterrupt be raised inside, so long after the run is asked; with a grace of 0 at once."""
        before, self._grace_s = self._grace_s, grace_s
        try:
            if self._is_asked and grace_s == 0:
                self.check()
            yield
        finally:
            self._grace_s = before
            if self._before:
                signal.setitimer(signal.ITIMER_REAL, 0)

    @contextmanager
    def shielded(self) -> Iterator[None]:
        """Let nothing be raised inside; `check` still says afterwards that the run was asked."""
        before, self._is_shielded = self._is_shielded, True
        try:
            yield
        finally:
            self._is_shielded = before

    def _ask(self, _number: int, _frame: FrameType | None) -> None:
        was_asked, since_s = self._is_asked, time.monotonic() - self._heard_s
        self._heard_s = time.monotonic()
        if since_s < self._again_s:
            return
        self._is_asked = True
        if self._is_shielded:
            return
        if was_asked or self._grace_s == 0:
            self.check()
        if self._grace_s is None:
            log.warning("asked to end: as soon as what is under way is done, or now if asked again")
        else:
            signal.setitimer(signal.ITIMER_REAL, self._grace_s)
            log.warning("asked to end: after this frame, in %g s at the latest, or now if asked again", self._grace_s)

    def _alarm(self, _number: int, _frame: FrameType | None) -> None:
        if self._grace_s is not None and not self._is_shielded:
            self.check()
