"""The pinhole camera: pixel centres at integers, rays with z = 1."""

import math

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from xrdslam.core.camera import Camera
from xrdslam.core.errors import DataError

CAMERA = Camera(300.0, 310.0, 158.7, 121.3, 320, 240)


def test_K_is_u_equals_fx_x_over_z_plus_cx() -> None:
    assert CAMERA.K().tolist() == torch.tensor([[300.0, 0, 158.7], [0, 310.0, 121.3], [0, 0, 1]]).tolist()
    point = torch.tensor([0.3, -0.2, 2.0], dtype=torch.float64)
    pixel, depth = CAMERA.project(point)
    homogeneous = CAMERA.K(torch.float64) @ point
    torch.testing.assert_close(pixel, homogeneous[:2] / homogeneous[2])
    assert float(depth) == 2.0


def test_pixel_zero_is_a_centre() -> None:
    camera = Camera(2.0, 2.0, 0.0, 0.0, 4, 3)
    assert camera.rays()[0, 0].tolist() == [0.0, 0.0, 1.0]
    assert camera.rays()[2, 3].tolist() == [1.5, 1.0, 1.0]  # row 2, column 3
    assert camera.pixels()[2, 3].tolist() == [3.0, 2.0]


@pytest.mark.parametrize(("dtype", "atol"), [(torch.float32, 1e-4), (torch.float64, 1e-12)])  # 5 eps of 320 px
def test_unproject_and_project_undo_each_other(dtype: torch.dtype, atol: float) -> None:
    pixels = CAMERA.pixels(dtype)
    depth = torch.linspace(0.1, 50.0, pixels[..., 0].numel(), dtype=dtype).reshape(pixels.shape[:2])
    points = CAMERA.unproject(pixels, depth)
    assert points.dtype == dtype
    found, z = CAMERA.project(points)
    torch.testing.assert_close(found, pixels, rtol=0, atol=atol)
    assert torch.equal(z, depth)


def test_rays_of_all_pixels_are_rays_of_each() -> None:
    assert torch.equal(CAMERA.rays(), CAMERA.rays(CAMERA.pixels()))
    assert CAMERA.rays(torch.zeros(0, 2)).shape == (0, 3)
    assert CAMERA.unproject(torch.zeros(0, 2), torch.zeros(0)).shape == (0, 3)


def test_points_in_the_camera_plane_give_finite_pixels_and_gradients() -> None:
    points = torch.tensor([[1.0, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 1.0, -2.0]], requires_grad=True)
    pixels, depth = CAMERA.project(points)
    assert depth.tolist() == [0.0, 0.0, -2.0]
    pixels.sum().backward()
    assert bool(torch.isfinite(pixels).all())
    assert points.grad is not None
    assert bool(torch.isfinite(points.grad).all())


@settings(deadline=None, max_examples=50)
@given(st.integers(1, 1000), st.integers(1, 1000))
def test_resizing_there_and_back_is_nothing(width: int, height: int) -> None:
    back = CAMERA.resized(width, height).resized(320, 240)
    for key in ("fx", "fy", "cx", "cy"):
        assert math.isclose(getattr(back, key), getattr(CAMERA, key), rel_tol=1e-12)
    assert (back.width, back.height) == (320, 240)


def test_the_centre_of_a_block_of_two_by_two_is_the_centre_of_the_small_pixel() -> None:
    """A ray through the middle of the block is the small camera's ray through its pixel."""
    small = CAMERA.resized(160, 120)
    blocks = CAMERA.pixels(torch.float64).reshape(120, 2, 160, 2, 2).mean((1, 3))
    torch.testing.assert_close(CAMERA.rays(blocks), small.rays(small.pixels(torch.float64)), rtol=0, atol=1e-14)


def test_resizing_keeps_the_corners_of_the_image_area() -> None:
    """Half a pixel outside the first and last centres: the field of view does not change."""
    small = CAMERA.resized(97, 31)
    for first, last in (((-0.5, -0.5), (-0.5, -0.5)), ((319.5, 239.5), (96.5, 30.5))):
        rays = CAMERA.rays(torch.tensor(first).double()), small.rays(torch.tensor(last).double())
        torch.testing.assert_close(*rays, rtol=0, atol=1e-14)


def test_a_crop_sees_the_same_rays() -> None:
    crop = CAMERA.cropped(20, 30, 100, 50)
    torch.testing.assert_close(crop.rays(), CAMERA.rays()[30:80, 20:120], rtol=0, atol=2e-7)
    assert CAMERA.cropped(0, 0, 320, 240) == CAMERA


@pytest.mark.parametrize("window", [(-1, 0, 10, 10), (0, -1, 10, 10), (311, 0, 10, 10), (0, 231, 10, 10)])
def test_a_crop_outside_is_refused(window: tuple[int, int, int, int]) -> None:
    with pytest.raises(DataError, match="leaves the 320x240 px image"):
        CAMERA.cropped(*window)


@pytest.mark.parametrize("window", [(0, 0, 0, 10), (5, 5, 10, 0), (5, 5, -3, 10)])
def test_an_empty_crop_is_refused(window: tuple[int, int, int, int]) -> None:
    with pytest.raises(DataError, match="at least one pixel"):
        CAMERA.cropped(*window)


@pytest.mark.parametrize(
    ("key", "value"),
    [("fx", 0.0), ("fy", -1.0), ("fx", math.nan), ("cx", math.inf), ("distortion", (0.1, math.nan, 0.0, 0.0))],
)
def test_intrinsics_that_make_no_sense_are_refused(key: str, value: float) -> None:
    intrinsics = {"fx": 300.0, "fy": 300.0, "cx": 160.0, "cy": 120.0, "width": 320, "height": 240, key: value}
    with pytest.raises(DataError, match="intrinsics"):
        Camera(**intrinsics)  # type: ignore[arg-type]  # mypy sees one type for all values


@pytest.mark.parametrize("size", [(0, 240), (320, 0), (-320, 240)])
def test_an_empty_image_is_refused(size: tuple[int, int]) -> None:
    with pytest.raises(DataError, match="at least one pixel"):
        Camera(300.0, 300.0, 160.0, 120.0, *size)
    with pytest.raises(DataError, match="at least one pixel"):
        CAMERA.resized(*size)


def test_a_number_of_distortion_coefficients_that_no_model_has_is_refused() -> None:
    with pytest.raises(DataError, match="4, 5, 8, 12 or 14"):
        Camera(300.0, 300.0, 160.0, 120.0, 320, 240, (0.1, 0.2, 0.3))


def test_undistorting_sends_each_pixel_where_opencv_finds_it() -> None:
    """The map is the distorted place of each straight pixel; opencv's iterative inverse brings that back."""
    camera = Camera(300.0, 310.0, 158.7, 121.3, 320, 240, (0.12, -0.2, 0.001, -0.0005, 0.03))
    map_x, map_y = camera.undistort_maps()
    distorted = np.stack((map_x, map_y), -1).reshape(-1, 1, 2).astype(np.float64)
    matrix = camera.K(torch.float64).numpy()
    coefficients = np.array(camera.distortion)
    rays = camera.rays().double().numpy().reshape(-1, 1, 3)
    placed, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, coefficients)
    np.testing.assert_allclose(distorted, placed, rtol=0, atol=1e-4)  # float32 of 320 px: 2e-5
    back = cv2.undistortPoints(distorted, matrix, coefficients, None, None, matrix)
    off = np.abs(back.reshape(240, 320, 2) - camera.pixels().numpy()).max()
    assert off < 0.05  # it stops after five steps; the distortion itself moves the corners by 3 px
    assert camera.undistorted().distortion == ()


def test_without_distortion_every_pixel_stays() -> None:
    map_x, map_y = CAMERA.undistort_maps()
    np.testing.assert_allclose(np.stack((map_x, map_y), -1), CAMERA.pixels().numpy(), rtol=0, atol=1e-4)


def test_inside_ends_at_the_outermost_centres() -> None:
    pixels = torch.tensor([[0.0, 0.0], [319.0, 239.0], [319.1, 0.0], [0.0, -0.1], [5.0, 5.0], [torch.nan, 1.0]])
    assert CAMERA.contains(pixels).tolist() == [True, True, False, False, True, False]
    assert CAMERA.contains(pixels, border_px=6.0).tolist() == [False] * 6
