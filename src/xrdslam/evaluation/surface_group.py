"""The figures of a reconstructed surface, from two mesh files and what the frames measured."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from xrdslam.core.errors import XrdslamError
from xrdslam.core.surface import TriangleMesh
from xrdslam.evaluation.alignment import Alignment
from xrdslam.evaluation.config import EvaluationConfig
from xrdslam.evaluation.culling import CULLING, DepthView, Seen, seen_under
from xrdslam.evaluation.errors import EvaluationError
from xrdslam.evaluation.icp import point_to_point
from xrdslam.evaluation.mesh_depth import MEASURES as DEPTH_MEASURES
from xrdslam.evaluation.mesh_depth import mesh_depth_error
from xrdslam.evaluation.metrics import JsonValue, MetricGroup
from xrdslam.evaluation.reconstruction import DENSITY, MEASURES, compare_surfaces, moved, seen_samples
from xrdslam.evaluation.surface_alignment import surface_alignment
from xrdslam.evaluation.surface_files import read_mesh
from xrdslam.evaluation.trajectories import Trajectories
from xrdslam.evaluation.trajectory import AlignmentKind
from xrdslam.evaluation.virtual_views import CAMERA, virtual_views
from xrdslam.ops.ray_mesh import RayMesh

__all__ = ["reconstruction_group"]

ICP_SAMPLES = 20_000
ICP_REACH_M = 0.1


def reconstruction_group(
    config: EvaluationConfig,
    estimate: Path,
    truth: Path,
    views: Sequence[DepthView],
    trajectories: Trajectories,
) -> MetricGroup:
    """Measure the estimate's mesh file against the true one; what cannot be measured is null with its reason."""
    group = MetricGroup("reconstruction", _protocol(config, len(views)))
    try:
        found = moved(_read(estimate), _alignment(config, trajectories, group))
        true = _read(truth)
        virtual, counted = _virtual(config, true, views, group)
        seen = seen_under(config.culling, views, virtual, config.cull_margin_m)
        if config.icp != "none":
            found = _registered(found, true, seen, config, group)
        compare_surfaces(found, true, seen, config.mesh_samples, config.seed).add_to(group)
    except XrdslamError as error:
        group.refuse((*MEASURES, *DEPTH_MEASURES), str(error))
        return group
    if virtual:
        mesh_depth_error(found, virtual, counted).add_to(group)
    return group


def _protocol(config: EvaluationConfig, num_views: int) -> dict[str, JsonValue]:
    return {
        "culling": config.culling,
        "culling_meaning": CULLING[config.culling],
        "culling_poses": "ground truth",
        "cull_every": config.cull_every,
        "culling_frames": num_views,
        "cull_margin_m": config.cull_margin_m,
        "samples": config.mesh_samples,
        "samples_measured_to": DENSITY * config.mesh_samples,
        "samples_are": "even over the area of each surface",
        "alignment": config.alignment,
        "icp": config.icp,
        "virtual_views": config.virtual_views,
        "virtual_camera": f"{CAMERA.width}x{CAMERA.height} px, focal length {CAMERA.fx:g} px",
        "mesh_depth_l1": "mean over views, of pixels whose true surface a frame saw; a missing surface counts in full",
        "seed": config.seed,
    }


def _read(path: Path) -> TriangleMesh:
    mesh = read_mesh(path)
    if not np.isfinite(mesh.vertices).all():
        raise EvaluationError(f"{path.name} has vertices that are not finite")
    return mesh


def _alignment(config: EvaluationConfig, trajectories: Trajectories, group: MetricGroup) -> Alignment:
    """Return what lays the run's world on the true one; a run without a metric scale needs one."""
    if config.alignment == "none":
        return Alignment.identity()
    if trajectories.ground_truth is None:
        raise EvaluationError("the sequence has no ground-truth trajectory to align by; evaluation.alignment=none")
    kind: AlignmentKind = "sim3" if config.alignment == "sim3" else "se3"
    found = surface_alignment(trajectories.final, trajectories.ground_truth, kind)
    group.protocol |= found.protocol(kind)
    return found.motion


def _virtual(
    config: EvaluationConfig, true: TriangleMesh, views: Sequence[DepthView], group: MetricGroup
) -> tuple[list[DepthView], list[np.ndarray]]:
    """Return the virtual views and the pixels that the frames saw; none where that fails and culling needs none."""
    if not config.virtual_views:
        group.refuse(DEPTH_MEASURES, "evaluation.virtual_views=0")
        return [], []
    try:
        if not views:
            raise EvaluationError("no frame has both a true pose and measured depth")
        by_frames = seen_under("frustum_occlusion", views, [], config.cull_margin_m)
        return virtual_views(RayMesh(true), views, by_frames, config.virtual_views, config.seed)
    except EvaluationError as error:
        if config.culling == "virtual_cameras":
            raise
        group.refuse(DEPTH_MEASURES, str(error))
        return [], []


def _registered(
    found: TriangleMesh, true: TriangleMesh, seen: Seen, config: EvaluationConfig, group: MetricGroup
) -> TriangleMesh:
    """Return the estimate after ICP on samples of what counts, and say how far that moved it."""
    rng = np.random.default_rng([config.seed, 2])
    source = seen_samples(found, seen, ICP_SAMPLES, rng, "the reconstructed surface")
    target = seen_samples(true, seen, DENSITY * ICP_SAMPLES, rng, "the ground-truth surface")
    result = point_to_point(source, target, ICP_REACH_M)
    group.protocol["icp_result"] = {
        "samples": len(source),
        "reach_cm": 100 * ICP_REACH_M,
        "iterations": result.iterations,
        "matched_percent": 100 * result.matched_share,
        "moved_cm": 100 * float(np.linalg.norm(result.alignment.apply(source) - source, axis=1).mean()),
        "turned_deg": result.rotation_deg,
    }
    return moved(found, result.alignment)
