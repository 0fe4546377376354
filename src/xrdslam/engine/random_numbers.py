"""The global streams of random numbers: seeded when a run begins, saved and given back by checkpoints."""

import random
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

__all__ = ["restore_streams", "seed_streams", "streams"]


def seed_streams(seed: int) -> None:
    """Seed Python's, numpy's and torch's global streams: libraries that a plugin uses may draw from them."""
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002  # the legacy stream is the global one
    torch.manual_seed(seed)


def streams() -> dict[str, Any]:
    """Return where the global streams are, as plain data."""
    legacy = np.random.get_state(legacy=False)  # noqa: NPY002
    assert isinstance(legacy, dict), "legacy=False gives a dictionary"
    state = {
        "python": random.getstate(),
        "numpy": {**legacy, "state": {**legacy["state"], "key": legacy["state"]["key"].tolist()}},
        "torch": torch.get_rng_state().tolist(),
    }
    if torch.cuda.is_available():
        state["cuda"] = [device.tolist() for device in torch.cuda.get_rng_state_all()]
    return state


def restore_streams(state: Mapping[str, Any]) -> None:
    """Take the global streams back to where `streams` found them."""
    version, numbers, spare = state["python"]
    random.setstate((version, tuple(numbers), spare))
    keys = np.array(state["numpy"]["state"]["key"], dtype=np.uint32)
    np.random.set_state({**state["numpy"], "state": {**state["numpy"]["state"], "key": keys}})  # noqa: NPY002
    torch.set_rng_state(torch.tensor(state["torch"], dtype=torch.uint8))
    if "cuda" in state and torch.cuda.is_available():
        torch.cuda.set_rng_state_all([torch.tensor(device, dtype=torch.uint8) for device in state["cuda"]])
