"""NICE-SLAM's settings, as published for Replica; other datasets' and the presets lie in `conf/`. Imports no torch."""

from dataclasses import dataclass, field
from typing import Any

from xrdslam.core.config import AlgorithmConfig, IterativeMappingConfig, IterativeTrackingConfig, require

__all__ = ["NiceSlamConfig", "NiceSlamMapConfig", "NiceSlamMappingConfig", "NiceSlamTrackingConfig"]


@dataclass
class NiceSlamMapConfig:
    """The grids: where they are, how fine, how rays are sampled, what losses weigh."""

    bounds: list[float] | None = None
    """The scene's box [m], [x, y, z, x, y, z] of its lower and upper corner, which then stays; by default what the
    first frame saw and the data states, and it grows with what later frames see."""
    margin_m: float = 0.16
    """How far a box that was found reaches beyond what was measured."""
    voxel_middle_m: float = 0.32
    voxel_fine_m: float = 0.16
    voxel_color_m: float = 0.16
    decoders: str | None = None
    """Path of the published `middle_fine.pt`; by default the decoders that come with this package."""
    num_uniform: int = 16
    """Samples of a ray from the camera to `far_share` of the measured depth,"""
    num_near_surface: int = 16
    """and about the surface, as far as `surface_share` of the measured depth."""
    far_share: float = 1.2
    surface_share: float = 0.05
    weight_rgb: float = 0.2
    """Of the colour loss in mapping, beside the depth loss."""
    tracking_weight_rgb: float = 0.5
    outlier_factor: float = 10.0
    """A tracking ray counts up to so many times the median residual."""
    lr_middle_alone: float = 0.02
    """Rate of the middle grid while nothing else is optimised,"""
    lr_grid: float = 5e-3
    """of all grids later,"""
    lr_decoder: float = 5e-3
    """and of the colour decoder."""
    render_step_m: float = 0.04
    """Step of the search for the surface where no depth is given."""
    mesh_voxel_m: float = 0.02

    def __post_init__(self) -> None:
        for name in ("voxel_middle_m", "voxel_fine_m", "voxel_color_m", "render_step_m", "mesh_voxel_m"):
            require(getattr(self, name) > 0, f"algo.map.{name}", getattr(self, name), "be positive")
        for name in ("weight_rgb", "tracking_weight_rgb", "lr_middle_alone", "lr_grid", "lr_decoder", "margin_m"):
            require(getattr(self, name) >= 0, f"algo.map.{name}", getattr(self, name), "not be negative")
        for name in ("num_uniform", "num_near_surface"):
            require(getattr(self, name) >= 2, f"algo.map.{name}", getattr(self, name), "be at least 2")
        require(self.far_share > 1, "algo.map.far_share", self.far_share, "be above 1")
        require(0 < self.surface_share < 1, "algo.map.surface_share", self.surface_share, "lie between 0 and 1")
        require(self.outlier_factor > 0, "algo.map.outlier_factor", self.outlier_factor, "be positive")
        corners = self.bounds
        sound = corners is None or (
            len(corners) == 6 and all(low < high for low, high in zip(corners[:3], corners[3:], strict=True))
        )
        require(sound, "algo.map.bounds", corners, "be six numbers, the lower corner and then the upper one")


@dataclass
class NiceSlamTrackingConfig(IterativeTrackingConfig):
    """Pose optimisation on rays."""

    name: str = "nice_slam"
    iterations: int = 10
    first_iterations: int = 100
    lr_rotation: float = 1e-3
    lr_translation: float = 1e-3
    num_pixels: int = 200
    border_px: int = 50


@dataclass
class NiceSlamMappingConfig(IterativeMappingConfig):
    """Middle grid, then fine, then colour and poses, over a window of overlapping keyframes."""

    name: str = "nice_slam"
    iterations: int = 60
    first_iterations: int = 1500
    keyframes: str = "overlap_random"
    window: int = 5
    lr_pose_rotation: float = 1e-3
    lr_pose_translation: float = 1e-3
    num_pixels: int = 1000
    middle_share: float = 0.4
    """Share of the iterations after which the fine grid joins the middle one,"""
    fine_share: float = 0.6
    """and after which colour and poses join."""
    first_lr_factor: float | None = None
    """Factor on the first frame's rates; by default 1 with our decoders, 5 with the published ones."""
    min_keyframes: int = 5
    """Poses are adjusted once there are so many keyframes."""
    frustum_margin_m: float = 0.5
    """What lies so far behind the measured depth, or so near to the camera, is optimised."""
    final_rounds: int = 5
    """Windows of twice the size that are optimised after the last frame, `iterations` each."""

    def __post_init__(self) -> None:
        super().__post_init__()
        middle, fine = self.middle_share, self.fine_share
        require(0 <= middle <= 1, "algo.mapping.middle_share", middle, "lie between 0 and 1")
        require(middle <= fine <= 1, "algo.mapping.fine_share", fine, "lie between middle_share and 1")
        factor = self.first_lr_factor
        require(factor is None or factor > 0, "algo.mapping.first_lr_factor", factor, "be positive")
        require(self.min_keyframes >= 2, "algo.mapping.min_keyframes", self.min_keyframes, "be at least 2")
        require(self.frustum_margin_m >= 0, "algo.mapping.frustum_margin_m", self.frustum_margin_m, "not be negative")
        require(self.final_rounds >= 0, "algo.mapping.final_rounds", self.final_rounds, "not be negative")


@dataclass
class NiceSlamConfig(AlgorithmConfig):
    """NICE-SLAM: every fifth frame is mapped, every fiftieth becomes a keyframe."""

    name: str = "nice_slam"
    map_every: int = 5
    keyframe_every: int = 50
    map: NiceSlamMapConfig = field(default_factory=NiceSlamMapConfig)
    tracking: Any = field(default_factory=NiceSlamTrackingConfig)
    mapping: Any = field(default_factory=NiceSlamMappingConfig)
