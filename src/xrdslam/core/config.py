"""Settings of a run as plain dataclasses: the one place of every default that all methods share. Imports no torch."""

from dataclasses import dataclass, field
from typing import Any

from xrdslam.core.errors import ConfigError

__all__ = [
    "AlgorithmConfig",
    "EngineConfig",
    "IterativeMappingConfig",
    "IterativeTrackingConfig",
    "MappingConfig",
    "MultiprocessConfig",
    "RunConfig",
    "TrackingConfig",
    "ViewerConfig",
    "require",
    "require_choice",
]


def require(condition: bool, key: str, value: object, must: str) -> None:
    """Refuse a setting: ConfigError `<dotted key>=<value>: must <must>`."""
    if not condition:
        raise ConfigError(f"{key}={value}: must {must}")


def require_choice(key: str, value: str, choices: tuple[str, ...]) -> None:
    """Refuse a setting that is not one of `choices`."""
    require(value in choices, key, value, f"be one of {', '.join(choices)}")


@dataclass
class TrackingConfig:
    """What every tracking method has: the name it is registered under, and what is done about losing the track."""

    name: str = "???"
    lost_agreement: float = 0.4
    """A frame is lost where the map, rendered at the pose found, agrees with a smaller part of its pixels than this
    part of what is usual in the run (the median of the last tracked frames); 0 does not ask."""
    relocalise: bool = False
    """Look for lost frames among remembered views (`methods.relocalisation`), and let tracking go on from there."""

    def __post_init__(self) -> None:
        part = self.lost_agreement
        require(0 <= part <= 1, "algo.tracking.lost_agreement", part, "lie between 0 and 1")


@dataclass
class MappingConfig:
    """What every mapping method has: the name it is registered under."""

    name: str = "???"


@dataclass
class IterativeTrackingConfig(TrackingConfig):
    """Pose optimisation against the map."""

    iterations: int = 40
    first_iterations: int = 0
    """Iterations on a frame whose motion cannot be predicted, the second of a sequence; 0 takes `iterations`."""
    lr_rotation: float = 1e-3
    """Adam's rate on the rotation's parameters [rad, or quaternion units]."""
    lr_translation: float = 1e-3
    """Adam's rate on the camera centre [m]."""
    rotation: str = "axis_angle"
    pivot: str = "camera"
    """What the pose turns about: the camera's centre, or the middle of the scene that the frame measured."""
    keep_best: bool = True
    """Keep the pose of the smallest measured loss instead of the last one."""
    num_pixels: int = 1024
    """Rays per iteration, for maps that take rays."""
    border_px: int = 0
    """Rays keep this distance from the image border."""
    stop_patience: int = 0
    """End after this many iterations without the loss improving by `stop_tolerance`; 0 never does."""
    stop_tolerance: float = 1e-3
    """Relative."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.iterations >= 1, "algo.tracking.iterations", self.iterations, "be at least 1")
        first = self.first_iterations
        require(first >= 0, "algo.tracking.first_iterations", first, "not be negative")
        require(self.lr_rotation >= 0, "algo.tracking.lr_rotation", self.lr_rotation, "not be negative")
        require(self.lr_translation >= 0, "algo.tracking.lr_translation", self.lr_translation, "not be negative")
        require_choice("algo.tracking.rotation", self.rotation, ("axis_angle", "quaternion"))
        require_choice("algo.tracking.pivot", self.pivot, ("camera", "scene"))
        require(self.num_pixels >= 1, "algo.tracking.num_pixels", self.num_pixels, "be at least 1")
        require(self.border_px >= 0, "algo.tracking.border_px", self.border_px, "not be negative")
        require(self.stop_patience >= 0, "algo.tracking.stop_patience", self.stop_patience, "not be negative")
        require(self.stop_tolerance >= 0, "algo.tracking.stop_tolerance", self.stop_tolerance, "not be negative")


@dataclass
class IterativeMappingConfig(MappingConfig):
    """Map optimisation over a window of keyframes."""

    iterations: int = 60
    first_iterations: int = 0
    """Iterations on the first frame; 0 takes `iterations`."""
    keyframes: str = "overlap"
    """How the window is chosen: random, overlap (ranked), overlap_random, window (latest), all."""
    window: int = 24
    """Frames in the window, the latest keyframe and the current frame among them."""
    lr_pose_rotation: float = 0.0
    """Adam's rate on the rotations of the window's poses; 0 leaves them."""
    lr_pose_translation: float = 0.0
    """Adam's rate on the window's camera centres [m]; 0 leaves them."""
    pose_accumulate: int = 1
    """Iterations whose pose gradients are summed before a pose steps."""
    num_pixels: int = 2048
    """Rays per iteration over the whole window, for maps that take rays."""
    keep_optimiser: bool = False
    """Keep the optimiser's moments from one mapped frame to the next."""
    final_iterations_per_keyframe: int = 0
    """Iterations over all keyframes after the last frame, so many for each of them, poses fixed; 0 leaves them out."""
    final_rates: list[float] = field(default_factory=lambda: [1.0, 0.1])
    """Factors on the learning rates at the first and at the last of them: they fall, and the map settles."""

    def __post_init__(self) -> None:
        require(self.iterations >= 1, "algo.mapping.iterations", self.iterations, "be at least 1")
        require(self.first_iterations >= 0, "algo.mapping.first_iterations", self.first_iterations, "not be negative")
        final = self.final_iterations_per_keyframe
        require(final >= 0, "algo.mapping.final_iterations_per_keyframe", final, "not be negative")
        rates = self.final_rates
        falls = len(rates) == 2 and 0 < rates[1] <= rates[0]
        require(falls, "algo.mapping.final_rates", rates, "be two factors above 0, the second at most the first")
        policies = ("random", "overlap", "overlap_random", "window", "all")
        require_choice("algo.mapping.keyframes", self.keyframes, policies)
        require(self.window >= 1, "algo.mapping.window", self.window, "be at least 1")
        require(self.lr_pose_rotation >= 0, "algo.mapping.lr_pose_rotation", self.lr_pose_rotation, "not be negative")
        lr_translation = self.lr_pose_translation
        require(lr_translation >= 0, "algo.mapping.lr_pose_translation", lr_translation, "not be negative")
        require(self.pose_accumulate >= 1, "algo.mapping.pose_accumulate", self.pose_accumulate, "be at least 1")
        require(self.num_pixels >= 1, "algo.mapping.num_pixels", self.num_pixels, "be at least 1")


@dataclass
class AlgorithmConfig:
    """What every algorithm has; `tracking` and `mapping` are chosen by `algo/tracking=` and `algo/mapping=`."""

    name: str = "???"
    map_every: int = 1
    """Map every n-th frame; the first frame is always mapped."""
    keyframe_every: int = 5
    """Make every n-th frame a keyframe."""
    first_pose: str = "auto"
    """Where the world is: `ground_truth` starts at the data's first pose, `identity` at the first camera, `auto` takes
    the data's where there is one. It moves no figure, only the frame that maps are written in."""
    motion: str = "constant_velocity"
    """How the next pose is predicted: none, constant_velocity."""
    tracking: Any = field(default_factory=TrackingConfig)
    mapping: Any = field(default_factory=MappingConfig)

    def __post_init__(self) -> None:
        require(self.map_every >= 1, "algo.map_every", self.map_every, "be at least 1")
        require(self.keyframe_every >= 1, "algo.keyframe_every", self.keyframe_every, "be at least 1")
        require_choice("algo.first_pose", self.first_pose, ("auto", "identity", "ground_truth"))
        require_choice("algo.motion", self.motion, ("none", "constant_velocity"))


@dataclass
class EngineConfig:
    """How a run is carried out, chosen by `engine=`."""

    name: str = "sequential"
    progress: bool = True
    """Show frames/s and what remains: a bar on a terminal, a line now and then elsewhere."""
    checkpoint_every: int = 50
    """Save everything after so many frames, for `resume=<run dir>`; 0 saves only when a run is told to end or fails."""

    def __post_init__(self) -> None:
        require(self.checkpoint_every >= 0, "engine.checkpoint_every", self.checkpoint_every, "not be negative")


@dataclass
class MultiprocessConfig(EngineConfig):
    """Tracker and Mapper as processes."""

    name: str = "multiprocess"
    sync: str = "strict"
    """`strict`: turn by turn, the sequential engine's very result; `async`: tracking goes ahead of mapping."""
    max_lag: int = 5
    """With `async`: how many tracked frames may wait for the mapper; with 0 it is `strict`."""

    @property
    def is_strict(self) -> bool:
        """Whether every frame is tracked against the map that holds all before it."""
        return self.sync == "strict" or self.max_lag == 0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_choice("engine.sync", self.sync, ("strict", "async"))
        require(self.max_lag >= 0, "engine.max_lag", self.max_lag, "not be negative")


@dataclass
class ViewerConfig:
    """How a run is watched, chosen by `viewer=`."""

    name: str = "none"


@dataclass
class RunConfig:
    """A whole run, as the command line composes it and as it is written beside its results."""

    algo: Any = field(default_factory=AlgorithmConfig)
    dataset: Any = "???"
    engine: Any = field(default_factory=EngineConfig)
    evaluation: Any = "???"
    viewer: Any = field(default_factory=ViewerConfig)
    seed: int = 0
    device: str = "cpu"
    """Where tensors live, as torch names it; `auto` takes an accelerator where there is one."""
    threads: int = 0
    """Threads of every library; 0 takes all cores."""
    settings: str = "none"
    """The dataset family whose published settings are in force (by default that of `dataset`)."""
    preset: str = "published"
    """What is laid over the published settings, such as fast."""
    run_dir: str = "???"
    report: bool = True
    """Write report.html at the end: the run on one page."""

    def __post_init__(self) -> None:
        require(self.seed >= 0, "seed", self.seed, "not be negative")
        require(self.threads >= 0, "threads", self.threads, "be the number of threads, or 0 for all cores")
