"""Vox-Fusion keeps the contracts of a method and of a map."""

from xrdslam.algorithms.vox_fusion.config import VoxFusionMapConfig
from xrdslam.algorithms.vox_fusion.model import VoxelMap
from xrdslam.core.algorithm import Scene
from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.testing import AlgorithmContract, ModelContract


class TestVoxFusion(AlgorithmContract):
    name = "vox_fusion"
    settings = {
        "keyframe_every": 2,
        "map.rows": 200,  # the table has to grow
        "map.width": 32,
        "map.step_m": 0.04,
        "map.truncation_m": 0.1,
        "tracking.iterations": 15,
        "tracking.num_pixels": 200,
        "mapping.first_iterations": 80,
        "mapping.iterations": 5,
        "mapping.num_pixels": 200,
    }
    accuracy = 0.06


class TestVoxelMap(ModelContract):
    def make_model(self, scene: Scene, frame: Frame) -> Model:
        return VoxelMap(VoxFusionMapConfig(width=32, rows=100, step_m=0.04))
