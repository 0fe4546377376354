"""A run: from a configuration to a run directory."""

from xrdslam.engine.build import build_algorithm, build_dataset
from xrdslam.engine.context import Run
from xrdslam.engine.restoring import load_run
from xrdslam.engine.run import RunSummary, resume, run
from xrdslam.engine.summary import summary_table

__all__ = ["Run", "RunSummary", "build_algorithm", "build_dataset", "load_run", "resume", "run", "summary_table"]
