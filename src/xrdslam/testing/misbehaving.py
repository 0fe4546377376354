"""Methods that go wrong at frame 3, each in its own way, for tests of what surrounds methods."""

import dataclasses
import os
import signal
from collections.abc import Sequence
from multiprocessing.util import Finalize

from xrdslam.core.frame import Frame
from xrdslam.core.mapping import GradientMapping, MappingMethod, MappingResult
from xrdslam.core.model import Model
from xrdslam.core.tracking import GradientTracking, TrackingResult
from xrdslam.core.trajectory import Trajectory
from xrdslam.engine.multiprocess.shared_event import SharedEvent

__all__ = [
    "DivergingMapping",
    "FailingMapping",
    "FailingTracking",
    "KilledMapping",
    "KilledTracking",
    "LeavingTracking",
    "SpoiltAtLast",
    "SpoiltFusion",
    "SpoiltMapping",
    "VanishingTracking",
    "sleep_through",
]

FRAME = 3


class FailingTracking(GradientTracking):
    """Raises what a fault of a method raises."""

    def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
        if frame.index == FRAME:
            raise ZeroDivisionError("a fault of the tracker")
        return super().track(frame, model, trajectory)


class KilledTracking(GradientTracking):
    """Is killed from outside, so to speak."""

    def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
        if frame.index == FRAME:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().track(frame, model, trajectory)


class LeavingTracking(GradientTracking):
    """Ends its process as if all were well."""

    def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
        if frame.index == FRAME:
            raise SystemExit(0)
        return super().track(frame, model, trajectory)


class VanishingTracking(GradientTracking):
    """Is killed when all is done and said, before what it handed on has left its process."""

    def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
        if frame.index == FRAME:
            Finalize(None, os.kill, (os.getpid(), signal.SIGKILL), exitpriority=10)
        return super().track(frame, model, trajectory)


class FailingMapping(GradientMapping):
    """Raises what a fault of a method raises."""

    def map(self, frame: Frame, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        if frame.index == FRAME:
            raise ZeroDivisionError("a fault of the mapper")
        return super().map(frame, model, keyframes)


class KilledMapping(GradientMapping):
    """Is killed from outside, so to speak."""

    def map(self, frame: Frame, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        if frame.index == FRAME:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().map(frame, model, keyframes)


class SpoiltMapping(GradientMapping):
    """Leaves a map that is no number, from a loss that was one: the step that a gradient of NaN makes."""

    def map(self, frame: Frame, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        result = super().map(frame, model, keyframes)
        if frame.index == FRAME:
            next(model.parameters()).detach()[0] = float("nan")
        return result


class SpoiltAtLast(GradientMapping):
    """Leaves a map that is no number when it refines it after the last frame."""

    def finish(self, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        next(model.parameters()).detach()[0] = float("nan")
        return MappingResult()


class SpoiltFusion(MappingMethod):
    """Descends nothing, and leaves a map that is no number all the same."""

    def map(self, frame: Frame, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        added = model.extend(frame, frame.pose.matrix().detach())
        if frame.index == FRAME:
            next(model.parameters()).detach()[0] = float("nan")
        return MappingResult(num_added=added)


class DivergingMapping(GradientMapping):
    """Ends with a loss that is no number."""

    def map(self, frame: Frame, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        result = super().map(frame, model, keyframes)
        return dataclasses.replace(result, loss=float("nan")) if frame.index == FRAME else result


def sleep_through(event: SharedEvent, asleep: SharedEvent) -> None:
    """Say that it sleeps, and wait for an event."""
    asleep.set()
    event.wait()
