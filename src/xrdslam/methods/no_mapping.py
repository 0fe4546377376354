"""Mapping that makes no map: pure odometry."""

from collections.abc import Sequence

from xrdslam.core.frame import Frame
from xrdslam.core.mapping import MappingMethod, MappingResult
from xrdslam.core.model import Model

__all__ = ["NoMapping"]


class NoMapping(MappingMethod):
    """Leaves the map alone; nothing that the map itself needs of a frame is then asked for."""

    changes_map = False

    def map(self, frame: Frame, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        """Do nothing."""
        return MappingResult()
