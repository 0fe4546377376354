"""What processes share is guarded where two may touch it, and costs the same for the last frame as for the first."""

import ast
import pickle
import threading
import time
from multiprocessing import get_context
from pathlib import Path

import pytest
import torch

import xrdslam.core
from xrdslam.core.frame import Frame, StereoView
from xrdslam.core.shared_algorithm import Entry, SharedAlgorithm
from xrdslam.engine.multiprocess.frame_ring import FrameRing, Holder
from xrdslam.engine.multiprocess.messages import Finished, Spent, pack, unpack
from xrdslam.engine.multiprocess.replica import SharedTrajectory
from xrdslam.engine.multiprocess.shared_event import SharedEvent
from xrdslam.testing.misbehaving import sleep_through
from xrdslam.testing.toy_sequence import toy_sequence

SOURCES = Path(next(iter(xrdslam.core.__path__))).parent


class SlowList(list[Entry]):
    """A list that leaves others time to come between an entry and its number."""

    def append(self, entry: Entry) -> None:
        super().append(entry)
        time.sleep(0.002)


def test_steps_that_are_recorded_at_the_same_time_keep_one_order() -> None:
    shared = SharedAlgorithm(["test"])
    shared._entries = SlowList()
    numbers: list[tuple[int, int]] = []

    def record(worker: int) -> None:
        for step in range(10):
            index = 100 * worker + step
            numbers.append((shared.record(Entry("tracked", index, b"")), index))

    threads = [threading.Thread(target=record, args=(worker,)) for worker in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [number for number, _ in sorted(numbers)] == list(range(40))
    assert [entry.index for entry in shared.since(0, "test")] == [index for _, index in sorted(numbers)]
    assert [entry.index for entry in shared.since(38, "test")] == [index for _, index in sorted(numbers)][38:]


def step(index: int) -> Entry:
    return Entry("tracked", index, b"")


def test_steps_are_kept_until_every_reader_knows_them() -> None:
    shared = SharedAlgorithm(["tracker", "mapper"])
    assert [shared.record(step(index)) for index in range(4)] == [0, 1, 2, 3]
    assert [entry.index for entry in shared.since(0, "tracker")] == [0, 1, 2, 3]
    assert [entry.index for entry in shared.since(4, "tracker")] == []
    assert [entry.index for entry in shared.since(0, "mapper")] == [0, 1, 2, 3], "asking is not yet knowing"
    assert [entry.index for entry in shared.since(3, "mapper")] == [3]
    assert len(shared._entries) == 1
    assert shared.record(step(4)) == 4, "numbers go on"
    assert [entry.index for entry in shared.since(3, "mapper")] == [3, 4]
    assert [entry.index for entry in shared.since(4, "tracker")] == [4]
    with pytest.raises(LookupError, match=r"mapper asks for step 2; those before 3 are dropped"):
        shared.since(2, "mapper")


def test_a_reader_that_has_ended_keeps_no_steps() -> None:
    shared = SharedAlgorithm(["tracker", "visualizer"])
    for index in range(3):
        shared.record(step(index))
    assert shared.since(3, "tracker") == []
    assert len(shared._entries) == 3, "a viewer may be slow"
    shared.forget("visualizer")
    assert shared._entries == []
    shared.forget("visualizer")
    shared.record(step(3))
    assert [entry.index for entry in shared.since(3, "visualizer")] == [3], "whoever else asks holds nothing back"
    assert shared.since(4, "tracker") == []
    assert shared._entries == []


def test_no_lock_is_left_out_by_an_and() -> None:
    """`with lock and no_grad():` enters the second alone."""
    wrong = [
        f"{path}:{node.lineno}"
        for path in SOURCES.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.With | ast.AsyncWith)
        and any(isinstance(item.context_expr, ast.BoolOp) for item in node.items)
    ]
    assert wrong == []


def test_an_event_never_waits_for_a_sleeper_that_was_killed() -> None:
    event, asleep = SharedEvent(), SharedEvent()
    sleeper = get_context("spawn").Process(target=sleep_through, args=(event, asleep), daemon=True)
    sleeper.start()
    assert asleep.wait(60.0)
    sleeper.kill()
    sleeper.join()
    setter = threading.Thread(target=event.set, daemon=True)
    setter.start()
    setter.join(10.0)
    assert not setter.is_alive()
    assert event.is_set()
    event.clear()
    assert not event.is_set()
    event.clear()


def test_a_frame_is_told_in_as_many_bytes_however_long_the_trajectory_is() -> None:
    trajectory, sizes = SharedTrajectory(), []
    for index in range(300):
        trajectory.append(index, 10**9 + index, torch.eye(4))
        if index == 0:
            trajectory.make_keyframe(index)
        sizes.append(len(pickle.dumps(trajectory.take_changes())))
    assert max(sizes[1:]) <= sizes[1] + 16  # a larger number may take a byte more
    assert sizes[-1] < 4096


def test_a_frame_is_handed_over_without_its_images() -> None:
    sequence = toy_sequence(2, 320, 240)
    ring = FrameRing(sequence)
    for frame in ring.fill(sequence.frames(), [Holder.TRACKER]):
        placed = ring.take(frame.index)
        assert len(pickle.dumps(placed)) < 4096 < frame.rgb.nbytes / 100
        assert torch.equal(ring.frame(placed).rgb, sequence[frame.index].rgb)


def test_the_right_image_of_a_pair_travels_along_and_a_copy_keeps_it() -> None:
    sequence = toy_sequence(3, 48, 36)
    left, right = sequence[0], sequence[1]
    pair = Frame(0, 0, left.camera, left.rgb, left.depth, stereo=StereoView(right.rgb, 0.11))
    ring = FrameRing(sequence)
    placed = ring.put(pair, [Holder.TRACKER])
    seen, copied = ring.frame(placed), ring.copy(placed)
    assert copied is not None
    for frame in (seen, copied):
        assert frame.stereo is not None
        assert frame.stereo.baseline_m == 0.11
        assert torch.equal(frame.stereo.rgb, right.rgb)
    ring.let_go(placed, Holder.TRACKER)
    other = sequence[2]
    ring.put(Frame(2, 0, other.camera, other.rgb, other.depth, stereo=StereoView(other.rgb, 0.11)), [Holder.TRACKER])
    assert not torch.equal(seen.stereo.rgb, right.rgb), "the slot is used again"
    assert torch.equal(copied.stereo.rgb, right.rgb)
    assert torch.equal(copied.rgb, left.rgb)
    assert ring.copy(placed) is None


def test_messages_come_out_as_they_went_in() -> None:
    """Whatever a method puts into a result's details: what numpy has no type for, views, parameters, nothing."""
    tensors = {
        "pose": torch.linspace(-1.0, 1.0, 16, dtype=torch.float64).view(4, 4),
        "turned": torch.arange(12.0).view(3, 4).T,
        "part": torch.arange(10)[2:5],
        "scalar": torch.tensor(-0.0),
        "empty": torch.empty(0, 4, 4),
        "flags": torch.tensor([True, False]),
        "not finite": torch.tensor([float("nan"), float("-inf")]),
        "half": torch.ones(2, dtype=torch.bfloat16),
        "complex": torch.tensor([1j]).conj(),
        "learned": torch.nn.Parameter(torch.ones(2)),
    }
    message = Finished(tensors, 7, 0.5, 0.25, Spent(1.0, 2.0, 3.0))
    entry = pack(message)
    assert (entry.kind, entry.index) == ("finished", -1)
    received = unpack(entry)
    assert isinstance(received, Finished)
    assert (received.version, received.spent) == (7, message.spent)
    for name, tensor in tensors.items():
        other = received.trajectory[name]
        assert (other.dtype, other.shape, type(other)) == (tensor.dtype, tensor.shape, type(tensor))
        assert torch.equal(torch.nan_to_num(other), torch.nan_to_num(tensor))
        assert torch.equal(torch.isnan(other), torch.isnan(tensor))
    assert received.trajectory["scalar"].signbit()
    pose = received.trajectory["pose"]
    assert pose.data_ptr() % 64 == 0  # as torch's own memory: the bits of a product may depend on it
    pose.zero_()
    assert not bool((tensors["pose"] == 0).all())
