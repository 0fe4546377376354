"""SplaTAM: splat, track and map 3-D Gaussians for dense RGB-D SLAM (Keetha et al., CVPR 2024, arXiv 2312.02126)."""

from xrdslam.algorithms.splatam.config import SplatamConfig
from xrdslam.algorithms.splatam.model import GaussianMap
from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.frame import Frame

__all__ = ["Splatam"]


class Splatam(Algorithm):
    """One global set of Gaussians, no loop closure: track(t), seed(t), map(t)."""

    needs = frozenset({"rgb", "depth"})
    config: SplatamConfig

    def build_model(self, scene: Scene, frame: Frame) -> GaussianMap:
        """Build the empty map; the scene's radius is the first frame's largest depth over the configured ratio."""
        assert frame.depth is not None, "checked before the first frame"
        radius = float(frame.depth.max()) / self.config.map.scene_radius_ratio
        return GaussianMap(self.config.map, radius)
