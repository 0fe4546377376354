"""Improving the map by a frame."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor

from xrdslam.core.batch import Batch, BatchKind, ImageBatch
from xrdslam.core.config import IterativeMappingConfig, MappingConfig
from xrdslam.core.dataset import Modality
from xrdslam.core.frame import Frame
from xrdslam.core.keyframes import select_keyframes
from xrdslam.core.model import Model
from xrdslam.core.optimisation import (
    GroupedOptimiser,
    IterativeOptimisation,
    ParameterGroup,
    exponential_decay,
    product,
)
from xrdslam.core.pose import stacked
from xrdslam.core.sampling import sample_rays

__all__ = ["GradientMapping", "MappingMethod", "MappingProblem", "MappingResult"]


@dataclass
class MappingResult:
    """What a mapping step did."""

    iterations: int = 0
    loss: float = float("nan")
    num_added: int = 0
    poses: dict[int, Tensor] = field(default_factory=dict)
    """Poses that moved: frame index -> T_world_camera. The algorithm writes them into the trajectory."""


class MappingMethod(ABC):
    """Puts frames into the map. `changes_map` is false for methods that leave it alone (pure odometry)."""

    needs: ClassVar[frozenset[Modality]] = frozenset({"rgb"})
    changes_map: ClassVar[bool] = True
    batch_kinds: ClassVar[frozenset[BatchKind]] = frozenset()
    """The batches that the method draws for the map's losses; empty: it takes what the map reads, or has no losses."""

    def __init__(self, config: MappingConfig, seed: int = 0) -> None:
        self.config: Any = config
        self.generator = torch.Generator().manual_seed(seed)

    @abstractmethod
    def map(self, frame: Frame, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        """Grow and improve the map by `frame`, seen from `frame.pose`; `keyframes` are the earlier ones, in order."""

    def finish(self, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        """Refine once more after the last frame."""
        return MappingResult()

    def state_dict(self) -> dict[str, Tensor]:
        """Return what a resumed run needs."""
        return {"generator": self.generator.get_state()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take over what `state_dict` returned."""
        self.generator.set_state(state["generator"])


@dataclass
class MappingProblem:
    """A map to be improved over a window of frames, the current one last."""

    model: Model
    window: list[Frame]
    is_first: bool
    anchor_index: int
    """The frame whose pose holds the world: it never moves."""
    is_final: bool = False
    """Whether the last frame has passed: no pose moves any more, and learning rates fall."""
    memory: dict[str, Any] = field(default_factory=dict)


class GradientMapping(MappingMethod, IterativeOptimisation[MappingProblem]):
    """Grows the map, then descends its own mapping losses over a keyframe window; poses too where rates are set."""

    needs = frozenset({"rgb", "depth"})
    config: IterativeMappingConfig

    def __init__(self, config: IterativeMappingConfig, seed: int = 0) -> None:
        super().__init__(config, seed)
        self._optimiser: GroupedOptimiser | None = None
        self._saved_moments: dict[str, Tensor] = {}

    def map(self, frame: Frame, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        """Choose the window, extend by the frame, optimise, report the poses that moved."""
        window = self.select(frame, keyframes)
        anchor = keyframes[0].index if keyframes else frame.index
        problem = MappingProblem(model, window, model.size == 0, anchor)
        self._restore(problem)
        added = model.extend(frame, frame.pose.matrix().detach())
        optimum = self.optimise(problem)
        moved = self.movable(problem)
        # Where keyframes moved, the frame is named too, for it would else be carried along by its keyframe.
        poses = {}
        if moved:
            matrices = stacked([f.pose for f in (*moved, frame)]).detach()
            poses = {f.index: matrix for f, matrix in zip((*moved, frame), matrices, strict=True)}
        return MappingResult(optimum.iterations, float(optimum.loss), added, poses)

    def finish(self, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        """Let the map settle on all keyframes where final iterations are set, its rates falling, poses fixed."""
        if not self.config.final_iterations_per_keyframe or not keyframes or model.size == 0:
            return MappingResult()
        problem = MappingProblem(model, list(keyframes), False, keyframes[0].index, is_final=True)
        self._restore(problem)
        optimum = self.optimise(problem)
        return MappingResult(optimum.iterations, float(optimum.loss))

    def select(self, frame: Frame, keyframes: Sequence[Frame]) -> list[Frame]:
        """Choose the window."""
        return select_keyframes(self.config.keyframes, keyframes, frame, self.config.window, self.generator)

    def num_iterations(self, problem: MappingProblem) -> int:
        if problem.is_final:
            return self.config.final_iterations_per_keyframe * len(problem.window)
        first = self.config.first_iterations or self.config.iterations
        return first if problem.is_first else self.config.iterations

    def movable(self, problem: MappingProblem) -> list[Frame]:
        """Return the frames whose poses are optimised: all but the anchor, where rates are set."""
        if problem.is_final or (self.config.lr_pose_rotation == 0 and self.config.lr_pose_translation == 0):
            return []
        return [f for f in problem.window if f.index != problem.anchor_index]

    def groups(self, problem: MappingProblem) -> list[ParameterGroup]:
        return problem.model.parameter_groups()

    def pose_groups(self, problem: MappingProblem) -> list[ParameterGroup]:
        """Return the window's poses as groups; they are built anew at every call, whatever the map's optimiser does."""
        rates = (self.config.lr_pose_rotation, self.config.lr_pose_translation)
        return [
            ParameterGroup(**group, accumulate=self.config.pose_accumulate)
            for frame in self.movable(problem)
            for group in frame.pose.parameter_groups(*rates)
        ]

    def optimiser(self, problem: MappingProblem) -> GroupedOptimiser:
        """Build the optimiser: the map's anew or with its moments kept (`keep_optimiser`), the poses' always anew."""
        groups = self.groups(problem)
        if problem.is_final:
            first, last = self.config.final_rates
            fall = exponential_decay(last / first, self.num_iterations(problem))
            groups = [dataclasses.replace(g, lr=first * g.lr, schedule=product(g.schedule, fall)) for g in groups]
        built = GroupedOptimiser(groups)
        if self._optimiser is not None and self.config.keep_optimiser and not problem.is_first:
            built.take_moments(self._optimiser)
        self._optimiser = built
        return built.joined(GroupedOptimiser(self.pose_groups(problem)))

    def state_dict(self) -> dict[str, Tensor]:
        """Return what a resumed run needs, kept moments among it (those that still wait for their map as well)."""
        moments = self._saved_moments
        if self._optimiser is not None and self.config.keep_optimiser:
            moments = self._optimiser.state_dict()
        return super().state_dict() | {f"optimiser.{k}": v for k, v in moments.items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take over what `state_dict` returned; the moments wait for the map that they belong to."""
        super().load_state_dict(state)
        self._optimiser = None
        prefix = "optimiser."
        self._saved_moments = {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}

    def _restore(self, problem: MappingProblem) -> None:
        """Give saved moments back to the map's parameters, before the map grows."""
        if self._saved_moments:
            self._optimiser = GroupedOptimiser(self.groups(problem))
            self._optimiser.load_state_dict(self._saved_moments)
            self._saved_moments = {}

    def batch(self, problem: MappingProblem) -> Batch:
        """Draw one window frame at random, or rays over the whole window, as the map takes them."""
        moved = {f.index for f in self.movable(problem)}
        if problem.model.batch_kind == "image":
            drawn = int(torch.randint(len(problem.window), (1,), generator=self.generator))
            frame = problem.window[drawn]
            return ImageBatch(frame, _pose(frame, frame.index in moved))
        poses = [_pose(f, f.index in moved) for f in problem.window]
        return sample_rays(problem.window, poses, self.config.num_pixels, self.generator)

    def losses(self, problem: MappingProblem, iteration: int) -> dict[str, Tensor]:
        return problem.model.losses(self.batch(problem), "mapping")


def _pose(frame: Frame, moves: bool) -> Tensor:
    matrix = frame.pose.matrix()
    return matrix if moves else matrix.detach()
