"""The one entry: checks the arguments and picks the renderer by device and dtype."""

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.core.errors import ConfigError
from xrdslam.ops.splats.tile_lists import TileLists
from xrdslam.ops.splats.twin import render_torch
from xrdslam.ops.splats.types import PinholeLike, SplatRender

__all__ = ["render"]


def render(
    means: Float[Tensor, "n 3"],
    log_scales: Float[Tensor, "n k"],
    opacity_logits: Float[Tensor, "n 1"] | Float[Tensor, " n"],
    colors: Float[Tensor, "n 3"],
    T_camera_world: Float[Tensor, "4 4"],
    camera: PinholeLike,
    *,
    quats_wxyz: Float[Tensor, "n 4"] | None = None,
    near: float = 0.2,
    lowpass: float = 0.3,
    backend: Literal["auto", "numba", "torch"] = "auto",
    lists: TileLists | None = None,
) -> SplatRender:
    """Render 3-D Gaussians to colour, depth and opacity in one pass, differentiable in every tensor argument.

    means: centres [m, world]. log_scales: ln of the standard deviation [m]; one column is isotropic, three are the axes
    of the rotation `quats_wxyz` (of any length). opacity_logits: opacity o = sigmoid. colors: used as they are.
    near [m]: Gaussians with z <= near are not drawn. lowpass [px^2]: added to both variances in the image.

    EWA splatting with the full perspective shear: cov = J R cov_world R^T J^T + lowpass I, p = -d^T cov^-1 d / 2,
    alpha = min(0.99, o e^p), front to back over a black background. Not blended: alpha < 1/255; and the Gaussian that
    would take the transmittance below 1e-4, with all behind it. x/z in J is clamped to 1.3 half fields of view, and a
    clamped value is a constant to the gradient. The gradient of T_camera_world treats its upper 3x4 entries as free.

    Deviations from the rasteriser of 3DGS: pixel (0, 0) is a centre (no half-pixel shift), footprints are exact where
    theirs end at 3 sigma, and the gradient through min(0.99, .) is exact (zero), where theirs passes.

    backend: "numba" (CPU, float32), "torch" (anything), "auto" picks numba where it can. lists: tile lists to use again
    in the next render of the same map from a nearby pose; the torch renderer has none and ignores them.
    """
    _check(means, log_scales, opacity_logits, colors, T_camera_world, quats_wxyz, near)
    tensors = [t for t in (means, log_scales, opacity_logits, colors, T_camera_world, quats_wxyz) if t is not None]
    fits = all(t.device.type == "cpu" and t.dtype == torch.float32 for t in tensors)
    if backend == "torch" or (backend == "auto" and not fits):
        logits = opacity_logits.reshape(-1, 1)
        return render_torch(
            means, log_scales, logits, colors, T_camera_world, camera, quats_wxyz, near=near, lowpass=lowpass
        )
    if not fits:
        found = sorted({f"{t.dtype} on {t.device}" for t in tensors})
        raise ConfigError(f"backend='numba' renders float32 on the CPU, got {', '.join(found)}; use backend='torch'")
    from xrdslam.ops.splats.rasteriser import render_numba  # here, so that the torch renderer needs no numba

    return render_numba(
        means, log_scales, opacity_logits, colors, T_camera_world, camera, quats_wxyz,
        near=near, lowpass=lowpass, lists=lists,
    )  # fmt: skip


def _check(
    means: Tensor, log_scales: Tensor, logits: Tensor, colors: Tensor, pose: Tensor, quats: Tensor | None, near: float
) -> None:
    """Refuse shapes that would be read out of bounds."""
    n = means.shape[0]
    columns = 1 if quats is None else 3
    shapes = {"means": (n, 3), "log_scales": (n, columns), "colors": (n, 3), "T_camera_world": (4, 4)}
    given = {"means": means, "log_scales": log_scales, "colors": colors, "T_camera_world": pose}
    if quats is not None:
        shapes["quats_wxyz"], given["quats_wxyz"] = (n, 4), quats
    wrong = [f"{k} {tuple(t.shape)} for {shapes[k]}" for k, t in given.items() if tuple(t.shape) != shapes[k]]
    if logits.shape not in ((n,), (n, 1)):
        wrong.append(f"opacity_logits {tuple(logits.shape)} for {(n, 1)}")
    if wrong:
        raise ConfigError(f"Gaussians of inconsistent shapes: {'; '.join(wrong)} (three scales need quats_wxyz)")
    if not near > 0:
        raise ConfigError(f"near={near}: the nearest depth drawn must be positive")
