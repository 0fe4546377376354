"""Where the camera was, seen along the axis on which its path is shortest: estimate against ground truth."""

import json
import math

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from xrdslam.evaluation.errors import EvaluationError
from xrdslam.evaluation.trajectory import TrajectoryError, absolute_trajectory_error
from xrdslam.pictures.palette import ERROR, coloured, hexadecimal
from xrdslam.report.charts import Chart, Series, line_chart, number
from xrdslam.report.run_files import RunFiles

__all__ = ["error_chart", "error_of", "path_figure"]

MOST_SEGMENTS = 700
Points = Float64[NDArray[np.float64], "n 2"]


def error_of(run: RunFiles, estimate: str = "final") -> TrajectoryError | None:
    """Return the absolute error of a run's trajectory, None where there is nothing to compare it with."""
    if run.ground_truth is None:
        return None
    try:
        return absolute_trajectory_error(getattr(run, estimate), run.ground_truth, "se3")
    except EvaluationError:
        return None


def path_figure(run: RunFiles) -> str:
    """Return the path from above as SVG: ground truth grey, estimate (aligned) coloured by its error."""
    error = error_of(run)
    centres = run.final[:, :3, 3] if error is None else error.alignment.apply(run.final[:, :3, 3])
    truth = None if error is None or run.ground_truth is None else run.ground_truth[:, :3, 3]
    axes = _widest(centres)
    path = centres[:, axes]
    known = np.concatenate([path, truth[:, axes]] if truth is not None else [path])
    known = known[np.isfinite(known).all(1)]
    if not len(known):
        return '<p class="none">No pose was found.</p>'
    low, high = known.min(0), known.max(0)
    margin = 0.07 * max(*(high - low), 1e-3)
    low, size = low - margin, np.maximum(high - low + 2 * margin, 0.3 * max(high - low + 2 * margin))
    drawn = [] if truth is None else [f'<path class="truth" d="{_polyline(truth[:, axes])}"/>']
    worst = 0.0 if error is None else float(np.nanmax(error.errors_cm))
    drawn += _segments(path, None if error is None else error.errors_cm, worst)
    first = path[np.isfinite(path).all(1)][0]
    r = 0.012 * max(size)
    drawn += [f'<circle class="lostpoint" cx="{x:.4f}" cy="{y:.4f}" r="{r:.4f}"/>' for x, y in path[run.is_lost]]
    drawn.append(f'<circle class="start" cx="{first[0]:.4f}" cy="{first[1]:.4f}" r="{1.4 * r:.4f}"/>')
    drawn.append(f'<circle class="here" cx="{first[0]:.4f}" cy="{first[1]:.4f}" r="{1.6 * r:.4f}"/>')
    bar = _nice(size[0] / 4)
    places = json.dumps([[round(float(x), 4), round(float(y), 4)] if math.isfinite(x) else None for x, y in path])
    names = "xyz"
    return (
        f'<figure class="path" data-path=\'{places}\' data-indices="{json.dumps(run.indices)}">'
        f"<figcaption><b>Path of the camera</b> <small>{names[axes[0]]} to the right, {names[axes[1]]} down"
        f"</small>{_key(error, worst)}</figcaption>"
        f'<svg viewBox="{low[0]:.4f} {low[1]:.4f} {size[0]:.4f} {size[1]:.4f}" role="img" '
        f'aria-label="path of the camera">{"".join(drawn)}</svg>'
        f'<div class="scale"><i style="width:{100 * bar / size[0]:.1f}%"></i>{number(bar)} m</div></figure>'
    )


def error_chart(run: RunFiles) -> str:
    """Return the error over the frames, final and as first reported."""
    final, online = error_of(run), error_of(run, "online")
    if final is None:
        return ""
    series = [Series("final", final.errors_cm, "var(--accent)", is_area=True)]
    if online is not None and not np.array_equal(online.errors_cm, final.errors_cm, equal_nan=True):
        series.insert(0, Series("online", online.errors_cm, "var(--second)"))
    return line_chart(
        Chart(
            "Error of the trajectory",
            "cm",
            np.asarray(run.indices, dtype=np.float64),
            series,
            lines=[("RMSE", final.rmse_cm)],
            marks=[float(index) for index in run.keyframes],
            bands=[float(index) for index in run.lost],
        )
    )


def _segments(path: Points, errors: NDArray[np.float64] | None, worst: float) -> list[str]:
    """Return stretches of one colour each: that of the largest error in them."""
    if errors is None:
        return [f'<path class="estimate" stroke="var(--accent)" d="{_polyline(path)}"/>']
    stretches = np.array_split(np.arange(len(path)), min(MOST_SEGMENTS, max(1, len(path) - 1)))
    drawn = []
    for stretch in stretches:
        rows = np.append(stretch, min(stretch[-1] + 1, len(path) - 1))
        error = errors[rows]
        finite = error[np.isfinite(error)]
        colour = coloured(np.array([finite.max() if len(finite) else np.nan]), ERROR, 0.0, max(worst, 1e-9))[0]
        drawn.append(f'<path class="estimate" stroke="{hexadecimal(colour)}" d="{_polyline(path[rows])}"/>')
    return drawn


def _polyline(path: Points) -> str:
    text, is_down = [], False
    for x, y in path:
        if math.isfinite(x) and math.isfinite(y):
            text.append(f"{'L' if is_down else 'M'}{x:.4f} {y:.4f}")
        is_down = bool(math.isfinite(x) and math.isfinite(y))
    return "".join(text)


def _key(error: TrajectoryError | None, worst: float) -> str:
    if error is None:
        return '<span class="legend"><span><i style="background:var(--accent)"></i>estimate, not compared</span></span>'
    stops = ",".join(hexadecimal(np.array(colour, np.uint8)) for colour in ERROR)
    return (
        '<span class="legend"><span><i style="background:var(--truth);height:5px"></i>ground truth</span>'
        f'<span>0<i class="ramp" style="background:linear-gradient(90deg,{stops})"></i>{number(worst)} cm</span></span>'
    )


def _widest(centres: Float64[NDArray[np.float64], "n 3"]) -> list[int]:
    """Return the two axes along which the path is longest, the longer to the right."""
    finite = centres[np.isfinite(centres).all(1)]
    extent = np.ptp(finite, axis=0) if len(finite) else np.ones(3)
    return [int(axis) for axis in np.argsort(-extent, kind="stable")[:2]]


def _nice(length: float) -> float:
    power = 10.0 ** math.floor(math.log10(max(length, 1e-6)))
    return max(power * m for m in (1, 2, 5) if power * m <= max(length, 1e-6) * (1 + 1e-9))
