"""Sensors on a body: where each sits, and two cameras brought to one plane."""

from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float64

from xrdslam.core.camera import Camera
from xrdslam.core.errors import DataError
from xrdslam.datasets.matrices import read_mapping
from xrdslam.datasets.poses import rigid_pose

__all__ = ["Mounted", "read_mounted", "read_mounting", "rectified_pair"]

Maps = tuple[np.ndarray, np.ndarray]
MODELS = ("radial-tangential", "radtan", "plumb_bob")


class Mounted(NamedTuple):
    """A camera and where it sits; `maps` bring its files to it where rectification turned it."""

    camera: Camera
    T_body_sensor: Float64[np.ndarray, "4 4"]
    stated_in: str
    maps: Maps | None = None


def read_mounting(path: Path) -> Float64[np.ndarray, "4 4"]:
    """Return T_BS of a sensor.yaml: sensor to body."""
    return _mounting(read_mapping(path), path)


def read_mounted(path: Path) -> Mounted:
    """Read a camera's sensor.yaml: T_BS, resolution, intrinsics, distortion."""
    values = read_mapping(path)
    model = values.get("distortion_model", MODELS[0])
    if values.get("camera_model", "pinhole") != "pinhole" or model not in MODELS:
        raise DataError(
            f"{path}: camera_model {values.get('camera_model')}, distortion_model {model}; only a pinhole camera with"
            f" {' or '.join(MODELS)} is read: undistort the images first"
        )
    try:
        width, height = (int(v) for v in values["resolution"])
        fx, fy, cx, cy = (float(v) for v in values["intrinsics"])
        distortion = tuple(float(v) for v in values.get("distortion_coefficients") or ())
        camera = Camera(fx, fy, cx, cy, width, height, distortion)
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"{path}: not a camera ({type(error).__name__}: {error}); it has resolution: [w, h], intrinsics:"
            " [fu, fv, cu, cv], distortion_coefficients and T_BS"
        ) from error
    except DataError as error:
        raise DataError(f"{path}: {error}") from error
    return Mounted(camera, _mounting(values, path), str(path))


def rectified_pair(left: Mounted, right: Mounted) -> tuple[Mounted, Mounted, float]:
    """Turn two cameras about their centres until their rows coincide; return both, of one K, and the baseline [m].

    Bouguet's rectification (cv2.stereoRectify), cropped so that every pixel of both was seen.
    """
    size = (left.camera.width, left.camera.height)
    if size != (right.camera.width, right.camera.height):
        raise DataError(f"{right.stated_in}: {right.camera.width}x{right.camera.height} px, the left has {size} px")
    T_right_left = np.linalg.inv(right.T_body_sensor) @ left.T_body_sensor
    K = [_matrix(side.camera) for side in (left, right)]
    lens = [np.array(side.camera.distortion or (0.0,) * 4) for side in (left, right)]
    turns = cv2.stereoRectify(K[0], lens[0], K[1], lens[1], size, T_right_left[:3, :3], T_right_left[:3, 3:], alpha=0)
    R_rectified = turns[:2]
    projections = turns[2:4]
    baseline_m = -float(projections[1][0, 3] / projections[1][0, 0])
    if baseline_m <= 0:
        raise DataError(f"{right.stated_in}: the right camera is not to the right of the left ({baseline_m:.3f} m)")
    P = projections[0]
    camera = Camera(float(P[0, 0]), float(P[1, 1]), float(P[0, 2]), float(P[1, 2]), *size)
    sides = []
    for side, R, matrix, coefficients, projection in zip((left, right), R_rectified, K, lens, projections, strict=True):
        T_sensor_rectified = np.eye(4)
        T_sensor_rectified[:3, :3] = R.T
        maps = cv2.initUndistortRectifyMap(matrix, coefficients, R, projection[:, :3], size, cv2.CV_32FC1)
        T_body = side.T_body_sensor @ T_sensor_rectified
        sides.append(Mounted(camera, T_body, f"{side.stated_in} (rectified)", (maps[0], maps[1])))
    return sides[0], sides[1], baseline_m


def _mounting(values: dict[str, Any], path: Path) -> Float64[np.ndarray, "4 4"]:
    try:
        matrix = np.array(values["T_BS"]["data"], dtype=np.float64).reshape(4, 4)
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path}: no T_BS with 16 numbers in `data` ({error}); it says where it sits") from error
    return rigid_pose(matrix, f"{path}: T_BS")


def _matrix(camera: Camera) -> Float64[np.ndarray, "3 3"]:
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
