"""Rays at meshes: closed forms, the brute-force twin, edges, both sides, nothing at all."""

import numpy as np
import pytest
import torch

from xrdslam.core.surface import TriangleMesh
from xrdslam.ops.ray_mesh import RayMesh, cast_reference

SQUARE = TriangleMesh(
    np.array([[-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]], np.float32), np.array([[0, 1, 2], [0, 2, 3]])
)


def soup(seed: int, faces: int) -> TriangleMesh:
    """Return triangles of very different sizes, some without area."""
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(faces, 1, 3)) + rng.normal(size=(faces, 3, 3)) * rng.choice(
        [0.0, 0.05, 2.0], (faces, 1, 1)
    )
    return TriangleMesh(corners.reshape(-1, 3).astype(np.float32), np.arange(3 * faces).reshape(-1, 3))


def cast(mesh: TriangleMesh, origin: list[float], direction: list[float]) -> tuple[float, int]:
    hits = RayMesh(mesh).cast(np.array([origin], dtype=np.float64), np.array([direction], dtype=np.float64))
    return float(hits.distance[0]), int(hits.face[0])


@pytest.mark.parametrize("faces", [1, 4, 5, 300])
@pytest.mark.parametrize("seed", range(3))
def test_every_hit_is_the_twins(faces: int, seed: int) -> None:
    mesh, rng = soup(seed, faces), np.random.default_rng(seed + 10)
    origins, directions = rng.normal(size=(2, 700, 3)) * [[[2.0]], [[1.0]]]
    corners = torch.from_numpy(mesh.vertices.astype(np.float64)[mesh.faces])
    expected = cast_reference(corners, torch.from_numpy(origins), torch.from_numpy(directions)).numpy()
    hits = RayMesh(mesh).cast(origins, directions)
    # float64, the same formulas: sums of three products that may be contracted, on distances of at most a hundred
    np.testing.assert_allclose(hits.distance, expected, rtol=1e-9)
    assert np.array_equal(hits.face >= 0, np.isfinite(expected))
    assert faces < 300 or np.isfinite(expected).sum() > 50
    met = hits.face >= 0
    points = origins[met] + hits.distance[met, None] * directions[met]
    a, b, c = mesh.vertices.astype(np.float64)[mesh.faces[hits.face[met]]].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)  # empty where nothing was met
    off = np.abs(((points - a) * normal).sum(1)) / np.linalg.norm(normal, axis=1)
    assert off.max(initial=0.0) < 1e-6  # the face that is named is the one that was met


def test_a_square_is_met_from_both_sides_and_not_behind_the_ray() -> None:
    assert cast(SQUARE, [0.2, 0.1, 0.0], [0, 0, 1])[0] == pytest.approx(2.0, abs=1e-12)
    assert cast(SQUARE, [0.2, 0.1, 5.0], [0, 0, -2])[0] == pytest.approx(1.5, abs=1e-12)  # in lengths of the direction
    assert cast(SQUARE, [0.2, 0.1, 3.0], [0, 0, 1]) == (np.inf, -1)
    assert cast(SQUARE, [0.2, 1.1, 0.0], [0, 0, 1]) == (np.inf, -1)
    assert cast(SQUARE, [-3.0, 0.0, 2.5], [1, 0, 0]) == (np.inf, -1)  # along it


def test_a_ray_through_an_edge_or_a_corner_does_not_slip_through() -> None:
    diagonal = np.linspace(-1, 1, 2001)
    origins = np.stack((diagonal, diagonal, np.zeros_like(diagonal)), 1)  # the edge that both triangles share
    hits = RayMesh(SQUARE).cast(origins, np.tile([0.0, 0.0, 1.0], (len(origins), 1)))
    assert np.isfinite(hits.distance).all()


def test_the_nearer_of_two_walls_is_met_whatever_their_order() -> None:
    for depths in ((2, 3), (3, 2)):
        vertices = np.concatenate([SQUARE.vertices * [1, 1, depth / 2] for depth in depths]).astype(np.float32)
        both = TriangleMesh(vertices, np.concatenate((SQUARE.faces, SQUARE.faces + 4)))
        distance, face = cast(both, [0.5, 0.2, 0.0], [0, 0, 1])
        assert distance == pytest.approx(2.0)
        assert face // 2 == depths.index(2)


def test_a_sphere_seen_from_its_middle() -> None:
    """A chord of a triangle with sides s lies at most s^2 / (6 r) inside the sphere (sagitta at its centroid)."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, 41), np.linspace(0, 2 * np.pi, 81), indexing="ij")
    points = np.stack((np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), -1).reshape(-1, 3)
    row, column = np.meshgrid(np.arange(40), np.arange(80), indexing="ij")
    a = (row * 81 + column).ravel()
    faces = np.concatenate((np.stack((a, a + 1, a + 82), 1), np.stack((a, a + 82, a + 81), 1)))
    directions = np.random.default_rng(0).normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = RayMesh(TriangleMesh(points.astype(np.float32), faces)).cast(np.zeros_like(directions), directions)
    assert hits.distance.max() < 1 + 1e-6
    assert hits.distance.min() > 1 - 2 * (np.pi / 40) ** 2 / 6


def test_the_same_bits_for_one_and_two_threads() -> None:
    mesh, rng = soup(0, 500), np.random.default_rng(1)
    origins, directions = rng.normal(size=(2, 2000, 3))
    before = torch.get_num_threads()
    found = []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            found.append(RayMesh(mesh).cast(origins, directions))
    finally:
        torch.set_num_threads(before)
    assert np.array_equal(found[0].distance, found[1].distance)
    assert np.array_equal(found[0].face, found[1].face)


def test_an_empty_mesh_is_met_by_nothing_and_a_broken_one_is_refused() -> None:
    empty = TriangleMesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int64))
    assert cast(empty, [0, 0, 0], [0, 0, 1]) == (np.inf, -1)
    assert len(RayMesh(SQUARE).cast(np.zeros((0, 3)), np.zeros((0, 3))).distance) == 0
    broken = SQUARE.vertices.copy()
    broken[2, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        RayMesh(TriangleMesh(broken, SQUARE.faces))
    corners = torch.zeros(0, 3, 3, dtype=torch.float64)
    assert cast_reference(corners, torch.zeros(2, 3).double(), torch.ones(2, 3).double()).tolist() == [np.inf] * 2


def test_triangles_in_one_place_end_in_one_leaf_not_in_an_endless_tree() -> None:
    same = TriangleMesh(np.tile(SQUARE.vertices[:3], (1000, 1)), np.arange(3000).reshape(-1, 3))
    assert cast(same, [0.5, -0.5, 0.0], [0, 0, 1])[0] == pytest.approx(2.0)
