"""The torch renderer against a scalar loop over pixels, finite differences, and closed forms."""

import math
from collections.abc import Callable
from typing import Any, Literal

import pytest
import torch
from torch import Tensor

from xrdslam.ops.splats import Pinhole, SplatRender, render, twin

Scene = Callable[..., dict[str, Any]]


def _double(arguments: dict[str, Any]) -> dict[str, Any]:
    return {k: v.double() if isinstance(v, Tensor) else v for k, v in arguments.items()}


def _scalar_reference(
    means: Tensor, log_scales: Tensor, opacity_logits: Tensor, colors: Tensor, T_camera_world: Tensor, camera: Pinhole,
    quats_wxyz: Tensor | None = None,
) -> list[list[list[float]]]:  # fmt: skip
    """Render pixel by pixel with Python floats, straight from the equations (conic by Cramer's rule, no culling)."""
    gaussians = []
    for i in range(len(means)):
        x, y, z = (T_camera_world[:3, :3] @ means[i] + T_camera_world[:3, 3]).tolist()
        if z <= 0.2:
            continue
        if quats_wxyz is None:
            cov = torch.eye(3, dtype=torch.float64) * math.exp(2 * log_scales[i, 0].item())
        else:
            w, a, b, c = (quats_wxyz[i] / quats_wxyz[i].norm()).tolist()
            axis = torch.tensor([[0, -c, b], [c, 0, -a], [-b, a, 0]], dtype=torch.float64)
            R = torch.eye(3, dtype=torch.float64) + 2 * w * axis + 2 * axis @ axis
            R = T_camera_world[:3, :3] @ R
            cov = R @ torch.diag((2 * log_scales[i]).exp()) @ R.T
        lim_x, lim_y = 1.3 * camera.width / (2 * camera.fx), 1.3 * camera.height / (2 * camera.fy)
        tx, ty = max(-lim_x, min(lim_x, x / z)), max(-lim_y, min(lim_y, y / z))
        J = torch.tensor(
            [[camera.fx / z, 0, -camera.fx * tx / z], [0, camera.fy / z, -camera.fy * ty / z]], dtype=torch.float64
        )
        cov2 = J @ cov @ J.T + 0.3 * torch.eye(2, dtype=torch.float64)
        opacity = 1 / (1 + math.exp(-opacity_logits[i, 0].item()))
        centre = (camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy)
        gaussians.append((z, centre, cov2.inverse().tolist(), opacity, [*colors[i].tolist(), z, 1.0]))
    gaussians.sort(key=lambda entry: entry[0])
    return [[_pixel(gaussians, u, v) for u in range(camera.width)] for v in range(camera.height)]


def _pixel(gaussians: list[Any], u: int, v: int) -> list[float]:
    out, T = [0.0] * 5, 1.0
    for _, (cu, cv), conic, opacity, features in gaussians:
        dx, dy = u - cu, v - cv
        power = -0.5 * (conic[0][0] * dx * dx + 2 * conic[0][1] * dx * dy + conic[1][1] * dy * dy)
        alpha = min(0.99, opacity * math.exp(power))
        if alpha < 1 / 255:
            continue
        if T * (1 - alpha) < 1e-4:
            break
        out = [o + f * alpha * T for o, f in zip(out, features, strict=True)]
        T *= 1 - alpha
    return out


@pytest.mark.parametrize("anisotropic", [False, True])
def test_agrees_with_a_scalar_loop_over_pixels(scene: Scene, anisotropic: bool) -> None:
    arguments = _double(scene(60, 24, 18, anisotropic))
    arguments["opacity_logits"] = arguments["opacity_logits"] + 2  # enough to fill pixels: the stop is reached
    expected = torch.tensor(_scalar_reference(**arguments), dtype=torch.float64)
    found = render(**arguments)
    assert expected[..., 4].max() > 0.9998
    torch.testing.assert_close(torch.cat((found.rgb, found.depth[..., None], found.opacity[..., None]), 2), expected,
                               rtol=0, atol=1e-12)  # fmt: skip


def _within_the_frustum_clamp(arguments: dict[str, Any]) -> dict[str, Any]:
    """Keep the Gaussians whose gradient is that of the image: beyond the clamp it is, by convention, not."""
    T, camera = arguments["T_camera_world"], arguments["camera"]
    x, y, z = (arguments["means"] @ T[:3, :3].T + T[:3, 3]).unbind(1)
    kept = (x / z).abs() < 1.25 * camera.width / 2 / camera.fx
    kept &= (y / z).abs() < 1.25 * camera.height / 2 / camera.fy
    return {k: v[kept] if k not in ("T_camera_world", "camera") else v for k, v in arguments.items()}


@pytest.mark.parametrize("anisotropic", [False, True])
def test_gradients_are_finite_differences(scene: Scene, anisotropic: bool) -> None:
    arguments = _double(_within_the_frustum_clamp(scene(14, 24, 18, anisotropic, seed=3)))
    assert len(arguments["means"]) >= 6
    names = ["means", "log_scales", "opacity_logits", "colors", "T_camera_world"] + ["quats_wxyz"] * anisotropic
    inputs = [arguments.pop(name).requires_grad_() for name in names]

    def images(*tensors: Tensor) -> tuple[Tensor, ...]:
        return tuple(render(**dict(zip(names, tensors, strict=True)), **arguments))

    assert torch.autograd.gradcheck(images, inputs, eps=1e-7, atol=2e-6, rtol=1e-6)


def test_bands_give_what_the_whole_image_gives(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> list[Tensor]:
        arguments = _double(scene())
        arguments["means"].requires_grad_()
        rendered = render(**arguments)
        weights = [torch.linspace(-1, 1, image.numel(), dtype=torch.float64).view_as(image) for image in rendered]
        sum((w * image).sum() for w, image in zip(weights, rendered, strict=True)).backward()
        return [*rendered, arguments["means"].grad]

    whole = run()
    monkeypatch.setattr(twin, "_PAIRS_PER_BAND", 2000)
    for band, image in zip(run(), whole, strict=True):
        torch.testing.assert_close(band, image, rtol=1e-9, atol=1e-9)


def _plane(lowpass: float, backend: Literal["numba", "torch"]) -> SplatRender:
    """Render the plane z = 2 m seeded as SplaTAM does: one Gaussian a pixel, opacity 1/2, one pixel wide."""
    camera = Pinhole(600.0, 600.0, 31.5, 23.5, 64, 48)
    v, u = torch.meshgrid(torch.arange(48.0), torch.arange(64.0), indexing="ij")
    means = torch.stack(((u - camera.cx) / 600 * 2, (v - camera.cy) / 600 * 2, torch.full_like(u, 2.0)), -1).view(-1, 3)
    n = len(means)
    log_scales, logits = torch.full((n, 1), math.log(2 / 600)), torch.zeros(n, 1)
    colors = torch.tensor([0.2, 0.5, 0.9]).expand(n, 3).contiguous()
    return render(means, log_scales, logits, colors, torch.eye(4), camera, lowpass=lowpass, backend=backend)


@pytest.mark.parametrize("backend", ["torch", "numba"])
def test_a_seeded_plane_has_the_silhouette_that_the_threshold_of_0_99_assumes(
    backend: Literal["numba", "torch"],
) -> None:
    rendered = _plane(0.3, backend)
    S = rendered.opacity[16:32, 16:48]
    assert S.min() > 0.990
    assert S.max() < 0.992
    torch.testing.assert_close(rendered.depth[16:32, 16:48] / S, torch.full_like(S, 2.0), rtol=0, atol=1e-4)
    colour = (rendered.rgb[16:32, 16:48] / S[..., None]).flatten(0, 1)
    torch.testing.assert_close(colour, torch.tensor([0.2, 0.5, 0.9]).expand_as(colour), rtol=0, atol=1e-5)
    assert abs(_plane(0.0, backend).opacity[16:32, 16:48].mean() - 0.974) < 1e-3
