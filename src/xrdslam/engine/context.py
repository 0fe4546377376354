"""What belongs to one run."""

from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.config import RunConfig
from xrdslam.core.dataset import Dataset
from xrdslam.core.frame import Frame
from xrdslam.core.registry import Registry
from xrdslam.engine.directory import RunDirectory
from xrdslam.engine.interruption import Interruption
from xrdslam.engine.profile import Profile

__all__ = ["Run"]


@dataclass
class Run:
    """A run, as hooks see it: settings, data, method, results so far."""

    config: RunConfig
    directory: RunDirectory
    dataset: Dataset
    algorithm: Algorithm
    registry: Registry
    device: str
    profile: Profile = field(default_factory=Profile)
    ground_truth: dict[int, Tensor] = field(default_factory=dict)
    next_frame: int = 0
    """The dataset's frame to go on with: the first one, or the one after a checkpoint's."""
    streams: dict[str, Any] = field(default_factory=dict)
    """Where the global random numbers of `tracker` and `mapper` were, if the run is taken up."""
    resumed_after: list[int] = field(default_factory=list)
    """The frames after which the run was taken up again."""
    has_ended: bool = False
    """Whether every frame has passed."""
    interruption: Interruption = field(default_factory=Interruption)
    """Whether the run is asked to end, and where it may be."""
    closing: ExitStack = field(default_factory=ExitStack)
    """What an engine leaves open until everything is saved and measured."""

    @property
    def scene(self) -> Scene:
        """What is known of the sequence."""
        return Scene.of(self.dataset)

    @property
    def title(self) -> str:
        """`<algorithm> on <dataset>`."""
        return f"{self.config.algo.name} on {self.dataset.name}"

    def note(self, frame: Frame) -> None:
        """Keep a frame's ground truth for the evaluation; an unknown pose is NaN."""
        self.note_truth(frame.index, frame.T_world_camera_gt)

    def note_truth(self, index: int, T_world_camera_gt: Tensor | None) -> None:
        """Keep the ground truth of a frame that is elsewhere."""
        unknown = torch.full((4, 4), torch.nan, dtype=torch.float64)
        given = T_world_camera_gt
        self.ground_truth[index] = unknown if given is None else given.detach().to("cpu", torch.float64)
