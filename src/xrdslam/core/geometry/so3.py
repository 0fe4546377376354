"""Rotations: rotation vectors, unit quaternions (w, x, y, z) and matrices, with exact gradients at every switch."""

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["exp", "from_quat_wxyz", "log", "quat_wxyz_from_rotation_vector", "skew", "to_quat_wxyz"]


def skew(omega: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Return W with W @ v = omega x v."""
    x, y, z = omega.unbind(-1)
    zero = torch.zeros_like(x)
    rows = (zero, -z, y, z, zero, -x, -y, x, zero)
    return torch.stack(rows, -1).reshape(*rows[0].shape, 3, 3)


def exp(omega: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Map rotation vectors [rad] to rotation matrices.

    R = I + a W + b W^2 with a = sin(t)/t, b = (1 - cos t)/t^2, t = |omega|  (Rodrigues' formula).

    a and b are even in t: below t^2 < eps^(1/3) their series in t^2 replace them, and 1 - cos t = 2 sin^2(t/2) avoids
    cancellation above it; value *and* gradient stay exact at the identity, where tracking starts.
    """
    t2 = (omega * omega).sum(-1)
    small = t2 < torch.finfo(omega.dtype).eps ** (1 / 3)
    safe = torch.where(small, torch.ones_like(t2), t2)  # keeps NaN out of the unused branch's gradient
    t = safe.sqrt()
    a = torch.where(small, 1 - t2 / 6 * (1 - t2 / 20 * (1 - t2 / 42)), t.sin() / t)
    half = (t / 2).sin()
    b = torch.where(small, 0.5 - t2 / 24 * (1 - t2 / 30 * (1 - t2 / 56)), 2 * half * half / safe)
    W = skew(omega)
    identity = torch.eye(3, dtype=omega.dtype, device=omega.device)
    return identity + a[..., None, None] * W + b[..., None, None] * (W @ W)


def from_quat_wxyz(quat_wxyz: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3 3"]:
    """Map quaternions of any non-zero length to rotation matrices: q and -q, q and 2q give the same rotation."""
    w, x, y, z = (quat_wxyz / quat_wxyz.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return torch.stack(rows, -1).reshape(*rows[0].shape, 3, 3)


def to_quat_wxyz(rotation: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 4"]:
    """Map rotation matrices to unit quaternions with w >= 0, dividing by the largest component only (Shepperd, 1978).

    Each row of `candidates` is 4 q_k q; the row with the largest q_k is well conditioned also at half a turn.
    """
    m = [[rotation[..., i, j] for j in range(3)] for i in range(3)]
    trace = m[0][0] + m[1][1] + m[2][2]
    squares = torch.stack(
        (1 + trace, 1 + 2 * m[0][0] - trace, 1 + 2 * m[1][1] - trace, 1 + 2 * m[2][2] - trace), -1
    )  # 4 q_k^2
    wx, wy, wz = m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]
    xy, xz, yz = m[0][1] + m[1][0], m[0][2] + m[2][0], m[1][2] + m[2][1]
    s = squares.unbind(-1)
    rows = (s[0], wx, wy, wz, wx, s[1], xy, xz, wy, xy, s[2], yz, wz, xz, yz, s[3])
    candidates = torch.stack(rows, -1).reshape(*wx.shape, 4, 4)
    best = squares.detach().argmax(-1)
    index = best[..., None, None].expand(*best.shape, 1, 4)
    quat_wxyz = candidates.gather(-2, index).squeeze(-2)
    quat_wxyz = quat_wxyz / quat_wxyz.norm(dim=-1, keepdim=True)
    return torch.where(quat_wxyz[..., :1] < 0, -quat_wxyz, quat_wxyz)


def log(rotation: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3"]:
    """Map rotation matrices to rotation vectors [rad] of length at most pi.

    Through the unit quaternion: omega = 2 atan2(|v|, w) v / |v|; near the identity 2 atan2(|v|, w) / |v| is replaced by
    its series in r = |v|/w, 2/w (1 - r^2/3 + r^4/5 - ...), whose gradient is exact at zero.
    """
    quat_wxyz = to_quat_wxyz(rotation)
    w, v = quat_wxyz[..., 0], quat_wxyz[..., 1:]
    v2 = (v * v).sum(-1)
    small = v2 < torch.finfo(rotation.dtype).eps ** (1 / 3)
    norm = torch.where(small, torch.ones_like(v2), v2).sqrt()
    w_safe = torch.where(small, w, torch.ones_like(w))
    r2 = v2 / (w_safe * w_safe)
    series = 2 / w_safe * (1 - r2 * (1 / 3 - r2 * (1 / 5 - r2 * (1 / 7 - r2 / 9))))
    factor = torch.where(small, series, 2 * torch.atan2(norm, w) / norm)
    return factor[..., None] * v


def quat_wxyz_from_rotation_vector(omega: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 4"]:
    """Map rotation vectors [rad] to unit quaternions: (cos(t/2), sin(t/2)/t omega)."""
    return to_quat_wxyz(exp(omega))
