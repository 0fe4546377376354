"""The surface of a field near known points: a sphere, closed, in place, coloured; nothing where nothing was seen."""

import numpy as np
import torch
import trimesh

from xrdslam.ops.field_surface import field_surface

RADIUS = 0.5
CENTER = torch.tensor([0.3, -0.2, -1.0])


def _sphere(points: torch.Tensor) -> torch.Tensor:
    return (points - CENTER).norm(dim=1) - RADIUS


def _on_sphere(count: int = 20000) -> np.ndarray:
    directions = torch.randn(count, 3, generator=torch.Generator().manual_seed(0))
    return (CENTER + RADIUS * directions / directions.norm(dim=1, keepdim=True)).numpy()


def test_a_sphere_is_closed_and_in_place() -> None:
    told: list[float] = []
    mesh = field_surface(_on_sphere(), 0.04, _sphere, lambda p: p * 0 + 0.25, progress=told.append)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert solid.is_watertight
    assert solid.volume > 0, "faces are counter-clockwise seen from where the field is positive"
    error = np.linalg.norm(mesh.vertices - CENTER.numpy(), axis=1) - RADIUS
    assert np.abs(error).max() < 0.04 / 50  # linear interpolation on a chord: h^2 / (8 r) = 0.4 mm
    assert mesh.colors is not None
    np.testing.assert_allclose(mesh.colors, 0.25)
    assert told[-1] == 1.0


def test_only_what_was_seen_is_meshed() -> None:
    points = _on_sphere()
    upper = points[points[:, 2] > float(CENTER[2])]
    mesh = field_surface(upper, 0.02, _sphere)
    lowest = mesh.vertices[:, 2].min() - float(CENTER[2])
    assert -0.02 * 2 * 8 - 0.1 < lowest < 0.02, f"the lower half was not seen, the mesh reaches {lowest} m below"


def test_nothing_seen_is_an_empty_mesh() -> None:
    for points in (np.zeros((0, 3), np.float32), np.full((5, 3), np.nan, np.float32)):
        mesh = field_surface(points, 0.02, _sphere)
        assert len(mesh.vertices) == len(mesh.faces) == 0
