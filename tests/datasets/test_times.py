"""Times of files are exact; two lists are joined one to one; a trajectory is interpolated where it is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from xrdslam.core.errors import DataError
from xrdslam.datasets.times import associated, nanoseconds
from xrdslam.datasets.tracks import Track, read_track


def test_decimal_seconds_are_exact_nanoseconds() -> None:
    assert nanoseconds("1305031239.529662", "x") == 1305031239529662000
    assert nanoseconds("1403715285262142976", "x", unit=1) == 1403715285262142976
    assert nanoseconds("1.25e3", "x") == 1250 * 10**9
    assert nanoseconds("-0.5", "x") == -500_000_000


@pytest.mark.parametrize("text", ["", "noon", "nan", "inf", "1,5", "0x10"])
def test_what_is_no_time_is_refused_by_line(text: str) -> None:
    with pytest.raises(DataError, match=r"rgb\.txt, line 3: .* is not a time"):
        nanoseconds(text, "rgb.txt, line 3")


def test_the_closest_pairs_are_joined_first_and_each_once() -> None:
    partners, apart = associated([0, 10, 20, 100], [9, 11, 26, 200], 6)
    # 10-9 and 10-11 are equally close, the earlier wins; 11 is 9 from 20, too far; 20-26 fits; 0 and 100 stay alone.
    assert partners.tolist() == [-1, 0, 2, -1]
    assert apart.tolist() == [9, 1, 6, 74]


def test_two_that_want_the_same_partner_do_not_both_get_it() -> None:
    partners, _ = associated([8, 11], [10], 5)
    assert partners.tolist() == [-1, 0]


def test_lists_need_not_be_in_order_and_may_be_empty() -> None:
    assert associated([20, 0], [1, 21], 2)[0].tolist() == [1, 0]
    assert associated([1, 2], [], 2)[0].tolist() == [-1, -1]
    assert associated([], [1], 2)[0].tolist() == []


def test_joining_equals_the_brute_force() -> None:
    random = np.random.default_rng(3)
    first, second = np.sort(random.integers(0, 4000, 60)), np.sort(random.integers(0, 4000, 50))
    partners, _ = associated(first.tolist(), second.tolist(), 25)
    pairs = sorted((abs(int(a) - int(b)), i, j) for i, a in enumerate(first) for j, b in enumerate(second))
    expected = np.full(60, -1)
    for apart, i, j in pairs:
        if apart <= 25 and expected[i] < 0 and j not in expected:
            expected[i] = j
    joined = partners >= 0
    assert len(set(partners[joined])) == joined.sum()
    gap = np.abs(first - second[partners])[joined]
    assert gap.max() <= 25
    best = np.abs(first - second[expected])[expected >= 0]
    assert gap.sum() <= best.sum() + 25  # ties may be broken otherwise
    assert abs(int(joined.sum()) - int((expected >= 0).sum())) <= 1


def turned(angle: float, x: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0, angle, 0]).as_matrix()
    pose[0, 3] = x
    return pose


def test_between_two_poses_both_parts_move_evenly() -> None:
    track = Track([1000, 0], np.stack([turned(1.0, 4.0), turned(0.2, 0.0)]))
    np.testing.assert_allclose(track.at(250, 1000), turned(0.4, 1.0), atol=1e-12)
    np.testing.assert_array_equal(track.at(1000, 0), turned(1.0, 4.0))


def test_a_pose_is_unknown_where_no_other_is_near() -> None:
    track = Track([0, 1000, 9000], np.stack([turned(0, 0), turned(0, 1), turned(0, 9)]))
    assert np.isfinite(track.at(500, 1000)).all()
    assert np.isnan(track.at(5000, 1000)).all()  # in the gap
    assert np.isnan(track.at(9200, 1000)).all()  # behind the end
    np.testing.assert_array_equal(track.at(9100, 1000), turned(0, 9))  # a tenth of the tolerance behind it
    assert np.isnan(Track([], np.zeros((0, 4, 4))).at(0, 10**12)).all()


def test_lines_that_are_no_poses_are_named_and_left_out() -> None:
    good = ["0", "0", "0", "0", "0", "0", "0", "1"]
    lines = [good, ["1", *["nan"] * 7], ["2", *good[1:7], "3"], good, ["4", "5"], ["x", *good[1:]]]
    track, faults = read_track([(words, f"gt, line {n}") for n, words in enumerate(lines)], "xyzw")
    assert len(track) == 1
    assert [fault.partition(":")[0] for fault in faults] == [f"gt, line {n}" for n in (1, 2, 3, 4, 5)]
    for fault, part in zip(faults, ["NaN", "length 3", "twice", "found 2 numbers", "not a time"], strict=True):
        assert part in fault
