"""Comparing results bit by bit: NaN equals NaN of the same bits, 0 does not equal -0."""

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from xrdslam.core.frame import Frame
from xrdslam.core.saved_state import load_state, save_state

__all__ = ["different_leaves", "frame_images", "through_a_file"]


def different_leaves(a: object, b: object) -> list[str]:
    """Return the dotted names of the tensors in two nests of mappings that differ in dtype, shape or any bit."""
    left, right = dict(_leaves(a)), dict(_leaves(b))
    return sorted(key for key in left.keys() | right.keys() if left.get(key) != right.get(key))


def frame_images(frame: Frame) -> dict[str, Tensor]:
    """Return copies of what a frame holds beside its pose."""
    return {name: buffer.detach().clone() for name, buffer in frame.named_buffers()}


def through_a_file(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is read back where `state` was written as a checkpoint is: tensors come through, code does not."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "state.safetensors"
        save_state(path, state, {})
        return load_state(path)[0]


def _leaves(tree: object, prefix: str = "") -> Iterator[tuple[str, object]]:
    if isinstance(tree, Mapping):
        for key, value in tree.items():
            yield from _leaves(value, f"{prefix}{key}.")
    elif isinstance(tree, Tensor):
        dense = tree.detach().cpu().contiguous()
        yield prefix[:-1], (dense.dtype, tuple(dense.shape), dense.reshape(-1).view(torch.uint8).numpy().tobytes())
    else:
        yield prefix[:-1], repr(tree)
