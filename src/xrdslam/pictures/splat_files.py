"""Gaussians read from PLY files in the layout of 3D Gaussian splatting."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from xrdslam.core.errors import DataError

__all__ = ["Splats", "read_splats"]

SH_0 = 0.28209479177387814
"""The first spherical harmonic, 1 / (2 sqrt(pi)): a colour is 1/2 + SH_0 f_dc."""


class Splats(NamedTuple):
    """Gaussians in the world [m]."""

    means: Float32[NDArray[np.float32], "n 3"]
    covariances: Float32[NDArray[np.float32], "n 3 3"]
    colors: Float32[NDArray[np.float32], "n 3"]
    opacities: Float32[NDArray[np.float32], " n"]


def read_splats(path: Path, most: int | None = None) -> Splats:
    """Read at most `most` Gaussians, evenly picked. DataError where the file holds none."""
    from plyfile import PlyData, PlyParseError  # type: ignore[import-untyped]  # ships no stubs

    try:
        vertex = PlyData.read(str(path))["vertex"]
        step = 1 if most is None else max(1, -(-len(vertex.data) // most))
        means, colour, log_scales, quats_wxyz, logits = (
            np.stack([np.asarray(vertex[name], dtype=np.float64)[::step] for name in names], 1)
            for names in (
                ("x", "y", "z"),
                ("f_dc_0", "f_dc_1", "f_dc_2"),
                ("scale_0", "scale_1", "scale_2"),
                ("rot_0", "rot_1", "rot_2", "rot_3"),
                ("opacity",),
            )
        )
    except (OSError, PlyParseError, KeyError, ValueError) as error:
        raise DataError(f"{path}: not a PLY file of Gaussians ({error}); give another file") from error
    axes = Rotation.from_quat(quats_wxyz[:, [1, 2, 3, 0]]).as_matrix() * np.exp(log_scales)[:, None]
    colors = np.clip(0.5 + SH_0 * colour, 0, 1)
    opacities = 1 / (1 + np.exp(-logits[:, 0]))
    covariances = axes @ axes.transpose(0, 2, 1)
    return Splats(*(array.astype(np.float32) for array in (means, covariances, colors, opacities)))
