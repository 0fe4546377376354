"""NICE-SLAM keeps the contracts of a method and of a map."""

from xrdslam.algorithms.nice_slam.config import NiceSlamMapConfig
from xrdslam.algorithms.nice_slam.model import NiceSlamMap, bounds_of
from xrdslam.core.algorithm import Scene
from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.testing import AlgorithmContract, ModelContract


class TestNiceSlam(AlgorithmContract):
    name = "nice_slam"
    settings = {
        "map_every": 2,
        "keyframe_every": 2,
        "map.num_uniform": 8,
        "map.num_near_surface": 6,
        "map.mesh_voxel_m": 0.1,
        "map.render_step_m": 0.1,
        "tracking.iterations": 10,
        "tracking.first_iterations": 40,
        "tracking.border_px": 2,
        "mapping.first_iterations": 150,
        "mapping.iterations": 15,
        "mapping.min_keyframes": 2,
        "mapping.num_pixels": 300,
        "mapping.final_rounds": 1,
    }
    accuracy = 0.06


class TestNiceSlamMap(ModelContract):
    def make_model(self, scene: Scene, frame: Frame) -> Model:
        config = NiceSlamMapConfig(mesh_voxel_m=0.1, render_step_m=0.1)
        return NiceSlamMap(config, bounds_of(frame, frame.pose.matrix().detach(), config.margin_m))
