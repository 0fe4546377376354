"""Buffers come back to the pool, whenever a destructor chooses to run."""

import threading
from collections import deque

import numpy as np
import pytest

from xrdslam.ops.splats import scratch
from xrdslam.ops.splats.scratch import Scratch


@pytest.fixture(autouse=True)
def _empty_pool(monkeypatch: pytest.MonkeyPatch) -> None:
    """Start from a pool of nothing: what other tests left in it decides which buffer fits."""
    monkeypatch.setattr(scratch, "_free", [])
    monkeypatch.setattr(scratch, "_returned", deque())


def test_a_buffer_is_used_again() -> None:
    first = Scratch()
    address = first.empty(1_000_003, np.uint8).ctypes.data
    del first
    assert Scratch().empty(1_000_003, np.uint8).ctypes.data == address


def test_arrays_are_aligned_and_do_not_overlap() -> None:
    held = Scratch()
    arrays = [held.empty((7, 5), np.float32) for _ in range(20)]
    for value, array in enumerate(arrays):
        array[:] = value
    assert all((array == value).all() for value, array in enumerate(arrays))
    assert {array.ctypes.data % 64 for array in arrays} == {0}


def test_a_destructor_that_runs_while_the_pool_is_locked_does_not_hang() -> None:
    """Garbage is collected inside any line: a destructor that waits for a lock its own thread holds waits for ever."""

    def collected_inside_take() -> None:
        dying = Scratch()
        dying.empty(10, np.float32)
        with scratch._lock:
            dying.__del__()

    thread = threading.Thread(target=collected_inside_take, daemon=True)
    thread.start()
    thread.join(10)
    assert not thread.is_alive()


def test_the_pool_stays_small() -> None:
    held = [Scratch() for _ in range(60)]
    for one in held:
        one.empty(100, np.float32)
    held.clear()
    del one
    Scratch().empty(100, np.float32)
    assert len(scratch._free) <= 24
