"""The hash encoding of a mapping iteration: 2048 rays of 85 samples, 16 levels of 2^16 rows."""

import torch

from benchmarks.interleaved import median_seconds
from benchmarks.metric import Metric
from xrdslam.ops.hash_grid import HashGridLayout, hash_grid, hash_grid_torch

__all__ = ["hash_grids"]


def hash_grids() -> list[Metric]:
    """Measure forward alone, and backward to the table and to the points."""
    g = torch.Generator().manual_seed(0)
    layout = HashGridLayout.build(325, 16)
    origins, directions = torch.rand(2048, 1, 3, generator=g), torch.randn(2048, 1, 3, generator=g) * 0.3
    along = torch.linspace(0, 1, 85)[None, :, None]
    points = (origins + along * directions).reshape(-1, 3).contiguous()
    table = torch.randn(layout.num_rows, 2, generator=g)
    upstream = torch.randn(len(points), layout.num_features, generator=g)
    calls = {"twin": hash_grid_torch, "kernel": hash_grid}
    forward = median_seconds({name: (lambda call=call: call(points, table, layout), 1) for name, call in calls.items()})
    leaves = {"table": table.clone().requires_grad_(), "points": points.clone().requires_grad_()}
    metrics = [
        Metric("kernels/hash_grid/forward_speedup", forward["twin"] / forward["kernel"], "x twin", "higher", 0.4)
    ]
    for leaf, tensor in leaves.items():
        given = {"table": table, "points": points, leaf: tensor}
        graphs = {name: call(given["points"], given["table"], layout) for name, call in calls.items()}
        seconds = median_seconds(
            {
                name: (lambda out=out: torch.autograd.grad(out, tensor, upstream, retain_graph=True), 1)  # noqa: B023
                for name, out in graphs.items()
            }
        )
        key = f"kernels/hash_grid/backward_{leaf}_speedup"
        metrics.append(Metric(key, seconds["twin"] / seconds["kernel"], "x twin", "higher", 0.4))
    return metrics
