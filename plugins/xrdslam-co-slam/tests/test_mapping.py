"""Bundle adjustment: what is banked, what moves, what stays, and where moved poses go."""

import pytest
import torch
from torch import Tensor

from xrdslam.algorithms.co_slam.algorithm import CoSlam, bounds_about
from xrdslam.algorithms.co_slam.bank import RayBank, in_world
from xrdslam.algorithms.co_slam.config import CoSlamConfig, CoSlamMapConfig, CoSlamMappingConfig
from xrdslam.algorithms.co_slam.mapping import CoSlamMapping
from xrdslam.algorithms.co_slam.model import CoSlamMap
from xrdslam.core.algorithm import Scene
from xrdslam.core.batch import RayBatch, Stage
from xrdslam.core.errors import ConfigError, PluginError
from xrdslam.core.mapping import MappingProblem
from xrdslam.core.optimisation import GroupedOptimiser
from xrdslam.methods.config import GroundTruthTrackingConfig
from xrdslam.methods.ground_truth import GroundTruthTracking
from xrdslam.testing import toy_sequence
from xrdslam.testing.toy_method import toy_algorithm


def _algorithm(**mapping: object) -> CoSlam:
    small = CoSlamMapConfig(log2_rows=10, voxel_m=0.1, num_uniform=6, num_near_surface=4, smoothness_samples=4)
    settings = {"iterations": 10, "first_iterations": 20, "num_pixels": 200, **mapping}
    config = CoSlamMappingConfig(**settings)
    tracking = GroundTruthTracking(GroundTruthTrackingConfig())
    return CoSlam(CoSlamConfig(map_every=1, keyframe_every=1, map=small), tracking, CoSlamMapping(config))


def _run(algorithm: CoSlam, count: int = 4) -> CoSlam:
    data = toy_sequence(num_frames=count)
    for frame in data:
        algorithm.start(Scene.of(data), frame) if frame.index == 0 else algorithm.track(frame)
        algorithm.map(frame)
    return algorithm


def test_the_bank_holds_a_twentieth_of_each_keyframes_pixels() -> None:
    data, bank = toy_sequence(num_frames=2), RayBank()
    for frame in data:
        bank.add(frame, 0.05, torch.Generator().manual_seed(0))
    pixels = data.camera.width * data.camera.height
    assert len(bank.rays) == 2 * int(0.05 * pixels)
    assert bank.indices == [0, 1]
    first = bank.rays[: int(0.05 * pixels)]
    assert len(torch.unique(first, dim=0)) == len(first), "drawn without replacement"


def test_drawn_rays_are_of_their_slots_however_the_bank_grew() -> None:
    bank = RayBank()
    for k, frame in enumerate(toy_sequence(num_frames=5)):
        if k == 3:
            grown, bank = bank, RayBank()
            bank.load_state_dict(grown.state_dict())
        frame.rgb.fill_(k / 10)
        bank.add(frame, 0.05, torch.Generator().manual_seed(k))
    batch = bank.draw(200, torch.eye(3).expand(5, 3, 3), torch.zeros(5, 3), torch.Generator().manual_seed(0))
    assert set(batch.frame_slot.tolist()) == set(range(5))
    torch.testing.assert_close(batch.rgb[:, 0], batch.frame_slot / 10)


def test_banked_rays_end_where_their_pixels_were_measured() -> None:
    frame = toy_sequence(num_frames=1)[0]
    bank = RayBank()
    bank.add(frame, 0.5, torch.Generator().manual_seed(0))
    pose = frame.T_world_camera_gt
    batch = bank.draw(100, pose[None, :3, :3], pose[None, :3, 3], torch.Generator().manual_seed(1))
    points = batch.origins_world + batch.depth[:, None] * batch.directions_world
    back = (points - pose[:3, 3]) @ pose[:3, :3]
    pixels, depth = frame.camera.project(back)
    column, row = pixels.round().long().unbind(1)
    assert (pixels - pixels.round()).abs().max() < 1e-3
    torch.testing.assert_close(depth, frame.depth[row, column], rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(batch.rgb, frame.rgb[row, column])


def test_gradients_reach_the_poses_of_their_rays_only() -> None:
    rotations, centers = torch.eye(3).repeat(3, 1, 1).requires_grad_(), torch.zeros(3, 3, requires_grad=True)
    rays = torch.randn(10, 7, generator=torch.Generator().manual_seed(0))
    slots = torch.tensor([0] * 5 + [2] * 5)
    batch = in_world(rays, slots, rotations, centers)
    (batch.origins_world.sum() + batch.directions_world.square().sum()).backward()
    assert float(centers.grad[1].abs().max()) == float(rotations.grad[1].abs().max()) == 0
    torch.testing.assert_close(centers.grad[0], torch.full((3,), 5.0))


def test_moved_poses_reach_the_final_trajectory_and_the_first_stays() -> None:
    """In the published framework they stay in the keyframes, and nobody sees them again."""
    algorithm = _run(_algorithm(lr_pose_rotation=1e-2, lr_pose_translation=1e-2))
    online, final = algorithm.trajectory.online(), algorithm.trajectory.current()
    torch.testing.assert_close(torch.as_tensor(online[0]), torch.as_tensor(final[0]), rtol=0, atol=1e-9)
    moved = (torch.as_tensor(online) - torch.as_tensor(final)).abs().amax((1, 2))
    assert (moved[1:] > 1e-4).all(), f"poses moved by {moved.tolist()}"
    for keyframe in algorithm.keyframes:
        there = torch.as_tensor(algorithm.trajectory.pose(keyframe.index)).float()
        torch.testing.assert_close(keyframe.pose.matrix().detach(), there, rtol=0, atol=1e-5)


def test_with_one_keyframe_no_pose_moves() -> None:
    algorithm = _run(_algorithm(lr_pose_rotation=1e-2, lr_pose_translation=1e-2), count=2)
    online, final = (torch.as_tensor(p) for p in (algorithm.trajectory.online(), algorithm.trajectory.current()))
    torch.testing.assert_close(online, final, rtol=0, atol=1e-6)


def test_the_current_pose_stays_where_asked() -> None:
    algorithm = _run(_algorithm(moves_current=False, lr_pose_rotation=1e-2, lr_pose_translation=1e-2), count=3)
    final, online = (torch.as_tensor(p) for p in (algorithm.trajectory.current(), algorithm.trajectory.online()))
    torch.testing.assert_close(final[2], online[2], rtol=0, atol=1e-6)
    assert (final[1] - online[1]).abs().max() > 1e-4


def test_poses_step_twice_in_ten_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[int] = []
    original = GroupedOptimiser.step

    def counted(self: GroupedOptimiser, iteration: int) -> None:
        due = [g.name for g in self.groups if (iteration + 1) % g.accumulate == 0]
        steps.append(due.count("rotations"))
        original(self, iteration)

    monkeypatch.setattr(GroupedOptimiser, "step", counted)
    _run(_algorithm(), count=3)
    assert sum(steps) == 2, "two steps, in the one adjustment with two keyframes"


def test_frames_without_depth_leave_the_map_finite() -> None:
    algorithm = _run(_algorithm(), count=2)
    frame = toy_sequence(num_frames=3)[2]
    frame.depth.zero_()
    frame.pose.set_(frame.T_world_camera_gt)
    algorithm.mapping.map(frame, algorithm.model, algorithm.keyframes)
    assert all(bool(torch.isfinite(p).all()) for p in algorithm.model.parameters())


def test_the_box_holds_the_camera_and_what_it_saw() -> None:
    frame = toy_sequence(num_frames=1)[0]
    frame.pose.set_(frame.T_world_camera_gt)
    low, high = bounds_about(frame)
    points: Tensor = frame.points_camera() @ frame.T_world_camera_gt[:3, :3].T + frame.T_world_camera_gt[:3, 3]
    assert ((points > low) & (points < high)).all()
    assert ((frame.T_world_camera_gt[:3, 3] > low) & (frame.T_world_camera_gt[:3, 3] < high)).all()


def test_a_map_of_whole_images_is_refused_before_the_first_step() -> None:
    algorithm = toy_algorithm()
    algorithm.mapping = CoSlamMapping(CoSlamMappingConfig())
    data = toy_sequence(num_frames=1)
    with pytest.raises(PluginError, match="algo/mapping=co_slam reads rays batches"):
        algorithm.start(Scene.of(data), data[0])


@pytest.mark.parametrize("bounds", [[0.0] * 3, [0.0, 0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0, 0.0, 1.0]])
def test_bounds_that_are_no_box_are_refused(bounds: list[float]) -> None:
    with pytest.raises(ConfigError, match=r"algo\.map\.bounds"):
        CoSlamMapConfig(bounds=bounds)


def test_the_map_settles_on_whole_keyframes_after_the_last_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    algorithm = _run(_algorithm(final_iterations_per_keyframe=2), count=3)
    final, table = algorithm.trajectory.current(), algorithm.model.field.table.detach().clone()
    banked = {tuple(ray) for ray in algorithm.mapping.bank.rays[:, 3:].tolist()}
    drawn: list[RayBatch] = []
    losses = CoSlamMap.losses

    def noted(self: CoSlamMap, batch: RayBatch, stage: Stage) -> dict[str, Tensor]:
        drawn.append(batch)
        return losses(self, batch, stage)

    monkeypatch.setattr(CoSlamMap, "losses", noted)
    algorithm.finish()
    assert len(drawn) == 6
    seen = {tuple(ray) for b in drawn for ray in torch.cat((b.rgb, b.depth[:, None]), 1).tolist()}
    assert len(seen - banked) > len(seen) / 2, "pixels that no keyframe left in the bank"
    assert all(len(b.frame_slot.unique()) == 3 for b in drawn), "of every keyframe"
    assert (algorithm.model.field.table - table).abs().max() > 0
    assert torch.equal(algorithm.trajectory.current(), final)


def test_colour_alone_counts_for_more_while_the_map_settles() -> None:
    data, algorithm = toy_sequence(num_frames=1), _run(_algorithm(final_rgb_factor=4.0), count=1)
    mapping, model, frame = algorithm.mapping, algorithm.model, data[0]
    found = []
    for factor in (1.0, 4.0):
        mapping.config.final_rgb_factor = factor
        mapping.generator.manual_seed(0)
        model.generator.manual_seed(0)
        found.append(mapping.losses(MappingProblem(model, [frame], False, 0, is_final=True), 0))
    plain, settling = found
    assert settling.keys() == plain.keys() == {"rgb", "depth", "sdf", "free_space"}, "nothing is smoothed any more"
    torch.testing.assert_close(settling["rgb"], 4 * plain["rgb"])
    assert all(torch.equal(settling[name], plain[name]) for name in plain.keys() - {"rgb"})
