"""Tile lists that are used again: the same images as fresh ones, and rebuilt when they must be."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from xrdslam.core.errors import ConfigError
from xrdslam.ops.splats import SplatRender, TileLists, render

Scene = Callable[..., dict[str, Any]]


def _moved(T: Tensor, translation: float, rotation: float) -> Tensor:
    """Return a pose moved along x and turned about y."""
    motion = torch.eye(4)
    motion[0, 3] = translation
    c, s = torch.tensor(rotation).cos(), torch.tensor(rotation).sin()
    motion[0, 0], motion[0, 2], motion[2, 0], motion[2, 2] = c, s, -s, c
    return motion @ T


def _render(arguments: dict[str, Any], T: Tensor, lists: TileLists | None) -> tuple[SplatRender, Tensor]:
    pose = T.clone().requires_grad_()
    rendered = render(**(arguments | {"T_camera_world": pose}), lists=lists, backend="numba")
    torch.autograd.backward(list(rendered), [torch.ones_like(image) for image in rendered])
    assert pose.grad is not None
    return SplatRender(*(image.detach() for image in rendered)), pose.grad


def _layered(scene: Scene, anisotropic: bool = False) -> dict[str, Any]:
    """Space the depths so far apart that no motion of these tests changes their order."""
    arguments = scene(250, anisotropic=anisotropic)
    T = arguments["T_camera_world"]
    points = arguments["means"] @ T[:3, :3].T + T[:3, 3]
    points *= (torch.linspace(0.5, 30, 250) / points[:, 2])[:, None]
    arguments["means"] = (points - T[:3, 3]) @ T[:3, :3]
    arguments["log_scales"] = arguments["log_scales"] + points[:, 2:].log()
    return arguments


@pytest.mark.parametrize("anisotropic", [False, True])
def test_lists_used_again_give_the_images_and_gradients_of_fresh_ones(scene: Scene, anisotropic: bool) -> None:
    arguments, lists = _layered(scene, anisotropic=anisotropic), TileLists()
    for step in range(8):
        T = _moved(arguments["T_camera_world"], 0.0015 * step, -0.0008 * step)
        again, pose_gradient = _render(arguments, T, lists)
        fresh, expected_gradient = _render(arguments, T, None)
        for a, b in zip(again, fresh, strict=True):
            torch.testing.assert_close(a, b, rtol=2e-6, atol=1e-6)
        scale = expected_gradient.abs().max()
        torch.testing.assert_close(pose_gradient / scale, expected_gradient / scale, rtol=0, atol=1e-6)
    assert lists.num_renders == 8
    assert lists.num_builds < 8


def test_two_renders_share_lists_before_either_is_differentiated(scene: Scene) -> None:
    arguments, lists = _layered(scene), TileLists()
    poses = [_moved(arguments["T_camera_world"], 0.001 * k, 0.0).requires_grad_() for k in range(2)]
    rendered = [render(**(arguments | {"T_camera_world": T}), lists=lists) for T in poses]
    assert lists.num_builds == 1
    for image, T in zip(rendered, poses, strict=True):
        torch.autograd.backward(list(image), [torch.ones_like(x) for x in image])
        assert T.grad is not None
        _, expected = _render(arguments, T.detach(), None)
        torch.testing.assert_close(T.grad / expected.abs().max(), expected / expected.abs().max(), rtol=0, atol=1e-6)


@pytest.mark.parametrize(("margin_px", "builds"), [(0.0, 2), (2.0, 1)])
def test_a_footprint_that_leaves_its_tiles_rebuilds_the_lists(scene: Scene, margin_px: float, builds: int) -> None:
    """15 mm at 0.6 m with 56 px focal length are 1.4 px: more than no margin, less than two pixels."""
    arguments, lists = scene(), TileLists(margin_px=margin_px)
    _render(arguments, arguments["T_camera_world"], lists)
    T = _moved(arguments["T_camera_world"], 0.015, 0.0)
    again, _ = _render(arguments, T, lists)
    assert lists.num_builds == builds
    if builds == 2:
        assert torch.equal(again.rgb, _render(arguments, T, None)[0].rgb)


@pytest.mark.parametrize(("translation", "rotation"), [(0.03, 0.0), (0.0, 0.02)])
def test_a_pose_beyond_the_limits_rebuilds_the_lists(scene: Scene, translation: float, rotation: float) -> None:
    arguments, lists = scene(), TileLists(margin_px=50.0)
    _render(arguments, arguments["T_camera_world"], lists)
    _render(arguments, _moved(arguments["T_camera_world"], translation / 2, rotation / 2.1), lists)
    assert lists.num_builds == 1
    _render(arguments, _moved(arguments["T_camera_world"], translation, rotation), lists)
    assert lists.num_builds == 2


def test_a_gaussian_that_comes_into_view_is_drawn(scene: Scene) -> None:
    """From just outside the image, and from just before `near`, where one centimetre decides."""
    for axis in (0, 2):
        arguments, lists = scene(1), TileLists(margin_px=0.0, max_translation=0.1)
        T = arguments["T_camera_world"] = torch.eye(4)
        camera = arguments["camera"]
        arguments["opacity_logits"][:] = 2.0
        arguments["log_scales"][:] = -7.0
        edge = torch.tensor([0.0, 0.0, 0.195]) if axis == 2 else torch.tensor([-(camera.cx + 4) / camera.fx, 0.0, 1.0])
        arguments["means"] = edge[None]
        T = torch.eye(4)
        first, _ = _render(arguments, T, lists)
        assert first.opacity.max() == 0
        T[axis, 3] = 0.09
        second, _ = _render(arguments, T, lists)
        assert second.opacity.max() > 0.3


@pytest.mark.parametrize("name", ["means", "log_scales", "opacity_logits"])
def test_a_changed_map_rebuilds_the_lists(scene: Scene, name: str) -> None:
    arguments, lists = scene(), TileLists()
    for step in range(2):
        again, _ = _render(arguments, arguments["T_camera_world"], lists)
        fresh, _ = _render(arguments, arguments["T_camera_world"], None)
        assert torch.equal(again.rgb, fresh.rgb)
        assert lists.num_builds == step + 1
        arguments[name].add_(0.05)


def test_another_map_of_the_same_size_rebuilds_the_lists(scene: Scene) -> None:
    """Freed memory is handed out again: the lists must not take the next tensor at an address for the last one."""
    arguments, lists = scene(2000), TileLists()
    for step in range(5):
        arguments["means"] = (scene(2000, seed=step)["means"] * 1.0).contiguous()
        again, _ = _render(arguments, arguments["T_camera_world"], lists)
        assert torch.equal(again.rgb, _render(arguments, arguments["T_camera_world"], None)[0].rgb)
        assert lists.num_builds == step + 1


def test_changed_colours_need_no_new_lists(scene: Scene) -> None:
    arguments, lists = scene(), TileLists()
    _render(arguments, arguments["T_camera_world"], lists)
    arguments["colors"].mul_(0.5)
    again, _ = _render(arguments, arguments["T_camera_world"], lists)
    fresh, _ = _render(arguments, arguments["T_camera_world"], None)
    assert torch.equal(again.rgb, fresh.rgb)
    assert lists.num_builds == 1


def test_limits_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ConfigError, match="margin_px"):
        TileLists(margin_px=-1.0)
