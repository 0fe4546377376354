"""The plain torch twin of TSDF integration: the oracle of the kernel."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.geometry import se3

__all__ = ["integrate"]


def _bilinear(image: Float[Tensor, "h w c"], u: Float[Tensor, " n"], v: Float[Tensor, " n"]) -> Float[Tensor, "n c"]:
    u0 = u.floor().long().clamp(0, image.shape[1] - 2)
    v0 = v.floor().long().clamp(0, image.shape[0] - 2)
    s, r = (u - u0)[:, None], (v - v0)[:, None]
    upper = (1 - s) * image[v0, u0] + s * image[v0, u0 + 1]
    lower = (1 - s) * image[v0 + 1, u0] + s * image[v0 + 1, u0 + 1]
    return (1 - r) * upper + r * lower


def _is_smooth(depth: Float[Tensor, "h w"], u: Float[Tensor, " n"], v: Float[Tensor, " n"], step_m: float) -> Tensor:
    """Say where (u, v) has four neighbours, all measured, that differ by less than `step_m`."""
    height, width = depth.shape
    u0, v0 = u.floor().long().clamp(0, width - 2), v.floor().long().clamp(0, height - 2)
    four = torch.stack((depth[v0, u0], depth[v0, u0 + 1], depth[v0 + 1, u0], depth[v0 + 1, u0 + 1]))
    inside = (u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)
    return inside & (four.amin(0) > 0) & (four.amax(0) - four.amin(0) < step_m)


def _share(new: Float[Tensor, " n"], total: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    return torch.where(new > 0, new / torch.where(new > 0, total, torch.ones_like(total)), torch.zeros_like(new))


def integrate(
    samples: Int[Tensor, "n 3"],
    tsdf: Float[Tensor, " n"],
    weights: Float[Tensor, " n"],
    colors: Float[Tensor, "n 4"],
    rgb: Float[Tensor, "h w 3"],
    depth: Float[Tensor, "h w"],
    pixel_weights: Float[Tensor, "h w"],
    camera: Camera,
    T_world_camera: Float[Tensor, "4 4"],
    voxel_m: float,
    truncation_m: float,
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"], Float[Tensor, "n 4"]]:
    """Return (tsdf, weights, colors) of samples at voxel_m * `samples` after averaging one view in.

    Distance is measured along z (projective), d = depth(u, v) - z, clipped to [-truncation_m, truncation_m] and divided
    by it; samples farther behind the surface are left alone (Curless and Levoy, 1996). Behind the surface the weight
    falls linearly from one voxel to the truncation, which spares thin things seen from both sides (Oleynikova et al.,
    IROS 2017). Depth and colour are read bilinearly, or at the nearest pixel where the four neighbours are not one
    surface: they differ by more than the truncation, or one was not measured. Colour has a weight of its own (the
    fourth of `colors`) and is averaged only where the surface is within the truncation: what is seen through free space
    is another surface's colour.
    """
    points = se3.transform(se3.inverse(T_world_camera.double()), samples.double() * voxel_m)
    z = points[:, 2]
    in_front = z > 0
    safe = torch.where(in_front, z, torch.ones_like(z))
    u = camera.fx * points[:, 0] / safe + camera.cx
    v = camera.fy * points[:, 1] / safe + camera.cy
    height, width = depth.shape
    seen = in_front & (u >= -0.5) & (u < width - 0.5) & (v >= -0.5) & (v < height - 0.5)
    u, v = torch.where(seen, u, torch.zeros_like(u)), torch.where(seen, v, torch.zeros_like(v))
    column, line = (u + 0.5).floor().long(), (v + 0.5).floor().long()
    smooth = _is_smooth(depth, u, v, truncation_m)
    stacked = torch.cat((depth[..., None], rgb), -1).double()
    values = torch.where(smooth[:, None], _bilinear(stacked, u, v), stacked[line, column])
    distance = values[:, 0] - z
    falloff = ((truncation_m + distance) / (truncation_m - voxel_m)).clamp(max=1)
    new = pixel_weights[line, column].double() * falloff
    used = seen & (depth[line, column] > 0) & (distance > -truncation_m) & (new > 0)
    new = torch.where(used, new, torch.zeros_like(new))
    total = weights + new
    tsdf = tsdf + _share(new, total) * ((distance / truncation_m).clamp(max=1) - tsdf)
    new_color = torch.where(distance < truncation_m, new, torch.zeros_like(new))
    total_color = colors[:, 3] + new_color
    mixed = colors[:, :3] + _share(new_color, total_color)[:, None] * (values[:, 1:] - colors[:, :3])
    return tsdf, total, torch.cat((mixed, total_color[:, None]), -1)
