"""What a run costs: time by stage, memory, map size."""

import csv
import io
import math
import resource
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any

import torch

from xrdslam.engine.build import current_accelerator

__all__ = ["PROTOCOL", "FrameCost", "Profile", "peak_rss_mib", "rss_mib"]

PROTOCOL = {
    "start": "from the engine's start to the first frame's reading: what processes take to be there",
    "wall": "from the first frame's reading to the end of the last refinement; files and evaluation excluded",
    "cpu": "processor time of all threads of all processes of the run, in the same span",
    "stage_cpu": "processor time of the process that ran the stage, its threads together, while the stage ran",
    "frames_per_second": "all frames over the wall time of the whole run",
    "tracking": "all frames but the first, whose pose is given",
    "mapping": "all frames, those that the method does not map among them",
    "viewer_drops": "frames that a viewer did not see: it was busy with an earlier one, failed on it, or had ended",
    "peak_rss": "largest resident memory, summed over the run's processes; what they share counts in each",
}
"""What the figures of a run's cost mean, whichever engine carried it out."""


@dataclass
class FrameCost:
    """The cost of one frame."""

    index: int
    reading_ms: float = 0.0
    tracking_ms: float = 0.0
    mapping_ms: float = 0.0
    tracking_iterations: int = 0
    mapping_iterations: int = 0
    map_size: int = 0
    rss_mib: float = 0.0
    tracking_cpu_ms: float = 0.0
    mapping_cpu_ms: float = 0.0
    is_lost: bool = False
    is_keyframe: bool = False


@dataclass
class Profile:
    """Costs of every frame, and of the run: wall clock from the first frame's reading to the end of `finish`.

    Frames per second is frames over that wall clock, for every method and engine alike; evaluation and files are not in
    it. An engine with processes of its own adds what each of them cost (`add_process`).
    """

    frames: list[FrameCost] = field(default_factory=list)
    wall_s: float = 0.0
    cpu_s: float = 0.0
    start_s: float = 0.0
    """From the engine's start to the first frame's reading: the time that processes take to be there."""
    finish_wall_s: float = 0.0
    finish_cpu_s: float = 0.0
    peak_rss_mib: float = 0.0
    peak_cuda_mib: float = 0.0
    earlier_peak_rss_mib: float = 0.0
    """The peak of the processes that carried the run out before it was resumed."""
    earlier_peak_cuda_mib: float = 0.0
    viewer_drops: int | None = None
    """Frames that a viewer in a process of its own was not shown; None without one."""

    def __post_init__(self) -> None:
        self._since: tuple[float, float] | None = None

    @contextmanager
    def running(self) -> Iterator[None]:
        """Count what happens inside as the run."""
        if torch.cuda.is_available():
            torch.cuda.reset_peak_memory_stats()
        self._since = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            self._stop()
            self.add_process(0.0, peak_rss_mib(), peak_cuda_mib())

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Do not count what happens inside; the sums hold everything up to here meanwhile."""
        is_running = self._since is not None
        self._stop()
        try:
            yield
        finally:
            self._since = (time.perf_counter(), time.process_time()) if is_running else None

    def _stop(self) -> None:
        if self._since is not None:
            self.wall_s += time.perf_counter() - self._since[0]
            self.cpu_s += time.process_time() - self._since[1]
        self._since = None

    def add_process(self, cpu_s: float, peak_rss_mib: float, peak_cuda_mib: float = 0.0) -> None:
        """Add what one process of the run cost."""
        self.cpu_s += cpu_s
        self.peak_rss_mib += peak_rss_mib
        self.peak_cuda_mib += peak_cuda_mib

    def state(self) -> dict[str, Any]:
        """Return everything as plain data, for checkpoints; peaks up to here count as those of earlier processes."""
        rss, cuda = (self.peak_rss_mib or peak_rss_mib()), (self.peak_cuda_mib or peak_cuda_mib())
        earlier = {
            "earlier_peak_rss_mib": max(self.earlier_peak_rss_mib, rss),
            "earlier_peak_cuda_mib": max(self.earlier_peak_cuda_mib, cuda),
        }
        return asdict(self) | earlier | {"peak_rss_mib": 0.0, "peak_cuda_mib": 0.0}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over what `state` returned."""
        for key, value in state.items():
            setattr(self, key, [FrameCost(**row) for row in value] if key == "frames" else value)

    @contextmanager
    def stage(self, cost: FrameCost, name: str) -> Iterator[None]:
        """Add the time inside to a frame's `<name>_ms` and `<name>_cpu_ms`."""
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            _synchronise()
            for key, spent in (
                (f"{name}_ms", time.perf_counter() - wall),
                (f"{name}_cpu_ms", time.process_time() - cpu),
            ):
                setattr(cost, key, getattr(cost, key) + 1e3 * spent)

    @contextmanager
    def finishing(self) -> Iterator[None]:
        """Count what happens inside as the refinement after the last frame."""
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            _synchronise()
            self.finish_wall_s += time.perf_counter() - wall
            self.finish_cpu_s += time.process_time() - cpu

    def metrics(self) -> dict[str, float]:
        """Return the figures of `metrics.json`'s group `profile`; NaN where there is nothing to divide by."""
        tracked, mapped = self.frames[1:], [f for f in self.frames if f.mapping_iterations]
        figures = {
            "frames": float(len(self.frames)),
            "start_s": self.start_s,
            "wall_s": self.wall_s,
            "cpu_s": self.cpu_s,
            "frames_per_second": _over(len(self.frames), self.wall_s),
            "tracking_frames_per_second": _over(len(tracked), _seconds(tracked, "tracking_ms")),
            "mapping_frames_per_second": _over(len(self.frames), _seconds(self.frames, "mapping_ms")),
            "reading_ms_per_frame": 1e3 * _over(_seconds(self.frames, "reading_ms"), len(self.frames)),
            "tracking_ms_per_frame": 1e3 * _over(_seconds(tracked, "tracking_ms"), len(tracked)),
            "mapping_ms_per_frame": 1e3 * _over(_seconds(self.frames, "mapping_ms"), len(self.frames)),
            "tracking_wall_s": _seconds(self.frames, "tracking_ms"),
            "tracking_cpu_s": _seconds(self.frames, "tracking_cpu_ms"),
            "mapping_wall_s": _seconds(self.frames, "mapping_ms"),
            "mapping_cpu_s": _seconds(self.frames, "mapping_cpu_ms"),
            "finish_wall_s": self.finish_wall_s,
            "finish_cpu_s": self.finish_cpu_s,
            "tracking_iterations": float(sum(f.tracking_iterations for f in self.frames)),
            "mapping_iterations": float(sum(f.mapping_iterations for f in self.frames)),
            "tracking_ms_per_iteration": _per_iteration(tracked, "tracking"),
            "mapping_ms_per_iteration": _per_iteration(mapped, "mapping"),
            "map_size": float(self.frames[-1].map_size) if self.frames else 0.0,
            "keyframes": float(sum(f.is_keyframe for f in self.frames)),
            "peak_rss_mib": max(self.earlier_peak_rss_mib, self.peak_rss_mib),
        }
        if self.viewer_drops is not None:
            figures["viewer_drops"] = float(self.viewer_drops)
        cuda = max(self.earlier_peak_cuda_mib, self.peak_cuda_mib)
        return figures | ({"peak_cuda_mib": cuda} if torch.cuda.is_available() else {})

    def csv(self) -> str:
        """Return `timing.csv`: a row a frame."""
        text = io.StringIO()
        writer = csv.DictWriter(text, list(FrameCost.__dataclass_fields__))
        writer.writeheader()
        for frame in self.frames:
            row = {k: round(v, 3) if isinstance(v, float) else v for k, v in vars(frame).items()}
            writer.writerow({k: int(v) if isinstance(v, bool) else v for k, v in row.items()})
        return text.getvalue()


def peak_rss_mib() -> float:
    """Return the largest resident memory that this process ever had [MiB].

    Linux hands getrusage's figure on from whoever started the process, so its own high-water mark is read there.
    """
    try:
        with open("/proc/self/status") as status:
            return next(int(line.split()[1]) for line in status if line.startswith("VmHWM:")) / 2**10
    except (OSError, StopIteration):
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / 2**20 if sys.platform == "darwin" else peak / 2**10


def peak_cuda_mib() -> float:
    """Return the largest memory of CUDA tensors since the run began [MiB]."""
    return torch.cuda.max_memory_allocated() / 2**20 if torch.cuda.is_available() else 0.0


def rss_mib() -> float:
    """Return the resident memory now [MiB]; where the system does not say, the peak."""
    try:
        with open("/proc/self/statm") as statm:
            return int(statm.read().split()[1]) * resource.getpagesize() / 2**20
    except OSError:
        return peak_rss_mib()


def _synchronise() -> None:
    if current_accelerator() is not None:
        torch.accelerator.synchronize()


def _seconds(frames: list[FrameCost], key: str) -> float:
    return 1e-3 * math.fsum(getattr(f, key) for f in frames)


def _over(amount: float | int, whole: float | int) -> float:
    return amount / whole if whole else float("nan")


def _per_iteration(frames: list[FrameCost], stage: str) -> float:
    """Return milliseconds of an iteration."""
    return 1e3 * _over(_seconds(frames, f"{stage}_ms"), sum(getattr(f, f"{stage}_iterations") for f in frames))
