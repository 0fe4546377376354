"""A run: from a configuration to a run directory."""

from xrdslam.engine.build import build_algorithm, build_dataset
from xrdslam.engine.context import Run
from xrdslam.engine.run import RunSummary, run
from xrdslam.engine.summary import summary_table

__all__ = ["Run", "RunSummary", "build_algorithm", "build_dataset", "run", "summary_table"]
