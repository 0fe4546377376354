"""`python -m xrdslam.evaluation RUN`: every figure of a finished run once more, or those of a trajectory file."""

import argparse
import logging
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from xrdslam.command_line.explain import in_one_line
from xrdslam.core.errors import ConfigError, XrdslamError

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Do what the arguments say; an error that a user can mend is one line, exit status 1."""
    parser = argparse.ArgumentParser(prog="python -m xrdslam.evaluation", description=__doc__)
    add = parser.add_argument
    add("run", type=Path, help="the folder of a run; or an estimated trajectory in TUM's format")
    add("settings", nargs="*", metavar="evaluation.NAME=VALUE", help="laid over the settings that the run had")
    add("--gt-mesh", type=Path, help="the true surface, a PLY file (else the dataset's)")
    add("--ground-truth", type=Path, help="the true trajectory that a trajectory file is held against")
    chosen = parser.parse_args(arguments)
    logging.basicConfig(format="%(levelname)s %(message)s")
    try:
        if chosen.ground_truth is not None:
            _trajectory(chosen)
        elif chosen.run.is_file():
            raise ConfigError(f"{chosen.run}: a trajectory file needs --ground-truth; for a run give its folder")
        else:
            _run(chosen)
    except XrdslamError as error:
        sys.exit(f"xrdslam: {in_one_line(error)}")


def _run(chosen: argparse.Namespace) -> None:
    from xrdslam import engine  # torch and the methods: only now
    from xrdslam.engine.reevaluation import evaluate_again

    metrics = evaluate_again(chosen.run, chosen.settings, chosen.gt_mesh)
    Console().print(engine.summary_table(metrics, chosen.run))


def _trajectory(chosen: argparse.Namespace) -> None:
    from xrdslam import engine
    from xrdslam.engine.reevaluation import overlaid
    from xrdslam.evaluation import EvalMetrics, EvaluationConfig
    from xrdslam.evaluation.trajectory_files import read_tum

    config = overlaid(EvaluationConfig(), chosen.settings)
    metrics = EvalMetrics(config).evaluate_files(read_tum(chosen.run), read_tum(chosen.ground_truth))
    Console().print(engine.summary_table(metrics, chosen.run))
