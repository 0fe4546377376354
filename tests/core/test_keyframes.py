"""Which keyframes a mapping step looks at."""

import dataclasses
from collections import Counter
from collections.abc import Sequence

import pytest
import torch
from torch import Tensor

from xrdslam.core import keyframes as keyframes_module
from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3, so3
from xrdslam.core.keyframes import BLOCK, KEYFRAME_POLICIES, overlap, select_keyframes
from xrdslam.core.pose import OptimizablePose

CAMERA = Camera(100.0, 100.0, 49.5, 39.5, 100, 80)
POLICIES = sorted(KEYFRAME_POLICIES)


def looking(index: int, yaw_deg: float = 0.0, x: float = 0.0) -> Frame:
    """A frame before a wall 2 m away, turned and moved."""
    frame = Frame(index, index, CAMERA, torch.zeros(80, 100, 3), torch.full((80, 100), 2.0))
    turn = so3.exp(torch.deg2rad(torch.tensor([0.0, yaw_deg, 0.0])))
    frame.pose.set_(se3.compose(turn, torch.tensor([x, 0.0, 0.0])))
    return frame


def random(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def chosen(policy: str, keyframes: list[Frame], frame: Frame, window: int, seed: int = 0) -> list[int]:
    return [f.index for f in select_keyframes(policy, keyframes, frame, window, random(seed))]


def row(count: int) -> list[Frame]:
    """Keyframes that all see about the same, slightly apart."""
    return [looking(index, x=0.001 * index) for index in range(count)]


@pytest.mark.parametrize("policy", [p for p in POLICIES if p != "all"])
@pytest.mark.parametrize("window", [1, 2, 3, 6])
def test_a_window_has_its_size_the_latest_keyframe_and_the_current_frame_last(policy: str, window: int) -> None:
    picked = chosen(policy, row(10), looking(20), window)
    assert len(picked) == window
    assert len(set(picked)) == window
    assert picked[-1] == 20
    if window > 1:
        assert picked[-2] == 9


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("window", [1, 2, 5])
def test_the_first_frame_is_alone(policy: str, window: int) -> None:
    assert chosen(policy, [], looking(0), window) == [0]


@pytest.mark.parametrize("policy", POLICIES)
def test_few_keyframes_are_all_taken(policy: str) -> None:
    assert chosen(policy, row(3), looking(20), 4) == [0, 1, 2, 20]


def test_all_are_all_whatever_the_window() -> None:
    assert chosen("all", row(10), looking(20), 2) == [*range(10), 20]


def test_the_window_policy_takes_the_latest() -> None:
    assert chosen("window", row(10), looking(20), 4) == [7, 8, 9, 20]


@pytest.mark.parametrize("policy", POLICIES)
def test_a_frame_that_is_a_keyframe_already_comes_once(policy: str) -> None:
    keyframes = row(6)
    picked = chosen(policy, keyframes, keyframes[-1], 6)
    assert picked == [0, 1, 2, 3, 4, 5]


def test_overlap_is_the_fraction_seen() -> None:
    """Moved sideways by half of what the image spans at the wall, half of the points stay (of a tenth less border)."""
    span = 100 * 2.0 / 100.0  # [m]
    frames = [looking(0), looking(1, x=span / 2), looking(2, x=2 * span), looking(3, yaw_deg=180)]
    fractions = overlap(frames, looking(9), random(), num_pixels=20_000, border_px=0.0)
    expected = torch.tensor([1.0, 0.5, 0.0, 0.0])
    torch.testing.assert_close(fractions, expected, rtol=0, atol=0.02)  # five sigma of 20 000 draws


def test_a_border_counts_as_outside() -> None:
    """8 px of 100 by 80: 84 * 64 of 8000 pixels are inside (centres on the border included)."""
    found = overlap([looking(0)], looking(9), random(), num_pixels=20_000, border_px=8.0)
    assert abs(float(found[0]) - 84 * 64 / 8000) < 0.02


def test_the_border_never_swallows_a_small_image() -> None:
    camera = CAMERA.resized(30, 24)
    small = Frame(0, 0, camera, torch.zeros(24, 30, 3), torch.full((24, 30), 2.0))
    assert float(overlap([small], small, random(), border_px=20.0)[0]) > 0.5


def test_ranked_overlap_takes_those_that_see_most_and_none_that_see_nothing() -> None:
    turned = [looking(i, yaw_deg=yaw) for i, yaw in enumerate((180.0, 20.0, 90.0, 5.0, 10.0, 0.0))]
    assert chosen("overlap", turned, looking(20), 4) == [3, 4, 5, 20]
    assert set(chosen("overlap", turned, looking(20), 6)) == {1, 3, 4, 5, 20}  # one less than the window holds


def test_random_overlap_draws_among_those_that_see_anything() -> None:
    turned = [looking(i, yaw_deg=yaw) for i, yaw in enumerate((180.0, 20.0, 120.0, 5.0, 10.0, 170.0, 0.0))]
    drawn = {index for seed in range(30) for index in chosen("overlap_random", turned, looking(20), 4, seed)[:2]}
    assert drawn == {1, 3, 4}


def test_random_overlap_finds_the_few_that_see_anything_and_is_alike_for_all_of_them() -> None:
    away = [looking(i, yaw_deg=180.0) for i in range(3 * BLOCK)]
    seeing = range(5, 3 * BLOCK, 20)
    for index in seeing:
        away[index] = looking(index, yaw_deg=5.0)
    assert chosen("overlap_random", away, looking(200), 20)[:-2] != list(seeing), "in no order"
    assert sorted(chosen("overlap_random", away, looking(200), 20)[:-2]) == list(seeing)
    drawn = Counter(chosen("overlap_random", away, looking(200), 3, seed)[0] for seed in range(500))
    assert set(drawn) == set(seeing)
    assert min(drawn.values()) > 100 - 5 * 9  # 500 draws of five: 100 each, nine is one sigma


def test_random_overlap_does_not_ask_more_keyframes_for_a_longer_run(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = 0
    inner = keyframes_module.stacked

    def counted(poses: Sequence[OptimizablePose]) -> Tensor:
        nonlocal asked
        asked += len(poses)
        return inner(poses)

    monkeypatch.setattr(keyframes_module, "stacked", counted)
    for count in (4 * BLOCK, 8 * BLOCK):
        asked = 0
        assert len(chosen("overlap_random", row(count), looking(999), 20)) == 20
        assert asked == BLOCK


def test_a_point_is_seen_where_it_projects_inside() -> None:
    """Against the camera's own projection: points all around, in front and behind."""
    generator = random()
    points = 3 * torch.randn(4000, 3, generator=generator)
    frames = [looking(i, yaw_deg=40.0 * i, x=0.3 * i) for i in range(9)]
    frames[4].camera = dataclasses.replace(CAMERA, fx=60.0, cx=30.0, cy=50.0)
    found = keyframes_module._seen(frames, points, 5.0)
    for frame, fraction in zip(frames, found, strict=True):
        pixels, depth = frame.camera.project(se3.transform(se3.inverse(frame.pose.matrix().detach()), points))
        expected = (frame.camera.contains(pixels, 5.0) & (depth > 0)).float().mean()
        assert 0.02 < expected < 0.5
        assert abs(float(fraction - expected)) <= 1 / 4000 + 1e-6  # one on the border may fall over it


def test_random_reaches_every_keyframe() -> None:
    drawn = {index for seed in range(60) for index in chosen("random", row(8), looking(20), 4, seed)[:2]}
    assert drawn == set(range(7))


@pytest.mark.parametrize("policy", POLICIES)
def test_the_seed_decides(policy: str) -> None:
    picks = [chosen(policy, row(12), looking(20), 5, seed=3) for _ in range(2)]
    assert picks[0] == picks[1]


def test_a_frame_without_a_depth_overlaps_with_nothing() -> None:
    frame = looking(9)
    assert frame.depth is not None
    frame.depth.zero_()
    assert overlap(row(3), frame, random()).tolist() == [0.0, 0.0, 0.0]
    assert overlap([], looking(9), random()).shape == (0,)


def test_keyframes_are_compared_in_blocks_as_one_by_one() -> None:
    """More of them than a block holds, and two cameras in turns: what one costs must not grow with their number."""
    frames = row(2 * BLOCK + 5)
    for frame in frames[BLOCK - 3 : BLOCK + 4]:
        frame.camera = dataclasses.replace(frame.camera, fx=0.8 * frame.camera.fx)
    together = overlap(frames, looking(99), random())
    alone = torch.cat([overlap([frame], looking(99), random()) for frame in frames])
    torch.testing.assert_close(together, alone, rtol=0, atol=1 / 1600 + 1e-6)  # a point on the border may fall over it
    assert len(together.unique()) > 3
