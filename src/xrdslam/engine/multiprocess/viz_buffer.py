"""`viz_buffer`: what a visualizer is told of, between two processes of which one may hang or die at any moment."""

import os
from multiprocessing.reduction import DupFd
from typing import Any

import numpy as np

from xrdslam.engine.multiprocess.memory import SharedMemory

__all__ = ["NewestFrame"]

NEWEST, PUT, TAKEN, SHOWN = range(4)


class NewestFrame:
    """A queue with one place for a frame's index. Putting never waits: what was not taken yet is dropped, and counted.

    Each word has one writer and nothing has a lock: a stock Queue or Event would keep the tracker waiting for ever once
    a reader is killed while it sleeps. `fileno` makes it an object that `multiprocessing.connection.wait` waits for.
    """

    def __init__(self) -> None:
        self._open(SharedMemory(4096), os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK))

    def _open(self, memory: SharedMemory, bell: int) -> None:
        self._memory = memory
        self._words: np.ndarray = memory.bytes.numpy()[:32].view(np.int64)
        self._bell = bell

    def __reduce__(self) -> tuple[Any, ...]:
        return _received, (self._memory, DupFd(self._bell))

    def __del__(self) -> None:
        if hasattr(self, "_bell"):
            os.close(self._bell)

    def fileno(self) -> int:
        """Return what is readable once somebody rang."""
        return self._bell

    def put(self, index: int) -> None:
        """Put a frame, whose index is larger than all before, in the place of the last. The tracker's."""
        self._words[NEWEST] = index + 1
        self._words[PUT] += 1
        self.ring()

    def ring(self) -> None:
        """Let the reader look, whether there is a frame or not."""
        os.eventfd_write(self._bell, 1)

    def silence(self) -> None:
        """Hear of what rings from now on. The reader's, before it looks."""
        try:
            os.eventfd_read(self._bell)
        except BlockingIOError:
            return

    def take(self, index: int, is_shown: bool) -> None:
        """Say that this frame and those before are dealt with, and whether it was shown. The reader's."""
        self._words[TAKEN] = index + 1
        self._words[SHOWN] += is_shown

    def num_dropped(self, has_ended: bool) -> int:
        """Return how many frames were not shown; the newest may still be, unless the reader has ended."""
        waits = not has_ended and self._words[NEWEST] > self._words[TAKEN]
        return int(self._words[PUT] - self._words[SHOWN] - waits)


def _received(memory: SharedMemory, descriptor: Any) -> NewestFrame:  # noqa: ANN401  # multiprocessing names no type
    buffer = NewestFrame.__new__(NewestFrame)
    buffer._open(memory, descriptor.detach())
    return buffer
