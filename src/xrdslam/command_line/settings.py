"""What the command line adds to the settings of a run: how a sweep (`-m`) is carried out."""

from dataclasses import dataclass, field, fields

from xrdslam.core.config import RunConfig, require

__all__ = ["CommandLineConfig", "SweepConfig"]


@dataclass
class SweepConfig:
    """Settings of a sweep; a single run has no use for them."""

    dir: str = "outputs/sweeps/${now:%Y-%m-%d_%H-%M-%S}"
    """The folder that its jobs' folders lie in; an earlier sweep's, to go on with it."""
    jobs: int = 0
    """Jobs side by side, which divide the cores; 0 is one for each core where the launcher can, else 1."""
    skip_done: bool = False
    """Leave out jobs that an earlier call finished, and resume those that left a checkpoint."""

    def __post_init__(self) -> None:
        require(self.jobs >= 0, "sweep.jobs", self.jobs, "be a number of jobs, or 0 for one for each core")


@dataclass
class CommandLineConfig(RunConfig):
    """All that stands on the command line."""

    sweep: SweepConfig = field(default_factory=SweepConfig)

    def run(self) -> RunConfig:
        """Return what belongs to a run, which is what it writes down."""
        return RunConfig(**{known.name: getattr(self, known.name) for known in fields(RunConfig)})
