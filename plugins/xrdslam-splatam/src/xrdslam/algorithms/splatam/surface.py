"""The map as files: 3DGS splats, and a mesh of what the map renders."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from torch import Tensor

from xrdslam.algorithms.splatam.config import SplatamMapConfig
from xrdslam.core.model import Model, View
from xrdslam.core.surface import TriangleMesh, write_ply
from xrdslam.ops.tsdf import TsdfVolume

__all__ = ["fuse_views", "write_splats"]

SH_DC = 0.28209479177387814
"""The constant spherical harmonic, 1 / (2 sqrt(pi)): a 3DGS file stores (colour - 1/2) / SH_DC."""


def write_splats(
    path: Path,
    means: Float[Tensor, "n 3"],
    log_scales: Float[Tensor, "n s"],
    opacity_logits: Float[Tensor, "n 1"],
    colors: Float[Tensor, "n 3"],
    quats_wxyz: Float[Tensor, "n 4"],
) -> None:
    """Write the PLY of 3D Gaussian splatting: position, normal (zero), SH-DC colour, logit, log scales, w x y z."""
    columns = {
        "x y z": means,
        "nx ny nz": means.new_zeros(means.shape),
        "f_dc_0 f_dc_1 f_dc_2": (colors - 0.5) / SH_DC,
        "opacity": opacity_logits,
        "scale_0 scale_1 scale_2": log_scales.expand(-1, 3),
        "rot_0 rot_1 rot_2 rot_3": quats_wxyz / quats_wxyz.norm(dim=1, keepdim=True),
    }
    names = [name for group in columns for name in group.split()]
    table = np.empty(len(means), dtype=[(name, "f4") for name in names])
    for group, values in columns.items():
        for name, column in zip(group.split(), values.detach().cpu().numpy().T, strict=True):
            table[name] = column
    write_ply(path, {"vertex": table})


def fuse_views(model: Model, views: Sequence[View], config: SplatamMapConfig) -> TriangleMesh:
    """Fuse rendered depth, divided by the silhouette, where the map explains enough of a pixel; no measured depth."""
    volume = TsdfVolume(config.mesh_voxel_m, config.mesh_truncation_m)
    for view in views:
        rendering = model.render(view.camera, view.T_world_camera)
        seen = rendering.opacity > config.mesh_opacity
        depth = (rendering.depth / rendering.opacity.clamp(min=1e-6)) * seen
        volume.integrate(rendering.rgb.clamp(0, 1), depth, view.camera, view.T_world_camera)
    return volume.mesh()
