"""Telling how far a run is: a bar on a terminal, plain lines elsewhere."""

import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from xrdslam.engine.profile import FrameCost

__all__ = ["ProgressReport"]

LINE_EVERY_S = 10.0


class ProgressReport:
    """Frames done, frames/s, what remains, ms by stage, keyframes, lost frames, memory."""

    def __init__(self, title: str, total: int, shown: bool = True, earlier: Sequence[FrameCost] = ()) -> None:
        """Begin; `earlier` are the frames that a run did before it was resumed."""
        self.total = total
        self.shown = shown
        self.title = title
        self.console = Console(stderr=True)
        self._start = time.perf_counter()
        self._last_line = self._start
        self._counts = {"frames": 0, "keyframes": 0, "lost": 0}
        for cost in earlier:
            self._count(cost)
        self._earlier = len(earlier)
        self._bar: Progress | None = None

    def __enter__(self) -> "ProgressReport":
        if self.shown and self.console.is_terminal:
            columns = (TextColumn("{task.description}"), BarColumn(None), MofNCompleteColumn(), TimeElapsedColumn())
            columns += (TimeRemainingColumn(), TextColumn("{task.fields[status]}"))  # type: ignore[assignment]
            self._bar = Progress(*columns, console=self.console, refresh_per_second=4)
            self._bar.start()
            self._task = self._bar.add_task(self.title, total=self.total, completed=self._earlier, status="")
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self, cost: FrameCost) -> None:
        """Take in a finished frame."""
        self._count(cost)
        if not self.shown:
            return
        if self._bar is not None:
            self._bar.update(self._task, completed=self._counts["frames"], status=self._status(cost))
        elif time.perf_counter() - self._last_line > LINE_EVERY_S:
            self._last_line = time.perf_counter()
            remaining = (self.total - self._counts["frames"]) / self._rate()
            line = f"{self.title}: frame {self._counts['frames']}/{self.total}, {self._status(cost)}"
            with suppress(OSError):  # who read it is gone; the run goes on
                sys.stderr.write(f"{line}, {remaining:.0f} s remain\n")
                sys.stderr.flush()

    def _count(self, cost: FrameCost) -> None:
        self._counts["frames"] += 1
        self._counts["keyframes"] += cost.is_keyframe
        self._counts["lost"] += cost.is_lost

    def _rate(self) -> float:
        return (self._counts["frames"] - self._earlier) / max(1e-9, time.perf_counter() - self._start)

    def _status(self, cost: FrameCost) -> str:
        lost = f", {self._counts['lost']} LOST" if self._counts["lost"] else ""
        return (
            f"{self._rate():.2f} frames/s, tracking {cost.tracking_ms:.0f} ms, mapping {cost.mapping_ms:.0f} ms, "
            f"{self._counts['keyframes']} keyframes, {cost.rss_mib:.0f} MiB{lost}"
        )
