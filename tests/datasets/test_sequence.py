"""What every sequence of files shares, on a sequence without files: picking, skipping, reading ahead."""

import itertools
import logging
import pickle
import threading
import time
import weakref
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from xrdslam.core.camera import Camera
from xrdslam.core.errors import ConfigError, DataError
from xrdslam.core.frame import Frame
from xrdslam.datasets.config import DatasetConfig
from xrdslam.datasets.prefetch import prefetch
from xrdslam.datasets.sequence import Record, RgbdSequence, SourceCamera

SOURCE = SourceCamera(Camera(5.0, 5.0, 2.0, 1.0, 5, 3), "camera.txt")


class Numbers(RgbdSequence):
    """Frame n is an image of n / 100; the file of a frame in `damaged` cannot be decoded, nor probed in `cut`."""

    damaged: frozenset[str] = frozenset()
    cut: frozenset[str] = frozenset()

    def probe(self, record: Record) -> None:
        if record.rgb.name in self.cut:
            raise DataError(f"{record.rgb}: truncated")

    def read_rgb(self, path: Path) -> np.ndarray:
        if path.name in self.damaged | self.cut:
            raise DataError(f"{path}: damaged")
        return np.full((3, 5, 3), int(path.name) / 100, np.float32)


def sequence(count: int = 10, records: list[Record] | None = None, **knobs: object) -> Numbers:
    made = [Record(n * 1000, Path(f"{n:02d}"), T_world_camera=np.eye(4)) for n in range(count)]
    return Numbers(DatasetConfig(family="numbers", **knobs), "numbers/ten", records or made, SOURCE)


def values(frames: Iterator[Frame]) -> list[int]:
    return [round(float(frame.rgb[0, 0, 0]) * 100) for frame in frames]


@pytest.mark.parametrize(
    ("frames", "picked"),
    [
        ([0, None, 1], list(range(10))),
        ([0, -1, 1], list(range(10))),
        ([3, 7, 1], [3, 4, 5, 6]),
        ([1, None, 4], [1, 5, 9]),
        ([9, 10, 1], [9]),
        ([None, None, None], list(range(10))),
    ],
)
def test_frames_pick_as_a_slice_does(frames: list[int | None], picked: list[int]) -> None:
    dataset = sequence(frames=frames)
    assert len(dataset) == len(picked)
    assert values(dataset.frames()) == picked
    assert [frame.index for frame in dataset.frames()] == list(range(len(picked)))
    assert [frame.timestamp_ns for frame in dataset.frames()] == [1000 * n for n in picked]


@pytest.mark.parametrize("frames", [[0, 5], [0, None, 0], [-1, None, 1], [0, -2, 1], [0, None, -1], []])
def test_frames_that_are_no_slice_are_refused(frames: list[int | None]) -> None:
    with pytest.raises(ConfigError, match=r"dataset\.frames=.*\[start, stop, stride\]"):
        DatasetConfig(frames=frames)


@pytest.mark.parametrize(
    "knobs", [{"size": [0, 4]}, {"size": [4]}, {"max_depth": 0.0}, {"max_depth": float("nan")}, {"on_error": "ignore"}]
)
def test_senseless_knobs_are_refused_by_name(knobs: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match=rf"dataset\.{next(iter(knobs))}="):
        DatasetConfig(**knobs)


def test_frames_that_pick_nothing_are_refused_with_what_there_is() -> None:
    with pytest.raises(ConfigError, match=r"\[10, None, 1\] picks none of the 10 frames of numbers/ten"):
        sequence(frames=[10, None, 1])


def test_a_stop_behind_the_end_is_the_end_and_is_said(caplog: pytest.LogCaptureFixture) -> None:
    assert len(sequence(frames=[0, 11, 1])) == 10
    assert "ends after 10 frames" in caplog.text
    caplog.clear()
    assert len(sequence(frames=[0, 10, 1])) == 10
    assert not caplog.text


def test_an_index_counts_from_either_end_and_no_farther() -> None:
    dataset = sequence()
    assert dataset[-1].index == 9
    for index in (10, -11):
        with pytest.raises(IndexError):
            dataset[index]


def test_no_frames_at_all_is_an_error() -> None:
    with pytest.raises(DataError, match="no frames"):
        Numbers(DatasetConfig(), "numbers/none", [], SOURCE).check()


def test_size_makes_image_and_camera_agree() -> None:
    dataset = sequence(size=[10, 9])
    assert (dataset.camera.width, dataset.camera.height) == (10, 9)
    assert dataset.camera == SOURCE.camera.resized(10, 9)
    assert dataset[0].rgb.shape == (9, 10, 3)


def test_modalities_are_what_every_frame_carries() -> None:
    assert sequence().modalities == {"rgb", "pose"}
    with_depth = [Record(n, Path("1"), Path("2"), np.eye(4)) for n in range(2)]
    assert sequence(records=with_depth).modalities == {"rgb", "depth", "pose"}
    assert sequence(records=[*with_depth, Record(2, Path("1"))]).modalities == {"rgb"}
    assert sequence(records=[*with_depth, Record(2, Path("1"), fault="it has nothing")]).modalities == {
        "rgb",
        "depth",
        "pose",
    }


def test_check_raises_the_first_fault_and_counts_the_rest() -> None:
    dataset = sequence()
    dataset.check()
    dataset.cut = frozenset({"03", "07", "08"})
    with pytest.raises(DataError, match=r"03: truncated \(and 2 more in numbers/ten\)"):
        dataset.check()


def test_check_looks_at_the_picked_frames_only() -> None:
    dataset = sequence(frames=[4, 7, 1])
    dataset.cut = frozenset({"03", "07"})
    dataset.check()


def test_skip_leaves_damaged_frames_out_and_says_how_many(caplog: pytest.LogCaptureFixture) -> None:
    records = [Record(n, Path(f"{n:02d}"), fault="traj.txt, line 5: NaN" if n == 4 else None) for n in range(10)]
    dataset = sequence(records=records, on_error="skip")
    dataset.cut, dataset.damaged = frozenset({"03"}), frozenset({"00"})  # damage that only decoding finds
    dataset.check()
    assert "2 of 10 frames will be skipped: 03: truncated (and 1 more" in caplog.text
    for frames in (dataset.frames(), prefetch(dataset.frames())):
        assert values(frames) == [1, 2, 5, 6, 7, 8, 9]
        assert dataset.num_skipped == 3
    assert [frame.index for frame in dataset.frames()] == [1, 2, 5, 6, 7, 8, 9]  # an index stays with its frame
    with pytest.raises(DataError, match=r"traj\.txt, line 5"):
        dataset[4]


def test_skip_does_not_go_so_far_as_to_leave_nothing() -> None:
    dataset = sequence(on_error="skip")
    dataset.cut = frozenset(f"{n:02d}" for n in range(10))
    with pytest.raises(DataError, match="all 10 frames are damaged"):
        dataset.check()


def test_raise_ends_the_iteration_at_the_damaged_frame() -> None:
    dataset = sequence()
    dataset.damaged = frozenset({"02"})
    for frames in (dataset.frames(), prefetch(dataset.frames())):
        assert values(itertools.islice(frames, 2)) == [0, 1]
        with pytest.raises(DataError, match="02: damaged"):
            next(frames)
    assert not readers()


def test_a_sequence_survives_the_way_to_another_process() -> None:
    dataset = pickle.loads(pickle.dumps(sequence(frames=[2, 8, 2])))
    assert values(dataset.frames()) == [2, 4, 6]


def readers() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name.startswith("prefetch")]


def test_reading_ahead_changes_neither_frames_nor_order() -> None:
    dataset = sequence(50)
    ahead = list(prefetch(dataset.frames()))
    assert values(iter(ahead)) == list(range(50))
    for one, other in zip(ahead, dataset.frames(), strict=True):
        assert torch.equal(one.rgb, other.rgb)
    assert not readers()


@pytest.mark.parametrize("lookahead", [0, 1, 3])
def test_no_more_than_lookahead_frames_wait(lookahead: int) -> None:
    read = 0

    def counted() -> Iterator[Frame]:
        nonlocal read
        for frame in sequence(30).frames():
            read += 1
            yield frame

    for used, _ in enumerate(prefetch(counted(), lookahead=lookahead), 1):
        time.sleep(0.002)  # long enough for a reader without a bound to run away
        assert read <= used + lookahead
    assert read == 30


def test_a_closed_reader_leaves_no_thread_and_reads_no_further() -> None:
    frames = prefetch(sequence(1000).frames())
    next(frames)
    assert len(readers()) == 1
    frames.close()
    assert not readers()


def test_an_error_in_the_loop_leaves_no_thread() -> None:
    def use() -> None:
        for _ in prefetch(sequence(1000).frames()):
            raise KeyError

    with pytest.raises(KeyError):
        use()
    assert not readers()


def test_logging_names_the_skipped_file(caplog: pytest.LogCaptureFixture) -> None:
    dataset = sequence(3, on_error="skip")
    dataset.damaged = frozenset({"01"})
    with caplog.at_level(logging.WARNING):
        list(dataset.frames())
    assert "01: damaged" in caplog.text


def test_frames_that_were_used_are_not_kept() -> None:
    """However long the sequence: those read ahead, the one in use and the one that is being read are alive."""
    alive: weakref.WeakSet[Frame] = weakref.WeakSet()
    most = 0
    for frame in prefetch(sequence(200).frames(), lookahead=2):
        alive.add(frame)
        most = max(most, sum(isinstance(kept, Frame) for kept in alive))
        del frame
    assert most <= 2  # of those handed out: this one, and the last until it is collected


def test_images_are_moved_to_the_device_once(monkeypatch: pytest.MonkeyPatch) -> None:
    moved: list[int] = []
    to = Frame.to

    def counted(frame: Frame, *where: object) -> Frame:
        moved.append(frame.index)
        return to(frame, *where)

    monkeypatch.setattr(Frame, "to", counted)
    assert [frame.index for frame in prefetch(sequence(6).frames(), device="cpu")] == list(range(6))
    assert moved == list(range(6))
