"""What a user may set about a synthetic sequence. Imports no torch."""

from dataclasses import dataclass

from xrdslam.core.config import require, require_choice
from xrdslam.datasets.config import DatasetConfig

__all__ = ["SyntheticConfig"]


@dataclass
class SyntheticConfig(DatasetConfig):
    """A procedural room, walked through with a camera of 90 degrees (fx = fy = half the width)."""

    family: str = "synthetic"
    scene: str = "room0"
    seed: int = 0
    """Changes what stands in the room, its textures and the walk."""
    num_frames: int = 120
    """Length of the sequence; a longer one begins with the frames of a shorter, and after one round repeats."""
    width: int = 320
    height: int = 240
    lighting: str = "fine"
    """How light is computed before the first frame: fine takes seconds, coarse a moment (for tests)."""
    cache: bool = True
    """Keep frames and light on disk, in XRDSLAM_CACHE or the platform's cache folder."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.num_frames >= 1, "dataset.num_frames", self.num_frames, "be at least 1")
        require(
            min(self.width, self.height) >= 1, "dataset.width, height", [self.width, self.height], "be at least 1 px"
        )
        require(self.seed >= 0, "dataset.seed", self.seed, "be 0 or more")
        require_choice("dataset.lighting", self.lighting, ("fine", "coarse"))
