"""Co-SLAM (Wang, Wang and Agapito, CVPR 2023, arXiv 2304.14377)."""

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.algorithms.co_slam.config import CoSlamConfig
from xrdslam.algorithms.co_slam.model import CoSlamMap
from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3

__all__ = ["CoSlam"]


class CoSlam(Algorithm):
    """A field of one size, every fifth frame adjusted with all keyframes."""

    needs = frozenset({"rgb", "depth"})
    config: CoSlamConfig

    def build_model(self, scene: Scene, frame: Frame) -> CoSlamMap:
        """Build the field in the box that the user or the data states, or about the first camera."""
        given = self.config.map.bounds
        if given is not None:
            bounds = torch.tensor(given, dtype=torch.float32).reshape(2, 3)
        elif scene.bounds is not None:
            bounds = scene.bounds.float()
        else:
            bounds = bounds_about(frame)
        return CoSlamMap(self.config.map, bounds)


def bounds_about(frame: Frame, margin: float = 0.3, share: float = 0.999) -> Float[Tensor, "2 3"]:
    """Return a box that holds the first camera and what it measured, wider to every side by a part of its longest one.

    A few outliers (all but `share` of an axis) are left out. What comes to lie outside is still mapped (see the map).
    """
    pose = frame.pose.matrix().detach()
    points = se3.transform(pose, frame.points_camera()[::7]).sort(0).values
    last = len(points) - 1
    low, high = points[round(last * (1 - share))], points[round(last * share)]
    low, high = torch.minimum(low, pose[:3, 3]), torch.maximum(high, pose[:3, 3])
    reach = margin * (high - low).max()
    return torch.stack((low - reach, high + reach)).cpu()
