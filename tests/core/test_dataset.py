"""What every dataset inherits: order, and damaged frames that stop a run or are skipped."""

import logging

import pytest

from xrdslam.core.errors import DataError
from xrdslam.testing import ToySequence, toy_sequence


def damaged() -> ToySequence:
    return ToySequence(5, toy_sequence(1, 16, 12).camera, damaged=[1, 3])


def test_frames_come_in_order() -> None:
    assert [frame.index for frame in toy_sequence(4, 16, 12).frames()] == [0, 1, 2, 3]


def test_a_damaged_frame_stops_the_run() -> None:
    frames = damaged().frames()
    assert next(frames).index == 0
    with pytest.raises(DataError, match="frame 1 is damaged"):
        next(frames)


def test_a_damaged_frame_is_skipped_where_that_is_asked_for(caplog: pytest.LogCaptureFixture) -> None:
    dataset = damaged()
    dataset.on_error = "skip"
    for _ in range(2):  # counted anew each time
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            assert [frame.index for frame in dataset.frames()] == [0, 2, 4]
        assert dataset.num_skipped == 2
        assert [record.getMessage()[:15] for record in caplog.records] == ["frame 1 skipped", "frame 3 skipped"]


def test_only_damage_is_skipped_not_a_bug() -> None:
    class Buggy(ToySequence):
        def _view(self, T_world_camera: object) -> object:  # type: ignore[override]  # a bug, on purpose
            raise ZeroDivisionError

    dataset = Buggy(2, toy_sequence(1, 16, 12).camera)
    dataset.on_error = "skip"
    with pytest.raises(ZeroDivisionError):
        next(dataset.frames())


def test_no_frames_are_refused_before_the_first() -> None:
    with pytest.raises(DataError, match="toy/room0 has no frames"):
        toy_sequence(0).check()
    toy_sequence(1).check()


def test_bounds_and_mesh_are_optional() -> None:
    dataset = toy_sequence(1)
    assert dataset.bounds is None
    assert dataset.ground_truth_mesh is None
