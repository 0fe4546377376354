"""Blocks of four rows of four pixels, in and out of images."""

import numpy as np

from xrdslam.ops import simd
from xrdslam.ops.splats import blocks


@simd.kernel
def _copy(image, out, channels):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    red, green, blue = blocks.split_rgb(
        blocks.load_block(image, 0, 36), blocks.load_block(image, 4, 36), blocks.load_block(image, 8, 36)
    )
    simd.store(channels, 0, red)
    simd.store(channels, 16, green)
    simd.store(channels, 32, blue)
    first, second, third = blocks.join_rgb(red, green, blue)
    blocks.store_block(out, 0, 36, first)
    blocks.store_block(out, 4, 36, second)
    blocks.store_block(out, 8, 36, third)


def test_channels_are_split_and_joined() -> None:
    image = np.random.default_rng(0).random((4, 12, 3), dtype=np.float32)
    out, channels = np.zeros_like(image), np.empty((3, 4, 4), np.float32)
    _copy(image, out, channels)
    np.testing.assert_array_equal(channels, image[:, :4].transpose(2, 0, 1))
    np.testing.assert_array_equal(out[:, :4], image[:, :4])
    assert out[:, 4:].max() == 0
