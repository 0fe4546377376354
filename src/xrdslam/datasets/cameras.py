"""Intrinsics in whichever common form somebody left them: matrices, lists, JSON and YAML of many tools."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from xrdslam.core.errors import DataError
from xrdslam.datasets.matrices import checked_matrix, read_mapping
from xrdslam.datasets.poses import read_text
from xrdslam.datasets.source import Lens

__all__ = ["CAMERA_FILES", "Stated", "lens_of", "read_camera"]

CAMERA_FILES = (
    *("K.txt", "intrinsics.txt", "intrinsic.txt", "camera.txt", "calibration.txt", "camera_matrix.txt"),
    *(
        "intrinsics.json",
        "intrinsic.json",
        "camera_intrinsic.json",
        "camera.json",
        "cam_params.json",
        "calibration.json",
    ),
    *("intrinsics.yaml", "camera.yaml", "camera_info.yaml", "calibration.yaml", "sensor.yaml", "intrinsics.yml"),
)
"""The names that are looked for, in this order."""

NAMES = {  # what tools call it
    "fx": ("fx", "fl_x", "focal_x", "f_x"),
    "fy": ("fy", "fl_y", "focal_y", "f_y"),
    "cx": ("cx", "c_x", "ppx", "principal_x"),
    "cy": ("cy", "c_y", "ppy", "principal_y"),
    "width": ("w", "width", "image_width"),
    "height": ("h", "height", "image_height"),
    "scale": ("scale", "depth_scale", "png_depth_scale"),
}
MATRICES = ("K", "k", "intrinsic_matrix", "camera_matrix", "intrinsics", "intrinsic", "cameraMatrix")
DISTORTIONS = ("distortion_coefficients", "distortion", "dist_coeffs", "coeffs", "D", "d")


class Stated(NamedTuple):
    """A lens, and the levels of depth per metre where the file says so."""

    lens: Lens
    depth_scale: float | None = None


def read_camera(path: Path) -> Stated:
    """Read a file of intrinsics: text (3x3, 3x4, 4x4, `fx fy cx cy` or `fx fy cx cy width height`), JSON or YAML."""
    if path.suffix in (".json", ".yaml", ".yml"):
        values = read_mapping(path)
        inner = next((values[key] for key in ("camera", "color", "rgb") if isinstance(values.get(key), dict)), values)
        return lens_of(inner, str(path))
    lines = [line for line in read_text(path, "intrinsics").splitlines() if not line.lstrip().startswith("#")]
    try:
        numbers = [float(word) for word in " ".join(lines).replace(",", " ").replace(";", " ").split()]
    except ValueError as error:
        raise DataError(f"{path}: intrinsics are numbers ({error}); mend the file") from error
    if len(numbers) in (4, 6):
        names = dict(zip(("fx", "fy", "cx", "cy", "w", "h"), numbers, strict=False))
        return lens_of(names, str(path))
    if len(numbers) in (9, 12, 16):
        return lens_of({"K": numbers}, str(path))
    raise DataError(
        f"{path}: intrinsics are fx fy cx cy, with or without width height, or a 3x3, 3x4 or 4x4 matrix;"
        f" found {len(numbers)} numbers"
    )


def lens_of(values: Mapping[str, Any], source: str) -> Stated:
    """Find a lens among named values; `source` is the file they came from."""
    try:
        four = _intrinsics(values, source)
        found = {key: _named(values, key) for key in ("width", "height", "scale")}
        distortion = _distortion(values)
    except (TypeError, ValueError, KeyError, IndexError) as error:
        raise DataError(
            f"{source}: not a camera ({type(error).__name__}: {error}); give fx, fy, cx, cy, or a 3x3 matrix as K, and"
            " width, height where they are known"
        ) from error
    if not all(map(math.isfinite, (*four, *distortion))) or min(four[:2]) <= 0:
        raise DataError(f"{source}: focal lengths must be above 0 and all finite, found {four}; mend the file")
    width, height, scale = found["width"], found["height"], found["scale"]
    size = (int(width), int(height)) if width and height else None
    if scale is not None and not 0 < scale < math.inf:
        raise DataError(f"{source}: a depth scale of {scale}; it is the levels of one metre, above 0")
    levels = 1 / scale if scale is not None and scale < 1 else scale  # below 1 it is metres a level
    return Stated(Lens(four, distortion, source, size), levels)


def _intrinsics(values: Mapping[str, Any], source: str) -> tuple[float, float, float, float]:
    fx, fy, cx, cy = (_named(values, key) for key in ("fx", "fy", "cx", "cy"))
    if fx is not None and cx is not None and cy is not None:
        return fx, fx if fy is None else fy, cx, cy
    given = next((values[key] for key in MATRICES if values.get(key) is not None), None)
    if given is None:
        raise KeyError("neither fx, fy, cx, cy nor a matrix")
    if isinstance(given, Mapping):
        given = given["data"] if "data" in given else _intrinsics(given, source)
    flat = np.asarray(given, dtype=np.float64).ravel()
    if flat.size == 4:
        fx, fy, cx, cy = flat.tolist()
        return fx, fy, cx, cy
    matrix = flat.reshape(-1, {9: 3, 12: 4, 16: 4}[flat.size])[:3, :3]
    by_columns = matrix[0, 2] == matrix[1, 2] == 0 and matrix[2, 0] > 0  # as Open3D writes it
    return checked_matrix(matrix.T if by_columns else matrix, source)


def _named(values: Mapping[str, Any], key: str) -> float | None:
    found = next((values[name] for name in NAMES[key] if values.get(name) is not None), None)
    return None if found is None else float(found)


def _distortion(values: Mapping[str, Any]) -> tuple[float, ...]:
    given: Any = next((values[key] for key in DISTORTIONS if values.get(key) is not None), None)
    if isinstance(given, Mapping):
        given = given.get("data", ())
    if given is None:
        given = [float(values.get(key) or 0.0) for key in ("k1", "k2", "p1", "p2", "k3")]
    coefficients = [float(v) for v in given] if isinstance(given, Sequence) else [float(given)]
    padded = coefficients + [0.0] * (4 - len(coefficients))
    return tuple(padded) if any(padded) else ()
