"""The two stages of a run, timed and announced: Tracker and Mapper."""

import logging
import math

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.errors import RunError
from xrdslam.core.frame import Frame
from xrdslam.core.mapping import MappingResult
from xrdslam.core.tracking import TrackingResult
from xrdslam.engine.heap import EVERY, give_back
from xrdslam.engine.profile import FrameCost, Profile

__all__ = ["Mapper", "Tracker"]

log = logging.getLogger(__name__)


class Tracker:
    """Finds the pose of each frame."""

    def __init__(self, algorithm: Algorithm, scene: Scene, profile: Profile) -> None:
        self.algorithm = algorithm
        self.scene = scene
        self.profile = profile
        self._num_lost = 0

    def step(self, frame: Frame, cost: FrameCost) -> TrackingResult:
        """Track a frame; the first one sets the world."""
        with self.profile.stage(cost, "tracking"):
            is_first = len(self.algorithm.trajectory) == 0
            result = self.algorithm.start(self.scene, frame) if is_first else self.algorithm.track(frame)
        cost.tracking_iterations = result.iterations
        cost.is_lost = result.is_lost
        self._tell(frame, result)
        return result

    def _tell(self, frame: Frame, result: TrackingResult) -> None:
        """Say of the first of a row of lost frames that it is lost, of the others to those who look for faults."""
        if result.is_lost:
            level = logging.DEBUG if self._num_lost else logging.WARNING
            reason = result.reason or "no reason given"
            log.log(level, "frame %d is lost (%s); its predicted pose is kept", frame.index, reason)
            self._num_lost += 1
        elif self._num_lost or result.is_recognised:
            how = f"recognised by {result.reason}" if result.is_recognised else "tracked"
            log.warning("frame %d is %s, after %d lost frames", frame.index, how, self._num_lost)
            self._num_lost = 0


class Mapper:
    """Puts each frame into the map."""

    def __init__(self, algorithm: Algorithm, profile: Profile) -> None:
        self.algorithm = algorithm
        self.profile = profile
        self._num_frames = 0

    def step(self, frame: Frame, cost: FrameCost) -> MappingResult | None:
        """Map a frame where it is due; RunError where the loss is no number: such a map is lost, and so is the rest."""
        with self.profile.stage(cost, "mapping"):
            result = self.algorithm.map(frame)
        cost.mapping_iterations = result.iterations if result is not None else 0
        if result is not None and result.iterations and not math.isfinite(result.loss):
            raise RunError(
                f"mapping of frame {frame.index} diverged: its loss is {result.loss} after {result.iterations} "
                "iterations; lower the map's learning rates, or leave the frame out with dataset.frames"
            )
        self._num_frames += 1
        if self._num_frames % EVERY == 0:
            give_back()
        cost.map_size = self.algorithm.model.size
        cost.is_keyframe = bool(self.algorithm.keyframes) and self.algorithm.keyframes[-1] is frame
        return result
