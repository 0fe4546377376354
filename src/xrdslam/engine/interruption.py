"""Ending a run when it is told to: after the frame under way, so that it can be resumed exactly there."""

import logging
import signal
import threading
from types import FrameType, TracebackType

__all__ = ["GRACE_S", "Interruption"]

GRACE_S = 5.0
"""How long the frame under way may take to end."""
log = logging.getLogger(__name__)


class Interruption:
    """While it is entered, SIGINT and SIGTERM ask a run to end; `check`, between frames, raises KeyboardInterrupt.

    A second signal, or a frame that takes longer than the grace, raises at once, wherever the run is. Only the main
    thread can be sent signals; elsewhere nothing is changed.
    """

    def __init__(self, grace_s: float = GRACE_S) -> None:
        self.grace_s = grace_s
        self.is_asked = False
        self._before: dict[int, object] = {}

    def __enter__(self) -> "Interruption":
        if threading.current_thread() is threading.main_thread():
            for number, handler in ((signal.SIGTERM, self._ask), (signal.SIGALRM, self._end)):
                self._before[number] = signal.signal(number, handler)
            if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # a shell's background job ignores it
                self._before[signal.SIGINT] = signal.signal(signal.SIGINT, self._ask)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._before:
            signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]  # what signal.signal returned
        self._before.clear()

    def check(self) -> None:
        """Raise KeyboardInterrupt where the run was asked to end."""
        if self.is_asked:
            raise KeyboardInterrupt

    def _ask(self, _number: int, _frame: FrameType | None) -> None:
        if self.is_asked:
            raise KeyboardInterrupt
        self.is_asked = True
        signal.setitimer(signal.ITIMER_REAL, self.grace_s)
        log.warning("asked to end: after this frame, in %g s at the latest, or now if asked again", self.grace_s)

    def _end(self, _number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt
