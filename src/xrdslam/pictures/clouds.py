"""Point clouds read from PLY files."""

from pathlib import Path

import numpy as np

from xrdslam.core.errors import DataError
from xrdslam.core.surface import PointCloud

__all__ = ["read_cloud"]


def read_cloud(path: Path) -> PointCloud:
    """Read points and, where there are any, colours; a mesh is read as its vertices. DataError where it is neither."""
    from plyfile import PlyData, PlyParseError  # type: ignore[import-untyped]  # ships no stubs

    try:
        lengths = {"face": {"vertex_indices": 3, "vertex_index": 3}}  # triangles are read at once
        vertex = PlyData.read(str(path), known_list_len=lengths)["vertex"]
        points = np.stack([np.asarray(vertex[axis], dtype=np.float32) for axis in "xyz"], 1)
        names = {p.name for p in vertex.properties}
    except (OSError, PlyParseError, KeyError, ValueError) as error:
        raise DataError(f"{path}: not a PLY cloud with vertices x, y, z ({error}); give another file") from error
    channels = ("red", "green", "blue")
    if not names.issuperset(channels):
        return PointCloud(points)
    return PointCloud(points, np.stack([np.asarray(vertex[c], dtype=np.float32) / 255 for c in channels], 1))
