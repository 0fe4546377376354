"""NICE-SLAM (Zhu, Peng, Larsson, Xu, Bao, Cui, Oswald and Pollefeys, CVPR 2022, arXiv 2112.12130)."""

import torch

from xrdslam.algorithms.nice_slam.config import NiceSlamConfig
from xrdslam.algorithms.nice_slam.model import NiceSlamMap, bounds_of
from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.frame import Frame

__all__ = ["NiceSlam"]


class NiceSlam(Algorithm):
    """Grids that grow with what is seen, every fifth frame mapped with overlapping keyframes."""

    needs = frozenset({"rgb", "depth"})
    config: NiceSlamConfig

    def build_model(self, scene: Scene, frame: Frame) -> NiceSlamMap:
        """Build the grids in the box that the user states, or about the first frame and what the data states."""
        given = self.config.map.bounds
        if given is not None:
            return NiceSlamMap(self.config.map, torch.tensor(given, dtype=torch.float32).reshape(2, 3), grows=False)
        bounds = bounds_of(frame, frame.pose.matrix().detach(), self.config.map.margin_m)
        if scene.bounds is not None:
            stated = scene.bounds.float()
            bounds = torch.stack((torch.minimum(bounds[0], stated[0]), torch.maximum(bounds[1], stated[1])))
        return NiceSlamMap(self.config.map, bounds)
