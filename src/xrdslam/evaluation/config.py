"""What is evaluated, and how: the settings of an evaluation (nothing heavy is imported here)."""

from dataclasses import dataclass

from xrdslam.core.config import require

__all__ = ["EvaluationConfig"]

CHOICES = {
    "mask": ("valid_depth", "none"),
    "culling": ("frustum", "frustum_occlusion", "virtual_cameras"),
    "alignment": ("se3", "sim3", "none"),
    "icp": ("none", "point_to_point"),
}
LEAST = {
    "every": 1,
    "held_out": 0,
    "pictures_every": 0,
    "mesh_samples": 0,
    "cull_every": 1,
    "virtual_views": 0,
    "seed": 0,
    "rpe_delta_frames": 1,
}
POSITIVE = ("cull_margin_m", "max_time_difference_s")


@dataclass
class EvaluationConfig:
    """Settings of `EvalMetrics`; on the command line `evaluation.<name>=<value>`."""

    every: int = 5
    """Rendered and compared are the frames whose index divides by this (SplaTAM's protocol: 5)."""
    held_out: int = 0
    """Keeps the last of every n frames from the mapper: tracked, never mapped, no keyframe, compared under
    `rendering/held_out`; 0: none. A setting of the run: a finished one cannot take it up."""
    mask: str = "valid_depth"
    """`valid_depth`: both images times [measured depth > 0], as SplaTAM publishes; `none`: the whole image."""
    lpips_weights: str | None = None
    """A file, or a folder with `lpips_alex_v0.1.npz` and `lpips_squeeze_v0.1.npz`; else XRDSLAM_LPIPS_WEIGHTS says."""
    pictures_every: int = 50
    """A side-by-side picture of frames whose index divides by this; 0: none."""
    trajectory_pictures: bool = True
    """Draw the online and the final trajectory."""
    mesh_samples: int = 200_000
    """Points drawn from each surface for the reconstruction's figures; 0: the surface is not evaluated."""
    culling: str = "frustum_occlusion"
    """What of both surfaces counts: `frustum`, `frustum_occlusion`, or `virtual_cameras` (that, and from beside)."""
    cull_every: int = 5
    """Frames whose index divides by this say what was seen of a surface."""
    cull_margin_m: float = 0.06
    """A point counts as seen where it is at most this far behind what was measured."""
    alignment: str = "se3"
    """How the surface is laid on the true one: the final trajectory's `se3` or `sim3`, or `none`."""
    icp: str = "none"
    """`point_to_point` then also lets the surfaces themselves fit, as the published framework does."""
    virtual_views: int = 200
    """Views that the depth of the mesh is compared from, and that `virtual_cameras` adds; 0: none."""
    seed: int = 0
    """Of surface samples and virtual views: part of the protocol, not of the run."""
    max_time_difference_s: float = 0.02
    """Poses of trajectory files belong together that are at most this far apart."""
    rpe_delta_frames: int = 1
    """The relative pose error compares the motion over this many frames, over all pairs."""

    def __post_init__(self) -> None:
        """Refuse nonsense before a run starts."""
        for key, least in LEAST.items():
            value = getattr(self, key)
            allowed = type(value) is int and value >= least
            require(allowed, f"evaluation.{key}", repr(value), f"be a whole number, at least {least}")
        require(self.held_out != 1, "evaluation.held_out", self.held_out, "leave the mapper some frames: 0, or 2 on")
        for key in POSITIVE:
            value = getattr(self, key)
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            require(is_number and value > 0, f"evaluation.{key}", repr(value), "be above 0")
        for key, choices in CHOICES.items():
            require(getattr(self, key) in choices, f"evaluation.{key}", repr(getattr(self, key)), _one_of(choices))
        is_flag = type(self.trajectory_pictures) is bool
        require(is_flag, "evaluation.trajectory_pictures", repr(self.trajectory_pictures), "be true or false")


def _one_of(choices: tuple[str, ...]) -> str:
    return f"be one of {', '.join(choices)}"
