"""What a user may set about a synthetic sequence. Imports no torch."""

from dataclasses import dataclass, field

from xrdslam.core.config import require, require_choice
from xrdslam.datasets.config import DatasetConfig

__all__ = ["SensorConfig", "SyntheticConfig"]


@dataclass
class SensorConfig:
    """The imperfections of an RGB-D camera, each off by default: what its numbers mean is in `sensor`."""

    depth_noise: float = 0.0
    """Standard deviation of disparity [px of the depth camera]; 0.06 is a Kinect's: 6 mm at 2 m, growing as z^2."""
    depth_correlation: float = 1.0
    """Length [px of the image] over which that noise is alike."""
    disparity_step: float = 0.0
    """Quantum of disparity [px of the depth camera]; 0.125 is a Kinect's: 7 cm at 5 m. 0 does not quantise."""
    depth_focal: float = 575.0
    """Focal length [px] of the depth camera, at its own resolution."""
    depth_baseline: float = 0.075
    """Distance [m] between the depth camera and its projector, which is to its right."""
    shadows: bool = False
    """No depth where the projector's light does not reach."""
    grazing_deg: float = 0.0
    """No depth where ray and surface meet at less than this angle [deg]; a Kinect loses it below some 10."""
    holes: float = 0.0
    """Share of the pixels without depth, in patches of about `hole_size`."""
    hole_size: float = 8.0
    """Diameter [px of the image]."""
    min_depth: float = 0.0
    """Nearer than this [m] is not measured; 0.5 is a Kinect's. For the far end there is dataset.max_depth."""
    rgb_noise: float = 0.0
    """Standard deviation [codes of 255] at mid grey; its variance grows with the light, as that of photons does."""
    exposure_drift: float = 0.0
    """Standard deviation [stops] of the brightness, which wanders over about a second."""
    white_balance_drift: float = 0.0
    """Standard deviation [stops] of red and of blue against green."""
    exposure_ms: float = 0.0
    """Time [ms] the shutter is open about each frame's moment: colours are the mean over it, so motion blurs them."""
    blur_samples: int = 8
    """Moments that this mean is taken over; each is rendered."""
    dropped: float = 0.0
    """Share of the frames that never arrive; time stamps tell the gap."""
    drop_burst: float = 2.0
    """Frames lost in a row, on average."""
    seed: int = 0
    """Draws other noise in the same room."""

    def __post_init__(self) -> None:
        for name in (
            "depth_noise", "depth_correlation", "disparity_step", "min_depth", "rgb_noise", "exposure_drift",
            "white_balance_drift", "seed",
        ):  # fmt: skip
            require(getattr(self, name) >= 0, f"dataset.sensor.{name}", getattr(self, name), "not be negative")
        for name in ("depth_focal", "depth_baseline", "hole_size"):
            require(getattr(self, name) > 0, f"dataset.sensor.{name}", getattr(self, name), "be above 0")
        require(0 <= self.grazing_deg < 90, "dataset.sensor.grazing_deg", self.grazing_deg, "be in [0, 90) degrees")
        for name in ("holes", "dropped"):
            require(0 <= getattr(self, name) < 1, f"dataset.sensor.{name}", getattr(self, name), "be a share in [0, 1)")
        exposure = self.exposure_ms
        require(0 <= exposure <= 1000 / 30, "dataset.sensor.exposure_ms", exposure, "be within a frame's 33.3 ms")
        require(self.blur_samples >= 2, "dataset.sensor.blur_samples", self.blur_samples, "be at least 2")
        burst = self.drop_burst
        require(burst >= 1 / (1 - self.dropped), "dataset.sensor.drop_burst", burst, "be at least 1 / (1 - dropped)")


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
    sensor: SensorConfig = field(default_factory=SensorConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.num_frames >= 1, "dataset.num_frames", self.num_frames, "be at least 1")
        require(
            min(self.width, self.height) >= 1, "dataset.width, height", [self.width, self.height], "be at least 1 px"
        )
        require(self.seed >= 0, "dataset.seed", self.seed, "be 0 or more")
        require_choice("dataset.lighting", self.lighting, ("fine", "coarse"))
