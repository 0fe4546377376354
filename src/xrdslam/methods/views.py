"""The views that a relocaliser remembers: what was seen, under the index of the frame that saw it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from xrdslam.core.frame import Frame
from xrdslam.core.trajectory import Trajectory
from xrdslam.methods.features import Features

__all__ = ["MAX_VIEWS", "View", "ViewMemory", "surface_of"]

MAX_VIEWS = 300
"""About 100 kB each: 30 MB at most."""
COLUMNS = 80
"""The surface of a view is kept at every n-th pixel, so that about this many columns remain."""
SPACING = 0.1
"""A view is worth remembering this part of its median depth away from every other one, ..."""
SPACING_RAD = 0.2
"""... or turned by this much against it, or the same in parts of both."""


@dataclass(frozen=True)
class View:
    """A frame as it is remembered."""

    index: int
    features: Features
    surface: Float32[np.ndarray, "m 3"]
    """Camera-frame points [m] of every n-th pixel."""
    reach_m: float
    """The median depth."""


def surface_of(frame: Frame) -> Float32[np.ndarray, "m 3"]:
    """Return the points [m] of every n-th pixel that has a depth."""
    if frame.depth is None:
        return np.empty((0, 3), np.float32)
    step = max(1, round(frame.camera.width / COLUMNS))
    depth = frame.depth[::step, ::step].cpu()
    is_known = (depth > 0) & torch.isfinite(depth)
    pixels = (is_known.nonzero() * step).flip(-1).to(depth)  # (row, column) -> (u, v)
    points: np.ndarray = frame.camera.unproject(pixels, depth[is_known]).numpy()
    return points


class ViewMemory:
    """Views that are spread over what the camera saw; with too many of them, the most redundant one is forgotten."""

    def __init__(self) -> None:
        self.views: list[View] = []

    def is_new(self, frame: Frame, reach_m: float, trajectory: Trajectory) -> bool:
        """Say whether a frame was taken from a place, or in a direction, that no view has."""
        if not self.views:
            return True
        distances = _distances(trajectory.pose(frame.index)[None], self._poses(trajectory), np.array([reach_m]))
        return bool(distances.min() >= 1)

    def add(self, view: View, trajectory: Trajectory) -> None:
        """Remember a view."""
        self.views.append(view)
        if len(self.views) > MAX_VIEWS:
            poses, reach = self._poses(trajectory), np.array([v.reach_m for v in self.views])
            distances = _distances(poses, poses, reach)
            np.fill_diagonal(distances, np.inf)
            del self.views[max(divmod(int(distances.argmin()), len(self.views)))]

    def _poses(self, trajectory: Trajectory) -> Tensor:
        return torch.stack([trajectory.pose(view.index) for view in self.views])

    def state_dict(self) -> dict[str, Tensor]:
        """Return everything as tensors."""
        parts = {
            "descriptors": ([v.features.descriptors for v in self.views], np.empty((0, 32), np.uint8)),
            "pixels": ([v.features.pixels for v in self.views], np.empty((0, 2), np.float32)),
            "points": ([v.features.points_camera for v in self.views], np.empty((0, 3), np.float32)),
            "surfaces": ([v.surface for v in self.views], np.empty((0, 3), np.float32)),
        }
        state = {name: torch.from_numpy(np.concatenate([nothing, *rows])) for name, (rows, nothing) in parts.items()}
        counts = [[v.index, len(v.features), len(v.surface)] for v in self.views]
        state["counts"] = torch.tensor(counts, dtype=torch.int64).reshape(-1, 3)
        state["reach_m"] = torch.tensor([v.reach_m for v in self.views], dtype=torch.float64)
        return state

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take over what `state_dict` returned."""
        counts = state["counts"].tolist()
        features, surfaces = [count for _, count, _ in counts], [count for *_, count in counts]
        columns = [_split(state[name], features) for name in ("descriptors", "pixels", "points")]
        self.views = [
            View(index, Features(*rows), surface, float(reach_m))
            for (index, *_), rows, surface, reach_m in zip(
                counts,
                zip(*columns, strict=True),
                _split(state["surfaces"], surfaces),
                state["reach_m"],
                strict=True,
            )
        ]


def _split(rows: Tensor, counts: Sequence[int]) -> list[np.ndarray]:
    return [part.cpu().numpy() for part in torch.split(rows, list(counts))]


def _distances(T_world_a: Tensor, T_world_b: Tensor, reach_m: np.ndarray) -> np.ndarray:
    """Return how far apart cameras are, in parts of what makes a view worth remembering, shape (a, b)."""
    shift = (T_world_a[:, None, :3, 3] - T_world_b[None, :, :3, 3]).norm(dim=-1).numpy()
    trace = torch.einsum("aij,bij->ab", T_world_a[:, :3, :3], T_world_b[:, :3, :3]).numpy()
    turn = np.arccos(np.clip((trace - 1) / 2, -1, 1))  # trace(A^T B) = 1 + 2 cos
    parts: np.ndarray = shift / (SPACING * np.maximum(reach_m, math.ulp(1.0)))[:, None] + turn / SPACING_RAD
    return parts
