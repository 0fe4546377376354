"""A dense grid and its decoder as a mapping iteration asks them: 1000 rays of 32 samples in a room of 8 x 8 x 3 m."""

import torch

from benchmarks.kernels.speedup import speedups
from benchmarks.metric import Metric
from xrdslam.ops.dense_grid import Chosen, DenseGridLayout, dense_grid, dense_grid_torch
from xrdslam.ops.feature_decoder import FeatureDecoder, decode_features_torch

__all__ = ["dense_grids"]

_SAMPLES = 32_000


def dense_grids() -> list[Metric]:
    """Measure interpolation with half of the vertices chosen, and a decoder of one output, each with all gradients."""
    g = torch.Generator().manual_seed(0)
    bounds = torch.tensor([[-4.0, -4, 0], [4, 4, 3]])
    layout = DenseGridLayout.covering(bounds, 0.16)
    points = (bounds[0] + torch.rand(_SAMPLES, 3, generator=g) * (bounds[1] - bounds[0])).requires_grad_()
    table = torch.randn(layout.num_rows, 32, generator=g)
    chosen = Chosen.of(table, torch.arange(layout.num_rows // 2))
    features = torch.randn(_SAMPLES, 32, generator=g).requires_grad_()
    decoder = FeatureDecoder(32, 1, g).requires_grad_(False)
    return [
        *speedups(
            "kernels/dense_grid/features",
            lambda: dense_grid_torch(points, table, layout, chosen),
            lambda: dense_grid(points, table, layout, chosen),
            (points, chosen.values),
        ),
        *speedups(
            "kernels/dense_grid/decoder",
            lambda: decode_features_torch(points, features, decoder.weights()),
            lambda: decoder(points, features),
            (points, features),
        ),
    ]
