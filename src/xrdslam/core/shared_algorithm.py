"""The algorithm as its processes share it: one instance in a server of its own. Imports nothing heavy."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.managers import BaseManager
from typing import Any, Protocol, runtime_checkable

__all__ = ["LISTENING", "AlgorithmManager", "Entry", "SharedAlgorithm", "Steps", "serve"]

LISTENING = "listening"
"""What the server says once it can be connected to."""


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

    def since(self, number: int) -> list[Entry]:
        """Return the steps from a number on."""


class SharedAlgorithm:
    """The one order in which steps happened, hence the one trajectory: every process replays what the others did.

    Called for control alone: a step is some kilobytes, images and maps go through shared memory.
    """

    def __init__(self) -> None:
        self._entries: list[Entry] = []
        self._lock = threading.Lock()

    def record(self, entry: Entry) -> int:
        """Append a step; return its number."""
        with self._lock:
            self._entries.append(entry)
            return len(self._entries) - 1

    def since(self, number: int) -> list[Entry]:
        """Return the steps from a number on."""
        with self._lock:
            return self._entries[number:]


class AlgorithmManager(BaseManager):
    """Serves the one SharedAlgorithm of a run, or connects to who serves it."""

    algorithm: Callable[[], Any]
    """Return a proxy of the shared instance."""


AlgorithmManager.register("algorithm", exposed=("record", "since"))


class _Server(AlgorithmManager):
    pass


def serve(address: str, key: bytes, say: Callable[[object], None]) -> None:
    """Be the server: say when it listens, then serve until the process is ended."""
    shared = SharedAlgorithm()
    _Server.register("algorithm", callable=lambda: shared, exposed=("record", "since"))
    server = _Server(address, key).get_server()
    say(LISTENING)
    server.serve_forever()
