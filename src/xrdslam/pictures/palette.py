"""Colours of numbers, chosen to be told apart on white and on black."""

import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray

__all__ = ["DEPTH", "ERROR", "Palette", "coloured", "hexadecimal"]

Palette = tuple[tuple[int, int, int], ...]
"""Evenly spaced colours (sRGB), joined by straight lines."""

ERROR: Palette = ((24, 138, 141), (92, 184, 132), (236, 196, 88), (236, 124, 66), (200, 46, 58))
"""Good to bad."""
DEPTH: Palette = ((50, 28, 96), (44, 94, 140), (40, 150, 136), (122, 200, 96), (246, 226, 92))
"""Near to far."""
MISSING = (112, 116, 124)
"""Where there is no number."""


def coloured(
    values: Float[NDArray[np.floating], "*n"], palette: Palette, low: float, high: float
) -> UInt8[np.ndarray, "*n 3"]:
    """Return the colour of each number; those outside [low, high] take the end's, NaN takes grey."""
    stops = np.asarray(palette, dtype=np.float64)
    known = np.isfinite(values)
    share = np.clip((np.where(known, values, low) - low) / max(high - low, 1e-12), 0.0, 1.0) * (len(stops) - 1)
    below = np.minimum(share.astype(np.int64), len(stops) - 2)
    part = (share - below)[..., None]
    mixed = stops[below] * (1 - part) + stops[below + 1] * part
    mixed[~known] = MISSING
    rounded: np.ndarray = np.rint(mixed).astype(np.uint8)
    return rounded


def hexadecimal(colour: UInt8[np.ndarray, "3"]) -> str:
    """Return `#rrggbb`."""
    return "#" + "".join(f"{int(channel):02x}" for channel in colour)
