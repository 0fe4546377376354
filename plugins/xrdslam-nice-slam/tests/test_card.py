"""What the method is known by: its renderer, its gradients, one room mapped and tracked in, outliers, its sizes."""

import os
from pathlib import Path

import pytest
import torch

from xrdslam.algorithms.nice_slam.config import NiceSlamMapConfig, NiceSlamMappingConfig, NiceSlamTrackingConfig
from xrdslam.algorithms.nice_slam.losses import tracking_losses
from xrdslam.algorithms.nice_slam.mapping import NiceSlamMapping
from xrdslam.algorithms.nice_slam.model import NiceSlamMap, bounds_of
from xrdslam.algorithms.nice_slam.rays import SOLID, exit_depths, sample_depths, see
from xrdslam.algorithms.nice_slam.tracking import NiceSlamTracking
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import so3
from xrdslam.core.trajectory import Trajectory
from xrdslam.ops.feature_decoder import FeatureDecoder, decode_features_torch
from xrdslam.ops.volume_rendering import Composite, composite, occupancy_weights
from xrdslam.testing import toy_sequence


def _frame(index: int = 0) -> Frame:
    frame = toy_sequence(num_frames=2, width=160, height=120)[index]
    frame.pose.set_(frame.T_world_camera_gt)
    return frame


@pytest.fixture(scope="module")
def room() -> NiceSlamMap:
    """One frame of the toy room, mapped with the decoders of the package."""
    frame, config = _frame(), NiceSlamMapConfig(render_step_m=0.05)
    model = NiceSlamMap(config, bounds_of(frame, frame.pose.matrix().detach(), config.margin_m))
    NiceSlamMapping(NiceSlamMappingConfig(first_iterations=300, num_pixels=600)).map(frame, model, [])
    return model


@pytest.mark.parametrize("k", [0, 3, 7])
def test_a_ray_ends_at_the_one_solid_sample(k: int) -> None:
    depths = torch.linspace(0.5, 4, 8)[None]
    logits = torch.full((1, 8), -SOLID)
    logits[0, k] = SOLID
    seen = composite(occupancy_weights(logits), torch.rand(1, 8, 3), depths)
    assert float(seen.depth) == pytest.approx(float(depths[0, k]), rel=1e-6)
    assert float(seen.variance) == pytest.approx(0, abs=1e-9)
    assert float(seen.opacity) == pytest.approx(1)


def test_a_ray_that_meets_nothing_has_no_depth_and_weights_never_pass_one() -> None:
    depths = torch.linspace(0.5, 4, 8).expand(100, 8)
    empty = composite(occupancy_weights(torch.full((100, 8), -SOLID)), torch.zeros(100, 8, 3), depths)
    assert float(empty.depth.abs().max()) == 0, "weights are not normalised"
    weights = occupancy_weights(torch.randn(100, 8, generator=torch.Generator().manual_seed(0)))
    assert bool((weights <= 1).all())
    assert bool((weights.sum(1) <= 1 + 1e-6).all())


def test_what_is_seen_has_exact_gradients_to_features_and_pose() -> None:
    """The chain of twins in float64: decoder, occupancy, compositing, rays of a pose."""
    g = torch.Generator().manual_seed(0)
    middle, color = FeatureDecoder(32, 1, g).double(), FeatureDecoder(32, 4, g).double()
    with torch.no_grad():
        for decoder in (middle, color):
            decoder.embedder._B.mul_(0.04)  # else a finite step is too long for its sines
    directions = torch.randn(3, 3, generator=g, dtype=torch.float64)
    depths = torch.linspace(0.5, 2, 5, dtype=torch.float64).expand(3, 5)

    def seen(features: torch.Tensor, rotation: torch.Tensor, center: torch.Tensor) -> tuple[torch.Tensor, ...]:
        turned = directions @ so3.exp(rotation).mT
        points = (center + depths[..., None] * turned[:, None]).reshape(-1, 3)
        logits = decode_features_torch(points, features, middle.weights())[:, 0]
        rgb = decode_features_torch(points, features, color.weights())[:, :3]
        shown = composite(occupancy_weights(logits.reshape(3, 5)), rgb.reshape(3, 5, 3), depths)
        return shown.depth, shown.rgb, shown.variance

    features = torch.randn(15, 32, generator=g, dtype=torch.float64, requires_grad=True)
    pose = torch.randn(2, 3, generator=g, dtype=torch.float64)
    rotation, center = pose[0].requires_grad_(), pose[1].clone().requires_grad_()
    assert torch.autograd.gradcheck(seen, (features, rotation, center), atol=1e-5)


def test_one_frame_of_a_room_is_mapped(room: NiceSlamMap) -> None:
    frame = _frame()
    camera, pose = frame.camera, frame.pose.matrix().detach()
    directions = camera.rays().reshape(-1, 3) @ pose[:3, :3].mT
    origins, depth = pose[:3, 3].expand_as(directions).contiguous(), frame.depth.reshape(-1)
    ends = exit_depths(origins, directions, room.bounds)
    with torch.no_grad():
        given = sample_depths(depth, ends, room.config, torch.Generator().manual_seed(0))
        guided = see(room.field, origins, directions, given, ends, "color")
    assert float((guided.depth - depth).abs().mean()) < 0.03, "m, with measured depth"
    rendering = room.render(camera, pose)
    assert float((rendering.depth - frame.depth).abs().mean()) < 0.06, "m, without"


@pytest.mark.parametrize("is_corrupted", [False, True])
def test_a_displaced_camera_finds_back_even_among_outliers(room: NiceSlamMap, is_corrupted: bool) -> None:
    """From 2 cm and 1 degree in three directions; 30 iterations would stop at up to 2 cm."""
    offsets_m, angles_deg = zip(*(_found_from(seed, room, is_corrupted) for seed in range(3)), strict=True)
    assert max(offsets_m) < 0.01, offsets_m
    assert max(angles_deg) < 0.5, angles_deg


def _found_from(seed: int, room: NiceSlamMap, is_corrupted: bool) -> tuple[float, float]:
    """How far (m, degrees) from the truth a camera is after tracking that began 2 cm and 1 degree off."""
    frame, g = _frame(), torch.Generator().manual_seed(seed)
    truth = frame.T_world_camera_gt
    if is_corrupted:
        wrong = torch.rand(frame.depth.shape, generator=torch.Generator().manual_seed(seed)) < 0.1
        frame.depth[wrong] += 1.0
    turn, shift = torch.nn.functional.normalize(torch.randn(2, 3, generator=g))
    offset = torch.eye(4)
    offset[:3, :3] = so3.exp(torch.deg2rad(turn))
    offset[:3, 3] = 0.02 * shift
    frame.pose.set_(truth @ offset)
    tracking = NiceSlamTracking(NiceSlamTrackingConfig(iterations=80, first_iterations=80, border_px=5))
    moved = torch.linalg.inv(truth) @ tracking.track(frame, room, Trajectory()).T_world_camera
    return float(moved[:3, 3].norm()), float(so3.log(moved[:3, :3]).norm().rad2deg())


def test_the_mask_of_outliers_holds_every_corrupted_ray() -> None:
    g = torch.Generator().manual_seed(0)
    truth = 1 + 2 * torch.rand(200, generator=g)
    depth = truth.clone()
    depth[::10] += 1.0
    noise = 0.005 * torch.randn(200, generator=g)
    rgb = torch.zeros(200, 3, requires_grad=True)
    seen = Composite(rgb, truth + noise, torch.full((200,), 1e-4), torch.ones(200))
    (pull,) = torch.autograd.grad(tracking_losses(seen, torch.ones(200, 3), depth, 10.0).rgb, rgb)
    assert bool((pull[::10] == 0).all())
    assert float((pull[:, 0] != 0).float().mean()) > 0.85, "of all rays still count"


@pytest.mark.parametrize(("channels", "outputs", "count"), [(32, 1, 15_800), (64, 1, 20_920), (32, 4, 15_899)])
def test_decoders_have_the_published_sizes(channels: int, outputs: int, count: int) -> None:
    assert sum(v.numel() for v in FeatureDecoder(channels, outputs).parameters()) == count


def test_a_published_colour_decoder_fits() -> None:
    folder = os.environ.get("XRDSLAM_DATA")
    if not folder:
        pytest.skip("XRDSLAM_DATA is unset: weights/loopy_slam_color.pt is not at hand")
    state = torch.load(Path(folder) / "weights" / "loopy_slam_color.pt", map_location="cpu", weights_only=True)
    FeatureDecoder(32, 4).load_state_dict(state)
