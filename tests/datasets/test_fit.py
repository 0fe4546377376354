"""From a file's pixels to the frame's: the image goes where its camera says."""

import numpy as np
import pytest

from xrdslam.core.camera import Camera
from xrdslam.datasets.fit import ImageFit

CAMERA = Camera(20.0, 22.0, 11.3, 8.6, 24, 18)


def ramps(width: int, height: int) -> np.ndarray:
    """Red is the column's number over 64, green the row's."""
    v, u = np.mgrid[:height, :width].astype(np.float32)
    return np.stack((u, v, 0 * u), -1) / 64


def test_nothing_asked_changes_nothing() -> None:
    fit = ImageFit(CAMERA)
    image, depth = ramps(24, 18), ramps(24, 18)[..., 0]
    assert fit.camera == CAMERA
    assert fit.rgb(image) is image
    np.testing.assert_array_equal(fit.depth(depth), depth)


def test_shrinking_colour_takes_the_mean_over_the_area() -> None:
    image = np.random.default_rng(0).random((18, 24, 3), dtype=np.float32)
    blocks = image.reshape(6, 3, 8, 3, 3).mean((1, 3))
    np.testing.assert_allclose(ImageFit(CAMERA, (8, 6)).rgb(image), blocks, atol=5e-7)  # nine summands' rounding


@pytest.mark.parametrize("size", [(12, 9), (8, 6), (36, 45), (24, 36)])
def test_a_pixel_and_its_resized_self_lie_on_one_ray(size: tuple[int, int]) -> None:
    fit = ImageFit(CAMERA, size)
    inner = fit.rgb(ramps(24, 18))[4:-4, 4:-4] * 64  # away from the border, where interpolation has both neighbours
    u, v = np.meshgrid(np.arange(4, size[0] - 4), np.arange(4, size[1] - 4))
    rays = ((u - fit.camera.cx) / fit.camera.fx, (v - fit.camera.cy) / fit.camera.fy)
    np.testing.assert_allclose((inner[..., 0] - CAMERA.cx) / CAMERA.fx, rays[0], atol=2e-3)  # weights of 11 bits
    np.testing.assert_allclose((inner[..., 1] - CAMERA.cy) / CAMERA.fy, rays[1], atol=2e-3)


def test_depth_takes_the_nearest_pixel_centre() -> None:
    columns = ramps(24, 18)[..., 0] * 64 + 1
    # (u' + 1/2) 3 - 1/2 = 3 u' + 1: the middle one of each three.
    np.testing.assert_array_equal(ImageFit(CAMERA, (8, 6)).depth(columns)[0], 3 * np.arange(8) + 2)


@pytest.mark.parametrize("size", [(8, 6), (10, 7), (31, 40)])
def test_resized_depth_has_no_value_that_was_not_measured(size: tuple[int, int]) -> None:
    depth = np.random.default_rng(1).random((18, 24), dtype=np.float32)
    fitted = ImageFit(CAMERA, size).depth(depth)
    assert fitted.shape == size[::-1]
    assert np.isin(fitted, depth).all()


def test_depth_of_another_size_than_colour_comes_to_the_same_camera() -> None:
    fit = ImageFit(CAMERA, (12, 9), depth_size=(48, 36))
    assert fit.rgb(ramps(24, 18)).shape[:2] == fit.depth(np.ones((36, 48), np.float32)).shape == (9, 12)


def test_max_depth_keeps_what_lies_at_it_and_drops_what_lies_beyond() -> None:
    depth = np.array([[0.5, 2.0, np.nextafter(np.float32(2), np.float32(3)), 9.0]], np.float32)
    fit = ImageFit(Camera(1.0, 1.0, 0.0, 0.0, 4, 1), max_depth=2.0)
    np.testing.assert_array_equal(fit.depth(depth), np.array([[0.5, 2, 0, 0]], np.float32))


def test_depth_that_is_no_distance_is_no_measurement() -> None:
    depth = np.array([[np.nan, np.inf, -np.inf, -1.0, 0.0, 1.0]], np.float32)
    fit = ImageFit(Camera(1.0, 1.0, 0.0, 0.0, 6, 1))
    np.testing.assert_array_equal(fit.depth(depth), np.array([[0, 0, 0, 0, 0, 1]], np.float32))


def test_undistortion_looks_where_the_lens_put_the_ray() -> None:
    k1 = 0.2
    distorted = Camera(20.0, 20.0, 11.5, 8.5, 24, 18, (k1, 0.0, 0.0, 0.0))
    fit = ImageFit(distorted)
    assert fit.camera.distortion == ()
    x, y = (np.arange(8, 16) - 11.5) / 20, (np.arange(6, 12)[:, None] - 8.5) / 20
    expected = x * (1 + k1 * (x * x + y * y)) * 20 + 11.5  # u = fx x (1 + k1 r^2) + cx
    np.testing.assert_allclose(fit.rgb(ramps(24, 18))[6:12, 8:16, 0] * 64, expected, atol=1 / 32)  # maps of 5 bits
    assert np.isin(fit.depth(ramps(24, 18)[..., 0]), ramps(24, 18)[..., 0]).all()


def test_depth_of_another_size_goes_through_the_same_lens() -> None:
    distorted = Camera(20.0, 20.0, 11.5, 8.5, 24, 18, (0.2, 0.0, 0.0, 0.0))
    same, double = ImageFit(distorted), ImageFit(distorted, size=(24, 18), depth_size=(48, 36))
    # A ramp in units of colour's columns, sampled twice as densely: half-pixel rule, columns -1/4, 1/4, 3/4, ...
    fine = np.broadcast_to(((np.arange(48, dtype=np.float32) + 0.5) / 2 - 0.5), (36, 48)).copy()
    coarse = np.broadcast_to(np.arange(24, dtype=np.float32), (18, 24)).copy()
    inner = np.s_[4:14, 4:20]
    # Each is off by at most half its pixel in the map, the finer by half of one more in the resizing.
    assert np.abs(double.depth(fine) - same.depth(coarse))[inner].max() <= 0.5 + 0.25 + 0.25
