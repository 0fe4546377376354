"""Teach the geometry decoders on random rooms: `python -m xrdslam.algorithms.nice_slam.pretrain`.

Auto-decoding: the features of each room's grids are free variables beside the shared decoders. What the decoders have
learned is then held to rooms that they have not seen, where only features may move.
"""

import argparse
import logging
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from safetensors.torch import save_file
from torch import Tensor, nn

from xrdslam.algorithms.nice_slam.rooms import Room, random_room
from xrdslam.core.files import replaced
from xrdslam.ops.dense_grid import DenseGridLayout, dense_grid
from xrdslam.ops.feature_decoder import FeatureDecoder

__all__ = ["Lesson", "Teaching", "main", "wrong_share"]

log = logging.getLogger(__name__)

CHANNELS = 32
SCALE = 10.0
"""Occupancy is the sigmoid of so many times a decoder's output, as the renderer takes it."""
BAND_M = 0.12
NEAR = 0.8
"""Share of the points within the band about a surface (voxels of 0.16 and 0.32 m; half of it for half the voxels)."""
UNKNOWN_LOGIT = -0.3
"""What featureless space is held to: an occupancy of 5 %, transparent but not out of the reach of gradients."""


class Lesson:
    """A room, points in it, and the features that are learned for it."""

    def __init__(self, room: Room, voxel_m: float, generator: torch.Generator, num_points: int = 120_000) -> None:
        band = BAND_M * voxel_m / 0.32
        self.points, self.distance = room.points(num_points, NEAR, band, generator)
        bounds = room.bounds(voxel_m)
        self.layouts = [DenseGridLayout.covering(bounds, v) for v in (voxel_m, voxel_m / 2)]
        deviations = (1e-2, 1e-4)
        self.tables = [
            nn.Parameter(deviation * torch.randn(layout.num_rows, CHANNELS, generator=generator))
            for layout, deviation in zip(self.layouts, deviations, strict=True)
        ]

    def features(self, points: Float[Tensor, "n 3"]) -> tuple[Tensor, Tensor]:
        """Return the middle level's features and [fine, middle] of points."""
        middle, fine = (dense_grid(points, t, grid) for t, grid in zip(self.tables, self.layouts, strict=True))
        return middle, torch.cat((fine, middle.detach()), 1)


class Teaching(NamedTuple):
    """How much is taught; the defaults are what the shipped decoders had."""

    generations: int = 20
    """Sets of rooms, one after the other."""
    rooms: int = 8
    steps: int = 150
    points: int = 3000
    """Of each room in a step."""
    lr_decoder: float = 2e-3
    lr_grid: float = 2e-2


def lessons(count: int, generator: torch.Generator) -> list[Lesson]:
    """Draw rooms; each third one is half as large, with voxels half as large."""
    scales = [0.5 if i % 3 == 2 else 1.0 for i in range(count)]
    return [Lesson(random_room(generator, scale), 0.32 * scale, generator) for scale in scales]


def descend(
    lessons: list[Lesson],
    decoders: tuple[FeatureDecoder, FeatureDecoder],
    teaching: Teaching,
    generator: torch.Generator,
    optimiser: torch.optim.Optimizer | None,
    rate: float,
) -> float:
    """Optimise features, and the decoders where they have an optimiser; return the last loss."""
    tables = torch.optim.Adam([t for lesson in lessons for t in lesson.tables], teaching.lr_grid)
    loss = torch.zeros(())
    for _ in range(teaching.steps):
        tables.zero_grad()
        if optimiser is not None:
            optimiser.zero_grad()
            for group in optimiser.param_groups:
                group["lr"] = rate * teaching.lr_decoder
        drawn = [torch.randint(len(le.points), (teaching.points,), generator=generator) for le in lessons]
        points = torch.cat([le.points[d] for le, d in zip(lessons, drawn, strict=True)])
        solid = torch.cat([(le.distance[d] < 0).float() for le, d in zip(lessons, drawn, strict=True)])
        features = [le.features(le.points[d]) for le, d in zip(lessons, drawn, strict=True)]
        middle = decoders[0](points, torch.cat([f[0] for f in features]))[:, 0]
        fine = decoders[1](points, torch.cat([f[1] for f in features]))[:, 0]
        bce = nn.functional.binary_cross_entropy_with_logits
        loss = bce(SCALE * middle, solid) + bce(SCALE * (middle + fine), solid)
        total = loss
        if optimiser is not None:
            total = total + 0.3 * _of_the_unknown(points[::8], decoders, generator)
        total.backward()  # type: ignore[no-untyped-call]  # torch leaves it untyped
        tables.step()
        if optimiser is not None:
            optimiser.step()
    return float(loss.detach())


def _of_the_unknown(
    points: Float[Tensor, "n 3"], decoders: tuple[FeatureDecoder, FeatureDecoder], generator: torch.Generator
) -> Tensor:
    """Hold the decoders to transparent space where features are as they begin, and the fine one to nothing to add."""
    noise = 1e-2 * torch.randn(len(points), 2 * CHANNELS, generator=generator)
    middle = decoders[0](points, noise[:, CHANNELS:])
    fine = decoders[1](points, noise * torch.cat((torch.full((CHANNELS,), 1e-2), torch.ones(CHANNELS))))
    off: Tensor = (middle - UNKNOWN_LOGIT).square().mean() + fine.square().mean()
    return SCALE * off


@torch.no_grad()
def wrong_share(lessons: list[Lesson], decoders: tuple[FeatureDecoder, FeatureDecoder]) -> tuple[float, float]:
    """Return the share of points whose occupancy is on the wrong side of 1/2: by the middle level, by both."""
    wrong = torch.zeros(2)
    for lesson in lessons:
        middle, both = lesson.features(lesson.points)
        coarse = decoders[0](lesson.points, middle)[:, 0]
        logits = torch.stack((coarse, coarse + decoders[1](lesson.points, both)[:, 0]))
        wrong += ((logits > 0) != (lesson.distance < 0)).float().mean(1)
    first, second = (wrong / len(lessons)).tolist()
    return first, second


def held_out(
    decoders: tuple[FeatureDecoder, FeatureDecoder], teaching: Teaching, generator: torch.Generator
) -> tuple[float, float]:
    """Fit features alone to half of the points of new rooms; return the wrong shares of the other half."""
    unseen = lessons(teaching.rooms, generator)
    for parameter in (p for decoder in decoders for p in decoder.parameters()):
        parameter.requires_grad_(False)
    kept = [(lesson.points[::2], lesson.distance[::2]) for lesson in unseen]
    for lesson in unseen:
        lesson.points, lesson.distance = lesson.points[1::2], lesson.distance[1::2]
    descend(unseen, decoders, teaching, generator, None, 1.0)
    for lesson, (points, distance) in zip(unseen, kept, strict=True):
        lesson.points, lesson.distance = points, distance
    return wrong_share(unseen, decoders)


def teach(teaching: Teaching, seed: int) -> tuple[FeatureDecoder, FeatureDecoder]:
    """Teach a middle and a fine decoder."""
    generator = torch.Generator().manual_seed(seed)
    decoders = FeatureDecoder(CHANNELS, 1, generator), FeatureDecoder(2 * CHANNELS, 1, generator)
    optimiser = torch.optim.Adam([p for decoder in decoders for p in decoder.parameters()], teaching.lr_decoder)
    for generation in range(teaching.generations):
        taught = lessons(teaching.rooms, generator)
        rate = 0.5 * (1 + torch.cos(torch.tensor(torch.pi * generation / teaching.generations)).item()) + 0.02
        loss = descend(taught, decoders, teaching, generator, optimiser, rate)
        first, second = wrong_share(taught, decoders)
        log.info(
            "rooms %d/%d: loss %.4f, wrong %.2f %% (middle) %.2f %% (with fine), deviation of middle features %.3f",
            generation + 1,
            teaching.generations,
            loss,
            100 * first,
            100 * second,
            float(torch.cat([lesson.tables[0].detach() for lesson in taught]).std()),
        )
    return decoders


def main(arguments: list[str] | None = None) -> None:
    """Teach, write, and say how well unseen rooms are told."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--generations", type=int, default=Teaching._field_defaults["generations"])
    parser.add_argument("--steps", type=int, default=Teaching._field_defaults["steps"])
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "weights" / "decoders.safetensors")
    chosen = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    teaching = Teaching(generations=chosen.generations, steps=chosen.steps)
    middle, fine = teach(teaching, chosen.seed)
    first, second = held_out((middle, fine), teaching, torch.Generator().manual_seed(chosen.seed + 1))
    log.info("held-out rooms: wrong occupancy %.2f %% (middle), %.2f %% (with fine)", 100 * first, 100 * second)
    named = {f"middle.{k}": v for k, v in middle.state_dict().items()}
    named |= {f"fine.{k}": v for k, v in fine.state_dict().items()}
    with replaced(chosen.output) as path:
        save_file({k: v.contiguous() for k, v in named.items()}, path)
    log.info("written: %s", chosen.output)


if __name__ == "__main__":
    main()
