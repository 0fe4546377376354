"""SplaTAM's settings, as published for Replica; other datasets' and the presets lie in `conf/`. Imports no torch."""

from dataclasses import dataclass, field
from typing import Any

from xrdslam.core.config import AlgorithmConfig, IterativeMappingConfig, IterativeTrackingConfig, require

__all__ = ["SplatamConfig", "SplatamMapConfig", "SplatamMappingConfig", "SplatamTrackingConfig"]


@dataclass
class SplatamMapConfig:
    """The Gaussians: how they are drawn, seeded, moved, removed and compared with a frame."""

    anisotropic: bool = False
    near_m: float = 0.2
    """Gaussians nearer than this are not drawn."""
    lowpass_px2: float = 0.3
    """Added to every projected variance; `tracking_silhouette` is calibrated to it."""
    seed_stride: int = 1
    """Every n-th pixel of a row and column gets a Gaussian, n times as large."""
    densify_silhouette: float = 0.5
    """Measured pixels that the map explains less than this are seeded,"""
    densify_depth_factor: float = 50.0
    """and those in front of it by more than this many medians of the depth error."""
    lr_means: float = 1e-4
    lr_scales: float = 1e-3
    lr_opacities: float = 5e-2
    lr_colors: float = 2.5e-3
    lr_quats: float = 1e-3
    """Moves nothing while Gaussians are isotropic."""
    adam_eps: float = 1e-8
    """Adam's epsilon. The released 1e-15 moves every Gaussian at the full rate, however small its gradient: those that
    a view barely touches drift, and with them what earlier frames looked like."""
    weight_depth: float = 1.0
    weight_color: float = 0.5
    weight_ssim: float = 0.2
    """Share of 1 - SSIM in mapping's colour loss; the rest is the absolute difference."""
    tracking_silhouette: float = 0.99
    """Tracking looks at the pixels that the map explains more than this."""
    prune_opacity: float = 0.005
    """Gaussians with less opacity are removed,"""
    prune_scale: float = 0.1
    """and those larger than this part of the scene's radius."""
    scene_radius_ratio: float = 3.0
    """The scene's radius is the first frame's largest depth divided by this."""
    mesh_voxel_m: float = 0.01
    mesh_truncation_m: float = 0.04
    mesh_opacity: float = 0.95
    """Rendered depth enters the mesh where the map explains a pixel more than this."""

    def __post_init__(self) -> None:
        for name in ("adam_eps", "near_m", "densify_depth_factor", "prune_scale", "scene_radius_ratio", "mesh_voxel_m"):
            require(getattr(self, name) > 0, f"algo.map.{name}", getattr(self, name), "be positive")
        for name in ("lr_means", "lr_scales", "lr_opacities", "lr_colors", "lr_quats", "lowpass_px2"):
            require(getattr(self, name) >= 0, f"algo.map.{name}", getattr(self, name), "not be negative")
        for name in ("weight_depth", "weight_color"):
            require(getattr(self, name) >= 0, f"algo.map.{name}", getattr(self, name), "not be negative")
        shares = ("densify_silhouette", "weight_ssim", "tracking_silhouette", "prune_opacity", "mesh_opacity")
        for name in shares:
            require(0 <= getattr(self, name) <= 1, f"algo.map.{name}", getattr(self, name), "lie between 0 and 1")
        require(self.seed_stride >= 1, "algo.map.seed_stride", self.seed_stride, "be at least 1")
        truncation = self.mesh_truncation_m
        require(truncation >= self.mesh_voxel_m, "algo.map.mesh_truncation_m", truncation, "be at least a voxel")


@dataclass
class SplatamTrackingConfig(IterativeTrackingConfig):
    """Pose optimisation on whole images."""

    name: str = "splatam"
    iterations: int = 40
    lr_rotation: float = 4e-4
    lr_translation: float = 2e-3
    rotation: str = "quaternion"
    pivot: str = "scene"
    min_tracked_share: float = 0.4
    """A frame of whose measured pixels the map explains a smaller share is lost; 0 never."""

    def __post_init__(self) -> None:
        super().__post_init__()
        share = self.min_tracked_share
        require(0 <= share <= 1, "algo.tracking.min_tracked_share", share, "lie between 0 and 1")


@dataclass
class SplatamMappingConfig(IterativeMappingConfig):
    """The map fitted over a window of keyframes; the poses stay as tracked."""

    name: str = "splatam"
    iterations: int = 60
    keyframes: str = "overlap_random"
    window: int = 24
    prune_at: list[int] = field(default_factory=lambda: [0, 20])
    """Iterations between whose backward pass and step Gaussians are removed."""


@dataclass
class SplatamConfig(AlgorithmConfig):
    """SplaTAM: every frame mapped, every fifth a keyframe."""

    name: str = "splatam"
    map: SplatamMapConfig = field(default_factory=SplatamMapConfig)
    tracking: Any = field(default_factory=SplatamTrackingConfig)
    mapping: Any = field(default_factory=SplatamMappingConfig)
