"""Triangle meshes read from PLY files."""

from pathlib import Path

import numpy as np

from xrdslam.core.errors import DataError
from xrdslam.core.surface import TriangleMesh

__all__ = ["read_mesh"]


def read_mesh(path: Path) -> TriangleMesh:
    """Read vertices and faces; polygons are cut into fans of triangles. DataError where the file is no mesh."""
    from plyfile import PlyData, PlyParseError  # type: ignore[import-untyped]  # ships no stubs

    try:
        data = PlyData.read(str(path))
        vertex, face = data["vertex"], data["face"]
        vertices = np.stack([np.asarray(vertex[axis], dtype=np.float32) for axis in "xyz"], 1)
        name = next(p.name for p in face.properties if p.name in ("vertex_indices", "vertex_index"))
        polygons = face[name]
    except (OSError, PlyParseError, KeyError, StopIteration, ValueError) as error:
        raise DataError(
            f"{path}: not a PLY mesh with vertices x, y, z and faces ({error}); give another file"
        ) from error
    sizes = np.array([len(p) for p in polygons], dtype=np.int64)
    fans = []
    for size in np.unique(sizes[sizes >= 3]):
        whole = np.stack(list(polygons[sizes == size])).astype(np.int64)
        fans += [whole[:, [0, k, k + 1]] for k in range(1, int(size) - 1)]
    faces = np.concatenate(fans) if fans else np.zeros((0, 3), np.int64)
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise DataError(f"{path}: a face names vertex {faces.max()} of {len(vertices)}; the file is damaged")
    return TriangleMesh(vertices, faces)
