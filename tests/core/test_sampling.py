"""Rays drawn from frames: they are rays of pixels, in shares, with the poses' gradients."""

import pytest
import torch

from xrdslam.core.errors import ConfigError
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.core.sampling import sample_rays
from xrdslam.testing import ToySequence, toy_sequence


def frames(count: int) -> list[Frame]:
    found = list(toy_sequence(count, 32, 24).frames())
    for frame in found:
        assert frame.T_world_camera_gt is not None
        frame.pose.set_(frame.T_world_camera_gt)
    return found


def random(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_a_ray_of_a_depth_ends_at_a_pixel_of_that_colour() -> None:
    window = frames(2)
    batch = sample_rays(window, [f.pose.matrix() for f in window], 100, random())
    points = batch.origins_world + batch.depth[:, None] * batch.directions_world
    for slot, frame in enumerate(window):
        mine = batch.frame_slot == slot
        pixels, depth = frame.camera.project(se3.transform(se3.inverse(frame.pose.matrix()), points[mine]))
        u, v = pixels.detach().round().long().unbind(-1)
        torch.testing.assert_close(pixels, torch.stack((u, v), -1).float(), rtol=0, atol=1e-4)
        assert torch.equal(batch.rgb[mine], frame.rgb[v, u])
        assert frame.depth is not None
        torch.testing.assert_close(depth, frame.depth[v, u], rtol=0, atol=1e-5)


@pytest.mark.parametrize(("num_rays", "shares"), [(9, [3, 3, 3]), (11, [4, 4, 3]), (2, [1, 1, 0]), (0, [0, 0, 0])])
def test_frames_share_the_rays_evenly(num_rays: int, shares: list[int]) -> None:
    window = frames(3)
    batch = sample_rays(window, [f.pose.matrix() for f in window], num_rays, random())
    assert batch.frame_slot.bincount(minlength=3).tolist() == shares
    assert batch.origins_world.shape == batch.directions_world.shape == batch.rgb.shape == (num_rays, 3)


def test_every_pixel_can_be_drawn_and_none_of_the_border() -> None:
    (frame,) = frames(1)
    for border in (0, 5):
        batch = sample_rays([frame], [torch.eye(4)], 20_000, random(), border)
        pixels, _ = frame.camera.project(batch.directions_world)
        u, v = pixels.round().long().unbind(-1)
        assert sorted(u.unique().tolist()) == list(range(border, 32 - border))
        assert sorted(v.unique().tolist()) == list(range(border, 24 - border))


def test_rays_carry_the_gradient_of_their_pose() -> None:
    window = frames(2)
    batch = sample_rays(window, [window[0].pose.matrix(), window[1].pose.matrix().detach()], 10, random())
    (batch.origins_world.sum() + batch.directions_world.square().sum() * 0 + batch.directions_world.sum()).backward()
    first, second = (f.pose for f in window)
    assert first.translation.grad is not None
    assert first.translation.grad.tolist() == [5.0, 5.0, 5.0]
    assert first.rotation.grad is not None
    assert second.translation.grad is None


def test_a_frame_without_depth_has_none_measured() -> None:
    frame = ToySequence(1, toy_sequence().camera, modalities=["rgb"])[0]
    assert sample_rays([frame], [torch.eye(4)], 7, random()).depth.tolist() == [0.0] * 7


def test_the_seed_decides() -> None:
    window = frames(2)
    poses = [f.pose.matrix().detach() for f in window]
    first, second, other = (sample_rays(window, poses, 50, random(seed)).rgb for seed in (1, 1, 2))
    assert torch.equal(first, second)
    assert not torch.equal(first, other)


@pytest.mark.parametrize("border", [12, 40])
def test_a_border_that_leaves_no_pixel_is_refused(border: int) -> None:
    with pytest.raises(ConfigError, match="leaves no pixel of a 32x24 px image"):
        sample_rays(frames(1), [torch.eye(4)], 5, random(), border)
