"""The toy method, its room and a viewer as a plugin registers them, for tests of engines; workers import by name."""

import dataclasses
from typing import Any

from xrdslam.core.config import (
    AlgorithmConfig,
    EngineConfig,
    IterativeMappingConfig,
    IterativeTrackingConfig,
    RunConfig,
)
from xrdslam.core.hookspecs import hookimpl
from xrdslam.core.records import AlgorithmInfo, DatasetInfo, MappingMethodInfo, TrackingMethodInfo, ViewerInfo
from xrdslam.core.registry import Registry
from xrdslam.datasets.config import DatasetConfig
from xrdslam.evaluation import EvaluationConfig
from xrdslam.testing.toy_sequence import ToySequence, toy_sequence

__all__ = ["ToyPlugin", "open_toy", "toy_config", "toy_registry"]


def open_toy(config: DatasetConfig) -> ToySequence:
    """Open the toy room; the scene is the number of its frames."""
    return toy_sequence(int(config.scene), 48, 36)


class ToyPlugin:
    """Everything a run needs, under the name `toy`."""

    @hookimpl
    def xrdslam_algorithms(self) -> list[AlgorithmInfo]:
        """Register the toy method."""
        return [AlgorithmInfo("toy", "xrdslam.testing.toy_method:ToyAlgorithm", "xrdslam.core.config:AlgorithmConfig")]

    @hookimpl
    def xrdslam_tracking_methods(self) -> list[TrackingMethodInfo]:
        """Register gradient descent."""
        config = "xrdslam.core.config:IterativeTrackingConfig"
        return [TrackingMethodInfo("toy", "xrdslam.core.tracking:GradientTracking", config)]

    @hookimpl
    def xrdslam_mapping_methods(self) -> list[MappingMethodInfo]:
        """Register gradient descent."""
        config = "xrdslam.core.config:IterativeMappingConfig"
        return [MappingMethodInfo("toy", "xrdslam.core.mapping:GradientMapping", config)]

    @hookimpl
    def xrdslam_datasets(self) -> list[DatasetInfo]:
        """Register the toy room."""
        return [DatasetInfo("toy", f"{__name__}:open_toy", "xrdslam.datasets.config:DatasetConfig")]

    @hookimpl
    def xrdslam_viewers(self) -> list[ViewerInfo]:
        """Register a viewer that goes wrong."""
        module = "xrdslam.testing.misbehaving_viewers"
        return [ViewerInfo("misbehaving", f"{module}:MisbehavingViewer", f"{module}:MisbehavingViewerConfig")]


def toy_registry() -> Registry:
    """Return a registry of this plugin alone."""
    registry = Registry()
    registry.register(ToyPlugin(), "toy 1.0")
    return registry


def toy_config(engine: EngineConfig, num_frames: int = 6, **changes: Any) -> RunConfig:  # noqa: ANN401  # fields of RunConfig
    """Return a run of some frames of 48x36 px: every frame is mapped, every second a keyframe, and their poses move."""
    algo = AlgorithmConfig(
        "toy",
        keyframe_every=2,
        tracking=IterativeTrackingConfig("toy", iterations=5),
        mapping=IterativeMappingConfig(
            "toy",
            iterations=5,
            keyframes="window",
            window=3,
            lr_pose_rotation=1e-3,
            lr_pose_translation=1e-3,
            keep_optimiser=True,
        ),
    )
    evaluation = EvaluationConfig(every=2, pictures_every=0, trajectory_pictures=False)
    dataset = DatasetConfig("toy", str(num_frames))
    return dataclasses.replace(RunConfig(algo, dataset, engine, evaluation, threads=1, report=False), **changes)
