"""The hooks that a distribution may implement in the module that its entry point in group `xrdslam` names.

Registration hooks return records and import nothing heavy; run-time hooks watch a run. A plugin writes::

    from xrdslam.core.hookspecs import hookimpl
    from xrdslam.core.records import AlgorithmInfo

    @hookimpl
    def xrdslam_algorithms() -> list[AlgorithmInfo]:
        return [AlgorithmInfo("mine", "mine.algorithm:Mine", "mine.config:MineConfig")]
"""

from typing import TYPE_CHECKING

import pluggy

from xrdslam.core.records import (
    AlgorithmInfo,
    DatasetInfo,
    Info,
    MappingMethodInfo,
    MetricInfo,
    TrackingMethodInfo,
    ViewerInfo,
)

if TYPE_CHECKING:  # a plugin's module must cost nothing, so torch is not imported to name a type
    from xrdslam.core.frame import Frame
    from xrdslam.core.mapping import MappingResult
    from xrdslam.core.tracking import TrackingResult

__all__ = ["PROJECT", "REGISTRATION_HOOKS", "HookSpecs", "hookimpl", "hookspec"]

PROJECT = "xrdslam"
"""The name of the entry-point group and the prefix of every hook."""

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)

REGISTRATION_HOOKS: dict[str, type[Info]] = {
    "xrdslam_algorithms": AlgorithmInfo,
    "xrdslam_tracking_methods": TrackingMethodInfo,
    "xrdslam_mapping_methods": MappingMethodInfo,
    "xrdslam_datasets": DatasetInfo,
    "xrdslam_metrics": MetricInfo,
    "xrdslam_viewers": ViewerInfo,
}
"""Each registration hook and the record that it returns a list of."""


class HookSpecs:
    """What may be hooked into, and with which arguments (a plugin may leave out those it does not read)."""

    @hookspec
    def xrdslam_algorithms(self) -> list[AlgorithmInfo]:
        """Register algorithms, chosen by `algo=`."""
        return []

    @hookspec
    def xrdslam_tracking_methods(self) -> list[TrackingMethodInfo]:
        """Register tracking methods, chosen by `algo/tracking=`."""
        return []

    @hookspec
    def xrdslam_mapping_methods(self) -> list[MappingMethodInfo]:
        """Register mapping methods, chosen by `algo/mapping=`."""
        return []

    @hookspec
    def xrdslam_datasets(self) -> list[DatasetInfo]:
        """Register dataset families, chosen by `dataset=<family>/<scene>`."""
        return []

    @hookspec
    def xrdslam_metrics(self) -> list[MetricInfo]:
        """Register figures that an evaluation computes."""
        return []

    @hookspec
    def xrdslam_viewers(self) -> list[ViewerInfo]:
        """Register viewers."""
        return []

    @hookspec
    def xrdslam_run_started(self, run: object) -> None:
        """Hear that a run begins; its algorithm, dataset and run directory exist."""

    @hookspec
    def xrdslam_frame_tracked(self, run: object, frame: "Frame", result: "TrackingResult") -> None:
        """Hear of a tracked frame and its `TrackingResult`."""

    @hookspec
    def xrdslam_map_updated(self, run: object, frame: "Frame", result: "MappingResult") -> None:
        """Hear of a frame that went into the map, and of its `MappingResult`."""

    @hookspec
    def xrdslam_run_finished(self, run: object, metrics: object) -> None:
        """Hear that a run is over and what was measured."""
