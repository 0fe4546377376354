"""`python -m benchmarks.lost [--gap A B] [--methods ...] setting=value ...`: what a gap in a sequence does to methods.

Each method runs with the frames A to B left out, without and with `algo.tracking.relocalise`, and once with all of
them, from the first true pose on. Errors are distances of camera centres in that world, without any alignment: behind
the gap they say whether the camera was found in the same world. They hold what the method drifts by and what the truth
is off by, too: the run with all frames says how much that is. `setting=value` choose the sequence, as on the command
line of a run.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from xrdslam.evaluation.trajectory_files import read_tum

__all__ = ["Outcome", "outcome"]

METHODS = {
    "splatam": ["algo=splatam", "preset=fast"],
    "co_slam": ["algo=co_slam", "preset=fast"],
    "gicp": ["algo=splatam", "algo/tracking=gicp", "preset=fast"],
}


class Outcome(NamedTuple):
    """How a run came through the gap."""

    before_cm: float
    """RMSE of the camera centres before the gap."""
    after_cm: float
    """And behind it, every frame, lost or not."""
    last_cm: float
    """And of the last ten frames."""
    lost: int
    recognised: int
    first_lost: int | None
    frames_per_second: float

    def row(self) -> str:
        """Return the figures as a row of a Markdown table."""
        first = "-" if self.first_lost is None else str(self.first_lost)
        figures = (f"{self.before_cm:.2f}", f"{self.after_cm:.2f}", f"{self.last_cm:.2f}")
        return " | ".join((*figures, str(self.lost), first, str(self.recognised), f"{self.frames_per_second:.2f}"))


QUICK = (
    "algo.first_pose=ground_truth",
    "evaluation.every=100",
    "evaluation.mesh_samples=0",
    "evaluation.pictures_every=0",
    "report=false",
)
"""The trajectory is what is asked."""
HEADING = (
    "| method | frames | before the gap [cm] | after [cm] | last ten [cm] | frames lost | first lost | recognised "
    "| frames/s |\n|---|---|---|---|---|---|---|---|---|"
)


RUNS = {
    "all of them": ["algo.tracking.relocalise=false"],
    "without the gap's": ["algo.tracking.relocalise=false"],
    "without, relocalise": ["algo.tracking.relocalise=true"],
}
"""What is said of a run, and its settings; the gap is left out of all but the first."""


def outcome(run_dir: Path, begin: int, end: int) -> Outcome:
    """Read off a run's files what happened before row `begin` of its trajectory and from row `end` on."""
    estimate, truth = (read_tum(run_dir / "trajectory" / f"{name}.txt") for name in ("final", "ground_truth"))
    off_cm = 100 * np.linalg.norm((estimate.T_world_camera - truth.T_world_camera)[:, :3, 3], axis=1)
    metrics = json.loads((run_dir / "metrics.json").read_text())
    lost = json.loads((run_dir / "keyframes.json").read_text())["lost_frames"]
    parts = (off_cm[:begin], off_cm[end:], off_cm[-10:])
    return Outcome(
        *(float(np.sqrt((part**2).mean())) for part in parts),
        lost=len(lost),
        recognised=metrics["trajectory/recognised_frames"],
        first_lost=min(lost, default=None),
        frames_per_second=metrics["profile/frames_per_second"],
    )


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.lost", description=__doc__)
    parser.add_argument("settings", nargs="*", metavar="setting=value", help="of the sequence, and what else")
    parser.add_argument("--gap", nargs=2, type=int, default=[85, 115], metavar=("A", "B"), help="frames left out")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--out", type=Path, default=Path("outputs/lost"), help="where the runs go")
    parser.add_argument("--frames", nargs=2, default=["0", "null"], metavar=("A", "B"), help="of dataset.frames")
    options = parser.parse_args()
    (start, stop), (first, last) = options.gap, options.frames
    print(HEADING, flush=True)
    for method in options.methods:
        for number, (said, settings) in enumerate(RUNS.items()):
            folder = options.out / f"{method}_{number}"
            command = [sys.executable, "-m", "xrdslam", *METHODS[method], *QUICK, *settings, *options.settings]
            command += [f"dataset.frames=[{first},{last},1]", "engine.progress=false", f"run_dir={folder}"]
            begin = end = start - int(first)
            if number == 0:
                end = stop - int(first)
            else:
                command.append(f"dataset.drop=[{start},{stop}]")
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            print(f"| {method} | {said} | {outcome(folder, begin, end).row()} |", flush=True)


if __name__ == "__main__":
    main()
