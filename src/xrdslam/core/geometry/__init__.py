"""Rotations and rigid motions: plain functions on tensors, exact at the identity and near half a turn."""

from xrdslam.core.geometry import se3, so3

__all__ = ["se3", "so3"]
