"""Classic scan-to-map tracking of depth: generalised ICP against a Gaussian voxel map."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64
from torch import Tensor

from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.core.tracking import TrackingMethod, TrackingResult
from xrdslam.core.trajectory import Trajectory
from xrdslam.methods.config import GicpTrackingConfig
from xrdslam.methods.gicp_map import Cloud, GaussianMaps, Registration

__all__ = ["GicpTracking"]


@dataclass(frozen=True)
class _Scan:
    """The thinned points of a frame, and the package's cloud of them."""

    index: int
    points_camera: Float32[np.ndarray, "n 3"]
    cloud: Cloud | None
    """None with fewer points than a frame needs."""
    overlap: float = 0.0
    """Share of the points that the map has."""


class GicpTracking(TrackingMethod):
    """Registers every frame's depth to a map of its own, made of the depth of accepted frames; follows no model.

    Generalised ICP (Segal et al., RSS 2009) in its voxelised form, by the package `small_gicp`. From the prediction to
    the fine map first; where too few points then lie in the map, through the coarse maps as well, then from the last
    good pose; the pose with most points in the map is kept. Before a single plane the motion along it is not determined
    and stays near the prediction. Deterministic, on one thread.
    """

    needs = frozenset({"rgb", "depth"})
    config: GicpTrackingConfig

    def __init__(self, config: GicpTrackingConfig, seed: int = 0) -> None:
        """Raise MissingExtraError where `small_gicp` is not installed."""
        super().__init__(config, seed)
        self._maps = GaussianMaps([*config.coarse_voxels_m, config.voxel_m], config.num_neighbours)
        self._scan: _Scan | None = None
        self._accepted: np.ndarray | None = None
        self._inserted: np.ndarray | None = None

    def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
        """Register the frame; lost with too few points or too few of them in the map."""
        predicted = frame.pose.matrix().detach()
        scan = self._scan = self._read(frame)
        if scan.cloud is None:
            return _lost(predicted, f"{len(scan.points_camera)} points of depth, {self.config.min_points} needed")
        if len(self._maps) == 0:
            self._insert(scan, _exact(predicted))
            return _lost(predicted, "no earlier frame had enough depth; the tracker's map starts here")
        best = self._register(scan.cloud, _exact(predicted))
        overlap = best.num_inliers / len(scan.points_camera)
        if overlap < self.config.min_overlap or not np.isfinite(best.T_world_camera).all():
            reason = f"{100 * overlap:.0f}% of the points lie in the map, {100 * self.config.min_overlap:.0f}% needed"
            return _lost(predicted, reason)
        self._scan = replace(scan, overlap=overlap)
        found = torch.from_numpy(best.T_world_camera).to(predicted)
        loss = best.error / best.num_inliers
        return TrackingResult(found, converged=best.converged, iterations=best.iterations, loss=loss)

    def integrate(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"]) -> None:
        """Take the frame into the map where it shows something new or from elsewhere."""
        if self._scan is None or self._scan.index != frame.index:
            self._scan = self._read(frame)
        pose = self._accepted = _exact(T_world_camera)
        if self._is_due(self._scan, pose):
            self._insert(self._scan, pose)
        self._scan = None

    def _read(self, frame: Frame) -> _Scan:
        """Turn depth into thinned camera-frame points."""
        if frame.depth is None:
            raise ValueError(f"frame {frame.index} has no depth")
        step = max(1, round(frame.camera.width / self.config.columns))
        depth = frame.depth[::step, ::step].cpu()
        is_used = (depth > 0) & (depth < self.config.max_depth_m)
        pixels = (is_used.nonzero() * step).flip(-1).to(depth)  # (row, column) -> (u, v)
        points = self._maps.thin(frame.camera.unproject(pixels, depth[is_used]).numpy(), self.config.point_spacing_m)
        cloud = self._maps.cloud(points) if len(points) >= self.config.min_points else None
        return _Scan(frame.index, points, cloud)

    def _register(self, cloud: Cloud, predicted: Float64[np.ndarray, "4 4"]) -> Registration:
        """Try one start after the other until one fits well; return the one that fits best."""
        best: Registration | None = None
        enough = self.config.confident_overlap * cloud.size()
        for start, coarse in self._starts(predicted):
            found = self._maps.register(cloud, start, coarse, self.config.max_iterations)
            if best is None or found.num_inliers > best.num_inliers:
                best = found
            if best.num_inliers >= enough:
                break
        assert best is not None  # there is at least one start
        return best

    def _starts(self, predicted: np.ndarray) -> Iterator[tuple[np.ndarray, bool]]:
        """Yield starting poses, and whether the coarse maps come first."""
        yield predicted, False
        yield predicted, True
        if self._accepted is not None:
            yield self._accepted, True

    def _is_due(self, scan: _Scan, pose: Float64[np.ndarray, "4 4"]) -> bool:
        if self._inserted is None or scan.overlap < self.config.insert_overlap:
            return True
        distance_m = float(np.linalg.norm(pose[:3, 3] - self._inserted[:3, 3]))
        cosine = (float(np.sum(pose[:3, :3] * self._inserted[:3, :3])) - 1) / 2  # trace(A^T B) = 1 + 2 cos
        angle_rad = math.acos(min(1.0, max(-1.0, cosine)))
        return distance_m > self.config.insert_distance_m or angle_rad > self.config.insert_angle_rad

    def _insert(self, scan: _Scan, pose: Float64[np.ndarray, "4 4"]) -> None:
        if scan.cloud is not None:
            self._maps.insert(scan.points_camera, scan.cloud, pose)
            self._inserted = pose

    def state_dict(self) -> dict[str, Tensor]:
        """Return the scans in the map and the last good pose (NaN where there is none): enough to go on exactly."""
        points, lengths, poses = (torch.from_numpy(array) for array in self._maps.scans())
        accepted = np.full((4, 4), np.nan) if self._accepted is None else self._accepted
        scans = {"scan_points": points, "scan_lengths": lengths, "scan_poses": poses}
        return super().state_dict() | scans | {"accepted": torch.from_numpy(accepted)}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take over what `state_dict` returned and build the map again."""
        super().load_state_dict(state)
        points, lengths, poses = (state[key].cpu().numpy() for key in ("scan_points", "scan_lengths", "scan_poses"))
        self._maps.replay(points, lengths, poses)
        accepted = state["accepted"].cpu().numpy()
        self._accepted = accepted if np.isfinite(accepted).all() else None
        self._inserted = poses[-1] if len(poses) else None
        self._scan = None


def _exact(T_world_camera: Float[Tensor, "4 4"]) -> Float64[np.ndarray, "4 4"]:
    exact: np.ndarray = T_world_camera.detach().cpu().double().numpy()
    return exact


def _lost(predicted: Float[Tensor, "4 4"], reason: str) -> TrackingResult:
    return TrackingResult(predicted, is_lost=True, converged=False, reason=reason)
