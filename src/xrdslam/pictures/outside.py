"""A map seen from outside: where to stand, and how its surface is shaded."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float64, UInt8
from numpy.typing import NDArray

from xrdslam.core.surface import PointCloud, TriangleMesh
from xrdslam.pictures.raster import draw_points, draw_triangles

__all__ = ["Drawing", "Outside"]

Pose = Float64[NDArray[np.float64], "4 4"]
Points = Float[np.ndarray, "n 3"]
Picture = UInt8[np.ndarray, "h w 3"]

CLAY = (0.78, 0.77, 0.74)
"""The colour of a surface that has none."""
AMBIENT, LIGHT = 0.45, 0.6
SUPERSAMPLING = 2
"""Samples a pixel has in each direction, averaged: smooth edges."""


@dataclass(frozen=True, eq=False)
class Outside:
    """A camera outside of a scene, with a focal length in units of the image's width."""

    T_world_camera: Pose
    focal: float = 1.1

    @classmethod
    def behind(
        cls,
        points_world: Points,
        T_world_cameras: Float64[NDArray[np.float64], "m 4 4"],
        turn_deg: float = 0.0,
        rise_deg: float = 35.0,
        aspect: float = 1.6,
    ) -> "Outside":
        """Stand behind where the cameras were, above them, and look at the points; as near as all of them fit.

        Up is what was up for the cameras on average. `turn_deg` walks around the scene. The outermost percent of the
        points is let go: a map has strays.
        """
        up, forward = _directions(T_world_cameras)
        turn, rise = np.radians(turn_deg), np.radians(rise_deg)
        right = np.cross(forward, up)
        level = np.cos(turn) * forward + np.sin(turn) * right
        z = np.cos(rise) * level - np.sin(rise) * up
        x = np.cross(z, up) / np.linalg.norm(np.cross(z, up))
        rotation = np.stack([x, np.cross(z, x), z], 1)
        some = points_world[:: max(1, len(points_world) // 50_000)]  # say as well where a million lie
        finite = some[np.isfinite(some).all(1)].astype(np.float64)
        inner = finite if len(finite) else np.zeros((1, 3))
        low, high = np.percentile(inner @ rotation, [1, 99], axis=0)
        centre = (low + high) / 2
        half = (high - low) / 2
        # The front of the box, `half[2]` nearer than its centre, must fit into the image with a margin.
        distance = half[2] + 1.08 * max(half[0] * 2 * cls.focal, half[1] * 2 * cls.focal * aspect, 1e-3)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, rotation @ (centre - [0.0, 0.0, distance])
        return cls(pose)

    def intrinsics(self, width: int, height: int) -> tuple[float, float, float, float]:
        """Return fx, fy, cx, cy [px] of an image of this size."""
        return self.focal * width, self.focal * width, (width - 1) / 2, (height - 1) / 2

    def to_camera(self, points_world: Points) -> Float64[NDArray[np.float64], "n 3"]:
        """Return points in this camera's frame [m]."""
        moved = points_world.astype(np.float64) - self.T_world_camera[:3, 3]
        return np.asarray(moved @ self.T_world_camera[:3, :3])

    def pixels(self, points_world: Points, width: int, height: int) -> Float64[NDArray[np.float64], "n 2"]:
        """Return where points are seen [px]; NaN for what lies behind."""
        x, y, z = self.to_camera(points_world).T
        fx, fy, cx, cy = self.intrinsics(width, height)
        safe = np.where(z > 0.01, z, np.nan)
        return np.stack([fx * x / safe + cx, fy * y / safe + cy], 1)


class Drawing:
    """A mesh (its front sides) or a cloud as a camera sees it, to be coloured once or in several ways."""

    def __init__(
        self, surface: TriangleMesh | PointCloud, view: Outside, size: tuple[int, int], point_radius_m: float = 0.01
    ) -> None:
        """Draw it; `size` is width, height [px]."""
        self.surface, self.size = surface, size
        width, height = (SUPERSAMPLING * side for side in size)
        intrinsics = view.intrinsics(width, height)
        if isinstance(surface, TriangleMesh):
            self._points = view.to_camera(surface.vertices)
            self._seen = draw_triangles(self._points, surface.faces, intrinsics, (width, height))
        else:
            self._points = view.to_camera(surface.points)
            self._seen = draw_points(self._points, point_radius_m, intrinsics, (width, height))
        self._is_covered = self._seen.which >= 0
        self.shown, self._place = np.unique(self._seen.which[self._is_covered], return_inverse=True)
        """The triangles or points that are seen."""

    def picture(self, background: tuple[int, int, int] = (255, 255, 255), colors: Points | None = None) -> Picture:
        """Return it in its own or in given colours (of vertices or points), a mesh shaded by a lamp at the eye."""
        rgb = self._mesh(colors) if isinstance(self.surface, TriangleMesh) else self._cloud(colors)
        image = np.empty((*self._is_covered.shape, 3), np.uint8)
        image[:] = background
        image[self._is_covered] = np.rint(255 * np.clip(rgb, 0, 1)).astype(np.uint8)[self._place.ravel()]
        return np.asarray(cv2.resize(image, self.size, interpolation=cv2.INTER_AREA))

    def _cloud(self, colors: Points | None) -> Float[np.ndarray, "s 3"]:
        own = self.surface.colors if colors is None else colors
        return np.full((len(self.shown), 3), CLAY) if own is None else np.asarray(own[self.shown])

    def _mesh(self, colors: Points | None) -> Float[np.ndarray, "s 3"]:
        """Return each shown triangle's mean colour under the lamp."""
        assert isinstance(self.surface, TriangleMesh), "called for meshes"
        faces = self.surface.faces[self.shown]
        corners = self._points[faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        middle = corners.mean(1)
        lengths = np.linalg.norm(normals, axis=1) * np.linalg.norm(middle, axis=1)
        facing = np.abs((normals * middle).sum(1)) / np.maximum(lengths, 1e-12)
        own = self.surface.colors if colors is None else colors
        plain = np.asarray(CLAY) if own is None else own[faces].mean(1)
        shaded: np.ndarray = plain * (AMBIENT + LIGHT * facing)[:, None]
        return shaded


def _directions(T_world_cameras: Float64[NDArray[np.float64], "m 4 4"]) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean up, and the mean of where the cameras looked, level to it."""
    finite = T_world_cameras[np.isfinite(T_world_cameras).all((1, 2))]
    turned = finite[:, :3, :3] if len(finite) else np.eye(3)[None]
    up = _unit(-turned[:, :, 1].mean(0), np.array([0.0, -1.0, 0.0]))
    forward = turned[:, :, 2].mean(0)
    level = forward - (forward @ up) * up
    aside = np.cross(up, [1.0, 0.0, 0.0])
    return up, _unit(level, aside if np.linalg.norm(aside) > 0.1 else np.cross(up, [0.0, 1.0, 0.0]))


def _unit(vector: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Return a direction; what is hardly any (cameras that looked everywhere) gives way to another."""
    length = float(np.linalg.norm(vector))
    chosen = vector if length > 0.05 else otherwise
    unit: np.ndarray = chosen / np.linalg.norm(chosen)
    return unit
