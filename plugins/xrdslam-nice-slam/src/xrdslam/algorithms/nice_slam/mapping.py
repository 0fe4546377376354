"""NICE-SLAM's mapper: the middle grid, then the fine one, then colour and poses, where the frame looks."""

from collections.abc import Sequence
from typing import ClassVar

import torch

from xrdslam.algorithms.nice_slam.config import NiceSlamMappingConfig
from xrdslam.algorithms.nice_slam.field import Level
from xrdslam.algorithms.nice_slam.model import NiceSlamMap
from xrdslam.core.batch import Batch, BatchKind
from xrdslam.core.errors import PluginError
from xrdslam.core.frame import Frame
from xrdslam.core.keyframes import select_keyframes
from xrdslam.core.mapping import GradientMapping, MappingProblem, MappingResult
from xrdslam.core.model import Model
from xrdslam.core.optimisation import Optimum, ParameterGroup, piecewise
from xrdslam.core.sampling import sample_rays

__all__ = ["NiceSlamMapping", "level_of"]


def level_of(iteration: int, iterations: int, middle_share: float, fine_share: float) -> Level:
    """Return what takes part in an iteration: the middle grid up to the first share, inclusive, then the fine one."""
    if iteration <= int(middle_share * iterations):
        return "middle"
    return "fine" if iteration <= int(fine_share * iterations) else "color"


class NiceSlamMapping(GradientMapping):
    """Staged mapping over a window of overlapping keyframes, with local bundle adjustment in the last stage."""

    batch_kinds: ClassVar[frozenset[BatchKind]] = frozenset({"rays"})
    config: NiceSlamMappingConfig

    def __init__(self, config: NiceSlamMappingConfig, seed: int = 0) -> None:
        super().__init__(config, seed)
        self._num_keyframes = 0
        self._refines = False

    def map(self, frame: Frame, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        """Optimise level by level; refused where the map has no levels."""
        if not isinstance(model, NiceSlamMap):
            raise PluginError(
                "algo/mapping=nice_slam optimises the grids of algo=nice_slam level by level, which the map here "
                f"({type(model).__name__}) does not have; choose that map's own algo/mapping"
            )
        self._num_keyframes = len(keyframes)
        return super().map(frame, model, keyframes)

    def finish(self, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        """Optimise a few wider windows with the colour decoder as it is (published as final refinement)."""
        result = MappingResult()
        if not isinstance(model, NiceSlamMap) or len(keyframes) < 2:
            return result
        self._num_keyframes, self._refines = len(keyframes), True
        for _ in range(self.config.final_rounds):
            problem = MappingProblem(model, self.select(keyframes[-1], keyframes), False, keyframes[0].index)
            optimum = self.optimise(problem)
            result.iterations += optimum.iterations
            result.loss = float(optimum.loss)
            result.poses |= {f.index: f.pose.matrix().detach() for f in self.movable(problem)}
        self._refines = False
        return result

    def select(self, frame: Frame, keyframes: Sequence[Frame]) -> list[Frame]:
        """Choose random keyframes among those that overlap, the last one and the frame; twice as many at the end."""
        window = self.config.window * (2 if self._refines else 1)
        return select_keyframes(self.config.keyframes, keyframes, frame, window, self.generator)

    def optimise(self, problem: MappingProblem) -> Optimum:
        """Optimise what the frame (at the end: the window) can say something about, then take it over."""
        model = problem.model
        assert isinstance(model, NiceSlamMap), "map() has refused any other"
        frames = problem.window if self._refines else problem.window[-1:]
        problem.memory["values"] = model.choose(frames, self.config.frustum_margin_m)
        try:
            return super().optimise(problem)
        finally:
            model.settle()
            model.level = "color"

    def movable(self, problem: MappingProblem) -> list[Frame]:
        """Return all frames of the window but the earliest, once there are keyframes enough."""
        if self._num_keyframes < self.config.min_keyframes or not super().movable(problem):
            return []
        earliest = min(f.index for f in problem.window)
        return [f for f in problem.window if f.index != earliest]

    def level(self, problem: MappingProblem, iteration: int) -> Level:
        """Return what takes part in an iteration."""
        shares = (0.0, 0.0) if self._refines else (self.config.middle_share, self.config.fine_share)
        return level_of(iteration, self.num_iterations(problem), *shares)

    def groups(self, problem: MappingProblem) -> list[ParameterGroup]:
        """Return the chosen features and the colour decoder, each with the rates of the levels."""
        model = problem.model
        assert isinstance(model, NiceSlamMap), "map() has refused any other"
        config, factor = model.config, self._factor(problem)
        starts = self._starts(problem)
        rates = {
            "middle": [(0, config.lr_middle_alone), (starts[0], config.lr_grid)],
            "fine": [(0, 0.0), (starts[0], config.lr_grid)],
            "color": [(0, 0.0), (starts[1], config.lr_grid)],
        }
        values = problem.memory["values"]
        groups = [
            ParameterGroup(name, [table], factor, schedule=piecewise(rate))
            for (name, rate), table in zip(rates.items(), values, strict=True)
        ]
        if self._refines:
            return groups
        decoder = list(model.field.color_decoder.parameters())
        late = piecewise([(0, 0.0), (starts[1], 1.0)])
        return [*groups, ParameterGroup("decoder", decoder, factor * config.lr_decoder, schedule=late)]

    def pose_groups(self, problem: MappingProblem) -> list[ParameterGroup]:
        """Return the window's poses, which move with colour only."""
        late = piecewise([(0, 0.0), (self._starts(problem)[1], 1.0)])
        groups = super().pose_groups(problem)
        for group in groups:
            group.schedule = late
        return groups

    def batch(self, problem: MappingProblem) -> Batch:
        """Draw rays over the whole window; poses carry gradients where they move."""
        moves = problem.memory["level"] == "color"
        moved = {f.index for f in self.movable(problem)} if moves else set()
        poses = [f.pose.matrix() if f.index in moved else f.pose.matrix().detach() for f in problem.window]
        return sample_rays(problem.window, poses, self.config.num_pixels, self.generator)

    def losses(self, problem: MappingProblem, iteration: int) -> dict[str, torch.Tensor]:
        level = self.level(problem, iteration)
        problem.memory["level"] = level
        assert isinstance(problem.model, NiceSlamMap), "map() has refused any other"
        problem.model.level = level
        return super().losses(problem, iteration)

    def _starts(self, problem: MappingProblem) -> tuple[int, int]:
        """Return the first iterations of the fine level and of colour."""
        levels = [self.level(problem, i) for i in range(self.num_iterations(problem))]
        count = levels.count("middle")
        return count, count + levels.count("fine")

    def _factor(self, problem: MappingProblem) -> float:
        if not problem.is_first:
            return 1.0
        assert isinstance(problem.model, NiceSlamMap), "map() has refused any other"
        if self.config.first_lr_factor is not None:
            return self.config.first_lr_factor
        return 1.0 if problem.model.field.decoders_are_own else 5.0
