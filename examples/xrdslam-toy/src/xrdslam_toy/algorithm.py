"""The toy as a whole: which map it has."""

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.frame import Frame
from xrdslam_toy.config import ToyConfig
from xrdslam_toy.model import PointMap

__all__ = ["Toy"]


class Toy(Algorithm):
    """Odometry with a map of points beside it."""

    needs = frozenset({"rgb", "depth"})
    config: ToyConfig

    def build_model(self, scene: Scene, frame: Frame) -> PointMap:
        """Build the empty map."""
        return PointMap(self.config.voxel)
