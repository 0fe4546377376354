"""Surfaces whose figures can be worked out by hand: rooms and spheres with offsets and holes; and their protocol."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from xrdslam.core.camera import Camera
from xrdslam.core.surface import TriangleMesh
from xrdslam.evaluation import Alignment, EvaluationConfig, EvaluationError, Trajectories
from xrdslam.evaluation.culling import DepthView, seen, seen_under
from xrdslam.evaluation.icp import point_to_point
from xrdslam.evaluation.mesh_depth import mesh_depth_error
from xrdslam.evaluation.metrics import MetricGroup
from xrdslam.evaluation.reconstruction import compare_surfaces, moved, sampled
from xrdslam.evaluation.surface_group import reconstruction_group
from xrdslam.evaluation.virtual_views import CAMERA, cast_depth, virtual_views
from xrdslam.ops.ray_mesh import RayMesh

LENS = Camera(40.0, 40.0, 39.5, 29.5, 80, 60)
SAMPLES = 20_000


def box(half: tuple[float, float, float], centre: tuple[float, float, float] = (0, 0, 0)) -> TriangleMesh:
    """Return the twelve triangles of a box."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half + centre
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [[q[0], q[k], q[k + 1]] for q in quads for k in (1, 2)]
    return TriangleMesh(corners.astype(np.float32), np.array(faces))


def sphere(radius: float, rows: int = 64) -> TriangleMesh:
    theta, phi = np.meshgrid(np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, 2 * rows + 1), indexing="ij")
    points = radius * np.stack((np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), -1)
    a = (np.arange(rows)[:, None] * (2 * rows + 1) + np.arange(2 * rows)).ravel()
    faces = np.concatenate(
        (np.stack((a, a + 1, a + 2 * rows + 2), 1), np.stack((a, a + 2 * rows + 2, a + 2 * rows + 1), 1))
    )
    return TriangleMesh(points.reshape(-1, 3).astype(np.float32), faces)


def without(mesh: TriangleMesh, *faces: int) -> TriangleMesh:
    return TriangleMesh(mesh.vertices, np.delete(mesh.faces, faces, 0))


def look(yaw: float, place: tuple[float, float, float] = (0, 0, 0), pitch: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("yx", [yaw, pitch]).as_matrix()
    pose[:3, 3] = place
    return pose


def around(mesh: TriangleMesh, places: tuple[tuple[float, float, float], ...] = ((0, 0, 0),)) -> list[DepthView]:
    """Return exact depth to every side, up and down, from each place."""
    poses = [look(k * math.pi / 3, place, pitch) for place in places for k in range(6) for pitch in (-0.9, 0.0, 0.9)]
    tree = RayMesh(mesh)
    return [DepthView(LENS, pose, cast_depth(tree, LENS, pose).astype(np.float32)) for pose in poses]


ROOM = box((2.0, 1.5, 2.5))
VIEWS = around(ROOM)
EVERYTHING = seen_under("frustum", VIEWS, [], 0.06)


def everywhere(points: np.ndarray) -> np.ndarray:
    return np.ones(len(points), np.bool_)


def figures(estimate: TriangleMesh, truth: TriangleMesh, seed: int = 0) -> dict[str, float]:
    group = MetricGroup("reconstruction")
    compare_surfaces(estimate, truth, everywhere, SAMPLES, seed).add_to(group)
    return {key: float(value) for key, value in group.values.items() if value is not None}


@pytest.mark.parametrize("offset", [0.003, 0.03, -0.08])
def test_a_sphere_of_another_radius_is_off_by_the_difference(offset: float) -> None:
    """From a sample to the nearest of 100000 on 12.6 m^2 is an offset d and, across, on average 1 / (2 sqrt(density)),
    0.56 cm: the root of the sum of squares, within the 0.5 mm that 64 rows of triangles lie inside the sphere."""
    found = figures(sphere(1 + offset), sphere(1))
    across = 0.5 / math.sqrt(5 * SAMPLES / (4 * math.pi))
    expected_cm = 100 * math.hypot(offset, across)
    assert found["accuracy_cm"] == pytest.approx(expected_cm, abs=0.1)
    assert found["completion_cm"] == pytest.approx(expected_cm, abs=0.1)
    assert found["f_score_5cm_percent"] == (100 if abs(offset) < 0.04 else 0)
    assert (found["f_score_1cm_percent"] > 80) == (abs(offset) < 0.01)


def test_a_box_without_one_side_has_that_sides_share_missing() -> None:
    """A cube without a face: recall is the other five, and the samples of the sixth within reach of its edges."""
    cube = box((1, 1, 1))
    found = figures(without(cube, 0, 1), cube)
    assert found["precision_5cm_percent"] == 100
    rim = 1 - (1.9 / 2) ** 2  # 5 cm along the four edges of a side of 2 m
    assert found["recall_5cm_percent"] == pytest.approx(100 * (5 + rim) / 6, abs=0.5)
    precision, recall = found["precision_5cm_percent"], found["recall_5cm_percent"]
    assert found["f_score_5cm_percent"] == pytest.approx(2 * precision * recall / (precision + recall))
    # a point of the missing side at distance r from its nearest edge: the mean over a square of side 2 is a third
    assert found["completion_cm"] == pytest.approx((5 * 0.3 + 100 / 3) / 6, abs=1.0)


def test_distances_are_those_of_every_pair() -> None:
    """The kd-tree by brute force."""
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(300, 3)), rng.normal(size=(400, 3))
    expected = np.linalg.norm(a[:, None] - b[None], axis=2).min(1)
    np.testing.assert_allclose(cKDTree(b).query(a)[0], expected, atol=1e-12)
    few = compare_surfaces(sphere(1, 8), sphere(1.1, 8), everywhere, 50, seed=3)
    drawn = np.random.default_rng(3)
    found, true = (sampled(mesh, 250, drawn) for mesh in (sphere(1, 8), sphere(1.1, 8)))
    to_truth = np.linalg.norm(found[:50, None] - true[None], axis=2).min(1)
    np.testing.assert_allclose(few.to_truth_m, to_truth, atol=1e-12)
    to_estimate = np.linalg.norm(true[:50, None] - found[None], axis=2).min(1)
    np.testing.assert_allclose(few.to_estimate_m, to_estimate, atol=1e-12)


# Mesh depth from virtual views


def depth_error(estimate: TriangleMesh, count: int = 20, seed: int = 0) -> tuple[float, float]:
    by_frames = seen_under("frustum_occlusion", VIEWS, [], 0.06)
    views, counted = virtual_views(RayMesh(ROOM), VIEWS, by_frames, count, seed)
    error = mesh_depth_error(estimate, views, counted)
    return 100 * float(error.l1_m.mean()), 100 * float(error.missing.mean())


def test_the_true_mesh_has_no_depth_error() -> None:
    l1_cm, missing = depth_error(ROOM)
    assert l1_cm < 1e-4  # depth is kept in float32
    assert missing == 0


def test_a_missing_wall_costs_its_whole_depth() -> None:
    """Pixels of the wall z = 2.5 lose their depth, in full; every other stays exact."""
    faces = [k for k, face in enumerate(ROOM.faces) if (ROOM.vertices[face][:, 2] > 2).all()]
    assert len(faces) == 2
    by_frames = seen_under("frustum_occlusion", VIEWS, [], 0.06)
    views, counted = virtual_views(RayMesh(ROOM), VIEWS, by_frames, 20, 0)
    expected, share = [], []
    for view, is_counted in zip(views, counted, strict=True):
        v, u = np.nonzero(is_counted)
        depth = view.depth[v, u].astype(np.float64)
        rays = np.stack(((u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(len(u))), 1)
        points = (rays * depth[:, None]) @ view.T_world_camera[:3, :3].T + view.T_world_camera[:3, 3]
        on_wall = points[:, 2] > 2.5 - 1e-4
        expected.append((depth * on_wall).sum() / len(depth))
        share.append(on_wall.mean())
    l1_cm, missing = depth_error(without(ROOM, *faces))
    assert missing == pytest.approx(100 * np.mean(share), abs=0.05)  # a ray along the rim may go either way
    assert l1_cm == pytest.approx(100 * np.mean(expected), rel=0.005)
    assert l1_cm > 10


def test_an_empty_mesh_has_the_mean_depth_as_its_error() -> None:
    empty = TriangleMesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int64))
    l1_cm, missing = depth_error(empty)
    assert missing == 100
    assert 100 < l1_cm < 450


def test_virtual_views_are_seeded_inside_the_room_and_turned_as_the_camera_was() -> None:
    by_frames = seen_under("frustum_occlusion", VIEWS, [], 0.06)
    first, again, other = (virtual_views(RayMesh(ROOM), VIEWS, by_frames, 12, seed)[0] for seed in (0, 0, 1))
    poses = [np.stack([view.T_world_camera for view in views]) for views in (first, again, other)]
    assert np.array_equal(poses[0], poses[1])
    assert not np.allclose(poses[0], poses[2])
    assert (np.abs(poses[0][:, :3, 3]) < [2.0, 1.5, 2.5]).all()
    np.testing.assert_allclose(
        poses[0][:, :3, :3] @ poses[0][:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (12, 1, 1)), atol=1e-12
    )
    assert np.linalg.det(poses[0][:, :3, :3]).min() > 0.999
    assert len(np.unique(poses[0][:, 0, 3])) == 12


def test_pixels_count_whose_true_surface_some_frame_saw() -> None:
    """One frame looks along +z: what a virtual view sees of the wall behind it does not count."""
    one = [VIEWS[1]]
    by_frame = seen_under("frustum_occlusion", one, [], 0.06)
    views, counted = virtual_views(RayMesh(ROOM), one, by_frame, 8, 0)
    for view, is_counted in zip(views, counted, strict=True):
        v, u = np.nonzero(is_counted)
        rays = np.stack(((u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(len(u))), 1)
        points = (rays * view.depth[v, u, None]) @ view.T_world_camera[:3, :3].T + view.T_world_camera[:3, 3]
        assert seen(points, one, 0.06).all()
        assert is_counted.mean() >= 0.5
    assert min(is_counted.mean() for is_counted in counted) < 1


def test_views_of_a_mesh_in_another_world_are_refused() -> None:
    by_frames = seen_under("frustum_occlusion", VIEWS, [], 0.06)
    with pytest.raises(EvaluationError, match="0 of 5 virtual views"):
        virtual_views(RayMesh(box((1, 1, 1), (50, 0, 0))), VIEWS, by_frames, 5, 0)


# What counts


def test_the_three_protocols_differ_where_they_should() -> None:
    """A screen at z = 1 hides the wall behind it from the frame in the middle; a view from beside it does not mind."""
    screen = TriangleMesh(
        np.array([[-0.5, -1.4, 1], [0.5, -1.4, 1], [0.5, 1.4, 1], [-0.5, 1.4, 1]], np.float32),
        np.array([[0, 1, 2], [0, 2, 3]]),
    )
    scene = TriangleMesh(
        np.concatenate((ROOM.vertices, screen.vertices)), np.concatenate((ROOM.faces, screen.faces + 8))
    )
    frame = DepthView(LENS, look(0.0), cast_depth(RayMesh(scene), LENS, look(0.0)).astype(np.float32))
    beside_pose = look(0.6, (-1.5, 0.0, 1.2))
    beside = DepthView(LENS, beside_pose, cast_depth(RayMesh(scene), LENS, beside_pose).astype(np.float32))
    hidden, behind, plain = [0.2, 0.0, 2.5], [0.0, 0.0, -2.5], [1.4, 0.0, 2.5]
    points = np.array([hidden, behind, plain])
    answers = {
        name: seen_under(name, [frame], [beside], 0.06)(points).tolist()
        for name in ("frustum", "frustum_occlusion", "virtual_cameras")
    }
    assert answers == {
        "frustum": [True, False, True],
        "frustum_occlusion": [False, False, True],
        "virtual_cameras": [True, False, True],
    }


# ICP and alignment


def test_icp_undoes_a_small_motion_and_says_how_far_it_went() -> None:
    rng = np.random.default_rng(0)
    target = sampled(ROOM, 40_000, rng)
    source = sampled(ROOM, 4_000, rng)
    turn = Rotation.from_rotvec([0.0, 0.01, 0.005]).as_matrix()
    shift = np.array([0.03, -0.02, 0.01])
    result = point_to_point(source @ turn.T + shift, target)
    np.testing.assert_allclose(result.alignment.apply(source @ turn.T + shift), source, atol=0.01)
    assert result.rotation_deg == pytest.approx(np.degrees(np.hypot(0.01, 0.005)), abs=0.1)
    assert result.matched_share > 0.99
    assert result.alignment.scale == 1.0


def test_icp_leaves_what_fits_and_refuses_what_is_out_of_reach() -> None:
    target = sampled(ROOM, 5_000, np.random.default_rng(0))
    result = point_to_point(target, target)
    np.testing.assert_allclose(result.alignment.rotation, np.eye(3), atol=1e-12)
    assert result.iterations == 1
    with pytest.raises(EvaluationError, match="0 of 5000 points"):
        point_to_point(target + 50.0, target)


def walked(scale: float = 1.0) -> Trajectories:
    """Return a run that saw the room at `scale` of its size, turned and moved."""
    truth = np.tile(np.eye(4), (9, 1, 1))
    t = np.linspace(0, 5, 9)
    truth[:, :3, 3] = np.stack((np.sin(t), 0.3 * np.cos(2 * t), 0.4 * t), 1)
    estimate = truth.copy()
    estimate[:, :3, 3] = OTHER_WORLD.apply(truth[:, :3, 3]) * scale
    estimate[:, :3, :3] = OTHER_WORLD.rotation @ truth[:, :3, :3]
    return Trajectories(estimate, estimate, truth)


OTHER_WORLD = Alignment(1.0, Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix(), np.array([1.0, 2.0, -3.0]))


def grouped(folder: Path, scale: float = 1.0, shift: float = 0.0, **settings: object) -> MetricGroup:
    estimate = moved(ROOM, Alignment(scale, OTHER_WORLD.rotation, scale * OTHER_WORLD.translation))
    estimate = TriangleMesh((estimate.vertices + shift).astype(np.float32), estimate.faces)
    estimate.write(folder / "mesh.ply")
    ROOM.write(folder / "true.ply")
    config = EvaluationConfig(mesh_samples=3000, virtual_views=5, **settings)  # type: ignore[arg-type]  # of all kinds
    return reconstruction_group(config, folder / "mesh.ply", folder / "true.ply", VIEWS, walked(scale))


def test_the_surface_goes_where_the_trajectory_goes(tmp_path: Path) -> None:
    group = grouped(tmp_path)
    assert float(group.values["accuracy_cm"] or 99) < 5  # measured to 15000 samples on 94 m^2: 0.5 / sqrt(160) = 4 cm
    assert float(group.values["mesh_depth_l1_cm"] or 0) < 0.01
    assert group.protocol["culling"] == "frustum_occlusion"
    assert group.protocol["icp"] == "none"
    assert group.unavailable == {}


def test_a_scale_is_applied_to_the_surface_too(tmp_path: Path) -> None:
    """The published tool corrects the trajectory's scale and leaves the mesh at its own."""
    right = grouped(tmp_path, scale=0.5, alignment="sim3")
    assert float(right.values["mesh_depth_l1_cm"] or 0) < 0.01
    assert right.protocol["alignment_scale"] == pytest.approx(2.0)
    wrong = grouped(tmp_path, scale=0.5, alignment="se3")
    assert wrong.values["mesh_depth_l1_cm"] is None or float(wrong.values["mesh_depth_l1_cm"] or 0) > 20


def test_icp_is_done_when_asked_for_and_said(tmp_path: Path) -> None:
    plain = grouped(tmp_path, shift=0.03)
    assert float(plain.values["mesh_depth_l1_cm"] or 0) > 2
    fitted = grouped(tmp_path, shift=0.03, icp="point_to_point")
    assert float(fitted.values["mesh_depth_l1_cm"] or 0) < 1
    said = fitted.protocol["icp_result"]
    assert isinstance(said, dict)
    assert float(str(said["moved_cm"])) == pytest.approx(3 * math.sqrt(3), abs=1)
    assert said["reach_cm"] == 10


def test_without_views_or_virtual_views_the_rest_is_still_measured(tmp_path: Path) -> None:
    none = grouped(tmp_path)
    config = EvaluationConfig(mesh_samples=3000, virtual_views=0)
    group = reconstruction_group(config, tmp_path / "mesh.ply", tmp_path / "true.ply", VIEWS, walked())
    assert group.values["mesh_depth_l1_cm"] is None
    assert group.values["accuracy_cm"] == none.values["accuracy_cm"]
    nobody = reconstruction_group(config, tmp_path / "mesh.ply", tmp_path / "true.ply", [], walked())
    assert nobody.values["accuracy_cm"] is None
    assert "no frame saw" in nobody.unavailable["accuracy_cm"]
    blind = EvaluationConfig(mesh_samples=3000, virtual_views=2, culling="virtual_cameras")
    assert (
        "no frame has both"
        in reconstruction_group(blind, tmp_path / "mesh.ply", tmp_path / "true.ply", [], walked()).unavailable[
            "accuracy_cm"
        ]
    )
    lost = Trajectories(walked().online, walked().final)
    assert (
        "no ground-truth trajectory"
        in reconstruction_group(config, tmp_path / "mesh.ply", tmp_path / "true.ply", VIEWS, lost).unavailable[
            "accuracy_cm"
        ]
    )


@pytest.mark.parametrize("which", ["mesh.ply", "true.ply"])
def test_a_mesh_with_a_nan_has_no_figures(tmp_path: Path, which: str) -> None:
    grouped(tmp_path)
    broken = ROOM.vertices.copy()
    broken[3, 1] = np.nan
    TriangleMesh(broken, ROOM.faces).write(tmp_path / which)
    config = EvaluationConfig(mesh_samples=3000, virtual_views=2)
    group = reconstruction_group(config, tmp_path / "mesh.ply", tmp_path / "true.ply", VIEWS, walked())
    assert all(value is None for value in group.values.values())
    assert "not finite" in group.unavailable["mesh_depth_l1_cm"]
