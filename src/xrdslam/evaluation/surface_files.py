"""Triangle meshes read from PLY files."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int64
from numpy.typing import NDArray

from xrdslam.core.errors import DataError
from xrdslam.core.surface import TriangleMesh

__all__ = ["read_mesh"]

NAMES = ("vertex_indices", "vertex_index")
"""What the list of a face's corners is called."""


def read_mesh(path: Path) -> TriangleMesh:
    """Read vertices and faces; polygons are cut into fans of triangles. DataError where the file is no mesh."""
    from plyfile import PlyParseError  # type: ignore[import-untyped]  # ships no stubs

    try:
        data = _read(path)
        vertex, face = data["vertex"], data["face"]
        vertices = np.stack([np.asarray(vertex[axis], dtype=np.float32) for axis in "xyz"], 1)
        faces = _triangles(face[next(p.name for p in face.properties if p.name in NAMES)])
    except (OSError, PlyParseError, KeyError, StopIteration, ValueError) as error:
        raise DataError(
            f"{path}: not a PLY mesh with vertices x, y, z and faces ({error}); give another file"
        ) from error
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise DataError(f"{path}: a face names vertex {faces.max()} of {len(vertices)}; the file is damaged")
    return TriangleMesh(vertices, faces)


def _read(path: Path) -> Any:  # noqa: ANN401  # the package is not typed
    """Read the file as one of triangles, which is a matter of milliseconds, else face by face."""
    from plyfile import PlyData, PlyParseError

    try:
        return PlyData.read(str(path), known_list_len={"face": dict.fromkeys(NAMES, 3)})
    except PlyParseError:
        return PlyData.read(str(path))


def _triangles(polygons: NDArray[Any]) -> Int64[NDArray[np.int64], "f 3"]:
    if polygons.ndim == 2:
        return polygons.astype(np.int64)
    sizes = np.array([len(p) for p in polygons], dtype=np.int64)
    fans = []
    for size in np.unique(sizes[sizes >= 3]):
        whole = np.stack(list(polygons[sizes == size])).astype(np.int64)
        fans += [whole[:, [0, k, k + 1]] for k in range(1, int(size) - 1)]
    return np.concatenate(fans) if fans else np.zeros((0, 3), np.int64)
