"""Pictures kept of frames: which, how true they stay, what is missing."""

from pathlib import Path

import numpy as np
import pytest

from xrdslam.core.errors import DataError
from xrdslam.pictures.palette import ERROR, coloured, hexadecimal
from xrdslam.pictures.panels import Panels, chosen_frames, kept_frames, read_panels, write_panels


def panels(width: int = 64, with_depth: bool = True) -> Panels:
    height = width * 3 // 4
    ramp = np.linspace(0, 255, width, dtype=np.uint8)
    rgb = np.stack([np.tile(ramp, (height, 1)), np.full((height, width), 90), np.full((height, width), 30)], -1)
    depth = np.tile(np.linspace(0, 5.4321, width, dtype=np.float32), (height, 1))
    return Panels(7, rgb.astype(np.uint8), 255 - rgb.astype(np.uint8), depth if with_depth else None, depth + 0.1)


def test_pictures_come_back_as_they_were(tmp_path: Path) -> None:
    write_panels(tmp_path, panels())
    again = read_panels(tmp_path, 7)
    assert kept_frames(tmp_path) == [7]
    # JPEG at quality 92 with halved chroma: a smooth ramp stays within a few of 255 steps
    assert np.abs(again.rgb.astype(int) - panels().rgb).mean() < 3
    assert again.depth is not None
    np.testing.assert_allclose(again.depth, panels().depth, atol=0.5e-3 + 1e-6)  # half a millimetre
    np.testing.assert_allclose(again.rendered_depth, panels().rendered_depth, atol=0.5e-3 + 1e-6)


def test_wide_pictures_are_reduced_and_missing_depth_stays_missing(tmp_path: Path) -> None:
    write_panels(tmp_path, panels(960, with_depth=False))
    again = read_panels(tmp_path, 7)
    assert again.rgb.shape == (360, 480, 3)
    assert again.depth is None


def test_depths_that_are_no_numbers_or_too_far_do_not_wrap(tmp_path: Path) -> None:
    depth = np.array([[np.nan, np.inf, -1.0, 70.0]], dtype=np.float32)
    write_panels(tmp_path, Panels(0, np.zeros((1, 4, 3), np.uint8), np.zeros((1, 4, 3), np.uint8), depth, depth))
    np.testing.assert_allclose(read_panels(tmp_path, 0).rendered_depth, [[0, 0, 0, 65.535]], atol=1e-3)


@pytest.mark.parametrize(("count", "most", "expected"), [(5, 24, 5), (24, 24, 24), (400, 24, 24), (400, 1, 1)])
def test_frames_are_chosen_evenly_with_both_ends(count: int, most: int, expected: int) -> None:
    chosen = sorted(chosen_frames(list(range(0, 5 * count, 5)), most))
    assert len(chosen) == expected
    assert chosen[0] == 0
    if expected > 2:
        assert chosen[-1] == 5 * (count - 1)
        assert np.ptp(np.diff(chosen)) <= 5


def test_a_damaged_picture_is_named(tmp_path: Path) -> None:
    write_panels(tmp_path, panels())
    (tmp_path / "frame_000007_rendering.jpg").write_bytes(b"no picture")
    with pytest.raises(DataError, match="frame_000007_rendering"):
        read_panels(tmp_path, 7)


def test_colours_run_from_the_first_to_the_last_and_grey_is_no_number() -> None:
    colours = coloured(np.array([-1.0, 0.0, 0.5, 1.0, 9.0, np.nan]), ERROR, 0.0, 1.0)
    assert colours[0].tolist() == colours[1].tolist() == list(ERROR[0])
    assert colours[3].tolist() == colours[4].tolist() == list(ERROR[-1])
    assert colours[2].tolist() == list(ERROR[2])
    assert len(set(colours[5].tolist())) == 3
    assert np.ptp(colours[5].astype(int)) < 15
    assert hexadecimal(np.array([0, 171, 255], np.uint8)) == "#00abff"
