"""Finding a frame again whose track was lost."""

from abc import ABC, abstractmethod
from typing import NamedTuple

from jaxtyping import Float, Float64
from torch import Tensor

from xrdslam.core.frame import Frame
from xrdslam.core.trajectory import Trajectory

__all__ = ["Relocalisation", "Relocaliser"]


class Relocalisation(NamedTuple):
    """Where a lost frame was taken, or that nobody knows."""

    T_world_camera: Float64[Tensor, "4 4"] | None
    reason: str
    """What the pose rests on, or why there is none."""


class Relocaliser(ABC):
    """Remembers what was seen from where, and recognises it.

    The algorithm tells it of every frame that was tracked and asks it about every frame that was not. Where a
    remembered frame is, the trajectory says, so that poses which mapping corrects later are followed.
    """

    @abstractmethod
    def remember(self, frame: Frame, trajectory: Trajectory) -> None:
        """Hear of a frame that was tracked; its pose is in the trajectory."""

    @abstractmethod
    def find(self, frame: Frame, trajectory: Trajectory) -> Relocalisation:
        """Say where a frame was taken that the tracker lost; None rather than a pose that is not verified."""

    @abstractmethod
    def agrees(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"], trajectory: Trajectory) -> bool:
        """Say whether the tracker's refinement of the frame last found agrees with what was remembered there."""

    def state_dict(self) -> dict[str, Tensor]:
        """Return what a resumed run needs."""
        return {}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:  # noqa: B027  # nothing by default
        """Take over what `state_dict` returned."""
