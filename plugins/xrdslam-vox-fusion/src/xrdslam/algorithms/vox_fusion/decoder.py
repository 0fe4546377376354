"""The network from a voxel's features to signed distance and colour."""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

__all__ = ["GEOMETRY", "Decoder", "DecoderWeights", "decode_color_torch", "decode_geometry_torch"]

GEOMETRY = 128
"""Numbers that the geometry hands to the colour."""


class DecoderWeights(NamedTuple):
    """Matrices (outputs x inputs) and biases: features -> w -> w -> distance and 128, and with these -> w -> colour."""

    first: Float[Tensor, "w f"]
    first_bias: Float[Tensor, " w"]
    second: Float[Tensor, "w w"]
    second_bias: Float[Tensor, " w"]
    head: Float[Tensor, "129 w"]
    """Row 0 gives the signed distance, the others what the colour is made of."""
    head_bias: Float[Tensor, " 129"]
    tint: Float[Tensor, "w g"]
    """Of [geometry | features]."""
    tint_bias: Float[Tensor, " w"]
    color: Float[Tensor, "3 w"]
    color_bias: Float[Tensor, " 3"]


class Decoder(nn.Module):
    """The parameters; each layer begins uniform within 1 / sqrt(inputs), as published."""

    def __init__(self, features: int, width: int, generator: torch.Generator) -> None:
        super().__init__()
        shapes = {
            "first": (width, features),
            "second": (width, width),
            "head": (1 + GEOMETRY, width),
            "tint": (width, GEOMETRY + features),
            "color": (3, width),
        }
        for name, (outputs, inputs) in shapes.items():
            bound = 1 / math.sqrt(inputs)
            weight, bias = torch.rand(outputs, inputs, generator=generator), torch.rand(outputs, generator=generator)
            self.register_parameter(name, nn.Parameter((weight * 2 - 1) * bound))
            self.register_parameter(f"{name}_bias", nn.Parameter((bias * 2 - 1) * bound))

    @property
    def weights(self) -> DecoderWeights:
        """All parameters, in the order that the field takes."""
        return DecoderWeights(*(self.get_parameter(name) for name in DecoderWeights._fields))


def decode_geometry_torch(features: Tensor, weights: DecoderWeights) -> Float[Tensor, "n 129"]:
    """Return signed distance [truncations] and geometry features."""
    first = (features @ weights.first.mT + weights.first_bias).relu()
    second = (first @ weights.second.mT + weights.second_bias).relu()
    return second @ weights.head.mT + weights.head_bias


def decode_color_torch(geometry: Tensor, features: Tensor, weights: DecoderWeights) -> Float[Tensor, "n 3"]:
    """Return colour in [0, 1]; `geometry` without its distance."""
    tint = (torch.cat((geometry, features), 1) @ weights.tint.mT + weights.tint_bias).relu()
    return torch.sigmoid(tint @ weights.color.mT + weights.color_bias)
