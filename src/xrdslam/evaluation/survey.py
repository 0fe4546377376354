"""One pass over the frames that any figure needs: each is read once, rendered, compared, drawn, its depth kept.

Rendering is left to one thread; frames are read ahead, compared and drawn in threads beside it, each by one of them. So
the numbers do not depend on how these are spread, and no map needs to be safe against two threads at once.
"""

import csv
import dataclasses
import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset

from xrdslam.core.errors import XrdslamError
from xrdslam.core.files import replaced
from xrdslam.core.model import Rendering
from xrdslam.evaluation.comparison import side_by_side
from xrdslam.evaluation.config import EvaluationConfig
from xrdslam.evaluation.culling import DepthView
from xrdslam.evaluation.metrics import MetricGroup
from xrdslam.evaluation.plots import write_figure
from xrdslam.evaluation.rendering import (
    MEASURES,
    Comparison,
    EvaluatedFrame,
    FrameRow,
    Frames,
    Perceptual,
    Render,
    RenderingMetrics,
)
from xrdslam.evaluation.trajectories import Trajectories
from xrdslam.pictures.panels import Panels, chosen_frames, write_panels

__all__ = ["Survey", "picked"]

log = logging.getLogger(__name__)

_AHEAD = 3
"""Frames read, or waiting to be compared, beside the one that is rendered."""
_DRAWING = threading.Lock()  # matplotlib shares its fonts between figures


class Survey:
    """What the frames of a run give: rows of comparisons by kind of view, and what was measured from where."""

    def __init__(
        self,
        config: EvaluationConfig,
        trajectories: Trajectories,
        run_dir: Path | None = None,
        perceptual: Perceptual | None = None,
    ) -> None:
        """Compare training views every `config.every` frames and all held-out ones; draw into `run_dir`."""
        self.config, self.trajectories, self.run_dir = config, trajectories, run_dir
        kinds = ("train", "held_out") if trajectories.held_out else ("train",)
        strides = {"train": config.every, "held_out": config.held_out}
        self.metrics = {
            kind: RenderingMetrics(strides[kind], config.mask, kind, perceptual=perceptual) for kind in kinds
        }
        self._kept = chosen_frames(self._compared()) if run_dir is not None and config.pictures_every else set()
        self.depth_views: list[DepthView] = []
        self.fault: XrdslamError | None = None

    def go(self, render: Render | None, frames: Frames, wants_depth: bool = False) -> None:
        """Visit the frames; an error of the renderer ends the comparisons and not the pass."""
        rendered = set() if render is None else {index for index in self._compared() if self._pose(index) is not None}
        seen = set(self._depth_poses()) if wants_depth else set()
        with ThreadPoolExecutor(torch.get_num_threads(), "evaluation") as pool:
            pending: deque[Future[tuple[str, Comparison]]] = deque()
            for frame in picked(frames, sorted(rendered | seen), pool):
                if frame.index in seen and frame.depth is not None:
                    self.depth_views.append(_depth_view(frame, self._depth_poses()[frame.index]))
                if render is not None and self.fault is None and frame.index in rendered:
                    self._attempt(lambda frame=frame: pending.append(self._submit(pool, render, frame)))  # type: ignore[misc]  # bound now
                while len(pending) > _AHEAD:
                    self._attempt(lambda: self._keep(pending.popleft()))
            while pending:
                self._attempt(lambda: self._keep(pending.popleft()))

    def groups(self) -> list[MetricGroup]:
        """Return the rendering figures of each kind of view; after an error of the renderer none, with the reason."""
        return [self._group(kind, metrics) for kind, metrics in self.metrics.items()]

    def write_rows(self, path: Path) -> None:
        """Write a row for every compared frame."""
        rows = [(kind, row) for kind, metrics in self.metrics.items() for row in metrics.rows]
        with replaced(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, [*(field.name for field in dataclasses.fields(FrameRow)), "is_held_out"])
            writer.writeheader()
            for kind, row in sorted(rows, key=lambda pair: pair[1].index):
                writer.writerow(dataclasses.asdict(row) | {"is_held_out": int(kind == "held_out")})

    def _group(self, kind: str, metrics: RenderingMetrics) -> MetricGroup:
        if self.fault is not None:
            group = MetricGroup(f"rendering/{kind}", metrics.protocol())
            group.refuse(MEASURES, f"rendering stopped after {len(metrics.rows)} frames: {self.fault}")
            return group
        group = metrics.group()
        wanted = [index for index in self._compared() if self._kind(index) == kind]
        group.protocol["frames_without_pose"] = sum(self._pose(index) is None for index in wanted)
        return group

    def _attempt(self, step: Callable[[], None]) -> None:
        try:
            step()
        except XrdslamError as error:
            if self.fault is None:
                log.warning("the renderings were not evaluated: %s", error)
                self.fault = error

    def _submit(
        self, pool: ThreadPoolExecutor, render: Render, frame: EvaluatedFrame
    ) -> "Future[tuple[str, Comparison]]":
        """Render here; compare and draw in another thread."""
        pose = self._pose(frame.index)
        assert pose is not None, "only frames with a pose are rendered"
        with torch.no_grad():
            rendering = render(frame.camera, pose.to(frame.rgb))
        return pool.submit(self._compare, frame, rendering)

    def _compare(self, frame: EvaluatedFrame, rendering: Rendering) -> tuple[str, Comparison]:
        kind = self._kind(frame.index)
        comparison = self.metrics[kind].compare(frame, rendering)
        every = self.config.pictures_every
        if self.run_dir is not None and frame.index in self._kept:
            _keep_panels(self.run_dir / "renders" / "panels", frame, rendering)
        if self.run_dir is not None and every and frame.index % every == 0:
            _write_picture(self.run_dir / "renders" / f"frame_{frame.index:06d}.png", frame, rendering, comparison.row)
        return kind, comparison

    def _keep(self, future: "Future[tuple[str, Comparison]]") -> None:
        kind, comparison = future.result()
        self.metrics[kind].keep(comparison)

    def _kind(self, index: int) -> str:
        return "held_out" if index in self.trajectories.held_out else "train"

    def _compared(self) -> list[int]:
        held_out = self.trajectories.held_out
        return [i for i in sorted(self.trajectories.rows) if i in held_out or i % self.config.every == 0]

    def _pose(self, index: int) -> Tensor | None:
        """Return the final pose of a frame, None where it has none."""
        pose = torch.from_numpy(self.trajectories.final[self.trajectories.rows[index]])
        return pose if bool(pose.isfinite().all()) else None

    def _depth_poses(self) -> dict[int, NDArray[np.float64]]:
        """Return the true poses of the frames that say what was seen of a surface."""
        truth = self.trajectories.ground_truth
        rows = {} if truth is None else self.trajectories.rows
        return {
            index: np.asarray(truth[row], dtype=np.float64)  # type: ignore[index]  # there are no rows without it
            for index, row in rows.items()
            if index % self.config.cull_every == 0 and np.isfinite(truth[row]).all()  # type: ignore[index]
        }


def picked(frames: Frames, indices: Sequence[int], pool: ThreadPoolExecutor | None = None) -> Iterator[EvaluatedFrame]:
    """Yield the frames of these indices; a Dataset is asked for no others, ahead of their use where there is a pool."""
    if not isinstance(frames, Dataset):
        wanted = set(indices)
        yield from (frame for frame in frames if frame.index in wanted)
        return
    if pool is None:
        yield from (frames[index] for index in indices)
        return
    reading: deque[Future[EvaluatedFrame]] = deque()
    for index in indices:
        reading.append(pool.submit(frames.__getitem__, index))
        if len(reading) > _AHEAD:
            yield reading.popleft().result()
    while reading:
        yield reading.popleft().result()


def _depth_view(frame: EvaluatedFrame, T_world_camera: NDArray[np.float64]) -> DepthView:
    assert frame.depth is not None, "asked for before"
    return DepthView(frame.camera, T_world_camera, _array(frame.depth))


def _write_picture(path: Path, frame: EvaluatedFrame, rendering: Rendering, row: FrameRow) -> None:
    scores = (("PSNR", row.psnr_db, "dB"), ("depth L1", row.depth_l1_cm, "cm"))
    texts = [f"{name} n/a" if value is None else f"{name} {value:.2f} {unit}" for name, value, unit in scores]
    depth = None if frame.depth is None else _array(frame.depth)
    caption = "   ·   ".join([f"frame {frame.index}", *texts])
    with _DRAWING:
        figure = side_by_side(_array(frame.rgb), _array(rendering.rgb), depth, _array(rendering.depth), caption)
        write_figure(figure, path)


def _keep_panels(folder: Path, frame: EvaluatedFrame, rendering: Rendering) -> None:
    """Keep what a report and a replay show of a frame."""
    depth = None if frame.depth is None else _array(frame.depth)
    rgb, rendered = (
        np.rint(255 * np.clip(_array(image), 0, 1)).astype(np.uint8) for image in (frame.rgb, rendering.rgb)
    )
    write_panels(folder, Panels(frame.index, rgb, rendered, depth, _array(rendering.depth)))


def _array(image: Tensor) -> NDArray[np.float32]:
    return np.asarray(image.detach().to("cpu", torch.float32).numpy())
