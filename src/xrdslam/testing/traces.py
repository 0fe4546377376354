"""What a run leaves on a machine, told apart from whatever else runs there by a mark in its environment."""

import os
import secrets
from collections.abc import Iterator
from pathlib import Path

__all__ = ["Traces"]

MARK = "XRDSLAM_TRACES"
CACHES = ("torchinductor_",)
"""Folders in which a library keeps what all of a user's programs share."""


class Traces:
    """Finds the processes that were started with `environment`, and what they leave in memory and in a folder."""

    def __init__(self, folder: Path) -> None:
        """`folder` takes the place of the system's folder of temporary files; it is made."""
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self._mark = secrets.token_hex(8)
        self._names: set[str] = set()
        self._inodes: set[int] = set()

    @property
    def environment(self) -> dict[str, str]:
        """What the run's first process is to be started with, beside its own; its children inherit it."""
        return {MARK: self._mark, "TMPDIR": str(self.folder)}

    def processes(self) -> dict[int, str]:
        """Return the number and the name of every process that lives."""
        found = {}
        for pid in self._marked():
            try:
                found[pid] = Path(f"/proc/{pid}/comm").read_text().strip()
            except OSError:  # it has ended meanwhile
                continue
        return found

    def look(self) -> None:
        """Note the named memory that the processes have now: once they are dead nobody knows whose it was."""
        for pid in self._marked():
            try:
                maps = Path(f"/proc/{pid}/maps").read_text()
            except OSError:
                continue
            fields = (line.split(maxsplit=5) for line in maps.splitlines() if " /dev/shm/" in line)
            self._inodes |= {int(inode) for *_, inode, _ in fields}  # the path may be that of before it was renamed

    def note(self, name: str) -> None:
        """Note a semaphore's name that was heard of otherwise."""
        self._names.add(f"sem.{name.removeprefix('/')}")

    def left(self) -> list[str]:
        """Say what is left of it all."""
        processes = [f"process {pid} ({name})" for pid, name in self.processes().items()]
        memory = [entry.path for entry in os.scandir("/dev/shm") if self._is_known(entry)]
        files = [path for path in sorted(self.folder.iterdir()) if not path.name.startswith(CACHES)]
        return [*processes, *sorted(memory), *map(str, files)]

    def _is_known(self, entry: os.DirEntry[str]) -> bool:
        return entry.name in self._names or entry.inode() in self._inodes

    def _marked(self) -> Iterator[int]:
        mark = f"{MARK}={self._mark}".encode()
        for entry in Path("/proc").iterdir():
            try:
                if entry.name.isdigit() and mark in (entry / "environ").read_bytes().split(b"\0"):
                    yield int(entry.name)
            except OSError:  # another user's, or gone
                continue
