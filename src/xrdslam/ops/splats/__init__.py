"""Gaussian splatting: colour, depth and silhouette of 3-D Gaussians, differentiable in the map and the pose."""

from xrdslam.ops.splats.dispatch import render
from xrdslam.ops.splats.ordering import morton_order
from xrdslam.ops.splats.tile_lists import TileLists
from xrdslam.ops.splats.types import Pinhole, PinholeLike, SplatRender

__all__ = ["Pinhole", "PinholeLike", "SplatRender", "TileLists", "morton_order", "render"]
