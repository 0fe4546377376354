"""What every map keeps to, as plain functions on a map: the contracts of models and of algorithms share them."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.core.batch import Batch, ImageBatch, Stage
from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame
from xrdslam.core.model import Model, Rendering, View
from xrdslam.core.sampling import sample_rays
from xrdslam.testing.bits import different_leaves

__all__ = ["batch_of", "check_losses", "check_parameter_groups", "check_rendering", "check_surface"]

OPACITY_SLACK = 1e-4  # of float32 sums over a few hundred samples


def batch_of(model: Model, frame: Frame, T_world_camera: Float[Tensor, "4 4"]) -> Batch:
    """Return the batch of one frame in the kind that the map takes."""
    if model.batch_kind == "image":
        return ImageBatch(frame, T_world_camera)
    return sample_rays([frame], [T_world_camera], 256, torch.Generator().manual_seed(0))


def check_rendering(model: Model, camera: Camera, T_world_camera: Float[Tensor, "4 4"]) -> Rendering:
    """Hold a rendering to shapes, finite numbers, ranges, the same bits twice, and a map that it leaves as it was."""
    before = {name: tensor.clone() for name, tensor in model.state_dict().items()}
    with torch.no_grad():
        first, second = (model.render(camera, T_world_camera) for _ in range(2))
    size = (camera.height, camera.width)
    assert first.rgb.shape == (*size, 3), f"rgb of {tuple(first.rgb.shape)} for a camera of {size} (rows, columns)"
    assert first.depth.shape == size, f"depth of {tuple(first.depth.shape)} for a camera of {size} (rows, columns)"
    assert first.opacity.shape == size, f"opacity of {tuple(first.opacity.shape)} for a camera of {size}"
    for name, image in first._asdict().items():
        assert bool(torch.isfinite(image).all()), f"rendered {name} is not finite"
    assert bool((first.depth >= 0).all()), f"rendered depth goes down to {float(first.depth.min())}"
    low, high = float(first.opacity.min()), float(first.opacity.max())
    assert low >= -OPACITY_SLACK, f"rendered opacity goes down to {low}"
    assert high <= 1 + OPACITY_SLACK, f"rendered opacity goes up to {high}"
    changed = different_leaves(first._asdict(), second._asdict())
    assert not changed, f"two renderings of one map from one pose differ in {changed}"
    changed = different_leaves(before, model.state_dict())
    assert not changed, f"rendering changed the map: {changed}"
    return first


def check_losses(model: Model, frame: Frame, T_world_camera: Float[Tensor, "4 4"], stage: Stage) -> None:
    """Hold the losses to finite scalars whose gradient is finite and reaches the map, or the pose when tracking."""
    pose = T_world_camera.detach().clone().requires_grad_(stage == "tracking")
    losses = model.losses(batch_of(model, frame, pose), stage)
    assert losses, f"no {stage} losses"
    for name, loss in losses.items():
        assert loss.shape == (), f"{stage} loss {name!r} has shape {tuple(loss.shape)}, a scalar is due"
        assert bool(torch.isfinite(loss)), f"{stage} loss {name!r} is {float(loss)}"
    total = torch.stack(tuple(losses.values())).sum()
    if stage == "tracking":
        moved = {"the pose": pose}
    else:
        moved = {f"{g.name}[{i}]": p for g in model.parameter_groups() for i, p in enumerate(g.params)}
    assert total.requires_grad, f"the {stage} losses carry no gradient"
    gradients = torch.autograd.grad(total, list(moved.values()), allow_unused=True)
    reached = {name: g for name, g in zip(moved, gradients, strict=True) if g is not None}
    spoilt = [name for name, g in reached.items() if not bool(torch.isfinite(_values(g)).all())]
    assert not spoilt, f"the gradient of the {stage} losses is not finite in {spoilt}"
    assert any(bool((_values(g) != 0).any()) for g in reached.values()), (
        f"the gradient of the {stage} losses is zero in all of {sorted(moved)}"
    )


def check_parameter_groups(model: Model) -> None:
    """Hold the groups to the model's own parameters, each once, with sound rates."""
    groups = model.parameter_groups()
    names = [group.name for group in groups]
    assert len(set(names)) == len(names), f"parameter groups share a name: {names}"
    held = [parameter for group in groups for parameter in group.params]
    assert len({id(p) for p in held}) == len(held), "a parameter is in two groups"
    own = {id(p) for p in model.parameters()}
    strangers = [group.name for group in groups if any(id(p) not in own for p in group.params)]
    assert not strangers, f"groups {strangers} hold parameters that are not the model's: state_dict() misses them"
    for group in groups:
        assert math.isfinite(group.lr), f"group {group.name!r} has learning rate {group.lr}"
        assert group.lr >= 0, f"group {group.name!r} has learning rate {group.lr}"
        assert group.accumulate >= 1, f"group {group.name!r} accumulates {group.accumulate} iterations"


def check_surface(model: Model, camera: Camera, T_world_camera: Float[Tensor, "4 4"]) -> None:
    """Hold the mesh and the points, where the map has them, to finite numbers, sound indices and colours in [0, 1]."""
    if model.supports("mesh"):
        mesh = model.mesh([View(camera, T_world_camera)])
        assert bool(torch.isfinite(torch.as_tensor(mesh.vertices)).all()), "a vertex is not finite"
        if len(mesh.faces):
            assert mesh.faces.min() >= 0, "a face points before the first vertex"
            assert mesh.faces.max() < len(mesh.vertices), "a face points behind the last vertex"
        _check_colours(mesh.colors, len(mesh.vertices))
    if model.supports("point_cloud"):
        cloud = model.point_cloud()
        assert bool(torch.isfinite(torch.as_tensor(cloud.points)).all()), "a point is not finite"
        _check_colours(cloud.colors, len(cloud.points))


def _check_colours(colours: object, count: int) -> None:
    if colours is None:
        return
    values = torch.as_tensor(colours)
    assert values.shape == (count, 3), f"colours of shape {tuple(values.shape)} for {count} points"
    assert bool(((values >= 0) & (values <= 1)).all()), "a colour is not in [0, 1]"


def _values(gradient: Tensor) -> Tensor:
    return gradient.coalesce().values() if gradient.is_sparse else gradient
