"""Meshes and point clouds as files that other programs read."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from xrdslam.core.surface import PointCloud, TriangleMesh, write_ply

VERTICES = np.array([[0, 0, 0], [1.5, 0, 0], [0, 2.5, 0], [0, 0, -3.25]], dtype=np.float64)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
COLORS = np.array([[0.0, 0.5, 1.0], [1.2, -0.1, 0.25], [0, 0, 0], [1, 1, 1]])
BYTES = [[0, 128, 255], [255, 0, 64], [0, 0, 0], [255, 255, 255]]


def test_a_mesh_is_read_by_trimesh(tmp_path: Path) -> None:
    TriangleMesh(VERTICES, FACES, COLORS).write(tmp_path / "mesh.ply")
    read = trimesh.load(tmp_path / "mesh.ply", process=False)
    assert isinstance(read, trimesh.Trimesh)
    np.testing.assert_array_equal(read.vertices, VERTICES)  # all are float32 numbers
    np.testing.assert_array_equal(read.faces, FACES)
    assert read.visual.vertex_colors[:, :3].tolist() == BYTES  # rounded, clipped
    assert read.is_watertight


def test_a_cloud_is_read_by_trimesh(tmp_path: Path) -> None:
    PointCloud(VERTICES.astype(np.float32), COLORS).write(tmp_path / "cloud.ply")
    read = trimesh.load(tmp_path / "cloud.ply")
    assert isinstance(read, trimesh.PointCloud)
    np.testing.assert_array_equal(read.vertices, VERTICES)
    assert read.colors[:, :3].tolist() == BYTES


def test_colours_are_optional(tmp_path: Path) -> None:
    TriangleMesh(VERTICES, FACES).write(tmp_path / "mesh.ply")
    assert b"red" not in (tmp_path / "mesh.ply").read_bytes()


def test_nothing_is_a_valid_file(tmp_path: Path) -> None:
    empty = np.zeros((0, 3))
    TriangleMesh(empty, np.zeros((0, 3), dtype=np.int64), empty).write(tmp_path / "mesh.ply")
    PointCloud(empty).write(tmp_path / "cloud.ply")
    for name in ("mesh", "cloud"):
        assert b"element vertex 0" in (tmp_path / f"{name}.ply").read_bytes()


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    PointCloud(VERTICES).write(path)
    before = path.read_bytes()
    with pytest.raises(ValueError, match="c16"):  # PLY has no complex numbers
        write_ply(path, {"vertex": np.zeros(2, dtype=[("x", "c16")])})
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["cloud.ply"]
