"""A grid of features that grows, and of which an optimiser may see the part that it is to move."""

from typing import Any

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from xrdslam.ops.dense_grid import Chosen, DenseGridLayout, dense_grid

__all__ = ["FeatureGrid"]

CHANNELS = 32


class FeatureGrid(nn.Module):
    """Features at lattice vertices; new ones begin as N(0, deviation^2)."""

    place: Tensor
    """First lattice vertex and vertices an axis, (2, 3)."""

    def __init__(
        self, bounds: Float[Tensor, "2 3"], voxel_m: float, deviation: float, generator: torch.Generator
    ) -> None:
        super().__init__()
        self.deviation = deviation
        self.layout = DenseGridLayout.covering(bounds, voxel_m)
        self.register_buffer("place", torch.tensor([self.layout.first, self.layout.size]))
        self.table = nn.Parameter(deviation * torch.randn(self.layout.num_rows, CHANNELS, generator=generator))
        self.chosen: Chosen | None = None

    def forward(self, points_world: Float[Tensor, "n 3"]) -> Float[Tensor, "n 32"]:
        return dense_grid(points_world, self.table, self.layout, self.chosen)

    @torch.no_grad()
    def grow(self, bounds: Float[Tensor, "2 3"], generator: torch.Generator) -> int:
        """Cover a larger box too; features stay where they are. Return how many vertices were added."""
        now = self.layout.box
        wanted = torch.stack((torch.minimum(bounds[0].cpu(), now[0]), torch.maximum(bounds[1].cpu(), now[1])))
        layout = DenseGridLayout.covering(wanted, self.layout.voxel_m)
        added = layout.num_rows - self.layout.num_rows
        if added:
            table = self.deviation * torch.randn(layout.num_rows, CHANNELS, generator=generator)
            table = table.to(self.table)
            table[self.layout.rows_in(layout).to(table.device)] = self.table
            self._replace(layout, table)
        return added

    def choose(self, rows: Int64[Tensor, " m"]) -> nn.Parameter:
        """Let an optimiser see the features of these vertices only; return them."""
        self.chosen = Chosen.of(self.table, rows)
        assert isinstance(self.chosen.values, nn.Parameter)
        return self.chosen.values

    @torch.no_grad()
    def settle(self) -> None:
        """Take the chosen features over; a vertex whose features are not finite keeps what it had."""
        if self.chosen is not None:
            sound = torch.isfinite(self.chosen.values).all(1)
            self.table[self.chosen.rows[sound]] = self.chosen.values[sound]
            self.chosen = None

    def _replace(self, layout: DenseGridLayout, table: Tensor) -> None:
        self.layout = layout
        self.place = torch.tensor([layout.first, layout.size], device=table.device)
        self.table = nn.Parameter(table)

    def _load_from_state_dict(self, state_dict: dict[str, Tensor], prefix: str, *args: Any) -> None:  # noqa: ANN401
        """Take the size from the state: the grid that is loaded into may be another one."""
        first, size = state_dict[prefix + "place"].tolist()
        layout = DenseGridLayout(self.layout.voxel_m, tuple(first), tuple(size))
        self._replace(layout, torch.empty_like(state_dict[prefix + "table"], device=self.table.device))
        super()._load_from_state_dict(state_dict, prefix, *args)
