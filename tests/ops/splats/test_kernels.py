"""The numba renderer against the float64 torch renderer, and what must hold of it exactly."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from xrdslam.core.errors import ConfigError
from xrdslam.ops.splats import Pinhole, SplatRender, morton_order, render

Scene = Callable[..., dict[str, Any]]
NAMES = ("means", "log_scales", "opacity_logits", "colors", "quats_wxyz", "T_camera_world")


def _gradients(
    arguments: dict[str, Any], backend: str, dtype: torch.dtype, names: tuple[str, ...] = NAMES
) -> tuple[SplatRender, dict[str, Tensor]]:
    """Render and pull random cotangents back; the same cotangents for the same image size."""
    cast = {k: v.to(dtype).clone() if isinstance(v, Tensor) else v for k, v in arguments.items()}
    leaves = {name: cast[name].requires_grad_() for name in names if name in cast}
    rendered = render(**cast, backend=backend)
    g = torch.Generator().manual_seed(7)
    cotangents = [torch.randn(image.shape, generator=g, dtype=torch.float64).to(dtype) for image in rendered]
    torch.autograd.backward(list(rendered), cotangents)
    return SplatRender(*(x.detach() for x in rendered)), {name: x.grad for name, x in leaves.items()}


def _relative(found: Tensor, expected: Tensor) -> float:
    """Return the largest error over the largest entry."""
    return float((found.double() - expected.double()).abs().max() / expected.abs().max())


@pytest.mark.parametrize("size", [(70, 50), (64, 32), (33, 97), (5, 3)])
@pytest.mark.parametrize("anisotropic", [False, True])
def test_images_and_gradients_are_those_of_the_float64_twin(
    scene: Scene, anisotropic: bool, size: tuple[int, int]
) -> None:
    arguments = scene(300, *size, anisotropic)
    found, grads = _gradients(arguments, "numba", torch.float32)
    expected, expected_grads = _gradients(arguments, "torch", torch.float64)
    for image, reference in zip(found, expected, strict=True):
        assert reference.abs().max() > 0.5
        torch.testing.assert_close(image.double(), reference, rtol=0, atol=1e-5)
    for name, gradient in grads.items():
        assert expected_grads[name].abs().max() > 0, name
        # Worst measured 1.3e-6 isotropic; 2e-5 anisotropic, where thin streaks amplify the rounding of the means.
        assert _relative(gradient, expected_grads[name]) < (1e-4 if anisotropic else 1e-5), name


@pytest.mark.parametrize("opacity", [0.5, 0.9, 0.99, 0.9999])
def test_full_pixels_stop_as_in_the_twin(scene: Scene, opacity: float) -> None:
    """Many layers: most of the list lies behind pixels that are full, and alpha reaches its clamp."""
    arguments = scene(3000, 40, 40)
    arguments["opacity_logits"] = torch.full((3000, 1), opacity).logit() + 0.01 * torch.rand(3000, 1)
    found, grads = _gradients(arguments, "numba", torch.float32)
    expected, expected_grads = _gradients(arguments, "torch", torch.float64)
    assert expected.opacity.median() > 0.999
    for image, reference in zip(found, expected, strict=True):
        torch.testing.assert_close(image.double(), reference, rtol=0, atol=1e-5)
    for name, gradient in grads.items():
        # Worst measured 1.1e-5: what is behind a Gaussian is a difference, divided by 1 - alpha, here 1/100.
        assert _relative(gradient, expected_grads[name]) < 3e-5, name


@pytest.mark.parametrize("anisotropic", [False, True])
def test_one_and_two_threads_give_the_same_bits(scene: Scene, anisotropic: bool) -> None:
    arguments, before = scene(2000, 150, 100, anisotropic), torch.get_num_threads()
    results = []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            results.append(_gradients(arguments, "numba", torch.float32))
    finally:
        torch.set_num_threads(before)
    (one, grads_one), (two, grads_two) = results
    for a, b in zip((*one, *grads_one.values()), (*two, *grads_two.values()), strict=True):
        assert torch.equal(a, b)


def test_the_order_of_the_gaussians_does_not_matter(scene: Scene) -> None:
    arguments = scene(500)
    g = torch.Generator().manual_seed(1)
    orders = (torch.randperm(500, generator=g), morton_order(arguments["means"]))
    for order in orders:
        assert torch.equal(order.sort().values, torch.arange(500))
        shuffled = {k: v[order] if k not in ("T_camera_world", "camera") else v for k, v in arguments.items()}
        for a, b in zip(render(**arguments), render(**shuffled), strict=True):
            assert torch.equal(a, b)


def test_front_and_back_halves_composite_to_the_whole(scene: Scene) -> None:
    arguments = scene(200)
    arguments["opacity_logits"] -= 3  # thin enough for no pixel to fill
    T = arguments["T_camera_world"]
    depth = (arguments["means"] @ T[:3, :3].T + T[:3, 3])[:, 2]
    front = depth < depth.median()

    def part(chosen: Tensor) -> SplatRender:
        return render(**{k: v[chosen] if k not in ("T_camera_world", "camera") else v for k, v in arguments.items()})

    whole, near, far = render(**arguments), part(front), part(~front)
    through = 1 - near.opacity
    torch.testing.assert_close(near.rgb + through[..., None] * far.rgb, whole.rgb, rtol=0, atol=1e-6)
    torch.testing.assert_close(near.depth + through * far.depth, whole.depth, rtol=0, atol=5e-6)
    torch.testing.assert_close(near.opacity + through * far.opacity, whole.opacity, rtol=0, atol=1e-6)


@pytest.mark.parametrize("anisotropic", [False, True])
def test_the_pose_alone_gets_the_gradient_it_gets_with_the_map(scene: Scene, anisotropic: bool) -> None:
    arguments = scene(300, anisotropic=anisotropic)
    _, alone = _gradients(arguments, "numba", torch.float32, ("T_camera_world",))
    _, full = _gradients(arguments, "numba", torch.float32)
    assert _relative(alone["T_camera_world"], full["T_camera_world"]) < 1e-6
    assert alone["T_camera_world"][3].abs().max() == 0


@pytest.mark.parametrize("backend", ["numba", "torch"])
def test_nothing_to_see_is_black_with_zero_gradients(scene: Scene, backend: str) -> None:
    behind, aside, faint = scene(40), scene(40), scene(40)
    behind["means"][:, 2] -= 20
    aside["means"][:, 0] += 100
    faint["opacity_logits"][:] = -6.0  # opacity 0.0025 < 1/255
    empty = {k: v[:0] if k not in ("T_camera_world", "camera") else v for k, v in scene(40).items()}
    for arguments in (behind, aside, faint, empty):
        rendered, grads = _gradients(arguments, backend, torch.float32)
        assert all(image.abs().max() == 0 for image in rendered)
        assert all(g.abs().sum() == 0 for g in grads.values())


@pytest.mark.parametrize("backend", ["numba", "torch"])
def test_one_gaussian_has_the_closed_form(backend: str) -> None:
    """On the optical axis: variance (s f/z)^2 + 0.3, alpha = o exp(-r^2 / 2 var), nothing below 1/255."""
    camera = Pinhole(100.0, 100.0, 20.0, 15.0, 41, 31)
    one = torch.tensor([[0.0, 0.0, 2.0]]), torch.tensor([[0.06]]).log(), torch.tensor([[0.4]]).logit()
    color = torch.tensor([[0.1, 0.6, 0.8]])
    rendered = render(*one, color, torch.eye(4), camera, backend=backend)
    v, u = torch.meshgrid(torch.arange(31.0), torch.arange(41.0), indexing="ij")
    alpha = 0.4 * torch.exp(-((u - 20) ** 2 + (v - 15) ** 2) / (2 * (3.0**2 + 0.3)))
    alpha = torch.where(alpha >= 1 / 255, alpha, 0)
    torch.testing.assert_close(rendered.opacity, alpha, rtol=0, atol=1e-6)
    torch.testing.assert_close(rendered.depth, 2 * alpha, rtol=0, atol=2e-6)
    torch.testing.assert_close(rendered.rgb, alpha[..., None] * color[0], rtol=0, atol=1e-6)


def test_a_gaussian_wider_than_the_image_reaches_every_pixel() -> None:
    camera = Pinhole(50.0, 50.0, 60.0, 40.0, 120, 80)
    means = torch.tensor([[30.0, 0.0, 5.0]])  # its centre is 240 px right of the image
    arguments = (means, torch.tensor([[25.0]]).log(), torch.tensor([[5.0]]), torch.ones(1, 3), torch.eye(4), camera)
    found, expected = render(*arguments, backend="numba"), render(*arguments, backend="torch")
    assert expected.opacity.min() > 0.1
    torch.testing.assert_close(found.opacity, expected.opacity, rtol=0, atol=1e-6)


def test_not_a_number_is_not_drawn(scene: Scene) -> None:
    arguments = scene(50)
    clean = render(**{k: v[3:] if k not in ("T_camera_world", "camera") else v for k, v in arguments.items()})
    arguments["means"][0] = float("nan")
    arguments["log_scales"][1] = float("nan")
    arguments["opacity_logits"][2] = float("nan")
    for a, b in zip(render(**arguments, backend="numba"), clean, strict=True):
        assert torch.equal(a, b)


def test_images_are_released_after_the_backward(scene: Scene) -> None:
    """A graph that refers to its own output would keep every frame's buffers until the garbage collector runs."""
    import gc
    import weakref

    gc.collect()
    gc.disable()
    try:
        arguments = scene(50)
        arguments["means"].requires_grad_()
        rendered = render(**arguments)
        alive = weakref.ref(rendered.rgb)
        rendered.rgb.sum().backward()
        del rendered
        assert alive() is None
    finally:
        gc.enable()


def test_changing_an_image_in_place_is_refused_by_the_backward(scene: Scene) -> None:
    arguments = scene(50)
    arguments["means"].requires_grad_()
    rendered = render(**arguments)
    rendered.rgb.detach().clamp_(max=0.5)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        rendered.rgb.sum().backward()


def test_float64_is_refused_by_the_kernel_and_taken_by_the_twin(scene: Scene) -> None:
    arguments = {k: v.double() if isinstance(v, Tensor) else v for k, v in scene(20).items()}
    assert render(**arguments).rgb.dtype == torch.float64
    with pytest.raises(ConfigError, match=r"float32 on the CPU, got torch\.float64 on cpu"):
        render(**arguments, backend="numba")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"colors": torch.zeros(3, 3)}, r"colors \(3, 3\) for \(20, 3\)"),
        ({"log_scales": torch.zeros(20, 3)}, r"three scales need quats_wxyz"),
        ({"opacity_logits": torch.zeros(20, 2)}, r"opacity_logits"),
        ({"near": 0.0}, r"near=0\.0"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(scene: Scene, change: dict[str, Any], message: str) -> None:
    arguments = scene(20) | change
    with pytest.raises((ConfigError, TypeError), match=message if "near" in change else None):
        render(**arguments)
