"""The state of a run between its processes and a checkpoint: gathered from them, and handed on to them."""

from collections.abc import Mapping
from typing import Any

from torch import Tensor

from xrdslam.core.algorithm import Algorithm
from xrdslam.engine.context import Run
from xrdslam.engine.multiprocess.channels import Channels
from xrdslam.engine.multiprocess.frame_ring import Holder
from xrdslam.engine.multiprocess.messages import Resumed
from xrdslam.engine.multiprocess.replica import map_state

__all__ = ["gathered", "hand_on", "load_tracker_state", "tracker_state"]

GUARD = "guard."


def gathered(algorithm: Algorithm, channels: Channels) -> dict[str, Any]:
    """Return what `Algorithm.state_dict` returns, while the processes wait: tracking and mapping are theirs.

    `algorithm` is the parent's, whose map, trajectory and keyframes have followed.
    """
    known = channels.tracking.latest().tensors
    return {
        **algorithm.results_state(),
        "model": dict(algorithm.model.state_dict()),
        "tracking": _without(GUARD, known),
        "guard": _with(GUARD, known),
        "mapping": channels.mapping.latest().tensors,
    }


def tracker_state(algorithm: Algorithm) -> dict[str, Tensor]:
    """Return what only the tracker knows: its method's state, and that of what watches over it."""
    guard = {f"{GUARD}{name}": tensor for name, tensor in algorithm.guard.state_dict().items()}
    return {**algorithm.tracking.state_dict(), **guard}


def load_tracker_state(algorithm: Algorithm, state: Mapping[str, Tensor]) -> None:
    """Take over what `tracker_state` returned."""
    algorithm.tracking.load_state_dict(_without(GUARD, state))
    algorithm.guard.load_state_dict(_with(GUARD, state))


def _with(prefix: str, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): t for name, t in state.items() if name.startswith(prefix)}


def _without(prefix: str, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name: t for name, t in state.items() if not name.startswith(prefix)}


def hand_on(run: Run, channels: Channels) -> Resumed:
    """Publish what a run was restored to, for processes that are about to start; return their first step."""
    algorithm, ring = run.algorithm, channels.frames
    channels.map.publish(map_state(algorithm))
    channels.tracking.publish(tracker_state(algorithm))
    channels.mapping.publish(algorithm.mapping.state_dict())
    first = algorithm.trajectory.first
    assert first is not None, "a checkpoint has at least one frame"
    holders = (Holder.TRACKER, Holder.MAPPER)  # for good: the first frame and the keyframes stay
    keyframes = [ring.put(keyframe, holders) for keyframe in algorithm.keyframes]
    return Resumed(ring.put(run.dataset[first], holders), keyframes, algorithm.trajectory.state_dict())
