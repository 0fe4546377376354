"""A frame: images as buffers, a pose as a module, and what makes it useless."""

import pytest
import torch

from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame

CAMERA = Camera(4.0, 5.0, 1.5, 1.0, 4, 3)


def frame(depth: torch.Tensor | None = None, rgb: torch.Tensor | None = None) -> Frame:
    return Frame(3, 30, CAMERA, torch.rand(3, 4, 3) if rgb is None else rgb, depth)


def test_images_move_and_are_saved_with_the_module() -> None:
    one = frame(torch.ones(3, 4)).to("meta")
    assert one.device == torch.device("meta")
    assert one.depth is not None
    assert one.depth.device == one.pose.translation.device == torch.device("meta")


def test_the_pose_starts_at_the_identity_and_is_all_that_can_be_optimised() -> None:
    one = frame()
    assert torch.equal(one.pose.matrix().detach(), torch.eye(4))
    assert [name for name, _ in one.named_parameters()] == ["pose.rotation", "pose.translation"]
    assert Frame(0, 0, CAMERA, torch.rand(3, 4, 3), rotation="quaternion").pose.kind == "quaternion"


def test_an_image_of_another_size_than_the_camera_is_refused() -> None:
    with pytest.raises(ValueError, match=r"image of \(4, 3\), camera of \(3, 4\)"):
        frame(rgb=torch.rand(4, 3, 3))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_points_are_those_of_pixels_with_depth_in_raster_order(dtype: torch.dtype) -> None:
    depth = torch.zeros(3, 4, dtype=dtype)
    depth[1, 3], depth[2, 0] = 2.0, 4.0
    points = frame(depth).points_camera()
    assert points.dtype == dtype
    expected = [[2 * (3 - 1.5) / 4, 0.0, 2.0], [4 * (0 - 1.5) / 4, 4 * (2 - 1.0) / 5, 4.0]]
    torch.testing.assert_close(points, torch.tensor(expected, dtype=dtype))


def test_without_depth_there_are_no_points() -> None:
    assert frame(torch.zeros(3, 4)).points_camera().shape == (0, 3)
    with pytest.raises(ValueError, match="frame 3 has no depth"):
        frame().points_camera()


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
def test_numbers_that_are_not_finite_are_a_fault(bad: float) -> None:
    rgb, depth = torch.rand(3, 4, 3), torch.ones(3, 4)
    rgb[1, 2, 0], depth[1, 2] = bad, bad
    assert frame(torch.ones(3, 4), rgb).fault({"rgb"}) == "its image is not finite"
    assert frame(depth).fault({"rgb", "depth"}) == "its depth is not finite"
    assert frame(depth).fault({"rgb"}) is None  # of no concern to who does not look at it


def test_no_depth_at_any_pixel_is_a_fault_for_who_needs_it() -> None:
    empty = frame(torch.zeros(3, 4))
    assert empty.fault({"rgb", "depth"}) == "no pixel has a depth"
    assert empty.fault({"rgb"}) is None
    assert frame(torch.ones(3, 4)).fault({"rgb", "depth"}) is None
