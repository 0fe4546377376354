"""Signals that a process is not to hear before it is ready for them."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["STOPPING", "deaf"]

STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def deaf() -> Iterator[None]:
    """Let processes that are started inside begin without hearing what asks a run to end: importing takes a while."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
