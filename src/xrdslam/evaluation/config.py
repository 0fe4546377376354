"""What is evaluated, and how: the settings of an evaluation (nothing heavy is imported here)."""

from dataclasses import dataclass, fields

from xrdslam.core.errors import ConfigError

__all__ = ["EvaluationConfig"]

MASKS = ("valid_depth", "none")


@dataclass
class EvaluationConfig:
    """Settings of `EvalMetrics`; on the command line `evaluation.<name>=<value>`."""

    every: int = 5
    """Rendered and compared are the frames whose index divides by this (SplaTAM's protocol: 5)."""
    mask: str = "valid_depth"
    """`valid_depth`: both images times [measured depth > 0], as SplaTAM publishes; `none`: the whole image."""
    pictures_every: int = 50
    """A side-by-side picture of frames whose index divides by this; 0: none."""
    trajectory_pictures: bool = True
    """Draw the online and the final trajectory."""
    mesh_samples: int = 200_000
    """Points drawn from each surface for the reconstruction's figures; 0: the surface is not evaluated."""
    cull_every: int = 5
    """Frames whose index divides by this say what was seen of a surface."""
    cull_margin_m: float = 0.06
    """A point counts as seen where it is at most this far behind what was measured."""
    rpe_delta_frames: int = 1
    """The relative pose error compares the motion over this many frames, over all pairs."""

    def __post_init__(self) -> None:
        """Refuse nonsense before a run starts."""
        lowest = {"every": 1, "pictures_every": 0, "rpe_delta_frames": 1, "cull_every": 1}
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in lowest and (type(value) is not int or value < lowest[field.name]):
                raise ConfigError(
                    f"evaluation.{field.name}={value!r}: must be a number of frames, at least {lowest[field.name]}"
                )
        if self.mesh_samples < 0 or not self.cull_margin_m > 0:
            found = f"evaluation.mesh_samples={self.mesh_samples}, evaluation.cull_margin_m={self.cull_margin_m}"
            raise ConfigError(f"{found}: the number must not be negative, the margin above 0 metres")
        if self.mask not in MASKS:
            raise ConfigError(f"evaluation.mask={self.mask!r}: must be one of {', '.join(MASKS)}")
        if type(self.trajectory_pictures) is not bool:
            raise ConfigError(f"evaluation.trajectory_pictures={self.trajectory_pictures!r}: must be true or false")
