"""Co-SLAM's settings, as published for Replica; other datasets' and the presets lie in `conf/`. Imports no torch."""

from dataclasses import dataclass, field
from typing import Any

from xrdslam.core.config import AlgorithmConfig, IterativeMappingConfig, IterativeTrackingConfig, require

__all__ = ["CoSlamConfig", "CoSlamMapConfig", "CoSlamMappingConfig", "CoSlamTrackingConfig"]


@dataclass
class CoSlamMapConfig:
    """The field: where it is, how finely it is stored, how rays are sampled, what its losses weigh."""

    bounds: list[float] | None = None
    """The scene's box [m], [x, y, z, x, y, z] of its lower and upper corner; by default the data's, or a box about what
    the first frame saw."""
    voxel_m: float = 0.02
    """Size of a cell of the finest level of the hash grid."""
    log2_rows: int = 16
    """Rows of a level of the hash grid, as a power of two: 13 is the paper's 0.26 M numbers, 16 what was released."""
    truncation_m: float = 0.1
    num_uniform: int = 16
    """Samples of a ray from the camera to just behind the measured surface,"""
    num_near_surface: int = 11
    """and in `surface_range_m` about it."""
    surface_range_m: float = 0.1
    far_m: float = 5.0
    """Where rays without measured depth end."""
    weight_rgb: float = 5.0
    weight_depth: float = 0.1
    weight_sdf: float = 1000.0
    weight_free_space: float = 10.0
    weight_smoothness: float = 1e-6
    smoothness_samples: int = 16
    """Points along the edge of the random cube whose features are kept smooth; 0 leaves the term out."""
    smoothness_voxel_m: float = 0.1
    rgb_without_depth: bool = True
    """Whether pixels without depth count in the colour loss."""
    lr_grid: float = 1e-2
    lr_decoder: float = 1e-2
    mesh_voxel_m: float = 0.02

    def __post_init__(self) -> None:
        for name in ("voxel_m", "truncation_m", "surface_range_m", "far_m", "smoothness_voxel_m", "mesh_voxel_m"):
            require(getattr(self, name) > 0, f"algo.map.{name}", getattr(self, name), "be positive")
        for name in ("rgb", "depth", "sdf", "free_space", "smoothness"):
            weight = getattr(self, f"weight_{name}")
            require(weight >= 0, f"algo.map.weight_{name}", weight, "not be negative")
        for name in ("lr_grid", "lr_decoder", "smoothness_samples"):
            require(getattr(self, name) >= 0, f"algo.map.{name}", getattr(self, name), "not be negative")
        for name in ("num_uniform", "num_near_surface"):
            require(getattr(self, name) >= 2, f"algo.map.{name}", getattr(self, name), "be at least 2")
        require(3 <= self.log2_rows <= 24, "algo.map.log2_rows", self.log2_rows, "lie between 3 and 24")
        corners = self.bounds
        sound = corners is None or (
            len(corners) == 6 and all(low < high for low, high in zip(corners[:3], corners[3:], strict=True))
        )
        require(sound, "algo.map.bounds", corners, "be six numbers, the lower corner and then the upper one")


@dataclass
class CoSlamTrackingConfig(IterativeTrackingConfig):
    """Pose optimisation on rays."""

    name: str = "co_slam"
    iterations: int = 10
    first_iterations: int = 60
    lr_rotation: float = 1e-3
    lr_translation: float = 1e-3
    pivot: str = "scene"
    num_pixels: int = 1024
    border_px: int = 20


@dataclass
class CoSlamMappingConfig(IterativeMappingConfig):
    """Bundle adjustment of the map and all keyframes on rays that keyframes left behind."""

    name: str = "co_slam"
    iterations: int = 10
    first_iterations: int = 200
    keyframes: str = "all"
    lr_pose_rotation: float = 1e-3
    lr_pose_translation: float = 1e-3
    pose_accumulate: int = 5
    num_pixels: int = 2048
    keep_optimiser: bool = True
    final_iterations_per_keyframe: int = 32
    final_rates: list[float] = field(default_factory=lambda: [1.5, 0.02])
    final_rgb_factor: float = 10.0
    """What the colour loss is multiplied by while the map settles: then shape is known, and colour is what lacks."""
    bank_share: float = 0.05
    """Share of a keyframe's pixels that it leaves in the bank."""
    min_current_pixels: int = 100
    """At least so many rays of an iteration are the current frame's."""
    moves_current: bool = True
    """Whether the current frame's pose is adjusted too."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(0 < self.bank_share <= 1, "algo.mapping.bank_share", self.bank_share, "lie above 0, and at most at 1")
        require(self.final_rgb_factor >= 0, "algo.mapping.final_rgb_factor", self.final_rgb_factor, "not be negative")
        least = self.min_current_pixels
        require(least >= 1, "algo.mapping.min_current_pixels", least, "be at least 1")


@dataclass
class CoSlamConfig(AlgorithmConfig):
    """Co-SLAM: every fifth frame is mapped and becomes a keyframe."""

    name: str = "co_slam"
    map_every: int = 5
    keyframe_every: int = 5
    map: CoSlamMapConfig = field(default_factory=CoSlamMapConfig)
    tracking: Any = field(default_factory=CoSlamTrackingConfig)
    mapping: Any = field(default_factory=CoSlamMappingConfig)
