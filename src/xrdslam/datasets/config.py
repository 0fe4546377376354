"""What a user may set about a dataset: the knobs that every family has, and each family's own. Imports no torch."""

from dataclasses import dataclass, field

from xrdslam.core.config import require, require_choice

__all__ = ["DatasetConfig", "ReplicaConfig", "SevenScenesConfig"]


@dataclass
class DatasetConfig:
    """The knobs that every family has."""

    family: str = "???"
    scene: str = "custom"
    root: str = "data"
    """The folder that holds the family's scenes."""
    path: str | None = None
    """The scene's own folder; goes before `root` and `scene`."""
    frames: list[int | None] = field(default_factory=lambda: [0, None, 1])
    """Which frames of the whole sequence: start, stop, stride; a stop of null (or -1) is the end."""
    size: list[int] | None = None
    """The width and height [px] that images are resized to."""
    max_depth: float | None = None
    """Depth beyond this [m] counts as not measured."""
    on_error: str = "raise"
    """What a damaged frame does: raise ends the run before it begins, skip leaves the frame out."""

    def __post_init__(self) -> None:
        must = "be [start, stop, stride] with start and stop from 0 (stop null: to the end) and stride from 1"
        require(len(self.frames) == 3, "dataset.frames", self.frames, must)
        start, stop, stride = self.frames
        allowed = (start or 0) >= 0 and (stop is None or stop >= -1) and (stride is None or stride >= 1)
        require(allowed, "dataset.frames", self.frames, must)
        sized = self.size is None or (len(self.size) == 2 and min(self.size) >= 1)
        require(sized, "dataset.size", self.size, "be [width, height] in pixels, both at least 1")
        require(self.max_depth is None or self.max_depth > 0, "dataset.max_depth", self.max_depth, "be above 0 metres")
        require_choice("dataset.on_error", self.on_error, ("raise", "skip"))


@dataclass
class ReplicaConfig(DatasetConfig):
    """Replica as NICE-SLAM rendered it."""

    family: str = "replica"
    root: str = "data/Replica"


@dataclass
class SevenScenesConfig(DatasetConfig):
    """Microsoft's 7-Scenes."""

    family: str = "seven_scenes"
    root: str = "data/7-Scenes"
    sequence: str | None = None
    """The sequence's folder inside the scene's, such as seq-01; needed where there are several."""
