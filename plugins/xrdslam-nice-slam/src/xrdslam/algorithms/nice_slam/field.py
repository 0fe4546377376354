"""The field of NICE-SLAM: occupancy by a middle and a fine grid, colour by a third, each with its decoder."""

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from xrdslam.algorithms.nice_slam.config import NiceSlamMapConfig
from xrdslam.algorithms.nice_slam.decoders import geometry_decoders
from xrdslam.algorithms.nice_slam.grid import CHANNELS, FeatureGrid
from xrdslam.ops.feature_decoder import FeatureDecoder

__all__ = ["Level", "NiceField"]

Level = Literal["middle", "fine", "color"]
"""What takes part: the middle grid; the fine one too; colour too."""


class NiceField(nn.Module):
    """Grids and decoders; those of occupancy are pretrained and stay as they are."""

    def __init__(self, config: NiceSlamMapConfig, bounds: Float[Tensor, "2 3"], generator: torch.Generator) -> None:
        super().__init__()
        self.middle = FeatureGrid(bounds, config.voxel_middle_m, 1e-2, generator)
        self.fine = FeatureGrid(bounds, config.voxel_fine_m, 1e-4, generator)
        self.color = FeatureGrid(bounds, config.voxel_color_m, 1e-2, generator)
        decoders = geometry_decoders(config.decoders)
        self.middle_decoder, self.fine_decoder = decoders.middle, decoders.fine
        self.decoders_are_own = decoders.are_own
        self.color_decoder = FeatureDecoder(CHANNELS, 4, generator)

    @property
    def grids(self) -> tuple[FeatureGrid, FeatureGrid, FeatureGrid]:
        """Middle, fine, colour."""
        return self.middle, self.fine, self.color

    def logits(self, points_world: Float[Tensor, "n 3"], level: Level = "fine") -> Float[Tensor, " n"]:
        """Return middle(p), or middle(p) + fine(p); occupancy is the sigmoid of ten times that.

        The fine decoder reads the middle features too, which get no gradient from it.
        """
        middle = self.middle(points_world)
        logits: Tensor = self.middle_decoder(points_world, middle)[:, 0]
        if level == "middle":
            return logits
        both = torch.cat((self.fine(points_world), middle.detach()), 1)
        fine: Tensor = self.fine_decoder(points_world, both)[:, 0]
        return logits + fine

    def rgb(self, points_world: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Return colours, nominally in [0, 1]."""
        decoded: Tensor = self.color_decoder(points_world, self.color(points_world))
        return decoded[:, :3]
