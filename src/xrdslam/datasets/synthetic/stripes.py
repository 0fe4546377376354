"""The box filter of a thin line: what every drawn edge of the textures is made of."""

from xrdslam.datasets.synthetic.compiled import compiled

__all__ = ["line"]


@compiled
def line(distance: float, thickness: float, w: float) -> float:
    """Return the share of a pixel `w` wide that a line covers, `distance` from its middle: two boxes convolved."""
    w = max(w, 1e-6)
    return min(max(0.5 * (thickness + w) - abs(distance), 0.0), min(thickness, w)) / w
