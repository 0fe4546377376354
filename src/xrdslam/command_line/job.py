"""`python -m xrdslam.command_line.job`: one job of a sweep, in a process of its own, which only the sweep starts.

What to do is a line of JSON on standard input, which then stays open: when it closes, whoever started this process is
gone, and the run ends as it would on SIGTERM, saving what there is.
"""

import json
import logging.config
import os
import signal
import sys
import threading
import time
import traceback
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from omegaconf import OmegaConf
from rich.console import Console

from xrdslam.command_line.explain import in_one_line
from xrdslam.command_line.groups import CONF_GROUP, conf_packages
from xrdslam.command_line.ledger import Outcome
from xrdslam.core.errors import XrdslamError

__all__ = ["log_to_stderr", "main"]


def main() -> None:
    """Carry out the run, and write down how it ended."""
    asked = json.loads(sys.stdin.buffer.readline())
    threading.Thread(target=_end_with_parent, daemon=True).start()
    log_to_stderr()
    began = time.monotonic()
    status, reason = _carry_out(asked["settings"], asked["resume"])
    run_dir = Path(asked["settings"]["run_dir"])
    begun = Outcome(**asked["outcome"], run_dir=run_dir)
    replace(begun, status=status, reason=reason, seconds=round(time.monotonic() - began, 1)).write()
    sys.exit({"done": 0, "interrupted": 130}.get(status, 1))


def log_to_stderr() -> None:
    """Set up messages as Hydra does where it is asked."""
    logs = OmegaConf.load(conf_packages()[CONF_GROUP] / "hydra" / "job_logging" / "xrdslam.yaml")
    logging.config.dictConfig(cast(dict[str, Any], OmegaConf.to_object(logs)))


def _carry_out(settings: dict[str, Any], is_resumed: bool) -> tuple[str, str]:
    run_dir = Path(settings["run_dir"])
    try:
        from xrdslam import engine  # torch and the methods: only now
        from xrdslam.engine.recorded import typed_config

        summary = engine.resume(run_dir) if is_resumed else engine.run(typed_config(settings), run_dir)
        Console().print(engine.summary_table(summary.metrics, summary.run_dir))
    except KeyboardInterrupt:
        return "interrupted", ""
    except XrdslamError as error:
        return "failed", in_one_line(error)
    except Exception as error:
        traceback.print_exc()
        return "failed", f"{type(error).__name__}: {' '.join(str(error).split())}"
    return ("interrupted" if summary.was_interrupted else "done"), ""


def _end_with_parent() -> None:
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    main()
