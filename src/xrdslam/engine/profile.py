"""What a run costs: time by stage, memory, map size."""

import csv
import io
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import torch

from xrdslam.engine.build import current_accelerator

__all__ = ["FrameCost", "Profile", "peak_rss_mib", "rss_mib"]


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
    is_lost: bool = False
    is_keyframe: bool = False


@dataclass
class Profile:
    """Costs of every frame, and of the run: wall clock from the first frame's reading to the end of `finish`.

    Frames per second is frames over that wall clock, for every method alike; evaluation and files are not in it.
    """

    frames: list[FrameCost] = field(default_factory=list)
    wall_s: float = 0.0
    cpu_s: float = 0.0

    @contextmanager
    def running(self) -> Iterator[None]:
        """Count what happens inside as the run."""
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            self.wall_s += time.perf_counter() - wall
            self.cpu_s += time.process_time() - cpu

    @contextmanager
    def stage(self, cost: FrameCost, name: str) -> Iterator[None]:
        """Add the time inside to a frame's `<name>_ms`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            _synchronise()
            key = f"{name}_ms"
            setattr(cost, key, getattr(cost, key) + 1e3 * (time.perf_counter() - start))

    def metrics(self) -> dict[str, float]:
        """Return the figures of `metrics.json`'s group `profile`."""
        tracked, mapped = [f for f in self.frames if f.index > 0], [f for f in self.frames if f.mapping_iterations]
        figures = {
            "frames": float(len(self.frames)),
            "wall_s": self.wall_s,
            "cpu_s": self.cpu_s,
            "frames_per_second": len(self.frames) / self.wall_s if self.wall_s else float("nan"),
            "reading_ms_per_frame": _mean([f.reading_ms for f in self.frames]),
            "tracking_ms_per_frame": _mean([f.tracking_ms for f in tracked]),
            "mapping_ms_per_frame": _mean([f.mapping_ms for f in self.frames]),
            "tracking_ms_per_iteration": _ratio(tracked, "tracking"),
            "mapping_ms_per_iteration": _ratio(mapped, "mapping"),
            "map_size": float(self.frames[-1].map_size) if self.frames else 0.0,
            "keyframes": float(sum(f.is_keyframe for f in self.frames)),
            "peak_rss_mib": peak_rss_mib(),
        }
        if torch.cuda.is_available():
            figures["peak_cuda_mib"] = torch.cuda.max_memory_allocated() / 2**20
        return figures

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


def _mean(values: list[float]) -> float:
    return sum(values) / len(values) if values else float("nan")


def _ratio(frames: list[FrameCost], stage: str) -> float:
    iterations = sum(getattr(f, f"{stage}_iterations") for f in frames)
    return sum(getattr(f, f"{stage}_ms") for f in frames) / iterations if iterations else float("nan")
