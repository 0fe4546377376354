"""The eight rooms: closed, furnished with several shapes, no two alike, texture wherever one looks."""

import numpy as np
import pytest

from xrdslam.datasets.synthetic.furniture import block
from xrdslam.datasets.synthetic.lighting import LightingConfig, bake, light_up
from xrdslam.datasets.synthetic.rooms import ROOMS, build_room
from xrdslam.datasets.synthetic.scene import Material, Pattern, Shape
from xrdslam.datasets.synthetic.tracer import render

DIM = LightingConfig(spacing=0.8, light_samples=1, gather_rays=4, bounces=1)


@pytest.mark.parametrize("name", sorted(ROOMS))
def test_a_room_is_furnished_with_several_shapes_inside_its_walls(name: str) -> None:
    room = build_room(name, 0)
    assert room.name == name
    packed = room.pack()
    assert len(room.solids) > 200
    assert (packed.shape == Shape.FRUSTUM).sum() > 20  # round things
    assert ((packed.shape == Shape.BOX) & (packed.size[:, 3] > 0.015)).sum() > 10  # padded things
    assert len({int(p) for p in packed.pattern[:, 0]}) >= 9
    low, high = room.bounds
    assert (packed.centre > low - 0.01).all()
    assert (packed.centre < high + 0.01).all()
    lights = packed.lights[:, :3]
    assert (lights > low).all()
    assert (lights < high).all()


def test_seeds_move_and_paint_but_do_not_rebuild() -> None:
    for name in ROOMS:
        first, again, other = (build_room(name, seed).pack() for seed in (0, 0, 1))
        assert first.digest() == again.digest() != other.digest()
        assert abs(len(first.shape) - len(other.shape)) < 0.35 * len(first.shape)  # books and crockery are counted anew


def test_no_two_rooms_share_size_or_light() -> None:
    rooms = [build_room(name, 0) for name in ROOMS]
    assert (
        len({room.size for room in rooms}) == len({room.lights for room in rooms}) == len({r.pace for r in rooms}) == 8
    )


@pytest.mark.parametrize("name", sorted(ROOMS))
def test_there_is_texture_wherever_one_looks(name: str) -> None:
    """In each of four directions, nearly every patch of 12 x 12 pixels varies by more than a code and a half of 255."""
    scene = build_room(name, 0)
    packed = scene.pack()
    world = light_up(packed, bake(packed, DIM))
    flat = []
    for yaw in np.radians([20.0, 110.0, 200.0, 290.0]):
        T = np.eye(4)
        T[:3, 0] = np.sin(yaw), -np.cos(yaw), 0
        T[:3, 2] = np.cos(yaw) * np.cos(0.2), np.sin(yaw) * np.cos(0.2), -np.sin(0.2)
        T[:3, 1] = np.cross(T[:3, 2], T[:3, 0])
        T[:3, 3] = 0.2, -0.1, 1.6
        rgb, depth = render(world, (60.0, 60.0, 59.5, 41.5), 120, 84, T)
        assert (depth > 0.05).all()
        assert 30 < rgb.mean() < 220
        grey = rgb.mean(2).reshape(7, 12, 10, 12).std(axis=(1, 3))
        flat.append((grey < 1.5).mean())
    assert max(flat) < 0.15


def test_a_rounding_wider_than_the_box_is_our_own_mistake() -> None:
    with pytest.raises(AssertionError):
        block(Material(Pattern.PLAIN, ("#808080",) * 3), (0.4, 0.4, 0.05), (0, 0, 0), 0.1)
