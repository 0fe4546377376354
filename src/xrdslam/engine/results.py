"""What a run leaves behind: trajectories, the map, figures."""

import logging
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.errors import RunError, XrdslamError
from xrdslam.core.files import write_text
from xrdslam.core.model import Rendering, View
from xrdslam.core.saved_state import save_state
from xrdslam.engine.checkpoints import header_of, known_poses
from xrdslam.engine.context import Run
from xrdslam.engine.profile import PROTOCOL
from xrdslam.engine.stages import not_finite
from xrdslam.evaluation import EvalMetrics, JsonValue, Metrics, Trajectories
from xrdslam.report.page import write_report

__all__ = ["evaluate", "save_map", "save_report", "save_trajectories", "trajectories_of"]

log = logging.getLogger(__name__)


def save_trajectories(run: Run) -> None:
    """Write the online, final and ground-truth trajectories, the keyframes, and the time that each frame took."""
    trajectory = run.algorithm.trajectory
    stamps = trajectory.timestamps_ns.tolist()
    run.directory.write_trajectory("online", stamps, trajectory.online())
    run.directory.write_trajectory("final", stamps, trajectory.current())
    known = [run.ground_truth[index] for index in trajectory.indices]
    if any(bool(torch.isfinite(pose).all()) for pose in known):
        run.directory.write_trajectory("ground_truth", stamps, torch.stack(known))
    lost = [index for index in trajectory.indices if trajectory.lost(index)]
    if lost:
        log.warning("%d of %d frames are lost: their poses are predictions", len(lost), len(trajectory))
    run.directory.write_keyframes([frame.index for frame in run.algorithm.keyframes], lost)
    write_text(run.directory.path / "timing.csv", run.profile.csv())
    if len(trajectory):
        exact = {**run.algorithm.results_state(), "ground_truth": known_poses(run)}
        save_state(run.directory.trajectory_state, exact, header_of(run))


def save_map(run: Run, with_mesh: bool = True) -> None:
    """Write the map's state, and whatever views of it the method offers; one that fails is said and skipped.

    RunError where it holds what is no number. OSError, after the others were tried, where the system refuses a file:
    the disk is full, or gone.
    """
    model = run.algorithm.model
    if wrong := not_finite(model):
        raise RunError(f"the map is not saved, for it is spoilt: {wrong[0]}; what else the run found is saved")
    save_state(run.directory.map_state, model.state_dict(), header_of(run))
    if model.size == 0:
        log.warning("the map is empty: no mesh, cloud or splats are written")
        return
    pose = run.algorithm.trajectory.pose
    views = [View(frame.camera, pose(frame.index).to(frame.rgb)) for frame in run.algorithm.keyframes]
    writers: dict[str, Callable[[], object]] = {
        "export": lambda: model.export(run.directory.map),
        "point_cloud": lambda: model.point_cloud().write(run.directory.map / "cloud.ply"),
        "mesh": lambda: model.mesh(views).write(run.directory.map / "mesh.ply"),
    }
    refused: OSError | None = None
    for capability, write in writers.items():
        if not model.supports(capability):
            continue
        if capability == "mesh" and not with_mesh:
            log.warning("the map is saved without a mesh, which takes long to extract")
            continue
        try:
            write()
        except (XrdslamError, OSError, MemoryError) as error:
            log.error("%s of the map was not written: %s", capability, error)
            refused = error if isinstance(error, OSError) else refused
    if refused is not None:
        raise refused


def evaluate(
    run: Run,
    with_rendering: bool = True,
    true_mesh: Path | None = None,
    profile_protocol: Mapping[str, JsonValue] | None = None,
) -> Metrics:
    """Measure, write metrics.json and the pictures.

    `true_mesh` takes the place of the dataset's; `profile_protocol` says under which conditions the run went, where
    that was not now.
    """
    model = run.algorithm.model

    def render(camera: Camera, T_world_camera: Tensor) -> Rendering:
        return model.render(camera, T_world_camera.to(run.device))

    estimate, truth = run.directory.map / "mesh.ply", true_mesh or run.dataset.ground_truth_mesh
    renders = with_rendering and model.size > 0 and model.supports("render")
    return EvalMetrics(run.config.evaluation).evaluate(
        trajectories_of(run),
        render if renders else None,
        run.dataset,
        dict(run.profile.metrics()),
        profile_protocol or _conditions(run),
        run.directory.path,
        (estimate, truth) if truth is not None and estimate.is_file() else None,
    )


def trajectories_of(run: Run) -> Trajectories:
    """Return what is known of a run's poses."""
    trajectory, indices = run.algorithm.trajectory, run.algorithm.trajectory.indices
    truth = np.stack([run.ground_truth[index].numpy() for index in indices])
    return Trajectories(
        online=trajectory.online().numpy(),
        final=trajectory.current().numpy(),
        ground_truth=truth if np.isfinite(truth).all((1, 2)).any() else None,
        is_lost=trajectory.is_lost.numpy(),
        num_recognised=int(trajectory.is_recognised.sum()),
        indices=indices,
        is_held_out=np.array([run.algorithm.is_held_out(index) for index in indices]),
        sequence_frames=len(run.dataset),
    )


def _conditions(run: Run) -> dict[str, JsonValue]:
    return {
        **PROTOCOL,
        "engine": run.config.engine.name,
        "threads": str(torch.get_num_threads()),
        "device": run.device,
        "preset": run.config.preset,
        "resumed_after_frames": ", ".join(map(str, run.resumed_after)) or "never",
    }


def save_report(run: Run, true_mesh: Path | None = None) -> None:
    """Write report.html, with `true_mesh` in place of the dataset's.

    Whatever goes wrong is a warning: nothing that was computed depends on it.
    """
    try:
        write_report(run.directory.path, true_mesh or run.dataset.ground_truth_mesh)
    except Exception as error:  # a fault of a picture must not fail a run that took hours
        again = f"`python -m xrdslam.report {run.directory.path}` writes it again"
        log.warning("report.html was not written (%s: %s); %s", type(error).__name__, error, again)
