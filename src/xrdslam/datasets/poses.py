"""Camera poses in text files: matrices and quaternions, refused by file and line where they are no rigid motions."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from xrdslam.core.errors import DataError

__all__ = ["parse_pose", "quaternion_pose", "read_pose", "read_pose_lines", "read_text", "rigid_pose"]

# Real files are rounded: rotations of 7-Scenes are off by 1.6e-4 (the largest entry of R R^T - I). A rotation in the
# wrong unit, order or layout is off by a tenth and more, a scaled one by twice its scale's excess.
ROTATION_TOLERANCE = 1e-2
QUATERNION_TOLERANCE = 1e-2  # four rounded decimals, as in TUM's files, are off by 1e-4


def read_pose(path: Path) -> Float64[np.ndarray, "4 4"]:
    """Read T_world_camera from a file of its own: four rows of four numbers."""
    return parse_pose(read_text(path), str(path))


def read_pose_lines(path: Path) -> list[tuple[str, str]]:
    """Return (text, "file, line n") of each line that holds something, to be parsed one by one.

    Blank lines and lines that start with # are left out, and counted in n.
    """
    lines = enumerate(read_text(path).splitlines(), 1)
    return [(text, f"{path}, line {n}") for n, text in lines if text.strip() and not text.lstrip().startswith("#")]


def parse_pose(text: str, source: str) -> Float64[np.ndarray, "4 4"]:
    """Parse the 16 numbers of T_world_camera, row by row; errors name `source`."""
    words = text.replace(",", " ").split()
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError as error:
        raise DataError(f"{source}: a pose is 16 numbers, found {_shortened(text)!r}; mend the line") from error
    if values.size != 16:
        raise DataError(f"{source}: a pose is 16 numbers (a 4x4 matrix by rows), found {values.size}; mend the line")
    return rigid_pose(values.reshape(4, 4), source)


def quaternion_pose(words: Sequence[str], source: str, order: Literal["xyzw", "wxyz"]) -> Float64[np.ndarray, "4 4"]:
    """Parse tx ty tz and a quaternion in the order of the file; it may be rounded, but not of another length than 1."""
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError as error:
        raise DataError(f"{source}: a pose is 7 numbers, found {' '.join(words)[:60]!r}; mend the line") from error
    if values.size != 7:
        raise DataError(f"{source}: a pose is tx ty tz and a quaternion, 7 numbers, found {values.size}; mend the line")
    if not np.isfinite(values).all():
        raise DataError(f"{source}: the pose has a NaN or infinity; {_REMEDY}")
    quat_xyzw = values[3:] if order == "xyzw" else values[[4, 5, 6, 3]]
    length = float(np.linalg.norm(quat_xyzw))
    if abs(length - 1) > QUATERNION_TOLERANCE:
        raise DataError(f"{source}: the quaternion has length {length:.4g}, not 1; its last four numbers are {order}")
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(quat_xyzw).as_matrix()
    pose[:3, 3] = values[:3]
    return pose


def rigid_pose(matrix: Float64[np.ndarray, "4 4"], source: str) -> Float64[np.ndarray, "4 4"]:
    """Return the rigid motion nearest to a matrix that is one but for rounding; a DataError where it is not.

    The rotation becomes U V^T of its singular value decomposition U S V^T, the nearest in the Frobenius norm.
    """
    if not np.isfinite(matrix).all():
        raise DataError(f"{source}: the pose has a NaN or infinity; {_REMEDY}")
    rotation = matrix[:3, :3]
    excess = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if excess > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        kind = "mirrored" if excess <= ROTATION_TOLERANCE else f"not orthonormal (R R^T - I reaches {excess:.2g})"
        raise DataError(f"{source}: the rotation of the pose is {kind}; {_REMEDY}")
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() > ROTATION_TOLERANCE:
        raise DataError(f"{source}: the last row of the pose is {matrix[3].tolist()}, not 0 0 0 1; {_REMEDY}")
    left, _, right = np.linalg.svd(rotation)
    rigid = np.eye(4)
    rigid[:3, :3] = left @ right
    rigid[:3, 3] = matrix[:3, 3]
    return rigid


_REMEDY = "give camera-to-world matrices by rows, or leave the frame out with dataset.on_error=skip"


def read_text(path: Path, what: str = "poses") -> str:
    """Read a text file; `what` it should hold is said in errors. A pipe or a folder is refused, not waited for."""
    if path.exists() and not path.is_file():
        raise DataError(f"{path}: not a file, but it should be a text file of {what}; copy it again")
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file of {what}; complete the folder") from error
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: not a readable text file of {what} ({error}); copy it again") from error


def _shortened(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."
