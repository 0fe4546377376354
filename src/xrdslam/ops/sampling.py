"""Depths along rays at which a field is looked at."""

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["importance_depths", "jittered", "linear_depths", "merged"]


def linear_depths(near: Float[Tensor, " n"], far: Float[Tensor, " n"], count: int) -> Float[Tensor, "n count"]:
    """Return `count` depths a ray, evenly from `near` to `far`, both included."""
    shares = torch.linspace(0, 1, count, dtype=near.dtype, device=near.device)
    return near[:, None] + (far - near)[:, None] * shares


def merged(a: Float[Tensor, "n s"], b: Float[Tensor, "n t"]) -> Float[Tensor, "n u"]:
    """Return the depths of both, in order along each ray."""
    return torch.cat((a, b), 1).sort(1).values


def jittered(depths: Float[Tensor, "n s"], generator: torch.Generator) -> Float[Tensor, "n s"]:
    """Redraw each depth uniformly between the midpoints to its neighbours (stratified sampling, NeRF eq. 2).

    The first and the last have half an interval, up to themselves. Depths come in order and stay in order.
    """
    if depths.shape[1] < 2:
        return depths.clone()
    middles = (depths[:, 1:] + depths[:, :-1]) / 2
    lower = torch.cat((depths[:, :1], middles), 1)
    upper = torch.cat((middles, depths[:, -1:]), 1)
    noise = torch.rand(depths.shape, generator=generator, dtype=depths.dtype).to(depths.device)
    return lower + (upper - lower) * noise


def importance_depths(
    depths: Float[Tensor, "n s"], weights: Float[Tensor, "n s"], count: int, generator: torch.Generator | None = None
) -> Float[Tensor, "n count"]:
    """Draw depths where the weights are: the inverse of their piecewise linear distribution function (NeRF, 5.2).

    The weight of a sample is spread between the midpoints to its neighbours. Without a generator the draws are evenly
    spaced, in order. A ray without weight is sampled evenly.
    """
    middles = (depths[:, 1:] + depths[:, :-1]) / 2
    edges = torch.cat((depths[:, :1], middles, depths[:, -1:]), 1)
    density = weights.clamp(min=0) + 1e-6 * weights.clamp(min=0).amax(1, keepdim=True) + 1e-12
    share = density.cumsum(1)
    share = torch.cat((torch.zeros_like(share[:, :1]), share / share[:, -1:]), 1)
    if generator is None:
        drawn = (torch.arange(count, dtype=depths.dtype, device=depths.device) + 0.5) / count
        drawn = drawn.expand(len(depths), count).contiguous()
    else:
        drawn = torch.rand((len(depths), count), generator=generator, dtype=depths.dtype).to(depths.device)
        drawn = drawn.sort(1).values
    upper = torch.searchsorted(share.contiguous(), drawn, right=True).clamp(1, depths.shape[1])
    low, high = share.gather(1, upper - 1), share.gather(1, upper)
    left, right = edges.gather(1, upper - 1), edges.gather(1, upper)
    return left + (right - left) * ((drawn - low) / (high - low).clamp(min=1e-12)).clamp(0, 1)
