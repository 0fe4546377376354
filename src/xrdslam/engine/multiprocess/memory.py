"""Memory that several processes see, and tensors in it."""

import math
import mmap
import os
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.reduction import DupFd
from typing import Any

import torch
from torch import Tensor

from xrdslam.core.errors import RunError

__all__ = ["PlacedTensor", "SharedMemory", "place"]

ALIGNMENT = 64
"""Bytes; torch's own tensors begin at such addresses, and a kernel that reads aligned memory gives the same bits."""


class SharedMemory:
    """A block of memory without a name: no file, nothing in /dev/shm, gone with the last process that has it.

    Only pages that were written to are there, so a block may be far larger than what it will hold. It goes to a process
    as an argument of its start, not through a queue.
    """

    def __init__(self, size: int) -> None:
        if not hasattr(os, "memfd_create"):
            raise RunError("engine=multiprocess needs Linux (memfd_create); use engine=sequential")
        self._open(os.memfd_create("xrdslam"), size)

    def _open(self, descriptor: int, size: int) -> None:
        os.ftruncate(descriptor, size)
        self.size = size
        self._descriptor = descriptor
        self.bytes = torch.frombuffer(mmap.mmap(descriptor, size), dtype=torch.uint8)

    def __reduce__(self) -> tuple[Any, ...]:
        return _received, (DupFd(self._descriptor), self.size)

    def __del__(self) -> None:
        if hasattr(self, "_descriptor"):
            os.close(self._descriptor)  # the mapping lives on as long as tensors in it do

    def tensor(self, placed: "PlacedTensor", start: int = 0) -> Tensor:
        """Return the tensor that lies at a place, counted from `start`."""
        begin = start + placed.offset
        flat = self.bytes[begin : begin + placed.num_bytes].view(getattr(torch, placed.dtype))
        return flat.as_strided(placed.shape, placed.stride, flat.storage_offset())


def _received(descriptor: Any, size: int) -> SharedMemory:  # noqa: ANN401  # multiprocessing names no type for it
    memory = SharedMemory.__new__(SharedMemory)
    memory._open(descriptor.detach(), size)
    return memory


@dataclass(frozen=True)
class PlacedTensor:
    """Where a tensor lies: plain data that any process can turn into a view."""

    dtype: str
    shape: tuple[int, ...]
    stride: tuple[int, ...]
    offset: int

    @property
    def num_bytes(self) -> int:
        """How much it takes."""
        size: int = getattr(torch, self.dtype).itemsize
        return math.prod(self.shape) * size


def place(tensors: Mapping[str, Tensor], offset: int = 0) -> tuple[dict[str, PlacedTensor], int]:
    """Give each tensor a place, one after the other from `offset`; return the places and the end of the last.

    Order in memory is kept as well as torch can (a channels-last tensor stays one), for sums depend on it.
    """
    places = {}
    for name, tensor in tensors.items():
        offset = -(-offset // ALIGNMENT) * ALIGNMENT
        stride = torch.empty_like(tensor, device="meta").stride()
        places[name] = PlacedTensor(str(tensor.dtype).removeprefix("torch."), tuple(tensor.shape), stride, offset)
        offset += places[name].num_bytes
    return places, offset
