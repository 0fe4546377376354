"""Random furnished rooms as signed distances in closed form, to teach decoders what surfaces are like."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.core.geometry import so3

__all__ = ["Room", "random_room"]


class Room(NamedTuple):
    """A box room of boxes and balls, turned and moved into the world."""

    half: Float[Tensor, "3"]
    """Half the room's sides [m]."""
    boxes: Float[Tensor, "b 6"]
    """Centre and half sides [m], in the room."""
    turns: Float[Tensor, "b 3 3"]
    balls: Float[Tensor, "s 4"]
    """Centre and radius [m], in the room."""
    rotation: Float[Tensor, "3 3"]
    center_world: Float[Tensor, "3"]

    def distance(self, points_world: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Return the distance [m] to the nearest surface, negative inside of things and of walls.

        Exact on either side of the walls and outside of the things; where things meet, at most too small.
        """
        points = (points_world - self.center_world) @ self.rotation
        nearest = -_to_box(points, torch.zeros(3), self.half, torch.eye(3))
        for box, turn in zip(self.boxes, self.turns, strict=True):
            nearest = torch.minimum(nearest, _to_box(points, box[:3], box[3:], turn))
        for ball in self.balls:
            nearest = torch.minimum(nearest, (points - ball[:3]).norm(dim=1) - ball[3])
        return nearest

    def points(
        self, count: int, near: float, band_m: float, generator: torch.Generator
    ) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"]]:
        """Draw world points and their distances: the share `near` within `band_m` of a surface, the others anywhere.

        Anywhere is the room and `band_m` of its walls.
        """
        reach = self.half + band_m
        drawn = (torch.rand(20 * count, 3, generator=generator) * 2 - 1) * reach @ self.rotation.mT + self.center_world
        distance = self.distance(drawn)
        close = (distance.abs() < band_m).nonzero()[:, 0][: int(near * count)]
        chosen = torch.cat((close, torch.arange(count - len(close))))
        return drawn[chosen], distance[chosen]

    def bounds(self, margin_m: float) -> Float[Tensor, "2 3"]:
        """Return the world box (min, max) [m] about the room."""
        reach = (self.rotation.abs() @ self.half) + margin_m
        return torch.stack((self.center_world - reach, self.center_world + reach))


def random_room(generator: torch.Generator, scale: float = 1.0, reach_m: float = 8.0) -> Room:
    """Draw a room of 3 to 7 m by 2.2 to 3.5 m, times `scale`, its centre within `reach_m` of the world's origin."""

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(*shape, generator=generator)

    sides = torch.cat((uniform(3.0, 7.0, 2), uniform(2.2, 3.5, 1)))[torch.randperm(3, generator=generator)]
    half = scale * sides / 2
    count = int(torch.randint(5, 12, (1,), generator=generator))
    sizes = scale * torch.exp(uniform(-3.2, -0.4, count, 3))  # from 4 to 67 cm half a side: boards, legs and cupboards
    centers = uniform(-1.0, 1.0, count, 3) * half
    turns = so3.exp(uniform(-1.0, 1.0, count, 3) * (torch.rand(count, 1, generator=generator) < 0.6))
    balls = torch.cat((uniform(-1.0, 1.0, 4, 3) * half, scale * uniform(0.1, 0.5, 4, 1)), 1)
    upright = float(torch.rand((), generator=generator)) < 0.5
    rotation = torch.eye(3) if upright else so3.exp(uniform(-2.0, 2.0, 3))
    return Room(half, torch.cat((centers, sizes), 1), turns, balls, rotation, uniform(-reach_m, reach_m, 3))


def _to_box(points: Tensor, center: Tensor, half: Tensor, turn: Tensor) -> Tensor:
    beyond = ((points - center) @ turn).abs() - half
    distance: Tensor = beyond.clamp(min=0).norm(dim=1) + beyond.amax(1).clamp(max=0)
    return distance
