"""The two stages of a run, timed and announced: Tracker and Mapper."""

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy

import torch

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.errors import RunError
from xrdslam.core.frame import Frame
from xrdslam.core.mapping import MappingResult
from xrdslam.core.model import Model
from xrdslam.core.optimisation import IterativeOptimisation
from xrdslam.core.tracking import TrackingResult
from xrdslam.engine.heap import EVERY, give_back
from xrdslam.engine.profile import FrameCost, Profile

__all__ = ["Mapper", "Tracker", "not_finite"]

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
    """Puts each frame into the map; a step that descends losses and ends in what is no number is taken back."""

    def __init__(self, algorithm: Algorithm, profile: Profile) -> None:
        self.algorithm = algorithm
        self.profile = profile
        self._num_frames = 0

    def step(self, frame: Frame, cost: FrameCost) -> MappingResult | None:
        """Map a frame where it is due; RunError where the map diverged: what follows would hang on it."""
        with self.profile.stage(cost, "mapping"), self._taken_back(f"mapping of frame {frame.index}") as losses:
            result = self.algorithm.map(frame)
            if result is not None and result.iterations:
                losses.append(result.loss)
        cost.mapping_iterations = result.iterations if result is not None else 0
        self._num_frames += 1
        if self._num_frames % EVERY == 0:
            give_back()
        cost.map_size = self.algorithm.model.size
        cost.is_keyframe = bool(self.algorithm.keyframes) and self.algorithm.keyframes[-1] is frame
        return result

    def finish(self) -> None:
        """Refine after the last frame; RunError where that diverged."""
        with self.profile.finishing(), self._taken_back("refining the map after the last frame"):
            self.algorithm.finish()

    @contextmanager
    def _taken_back(self, what: str) -> Iterator[list[float]]:
        """Give the map back as it was where a loss or a parameter is no number; losses are put into what is yielded.

        A copy costs less than one of Adam's steps. Methods that do not descend cannot diverge and are spared it.
        """
        model = self.algorithm.model
        descends = isinstance(self.algorithm.mapping, IterativeOptimisation)
        before = {name: deepcopy(t) for name, t in model.state_dict().items()} if descends else {}
        losses: list[float] = []
        yield losses
        wrong = [f"its loss is {loss}" for loss in losses if not math.isfinite(loss)] + not_finite(model)
        if not wrong:
            return
        if descends:
            model.load_state_dict(before)
        raise RunError(
            f"{what} diverged: {wrong[0]}; {'the map is kept as it was before. Lower' if descends else 'lower'} the "
            "map's learning rates, or leave the frame out with dataset.frames"
        )


def not_finite(model: Model) -> list[str]:
    """Say which of a map's parameters hold what is no number, if any."""
    parameters = [(name, p) for name, p in model.named_parameters() if p.is_floating_point()]
    return [f"{name} is not finite" for name, p in parameters if not bool(torch.isfinite(p.detach().sum()))]
