"""Everything that the processes of a run share."""

import secrets
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.context import SpawnContext
from multiprocessing.queues import Queue

import numpy as np

from xrdslam.core.dataset import Dataset
from xrdslam.core.shared_algorithm import AlgorithmManager, Steps
from xrdslam.engine.multiprocess.frame_ring import FrameRing
from xrdslam.engine.multiprocess.memory import SharedMemory
from xrdslam.engine.multiprocess.shared_event import SharedEvent
from xrdslam.engine.multiprocess.shared_state import SharedState
from xrdslam.engine.multiprocess.viz_buffer import NewestFrame

__all__ = ["Channels", "Counters", "wait_until"]


class Counters:
    """How far tracking and mapping are, readable without asking anybody; each has one writer."""

    def __init__(self) -> None:
        self._memory = SharedMemory(4096)

    def _word(self, position: int) -> np.ndarray:
        return self._memory.bytes.numpy()[8 * position : 8 * position + 8].view(np.int64)

    @property
    def is_up(self) -> bool:
        """Whether the mapper waits for its first frame."""
        return bool(self._word(2)[0])

    @is_up.setter
    def is_up(self, value: bool) -> None:
        self._word(2)[0] = value

    @property
    def may_begin(self) -> bool:
        """Whether the parent waits for nobody else, such as a viewer that opens its page."""
        return bool(self._word(3)[0])

    @may_begin.setter
    def may_begin(self, value: bool) -> None:
        self._word(3)[0] = value

    @property
    def saved(self) -> int:
        """Frames that had been handed to the mapper when the latest checkpoint was written."""
        return int(self._word(4)[0])

    @saved.setter
    def saved(self, count: int) -> None:
        self._word(4)[0] = count

    @property
    def is_asked(self) -> bool:
        """Whether the parent asks the tracker to pause after the frame under way."""
        return bool(self._word(5)[0])

    @is_asked.setter
    def is_asked(self, value: bool) -> None:
        self._word(5)[0] = value

    @property
    def tracked(self) -> int:
        """Frames handed to the mapper."""
        return int(self._word(0)[0])

    @tracked.setter
    def tracked(self, count: int) -> None:
        self._word(0)[0] = count

    @property
    def mapped(self) -> int:
        """Frames that the mapper is done with."""
        return int(self._word(1)[0])

    @mapped.setter
    def mapped(self, count: int) -> None:
        self._word(1)[0] = count


@dataclass
class Channels:
    """Frames, maps and counters in shared memory; queues of indexes and versions; events that say when to look.

    The buffers' names are those of the published framework; what goes through them is not images but where they lie.
    """

    address: str
    key: bytes
    frames: FrameRing
    map: SharedState
    """Published by the mapper."""
    changes: SharedState
    """Published by the tracker: what tracking changed in the map."""
    tracking: SharedState
    """The tracker's own state, published for a checkpoint, and by the parent where a run is taken up."""
    mapping: SharedState
    """The mapper's."""
    counters: Counters
    event_begin: SharedEvent
    """The server listens, and where the run is taken up, its first step is there."""
    event_ready: SharedEvent
    """The tracker handed a frame over."""
    event_processed: SharedEvent
    """The mapper is done with a frame."""
    map_buffer: "Queue[int]"
    """Tracker to mapper: the index of each frame in order, then -1."""
    viz_buffer: NewestFrame
    """Tracker to visualizer: the index of the newest frame; the mapper rings when it is done with one."""

    @classmethod
    def build(cls, context: SpawnContext, dataset: Dataset) -> "Channels":
        """Make all of them; only semaphores have a name in a file system, for the processes to open when they start."""
        return cls(
            address=f"\0xrdslam-{secrets.token_hex(16)}",  # Linux's abstract names: a socket without a file
            key=secrets.token_bytes(32),
            frames=FrameRing(dataset),
            map=SharedState(),
            changes=SharedState(),
            tracking=SharedState(),
            mapping=SharedState(),
            counters=Counters(),
            event_begin=SharedEvent(),
            event_ready=SharedEvent(),
            event_processed=SharedEvent(),
            map_buffer=context.Queue(),
            viz_buffer=NewestFrame(),
        )

    def close(self) -> None:
        """Drop what has a name while it lives: the semaphores, in /dev/shm. Frames and maps live as long as views."""
        del self.map_buffer

    def algorithm(self) -> Steps:
        """Connect to the shared algorithm; what is returned is a proxy of it."""
        manager = AlgorithmManager(self.address, self.key)
        manager.connect()
        proxy: Steps = manager.algorithm()
        return proxy


def wait_until(is_due: Callable[[], bool], event: SharedEvent) -> None:
    """Wait until something holds; `event` says when to look. Who would set it but died is the parent's to notice."""
    while not is_due():
        event.wait()
        event.clear()  # before looking again: what is set after this is seen by the next wait
