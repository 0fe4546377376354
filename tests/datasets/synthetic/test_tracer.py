"""What the ray caster sees, against closed forms."""

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from xrdslam.datasets.synthetic.bvh import STACK, build_bvh, first_hit
from xrdslam.datasets.synthetic.distance import signed_distance
from xrdslam.datasets.synthetic.lighting import LightingConfig, bake
from xrdslam.datasets.synthetic.scene import Scene, Shape, Solid, rotation
from xrdslam.datasets.synthetic.shading import World
from xrdslam.datasets.synthetic.tracer import render

SPHERE_RADIUS, SPHERE_CENTRE = 0.5, np.array([1.0, 0.3, 1.2])
BOX_HALF, BOX_CENTRE, BOX_R = np.array([0.4, 0.3, 0.5]), np.array([-1.0, 0.4, 1.0]), rotation(30.0)
LENS = (60.0, 60.0, 31.5, 23.5)
SIZE = (64, 48)


def looking(position: tuple[float, float, float], target: tuple[float, float, float]) -> NDArray[np.float64]:
    """T_world_camera at `position`, the optical axis through `target`, upright."""
    forward = np.subtract(target, position) / np.linalg.norm(np.subtract(target, position))
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3] = right, np.cross(forward, right), forward, position
    return T


def rays(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """World directions with z = 1 in the camera, so that a ray's parameter is its depth."""
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    camera = np.stack(((u - LENS[2]) / LENS[0], (v - LENS[3]) / LENS[1], np.ones(u.shape)), -1)
    return camera @ T[:3, :3].T


def room_depth(o: NDArray[np.float64], d: NDArray[np.float64]) -> NDArray[np.float64]:
    """Depth of the empty 5 x 4 x 3 m room."""
    wall = np.where(d > 0, [2.5, 2.0, 3.0], [-2.5, -2.0, 0.0])
    return np.asarray(((wall - o) / np.where(d == 0, 1e-300, d)).min(-1))


def test_an_empty_room_has_the_depth_of_its_walls(toy_scene: Scene) -> None:
    packed = Scene("empty", toy_scene.size, toy_scene.shell, (), toy_scene.lights).pack()
    world = World(packed, build_bvh(packed), bake(packed, LightingConfig(1.0, 1, 2, 0)))
    T = looking((0.3, -0.4, 1.4), (2.0, 1.0, 0.7))
    _, depth = render(world, LENS, *SIZE, T)
    np.testing.assert_array_equal(depth, room_depth(T[:3, 3], rays(T)).astype(np.float32))


def test_a_sphere_has_the_depth_of_its_quadratic(toy_world: World) -> None:
    T = looking((-0.5, -0.7, 1.4), tuple(SPHERE_CENTRE))
    _, depth = render(toy_world, LENS, *SIZE, T)
    d, oc = rays(T), T[:3, 3] - SPHERE_CENTRE
    a, b, c = (d * d).sum(-1), d @ oc, oc @ oc - SPHERE_RADIUS**2
    disc = b * b - a * c
    met = disc > 0
    assert 200 < met.sum() < 3000
    np.testing.assert_allclose(depth[met], ((-b - np.sqrt(np.maximum(disc, 0))) / a)[met], rtol=1.2e-7)  # float32's eps


def test_a_turned_box_has_the_depth_of_its_slabs(toy_world: World) -> None:
    T = looking((0.6, -0.9, 1.6), tuple(BOX_CENTRE))
    _, depth = render(toy_world, LENS, *SIZE, T)
    d, o = rays(T) @ BOX_R, (T[:3, 3] - BOX_CENTRE) @ BOX_R
    t0, t1 = (-BOX_HALF - o) / d, (BOX_HALF - o) / d
    near, far = np.minimum(t0, t1).max(-1), np.maximum(t0, t1).min(-1)
    met = near < far
    assert 200 < met.sum() < 3000
    np.testing.assert_allclose(depth[met], near[met], rtol=1.2e-7)


@pytest.mark.parametrize("target", [(0.0, -1.2, 0.5), (0.2, 1.2, 0.6), (1.0, 0.3, 1.2)])
def test_every_hit_lies_on_a_surface_and_none_is_passed(toy_world: World, target: tuple[float, float, float]) -> None:
    T = looking((-0.9, -0.6, 1.7), target)
    _, depth = render(toy_world, LENS, *SIZE, T)
    points = T[:3, 3] + rays(T) * depth[..., None].astype(np.float64)
    assert np.abs(signed_distance(toy_world.scene, points)).max() < 2e-6  # depth in float32 at 4 m
    for share in np.linspace(0.0, 0.999, 60):  # a distance below zero on the way would be a surface gone through
        on_way = T[:3, 3] + share * (points - T[:3, 3])
        assert signed_distance(toy_world.scene, on_way).min() > -1e-6


def test_the_guess_does_not_change_the_answer(toy_world: World) -> None:
    rng = np.random.default_rng(3)
    stack = np.empty(STACK, np.int64)
    for _ in range(200):
        d = rng.normal(size=3)
        found = [first_hit(toy_world.scene, toy_world.bvh, -0.6, -0.4, 1.9, *d, guess, stack) for guess in range(5)]
        assert len(set(found)) == 1


def test_the_guess_does_not_change_which_of_two_coinciding_faces_is_seen(toy_scene: Scene) -> None:
    grey = toy_scene.shell[0]
    twins = tuple(Solid(Shape.BOX, (0.3, 0.3, h), 0.0, (grey,), (0.0, 0.0, 1.0 - h)) for h in (0.5, 0.25, 0.125))
    packed = Scene("twins", (5.0, 4.0, 3.0), (grey,), twins, ()).pack()  # three tops at z = 1
    bvh, stack = build_bvh(packed), np.empty(STACK, np.int64)
    for guess in range(4):
        assert first_hit(packed, bvh, 0.1, 0.1, 2.0, 0.0, 0.0, -1.0, guess, stack) == (1.0, 1)


def test_any_number_of_threads_gives_the_same_bits(toy_scene: Scene, toy_world: World) -> None:
    T = looking((-0.9, -0.6, 1.7), (0.2, 1.2, 0.6))
    before = numba.get_num_threads()
    results = []
    try:
        for threads in sorted({1, min(2, before), before}):
            numba.set_num_threads(threads)
            light = bake(toy_world.scene, LightingConfig(0.4, 2, 8, 1))
            results.append((*render(toy_world._replace(light=light), LENS, *SIZE, T), light.irradiance))
    finally:
        numba.set_num_threads(before)
    for other in results[1:]:
        for a, b in zip(results[0], other, strict=True):
            np.testing.assert_array_equal(a, b)


def test_light_falls_as_a_small_lamp_s_closed_form(toy_scene: Scene) -> None:
    """Irradiance under a small rectangle is L A cos cos / d^2; the floor below the toy's lamp is open."""
    packed = Scene("empty", (5.0, 4.0, 3.0), toy_scene.shell, (), ()).pack()
    side, height = 0.02, 2.5
    lamp = np.array([[0.0, 0.0, height, side / 2, 0, 0, 0, -side / 2, 0, 50.0, 50.0, 50.0]])
    light = bake(packed._replace(lights=lamp), LightingConfig(0.25, 1, 1, 0))
    columns, rows, start = light.columns[0, 5], light.rows[0, 5], light.start[0, 5]
    middle = light.irradiance[start : start + columns * rows].reshape(rows, columns, 3)[rows // 2, columns // 2]
    lift = 2e-3
    np.testing.assert_allclose(middle, 50.0 * side**2 / (height - lift) ** 2, rtol=1e-5)
