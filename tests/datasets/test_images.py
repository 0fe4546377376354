"""Image files: values come back exactly, and no damage goes by."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from xrdslam.core.errors import DataError
from xrdslam.datasets.images import PNG_END, probe_depth, probe_image, probe_rgb, read_depth, read_rgb

RED = np.array([[[0, 0, 255], [10, 20, 30]]], np.uint8)  # blue first, as OpenCV writes


def write(path: Path, image: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), image)
    return path


def smooth(height: int, width: int) -> np.ndarray:
    v, u = np.mgrid[:height, :width]
    return np.stack((3 * u, 5 * v, 2 * u + v), -1).astype(np.uint8)


def test_colour_is_read_red_first_and_exactly(tmp_path: Path) -> None:
    rgb = read_rgb(write(tmp_path / "a.png", RED))
    assert rgb.dtype == np.float32
    np.testing.assert_array_equal(rgb, np.array([[[1, 0, 0], np.array([30, 20, 10]) / 255]], np.float32))


def test_every_level_of_colour_is_its_255th(tmp_path: Path) -> None:
    levels = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, -1)
    rgb = read_rgb(write(tmp_path / "a.png", levels))
    np.testing.assert_array_equal(rgb[0, :, 0], np.arange(256, dtype=np.float32) / np.float32(255))


def test_jpeg_is_read_red_first_within_its_loss(tmp_path: Path) -> None:
    image = smooth(32, 48)
    rgb = read_rgb(write(tmp_path / "a.jpg", image))
    assert np.abs(rgb - image[..., ::-1] / np.float32(255)).mean() < 3 / 255


def test_alpha_is_dropped(tmp_path: Path) -> None:
    image = np.dstack((smooth(4, 5), np.full((4, 5), 7, np.uint8)))
    assert read_rgb(write(tmp_path / "a.png", image)).shape == (4, 5, 3)


def test_depth_is_levels_over_scale_and_0_where_invalid(tmp_path: Path) -> None:
    path = write(tmp_path / "d.png", np.array([[0, 1, 1000, 65534, 65535]], np.uint16))
    depth = read_depth(path, 1000.0)
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(depth, np.array([[0, 0.001, 1, 65.534, 65.535]], np.float32))
    np.testing.assert_array_equal(read_depth(path, 1000.0, (65535,))[0, 3:], np.array([65.534, 0], np.float32))


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_a_header_declares_what_the_decoder_finds(tmp_path: Path, name: str) -> None:
    header = probe_image(write(tmp_path / name, smooth(11, 17)))
    assert (header.size, header.channels, header.bits) == ((17, 11), 3, 8)


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_a_cut_anywhere_is_refused_without_decoding(tmp_path: Path, name: str) -> None:
    whole = write(tmp_path / name, smooth(9, 12)).read_bytes()
    probe_rgb(tmp_path / name)
    cut = tmp_path / f"cut-{name}"
    for length in range(len(whole)):
        cut.write_bytes(whole[:length])
        with pytest.raises(DataError, match="cut-a"):
            probe_rgb(cut)


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_bytes_behind_the_end_do_no_harm(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / name, smooth(9, 12))
    expected = read_rgb(path)
    path.write_bytes(path.read_bytes() + b"appended by a camera")
    np.testing.assert_array_equal(read_rgb(path), expected)


def test_the_end_of_a_thumbnail_is_not_the_end_of_a_jpeg(tmp_path: Path) -> None:
    whole = write(tmp_path / "a.jpg", smooth(9, 12)).read_bytes()
    segment = b"\xff\xe1" + struct.pack(">H", len(whole) + 2) + whole  # APP1 that holds a JPEG, as EXIF does
    path = tmp_path / "b.jpg"
    path.write_bytes(whole[:2] + segment + whole[2:])
    assert probe_rgb(path).size == (12, 9)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(DataError, match="truncated jpeg"):
        probe_rgb(path)


def test_a_png_damaged_inside_is_refused_when_read(tmp_path: Path) -> None:
    path = write(tmp_path / "d.png", np.arange(6000, dtype=np.uint16).reshape(60, 100))
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(DataError, match=r"d\.png: damaged png"):
        read_depth(path, 1000.0)


def test_a_header_that_lies_about_the_size_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.jpg", smooth(8, 8))
    data = path.read_bytes()
    at = data.index(b"\xff\xc0") + 5
    path.write_bytes(data[:at] + b"\0\0\0\0" + data[at + 4 :])
    with pytest.raises(DataError, match=r"a\.jpg: damaged jpeg"):
        read_rgb(path)


@pytest.mark.parametrize("image", [np.zeros((4, 5), np.uint8), np.zeros((4, 5, 3), np.uint16)], ids=["grey", "16 bits"])
def test_what_is_not_8_bit_colour_is_no_colour_image(tmp_path: Path, image: np.ndarray) -> None:
    with pytest.raises(DataError, match=r"a\.png: a colour image has 3 channels of 8 bits"):
        probe_rgb(write(tmp_path / "a.png", image))


@pytest.mark.parametrize(
    ("name", "image"), [("d.png", np.zeros((4, 5), np.uint8)), ("d.png", smooth(4, 5)), ("d.jpg", RED)]
)
def test_what_is_not_one_channel_of_16_bits_is_no_depth_image(tmp_path: Path, name: str, image: np.ndarray) -> None:
    with pytest.raises(DataError, match=r"d\.(png|jpg): a depth image is a PNG with 1 channel of 16 bits"):
        probe_depth(write(tmp_path / name, image))


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "empty file"),
        (b"hello", "neither PNG nor JPEG"),
        (b"II*\0 a TIFF", "neither PNG nor JPEG"),
        (None, "no such"),
    ],
)
def test_what_is_no_image_is_refused_by_name(tmp_path: Path, content: bytes | None, found: str) -> None:
    path = tmp_path / "a.png"
    if content is not None:
        path.write_bytes(content)
    for read in (probe_rgb, probe_depth, read_rgb):
        with pytest.raises(DataError, match=rf"a\.png: {found}"):
            read(path)


def test_a_folder_in_place_of_an_image_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot be read"):
        probe_image(tmp_path)


def test_the_end_marker_of_a_png_is_its_iend_chunk() -> None:
    assert struct.pack(">I", 0) + b"IEND" + struct.pack(">I", zlib.crc32(b"IEND")) == PNG_END
