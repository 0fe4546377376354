"""The splat renderer in plain torch: any device, any dtype, differentiated by autograd; the oracle of the kernels."""

import itertools
import math

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from xrdslam.ops.splats.types import (
    ALPHA_MAX,
    ALPHA_MIN,
    FRUSTUM_CLAMP,
    TRANSMITTANCE_MIN,
    PinholeLike,
    SplatRender,
)

__all__ = ["project", "render_torch"]

_PAIRS_PER_BAND = 4_000_000
"""Pixel-Gaussian pairs worked on at once; an image with more is rendered in bands, recomputed in the backward."""


def render_torch(
    means: Float[Tensor, "n 3"],
    log_scales: Float[Tensor, "n k"],
    opacity_logits: Float[Tensor, "n 1"],
    colors: Float[Tensor, "n 3"],
    T_camera_world: Float[Tensor, "4 4"],
    camera: PinholeLike,
    quats_wxyz: Float[Tensor, "n 4"] | None = None,
    *,
    near: float = 0.2,
    lowpass: float = 0.3,
) -> SplatRender:
    """Render Gaussians; see `xrdslam.ops.splats.render` for the meaning of the arguments.

    Sorts by depth, lists the pixels of every footprint, sorts the pairs by pixel, scans log-transmittance per pixel.
    """
    features = project(means, log_scales, opacity_logits, colors, T_camera_world, camera, quats_wxyz, near, lowpass)
    image = features.new_zeros(camera.height * camera.width, 5)
    boxes = _pixel_boxes(features.detach(), camera)
    for band, top, bottom in _bands(boxes, camera):
        flat, pairs = _pairs(features.detach(), boxes, band, top, bottom, camera.width)
        if features.requires_grad and bottom - top < camera.height:
            values = checkpoint(_composite, features, flat, pairs, camera.width, use_reentrant=False)
        else:
            values = _composite(features, flat, pairs, camera.width)
        image = image.index_add(0, flat, values)
    image = image.view(camera.height, camera.width, 5)
    return SplatRender(image[..., :3], image[..., 3], image[..., 4])


def project(
    means: Float[Tensor, "n 3"],
    log_scales: Float[Tensor, "n k"],
    opacity_logits: Float[Tensor, "n 1"],
    colors: Float[Tensor, "n 3"],
    T_camera_world: Float[Tensor, "4 4"],
    camera: PinholeLike,
    quats_wxyz: Float[Tensor, "n 4"] | None,
    near: float,
    lowpass: float,
) -> Float[Tensor, "visible 10"]:
    """Return (u, v, A, B, C, opacity, r, g, b, z) of the Gaussians in front of `near`, nearest first.

    The image-plane covariance is J cov J^T + lowpass I, J the derivative of the projection with x/z clamped; (A, B, C)
    is its inverse (EWA splatting, Zwicker et al. 2001).
    """
    points = means @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
    kept = (points.detach()[:, 2] > near).nonzero().squeeze(1)
    kept = kept[torch.argsort(points.detach()[kept, 2], stable=True)]
    x, y, z = points[kept].unbind(1)
    tx = _clamped(x, z, FRUSTUM_CLAMP * camera.width / (2 * camera.fx))
    ty = _clamped(y, z, FRUSTUM_CLAMP * camera.height / (2 * camera.fy))
    o = torch.zeros_like(z)
    J = torch.stack((camera.fx / z, o, -camera.fx * tx / z**2, o, camera.fy / z, -camera.fy * ty / z**2), 1).view(
        -1, 2, 3
    )
    if quats_wxyz is None:
        root = J * log_scales[kept].exp()[:, None, :]
    else:
        root = J @ T_camera_world[:3, :3] @ rotation_matrix(quats_wxyz[kept]) * log_scales[kept].exp()[:, None, :]
    cov = root @ root.transpose(1, 2)
    a, b, c = cov[:, 0, 0] + lowpass, cov[:, 0, 1], cov[:, 1, 1] + lowpass
    det = a * c - b * b
    uv = (camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy)
    opacity = torch.sigmoid(opacity_logits[kept, 0])
    return torch.cat((torch.stack((*uv, c / det, -b / det, a / det, opacity), 1), colors[kept], z[:, None]), 1)


def rotation_matrix(quats_wxyz: Float[Tensor, "n 4"]) -> Float[Tensor, "n 3 3"]:
    """Return the rotations of quaternions that need not have unit length."""
    w, x, y, z = (quats_wxyz / quats_wxyz.norm(dim=1, keepdim=True)).unbind(1)
    entries = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, 1) for row in entries], 1)


def _clamped(x: Float[Tensor, " n"], z: Float[Tensor, " n"], limit: float) -> Float[Tensor, " n"]:
    """Return x where |x/z| <= limit; beyond, the limit times z as a constant."""
    ratio = (x / z).detach()
    return torch.where(ratio.abs() <= limit, x, ratio.clamp(-limit, limit) * z.detach())


def _pixel_boxes(features: Float[Tensor, "n 10"], camera: PinholeLike) -> Int[Tensor, "n 4"]:
    """Return (left, right, top, bottom) [px, inclusive] of the ellipse where alpha >= `ALPHA_MIN`, cut to the image.

    The ellipse A dx^2 + 2 B dx dy + C dy^2 = k reaches sqrt(k C / (AC - B^2)) sideways. A tenth of a pixel is added:
    the pairs are tested one by one afterwards.
    """
    u, v, A, B, C, opacity = features[:, :6].unbind(1)
    k = 2 * torch.log(opacity / ALPHA_MIN)
    det = A * C - B * B
    half_u, half_v = ((k * side / det).clamp(min=0).sqrt() + 0.1 for side in (C, A))
    edges = (
        (u - half_u).ceil().clamp(0, camera.width),
        (u + half_u).floor().clamp(-1, camera.width - 1),
        (v - half_v).ceil().clamp(0, camera.height),
        (v + half_v).floor().clamp(-1, camera.height - 1),
    )
    boxes = torch.stack(edges, 1).nan_to_num(-1).long()
    boxes[~(k > 0)] = torch.tensor([1, 0, 1, 0], device=boxes.device)
    return boxes


def _bands(boxes: Int[Tensor, "n 4"], camera: PinholeLike) -> list[tuple[Int[Tensor, " m"], int, int]]:
    """Cut the image into bands of rows of about equal work: (Gaussians that touch it, first row, row past the last)."""
    area = (boxes[:, 1] - boxes[:, 0] + 1).clamp(min=0) * (boxes[:, 3] - boxes[:, 2] + 1).clamp(min=0)
    count = min(camera.height, math.ceil(int(area.sum()) / _PAIRS_PER_BAND))
    edges = [camera.height * k // max(count, 1) for k in range(max(count, 1) + 1)]
    bands = []
    for top, bottom in itertools.pairwise(edges):
        touched = (boxes[:, 0] <= boxes[:, 1]) & (boxes[:, 2] < bottom) & (boxes[:, 3] >= top) & (area > 0)
        bands.append((touched.nonzero().squeeze(1), top, bottom))
    return bands


def _pairs(
    features: Float[Tensor, "n 10"],
    boxes: Int[Tensor, "n 4"],
    band: Int[Tensor, " m"],
    top: int,
    bottom: int,
    width: int,
) -> tuple[Int[Tensor, " pairs"], Int[Tensor, " pairs"]]:
    """List (flat pixel, Gaussian) of every pair with alpha >= `ALPHA_MIN` in a band, by pixel, nearest first."""
    left, right, first, last = boxes[band].unbind(1)
    first, last = first.clamp(min=top), last.clamp(max=bottom - 1)
    columns = right - left + 1
    area = columns * (last - first + 1)
    owner = torch.repeat_interleave(torch.arange(len(band), device=band.device), area)
    k = torch.arange(len(owner), device=band.device) - (area.cumsum(0) - area)[owner]
    u = left[owner] + k % columns[owner]
    v = first[owner] + torch.div(k, columns[owner], rounding_mode="floor")
    gaussian = band[owner]
    drawn = _alpha(features[gaussian], u, v) >= ALPHA_MIN
    flat, order = torch.sort((v * width + u)[drawn], stable=True)
    return flat, gaussian[drawn][order]


def _alpha(
    features: Float[Tensor, "pairs 10"], u: Int[Tensor, " pairs"], v: Int[Tensor, " pairs"]
) -> Float[Tensor, " pairs"]:
    """Return opacity * exp(-(A dx^2 + C dy^2)/2 - B dx dy), not yet clamped."""
    dx, dy = u - features[:, 0], v - features[:, 1]
    A, B, C = features[:, 2:5].unbind(1)
    return features[:, 5] * torch.exp(-0.5 * (A * dx * dx + C * dy * dy) - B * dx * dy)


def _composite(
    features: Float[Tensor, "n 10"], flat: Int[Tensor, " pairs"], pairs: Int[Tensor, " pairs"], width: int
) -> Float[Tensor, "pairs 5"]:
    """Return what every pair adds to its pixel: (r, g, b, z, 1) * alpha * T.

    T is the product of (1 - alpha) over the pairs before it in its pixel, scanned in float64. T never rises, so leaving
    out whatever takes it below the limit, without ending the scan, is the same as stopping there.
    """
    own = features[pairs]
    alpha = _alpha(own, flat % width, torch.div(flat, width, rounding_mode="floor")).clamp(max=ALPHA_MAX)
    log_keep = torch.log1p(-alpha.double())
    before = log_keep.cumsum(0) - log_keep
    start = torch.searchsorted(flat, flat)  # the first pair of the same pixel
    T = torch.exp(before - before[start])
    drawn = (T * (1 - alpha)).detach() >= TRANSMITTANCE_MIN
    weight = torch.where(drawn, alpha * T, 0).to(own.dtype)
    return weight[:, None] * torch.cat((own[:, 6:], torch.ones_like(weight)[:, None]), 1)
