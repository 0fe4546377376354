"""The map of Gaussians: growth, order, pruning, files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from plyfile import PlyData
from torch import nn

from xrdslam.algorithms.splatam.config import SplatamMapConfig
from xrdslam.algorithms.splatam.model import PARAMETERS, GaussianMap
from xrdslam.core.batch import ImageBatch
from xrdslam.core.frame import Frame
from xrdslam.core.model import View
from xrdslam.core.optimisation import GroupedOptimiser


def map_of(frame: Frame, **settings: object) -> GaussianMap:
    model = GaussianMap(SplatamMapConfig(**settings), scene_radius_m=1.0)  # type: ignore[arg-type]
    model.extend(frame, torch.eye(4))
    return model


def test_the_same_view_again_adds_almost_nothing(first_frame: Frame) -> None:
    model = map_of(first_frame)
    assert model.size == 60 * 80
    assert model.extend(first_frame, torch.eye(4)) < 0.005 * model.size


def test_what_a_step_to_the_side_uncovers_is_added(world: Any, first_frame: Frame) -> None:
    model = map_of(first_frame)
    T_world_camera = world.moved(x=0.2)
    added = model.extend(world.look(T_world_camera, 1), T_world_camera)
    strip, hidden = 60 * 4.8, 28 * 3.2  # px: wall that enters on the right, and what the box hid
    assert 60 * (4.8 - 2) < added < strip + hidden  # the map's last Gaussians explain up to 2 px beyond them
    assert set(model.birth.unique().tolist()) == {0, 1}


def test_sorting_moves_rows_and_changes_no_picture(world: Any, first_frame: Frame) -> None:
    model = map_of(first_frame)
    with torch.no_grad():  # no two at the same depth: ties are blended in the order of the rows
        model.means[:, 2] += 4e-6 * torch.randperm(model.size, generator=torch.manual_seed(0))
    before = model.render(world.camera, torch.eye(4))
    means = model.means.detach().clone()
    model._sort()
    assert not torch.equal(model.means, means)
    for one, other in zip(before, model.render(world.camera, torch.eye(4)), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=2e-6)


def test_tracking_losses_look_only_where_the_map_explains_the_frame(world: Any, first_frame: Frame) -> None:
    model = map_of(first_frame)
    opacity = model.render(world.camera, torch.eye(4)).opacity
    explained = (opacity > 0.99) & (first_frame.depth > 0)
    assert 0.5 < explained.float().mean() < 1
    changed = world.look(torch.eye(4))
    changed.rgb[~explained] = 0
    losses = [model.losses(ImageBatch(f, torch.eye(4)), "tracking") for f in (first_frame, changed)]
    torch.testing.assert_close(losses[0]["color"], losses[1]["color"])
    assert losses[0]["depth"] > 0


def _stepped(model: GaussianMap, frame: Frame, prune: bool) -> None:
    optimiser = GroupedOptimiser(model.parameter_groups())
    sum(model.losses(ImageBatch(frame, torch.eye(4)), "mapping").values()).backward()  # type: ignore[union-attr]
    if prune:
        model.prune(optimiser)
    optimiser.step(0)


def test_pruning_keeps_the_gradients_of_what_stays(first_frame: Frame) -> None:
    """The released code rebuilds every parameter in a pruning iteration, so that it never steps (its issue 76)."""
    model = map_of(first_frame)
    with torch.no_grad():
        model.opacity_logits[::7] = -20.0  # transparent: no influence on the picture, to be removed
    kept = torch.ones(model.size, dtype=torch.bool)
    kept[::7] = False
    unpruned = map_of(first_frame)
    unpruned.load_state_dict(model.state_dict())
    _stepped(model, first_frame, prune=True)
    _stepped(unpruned, first_frame, prune=False)
    assert model.size == int(kept.sum())
    for name in ("means", "colors", "log_scales", "opacity_logits"):
        stepped = getattr(unpruned, name)[kept]
        torch.testing.assert_close(getattr(model, name), stepped, msg=name)
    assert not torch.equal(model.colors, map_of(first_frame).colors[kept])


def test_pruning_keeps_moments_with_their_rows(first_frame: Frame) -> None:
    model = map_of(first_frame)
    optimiser = GroupedOptimiser(model.parameter_groups())
    sum(model.losses(ImageBatch(first_frame, torch.eye(4)), "mapping").values()).backward()  # type: ignore[union-attr]
    optimiser.step(0)
    moments = optimiser.moments(model.colors)["exp_avg"].clone()
    with torch.no_grad():
        model.log_scales[5] = 1.0  # larger than a tenth of the scene
    assert model.prune(optimiser) == 1
    kept = torch.arange(len(moments)) != 5
    assert torch.equal(optimiser.moments(model.colors)["exp_avg"], moments[kept])


@pytest.mark.parametrize(("eps", "share_of_rate"), [(1e-8, 1e-4), (1e-15, 0.999)])
def test_what_a_view_barely_touches_stays_where_it_is(first_frame: Frame, eps: float, share_of_rate: float) -> None:
    """Adam's first step is lr g / (|g| + eps): a gradient of 1e-12 moves by a ten-thousandth of the rate, not all."""
    model = map_of(first_frame, adam_eps=eps)
    before = model.means.detach().clone()
    optimiser = GroupedOptimiser(model.parameter_groups())
    model.means.grad = torch.full_like(model.means, 1e-12)
    optimiser.step(0)
    moved = (before - model.means.detach()).double().abs().max() / model.config.lr_means
    assert moved <= 1.01 * share_of_rate + 3e-3  # a mean of 2.5 m is rounded to 2.4e-7 m, 2.4e-3 of the rate
    assert moved >= share_of_rate - 3e-3


@pytest.mark.parametrize("anisotropic", [False, True])
def test_state_goes_into_an_empty_map_and_comes_out_the_same(world: Any, first_frame: Frame, anisotropic: bool) -> None:
    model = map_of(first_frame, anisotropic=anisotropic)
    other = GaussianMap(SplatamMapConfig(anisotropic=anisotropic), 1.0)
    other.load_state_dict(model.state_dict())
    for name in PARAMETERS:
        assert torch.equal(getattr(model, name), getattr(other, name))
        assert isinstance(getattr(other, name), nn.Parameter)
    assert torch.equal(model.render(world.camera, torch.eye(4)).rgb, other.render(world.camera, torch.eye(4)).rgb)


def test_splats_ply_has_the_fields_and_values_that_viewers_expect(first_frame: Frame, tmp_path: Path) -> None:
    model = map_of(first_frame)
    (path,) = model.export(tmp_path)
    vertices = PlyData.read(str(path))["vertex"]
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    assert [p.name for p in vertices.properties] == names
    assert {p.val_dtype for p in vertices.properties} == {"f4"}
    color = 0.5 + 0.28209479177387814 * np.stack([vertices[f"f_dc_{i}"] for i in range(3)], 1)
    np.testing.assert_allclose(color, model.colors.detach().numpy(), atol=1e-6)
    np.testing.assert_allclose(np.exp(vertices["scale_2"]), model.log_scales.detach().exp().numpy()[:, 0], rtol=1e-6)
    np.testing.assert_allclose(vertices["rot_0"], 1.0)
    np.testing.assert_allclose(np.stack([vertices[a] for a in "xyz"], 1), model.means.detach().numpy())


def test_the_mesh_is_the_maps_and_not_the_sensors(world: Any, first_frame: Frame) -> None:
    """Moving the map moves the mesh, although the views and whatever they measured stay."""
    model = map_of(first_frame, mesh_voxel_m=0.03, mesh_truncation_m=0.12)
    with torch.no_grad():
        model.opacity_logits += 3
        model.means[:, 2] += 0.3
    vertices = model.mesh([View(world.camera, torch.eye(4))]).vertices
    wall = vertices[np.abs(vertices[:, 0]) > 0.8]
    assert len(wall) > 100
    assert abs(np.median(wall[:, 2]) - 2.8) < 0.03


def test_the_cloud_has_a_point_for_each_gaussian(first_frame: Frame) -> None:
    cloud = map_of(first_frame).point_cloud()
    assert cloud.points.shape == (4800, 3)
    assert cloud.colors is not None
    assert 0 <= cloud.colors.min() <= cloud.colors.max() <= 1
