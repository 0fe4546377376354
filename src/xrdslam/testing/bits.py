"""Comparing results bit by bit: NaN equals NaN of the same bits, 0 does not equal -0."""

import io
from collections.abc import Iterator, Mapping
from typing import TypeVar

import torch
from torch import Tensor

from xrdslam.core.frame import Frame

__all__ = ["different_leaves", "frame_images", "through_a_file"]

State = TypeVar("State")


def different_leaves(a: object, b: object) -> list[str]:
    """Return the dotted names of the tensors in two nests of mappings that differ in dtype, shape or any bit."""
    left, right = dict(_leaves(a)), dict(_leaves(b))
    return sorted(key for key in left.keys() | right.keys() if left.get(key) != right.get(key))


def frame_images(frame: Frame) -> dict[str, Tensor]:
    """Return copies of what a frame holds beside its pose."""
    return {name: buffer.detach().clone() for name, buffer in frame.named_buffers()}


def through_a_file(state: State) -> State:
    """Return what is read back where `state` was written: plain tensors come through, code does not."""
    file = io.BytesIO()
    torch.save(state, file)
    file.seek(0)
    read: State = torch.load(file, weights_only=True)
    return read


def _leaves(tree: object, prefix: str = "") -> Iterator[tuple[str, object]]:
    if isinstance(tree, Mapping):
        for key, value in tree.items():
            yield from _leaves(value, f"{prefix}{key}.")
    elif isinstance(tree, Tensor):
        dense = tree.detach().cpu().contiguous()
        yield prefix[:-1], (dense.dtype, tuple(dense.shape), dense.reshape(-1).view(torch.uint8).numpy().tobytes())
    else:
        yield prefix[:-1], repr(tree)
