"""What a slow watcher is given: the newest, never a queue; and how much time may go into preparing it."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

__all__ = ["Budget", "Latest"]

Item = TypeVar("Item")


class Latest(Generic[Item]):
    """A slot between two threads. Putting never waits: what was not taken yet is dropped, and counted."""

    def __init__(self) -> None:
        self.dropped = 0
        self._item: Item | None = None
        self._changed = threading.Condition()
        self._is_closed = False

    def put(self, item: Item) -> None:
        """Put the newest item in the place of the last."""
        with self._changed:
            self.dropped += self._item is not None
            self._item = item
            self._changed.notify()

    def take(self) -> Item | None:
        """Wait for an item and take it; None once the slot is closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._item is not None or self._is_closed)
            item, self._item = self._item, None
            return item

    def close(self) -> None:
        """Let whoever waits go; what is in the slot can still be taken."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()


class Budget:
    """Allows work for a share of the time that passes; what one piece took too much is made up for by waiting."""

    def __init__(self, share: float, clock: Callable[[], float] = time.perf_counter) -> None:
        self.spent_s = 0.0
        self._share = share
        self._clock = clock
        self._start = clock()

    @property
    def is_open(self) -> bool:
        """Say whether there is time to spend."""
        return self.spent_s <= self._share * (self._clock() - self._start)

    @contextmanager
    def spending(self) -> Iterator[None]:
        """Count what happens inside."""
        begun = self._clock()
        try:
            yield
        finally:
            self.spent_s += self._clock() - begun
