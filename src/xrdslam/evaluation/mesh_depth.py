"""The depth of a reconstructed mesh against that of the true one, from virtual views."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from xrdslam.core.surface import TriangleMesh
from xrdslam.evaluation.culling import DepthView
from xrdslam.evaluation.metrics import MetricGroup
from xrdslam.evaluation.virtual_views import cast_depth
from xrdslam.ops.ray_mesh import RayMesh

__all__ = ["MEASURES", "MeshDepthError", "mesh_depth_error"]

MEASURES = ("mesh_depth_l1_cm", "missing_surface_percent")


@dataclass(frozen=True, eq=False)
class MeshDepthError:
    """What each virtual view found."""

    l1_m: Float[NDArray[np.float64], " k"]
    """Mean |estimate - truth| over the pixels that count; where the estimate has no surface, the whole true depth."""
    missing: Float[NDArray[np.float64], " k"]
    """The share of those pixels where it has none."""

    def add_to(self, group: MetricGroup) -> None:
        """Add the means over views."""
        group.add("mesh_depth_l1_cm", 100 * float(self.l1_m.mean()))
        group.add("missing_surface_percent", 100 * float(self.missing.mean()))


def mesh_depth_error(
    estimate: TriangleMesh, views: Sequence[DepthView], counted: Sequence[Bool[NDArray[np.bool_], "h w"]]
) -> MeshDepthError:
    """Cast depth at the aligned estimate from views that know the true depth; compare the pixels that count."""
    mesh = RayMesh(estimate)
    errors, missing = [], []
    for view, is_counted in zip(views, counted, strict=True):
        found = cast_depth(mesh, view.camera, view.T_world_camera)[is_counted]
        errors.append(np.abs(found - view.depth[is_counted]).mean())  # a missing surface has a depth of 0
        missing.append((found == 0).mean())
    return MeshDepthError(np.array(errors), np.array(missing))
