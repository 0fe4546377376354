"""Killing one process of a run at a chosen moment, and looking at what becomes of the run."""

import json
import os
import re
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import load_file

from xrdslam.testing.traces import Traces
from xrdslam.testing.victim import COMMAND, NUM_FRAMES

__all__ = ["LIMIT_S", "PHASES", "ROLES", "Outcome", "Victim", "kill", "phase_lengths"]

ROLES = ("parent", "server", "tracker", "mapper", "visualizer")
PHASES = ("start-up", "frames", "finishing", "conclusion")
"""Until the first frame is mapped; until the last one is; until the workers are gone; until the run's process is."""
LIMIT_S = 10.0
"""How long a run may last once one of its processes is killed."""
FRAME = re.compile(r": frame (\d+)/")
PATIENCE_S = 120.0
STARTED = ("server", "visualizer", "tracker", "mapper")
"""The order in which a parent starts its processes, for those that cannot be told by their name yet."""


@dataclass(frozen=True)
class Outcome:
    """What became of a run after the blow."""

    role: str
    phase: str
    """The one that the run was in, as far as it had said: the next may have begun."""
    is_struck: bool
    """Whether the process still lived."""
    seconds: float
    """From the blow until no process of the run was left."""
    exit_status: int
    last_line: str
    frames_done: int
    """As the run had said by then."""
    frames_saved: int
    has_map: bool
    has_metrics: bool
    left: list[str]
    """Processes, named memory, temporary files; unfinished files in the run's folder too where the parent lives on."""

    def faults(self) -> list[str]:
        """Say what is not as it should be."""
        parent, found = self.role == "parent", []
        if self.seconds > LIMIT_S:
            found.append(f"ended after {self.seconds:.1f} s")
        if self.left:
            found.append(f"left {', '.join(self.left)}")
        if parent or not self.is_struck:
            return found
        is_whole = self.frames_saved == NUM_FRAMES and self.has_map and self.has_metrics and self.exit_status == 0
        if self.role == "visualizer":
            return found if is_whole else [*found, f"exit status {self.exit_status}, {self.last_line!r}"]
        if self.frames_done and not (self.frames_saved and self.has_map and self.has_metrics):
            saved = f"{self.frames_saved} poses, {'a' if self.has_map else 'no'} map, "
            found.append(f"of {self.frames_done} frames saved {saved}{'' if self.has_metrics else 'no '}metrics")
        if self.frames_saved < self.frames_done:
            found.append(f"saved {self.frames_saved} poses of {self.frames_done}")
        if not is_whole and (self.exit_status != 1 or f"the {self.role} was killed by SIGKILL" not in self.last_line):
            found.append(f"exit status {self.exit_status}, {self.last_line!r}")
        return found


class Victim:
    """A run in a process group of its own, and what it says."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.run_dir = folder / "run"
        self.traces = Traces(folder / "temporary")
        self.lines: list[str] = []
        self.is_watched = "viewer" in arguments
        self._seen: set[str] = set()
        self.began_s = time.monotonic()
        command = [*COMMAND, "run", str(self.run_dir), *arguments]
        environment = {**os.environ, **self.traces.environment}
        self.process = subprocess.Popen(
            command, stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True, preexec_fn=_listening
        )
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        with self.process.stderr as lines:
            self.lines.extend(line.rstrip() for line in lines)

    @property
    def frames_done(self) -> int:
        """How many frames the run has said to be mapped."""
        return max((int(found[1]) for line in list(self.lines) if (found := FRAME.search(line))), default=0)

    @property
    def phase(self) -> str:
        """Say which phase the run is in."""
        if (self.run_dir / "trajectory" / "online.txt").is_file():
            return "conclusion"
        done = self.frames_done
        return "start-up" if done == 0 else "frames" if done < NUM_FRAMES else "finishing"

    def wait_for(self, is_due: Callable[[], bool]) -> bool:
        """Wait until something holds; false where the run ended before."""
        until = time.monotonic() + PATIENCE_S
        while not is_due():
            if self.process.poll() is not None or time.monotonic() > until:
                return is_due()
            time.sleep(0.002)
        return True

    def reach(self, phase: str, role: str) -> bool:
        """Wait until a phase begins, the first of them with the role's process."""
        begins: dict[str, Callable[[], bool]] = {
            "start-up": lambda: self.pid(role) is not None,
            "frames": lambda: self.frames_done >= 1,
            "finishing": lambda: self.frames_done >= NUM_FRAMES,
            "conclusion": (self.run_dir / "trajectory" / "online.txt").is_file,
        }
        return self.wait_for(begins[phase])

    def pid(self, role: str) -> int | None:
        """Return the number of a role's process, None where there is none."""
        if role == "parent":
            return self.process.pid
        try:
            numbers = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        except OSError:
            return None
        started = [int(number) for number in numbers if _is_spawned(int(number))]
        names = {pid: _name(pid) for pid in started}
        roles = {each: pid for each in STARTED for pid, name in names.items() if name == f"xrdslam-{each}"[:15]}
        self._seen |= roles.keys()
        unnamed = [pid for pid, name in names.items() if not name.startswith("xrdslam-")]
        awaited = [each for each in STARTED if each not in self._seen and (self.is_watched or each != "visualizer")]
        return {**dict(zip(awaited, unnamed, strict=False)), **roles}.get(role)

    def end(self) -> float:
        """Wait until no process of the run is left; return when that was."""
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until and (self.process.poll() is None or self.traces.processes()):
            time.sleep(0.01)
        ended_s = time.monotonic()
        for pid in self.traces.processes():
            os.kill(pid, signal.SIGKILL)
        self._reader.join(PATIENCE_S)
        return ended_s


def _listening() -> None:
    """Hear what a test that runs in the background of a shell was made deaf to."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def _is_spawned(pid: int) -> bool:
    try:
        return b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


def _name(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/comm").read_text().strip()
    except OSError:
        return ""


@contextmanager
def _running(role: str, folder: Path) -> Iterator[Victim]:
    victim = Victim(folder, "multiprocess", *(["viewer"] if role == "visualizer" else []))
    try:
        yield victim
    finally:
        victim.end()


def phase_lengths(role: str, folder: Path) -> dict[str, float]:
    """Carry out a run that nobody disturbs; return how long each phase takes [s], the first from the role's start."""
    with _running(role, folder) as victim:
        times = []
        for phase in PHASES:
            assert victim.reach(phase, role), f"the run says:\n{victim.lines}"
            times.append(time.monotonic())
        times.append(victim.end())
    assert victim.process.returncode == 0, f"the run says:\n{victim.lines}"
    return {phase: end - begin for phase, (begin, end) in zip(PHASES, pairwise(times), strict=True)}


def kill(role: str, phase: str, share: float, lengths: Mapping[str, float], folder: Path) -> Outcome:
    """Carry out a run and kill one of its processes when a share of a phase is over; say what came of it."""
    with _running(role, folder) as victim:
        reached = victim.reach(phase, role)
        assert reached or victim.process.poll() is not None, f"{phase} does not begin:\n{victim.lines}"
        time.sleep(share * lengths[phase])
        victim.traces.look()
        pid, done, phase = victim.pid(role), victim.frames_done, victim.phase
        struck_s = time.monotonic()
        is_struck = pid is not None and victim.process.poll() is None
        if is_struck and pid is not None:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                is_struck = False
        ended_s = victim.end()
    run_dir = victim.run_dir
    left = victim.traces.left()
    if role != "parent":
        left += [str(path) for path in run_dir.rglob("*.part")]
    last = next((line for line in reversed(victim.lines) if line), "")
    poses, has_map, has_metrics = saved_in(run_dir)
    seconds = ended_s - struck_s
    status = victim.process.returncode
    return Outcome(role, phase, is_struck, seconds, status, last, done, poses, has_map, has_metrics, left)


def saved_in(run_dir: Path) -> tuple[int, bool, bool]:
    """Return how many poses a run saved, and whether there is a whole map, finite, and a file of metrics."""
    path = run_dir / "trajectory" / "online.txt"
    poses = len(path.read_text().splitlines()) - 1 if path.is_file() else 0
    try:
        tensors = load_file(run_dir / "map" / "map.safetensors")
        has_map = bool(tensors) and all(bool(tensor.isfinite().all()) for tensor in tensors.values())
    except (SafetensorError, OSError):
        has_map = False
    try:
        has_metrics = bool(json.loads((run_dir / "metrics.json").read_text()))
    except (OSError, ValueError):
        has_metrics = False
    return poses, has_map, has_metrics
