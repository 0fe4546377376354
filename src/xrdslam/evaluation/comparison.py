"""A rendering beside its photograph: colour and depth, measured, rendered and how far apart."""

from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float32
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

__all__ = ["side_by_side"]

Rgb = Float32[NDArray[np.float32], "h w 3"]
Depth = Float32[NDArray[np.float32], "h w"]

BACKGROUND, TEXT, MISSING = "#14161b", "#e8eaee", "#3a3f4a"
GAP, CAPTION, STRIP, MARGIN = 8, 40, 28, 12  # px
PANEL_WIDTHS = (320, 480)  # px: smaller images are enlarged, larger ones reduced
DPI = 100


@dataclass(frozen=True)
class _Scale:
    colours: str
    low: float
    high: float
    unit: str
    is_open_above: bool = False

    @property
    def colour_map(self) -> Colormap:
        return mpl.colormaps[self.colours].with_extremes(bad=MISSING)


@dataclass(frozen=True)
class _Panel:
    title: str
    values: NDArray[np.float32] | None
    scale: _Scale | None = None
    """None: the values are colours."""
    has_bar: bool = True


def side_by_side(
    rgb_input: Rgb,
    rgb_rendered: Rgb,
    depth_input: Depth | None,
    depth_rendered: Depth,
    caption: str = "",
    colour_error_max: float = 0.2,
    depth_error_max_cm: float = 10.0,
) -> Figure:
    """Draw input | rendering | error for colour, and below for depth [m], both depths in one colour scale.

    The colour error is the mean |difference| over channels. Error scales are fixed, so that pictures can be compared.
    Grey is where nothing was measured (or rendered); a missing rendering of a measured depth is an error in full.
    """
    colour_error = np.abs(rgb_rendered - rgb_input).mean(-1)
    depth_error_cm = _depth_error_cm(depth_input, depth_rendered)
    depth_scale = _Scale("viridis", *_depth_range(depth_rendered if depth_input is None else depth_input), " m")
    panels = [
        _Panel("input", rgb_input),
        _Panel("rendering", rgb_rendered),
        _Panel("colour error", colour_error, _Scale("magma", 0.0, colour_error_max, "", is_open_above=True)),
        _Panel("input depth", _known(depth_input), depth_scale),
        _Panel("rendered depth", _known(depth_rendered), depth_scale, has_bar=depth_input is None),
        _Panel("depth error", depth_error_cm, _Scale("magma", 0.0, depth_error_max_cm, " cm", is_open_above=True)),
    ]
    height, width = rgb_input.shape[:2]
    panel_width = int(np.clip(width, *PANEL_WIDTHS))
    panel_height = max(round(panel_width * height / width), 1)
    total = (3 * panel_width + 2 * GAP + 2 * MARGIN, CAPTION + 2 * (STRIP + panel_height) + GAP + MARGIN)
    figure = Figure(figsize=(total[0] / DPI, total[1] / DPI), dpi=DPI, facecolor=BACKGROUND)
    middle = 1 - CAPTION / 2 / total[1]
    figure.text(MARGIN / total[0], middle, caption, color=TEXT, fontsize=12, va="center", weight="bold")
    for place, panel in enumerate(panels):
        row, column = divmod(place, 3)
        left = MARGIN + column * (panel_width + GAP)
        top = CAPTION + row * (STRIP + panel_height + GAP)
        _draw(figure, panel, total, (left, top, panel_width, panel_height))
    return figure


def _draw(figure: Figure, panel: _Panel, total: tuple[int, int], box: tuple[int, int, int, int]) -> None:
    """Draw a strip with title and colour bar, under it the image; `box` is left, top, width, height [px]."""
    left, top, width, height = box
    axes = figure.add_axes(_fraction(total, left, top + STRIP, width, height))
    axes.set_axis_off()
    middle = 1 - (top + STRIP / 2) / total[1]
    figure.text(left / total[0], middle, panel.title, color=TEXT, fontsize=10, va="center")
    if panel.values is None:
        axes.text(0.5, 0.5, "none", color=TEXT, ha="center", va="center", fontsize=10, transform=axes.transAxes)
        return
    if panel.scale is None:
        axes.imshow(_displayable(panel.values), interpolation="antialiased", aspect="auto")
        return
    scale, values = panel.scale, np.ma.masked_invalid(panel.values)
    axes.imshow(values, cmap=scale.colour_map, vmin=scale.low, vmax=scale.high, interpolation="nearest", aspect="auto")
    if panel.has_bar:
        _draw_bar(figure, scale, total, (left + width, top))


def _draw_bar(figure: Figure, scale: _Scale, total: tuple[int, int], corner: tuple[int, int]) -> None:
    """Draw low, bar, high into a strip, ending at its upper right `corner` [px]."""
    right, top = corner
    low, high = f"{round(scale.low, 2):g}", f"{'≥ ' * scale.is_open_above}{round(scale.high, 2):g}{scale.unit}"
    length, thickness = 90, 8
    bar_right = right - 7 * len(high) - 12
    axes = figure.add_axes(_fraction(total, bar_right - length, top + (STRIP - thickness) // 2, length, thickness))
    axes.set_axis_off()
    axes.imshow(np.linspace(0.0, 1.0, 256)[None], cmap=scale.colour_map, aspect="auto")
    middle = 1 - (top + STRIP / 2) / total[1]
    style: dict[str, Any] = {"color": TEXT, "fontsize": 9, "va": "center"}
    figure.text((bar_right - length - 6) / total[0], middle, low, ha="right", **style)
    figure.text(right / total[0], middle, high, ha="right", **style)


def _fraction(
    total: tuple[int, int], left: int, top: int, width: int, height: int
) -> tuple[float, float, float, float]:
    return left / total[0], 1 - (top + height) / total[1], width / total[0], height / total[1]


def _displayable(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.clip(np.nan_to_num(rgb, nan=0.0), 0.0, 1.0)


def _known(depth: Depth | None) -> Depth | None:
    return None if depth is None else np.where(depth > 0, depth, np.float32(np.nan))


def _depth_error_cm(measured: Depth | None, rendered: Depth) -> Depth | None:
    return None if measured is None else np.where(measured > 0, 100 * np.abs(rendered - measured), np.float32(np.nan))


def _depth_range(depth: Depth) -> tuple[float, float]:
    """Return the 1st and 99th percentile [m] of what is known, so that a few outliers leave the scene its colours."""
    known = depth[np.isfinite(depth) & (depth > 0)]
    if len(known) == 0:
        return 0.0, 1.0
    low, high = np.percentile(known, [1, 99])
    return float(low), float(max(high, low + 1e-3))
