"""SplaTAM keeps the contracts of a method and of a map."""

from xrdslam.algorithms.splatam.config import SplatamMapConfig
from xrdslam.algorithms.splatam.model import GaussianMap
from xrdslam.core.algorithm import Scene
from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.testing import AlgorithmContract, ModelContract

QUICK = {
    "tracking.iterations": 40,
    "tracking.first_iterations": 120,
    "tracking.lr_rotation": 1e-3,
    "mapping.iterations": 15,
    "mapping.first_iterations": 200,
    "map.mesh_voxel_m": 0.05,
    "map.mesh_truncation_m": 0.2,
}


class TestSplatam(AlgorithmContract):
    name = "splatam"
    settings = QUICK
    accuracy = 0.05


class TestSplatamAnisotropic(AlgorithmContract):
    name = "splatam"
    settings = {**QUICK, "map.anisotropic": True}
    accuracy = 0.05


class TestGaussianMap(ModelContract):
    def make_model(self, scene: Scene, frame: Frame) -> Model:
        return GaussianMap(SplatamMapConfig(mesh_voxel_m=0.05, mesh_truncation_m=0.2), scene_radius_m=1.0)
