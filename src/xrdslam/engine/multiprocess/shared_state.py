"""Tensors that one process publishes and others read, whole at any moment."""

import os
import pickle
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from xrdslam.core.errors import PluginError, RunError
from xrdslam.engine.multiprocess.memory import SharedMemory, place

__all__ = ["Published", "SharedState", "same_bits"]

WORDS = 4096
"""Bytes at the block's beginning: the latest version, then the version that each of the two buffers holds."""
HEAD = 2**24
"""Bytes at each buffer's beginning: how long its table of contents is, and the table."""


class Published(NamedTuple):
    """One version of the tensors."""

    version: int
    base: int
    """A number that the publisher gave with them."""
    tensors: dict[str, Tensor]


class SharedState:
    """Two buffers that are written in turn, each with its version: who dies while writing leaves the other one whole.

    One process publishes at a time. A reader that copies checks afterwards that its buffer was not written to meanwhile
    (a sequence lock); one that knows that nobody writes takes views.
    """

    def __init__(self) -> None:
        physical = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        self._capacity = HEAD + physical  # what is larger could not be there; what is not used costs nothing
        self._memory = SharedMemory(WORDS + 2 * self._capacity)

    @property
    def _words(self) -> Tensor:
        return self._memory.bytes[:24].view(torch.int64)

    def _start(self, version: int) -> int:
        return WORDS + version % 2 * self._capacity

    @property
    def version(self) -> int:
        """The latest whole version; 0 before the first."""
        return int(self._words[0])

    def publish(self, tensors: Mapping[str, Tensor], base: int = 0) -> int:
        """Write all tensors as the next version and return it."""
        _check_tensors(tensors)
        version, words = self.version + 1, self._words
        places, end = place(tensors, HEAD)
        head = pickle.dumps((base, places))
        if end > self._capacity or len(head) + 8 > HEAD:
            raise RunError(f"the map takes {end / 2**20:.0f} MiB, more than this machine has")
        start = self._start(version)
        words[1 + version % 2] = 0
        for name, where in places.items():
            self._memory.tensor(where, start).copy_(tensors[name].detach())
        block = self._memory.bytes[start : start + HEAD].numpy()
        block[:8].view(np.int64)[0] = len(head)
        block[8 : 8 + len(head)] = np.frombuffer(head, np.uint8)
        words[1 + version % 2] = version
        words[0] = version
        return version

    def latest(self) -> Published:
        """Return the latest version where there is one."""
        published = self.read()
        assert published is not None, "who asks was told so"
        return published

    def read(self, copied: bool = True) -> Published | None:
        """Return the latest version, None before the first; views instead of copies where nobody writes meanwhile."""
        while version := self.version:
            start = self._start(version)
            block = self._memory.bytes[start : start + HEAD].numpy()
            head = block[8 : 8 + int(block[:8].view(np.int64)[0])].tobytes()
            if int(self._words[1 + version % 2]) != version:
                continue
            base, places = pickle.loads(head)
            tensors = {name: self._memory.tensor(where, start) for name, where in places.items()}
            if not copied:
                return Published(version, base, tensors)
            tensors = {name: tensor.clone() for name, tensor in tensors.items()}
            if int(self._words[1 + version % 2]) == version:
                return Published(version, base, tensors)
        return None


def same_bits(a: Tensor, b: Tensor) -> bool:
    """Say whether two tensors hold the same bits; NaN equals itself, 0 does not equal -0."""
    if a.dtype != b.dtype or a.shape != b.shape:
        return False
    left, right = (t.detach().to("cpu").contiguous().reshape(-1).view(torch.uint8).numpy() for t in (a, b))
    return left.nbytes == 0 or bool(np.array_equal(_words_of(left), _words_of(right)))


def _words_of(data: np.ndarray) -> np.ndarray:
    return data.view(np.int64) if data.nbytes % 8 == 0 else data


def _check_tensors(tensors: Mapping[str, object]) -> None:
    for name, tensor in tensors.items():
        if not isinstance(tensor, Tensor):
            raise PluginError(
                f"state_dict() has {name!r}, a {type(tensor).__name__}: only tensors go from process to process; "
                "give numbers as a tensor (get_extra_state too), or use engine=sequential"
            )
