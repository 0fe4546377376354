"""The command line: Hydra around one run, errors in one line."""

import os
import sys
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console

from xrdslam.command_line.compose import run_config
from xrdslam.command_line.explain import in_one_line
from xrdslam.command_line.help import help_page
from xrdslam.core.errors import XrdslamError
from xrdslam.core.registry import installed

__all__ = ["main"]

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
        _run()
    except (XrdslamError, HydraException, OmegaConfBaseException) as error:
        if wants_traceback:
            raise
        sys.exit(f"xrdslam: {in_one_line(error)}")
    except KeyboardInterrupt:
        sys.exit(130)


@hydra.main(version_base="1.3", config_path="pkg://xrdslam.conf", config_name="config")
def _run(cfg: DictConfig) -> None:
    """Carry out one composed run; Hydra calls this once, or once per job of a sweep."""
    job = HydraConfig.get()
    run_dir = Path(job.runtime.output_dir)
    try:
        config = run_config(cfg, job.runtime.choices, run_dir)
        from xrdslam import engine  # torch and the methods: only now that everything is checked

        summary = engine.run(config, run_dir)
        Console().print(engine.summary_table(summary.metrics, run_dir))
    except XrdslamError as error:
        sys.exit(f"xrdslam: {in_one_line(error)}")
    if summary.exit_status:
        sys.exit(summary.exit_status)
