"""Vox-Fusion (Yang, Li, Zhai, Ming, Liu and Zhang, ISMAR 2022, arXiv 2210.15858)."""

from xrdslam.algorithms.vox_fusion.config import VoxFusionConfig
from xrdslam.algorithms.vox_fusion.model import VoxelMap
from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.frame import Frame

__all__ = ["VoxFusion"]


class VoxFusion(Algorithm):
    """A map that grows with what is seen; no bounds are needed."""

    needs = frozenset({"rgb", "depth"})
    config: VoxFusionConfig

    def build_model(self, scene: Scene, frame: Frame) -> VoxelMap:
        """Build the map, without a voxel."""
        return VoxelMap(self.config.map)
