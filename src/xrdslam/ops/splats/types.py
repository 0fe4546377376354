"""What a splat renderer takes and gives, and the thresholds that twin and kernel share."""

import math
from typing import NamedTuple, Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

__all__ = ["ALPHA_MAX", "ALPHA_MIN", "FRUSTUM_CLAMP", "TRANSMITTANCE_MIN", "Pinhole", "PinholeLike", "SplatRender"]

ALPHA_MIN = 1 / 255
"""A Gaussian is not blended where its alpha is below this."""
ALPHA_MAX = 0.99
"""Alpha is clamped here; the gradient through the clamp is exact, that is zero."""
TRANSMITTANCE_MIN = 1e-4
"""A Gaussian that would take a pixel's transmittance below this is not blended there, nor is anything behind it."""
FRUSTUM_CLAMP = 1.3
"""The perspective shear uses x/z clamped to this many half fields of view; a clamped x/z is a constant to gradients."""
FOOTPRINT_MAX_SQ = 2 * math.log(255)
"""Squared Mahalanobis radius at which alpha reaches `ALPHA_MIN` when the opacity is 1: no footprint is larger."""


@runtime_checkable
class PinholeLike(Protocol):
    """Anything with a pinhole camera's numbers, `xrdslam.core.camera.Camera` for one."""

    @property
    def fx(self) -> float: ...
    @property
    def fy(self) -> float: ...
    @property
    def cx(self) -> float: ...
    @property
    def cy(self) -> float: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...


class Pinhole(NamedTuple):
    """A pinhole camera [px]; pixel (0, 0) is a centre, u = fx x/z + cx."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int


class SplatRender(NamedTuple):
    """A rendered view over a black background."""

    rgb: Float[Tensor, "h w 3"]
    """Sum of colour * alpha * T."""
    depth: Float[Tensor, "h w"]
    """Sum of z * alpha * T [m]: not divided by the opacity."""
    opacity: Float[Tensor, "h w"]
    """Sum of alpha * T, the silhouette."""
