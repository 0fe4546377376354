"""Stages, what is moved and what stays, the box, the decoders, rays that see nothing."""

from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from xrdslam.algorithms.nice_slam.config import NiceSlamConfig, NiceSlamMapConfig, NiceSlamMappingConfig
from xrdslam.algorithms.nice_slam.decoders import OWN, geometry_decoders, published_state
from xrdslam.algorithms.nice_slam.frustum import seen_by
from xrdslam.algorithms.nice_slam.losses import tracking_losses
from xrdslam.algorithms.nice_slam.mapping import NiceSlamMapping, level_of
from xrdslam.algorithms.nice_slam.model import NiceSlamMap, bounds_of
from xrdslam.algorithms.nice_slam.rays import exit_depths, see
from xrdslam.core.algorithm import Scene
from xrdslam.core.batch import RayBatch
from xrdslam.core.errors import ConfigError, DataError, PluginError
from xrdslam.core.frame import Frame
from xrdslam.core.mapping import MappingProblem
from xrdslam.ops.feature_decoder import FeatureDecoder
from xrdslam.ops.volume_rendering import Composite
from xrdslam.testing import toy_sequence
from xrdslam.testing.toy_method import toy_algorithm


def _frame(index: int = 0) -> Frame:
    frame = toy_sequence(num_frames=index + 1)[index]
    frame.pose.set_(frame.T_world_camera_gt)
    return frame


def _map(**settings: object) -> NiceSlamMap:
    config = NiceSlamMapConfig(num_uniform=6, num_near_surface=6, **settings)
    frame = _frame()
    return NiceSlamMap(config, bounds_of(frame, frame.pose.matrix().detach(), config.margin_m))


@pytest.mark.parametrize(("iterations", "counts"), [(60, (25, 12, 23)), (1500, (601, 300, 599))])
def test_stages_have_the_published_lengths(iterations: int, counts: tuple[int, int, int]) -> None:
    levels = [level_of(i, iterations, 0.4, 0.6) for i in range(iterations)]
    assert tuple(levels.count(level) for level in ("middle", "fine", "color")) == counts
    assert [level_of(i, 60, 0.0, 0.0) for i in range(60)].count("middle") == 1, "refinement begins with one"


def test_rates_follow_the_stages_and_the_first_frames_factor() -> None:
    model, frame = _map(), _frame()
    mapping = NiceSlamMapping(NiceSlamMappingConfig(first_lr_factor=5.0))
    for is_first, factor in ((False, 1.0), (True, 5.0)):
        problem = MappingProblem(model, [frame], is_first, 0)
        problem.memory["values"] = model.choose([frame], 0.5)
        starts = [0, 25, 37] if not is_first else [0, 601, 901]
        rates = {g.name: [g.lr * g.schedule(i) for i in starts] for g in mapping.groups(problem)}
        expected = {
            "middle": [0.02, 5e-3, 5e-3],
            "fine": [0, 5e-3, 5e-3],
            "color": [0, 0, 5e-3],
            "decoder": [0, 0, 5e-3],
        }
        for name, values in expected.items():
            assert rates[name] == pytest.approx([factor * v for v in values]), name
        model.settle()


def test_mapping_moves_the_vertices_that_the_frame_sees_and_no_others() -> None:
    model, frame = _map(), _frame()
    before = [grid.table.detach().clone() for grid in model.field.grids]
    frozen = {k: v.clone() for k, v in model.field.state_dict().items() if "middle_decoder" in k or "fine_decoder" in k}
    NiceSlamMapping(NiceSlamMappingConfig(first_iterations=10, num_pixels=100)).map(frame, model, [])
    for grid, old in zip(model.field.grids, before, strict=True):
        seen = seen_by(grid.layout.vertices(), frame, 0.5)
        changed = (grid.table != old).any(1)
        assert bool(changed.any())
        assert not bool((changed & ~seen).any())
    assert all(torch.equal(v, model.field.state_dict()[k]) for k, v in frozen.items()), (
        "decoders of geometry are frozen"
    )


def test_what_is_near_to_the_camera_is_seen_and_what_is_far_behind_the_surface_is_not() -> None:
    frame = _frame()
    pose = frame.T_world_camera_gt
    middle = frame.depth[24, 32]
    z = torch.tensor([-0.4, -0.6, float(middle) + 0.4, float(middle) + 0.6])
    points = pose[:3, 3] + z[:, None] * pose[:3, 2]
    assert seen_by(points, frame, 0.5).tolist() == [True, False, True, False]


def test_the_box_grows_and_features_stay_where_they_are() -> None:
    model = _map()
    point = _frame().T_world_camera_gt[None, :3, 3].clone()
    before = model.field.middle(point)
    far = _frame()
    far.pose.set_(torch.tensor([[1.0, 0, 0, 3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]) @ far.T_world_camera_gt)
    low, high = model.bounds.clone()
    assert model.extend(far, far.pose.matrix().detach()) > 0
    assert float(model.bounds[1, 0] - high[0]) == pytest.approx(3.0, abs=0.05)
    assert torch.equal(model.bounds[0], low)
    torch.testing.assert_close(model.field.middle(point), before)


def test_rays_without_depth_and_rays_outside_the_box_are_no_numbers_that_are_not() -> None:
    model = _map()
    model.extend(_frame(), _frame().T_world_camera_gt)
    origins = torch.tensor([[0.0, 0, 0], [100.0, 0, 0]]).expand(2, 3)
    for rows, depth in ((slice(0, 1), 0.0), (slice(1, 2), 1.0), (slice(0, 2), 0.0), (slice(0, 0), 0.0)):
        o = origins[rows]
        batch = RayBatch(
            o, torch.ones_like(o), torch.ones_like(o), torch.full((len(o),), depth), torch.zeros(len(o)).long()
        )
        for stage in ("mapping", "tracking"):
            assert all(bool(torch.isfinite(v)) for v in model.losses(batch, stage).values())


def test_the_fine_level_pulls_on_the_middle_grid_through_the_middle_decoder_only() -> None:
    field = _map().field
    points = _frame().T_world_camera_gt[None, :3, 3] + 0.3 * torch.rand(20, 3)
    (both,) = torch.autograd.grad(field.logits(points, "fine").sum(), field.middle.table)
    (alone,) = torch.autograd.grad(field.logits(points, "middle").sum(), field.middle.table)
    torch.testing.assert_close(both, alone)


def test_beyond_the_box_everything_is_solid() -> None:
    model = _map()
    origin, direction = _frame().T_world_camera_gt[None, :3, 3], torch.tensor([[0.0, 0.0, 1.0]])
    end = exit_depths(origin, direction, model.bounds)
    depths = torch.stack((end + 0.01, end + 5), 1)
    seen = see(model.field, origin, direction, depths, end, "fine")
    assert float(seen.opacity.detach()) == pytest.approx(1.0, abs=1e-6)
    assert float(seen.depth.detach()) == pytest.approx(float(end) + 0.01, abs=1e-3)


def test_outliers_do_not_count_in_tracking() -> None:
    depth = torch.full((50,), 2.0)
    depth[::10] += 1.0
    seen = Composite(torch.zeros(50, 3), torch.full((50,), 2.01), torch.full((50,), 1e-4), torch.ones(50))
    found = tracking_losses(seen, torch.ones(50, 3), depth, 10.0)
    assert float(found.depth) == pytest.approx(45 * 1.0, rel=1e-3), "each by its deviation of a centimetre"
    assert float(found.rgb) == pytest.approx(45 * 3)


def test_our_decoders_take_featureless_space_for_transparent() -> None:
    decoders = geometry_decoders(None)
    points = 16 * torch.rand(2000, 3, generator=torch.Generator().manual_seed(0)) - 8
    features = 1e-2 * torch.randn(2000, 32, generator=torch.Generator().manual_seed(1))
    occupancy = torch.sigmoid(10 * decoders.middle(points, features))
    assert float(occupancy.median()) < 0.2
    assert not any(p.requires_grad for p in decoders.middle.parameters())


def test_a_published_checkpoint_is_read_by_its_keys_and_checked_by_its_sum(tmp_path: Path) -> None:
    middle, fine = FeatureDecoder(32, 1), FeatureDecoder(64, 1)
    model = {f"decoder.coarse.{k}": v for k, v in middle.state_dict().items()}
    model |= {f"decoder.fine.{k}": v for k, v in fine.state_dict().items()} | {"encoder.x": torch.zeros(1)}
    path = tmp_path / "middle_fine.pt"
    torch.save({"model": model}, path)
    states = published_state(torch.load(path, weights_only=True))
    for decoder, level in ((FeatureDecoder(32, 1), "middle"), (FeatureDecoder(64, 1), "fine")):
        decoder.load_state_dict(states[level])
    with pytest.raises(DataError, match="SHA-256"):
        geometry_decoders(str(path))
    with pytest.raises(ConfigError, match="no such file"):
        geometry_decoders(str(tmp_path / "none.pt"))


def test_our_decoders_are_what_the_file_says() -> None:
    assert sum(v.numel() for v in load_file(OWN).values()) == 15_800 + 20_920


def test_a_map_without_levels_is_refused() -> None:
    data, algorithm = toy_sequence(num_frames=1), toy_algorithm()
    algorithm.start(Scene.of(data), data[0])
    with pytest.raises(PluginError, match="level by level"):
        NiceSlamMapping(NiceSlamMappingConfig()).map(_frame(), algorithm.model, [])


@pytest.mark.parametrize("bounds", [[0.0] * 3, [0.0, 0.0, 0.0, 1.0, 0.0, 1.0]])
def test_bounds_that_are_no_box_are_refused(bounds: list[float]) -> None:
    with pytest.raises(ConfigError, match=r"algo\.map\.bounds"):
        NiceSlamMapConfig(bounds=bounds)


def test_the_published_counts_are_the_defaults() -> None:
    config = NiceSlamConfig()
    assert (config.map_every, config.keyframe_every, config.mapping.window) == (5, 50, 5)
    assert (config.tracking.iterations, config.tracking.num_pixels) == (10, 200)
    assert (config.mapping.first_iterations, config.mapping.iterations, config.mapping.num_pixels) == (1500, 60, 1000)
