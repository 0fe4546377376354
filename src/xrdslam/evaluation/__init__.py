"""Accuracy of a run: trajectory, renderings, the protocol beside each number. Names are imported when first used."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from xrdslam.evaluation.alignment import Alignment, umeyama
    from xrdslam.evaluation.comparison import side_by_side
    from xrdslam.evaluation.config import EvaluationConfig
    from xrdslam.evaluation.errors import EvaluationError
    from xrdslam.evaluation.eval_metrics import EvalMetrics
    from xrdslam.evaluation.image_quality import depth_l1_cm, ms_ssim, psnr, ssim
    from xrdslam.evaluation.metrics import JsonValue, MetricGroup, Metrics, assemble, write_metrics
    from xrdslam.evaluation.plots import trajectory_figure, write_figure
    from xrdslam.evaluation.rendering import RenderingMetrics
    from xrdslam.evaluation.trajectories import Trajectories
    from xrdslam.evaluation.trajectory import (
        RelativePoseError,
        TrajectoryError,
        absolute_trajectory_error,
        relative_pose_error,
    )

__all__ = [
    "Alignment",
    "EvalMetrics",
    "EvaluationConfig",
    "EvaluationError",
    "JsonValue",
    "MetricGroup",
    "Metrics",
    "RelativePoseError",
    "RenderingMetrics",
    "Trajectories",
    "TrajectoryError",
    "absolute_trajectory_error",
    "assemble",
    "depth_l1_cm",
    "ms_ssim",
    "psnr",
    "relative_pose_error",
    "side_by_side",
    "ssim",
    "trajectory_figure",
    "umeyama",
    "write_figure",
    "write_metrics",
]

_MODULES = {
    "alignment": ("Alignment", "umeyama"),
    "config": ("EvaluationConfig",),
    "errors": ("EvaluationError",),
    "eval_metrics": ("EvalMetrics",),
    "image_quality": ("depth_l1_cm", "ms_ssim", "psnr", "ssim"),
    "metrics": ("JsonValue", "MetricGroup", "Metrics", "assemble", "write_metrics"),
    "plots": ("trajectory_figure", "write_figure"),
    "rendering": ("RenderingMetrics",),
    "comparison": ("side_by_side",),
    "trajectories": ("Trajectories",),
    "trajectory": ("RelativePoseError", "TrajectoryError", "absolute_trajectory_error", "relative_pose_error"),
}


def __getattr__(name: str) -> Any:  # noqa: ANN401  # any of the names above
    """Import the module of a name: torch and matplotlib are not paid for by a listing of settings."""
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
