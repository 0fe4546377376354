"""What a worker process is told, and how it sets out."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.config import RunConfig
from xrdslam.core.dataset import Dataset
from xrdslam.core.registry import Registry
from xrdslam.engine.build import algorithm_of
from xrdslam.engine.heap import keep
from xrdslam.engine.multiprocess.channels import Channels
from xrdslam.engine.multiprocess.child import Say
from xrdslam.engine.seeding import prepare

__all__ = ["Job", "Work", "work"]


@dataclass(frozen=True)
class Job:
    """What a worker is told of the run."""

    config: RunConfig
    dataset: Dataset
    registry: Registry
    device: str
    threads: int
    """Of this process."""
    run_dir: Path
    next_frame: int
    """The dataset's frame to begin with."""
    streams: dict[str, Any]
    """Where the global random numbers of tracker and mapper are, if the run is taken up."""
    is_heard: bool
    """Whether a plugin's hooks hear of frames, in the parent."""
    is_watched: bool
    """Whether a viewer does, in a process of its own."""

    @property
    def with_poses(self) -> bool:
        """Say whether hooks want the poses that moved; everybody else has them in the trajectory."""
        return self.is_heard or self.is_watched

    @property
    def scene(self) -> Scene:
        """What is known of the sequence."""
        return Scene.of(self.dataset)

    def algorithm(self) -> Algorithm:
        """Build the method as every other process does."""
        return algorithm_of(self.config, self.device, self.registry)


Work = Callable[[Job, Channels], None]


def work(packed: bytes, task: Work, channels: Channels, _say: Say) -> None:
    """Be a worker: what its process calls."""
    keep()
    told: Job = pickle.loads(packed)
    prepare(told.config.seed, told.threads)
    channels.event_begin.wait()
    task(told, channels)
