"""The state of a run between its processes and a checkpoint: gathered from them, and handed on to them."""

from typing import Any

from xrdslam.core.algorithm import Algorithm
from xrdslam.engine.context import Run
from xrdslam.engine.multiprocess.channels import Channels
from xrdslam.engine.multiprocess.frame_ring import Holder
from xrdslam.engine.multiprocess.messages import Resumed
from xrdslam.engine.multiprocess.replica import map_state

__all__ = ["gathered", "hand_on"]


def gathered(algorithm: Algorithm, channels: Channels) -> dict[str, Any]:
    """Return what `Algorithm.state_dict` returns, while the processes wait: tracking and mapping are theirs.

    `algorithm` is the parent's, whose map, trajectory and keyframes have followed.
    """
    return {
        **algorithm.results_state(),
        "model": dict(algorithm.model.state_dict()),
        "tracking": channels.tracking.latest().tensors,
        "mapping": channels.mapping.latest().tensors,
    }


def hand_on(run: Run, channels: Channels) -> Resumed:
    """Publish what a run was restored to, for processes that are about to start; return their first step."""
    algorithm, ring = run.algorithm, channels.frames
    channels.map.publish(map_state(algorithm))
    channels.tracking.publish(algorithm.tracking.state_dict())
    channels.mapping.publish(algorithm.mapping.state_dict())
    first = algorithm.trajectory.first
    assert first is not None, "a checkpoint has at least one frame"
    holders = (Holder.TRACKER, Holder.MAPPER)  # for good: the first frame and the keyframes stay
    keyframes = [ring.put(keyframe, holders) for keyframe in algorithm.keyframes]
    return Resumed(ring.put(run.dataset[first], holders), keyframes, algorithm.trajectory.state_dict())
