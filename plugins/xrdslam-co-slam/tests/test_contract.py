"""Co-SLAM keeps the contracts of a method and of a map."""

from xrdslam.algorithms.co_slam.algorithm import bounds_about
from xrdslam.algorithms.co_slam.config import CoSlamMapConfig
from xrdslam.algorithms.co_slam.model import CoSlamMap
from xrdslam.core.algorithm import Scene
from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.testing import AlgorithmContract, ModelContract


class TestCoSlam(AlgorithmContract):
    name = "co_slam"
    settings = {
        "map_every": 2,
        "keyframe_every": 2,
        "map.log2_rows": 12,
        "map.voxel_m": 0.1,
        "map.mesh_voxel_m": 0.1,
        "map.truncation_m": 0.2,
        "map.surface_range_m": 0.2,
        "tracking.iterations": 30,
        "tracking.num_pixels": 400,
        "tracking.border_px": 2,
        "mapping.first_iterations": 150,
        "mapping.num_pixels": 800,
        "mapping.final_iterations_per_keyframe": 2,
    }
    accuracy = 0.06


class TestCoSlamMap(ModelContract):
    def make_model(self, scene: Scene, frame: Frame) -> Model:
        config = CoSlamMapConfig(log2_rows=10, voxel_m=0.1, mesh_voxel_m=0.1)
        return CoSlamMap(config, bounds_about(frame))
