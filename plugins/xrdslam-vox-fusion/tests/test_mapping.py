"""Mapping: what grows, what moves, what stays, where moved poses go; tracking: what is lost."""

import pytest
import torch

from xrdslam.algorithms.vox_fusion.algorithm import VoxFusion
from xrdslam.algorithms.vox_fusion.config import (
    VoxFusionConfig,
    VoxFusionMapConfig,
    VoxFusionMappingConfig,
    VoxFusionTrackingConfig,
)
from xrdslam.algorithms.vox_fusion.mapping import VoxFusionMapping
from xrdslam.algorithms.vox_fusion.model import VoxelMap
from xrdslam.algorithms.vox_fusion.tracking import VoxFusionTracking
from xrdslam.core.algorithm import Scene
from xrdslam.core.errors import ConfigError
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.core.mapping import MappingProblem
from xrdslam.core.optimisation import GroupedOptimiser
from xrdslam.core.trajectory import Trajectory
from xrdslam.methods.config import GroundTruthTrackingConfig
from xrdslam.methods.ground_truth import GroundTruthTracking
from xrdslam.testing import toy_sequence
from xrdslam.testing.toy_room import BALLS, WALLS


def _map(**settings: object) -> VoxFusionMapConfig:
    return VoxFusionMapConfig(**{"width": 16, "rows": 3000, "step_m": 0.05, "truncation_m": 0.1, **settings})


def _algorithm(rows: int = 3000, **mapping: object) -> VoxFusion:
    settings = {"iterations": 3, "first_iterations": 10, "num_pixels": 60, **mapping}
    tracking = GroundTruthTracking(GroundTruthTrackingConfig())
    config = VoxFusionConfig(keyframe_every=2, map=_map(rows=rows))
    return VoxFusion(config, tracking, VoxFusionMapping(VoxFusionMappingConfig(**settings)))


def _run(algorithm: VoxFusion, count: int = 5) -> VoxFusion:
    data = toy_sequence(num_frames=count)
    for frame in data:
        algorithm.start(Scene.of(data), frame) if frame.index == 0 else algorithm.track(frame)
        algorithm.map(frame)
    return algorithm


def _frames(count: int) -> list[Frame]:
    frames = list(toy_sequence(num_frames=count))
    for frame in frames:
        frame.pose.set_(frame.T_world_camera_gt)
    return frames


def test_a_frames_voxels_are_there_before_it_is_fitted_and_nowhere_else(monkeypatch: pytest.MonkeyPatch) -> None:
    covered: list[float] = []
    original = VoxFusionMapping.optimise

    def noted(self: VoxFusionMapping, problem: MappingProblem) -> object:
        frame = problem.window[-1]
        points = se3.transform(frame.pose.matrix().detach(), frame.points_camera())
        covered.append(float((problem.model.grid.locate(points, 1e-4) >= 0).float().mean()))
        return original(self, problem)

    monkeypatch.setattr(VoxFusionMapping, "optimise", noted)
    model = _run(_algorithm(), count=3).model
    assert covered == [1.0] * 3
    assert isinstance(model, VoxelMap)
    middles = (model.coords + 0.5) * 0.2
    to_walls = torch.minimum(middles - WALLS[0], WALLS[1] - middles).amin(1)
    to_balls = ((middles[:, None] - BALLS[:, :3]).norm(dim=2) - BALLS[:, 3]).abs().amin(1)
    assert torch.minimum(to_walls, to_balls).max() < 0.1 * 3**0.5 + 1e-3, "half a voxel's diagonal"
    assert int(model.coords.min()) < 0, "coordinates may be negative"


def test_a_measurement_farther_than_the_largest_depth_makes_no_voxel() -> None:
    frame = _frames(1)[0]
    near, all_of_it = VoxelMap(_map(max_depth_m=2.0)), VoxelMap(_map())
    assert 0 < near.extend(frame, frame.T_world_camera_gt) < all_of_it.extend(frame, frame.T_world_camera_gt)


def test_the_table_grows_and_its_rows_stay() -> None:
    model, frames = VoxelMap(_map(rows=50)), _frames(5)
    model.extend(frames[0], frames[0].T_world_camera_gt)
    before = model.table.detach().clone()
    assert len(before) >= model.grid.num_vertices > 50
    behind = frames[4].T_world_camera_gt.clone()
    behind[:3, :3] = behind[:3, :3] @ torch.diag(torch.tensor([-1.0, 1.0, -1.0]))
    model.extend(frames[4], behind)
    assert len(model.table) > len(before)
    assert torch.equal(model.table[: len(before)], before)


def test_moments_follow_a_table_that_grows() -> None:
    mapping, model = (
        VoxFusionMapping(VoxFusionMappingConfig(first_iterations=5, num_pixels=60)),
        VoxelMap(_map(rows=50)),
    )
    frames = _frames(3)
    mapping.map(frames[0], model, [])
    old, held = model.table, mapping._optimiser
    assert isinstance(held, GroupedOptimiser)
    moments = held.moments(old)["exp_avg"].clone()
    step = held.moments(old)["step"].clone()
    far = frames[1].T_world_camera_gt.clone()
    far[:3, 3] += 30.0
    model.extend(frames[1], far)
    assert model.table is not old
    problem = MappingProblem(model, [frames[0]], False, 0)
    found = mapping.optimiser(problem).moments(model.table)
    assert torch.equal(found["exp_avg"][: len(old)], moments)
    assert bool((found["exp_avg"][len(old) :] == 0).all())
    assert found["step"] == step == 5
    assert bool((moments != 0).any())


def test_adam_goes_on_from_frame_to_frame() -> None:
    algorithm = _run(_algorithm(), count=3)
    model, optimiser = algorithm.model, algorithm.mapping._optimiser
    assert isinstance(model, VoxelMap)
    assert int(optimiser.moments(model.table)["step"]) == 10 + 3 + 3


def test_moved_poses_reach_the_final_trajectory_and_the_first_stays() -> None:
    algorithm = _run(_algorithm())
    online, final = algorithm.trajectory.online(), algorithm.trajectory.current()
    torch.testing.assert_close(online[0], final[0], rtol=0, atol=1e-9)
    moved = (online - final).abs().amax((1, 2))
    assert (moved[1:] > 1e-5).all(), f"poses moved by {moved.tolist()}"
    for keyframe in algorithm.keyframes:
        there = algorithm.trajectory.pose(keyframe.index).float()
        torch.testing.assert_close(keyframe.pose.matrix().detach(), there, rtol=0, atol=1e-5)


def test_without_rates_no_pose_moves() -> None:
    algorithm = _run(_algorithm(lr_pose_rotation=0.0, lr_pose_translation=0.0))
    torch.testing.assert_close(algorithm.trajectory.online(), algorithm.trajectory.current(), rtol=0, atol=1e-6)


def test_the_window_is_of_a_few_random_keyframes_with_as_many_rays_each() -> None:
    mapping, model, frames = VoxFusionMapping(VoxFusionMappingConfig(num_pixels=33)), VoxelMap(_map()), _frames(12)
    windows = [mapping.select(frames[11], frames[:11]) for _ in range(20)]
    assert {len(window) for window in windows} == {5}
    assert all(window[-1] is frames[11] for window in windows)
    assert len({frame.index for window in windows for frame in window}) == 12, "every keyframe has its turn"
    problem = MappingProblem(model, windows[0], False, 0)
    slots = mapping.batch(problem).frame_slot
    assert torch.bincount(slots).tolist() == [33] * 5


def test_frames_and_views_without_depth_leave_the_map_finite() -> None:
    algorithm = _run(_algorithm(), count=2)
    frame = _frames(3)[2]
    frame.depth.zero_()
    algorithm.mapping.map(frame, algorithm.model, algorithm.keyframes)
    assert all(bool(torch.isfinite(p).all()) for p in algorithm.model.parameters())


def test_a_frame_that_looks_beside_the_map_is_lost_and_said_to_be() -> None:
    model, frames = VoxelMap(_map()), _frames(2)
    tracking = VoxFusionTracking(VoxFusionTrackingConfig(iterations=2, num_pixels=50))
    model.extend(frames[0], frames[0].T_world_camera_gt)
    there = tracking.track(frames[1], model, Trajectory())
    assert not there.is_lost
    beside = frames[1].T_world_camera_gt.clone()
    beside[:3, 3] += 100.0
    frames[1].pose.set_(beside)
    result = tracking.track(frames[1], model, Trajectory())
    assert result.is_lost
    assert "0 % of what was measured" in result.reason
    torch.testing.assert_close(result.T_world_camera, beside)


def test_the_first_frames_budget_fits_it() -> None:
    """From a depth that is wherever the voxels begin, and grey, to the room's depth and some of its colours."""
    settings = {"iterations": 1, "first_iterations": 160, "num_pixels": 250}
    model, frame = VoxelMap(_map(width=32, weight_rgb=5.0)), _frames(1)[0]
    VoxFusionMapping(VoxFusionMappingConfig(**settings)).map(frame, model, [])
    seen = model.render(frame.camera, frame.T_world_camera_gt)
    both = (seen.depth > 0) & (frame.depth > 0)
    assert both.float().mean() > 0.99, "every ray of the frame meets a surface"
    assert float((seen.depth - frame.depth)[both].abs().mean()) < 0.025
    flat = frame.rgb.std(dim=(0, 1)).square().mean()  # the error of the frame's mean colour
    assert float((seen.rgb - frame.rgb).square().mean()) < 0.6 * flat


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"precision": "float16"}, "precision"),
        ({"mesh_resolution": 7}, "mesh_resolution"),
        ({"voxel_m": 0.0}, "voxel_m"),
        ({"max_samples": 0}, "max_samples"),
        ({"min_color_weight": 1.0}, "min_color_weight"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, object], key: str) -> None:
    with pytest.raises(ConfigError, match=rf"algo\.map\.{key}"):
        VoxFusionMapConfig(**settings)


def test_bfloat16_gives_nearly_the_same_field() -> None:
    """Eight bits of mantissa: 0.4 % of a value of about one, and no parameter changes its type."""
    frames = _frames(1)
    fields = []
    for precision in ("float32", "bfloat16"):
        model = VoxelMap(_map(precision=precision))
        model.extend(frames[0], frames[0].T_world_camera_gt)
        fields.append(model.render(frames[0].camera, frames[0].T_world_camera_gt))
        assert all(p.dtype == torch.float32 for p in model.parameters())
    torch.testing.assert_close(fields[0].rgb, fields[1].rgb, rtol=0, atol=0.02)
