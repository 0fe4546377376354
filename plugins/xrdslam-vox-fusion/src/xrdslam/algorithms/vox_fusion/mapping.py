"""Vox-Fusion's mapper: new voxels, then the map and the poses of a few keyframes on rays of each."""

from typing import ClassVar

import torch

from xrdslam.algorithms.vox_fusion.config import VoxFusionMappingConfig
from xrdslam.core.batch import Batch, BatchKind
from xrdslam.core.mapping import GradientMapping, MappingProblem
from xrdslam.core.optimisation import GroupedOptimiser
from xrdslam.core.sampling import sample_rays

__all__ = ["VoxFusionMapping"]


class VoxFusionMapping(GradientMapping):
    """Random keyframes and the current frame, as many rays of each; the map's Adam goes on from call to call."""

    batch_kinds: ClassVar[frozenset[BatchKind]] = frozenset({"rays"})
    config: VoxFusionMappingConfig

    def batch(self, problem: MappingProblem) -> Batch:
        """Draw rays of every frame of the window; gradients reach the poses that move."""
        moved = {f.index for f in self.movable(problem)}
        poses = [f.pose.matrix() if f.index in moved else f.pose.matrix().detach() for f in problem.window]
        return sample_rays(problem.window, poses, self.config.num_pixels * len(problem.window), self.generator)

    def optimiser(self, problem: MappingProblem) -> GroupedOptimiser:
        """Keep the moments of parameters that were replaced by longer ones, too; new rows begin with none."""
        if self._optimiser is not None:
            held = {group.name: group.params for group in self._optimiser.groups}
            for group in problem.model.parameter_groups():
                for old, new in zip(list(held.get(group.name, ())), group.params, strict=False):
                    if old is not new:
                        _follow(self._optimiser, old, new)
        return super().optimiser(problem)


def _follow(optimiser: GroupedOptimiser, old: torch.nn.Parameter, new: torch.nn.Parameter) -> None:
    """Let the moments of `old` go on as those of `new`, whose first rows are the rows of `old`."""
    rows = torch.arange(len(new), device=new.device)
    optimiser.reindex_(old, new, rows.clamp(max=len(old) - 1))
    for moment in optimiser.moments(new).values():
        if moment.shape == new.shape:
            moment[len(old) :] = 0
