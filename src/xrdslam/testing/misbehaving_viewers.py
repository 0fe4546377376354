"""A viewer that misbehaves at the first frame it is shown, in one of several ways, for tests of who feeds viewers."""

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from xrdslam.core.config import ViewerConfig
from xrdslam.core.errors import MissingExtraError
from xrdslam.core.frame import Frame
from xrdslam.core.hookspecs import hookimpl
from xrdslam.engine.context import Run

__all__ = ["MisbehavingViewer", "MisbehavingViewerConfig"]

FOR_EVER_S = 600.0


@dataclass
class MisbehavingViewerConfig(ViewerConfig):
    """What to do, and where to write what was heard."""

    name: str = "misbehaving"
    fault: str = "none"
    """none; absent (refuses to be made); slow (hangs); raises; exits; closing (raises when it is closed)."""
    heard: str = "???"
    """A file: a line for each call."""


class MisbehavingViewer:
    """Writes down what it hears, until it does what its configuration says."""

    def __init__(self, config: MisbehavingViewerConfig) -> None:
        self.config = config
        if config.fault == "absent":
            raise MissingExtraError("viewer=misbehaving needs what nobody has")

    @hookimpl
    def xrdslam_run_started(self, run: Run) -> None:
        """Write it down."""
        self._write(f"started {run.title}")

    @hookimpl
    def xrdslam_frame_tracked(self, run: Run, frame: Frame, result: object) -> None:
        """Write it down, with how bright the frame is; misbehave."""
        self._write(f"tracked {frame.index} {float(frame.rgb.mean()):.6f} {len(run.algorithm.trajectory)}")
        self._misbehave()

    @hookimpl
    def xrdslam_map_updated(self, run: Run, frame: Frame, result: object) -> None:
        """Write it down, with how large the map is."""
        self._write(f"mapped {frame.index} {run.algorithm.model.size}")

    @hookimpl
    def xrdslam_run_finished(self, run: Run, metrics: Mapping[str, object]) -> None:
        """Write it down."""
        self._write(f"finished {len(run.algorithm.trajectory)} {metrics['profile/frames']}")

    def close(self) -> None:
        """Write it down."""
        self._write("closed")
        if self.config.fault == "closing":
            raise ZeroDivisionError("a fault of the viewer")

    def _misbehave(self) -> None:
        if self.config.fault == "slow":
            time.sleep(FOR_EVER_S)
        elif self.config.fault == "raises":
            raise ZeroDivisionError("a fault of the viewer")
        elif self.config.fault == "exits":
            os._exit(3)

    def _write(self, line: str) -> None:
        with Path(self.config.heard).open("a") as heard:
            heard.write(line + "\n")
