"""The toy's mapper: put points where the map has none."""

from collections.abc import Sequence

from xrdslam.core.frame import Frame
from xrdslam.core.mapping import MappingMethod, MappingResult
from xrdslam.core.model import Model

__all__ = ["ToyMapping"]


class ToyMapping(MappingMethod):
    """Extends the map and optimises nothing; works with any map."""

    needs = frozenset({"rgb", "depth"})

    def map(self, frame: Frame, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        """Let the map take what it lacks."""
        return MappingResult(num_added=model.extend(frame, frame.pose.matrix().detach()))
