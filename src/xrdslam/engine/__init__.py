"""A run: from a configuration to a run directory. Names are imported when first used."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from xrdslam.engine.build import build_algorithm, build_dataset
    from xrdslam.engine.context import Run
    from xrdslam.engine.one_run import RunSummary, resume, run
    from xrdslam.engine.restoring import load_run
    from xrdslam.engine.summary import summary_table

__all__ = ["Run", "RunSummary", "build_algorithm", "build_dataset", "load_run", "resume", "run", "summary_table"]

_MODULES = {
    "build": ("build_algorithm", "build_dataset"),
    "context": ("Run",),
    "one_run": ("RunSummary", "resume", "run"),
    "restoring": ("load_run",),
    "summary": ("summary_table",),
}


def __getattr__(name: str) -> Any:  # noqa: ANN401  # any of the names above
    """Import the module of a name: a process of a run has no use for figures, reports and bars."""
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
