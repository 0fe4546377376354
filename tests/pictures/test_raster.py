"""Triangles and points in a depth buffer against closed forms and a slow twin."""

import numpy as np
import pytest

from xrdslam.core.surface import PointCloud, TriangleMesh
from xrdslam.pictures.outside import Drawing, Outside
from xrdslam.pictures.raster import draw_points, draw_triangles

INTRINSICS, SIZE = (40.0, 42.0, 15.5, 11.5), (32, 24)


def rays() -> np.ndarray:
    fx, fy, cx, cy = INTRINSICS
    u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    return np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u)], -1)


def slow_depth(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Cut every ray with every triangle (Moeller and Trumbore)."""
    depth = np.full(SIZE[::-1], np.inf)
    for face in faces:
        a, b, c = points[face]
        d = rays().reshape(-1, 3)
        across = np.cross(d, c - a)
        determinant = across @ (b - a)
        u = (across @ -a) / determinant
        beside = np.cross(-a, b - a)
        v = (d @ beside) / determinant
        t = ((c - a) @ beside) / determinant
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0.02)
        depth = np.minimum(depth, np.where(hit, t, np.inf).reshape(SIZE[::-1]))
    return depth


def test_depths_are_those_of_rays_cut_with_the_triangles() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform([-1, -1, 1.0], [1, 1, 4.0], (60, 3))
    faces = rng.integers(0, 60, (40, 3))
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 0] != faces[:, 2])]
    seen = draw_triangles(points, faces, INTRINSICS, SIZE, is_culled=False)
    expected = slow_depth(points, faces)
    assert np.isfinite(expected).mean() > 0.3
    np.testing.assert_array_equal(np.isfinite(seen.depth), np.isfinite(expected))
    known = np.isfinite(expected)
    np.testing.assert_allclose(seen.depth[known], expected[known], rtol=1e-6)  # kept in float32


def test_only_fronts_of_a_culled_mesh_are_seen() -> None:
    front = np.array([[-1.0, -1, 2], [0, 1, 2], [1, -1, 2]])  # its normal points to the camera
    normal = np.cross(front[1] - front[0], front[2] - front[0])
    assert normal[2] < 0
    faces = np.array([[0, 1, 2]])
    assert (draw_triangles(front, faces, INTRINSICS, SIZE).which >= 0).any()
    assert not (draw_triangles(front, faces[:, ::-1], INTRINSICS, SIZE).which >= 0).any()
    assert (draw_triangles(front, faces[:, ::-1], INTRINSICS, SIZE, is_culled=False).which >= 0).any()


def test_the_nearer_point_is_seen_and_what_is_behind_or_nan_is_not() -> None:
    points = np.array([[0.0, 0, 3], [0, 0, 2], [0, 0, -1], [np.nan, 0, 1], [100, 0, 1]])
    seen = draw_points(points, 0.1, INTRINSICS, SIZE)
    assert set(np.unique(seen.which)) == {-1, 1}
    assert seen.depth[seen.which == 1].max() == 2
    side_px = 2 * 40 * 0.1 / 2
    assert abs((seen.which == 1).sum() ** 0.5 - side_px) <= 1


@pytest.mark.parametrize("turn_deg", [-120.0, 0.0, 50.0])
def test_a_view_from_outside_holds_the_whole_scene_upright(turn_deg: float) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform([-2, -1, -3], [2, 1, 3], (2000, 3))
    looking = np.tile(np.eye(4), (3, 1, 1))  # the cameras' y points down
    view = Outside.behind(points, looking, turn_deg, aspect=1.5)
    pixels = view.pixels(points, 300, 200)
    inside = ((pixels >= 0) & (pixels < [300, 200])).all(1)
    assert inside.mean() > 0.97
    spread = np.ptp(pixels[inside], axis=0) / [300, 200]
    assert spread.max() > 0.6  # and fills it
    top, bottom = view.pixels(np.array([[0.0, -1, 0], [0.0, 1, 0]]), 300, 200)
    assert top[1] < bottom[1]
    assert abs(top[0] - bottom[0]) < 1  # px: verticals beside the middle converge
    np.testing.assert_allclose(view.T_world_camera[:3, :3] @ view.T_world_camera[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(view.T_world_camera[:3, :3]) > 0


def test_a_picture_has_the_colours_of_its_map_on_its_background() -> None:
    view = Outside(np.eye(4))
    red = np.tile([1.0, 0, 0], (3, 1))
    front = np.array([[-9.0, -9, 2], [0, 9, 2], [9, -9, 2]])
    drawing = Drawing(TriangleMesh(front, np.array([[0, 1, 2]]), red), view, (40, 30))
    image = drawing.picture((10, 20, 30))
    assert image.shape == (30, 40, 3)
    assert image[10, 20, 0] > 150  # lit nearly head-on
    assert image[10, 20, 1:].max() == 0
    assert drawing.picture(colors=red[:, ::-1])[10, 20, 0] == 0  # in other colours
    empty = Drawing(PointCloud(np.zeros((0, 3))), view, (40, 30)).picture((10, 20, 30))
    assert (empty == [10, 20, 30]).all()
    green = PointCloud(np.array([[0.0, 0, 2]]), np.array([[0.0, 1, 0]]))
    cloud = Drawing(green, view, (40, 30), point_radius_m=0.3).picture()
    assert cloud[15, 20].tolist() == [0, 255, 0]


def test_cameras_that_looked_everywhere_still_give_a_view() -> None:
    around = np.stack([np.diag([1.0, 1, 1, 1]), np.diag([-1.0, 1, -1, 1])])
    view = Outside.behind(np.random.default_rng(0).normal(size=(50, 3)), around)
    assert np.isfinite(view.T_world_camera).all()
    nothing = Outside.behind(np.zeros((0, 3)), np.full((1, 4, 4), np.nan))
    assert np.isfinite(nothing.T_world_camera).all()
