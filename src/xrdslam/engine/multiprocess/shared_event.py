"""An event between processes of which any may be killed at any moment."""

import os
import select
from contextlib import suppress
from multiprocessing.reduction import DupFd
from typing import Any

__all__ = ["SharedEvent"]


class SharedEvent:
    """Set in one process, waited for in another, by the kernel's own counter (eventfd): no lock, no name in a folder.

    The stock Event lets who sets it wait until every sleeper has woken up, which one that was killed never does.
    `fileno` makes it an object that `multiprocessing.connection.wait` waits for.
    """

    def __init__(self) -> None:
        self._descriptor = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)

    def __reduce__(self) -> tuple[Any, ...]:
        return _received, (DupFd(self._descriptor),)

    def __del__(self) -> None:
        if hasattr(self, "_descriptor"):
            os.close(self._descriptor)

    def fileno(self) -> int:
        """Return what is readable while it is set."""
        return self._descriptor

    def set(self) -> None:
        """Set it; never waits."""
        os.eventfd_write(self._descriptor, 1)

    def is_set(self) -> bool:
        """Say whether it is set."""
        return self.wait(0.0)

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until it is set, or so long; say whether it is."""
        poll = select.poll()
        poll.register(self._descriptor, select.POLLIN)
        return bool(poll.poll(None if timeout_s is None else 1e3 * timeout_s))

    def clear(self) -> None:
        """Take it back."""
        with suppress(BlockingIOError):  # it was not set
            os.eventfd_read(self._descriptor)


def _received(descriptor: Any) -> SharedEvent:  # noqa: ANN401  # multiprocessing names no type for it
    event = SharedEvent.__new__(SharedEvent)
    event._descriptor = descriptor.detach()
    return event
