"""Methods that go wrong at frame 3, each in its own way, for tests of what surrounds methods."""

import dataclasses
import os
import signal
from collections.abc import Sequence

from xrdslam.core.frame import Frame
from xrdslam.core.mapping import GradientMapping, MappingResult
from xrdslam.core.model import Model
from xrdslam.core.tracking import GradientTracking, TrackingResult
from xrdslam.core.trajectory import Trajectory

__all__ = [
    "DivergingMapping",
    "FailingMapping",
    "FailingTracking",
    "KilledMapping",
    "KilledTracking",
    "LeavingTracking",
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


class DivergingMapping(GradientMapping):
    """Ends with a loss that is no number."""

    def map(self, frame: Frame, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        result = super().map(frame, model, keyframes)
        return dataclasses.replace(result, loss=float("nan")) if frame.index == FRAME else result
