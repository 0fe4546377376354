"""Signed distances and the mesh made of them, against closed forms."""

import itertools

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from xrdslam.datasets.synthetic.bvh import STACK, build_bvh, first_hit
from xrdslam.datasets.synthetic.distance import signed_distance
from xrdslam.datasets.synthetic.mesh import ply_bytes, scene_mesh
from xrdslam.datasets.synthetic.scene import Material, Pattern, Scene, Shape, Solid, rotation
from xrdslam.datasets.synthetic.shading import World
from xrdslam.datasets.synthetic.solids import core_gradient

GREY = Material(Pattern.PLAIN, ("#808080", "#808080", "#808080"))
POINTS = np.random.default_rng(0).uniform((-2.4, -1.9, 0.1), (2.4, 1.9, 2.9), (500, 3))


def alone(solid: Solid) -> Scene:
    return Scene("one", (20.0, 20.0, 20.0), (GREY,), (solid,), ())


def test_distance_to_a_sphere() -> None:
    scene = alone(Solid(Shape.BOX, (0.0, 0.0, 0.0), 0.7, (GREY,), (0.4, -0.3, 1.5))).pack()
    expected = np.linalg.norm(POINTS - [0.4, -0.3, 1.5], axis=1) - 0.7
    inside_room = np.minimum(POINTS[:, 2], expected)  # the floor may be nearer
    np.testing.assert_allclose(signed_distance(scene, POINTS), inside_room, atol=1e-14)


def test_distance_to_a_turned_box_outside_and_inside() -> None:
    R, half, centre = rotation(25.0, 10.0, -40.0), np.array([0.8, 0.4, 0.3]), np.array([0.1, 0.2, 1.6])
    scene = alone(Solid(Shape.BOX, (0.8, 0.4, 0.3), 0.0, (GREY,), (0.1, 0.2, 1.6), R)).pack()
    q = np.abs((POINTS - centre) @ R) - half
    expected = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(1), 0)
    assert (expected < 0).sum() > 5
    np.testing.assert_allclose(signed_distance(scene, POINTS), np.minimum(POINTS[:, 2], expected), atol=1e-13)


def test_outside_the_room_is_solid() -> None:
    scene = Scene("empty", (5.0, 4.0, 3.0), (GREY,), (), ()).pack()
    points = np.array([[0.0, 0.0, 1.5], [2.4, 0.0, 1.5], [3.0, 0.0, 1.5], [0.0, 0.0, -0.25]])
    np.testing.assert_allclose(signed_distance(scene, points), [1.5, 0.1, -0.5, -0.25], atol=1e-14)


@pytest.mark.parametrize("size", [(0.5, 0.2, 0.4), (0.2, 0.5, 0.4), (0.3, 0.3, 0.2), (0.4, 0.0, 0.5)])
def test_distance_to_a_frustum_is_that_to_its_nearest_surface_point(size: tuple[float, float, float]) -> None:
    """An independent twin: the least distance to a dense sampling of the trapezoid's outline in (r, z)."""
    bottom, top, h = size
    corners = np.array([[0.0, -h], [bottom, -h], [top, h], [0.0, h]])
    t = np.linspace(0, 1, 4001)[:, None]
    outline = np.concatenate([a + t * (b - a) for a, b in itertools.pairwise(corners)])
    rng = np.random.default_rng(1)
    for x, y, z in rng.uniform(-0.9, 0.9, (200, 3)):
        d, gx, gy, gz = core_gradient(1, x, y, z, bottom, top, h)
        r = np.hypot(x, y)
        nearest = np.sqrt(((outline - [r, z]) ** 2).sum(1).min())
        inside = abs(z) < h and r < bottom + (top - bottom) * (z + h) / (2 * h)
        assert d == pytest.approx(-nearest if inside else nearest, abs=2e-4)  # half a step of the sampling
        assert np.hypot(np.hypot(gx, gy), gz) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("shape", "size", "radius"),
    [(0, (0.3, 0.2, 0.1), 0.08), (0, (0.0, 0.0, 0.3), 0.2), (1, (0.4, 0.2, 0.3), 0.0), (1, (0.3, 0.3, 0.1), 0.1)],
)
def test_rays_meet_convex_solids_where_slow_marching_meets_them(
    shape: int, size: tuple[float, float, float], radius: float
) -> None:
    scene = alone(Solid(Shape(shape), size, radius, (GREY,), (0.0, 0.0, 5.0))).pack()
    bvh, stack, rng = build_bvh(scene), np.empty(STACK, np.int64), np.random.default_rng(2)
    hits = 0
    for _ in range(150):
        origin = rng.normal(size=3)
        origin = 2.0 * origin / np.linalg.norm(origin)
        d = rng.uniform(-0.45, 0.45, 3) - origin
        d /= np.linalg.norm(d)
        t, who = first_hit(scene, bvh, origin[0], origin[1], origin[2] + 5.0, *d, 0, stack)
        marched = march(scene_distance(shape, size, radius), origin, d)
        assert (who == 1) == (marched is not None)
        if marched is not None:
            hits += 1
            assert t == pytest.approx(marched, abs=1e-5)
    assert 20 < hits < 150


def scene_distance(shape: int, size: tuple[float, float, float], radius: float):  # noqa: ANN201
    return lambda p: core_gradient(shape, *p, *size)[0] - radius


def march(distance, origin: NDArray[np.float64], d: NDArray[np.float64]) -> float | None:  # noqa: ANN001
    t = 0.0
    for _ in range(4000):
        gap = distance(origin + t * d)
        if gap < 1e-7:
            return t
        t += gap
        if t > 4.0:
            return None
    return None


def test_the_mesh_lies_on_the_surface_and_faces_the_air(toy_world: World) -> None:
    mesh = scene_mesh(toy_world, voxel=0.04)
    distances = signed_distance(toy_world.scene, mesh.vertices.astype(np.float64))
    assert np.median(np.abs(distances)) < 1e-5
    assert np.abs(distances).max() < 0.02  # half a voxel, at edges
    corner = mesh.vertices[mesh.faces].astype(np.float64)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(normal, axis=1)
    large = area > 0.3 * np.median(area)
    ahead = corner.mean(1)[large] + 0.01 * normal[large] / area[large, None]
    assert (signed_distance(toy_world.scene, ahead) > 0).mean() > 0.99
    walls = 2 * (5 * 4 + 5 * 3 + 4 * 3)
    assert 0.5 * area.sum() > walls


def test_the_mesh_s_file_is_read_by_others(toy_world: World) -> None:
    mesh = scene_mesh(toy_world, voxel=0.1)
    read = trimesh.load_mesh(trimesh.util.wrap_as_stream(ply_bytes(mesh)), file_type="ply", process=False)
    np.testing.assert_array_equal(read.vertices.astype(np.float32), mesh.vertices)
    np.testing.assert_array_equal(read.faces, mesh.faces)
    np.testing.assert_array_equal(read.visual.vertex_colors[:, :3], mesh.colours)
