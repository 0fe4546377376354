"""What a map looks like from outside: triangle meshes and point clouds, and their files."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from xrdslam.core.files import replaced

__all__ = ["PointCloud", "TriangleMesh", "write_ply"]


@dataclass
class PointCloud:
    """World-frame points [m] with colours in [0, 1]."""

    points: Float[np.ndarray, "n 3"]
    colors: Float[np.ndarray, "n 3"] | None = None

    def write(self, path: Path) -> None:
        """Write a binary PLY that common viewers open."""
        write_ply(path, {"vertex": _vertex_table(self.points, self.colors)})


@dataclass
class TriangleMesh:
    """World-frame vertices [m], triangles (counter-clockwise seen from outside), colours in [0, 1]."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    colors: Float[np.ndarray, "v 3"] | None = None

    def write(self, path: Path) -> None:
        """Write a binary PLY that common viewers open."""
        faces = np.empty(len(self.faces), dtype=[("vertex_indices", "i4", (3,))])
        faces["vertex_indices"] = self.faces
        write_ply(path, {"vertex": _vertex_table(self.vertices, self.colors), "face": faces})


def _vertex_table(points: Float[np.ndarray, "n 3"], colors: Float[np.ndarray, "n 3"] | None) -> np.ndarray:
    fields = [(axis, "f4") for axis in "xyz"]
    if colors is not None:
        fields += [(channel, "u1") for channel in ("red", "green", "blue")]
    table = np.empty(len(points), dtype=fields)
    for axis, values in zip("xyz", points.T, strict=True):
        table[axis] = values
    if colors is not None:
        for channel, values in zip(("red", "green", "blue"), np.clip(colors, 0, 1).T, strict=True):
            table[channel] = np.round(values * 255)
    return table


def write_ply(path: Path, tables: dict[str, np.ndarray]) -> None:
    """Write structured arrays as the elements of a binary little-endian PLY; the file appears whole or not at all."""
    from plyfile import PlyData, PlyElement  # type: ignore[import-untyped]  # ships no stubs

    with replaced(path) as temporary:
        PlyData([PlyElement.describe(table, name) for name, table in tables.items()], byte_order="<").write(
            str(temporary)
        )
