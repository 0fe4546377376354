"""Pictures of a trajectory: the path seen from above, its error over the frames.

Drawn with matplotlib's objects (no pyplot, no global state, no window).
"""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float64
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from xrdslam.core.files import replaced
from xrdslam.evaluation.trajectory import Poses, TrajectoryError

__all__ = ["trajectory_figure", "write_figure"]

INK, FAINT, TRUTH, LOST = "#1f2430", "#d5d8de", "#9aa1ad", "#c8443c"
ERROR_COLOURS = ListedColormap(mpl.colormaps["plasma"](np.linspace(0.0, 0.9, 256)))  # its yellow end is lost on white
WIDTH = 8.0  # inches
ALIGNMENTS = {"se3": "SE(3) alignment", "sim3": "Sim(3) alignment", "none": "no alignment"}
Centres = Float64[NDArray[np.float64], "n 3"]


def write_figure(figure: Figure, path: Path) -> None:
    """Write a PNG; its folder is made, an older file replaced at once."""
    with replaced(path) as temporary:
        figure.savefig(temporary, format="png")


def trajectory_figure(
    estimate: Poses,
    ground_truth: Poses | None = None,
    error: TrajectoryError | None = None,
    is_lost: NDArray[np.bool_] | None = None,
    title: str = "Trajectory",
) -> Figure:
    """Draw the camera's path from above, coloured by its error, and the error over the frames below.

    `error` is of this estimate against this ground truth; its alignment moves the estimate. Without it the path alone
    is drawn, coloured by frame.
    """
    centres = estimate[:, :3, 3] if error is None else error.alignment.apply(estimate[:, :3, 3])
    truth = None if ground_truth is None or error is None else ground_truth[:, :3, 3]
    lost = np.zeros(len(estimate), dtype=bool) if is_lost is None else is_lost
    axes_shown = _largest_extent(centres if truth is None else truth)
    height = _height(centres[:, axes_shown])
    below_height = 0.0 if error is None else 1.9
    figure = Figure(figsize=(WIDTH, height + below_height), dpi=130, layout="constrained", facecolor="white")
    if error is None:
        top = figure.add_subplot()
    else:
        top, below = figure.subplots(2, 1, height_ratios=[height, below_height])
        _draw_errors(below, error, lost)
    colours = np.arange(len(centres), dtype=np.float64) if error is None else error.errors_cm
    _draw_path(figure, top, centres, truth, axes_shown, colours, "frame" if error is None else "error [cm]")
    _mark_lost(top, centres[:, axes_shown], lost)
    top.set_title(_title(title, error, centres, int(lost.sum())), loc="left", fontsize=11, color=INK, pad=26)
    if top.get_legend_handles_labels()[0]:
        top.legend(loc="lower left", bbox_to_anchor=(-0.01, 0.99), ncols=3, frameon=False, fontsize=9)
    return figure


def _largest_extent(centres: Centres) -> list[int]:
    """Return the two axes along which the path is longest, in the order x, y, z."""
    finite = centres[np.isfinite(centres).all(1)]
    extent = np.ptp(finite, axis=0) if len(finite) else np.ones(3)
    return sorted(np.argsort(-extent, kind="stable")[:2].tolist())


def _height(path: Float64[NDArray[np.float64], "n 2"]) -> float:
    """Return inches that suit the shape of the path, so that neither a corridor nor a tower leaves the sheet empty."""
    finite = path[np.isfinite(path).all(1)]
    extent = np.ptp(finite, axis=0) if len(finite) else np.ones(2)
    return float(WIDTH * np.clip(extent[1] / max(extent[0], 1e-9), 0.35, 0.95) + 0.9)


def _draw_path(
    figure: Figure,
    axes: Axes,
    centres: Centres,
    truth: Centres | None,
    shown: list[int],
    colours: Float64[NDArray[np.float64], " n"],
    label: str,
) -> None:
    path = centres[:, shown]
    if truth is not None:
        axes.plot(*truth[:, shown].T, color=TRUTH, linewidth=3.5, alpha=0.8, label="ground truth", zorder=1)
    segments = np.stack([path[:-1], path[1:]], 1)
    # A segment has the colour of the frame it leads to; one with a missing end is not drawn, so gaps stay gaps.
    drawn = np.isfinite(segments).all((1, 2)) & np.isfinite(colours[1:])
    finite = colours[np.isfinite(colours)]
    scale = Normalize(0.0, max(float(finite.max()), 1e-6) if len(finite) else 1.0)
    lines = LineCollection(list(segments[drawn]), cmap=ERROR_COLOURS, norm=scale, linewidths=1.8, zorder=2)
    lines.set_capstyle("round")
    lines.set_array(colours[1:][drawn])
    axes.add_collection(lines)
    started = np.flatnonzero(np.isfinite(path).all(1))
    if len(started):
        ring: dict[str, Any] = {
            "markersize": 10,
            "markerfacecolor": "white",
            "markeredgecolor": INK,
            "markeredgewidth": 1.8,
        }
        axes.plot(*path[started[0]], "o", **ring, label="start", zorder=4)
    axes.autoscale_view()
    axes.margins(0.06)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(f"{'xyz'[shown[0]]} [m]")
    axes.set_ylabel(f"{'xyz'[shown[1]]} [m]")
    _quiet(axes)
    bar = figure.colorbar(lines, ax=axes, fraction=0.04, pad=0.015, aspect=32)
    bar.set_label(label)
    bar.outline.set_visible(False)


def _draw_errors(axes: Axes, error: TrajectoryError, lost: NDArray[np.bool_]) -> None:
    frames = np.arange(len(error.errors_cm))
    axes.fill_between(frames, error.errors_cm, color=TRUTH, alpha=0.25, linewidth=0)
    axes.plot(frames, error.errors_cm, color=INK, linewidth=1.1)
    axes.axhline(error.rmse_cm, color=INK, linewidth=1.0, linestyle=(0, (4, 3)))
    if lost.any():
        bands = [(frame - 0.5, 1.0) for frame in frames[lost].tolist()]
        axes.broken_barh(bands, (0, 1), transform=axes.get_xaxis_transform(), color=LOST, alpha=0.25, linewidth=0)
    statistics = f"RMSE {error.rmse_cm:.3g} (dashed) · mean {error.mean_cm:.3g} · median {error.median_cm:.3g}"
    axes.set_title(f"{statistics} · max {error.max_cm:.3g} cm", loc="right", fontsize=9, color=INK)
    axes.set_xlim(0, max(len(frames) - 1, 1))
    axes.set_ylim(bottom=0)
    axes.set_xlabel("frame")
    axes.set_ylabel("error [cm]")
    _quiet(axes)


def _mark_lost(axes: Axes, path: Float64[NDArray[np.float64], "n 2"], lost: NDArray[np.bool_]) -> None:
    if lost.any():
        axes.plot(*path[lost].T, ".", color=LOST, markersize=5, linestyle="none", label="lost", zorder=3)


def _quiet(axes: Axes) -> None:
    axes.grid(color=FAINT, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(color=FAINT, labelcolor=INK, labelsize=9)
    for name, spine in axes.spines.items():
        spine.set_visible(name in ("left", "bottom"))
        spine.set_color(FAINT)


def _title(title: str, error: TrajectoryError | None, centres: Centres, num_lost: int) -> str:
    parts = [title]
    if error is not None:
        of_all = "" if error.matched == len(centres) else f" of {len(centres)}"
        parts += [f"ATE RMSE {error.rmse_cm:.3g} cm", ALIGNMENTS[error.alignment_kind]]
        parts.append(f"{error.matched}{of_all} frames")
    else:
        parts += [f"{int(np.isfinite(centres).all(1).sum())} frames", "not compared with a ground truth"]
    return "  ·  ".join(parts + ([f"{num_lost} lost"] if num_lost else []))
