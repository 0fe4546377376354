"""Planes and spheres in closed form: weights, pictures without measured depth, meshes."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from xrdslam.algorithms.vox_fusion.model import VoxelMap
from xrdslam.core.batch import RayBatch
from xrdslam.core.camera import Camera
from xrdslam.ops.ragged_rendering import ragged_sdf_weights, ragged_sums

Ruled = Callable[[Callable[[torch.Tensor], torch.Tensor], torch.Tensor], VoxelMap]
CAMERA = Camera(40.0, 40.0, 31.5, 23.5, 64, 48)


def _wall(ruled: Ruled, depth_m: float) -> VoxelMap:
    """A wall across the view, with voxels before and behind it."""
    x, y = torch.meshgrid(torch.linspace(-3, 3, 61), torch.linspace(-3, 3, 61), indexing="ij")
    points = torch.cat(
        [torch.stack((x, y, torch.full_like(x, depth_m + s)), -1).reshape(-1, 3) for s in (-0.2, 0, 0.2)]
    )
    return ruled(lambda p: (depth_m - p[:, 2]) / 0.05, points)


def test_a_wall_is_seen_at_its_depth_without_measured_depth(ruled: Ruled) -> None:
    seen = _wall(ruled, 2.07).render(CAMERA, torch.eye(4))
    torch.testing.assert_close(seen.depth, torch.full_like(seen.depth, 2.07), rtol=0, atol=1e-3)
    torch.testing.assert_close(seen.opacity, torch.ones_like(seen.opacity), rtol=0, atol=1e-4)
    torch.testing.assert_close(seen.rgb, torch.full_like(seen.rgb, 0.5), rtol=0, atol=1e-3)


def test_the_first_of_two_walls_is_seen(ruled: Ruled) -> None:
    far = torch.tensor([[0.1, 0.1, 3.1]])
    near = torch.tensor([[0.1, 0.1, 1.1]])
    model = ruled(lambda p: torch.where(p[:, 2] < 2, 1.1 - p[:, 2], 3.1 - p[:, 2]) / 0.05, torch.cat((far, near)))
    seen = model.render(Camera(1.0, 1.0, 0.0, 0.0, 1, 1), _at(0.1, 0.1))
    assert abs(float(seen.depth) - 1.1) < 1e-3


def test_a_voxel_entered_behind_its_surface_is_met_where_it_is_entered(ruled: Ruled) -> None:
    model = ruled(lambda p: torch.full_like(p[:, 0], -0.01), torch.tensor([[0.1, 0.1, 1.1]]))
    seen = model.render(Camera(1.0, 1.0, 0.0, 0.0, 1, 1), _at(0.1, 0.1))
    assert abs(float(seen.depth) - 1.0) < 0.05
    assert float(seen.opacity) > 0.5


def test_a_ray_with_its_surface_out_of_reach_sees_nothing(ruled: Ruled) -> None:
    seen = ruled(lambda p: torch.ones_like(p[:, 0]), torch.tensor([[0.1, 0.1, 1.1]])).render(CAMERA, _at(0.1, 0.1))
    assert float(seen.opacity.max()) == float(seen.depth.max()) == 0


def test_jittered_samples_of_a_wall_have_its_depth(ruled: Ruled) -> None:
    """The bell of 0.9 cm on samples 1 cm apart: mean within 1 mm, deviation below 2.5 mm."""
    model = _wall(ruled, 2.07)
    directions = CAMERA.rays().reshape(-1, 3)[::3]
    depth = torch.full((len(directions),), 2.07)
    gray = torch.full_like(directions, 0.5)
    slots = torch.zeros(len(depth), dtype=torch.int64)
    batch = RayBatch(torch.zeros_like(directions), directions, gray, depth, slots)
    samples = model.sample(batch)
    points = samples.depths[:, None] * directions[samples.rays]
    sdf = model.field.distance(points, samples.voxels)
    weights = ragged_sdf_weights(sdf, samples.depths, samples.offsets, 0.05)
    error = ragged_sums(weights * samples.depths, samples.offsets) - 2.07
    assert error.mean().abs() < 1e-3
    assert error.std() < 2.5e-3
    assert float(samples.depths.max()) <= 2.07 + 0.05


def test_free_space_is_sampled_sparsely_the_surface_in_full(ruled: Ruled) -> None:
    """Voxels along rays of 2 m: every cm within 10 cm of the wall, every eighth before, none of them twice as often."""
    model = ruled(lambda p: torch.ones_like(p[:, 0]), torch.tensor([[0.1, 0.1, 0.2 * k + 0.1] for k in range(12)]))
    count = 4000
    directions = torch.tensor([[0.0, 0.0, 1.0]]).expand(count, 3)
    depth = torch.full((count,), 2.0)
    slots = torch.zeros(count, dtype=torch.int64)
    batch = RayBatch(torch.tensor([[0.1, 0.1, 0.0]]).expand(count, 3), directions, directions, depth, slots)
    kept, model.config.free_space_every = model.sample(batch), 1
    whole = model.sample(batch)
    far, all_far = kept.depths < 1.9, whole.depths < 1.9
    assert float(far.sum() / all_far.sum()) == pytest.approx(1 / 8, rel=0.02)
    assert float((~far).sum() / (~all_far).sum()) == pytest.approx(1, rel=0.01)
    per_ray = torch.bincount(kept.rays[far], minlength=count)
    assert int(per_ray.min()) > 10, "of each ray"
    assert bool((kept.offsets.diff() == torch.bincount(kept.rays, minlength=count)).all())
    assert bool((kept.voxels == (kept.depths / 0.2).floor().long()).all()), "each with its own voxel"


def test_the_mesh_of_a_sphere_is_closed_and_lies_on_it(ruled: Ruled) -> None:
    generator = torch.Generator().manual_seed(0)
    outward = torch.nn.functional.normalize(torch.randn(20000, 3, generator=generator), dim=1)
    shell = torch.cat([outward * radius for radius in (0.85, 0.95, 1.0, 1.05, 1.15)])
    model = ruled(lambda p: (p.norm(dim=1) - 1) / 0.05, shell)
    mesh = model.mesh([])
    edges = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, shared = np.unique(edges, axis=0, return_counts=True)
    assert (shared == 2).all(), "an edge without its second face: a hole"
    radii = np.linalg.norm(mesh.vertices, axis=1)
    assert abs(radii - 1).max() < 0.011, "linear between values 0.2 m apart: 2 * 0.2^2 / 8 = 1 cm, and higher orders"
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a) > 0).mean() > 0.99, "faces look outward, to free space"
    assert mesh.colors is not None
    assert abs(mesh.colors - 0.5).max() < 1e-5, "every vertex lies in a voxel"


def test_the_mesh_ends_where_the_voxels_end(ruled: Ruled) -> None:
    model = ruled(lambda p: (0.07 - p[:, 2]) / 0.05, torch.tensor([[0.1, 0.1, 0.1]]))
    mesh = model.mesh([])
    assert np.allclose(mesh.vertices.min(0), [0, 0, 0.07], atol=1e-4)
    assert np.allclose(mesh.vertices.max(0), [0.2, 0.2, 0.07], atol=1e-4)


def test_an_empty_map_has_no_mesh(ruled: Ruled) -> None:
    assert len(ruled(lambda p: p[:, 0], torch.zeros(0, 3)).mesh([]).faces) == 0


def _at(x: float, y: float) -> torch.Tensor:
    pose = torch.eye(4)
    pose[0, 3], pose[1, 3] = x, y
    return pose
