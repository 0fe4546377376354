"""The map that generalised ICP registers depth to: scans of points in Gaussian voxels of several sizes."""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int64

from xrdslam.core.errors import MissingExtraError

__all__ = ["Cloud", "GaussianMaps", "Registration", "load_small_gicp"]

_MAP_ORIENTATION_RAD = (0.6, 0.5, -0.4)
"""The voxel grid against the world, as a rotation vector: any that leaves no axis near an axis or a diagonal."""

_FOREVER = 10**8
"""Scans for which a voxel that is not seen again is kept: as long as the run, so that a revisit finds it."""


def load_small_gicp() -> ModuleType:
    """Import the package that brings the registration, or say which extra does."""
    try:
        return importlib.import_module("small_gicp")
    except ImportError as error:
        raise MissingExtraError(
            f"algo/tracking=gicp needs the package small_gicp, which cannot be imported ({error}); "
            "`pip install xrdslam[gicp]`"
        ) from error


@runtime_checkable
class Cloud(Protocol):
    """The package's points with covariances."""

    def size(self) -> int:
        """Return how many points there are."""

    def points(self) -> Float64[np.ndarray, "n 4"]:
        """Return the points, homogeneous."""


@dataclass(frozen=True)
class Registration:
    """A pose and how well it fits."""

    T_world_camera: Float64[np.ndarray, "4 4"]
    num_inliers: int
    """Points that lie in voxels of the finest map."""
    error: float
    """Sum of half squared Mahalanobis distances over the inliers."""
    iterations: int
    converged: bool
    information: Float64[np.ndarray, "6 6"]
    """Of a small motion of the camera (rotation, translation in its axes), as far as the points tell it."""

    def determination(self, cloud: "Cloud") -> float:
        """Return how well the registered cloud tells the worst known motion, in parts of the best known one.

        Motions are translations, and turns about the cloud's middle by what moves its points as far. Below a hundredth
        before a plain wall, unless its points are noisy; 0.03 and more in furnished rooms.
        """
        points = cloud.points()[:, :3]
        middle = points.mean(0)
        spread_m = float(np.sqrt(((points - middle) ** 2).sum(1).mean()))
        motions = np.eye(6)
        motions[3:, :3] = np.cross(np.eye(3), middle)  # how a turn about the middle moves the origin
        motions[:, :3] /= max(spread_m, 1e-9)
        known = np.linalg.eigvalsh(motions.T @ self.information @ motions)
        return float(known[0] / known[-1]) if known[-1] > 0 else 0.0


class GaussianMaps:
    """Scans, and the Gaussian voxel maps that they make up (voxelised GICP: Koide et al., ICRA 2021).

    A voxel holds the mean and the averaged covariance of the points in it; covariances are flattened to planes
    (1e-3, 1, 1). The grid lies askew in the world: a wall that lies *in* a face of the grid, as in a room with straight
    axes, would change its voxels at the least motion and lose them. The same scans in the same order give the same
    bits: everything runs on one thread, since the package adds up in no fixed order in parallel.
    """

    def __init__(self, voxel_sizes_m: Sequence[float], num_neighbours: int) -> None:
        """Start empty; the last of `voxel_sizes_m` is the finest."""
        self._gicp = load_small_gicp()
        self._sizes_m = tuple(voxel_sizes_m)
        self._num_neighbours = num_neighbours
        self._T_map_world = np.eye(4)
        self._T_map_world[:3, :3] = cv2.Rodrigues(np.array(_MAP_ORIENTATION_RAD))[0]
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self._scans: list[tuple[np.ndarray, np.ndarray]] = []
        self._maps = [self._gicp.GaussianVoxelMap(size) for size in self._sizes_m]
        for voxels in self._maps:
            voxels.set_lru(_FOREVER, _FOREVER)

    def __len__(self) -> int:
        return len(self._scans)

    def thin(self, points: Float32[np.ndarray, "n 3"], spacing_m: float) -> Float32[np.ndarray, "m 3"]:
        """Average the points in each cell of a grid; float32, so that what is stored is what was registered."""
        if len(points) == 0:
            return points
        sampled = self._gicp.voxelgrid_sampling(points.astype(np.float64), spacing_m, num_threads=1)
        return np.ascontiguousarray(sampled.points()[:, :3], dtype=np.float32)

    def cloud(self, points: Float32[np.ndarray, "n 3"]) -> Cloud:
        """Return the package's point cloud with the covariance of each point's neighbourhood."""
        cloud: Cloud = self._gicp.PointCloud(points.astype(np.float64))
        tree = self._gicp.KdTree(cloud, num_threads=1)
        self._gicp.estimate_covariances(cloud, tree, num_neighbors=self._num_neighbours, num_threads=1)
        return cloud

    def insert(
        self, points_camera: Float32[np.ndarray, "n 3"], cloud: Cloud, T_world_camera: Float64[np.ndarray, "4 4"]
    ) -> None:
        """Add a scan (`cloud` is that of its points) to every map."""
        self._scans.append((points_camera, T_world_camera))
        for voxels in self._maps:
            voxels.insert(cloud, self._T_map_world @ T_world_camera)

    def register(
        self, cloud: Cloud, T_world_camera: Float64[np.ndarray, "4 4"], coarse: bool, max_iterations: int
    ) -> Registration:
        """Register a cloud, starting from a pose: to the finest map, or through every map from the coarsest."""
        T_map_camera = self._T_map_world @ T_world_camera
        total = 0
        for voxels, size in list(zip(self._maps, self._sizes_m, strict=True))[0 if coarse else -1 :]:
            is_finest = size == self._sizes_m[-1]
            result = self._gicp.align(
                voxels,
                cloud,
                T_map_camera,
                max_correspondence_distance=2 * size,  # more than a voxel's diagonal: the voxel decides
                num_threads=1,
                max_iterations=max_iterations,
                rotation_epsilon=1e-4 if is_finest else 1e-3,
                translation_epsilon=1e-5 if is_finest else 1e-3,
            )
            T_map_camera = result.T_target_source
            total += result.iterations
        T_world_camera = np.linalg.inv(self._T_map_world) @ T_map_camera
        converged, information = result.converged, np.array(result.H)
        return Registration(T_world_camera, result.num_inliers, result.error, total, converged, information)

    def scans(self) -> tuple[Float32[np.ndarray, "n 3"], Int64[np.ndarray, " s"], Float64[np.ndarray, "s 4 4"]]:
        """Return every scan's camera-frame points one after the other, their numbers, and T_world_camera of each."""
        points = [points for points, _ in self._scans]
        lengths = np.array([len(p) for p in points], dtype=np.int64)
        poses = np.array([pose for _, pose in self._scans], dtype=np.float64).reshape(-1, 4, 4)
        return np.concatenate([np.empty((0, 3), np.float32), *points]), lengths, poses

    def replay(
        self,
        points: Float32[np.ndarray, "n 3"],
        lengths: Int64[np.ndarray, " s"],
        poses: Float64[np.ndarray, "s 4 4"],
    ) -> None:
        """Make the maps again from what `scans` returned, bit by bit what they were."""
        self.clear()
        for scan, T_world_camera in zip(np.split(points, np.cumsum(lengths))[:-1], poses, strict=True):
            self.insert(scan, self.cloud(scan), T_world_camera)
