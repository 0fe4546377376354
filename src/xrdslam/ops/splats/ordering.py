"""The order of Gaussians in memory: neighbours in space should be neighbours there."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

__all__ = ["morton_order"]

_BITS = 10


def morton_order(means: Float[Tensor, "n 3"]) -> Int[Tensor, " n"]:
    """Return the indices that sort points along a Z-order curve over their bounding box, 2^10 cells a side.

    A render reads the Gaussians of a tile together: out of spatial order nearly each is a cache miss. New Gaussians
    seeded in raster order are in good order already; re-sort when the map was densified many times.
    """
    if means.shape[0] == 0:
        return torch.zeros(0, dtype=torch.long, device=means.device)
    points = means.detach()
    low, high = points.amin(0), points.amax(0)
    cells = ((points - low) / (high - low).clamp(min=1e-12) * (2**_BITS - 1)).long()
    code = torch.zeros(means.shape[0], dtype=torch.long, device=means.device)
    for bit in range(_BITS):
        for axis in range(3):
            code |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return torch.argsort(code, stable=True)
