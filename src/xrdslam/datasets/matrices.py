"""Intrinsics in files: matrices and lists of numbers as text, and the usual keys of JSON and YAML."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from xrdslam.core.errors import DataError
from xrdslam.datasets.poses import read_text

__all__ = ["read_intrinsic_matrix", "read_mapping"]

Four = tuple[float, float, float, float]


def read_intrinsic_matrix(path: Path) -> Four:
    """Return fx, fy, cx, cy of a text file that holds a 3x3, 3x4 or 4x4 matrix by rows."""
    text = "\n".join(line for line in read_text(path, "intrinsics").splitlines() if not line.lstrip().startswith("#"))
    try:
        values = np.array(text.replace(",", " ").replace(";", " ").split(), dtype=np.float64)
    except ValueError as error:
        raise DataError(f"{path}: intrinsics are a matrix of numbers ({error}); mend the file") from error
    columns = {9: 3, 12: 4, 16: 4}.get(values.size)
    if columns is None:
        raise DataError(f"{path}: intrinsics are a 3x3, 3x4 or 4x4 matrix, found {values.size} numbers; mend the file")
    return checked_matrix(values.reshape(-1, columns), str(path))


def checked_matrix(matrix: np.ndarray, source: str) -> Four:
    """Return fx, fy, cx, cy of an intrinsic matrix; refuse what is none."""
    if not np.isfinite(matrix).all() or min(matrix[0, 0], matrix[1, 1]) <= 0:
        raise DataError(f"{source}: focal lengths must be above 0 and all finite, found {matrix.tolist()}; mend it")
    if abs(matrix[2, 2] - 1) > 1e-6 or abs(matrix[1, 0]) + abs(matrix[2, 0]) + abs(matrix[2, 1]) > 1e-6:
        raise DataError(
            f"{source}: the matrix is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]: {matrix.tolist()}; mend it"
        )
    if abs(matrix[0, 1]) > 1e-3 * matrix[0, 0]:
        raise DataError(f"{source}: the pixels are skewed by {matrix[0, 1]:g}; rectify the images first")
    return float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2])


def read_mapping(path: Path) -> dict[str, Any]:
    """Read a file of JSON or YAML that holds names and values; OpenCV's %YAML:1.0 and its tags are allowed."""
    text = read_text(path, "names and values")
    try:
        if path.suffix == ".json":
            values = json.loads(text)
        else:
            kept = (line for line in text.splitlines() if not line.startswith("%"))
            values = yaml.safe_load("\n".join(kept).replace("!!opencv-matrix", ""))
    except (ValueError, yaml.YAMLError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise DataError(f"{path}: not {path.suffix.lstrip('.').upper()} ({reason}); copy it again") from error
    if not isinstance(values, dict):
        raise DataError(f"{path}: holds a {type(values).__name__}, not names and values; copy it again")
    return values
