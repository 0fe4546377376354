"""Maps whose field is known: corner values of the signed distance, handed through by the decoder."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from xrdslam.algorithms.vox_fusion.config import VoxFusionMapConfig
from xrdslam.algorithms.vox_fusion.model import VoxelMap

Ruled = Callable[[Callable[[Tensor], Tensor], Tensor], VoxelMap]


@pytest.fixture
def ruled() -> Ruled:
    """Return a maker of maps from a function of world points [m -> truncations] and points in their voxels.

    Feature 0 of a corner is the function's value there. relu(x) - relu(-x) = x goes through both hidden layers; with
    no other weights the colour is sigmoid(0) = 1/2 everywhere.
    """

    def make(function: Callable[[Tensor], Tensor], points: Tensor) -> VoxelMap:
        model = VoxelMap(VoxFusionMapConfig(width=8, rows=8000))
        model.grid.insert(points)
        model.coords = model.grid.coords.clone()
        with torch.no_grad():
            for parameter in model.parameters():
                parameter.zero_()
            model.table[: model.grid.num_vertices, 0] = function(model.grid.vertices * model.grid.voxel_m)
            model.decoder.first[:2, 0] = torch.tensor([1.0, -1.0])
            model.decoder.second[:2, :2] = torch.eye(2)
            model.decoder.head[0, :2] = torch.tensor([1.0, -1.0])
        return model

    return make
