"""Charts as HTML with inline SVG: lines stretch with the page, text keeps its size on a phone."""

import html
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

__all__ = ["Chart", "Series", "line_chart", "number", "thinned"]

Values = Float64[NDArray[np.float64], " n"]
Scale = Callable[[float], float]
MOST_POINTS = 800
"""More than a screen shows would only make the file large."""


@dataclass(frozen=True, eq=False)
class Series:
    """A line of a chart."""

    name: str
    values: Values
    """NaN is a gap."""
    colour: str = "var(--accent)"
    is_area: bool = False


@dataclass(frozen=True, eq=False)
class Chart:
    """Lines over a common abscissa."""

    title: str
    unit: str
    x: Values
    series: Sequence[Series]
    x_label: str = "frame"
    lines: Sequence[tuple[str, float]] = ()
    """Horizontal lines with their names."""
    marks: Sequence[float] = field(default_factory=list)
    """Abscissas of ticks at the bottom (keyframes)."""
    bands: Sequence[float] = field(default_factory=list)
    """Abscissas that are shaded (lost frames)."""
    from_zero: bool = True


def line_chart(chart: Chart) -> str:
    """Return a figure: title, legend, plot, axes."""
    values = np.concatenate([s.values for s in chart.series] or [np.zeros(0)])
    finite = values[np.isfinite(values)]
    lowest, highest = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    ticks = _ticks(0.0 if chart.from_zero else lowest, highest)
    bottom, top = ticks[0], ticks[-1]
    first, last = (float(chart.x[0]), float(chart.x[-1])) if len(chart.x) else (0.0, 1.0)
    span = max(last - first, 1e-9)

    def across(x: float) -> float:
        return 1000 * (x - first) / span

    def down(y: float) -> float:
        return 300 * (top - y) / (top - bottom)

    drawn = [*(_band(across(x), 1000 / span) for x in chart.bands)]
    drawn += [f'<path class="grid" d="M0 {down(t):.1f}H1000"/>' for t in ticks]
    for series in chart.series:
        drawn.append(_line(series, *thinned(chart.x, series.values), across, down))
    drawn += [f'<path class="level" d="M0 {down(y):.1f}H1000"/>' for _, y in chart.lines if bottom <= y <= top]
    drawn += [f'<path class="mark" d="M{across(x):.1f} 300v-9"/>' for x in chart.marks]
    y_labels = "".join(f'<span style="top:{down(t) / 3:.2f}%">{number(t)}</span>' for t in ticks)
    x_ticks = [t for t in _ticks_between(first, last)]
    x_labels = "".join(f'<span style="left:{across(t) / 10:.2f}%">{number(t)}</span>' for t in x_ticks)
    return (
        f'<figure class="chart" data-chart="{html.escape(_data(chart))}">'
        f"<figcaption><b>{html.escape(chart.title)}</b> <small>{html.escape(chart.unit)}</small>"
        f'<span class="legend">{_legend(chart)}</span><output></output></figcaption>'
        f'<div class="plot"><div class="ys">{y_labels}</div><svg viewBox="0 0 1000 300" preserveAspectRatio="none" '
        f'role="img" aria-label="{html.escape(chart.title)}">{"".join(drawn)}</svg><i class="cursor"></i>'
        f'<div class="xs">{x_labels}<em>{html.escape(chart.x_label)}</em></div></div></figure>'
    )


def thinned(x: Values, y: Values, most: int = MOST_POINTS) -> tuple[Values, Values]:
    """Return fewer points that look the same: of each stretch its lowest and its highest."""
    if len(x) <= most:
        return x, y
    kept = set()
    for stretch in np.array_split(np.arange(len(x)), most // 2):
        known = stretch[np.isfinite(y[stretch])]
        if len(known) < len(stretch):
            kept.add(int(stretch[~np.isfinite(y[stretch])][0]))  # a gap stays a gap
        if len(known):
            kept |= {int(known[np.argmin(y[known])]), int(known[np.argmax(y[known])])}
    chosen = np.array(sorted(kept))
    return x[chosen], y[chosen]


def number(value: float | None) -> str:
    """Return three significant digits without an exponent."""
    if value is None or not math.isfinite(value):
        return "n/a"
    if value == 0:
        return "0"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    text = f"{value:,.{min(digits, 6)}f}"
    return (text.rstrip("0").rstrip(".") if "." in text else text).replace(",", "\u202f")


def _line(series: Series, x: Values, y: Values, across: Scale, down: Scale) -> str:
    pieces: list[list[str]] = [[]]
    for a, b in zip(x, y, strict=True):
        if math.isfinite(b):
            pieces[-1].append(f"{across(a):.1f} {down(b):.1f}")
        elif pieces[-1]:
            pieces.append([])
    whole = [piece for piece in pieces if piece]
    path = "".join("M" + "L".join(piece if len(piece) > 1 else piece * 2) for piece in whole)
    area = ""
    if series.is_area:
        filled = "".join(f"M{p[0].split()[0]} 300L{'L'.join(p)}L{p[-1].split()[0]} 300Z" for p in whole if len(p) > 1)
        area = f'<path class="area" fill="{series.colour}" d="{filled}"/>'
    return f'{area}<path class="line" stroke="{series.colour}" d="{path}"/>'


def _band(x: float, width: float) -> str:
    return f'<rect class="lost" x="{x - width / 2:.1f}" y="0" width="{max(width, 2):.1f}" height="300"/>'


def _legend(chart: Chart) -> str:
    names = [(s.name, f"background:{s.colour}") for s in chart.series if len(chart.series) > 1]
    names += [(f"{name} {number(y)}", "border-top:2px dashed var(--ink);height:0") for name, y in chart.lines]
    names += [("keyframe", "background:var(--ink);width:2px")] if len(chart.marks) else []
    names += [("lost", "background:var(--bad)")] if len(chart.bands) else []
    return "".join(f'<span><i style="{style}"></i>{html.escape(name)}</span>' for name, style in names)


def _data(chart: Chart) -> str:
    """Return what the page's script shows under a finger."""
    step = max(1, math.ceil(len(chart.x) / MOST_POINTS))

    def rounded(values: Values) -> list[float | None]:
        return [float(f"{v:.4g}") if math.isfinite(v) else None for v in values[::step]]

    series = [{"name": s.name, "y": rounded(s.values)} for s in chart.series]
    return json.dumps({"x": rounded(chart.x), "series": series, "unit": chart.unit, "label": chart.x_label})


def _ticks(lowest: float, highest: float) -> list[float]:
    """Return round numbers from at most the lowest to at least the highest."""
    step = _step(max(highest - lowest, 1e-3 * abs(highest), 1e-9) / 4)
    first = math.floor(lowest / step + 1e-9)
    return [step * i for i in range(first, max(math.ceil(highest / step - 1e-9), first + 1) + 1)]


def _ticks_between(first: float, last: float) -> list[float]:
    if last <= first:
        return [first]
    step = max(1.0, _step((last - first) / 5))
    return [t for t in np.arange(math.ceil(first / step) * step, last + 1e-9, step).tolist()]


def _step(least: float) -> float:
    """Return the next 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(power * m for m in (1, 2, 5, 10) if power * m >= least * (1 - 1e-9))
