"""A textured box room with balls in it, in closed form: where a ray ends and what colour is there."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["BALLS", "NUM_WAVES", "PAINT", "WALLS", "colour", "distance_to_balls", "distance_to_walls"]

WALLS = torch.tensor([[-2.0, -1.3, -2.5], [2.0, 1.3, 2.5]], dtype=torch.float64)
"""The corners (min, max) of the room [m]; y points down."""
BALLS = torch.tensor([[0.6, 0.6, 1.2, 0.45], [-0.9, 0.4, 1.5, 0.5]], dtype=torch.float64)
"""Centre and radius [m] of each ball."""
NUM_WAVES = 8
_GENERATOR = torch.Generator().manual_seed(7)
_DIRECTIONS = torch.randn(NUM_WAVES, 3, dtype=torch.float64, generator=_GENERATOR)
_WAVELENGTHS = torch.linspace(2.4, 0.5, NUM_WAVES, dtype=torch.float64)  # [m]
_WAVE_VECTORS = 2 * math.pi * _DIRECTIONS / _DIRECTIONS.norm(dim=-1, keepdim=True) / _WAVELENGTHS[:, None]
_PHASES = 2 * math.pi * torch.rand(NUM_WAVES, dtype=torch.float64, generator=_GENERATOR)
PAINT = torch.randn(NUM_WAVES, 3, dtype=torch.float64, generator=_GENERATOR)
"""The amplitude of each wave in each channel; they add up to 0.45 a channel, so that colours stay in [0.05, 0.95]."""
PAINT *= 0.45 / PAINT.abs().sum(0)


def colour(points_world: Float[Tensor, "*batch 3"], amplitudes: Float[Tensor, "m 3"]) -> Float[Tensor, "*batch 3"]:
    """Return 1/2 + sum_j a_j sin(k_j x + phase_j) over the first m waves."""
    num_waves = len(amplitudes)
    phases = points_world @ _WAVE_VECTORS[:num_waves].T.to(points_world) + _PHASES[:num_waves].to(points_world)
    painted: Tensor = 0.5 + phases.sin() @ amplitudes
    return painted


def distance_to_walls(
    origins: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"], walls: Float[Tensor, "2 3"]
) -> Float[Tensor, " n"]:
    """Return the t at which o + t d leaves the box, in units of |d|; negative where the ray has left it already."""
    safe = torch.where(directions.abs() < 1e-9, torch.full_like(directions, 1e-9), directions)
    return torch.maximum((walls[0] - origins) / safe, (walls[1] - origins) / safe).amin(-1)


def distance_to_balls(
    origins: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"], balls: Float[Tensor, "k 4"]
) -> Float[Tensor, " n"]:
    """Return the smallest t > 0 at which o + t d meets a ball, inf where it meets none.

    |o + t d - c|^2 = r^2 is a t^2 + 2 b t + c = 0 with a = d d, b = d (o - c), c = |o - c|^2 - r^2.
    """
    offset = origins[:, None] - balls[:, :3]
    a = (directions * directions).sum(-1)[:, None]
    b = (directions[:, None] * offset).sum(-1)
    discriminant = b * b - a * ((offset * offset).sum(-1) - balls[:, 3] ** 2)
    t = (-b - discriminant.clamp(min=0).sqrt()) / a
    hit = (discriminant > 0) & (t > 0)
    infinity = torch.full((len(origins), 1), torch.inf, dtype=t.dtype, device=t.device)  # so that no balls are fine
    return torch.cat((torch.where(hit, t, infinity), infinity), -1).amin(-1)
