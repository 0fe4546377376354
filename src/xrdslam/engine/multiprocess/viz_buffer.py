"""`viz_buffer`: what a visualizer is told of, between two processes of which one may hang or die at any moment."""

import numpy as np

from xrdslam.engine.multiprocess.memory import SharedMemory
from xrdslam.engine.multiprocess.shared_event import SharedEvent

__all__ = ["NewestFrame"]

NEWEST, PUT, TAKEN, SHOWN = range(4)


class NewestFrame:
    """A queue with one place for a frame's index. Putting never waits: what was not taken yet is dropped, and counted.

    Each word has one writer and nothing has a lock. `fileno` makes it an object that `multiprocessing.connection.wait`
    waits for.
    """

    def __init__(self) -> None:
        self._memory = SharedMemory(4096)
        self._bell = SharedEvent()

    @property
    def _words(self) -> np.ndarray:
        words: np.ndarray = self._memory.bytes.numpy()[:32].view(np.int64)
        return words

    def fileno(self) -> int:
        """Return what is readable once somebody rang."""
        return self._bell.fileno()

    def put(self, index: int) -> None:
        """Put a frame, whose index is larger than all before, in the place of the last. The tracker's."""
        self._words[NEWEST] = index + 1
        self._words[PUT] += 1
        self.ring()

    def ring(self) -> None:
        """Let the reader look, whether there is a frame or not."""
        self._bell.set()

    def silence(self) -> None:
        """Hear of what rings from now on. The reader's, before it looks."""
        self._bell.clear()

    def take(self, index: int, is_shown: bool) -> None:
        """Say that this frame and those before are dealt with, and whether it was shown. The reader's."""
        self._words[TAKEN] = index + 1
        self._words[SHOWN] += is_shown

    def num_dropped(self, has_ended: bool) -> int:
        """Return how many frames were not shown; the newest may still be, unless the reader has ended."""
        waits = not has_ended and self._words[NEWEST] > self._words[TAKEN]
        return int(self._words[PUT] - self._words[SHOWN] - waits)
