"""The command line: Hydra around one run, errors in one line."""

import logging.config
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console

from xrdslam.command_line.compose import run_config
from xrdslam.command_line.explain import in_one_line
from xrdslam.command_line.groups import CONF_GROUP, conf_packages
from xrdslam.command_line.help import help_page
from xrdslam.core.errors import XrdslamError
from xrdslam.core.registry import installed

if TYPE_CHECKING:
    from xrdslam import engine

__all__ = ["main"]

RESUME = "resume="
"""The one argument that Hydra does not see."""

FULL_ERROR = "HYDRA_FULL_ERROR"
"""Set to 1 by a user, every error keeps its traceback; set by us, Hydra hands errors on instead of printing them."""


def main() -> None:
    """Do what the arguments say. What a user can mend is said in one line, exit status 1; the rest is a traceback."""
    if {"--help", "-h"} & set(sys.argv[1:]):
        print(help_page(installed()))
        return
    wants_traceback = os.environ.get(FULL_ERROR) == "1"
    os.environ[FULL_ERROR] = "1"
    try:
        if any(argument.startswith(RESUME) for argument in sys.argv[1:]):
            _resume(sys.argv[1:])
        else:
            _run()
    except (XrdslamError, HydraException, OmegaConfBaseException) as error:
        if wants_traceback:
            raise
        sys.exit(f"xrdslam: {in_one_line(error)}")
    except KeyboardInterrupt:
        sys.exit(130)


def _resume(arguments: Sequence[str]) -> None:
    """Go on with the run that `resume=<run dir>` names; its settings are recorded, so that nothing is composed."""
    run_dir = Path(next(a for a in arguments if a.startswith(RESUME)).removeprefix(RESUME))
    logs = OmegaConf.load(conf_packages()[CONF_GROUP] / "hydra" / "job_logging" / "xrdslam.yaml")
    logging.config.dictConfig(cast(dict[str, Any], OmegaConf.to_object(logs)))
    from xrdslam import engine

    _finish(engine.resume(run_dir, [a for a in arguments if not a.startswith(RESUME)]))


@hydra.main(version_base="1.3", config_path="pkg://xrdslam.conf", config_name="config")
def _run(cfg: DictConfig) -> None:
    """Carry out one composed run; Hydra calls this once, or once per job of a sweep."""
    job = HydraConfig.get()
    run_dir = Path(job.runtime.output_dir)
    try:
        config = run_config(cfg, job.runtime.choices, run_dir)
        from xrdslam import engine  # torch and the methods: only now that everything is checked

        summary = engine.run(config, run_dir)
    except XrdslamError as error:
        sys.exit(f"xrdslam: {in_one_line(error)}")
    _finish(summary)


def _finish(summary: "engine.RunSummary") -> None:
    """Show how a run ended, and end the process where that was not well."""
    from xrdslam import engine

    Console().print(engine.summary_table(summary.metrics, summary.run_dir))
    if summary.exit_status:
        sys.exit(summary.exit_status)
