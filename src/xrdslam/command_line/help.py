"""The page that `--help` prints: how to start, and what is installed."""

from collections.abc import Iterable, Mapping

from xrdslam.command_line.groups import options
from xrdslam.core.records import AlgorithmInfo, DatasetInfo, Info, MappingMethodInfo, TrackingMethodInfo, ViewerInfo
from xrdslam.core.registry import Registry

__all__ = ["help_page", "inventory"]

USAGE = """\
xrdslam: dense and learned visual SLAM

  python -m xrdslam algo=<name> dataset=<family>/<scene> [setting=value ...]
  python -m xrdslam -m algo=<name>,<name> dataset=... seed=0,1,2       a sweep: one run per combination
      launcher=joblib sweep.jobs=4      side by side (also ray, submitit_local, submitit_slurm)
      sweep.dir=<folder> sweep.skip_done=true      go on with a sweep: what is done is left out
  python -m xrdslam algo=<name> dataset=... --cfg job                  every setting and its value, nothing is run
  python -m xrdslam resume=<run dir>                                   go on with a run that did not end
"""
SETTINGS = """\
Common settings
  dataset.root=<folder>          where a family's scenes lie (default data/<Family>)
  dataset=<family>/custom dataset.path=<folder>     any other scene of a known layout
  dataset.frames=[0,200,2]       start, stop, stride          dataset.size=[320,240]   width, height
  dataset.max_depth=4            metres                       dataset.on_error=skip    go on over damaged frames
  dataset.drop=[80,110]          frames left out: a gap       algo.tracking.relocalise=true   recognise lost frames
  preset=published               or fast, where a method has it
  settings=<family>              published settings of another family than the dataset's
  seed=0  device=cpu  threads=0 (all)  run_dir=<folder>

Your own data: `python -m xrdslam.datasets inspect <path>` says what it is and how to run it
Does it not run? `python -m xrdslam.doctor`
More: --hydra-help, `python -m xrdslam.plugins`, eval "$(xrdslam -sc install=bash)" for completion"""


def help_page(registry: Registry) -> str:
    """Return the whole page."""
    return f"{USAGE}\n{inventory(registry)}\n{SETTINGS}"


def inventory(registry: Registry) -> str:
    """List what is installed, with a line for each name, and what is broken."""
    sections = [
        _section("Algorithms (algo=)", _lines(registry.all(AlgorithmInfo))),
        _section("Tracking methods (algo/tracking=)", _lines(registry.all(TrackingMethodInfo))),
        _section("Mapping methods (algo/mapping=)", _lines(registry.all(MappingMethodInfo))),
        _section("Datasets (dataset=)", _dataset_lines(registry)),
        _section("Viewers (viewer=)", _lines(registry.all(ViewerInfo))),
    ]
    if registry.broken:
        sections.append(_section("Broken plugins", (f"  {plugin}" for plugin in registry.broken.values())))
    return "\n".join(sections)


def _section(title: str, lines: Iterable[str]) -> str:
    return "\n".join([title, *(list(lines) or ["  none installed: pip install xrdslam-<name>"]), ""])


def _lines(infos: Mapping[str, Info]) -> Iterable[str]:
    width = max(map(len, infos), default=0) + 2
    for name, info in infos.items():
        yield f"  {name:<{width}}{info.summary}  [{info.distribution}]"


def _dataset_lines(registry: Registry) -> Iterable[str]:
    infos = registry.all(DatasetInfo)
    for line, family in zip(_lines(infos), infos, strict=True):
        yield line
        scenes = ", ".join(sorted(options(f"dataset/{family}")))
        yield f"      {family}/{{{scenes}}}"
