"""Scenes for the splat tests: random, with all that can happen to a Gaussian, small enough for slow references."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from xrdslam.ops.splats import Pinhole


def _pose() -> Tensor:
    omega = torch.tensor([[0.0, -0.07, -0.1], [0.07, 0.0, -0.05], [0.1, 0.05, 0.0]])
    T = torch.eye(4)
    T[:3, :3] = torch.matrix_exp(omega)
    T[:3, 3] = torch.tensor([0.05, -0.03, 0.1])
    return T


@pytest.fixture
def scene() -> Callable[..., dict[str, Any]]:
    """Return a maker of arguments for `render`.

    Gaussians from 0.4 to 5 px wide, opacities from 0.02 to 0.998, a third outside the image, some behind `near`.
    """

    def make(
        n: int = 300, width: int = 70, height: int = 50, anisotropic: bool = False, seed: int = 0
    ) -> dict[str, Any]:
        g = torch.Generator().manual_seed(seed)
        camera = Pinhole(0.8 * width, 0.82 * width, width / 2 - 0.3, height / 2 + 0.2, width, height)
        z = 0.6 + 3 * torch.rand(n, generator=g)
        z[: n // 30] = 0.1
        u, v = (s * (1.6 * torch.rand(n, generator=g) - 0.3) for s in (width, height))
        points = torch.stack(((u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z), 1)
        log_scales = (z / camera.fx * (0.4 + 4.6 * torch.rand(n, generator=g))).log()[:, None]
        T = _pose()
        arguments: dict[str, Any] = {
            "means": (points - T[:3, 3]) @ T[:3, :3],
            "log_scales": log_scales + 0.5 * torch.randn(n, 3, generator=g) if anisotropic else log_scales,
            "opacity_logits": 2 * torch.randn(n, 1, generator=g) + 0.5,
            "colors": torch.rand(n, 3, generator=g),
            "T_camera_world": T,
            "camera": camera,
        }
        if anisotropic:
            arguments["quats_wxyz"] = torch.randn(n, 4, generator=g)
        return arguments

    return make
