"""The command line: Hydra around one run, errors in one line."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console

from xrdslam.command_line.compose import run_config
from xrdslam.command_line.explain import in_one_line
from xrdslam.command_line.groups import CONF_GROUP
from xrdslam.command_line.help import help_page
from xrdslam.command_line.job import log_to_stderr
from xrdslam.command_line.sweep import supervised
from xrdslam.command_line.swept import carry_out_job
from xrdslam.core.errors import XrdslamError
from xrdslam.core.registry import installed

if TYPE_CHECKING:
    from xrdslam import engine

__all__ = ["carry_out", "main"]

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
            with supervised():
                hydra.main(version_base="1.3", config_path=f"pkg://{CONF_GROUP}", config_name="config")(carry_out)()
    except (XrdslamError, HydraException, OmegaConfBaseException) as error:
        if wants_traceback:
            raise
        sys.exit(f"xrdslam: {in_one_line(error)}")
    except KeyboardInterrupt:
        sys.exit(130)


def _resume(arguments: Sequence[str]) -> None:
    """Go on with the run that `resume=<run dir>` names; its settings are recorded, so that nothing is composed."""
    run_dir = Path(next(a for a in arguments if a.startswith(RESUME)).removeprefix(RESUME))
    log_to_stderr()
    from xrdslam import engine

    _finish(engine.resume(run_dir, [a for a in arguments if not a.startswith(RESUME)]))


def carry_out(cfg: DictConfig) -> None:
    """Carry out what Hydra composed: the one run of a command line, or a job of its sweep.

    Public because the launchers of sweeps send it to other processes by its name.
    """
    hydra_config = HydraConfig.get()
    run_dir, choices = Path(hydra_config.runtime.output_dir), hydra_config.runtime.choices
    if not OmegaConf.is_missing(hydra_config.job, "num"):  # numbered in sweeps only
        overrides = [str(override) for override in hydra_config.overrides.task]
        carry_out_job(cfg, choices, run_dir, Path(hydra_config.sweep.dir), overrides)
        return
    try:
        config = run_config(cfg, choices, run_dir)
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
