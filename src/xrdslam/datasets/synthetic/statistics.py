"""How fast a camera moves from frame to frame: the table of docs/synthetic.md.

`python -m xrdslam.datasets.synthetic.statistics [TRAJECTORY...]` prints the walks of the eight rooms, then those of the
named files: 4 x 4 matrices row by row, one pose a line, camera to world in metres, as in Replica's traj.txt.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

__all__ = ["MotionStatistics", "measure"]


class MotionStatistics(NamedTuple):
    """Mean, median, 95th percentile of the way [cm] and the turn [deg] a frame, and how jerkily both change."""

    way_cm: tuple[float, float, float]
    turn_deg: tuple[float, float, float]
    acceleration_mm: float
    """Mean length of the second difference of position [mm per frame^2]."""
    jerk_mm: float
    """Mean length of the third difference of position [mm per frame^3]."""
    turn_change_deg: float
    """Mean length of the change of the angular velocity [deg per frame^2]."""


def measure(T_world_camera: Float64[np.ndarray, "n 4 4"]) -> MotionStatistics:
    """Return the statistics of a trajectory of at least four poses, one a frame."""
    R = T_world_camera[:-1, :3, :3].transpose(0, 2, 1) @ T_world_camera[1:, :3, :3]
    axis = 0.5 * np.stack((R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]), 1)
    sine, cosine = np.linalg.norm(axis, axis=1), 0.5 * (np.trace(R, axis1=1, axis2=2) - 1)
    turn = np.degrees(np.arctan2(sine, cosine))
    omega = axis / np.maximum(sine, 1e-300)[:, None] * turn[:, None]
    position = T_world_camera[:, :3, 3]
    way = 100 * np.linalg.norm(np.diff(position, axis=0), axis=1)
    second, third = (1000 * np.linalg.norm(np.diff(position, n, axis=0), axis=1) for n in (2, 3))
    change = np.linalg.norm(np.diff(omega, axis=0), axis=1)
    return MotionStatistics(_three(way), _three(turn), *(float(x.mean()) for x in (second, third, change)))


def _three(values: Float64[np.ndarray, " n"]) -> tuple[float, float, float]:
    return float(values.mean()), float(np.median(values)), float(np.percentile(values, 95))


def _row(name: str, T_world_camera: Float64[np.ndarray, "n 4 4"]) -> str:
    s = measure(T_world_camera)
    way, turn = (" ".join(f"| {v:.2f} " for v in three) for three in (s.way_cm, s.turn_deg))
    return (
        f"| {name} | {len(T_world_camera)} {way}{turn}"
        f"| {s.acceleration_mm:.2f} | {s.jerk_mm:.3f} | {s.turn_change_deg:.3f} |"
    )


def main(files: list[str]) -> None:
    """Print the table as Markdown."""
    from xrdslam.datasets.synthetic.config import SyntheticConfig
    from xrdslam.datasets.synthetic.dataset import SyntheticDataset
    from xrdslam.datasets.synthetic.rooms import ROOMS

    head = "way a frame [cm]: mean | median | 95 % | turn a frame [deg]: mean | median | 95 %"
    print(f"| trajectory | frames | {head} | bend [mm/frame²] | jerk [mm/frame³] | change of turn [deg/frame²] |")
    print("|---" * 11 + "|")
    for name in sorted(ROOMS):
        print(_row(f"synthetic/{name}", SyntheticDataset(SyntheticConfig(scene=name)).loop))
    for file in files:
        print(_row(Path(file).stem, np.loadtxt(file).reshape(-1, 4, 4)))


if __name__ == "__main__":
    main(sys.argv[1:])
