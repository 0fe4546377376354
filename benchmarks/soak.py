"""`python -m benchmarks.soak [--out FOLDER] [setting=value ...]`: does a long run creep?

2000 frames of the synthetic room with the fast preset, unless the settings say otherwise. Memory and time may grow with
what a run holds, its map and its keyframes; what grows beside them creeps. Slopes are printed, and drawn with the
curves into `soak.png` beside the run's own files. The exit status is 1 if memory creeps by more than `--allowed`.
"""

import argparse
import csv
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

matplotlib.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["Soak", "read_timing", "rolling_median"]

SETTINGS = (
    "algo=splatam", "preset=fast", "dataset=synthetic/room0", "dataset.num_frames=2000", "dataset.width=120",
    "dataset.height=90", "evaluation.every=200", "engine.progress=false", "report=false",
)  # fmt: skip
WARM_UP = 200
"""Frames that slopes leave out: kernels are compiled, allocators fill."""
WINDOW = 50
"""Frames of a rolling median: a single frame may be one that is not mapped."""

Column = NDArray[np.float64]


@dataclass(frozen=True)
class Soak:
    """A run, frame by frame."""

    frame: Column
    rss_mib: Column
    map_size: Column
    keyframes: Column
    """How many there are."""
    tracking_ms: Column
    """Of the processor, all threads together: what else the machine does is not in it."""
    mapping_ms: Column
    """NaN of frames that are not mapped."""
    keyframe_mib: float
    """Colour and depth of one of them, float32."""

    def slope(self, values: Column) -> float:
        """Return the growth of something over 1000 frames, after the warm-up; the line of least squares."""
        late = self.frame >= WARM_UP
        return 1000 * float(np.polyfit(self.frame[late], values[late], 1)[0])

    def creep(self, values: Column) -> tuple[float, float]:
        """Return what a primitive brings, and what 1000 frames bring beside the map.

        Least squares of values = a + b map + c frame with b >= 0 over the frames after the warm-up.
        """
        late = self.frame >= WARM_UP
        if np.ptp(self.map_size[late]) == 0:  # a map of fixed size explains nothing
            return 0.0, self.slope(values)
        columns = np.stack([np.ones(late.sum()), self.map_size[late], self.frame[late]], 1)
        scale = np.abs(columns).max(0)
        found = lsq_linear(columns / scale, values[late], ([-np.inf, 0, -np.inf], np.inf)).x / scale
        return float(found[1]), 1000 * float(found[2])

    def besides_keyframes(self) -> Column:
        """Return the memory [MiB] without the images of the keyframes, whose size is known."""
        return self.rss_mib - self.keyframe_mib * self.keyframes

    def lines(self) -> list[str]:
        """Say what was found, each figure with its unit."""
        lines = [
            f"{len(self.frame)} frames, {self.keyframes[-1]:.0f} keyframes, map of {self.map_size[-1]:.0f} primitives",
            f"memory {self.rss_mib[0]:.0f} MiB after the first frame, {self._late(self.rss_mib)}",
            f"tracking {self._late(self.tracking_ms, 'ms')}; mapping {self._late(self.mapping_ms, 'ms')}",
        ]
        per_primitive, rest = self.creep(self.besides_keyframes())
        lines.append(
            f"memory: {2**10 * self.keyframe_mib:.0f} KiB of images a keyframe, "
            f"{2**20 * per_primitive:.0f} B a primitive, {rest:+.2f} MiB per 1000 frames beside them"
        )
        for name, values in (("tracking", self.tracking_ms), ("mapping", self.mapping_ms)):
            per_primitive, rest = self.creep(rolling_median(values))
            lines.append(
                f"{name}: {1000 * per_primitive:.2f} ms per 1000 primitives, {rest:+.2f} ms per 1000 frames beside them"
            )
        return lines

    def _late(self, values: Column, unit: str = "MiB") -> str:
        first, last = np.nanmedian(values[WARM_UP : WARM_UP + 100]), np.nanmedian(values[-100:])
        return (
            f"{first:.0f} {unit} at frame {WARM_UP}, {last:.0f} {unit} at the end, "
            f"{self.slope(rolling_median(values)):+.2f} {unit} per 1000 frames"
        )

    def draw(self, path: Path, title: str) -> None:
        """Draw memory, map size and time over the frames."""
        figure, axes = plt.subplots(3, 1, figsize=(9, 8), sharex=True, constrained_layout=True)
        axes[0].set_title(title, loc="left")
        axes[0].plot(self.frame, self.rss_mib, color="tab:blue")
        axes[0].set_ylabel("resident memory [MiB]")
        axes[1].plot(self.frame, self.map_size / 1000, color="tab:green")
        axes[1].set_ylabel("map [1000 primitives]")
        twin = axes[1].twinx()
        twin.plot(self.frame, self.keyframes, color="tab:gray", linestyle="--")
        twin.set_ylabel("keyframes (dashed)")
        for name, values in (("tracking", self.tracking_ms), ("mapping", self.mapping_ms)):
            axes[2].plot(self.frame, rolling_median(values), label=f"{name}, median of {WINDOW}")
        axes[2].set_ylabel("processor time per frame [ms]")
        axes[2].set_ylim(bottom=0)
        axes[2].set_xlabel("frame")
        axes[2].legend(loc="upper left")
        for each in axes:
            each.grid(alpha=0.3)
        figure.savefig(path, dpi=110)
        plt.close(figure)


def rolling_median(values: Column, window: int = WINDOW) -> Column:
    """Return the median of each value and its neighbours, those that are numbers; fewer of them at the ends."""
    half = window // 2
    return np.array([np.nanmedian(values[max(0, i - half) : i + half + 1]) for i in range(len(values))])


def read_timing(path: Path, num_pixels: int) -> Soak:
    """Read a run's timing.csv; `num_pixels` are those of an image."""
    with path.open() as file:
        rows = list(csv.DictReader(file))

    def column(name: str) -> Column:
        return np.array([float(row[name]) for row in rows])

    counted = ("index", "rss_mib", "map_size", "is_keyframe", "tracking_cpu_ms", "mapping_cpu_ms")
    frame, rss_mib, map_size, is_keyframe, tracking_ms, mapping_ms = map(column, counted)
    mapping_ms[column("mapping_iterations") == 0] = np.nan
    return Soak(frame, rss_mib, map_size, is_keyframe.cumsum(), tracking_ms, mapping_ms, 16 * num_pixels / 2**20)


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__)
    parser.add_argument("settings", nargs="*", metavar="setting=value", help="laid over the soak's own")
    parser.add_argument("--out", type=Path, default=Path("outputs/soak"), help="the run's folder")
    parser.add_argument("--read", action="store_true", help="draw what lies in the folder, without a run")
    parser.add_argument("--allowed", type=float, default=20.0, help="creep of memory [MiB per 1000 frames]")
    options = parser.parse_args()
    if not options.read:
        command = [sys.executable, "-m", "xrdslam", *SETTINGS, *options.settings, f"run_dir={options.out}"]
        subprocess.run(command, check=True)
    chosen = dict(setting.split("=", 1) for setting in [*SETTINGS, *options.settings])
    num_pixels = int(chosen["dataset.width"]) * int(chosen["dataset.height"])
    soak = read_timing(options.out / "timing.csv", num_pixels)
    print("\n".join(soak.lines()))
    soak.draw(options.out / "soak.png", f"{chosen['algo']} on {chosen['dataset']}, preset={chosen['preset']}")
    return 0 if soak.creep(soak.besides_keyframes())[1] <= options.allowed else 1


if __name__ == "__main__":
    sys.exit(main())
