"""Finding where a frame was taken."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.core.batch import Batch, BatchKind, ImageBatch
from xrdslam.core.config import IterativeTrackingConfig, TrackingConfig
from xrdslam.core.dataset import Modality
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.core.model import Model
from xrdslam.core.motion import has_velocity
from xrdslam.core.optimisation import IterativeOptimisation, ParameterGroup
from xrdslam.core.pose import OptimizablePose, PivotedPose, RotationKind
from xrdslam.core.sampling import sample_rays
from xrdslam.core.trajectory import Trajectory

__all__ = ["GradientTracking", "TrackingMethod", "TrackingProblem", "TrackingResult", "frozen"]


class TrackingResult(NamedTuple):
    """Where a frame was taken, and how sure that is."""

    T_world_camera: Float[Tensor, "4 4"]
    is_lost: bool = False
    """True: nothing better than the prediction is known; the algorithm keeps the prediction and marks the frame."""
    converged: bool = True
    iterations: int = 0
    loss: float = float("nan")
    reason: str = ""
    """Why the frame is lost, or what finding it again rests on."""
    poses: Mapping[int, Tensor] = MappingProxyType({})
    """Earlier frames that are now believed elsewhere (odometry over a window): frame index -> T_world_camera."""
    is_recognised: bool = False
    """Whether the frame had been lost and was recognised."""


class TrackingMethod(ABC):
    """Finds the pose of one frame after the other.

    `frame.pose` holds the motion model's prediction when `track` is called. `needs` says what a frame must carry,
    `follows_map` whether the method looks at the model, and `batch_kinds` which of its losses it can then descend
    (empty: it uses the model in its own way).
    """

    needs: ClassVar[frozenset[Modality]] = frozenset({"rgb"})
    follows_map: ClassVar[bool] = False
    batch_kinds: ClassVar[frozenset[BatchKind]] = frozenset()

    def __init__(self, config: TrackingConfig, seed: int = 0) -> None:
        self.config: Any = config
        self.generator = torch.Generator().manual_seed(seed)

    def start(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"]) -> None:
        """Hear of the first frame, whose pose is given."""
        self.integrate(frame, T_world_camera)

    @abstractmethod
    def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
        """Find the pose of `frame`."""

    def integrate(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"]) -> None:  # noqa: B027  # optional step
        """Hear of the pose that was accepted (methods that keep a map of their own grow it here)."""

    def finish(self, model: Model) -> Mapping[int, Tensor]:
        """Refine once more after the last frame; return the poses that moved."""
        return {}

    def state_dict(self) -> dict[str, Tensor]:
        """Return what a resumed run needs."""
        return {"generator": self.generator.get_state()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take over what `state_dict` returned."""
        self.generator.set_state(state["generator"])


@contextmanager
def frozen(model: Model) -> Iterator[None]:
    """Let no gradient reach the map: half of the backward pass is saved and nothing accumulates by accident."""
    movable = [p for p in model.parameters() if p.requires_grad]
    for parameter in movable:
        parameter.requires_grad_(False)
    try:
        yield
    finally:
        for parameter in movable:
            parameter.requires_grad_(True)


@dataclass
class TrackingProblem:
    """One frame to be tracked against a frozen map."""

    frame: Frame
    model: Model
    pose: OptimizablePose
    is_predicted: bool = True
    """Whether earlier poses let the motion model predict this one."""
    best_seen: float = float("inf")
    stale_iterations: int = 0
    memory: dict[str, Any] = field(default_factory=dict)
    """Whatever a method keeps between the iterations of one frame."""


class GradientTracking(TrackingMethod, IterativeOptimisation[TrackingProblem]):
    """Moves the pose down the gradient of the model's own tracking losses (Adam, from the predicted pose).

    Works with any map that brings `losses`; a method whose tracking differs overrides the steps that differ.
    """

    needs = frozenset({"rgb", "depth"})
    follows_map = True
    batch_kinds = frozenset({"image", "rays"})
    config: IterativeTrackingConfig

    def __init__(self, config: IterativeTrackingConfig, seed: int = 0) -> None:
        super().__init__(config, seed)
        self.keep_best = config.keep_best

    def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
        """Predict, descend, keep the best; lost where no iteration had a finite loss."""
        predicted = frame.pose.matrix().detach()
        if model.size == 0:
            return TrackingResult(predicted, is_lost=True, converged=False, reason="the map is empty")
        pose = self.parametrise(frame, predicted)
        with frozen(model):
            optimum = self.optimise(TrackingProblem(frame, model, pose, has_velocity(trajectory)))
        if not optimum.is_finite:
            return TrackingResult(predicted, True, False, optimum.iterations, reason="the tracking loss is not finite")
        with torch.no_grad():
            pose.rotation.copy_(optimum.best[0])
            pose.translation.copy_(optimum.best[1])
        return TrackingResult(pose.matrix().detach(), iterations=optimum.iterations, loss=float(optimum.loss))

    def parametrise(self, frame: Frame, predicted: Float[Tensor, "4 4"]) -> OptimizablePose:
        """Return the predicted pose in the parameters that the optimiser moves."""
        kind: RotationKind = "quaternion" if self.config.rotation == "quaternion" else "axis_angle"
        if self.config.pivot == "scene" and frame.depth is not None:
            points_camera = frame.points_camera()
            if len(points_camera):
                return PivotedPose.about(predicted, se3.transform(predicted, points_camera.mean(0)), kind)
        return OptimizablePose.from_matrix(predicted, kind)

    def num_iterations(self, problem: TrackingProblem) -> int:
        unpredicted = self.config.first_iterations or self.config.iterations
        return self.config.iterations if problem.is_predicted else unpredicted

    def groups(self, problem: TrackingProblem) -> list[ParameterGroup]:
        rates = problem.pose.parameter_groups(self.config.lr_rotation, self.config.lr_translation)
        return [ParameterGroup(**group) for group in rates]

    def candidate(self, problem: TrackingProblem) -> tuple[Tensor, ...]:
        return problem.pose.rotation, problem.pose.translation

    def batch(self, problem: TrackingProblem) -> Batch:
        """Draw what one iteration looks at, in the kind that the map takes."""
        if problem.model.batch_kind == "image":
            return ImageBatch(problem.frame, problem.pose.matrix())
        poses = [problem.pose.matrix()]
        return sample_rays([problem.frame], poses, self.config.num_pixels, self.generator, self.config.border_px)

    def losses(self, problem: TrackingProblem, iteration: int) -> dict[str, Tensor]:
        return problem.model.losses(self.batch(problem), "tracking")

    def should_stop(self, problem: TrackingProblem, iteration: int, loss: Tensor) -> bool:
        """Stop after `stop_patience` iterations without progress (off by default; reads the loss only when on)."""
        if not self.config.stop_patience:
            return False
        value = float(loss)
        improved = value < problem.best_seen * (1 - self.config.stop_tolerance)
        problem.stale_iterations = 0 if improved else problem.stale_iterations + 1
        problem.best_seen = min(value, problem.best_seen)
        return problem.stale_iterations >= self.config.stop_patience
