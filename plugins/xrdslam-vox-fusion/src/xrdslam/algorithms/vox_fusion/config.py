"""Vox-Fusion's settings, as published for Replica; other datasets' and the presets lie in `conf/`. Imports no torch."""

from dataclasses import dataclass, field
from typing import Any

from xrdslam.core.config import (
    AlgorithmConfig,
    IterativeMappingConfig,
    IterativeTrackingConfig,
    require,
    require_choice,
)

__all__ = ["VoxFusionConfig", "VoxFusionMapConfig", "VoxFusionMappingConfig", "VoxFusionTrackingConfig"]


@dataclass
class VoxFusionMapConfig:
    """The voxels and their decoder, how rays are sampled, what the losses weigh."""

    voxel_m: float = 0.2
    features: int = 16
    """Numbers on each corner of a voxel."""
    rows: int = 20000
    """Corners that there is room for at first; the table doubles where they do not do."""
    width: int = 128
    """Of the decoder's layers; 256 is published for ScanNet."""
    truncation_m: float = 0.05
    step_m: float = 0.01
    """Distance of a ray's samples within voxels (published as a share of the voxel: 0.05)."""
    free_space_every: int = 8
    """Of the samples more than two truncations before the measured depth one in so many is taken, and counts for all of
    them in the loss of free space. 1 takes each, as published."""
    max_depth_m: float = 10.0
    """Farther measurements count as none; rays without measured depth end here."""
    max_samples: int = 512
    """Of a ray: a wrong pose must not make it endless."""
    min_color_weight: float = 1e-4
    """Samples that a ray gives less weight have no colour computed."""
    padded_m: float = 1.0
    """The losses of samples are means over a ray of this length within voxels (published: over the longest ray)."""
    weight_rgb: float = 0.5
    weight_depth: float = 1.0
    weight_sdf: float = 5000.0
    weight_free_space: float = 10.0
    outlier_ratio: float = 10.0
    """In tracking, rays whose depth error over its deviation exceeds this many medians are left out."""
    precision: str = "float32"
    """Of the products of the decoder's wide layers on the CPU: float32, or bfloat16 where the processor has it.
    Parameters and Adam stay float32."""
    lr_features: float = 5e-3
    lr_decoder: float = 5e-3
    mesh_resolution: int = 8
    """Samples of the mesh's lattice along a voxel's edge."""

    def __post_init__(self) -> None:
        for name in ("voxel_m", "truncation_m", "step_m", "max_depth_m", "padded_m", "outlier_ratio"):
            require(getattr(self, name) > 0, f"algo.map.{name}", getattr(self, name), "be positive")
        for name in ("features", "rows", "width", "max_samples", "free_space_every"):
            require(getattr(self, name) >= 1, f"algo.map.{name}", getattr(self, name), "be at least 1")
        for name in ("weight_rgb", "weight_depth", "weight_sdf", "weight_free_space", "lr_features", "lr_decoder"):
            require(getattr(self, name) >= 0, f"algo.map.{name}", getattr(self, name), "not be negative")
        least = self.min_color_weight
        require(0 <= least < 1, "algo.map.min_color_weight", least, "lie in [0, 1)")
        require_choice("algo.map.precision", self.precision, ("float32", "bfloat16"))
        sound = self.mesh_resolution >= 8 and self.mesh_resolution % 8 == 0
        require(sound, "algo.map.mesh_resolution", self.mesh_resolution, "be a multiple of 8")


@dataclass
class VoxFusionTrackingConfig(IterativeTrackingConfig):
    """Pose optimisation on rays."""

    name: str = "vox_fusion"
    iterations: int = 30
    lr_rotation: float = 1e-2
    lr_translation: float = 1e-2
    num_pixels: int = 1024
    min_seen: float = 0.1
    """A frame is lost where a smaller share of its points falls into the map's voxels, seen from the prediction."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(0 <= self.min_seen <= 1, "algo.tracking.min_seen", self.min_seen, "lie in [0, 1]")


@dataclass
class VoxFusionMappingConfig(IterativeMappingConfig):
    """Every frame with a few random keyframes; all poses but the first frame's are free."""

    name: str = "vox_fusion"
    iterations: int = 15
    first_iterations: int = 200
    keyframes: str = "random"
    window: int = 5
    lr_pose_rotation: float = 1e-3
    lr_pose_translation: float = 1e-3
    num_pixels: int = 1024
    """Rays of each frame of the window (other methods: of all together)."""
    keep_optimiser: bool = True


@dataclass
class VoxFusionConfig(AlgorithmConfig):
    """Vox-Fusion: every frame is mapped, every fiftieth becomes a keyframe."""

    name: str = "vox_fusion"
    map_every: int = 1
    keyframe_every: int = 50
    map: VoxFusionMapConfig = field(default_factory=VoxFusionMapConfig)
    tracking: Any = field(default_factory=VoxFusionTrackingConfig)
    mapping: Any = field(default_factory=VoxFusionMappingConfig)
