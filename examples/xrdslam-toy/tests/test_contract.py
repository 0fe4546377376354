"""The contracts that every method and every map keep: all that a plugin author has to write."""

from xrdslam_toy.model import PointMap

from xrdslam.core.algorithm import Scene
from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.testing import AlgorithmContract, ModelContract


class TestToy(AlgorithmContract):
    name = "toy"
    accuracy = 0.01


class TestPointMap(ModelContract):
    def make_model(self, scene: Scene, frame: Frame) -> Model:
        return PointMap(voxel=0.05)
