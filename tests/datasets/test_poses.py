"""Poses in text: numbers come back, what is no rigid motion is refused by file and line."""

from pathlib import Path

import numpy as np
import pytest

from xrdslam.core.errors import DataError
from xrdslam.datasets.poses import ROTATION_TOLERANCE, parse_pose, read_pose, read_pose_lines, rigid_pose


def rotation(seed: int) -> np.ndarray:
    left, _, right = np.linalg.svd(np.random.default_rng(seed).normal(size=(3, 3)))
    matrix = left @ right
    return matrix * np.sign(np.linalg.det(matrix))


def pose(seed: int) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(seed)
    matrix[:3, 3] = np.random.default_rng(seed + 1).normal(size=3)
    return matrix


@pytest.mark.parametrize("separator", [" ", "\t ", ", "])
def test_a_pose_comes_back_whatever_separates_its_numbers(tmp_path: Path, separator: str) -> None:
    path = tmp_path / "pose.txt"
    path.write_text("\n".join(separator.join(f"{v:.17e}" for v in row) for row in pose(3)))
    np.testing.assert_allclose(read_pose(path), pose(3), rtol=0, atol=1e-15)


def test_a_rounded_rotation_becomes_an_exact_one_no_farther_than_it_was_off() -> None:
    rounded = np.round(pose(5), 3)
    rigid = rigid_pose(rounded, "here")
    np.testing.assert_allclose(rigid[:3, :3] @ rigid[:3, :3].T, np.eye(3), atol=1e-15)
    # The nearest rotation is no farther from the rounded matrix than the true one is.
    assert np.linalg.norm(rigid - rounded) <= np.linalg.norm(pose(5) - rounded)
    np.testing.assert_array_equal(rigid[:3, 3], rounded[:3, 3])


@pytest.mark.parametrize(("side", "refused"), [(0.9, False), (1.1, True)])
def test_a_scaled_rotation_is_refused_from_the_tolerance_on(side: float, refused: bool) -> None:
    matrix = pose(7)
    matrix[:3, :3] *= np.sqrt(1 + side * ROTATION_TOLERANCE)  # R R^T - I is then side * tolerance
    if refused:
        with pytest.raises(DataError, match="here: the rotation of the pose is not orthonormal"):
            rigid_pose(matrix, "here")
    else:
        np.testing.assert_allclose(rigid_pose(matrix, "here"), pose(7), atol=1e-12)


def test_a_mirror_a_nan_and_a_false_last_row_are_refused() -> None:
    with pytest.raises(DataError, match="mirrored"):
        rigid_pose(pose(9) @ np.diag([1.0, 1.0, -1.0, 1.0]), "here")
    for value in (np.nan, np.inf, -np.inf):
        spoilt = pose(9)
        spoilt[1, 3] = value
        with pytest.raises(DataError, match="NaN or infinity"):
            rigid_pose(spoilt, "here")
    with pytest.raises(DataError, match="last row"):
        rigid_pose(pose(9).T, "here")


@pytest.mark.parametrize(("text", "found"), [("1 2 3", "found 3"), ("a " * 16, "found 'a a"), ("", "found 0")])
def test_what_is_not_16_numbers_is_refused(text: str, found: str) -> None:
    with pytest.raises(DataError, match=f"here: .*{found}"):
        parse_pose(text, "here")


def test_lines_are_numbered_as_an_editor_does(tmp_path: Path) -> None:
    path = tmp_path / "traj.txt"
    path.write_text("# poses\n\n1 2\n3 4\n")
    assert read_pose_lines(path) == [("1 2", f"{path}, line 3"), ("3 4", f"{path}, line 4")]


def test_a_missing_file_and_one_that_is_no_text_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"none\.txt: no such file"):
        read_pose(tmp_path / "none.txt")
    (tmp_path / "bytes.txt").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(DataError, match=r"bytes\.txt: not a readable text"):
        read_pose_lines(tmp_path / "bytes.txt")
