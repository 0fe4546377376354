"""Rigid motions as 4x4 matrices: points_a = T_a_b points_b."""

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["compose", "inverse", "is_rigid", "transform"]


def compose(
    rotation: Float[Tensor, "*batch 3 3"], translation: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch 4 4"]:
    """Build T_a_b from R_a_b and the origin of b in a [m]."""
    upper = torch.cat((rotation, translation[..., None]), -1)
    bottom = upper.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*upper.shape[:-2], 1, 4)
    return torch.cat((upper, bottom), -2)


def inverse(T_a_b: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 4 4"]:
    """Return T_b_a = (R^T, -R^T t): exact for rigid motions, where a general inverse only comes near."""
    rotation = T_a_b[..., :3, :3].mT
    return compose(rotation, -(rotation @ T_a_b[..., :3, 3:])[..., 0])


def transform(T_a_b: Float[Tensor, "4 4"], points_b: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Return points_a = R points_b + t."""
    return points_b @ T_a_b[:3, :3].mT + T_a_b[:3, 3]


def is_rigid(T_a_b: Float[Tensor, "*batch 4 4"], tolerance: float = 1e-3) -> bool:
    """Say whether all matrices are finite, orthonormal within `tolerance`, right-handed, with a bottom row 0 0 0 1."""
    if not bool(torch.isfinite(T_a_b).all()):
        return False
    R = T_a_b[..., :3, :3].double()
    orthonormal = (R @ R.mT - torch.eye(3, dtype=torch.float64, device=R.device)).abs().max() < tolerance
    bottom = (T_a_b[..., 3, :].double() - T_a_b.new_tensor([0, 0, 0, 1]).double()).abs().max() < tolerance
    return bool(orthonormal & bottom & (torch.linalg.det(R) > 0).all())
