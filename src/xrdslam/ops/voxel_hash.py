"""Sparse voxels over a hash of signed coordinates, whose corners have rows that neighbours share; rays through them."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int32, Int64
from torch import Tensor

from xrdslam.ops.coordinate_hash import REACH, rehash

__all__ = ["RayHits", "SparseVoxels", "corner_rows_torch", "locate_torch", "traverse", "traverse_torch", "voxels_torch"]

_SHORTEST = 1e-6  # as the kernel's


class RayHits(NamedTuple):
    """Which voxels rays pass, in order along each ray: ray r has the hits `offsets[r]` to `offsets[r + 1]`."""

    offsets: Int64[Tensor, " n1"]
    voxels: Int64[Tensor, " h"]
    entries: Float[Tensor, " h"]
    """Ray parameter at which the voxel is entered; 0 where the ray begins inside."""
    exits: Float[Tensor, " h"]


class SparseVoxels:
    """Voxels of one size, in the order in which they were entered; voxel v spans [v, v + 1) * voxel_m.

    Each corner has a row, shared by all voxels that meet there, numbered in the order of creation and for good: new
    voxels append rows. Coordinates are signed; what lies beyond 2^20 voxels from the origin is left out. The tables
    live on the CPU and grow as needed; the same points in the same order give the same rows.
    """

    def __init__(self, voxel_m: float, capacity: int = 1024) -> None:
        if not 0 < voxel_m < float("inf") or capacity < 1:
            raise ValueError(f"voxel_m={voxel_m}, capacity={capacity}: must both be positive")
        self.voxel_m = voxel_m
        self._counts = np.zeros(2, np.int64)
        self._coords = np.zeros((0, 3), np.int32)
        self._corners = np.zeros((0, 8), np.int32)
        self._vertices = np.zeros((0, 3), np.int32)
        self._resize(capacity)

    def __len__(self) -> int:
        return int(self._counts[0])

    @property
    def num_vertices(self) -> int:
        """How many corners there are, each counted once."""
        return int(self._counts[1])

    @property
    def coords(self) -> Int32[Tensor, "v 3"]:
        """Each voxel's coordinates: its corner with the least ones [voxels]."""
        return torch.from_numpy(self._coords[: len(self)])

    @property
    def corners(self) -> Int32[Tensor, "v 8"]:
        """The rows of each voxel's corners; x runs slowest, z fastest."""
        return torch.from_numpy(self._corners[: len(self)])

    @property
    def vertices(self) -> Int32[Tensor, "c 3"]:
        """The coordinates of each row's corner [voxels]."""
        return torch.from_numpy(self._vertices[: self.num_vertices])

    def insert(self, points_world: Float[Tensor, "n 3"]) -> int:
        """Enter the voxels that hold the points [m]; return how many are new."""
        from xrdslam.ops import voxel_hash_kernels as kernels

        points = points_world.detach().to("cpu", torch.float32).contiguous().numpy()
        before, done = len(self), 0
        while done < len(points):
            done = kernels.insert(points, done, self.voxel_m, *self._tables())
            if done < len(points):
                self._resize(2 * len(self._coords))
        return len(self) - before

    def insert_cells(self, coords: Int32[Tensor, "n 3"]) -> int:
        """Enter voxels by their coordinates; return how many are new."""
        from xrdslam.ops import voxel_hash_kernels as kernels

        before, cells = len(self), coords.cpu().contiguous().numpy()
        if len(cells) and abs(cells).max() >= REACH - 1:
            raise ValueError(f"coordinates up to {abs(cells).max()}: must lie within {REACH - 1} voxels of the origin")
        if before + len(cells) > len(self._coords):
            self._resize(before + len(cells))
        kernels.insert_cells(cells, *self._tables())
        return len(self) - before

    def locate(self, points_world: Float[Tensor, "n 3"], slack: float = 0.0) -> Int64[Tensor, " n"]:
        """Return the voxel that holds each point [m], -1 where there is none.

        A point within `slack` [voxels] of a face may be given to the voxel across, where its own does not exist.
        """
        if points_world.device.type != "cpu" or points_world.dtype != torch.float32:
            return locate_torch(points_world, self.coords.to(points_world.device), self.voxel_m, slack)
        from xrdslam.ops import voxel_hash_kernels as kernels
        from xrdslam.ops.threads import kernel_threads

        out = torch.empty(len(points_world), dtype=torch.int64)
        points = points_world.detach().contiguous().numpy()
        with kernel_threads():
            kernels.locate(points, self.voxel_m, slack, self._keys, self._rows, out.numpy())
        return out

    @property
    def box(self) -> Int64[np.ndarray, "2 3"]:
        """The least coordinates, and the largest plus one; both zero where there are no voxels."""
        coords = self._coords[: len(self)].astype(np.int64)
        if len(coords) == 0:
            return np.zeros((2, 3), np.int64)
        return np.stack((coords.min(0), coords.max(0) + 1))

    @property
    def table(self) -> tuple[np.ndarray, np.ndarray]:
        """The hash table from coordinates to voxels, for kernels (see `coordinate_hash`)."""
        return self._keys, self._rows

    def _tables(self) -> tuple[np.ndarray, ...]:
        return (
            self._keys,
            self._rows,
            self._coords,
            self._corners,
            self._vertex_keys,
            self._vertex_rows,
            self._vertices,
            self._counts,
        )

    def _resize(self, capacity: int) -> None:
        """Make room for `capacity` voxels, and as many vertices as they can have."""
        self._coords, self._corners = _grown(self._coords, capacity), _grown(self._corners, capacity)
        self._vertices = _grown(self._vertices, 8 * capacity)
        self._keys, self._rows = _empty_table(capacity)
        self._vertex_keys, self._vertex_rows = _empty_table(8 * capacity)
        rehash(self._keys, self._rows, self._coords, len(self))
        rehash(self._vertex_keys, self._vertex_rows, self._vertices, self.num_vertices)


def traverse(
    grid: SparseVoxels,
    origins_world: Float[Tensor, "n 3"],
    directions_world: Float[Tensor, "n 3"],
    far: Float[Tensor, " n"],
) -> RayHits:
    """Return every voxel that rays pass between 0 and `far` (in units of their directions), without a cap."""
    tensors = (origins_world, directions_world, far)
    if not all(t.device.type == "cpu" and t.dtype == torch.float32 for t in tensors):
        return traverse_torch(grid, origins_world, directions_world, far)
    from xrdslam.ops import voxel_hash_kernels as kernels
    from xrdslam.ops.threads import kernel_threads

    rays = [t.detach().contiguous().numpy() for t in tensors]
    given = (*rays, grid.voxel_m, grid.box, *grid.table)
    counts = torch.empty(len(far), dtype=torch.int64)
    with kernel_threads():
        kernels.count_hits(*given, counts.numpy())
        offsets = _offsets(counts)
        total = int(offsets[-1])
        hits = RayHits(offsets, torch.empty(total, dtype=torch.int64), torch.empty(total), torch.empty(total))
        kernels.fill_hits(*given, *(t.numpy() for t in hits))
    return hits


def traverse_torch(grid: SparseVoxels, origins_world: Tensor, directions_world: Tensor, far: Tensor) -> RayHits:
    """Test every ray against every voxel's slabs: the twin of the kernel."""
    low = grid.coords.to(far.device).double()
    origins, directions = (
        origins_world.detach().double() / grid.voxel_m,
        directions_world.detach().double() / grid.voxel_m,
    )
    start = torch.zeros(len(far), len(low), dtype=torch.float64, device=far.device)
    end = far.detach().double()[:, None].expand_as(start)
    for a in range(3):
        o, d = origins[:, a, None], directions[:, a, None]
        one, two = (low[:, a] - o) / d, (low[:, a] + 1 - o) / d
        inside = (low[:, a] <= o) & (o < low[:, a] + 1)
        still = d == 0
        start = torch.maximum(start, torch.where(still, -torch.inf, torch.minimum(one, two)))
        end = torch.minimum(
            end, torch.where(still, torch.where(inside, torch.inf, -torch.inf), torch.maximum(one, two))
        )
    is_hit = end - start > _SHORTEST
    order = torch.where(is_hit, start, torch.inf).argsort(stable=True, dim=1)
    is_hit, start, end = (t.gather(1, order) for t in (is_hit, start, end))
    offsets = _offsets(is_hit.sum(1))
    return RayHits(offsets, order[is_hit], start[is_hit].to(far.dtype), end[is_hit].to(far.dtype))


def voxels_torch(points_world: Float[Tensor, "n 3"], voxel_m: float) -> Int32[Tensor, "v 3"]:
    """Return the coordinates of the voxels that hold the points, in the order of their first points: insertion's twin.

    Points that are not finite, or out of reach, have none.
    """
    cells = torch.floor(points_world.detach().double() / voxel_m)
    cells = cells[(cells.abs() < REACH - 1).all(1)].long()
    _, first = _first_of(_packed(cells))
    return cells[first.sort().values].to(torch.int32)


def corner_rows_torch(coords: Int32[Tensor, "v 3"]) -> tuple[Int32[Tensor, "v 8"], Int32[Tensor, "c 3"]]:
    """Return the corner rows of voxels, numbered as they come, and the rows' coordinates: the twin of the sharing."""
    shifts = torch.tensor([[c >> 2, (c >> 1) & 1, c & 1] for c in range(8)], device=coords.device)
    corners = (coords.long()[:, None] + shifts).reshape(-1, 3)
    inverse, first = _first_of(_packed(corners))
    order = first.argsort()
    rank = torch.empty_like(order)
    rank[order] = torch.arange(len(order), device=order.device)
    return rank[inverse].reshape(-1, 8).to(torch.int32), corners[first[order]].to(torch.int32)


def locate_torch(points_world: Tensor, coords: Int32[Tensor, "v 3"], voxel_m: float, slack: float = 0.0) -> Tensor:
    """Return the voxel that holds each point: the twin of the look-up."""
    position = points_world.detach().double() / voxel_m
    keys, order = _packed(coords.long()).sort()
    found = torch.full((len(position),), -1, dtype=torch.int64, device=position.device)
    if len(keys) == 0:
        return found
    near = (position.abs() < REACH - 1).all(1)
    fraction = position - position.floor()
    across = torch.where(fraction >= 1 - slack, 2 * slack + 1e-9, 0.0)
    across = torch.where(fraction <= slack, -2 * slack - 1e-9, across)
    for corner in range(8):
        side = torch.tensor([corner >> 2, (corner >> 1) & 1, corner & 1], device=position.device)
        cells = torch.where(near[:, None], (position + side * across).floor(), 0.0).long()
        wanted = _packed(cells)
        at = torch.searchsorted(keys, wanted).clamp(max=len(keys) - 1)
        found = torch.where((found < 0) & (keys[at] == wanted) & near, order[at], found)
    return found


def _packed(cells: Int64[Tensor, "n 3"]) -> Int64[Tensor, " n"]:
    x, y, z = (cells + REACH).unbind(1)
    return (x << 42) | (y << 21) | z


def _first_of(keys: Int64[Tensor, " n"]) -> tuple[Tensor, Tensor]:
    """Return where each key is among the different ones, and each different one's first place."""
    unique, inverse = torch.unique(keys, return_inverse=True)
    first = torch.full((len(unique),), len(keys), dtype=torch.int64, device=keys.device)
    first.scatter_reduce_(0, inverse, torch.arange(len(keys), device=keys.device), "amin")
    return inverse, first


def _offsets(counts: Int64[Tensor, " n"]) -> Int64[Tensor, " n1"]:
    """Return where each ray's part begins, and the end of all."""
    return torch.cat((counts.new_zeros(1), counts.cumsum(0)))


def _grown(array: np.ndarray, capacity: int) -> np.ndarray:
    longer = np.zeros((capacity, array.shape[1]), array.dtype)
    longer[: len(array)] = array
    return longer


def _empty_table(capacity: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a hash table that `capacity` entries fill by half."""
    size = 1 << (2 * capacity - 1).bit_length()
    return np.full(size, -1, np.int64), np.full(size, -1, np.int32)
