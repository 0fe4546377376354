"""Where Gaussians are seeded, and as what."""

import math

import pytest
import torch
from torch import Tensor

from xrdslam.algorithms.splatam.config import SplatamMapConfig
from xrdslam.algorithms.splatam.seeding import pixels_to_seed, seeds_of
from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame
from xrdslam.core.model import Rendering

CAMERA = Camera(20.0, 22.0, 7.5, 5.5, 16, 12)


def frame_of(depth: Tensor) -> Frame:
    generator = torch.Generator().manual_seed(0)
    return Frame(0, 0, CAMERA, torch.rand(12, 16, 3, generator=generator), depth)


def rendering_of(depth: Tensor, opacity: float = 1.0) -> Rendering:
    return Rendering(torch.zeros(12, 16, 3), depth, torch.full((12, 16), opacity))


def test_a_seed_projects_onto_the_centre_of_its_pixel_with_a_radius_of_one_pixel() -> None:
    depth = torch.full((12, 16), 2.0)
    depth[3, 4] = 0.0  # not measured: no seed
    T_world_camera = torch.eye(4)
    T_world_camera[:3, 3] = torch.tensor([1.0, -2.0, 0.5])
    seeds = seeds_of(frame_of(depth), T_world_camera, depth > 0, SplatamMapConfig())
    pixels, z = CAMERA.project(seeds.means - T_world_camera[:3, 3])
    expected = CAMERA.pixels()[depth > 0]
    torch.testing.assert_close(pixels, expected, rtol=0, atol=1e-5)
    assert len(z) == 12 * 16 - 1
    radius_px = seeds.log_scales.exp() * 21.0 / z[:, None]
    torch.testing.assert_close(radius_px, torch.ones(len(z), 1))
    assert torch.equal(torch.sigmoid(seeds.opacity_logits), torch.full((len(z), 1), 0.5))


def test_every_second_pixel_gets_a_seed_twice_as_large() -> None:
    depth = torch.full((12, 16), 2.0)
    whole = seeds_of(frame_of(depth), torch.eye(4), depth > 0, SplatamMapConfig())
    half = seeds_of(frame_of(depth), torch.eye(4), depth > 0, SplatamMapConfig(seed_stride=2))
    assert len(half.means) * 4 == len(whole.means)
    torch.testing.assert_close(half.log_scales[0] - whole.log_scales[0], torch.tensor([math.log(2)]))


def test_a_map_that_explains_the_frame_is_left_alone() -> None:
    depth = torch.full((12, 16), 2.0)
    assert not pixels_to_seed(rendering_of(depth), frame_of(depth), SplatamMapConfig()).any()


def test_holes_are_seeded_where_there_is_a_measurement() -> None:
    depth = torch.full((12, 16), 2.0)
    depth[:, :8] = 0
    seeded = pixels_to_seed(rendering_of(depth, opacity=0.49), frame_of(depth), SplatamMapConfig())
    assert torch.equal(seeded, depth > 0)
    assert not pixels_to_seed(rendering_of(depth, opacity=0.51), frame_of(depth), SplatamMapConfig()).any()


def box_scene() -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    rendered = torch.full((12, 16), 2.0) + 0.001 * torch.rand(12, 16, generator=generator)
    measured = torch.full((12, 16), 2.0)
    measured[2:5, 3:7] = 1.0  # a box that came to stand in front
    return rendered, measured


def test_something_new_in_front_is_seeded_and_only_that() -> None:
    rendered, measured = box_scene()
    seeded = pixels_to_seed(rendering_of(rendered), frame_of(measured), SplatamMapConfig())
    assert torch.equal(seeded, measured == 1.0)


def test_something_missing_in_front_is_not_seeded() -> None:
    rendered, measured = box_scene()
    assert not pixels_to_seed(rendering_of(measured), frame_of(rendered), SplatamMapConfig()).any()


def test_unmeasured_pixels_do_not_drag_the_median_error_to_zero() -> None:
    """With most of the depth missing, a median over all pixels is 0, and every pixel slightly in front is seeded."""
    rendered, measured = box_scene()
    measured[5:] = 0
    seeded = pixels_to_seed(rendering_of(rendered), frame_of(measured), SplatamMapConfig())
    assert torch.equal(seeded, measured == 1.0)


@pytest.mark.parametrize("depth", [torch.zeros(12, 16)])
def test_a_frame_without_any_measurement_seeds_nothing(depth: Tensor) -> None:
    assert not pixels_to_seed(rendering_of(depth, 0.0), frame_of(depth), SplatamMapConfig()).any()
    assert len(seeds_of(frame_of(depth), torch.eye(4), depth > 0, SplatamMapConfig()).means) == 0
