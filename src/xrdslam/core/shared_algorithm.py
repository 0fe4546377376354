"""The algorithm as its processes share it: one instance in a server of its own. Imports nothing heavy."""

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from multiprocessing.managers import BaseManager
from typing import Any, Protocol, runtime_checkable

__all__ = ["LISTENING", "AlgorithmManager", "Entry", "SharedAlgorithm", "Steps", "serve"]

LISTENING = "listening"
"""What the server says once it can be connected to."""
EXPOSED = ("record", "since", "forget")


@dataclass(frozen=True)
class Entry:
    """One step of the run, as its process reported it."""

    kind: str
    """`tracked`, `mapped` or `finished`."""
    index: int
    """The frame's."""
    payload: bytes
    """What the step changed, readable for those who have the method's classes."""


@runtime_checkable
class Steps(Protocol):
    """What the server offers, and a proxy of it."""

    def record(self, entry: Entry) -> int:
        """Append a step; return its number."""

    def since(self, number: int, reader: str) -> list[Entry]:
        """Return the steps from a number on to a reader that knows those before."""

    def forget(self, reader: str) -> None:
        """Hear that a reader has ended."""


class SharedAlgorithm:
    """The one order in which steps happened, hence the one trajectory: every process replays what the others did.

    Called for control alone: a step is some kilobytes, images and maps go through shared memory. What every reader
    knows is dropped, so that it does not grow with the run.
    """

    def __init__(self, readers: Iterable[str]) -> None:
        self._entries: list[Entry] = []
        self._first = 0
        """The number of the first that is kept."""
        self._known = dict.fromkeys(readers, 0)
        self._lock = threading.Lock()

    def record(self, entry: Entry) -> int:
        """Append a step; return its number."""
        with self._lock:
            self._entries.append(entry)
            return self._first + len(self._entries) - 1

    def since(self, number: int, reader: str) -> list[Entry]:
        """Return the steps from a number on to a reader that knows those before."""
        with self._lock:
            if number < self._first:
                raise LookupError(f"{reader} asks for step {number}; those before {self._first} are dropped")
            if reader in self._known:
                self._known[reader] = number
                self._drop()
            return self._entries[number - self._first :]

    def forget(self, reader: str) -> None:
        """Hear that a reader has ended."""
        with self._lock:
            self._known.pop(reader, None)
            self._drop()

    def _drop(self) -> None:
        known = min(self._known.values(), default=self._first)
        del self._entries[: known - self._first]
        self._first = known


class AlgorithmManager(BaseManager):
    """Serves the one SharedAlgorithm of a run, or connects to who serves it."""

    algorithm: Callable[[], Any]
    """Return a proxy of the shared instance."""


AlgorithmManager.register("algorithm", exposed=EXPOSED)


class _Server(AlgorithmManager):
    pass


def serve(address: str, key: bytes, readers: Iterable[str], say: Callable[[object], None]) -> None:
    """Be the server: say when it listens, then serve until the process is ended."""
    shared = SharedAlgorithm(readers)
    _Server.register("algorithm", callable=lambda: shared, exposed=EXPOSED)
    server = _Server(address, key).get_server()
    say(LISTENING)
    server.serve_forever()
