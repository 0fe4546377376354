"""SplaTAM's mapper: seed what is missing, then fit a random window frame at each iteration, pruning on the way."""

from xrdslam.algorithms.splatam.config import SplatamMappingConfig
from xrdslam.algorithms.splatam.model import GaussianMap
from xrdslam.core.mapping import GradientMapping, MappingProblem
from xrdslam.core.optimisation import GroupedOptimiser

__all__ = ["SplatamMapping"]


class SplatamMapping(GradientMapping):
    """Gradient-based mapping with poses held (as SplaTAM does) and pruning between backward pass and step."""

    config: SplatamMappingConfig

    def before_step(self, problem: MappingProblem, optimiser: GroupedOptimiser, iteration: int) -> None:
        if iteration in self.config.prune_at and isinstance(problem.model, GaussianMap):
            problem.model.prune(optimiser)
