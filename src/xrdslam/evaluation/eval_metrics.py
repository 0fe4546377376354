"""A run's numbers and pictures, from its poses and its map, in one call."""

import csv
import dataclasses
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool
from numpy.typing import NDArray
from torch import Tensor

from xrdslam.core.errors import XrdslamError
from xrdslam.core.files import replaced
from xrdslam.core.model import Rendering
from xrdslam.evaluation.comparison import side_by_side
from xrdslam.evaluation.config import EvaluationConfig
from xrdslam.evaluation.errors import EvaluationError
from xrdslam.evaluation.metrics import MetricGroup, Metrics, assemble, write_metrics
from xrdslam.evaluation.plots import trajectory_figure, write_figure
from xrdslam.evaluation.reconstruction import DENSITY, DepthView, compare_surfaces
from xrdslam.evaluation.reconstruction import MEASURES as SURFACE_MEASURES
from xrdslam.evaluation.rendering import (
    MEASURES,
    EvaluatedFrame,
    FrameRow,
    Frames,
    Render,
    RenderingMetrics,
    picked,
    rendered_frames,
)
from xrdslam.evaluation.surface_files import read_mesh
from xrdslam.evaluation.trajectory import (
    AnyPoses,
    Poses,
    TrajectoryError,
    absolute_trajectory_error,
    is_finite,
    relative_pose_error,
)
from xrdslam.pictures.panels import Panels, chosen_frames, write_panels

__all__ = ["EvalMetrics", "Trajectories"]

log = logging.getLogger(__name__)

ATE_STATISTICS = ("rmse_cm", "mean_cm", "median_cm", "max_cm", "std_cm")
RPE_KEYS = ("rpe_translation_rmse_cm", "rpe_rotation_rmse_deg")
ATE_KEYS = tuple(f"ate_{name}" for name in ATE_STATISTICS)


@dataclass(frozen=True, eq=False)
class Trajectories:
    """The poses of a run, T_world_camera, row by row of the same frames; a missing pose is a row of NaN."""

    online: AnyPoses
    """As first reported."""
    final: AnyPoses
    """As believed after the last frame."""
    ground_truth: AnyPoses | None = None
    is_lost: Bool[NDArray[np.bool_], " _"] | None = None
    """Frames that kept a predicted pose because tracking failed."""
    indices: Sequence[int] | None = None
    """The frame index of each row; None: row i is frame i."""
    has_metric_scale: bool = True
    """False for monocular estimates: RPE translations then use the scale of the Sim(3) alignment."""

    def __post_init__(self) -> None:
        """Refuse rows that do not belong together."""
        rows = {
            "online": len(self.online),
            "final": len(self.final),
            **({} if self.ground_truth is None else {"ground_truth": len(self.ground_truth)}),
            **({} if self.is_lost is None else {"is_lost": len(self.is_lost)}),
            **({} if self.indices is None else {"indices": len(self.indices)}),
        }
        if len(set(rows.values())) > 1:
            raise EvaluationError(f"trajectories of one run need a row for each frame, found {rows}; fill with NaN")

    @property
    def frame_indices(self) -> list[int]:
        """The frame index of each row."""
        return list(range(len(self.final))) if self.indices is None else [int(index) for index in self.indices]


class EvalMetrics:
    """Evaluates runs under one configuration.

    metrics = EvalMetrics(config).evaluate(Trajectories(online, final, truth), render, dataset, run_dir=folder)
    """

    def __init__(self, config: EvaluationConfig | None = None) -> None:
        """Use the defaults where nothing is configured."""
        self.config = config or EvaluationConfig()

    def evaluate(
        self,
        trajectories: Trajectories,
        render: Render | None = None,
        frames: Frames = (),
        profile: Mapping[str, float] | None = None,
        profile_protocol: Mapping[str, str] | None = None,
        run_dir: Path | None = None,
        surfaces: tuple[Path, Path] | None = None,
    ) -> Metrics:
        """Return the flat metrics; with `run_dir` also write metrics.json, pictures and a row for every compared frame.

        `render(camera, T_world_camera)` is the map's view (None: it has none); `frames` are the photographs, of which
        a Dataset is read only where needed; `surfaces` are the files of the estimated and the true mesh. Nothing that
        cannot be measured stops the rest: it becomes null with its reason.
        """
        groups = [
            self._trajectory_group("online", trajectories.online, trajectories, run_dir),
            self._trajectory_group("final", trajectories.final, trajectories, run_dir),
            _lost_group(trajectories),
        ]
        if render is not None:
            groups.append(self._rendering_group(render, frames, trajectories, run_dir))
        if surfaces is not None and self.config.mesh_samples:
            groups.append(self._reconstruction_group(*surfaces, frames, trajectories))
        if profile:
            groups.append(_profile_group(profile, profile_protocol or {}))
        metrics = assemble(groups)
        if run_dir is not None:
            write_metrics(run_dir / "metrics.json", metrics)
        return metrics

    def _trajectory_group(
        self, name: str, estimate: Poses, trajectories: Trajectories, run_dir: Path | None
    ) -> MetricGroup:
        group = MetricGroup(f"trajectory/{name}", {"poses": "camera-to-world", "frames": len(estimate)})
        truth, error = trajectories.ground_truth, None
        if truth is None:
            group.refuse((*ATE_KEYS, "ate_sim3_rmse_cm", *RPE_KEYS), "the sequence has no ground-truth trajectory")
        else:
            error = _add_ate(group, estimate, truth)
            scale = _add_sim3(group, estimate, truth)
            self._add_rpe(group, estimate, truth, 1.0 if trajectories.has_metric_scale else scale)
        if run_dir is not None and self.config.trajectory_pictures:
            title = f"{name.capitalize()} trajectory"
            figure = trajectory_figure(estimate, truth, error, trajectories.is_lost, title)
            write_figure(figure, run_dir / "trajectory" / f"{name}.png")
        return group

    def _add_rpe(self, group: MetricGroup, estimate: Poses, truth: Poses, scale: float | None) -> None:
        try:
            if scale is None:
                raise EvaluationError("the estimate has no metric scale and no Sim(3) alignment gives one")
            rpe = relative_pose_error(estimate, truth, self.config.rpe_delta_frames, scale)
        except EvaluationError as error:
            group.refuse(RPE_KEYS, str(error))
            return
        group.add("rpe_translation_rmse_cm", rpe.translation_rmse_cm)
        group.add("rpe_rotation_rmse_deg", rpe.rotation_rmse_deg)
        group.protocol |= {"rpe_delta_frames": rpe.delta_frames, "rpe_pairs": rpe.pairs, "rpe_scale": rpe.scale}

    def _rendering_group(
        self, render: Render, frames: Frames, trajectories: Trajectories, run_dir: Path | None
    ) -> MetricGroup:
        measure = RenderingMetrics(self.config.every, self.config.mask)
        poses = dict(zip(trajectories.frame_indices, torch.tensor(trajectories.final), strict=True))
        kept = chosen_frames([index for index in poses if index % self.config.every == 0])
        try:
            for frame, rendering in rendered_frames(render, frames, poses, self.config.every):
                row = measure.add(frame, rendering)
                if run_dir is not None and self.config.pictures_every and frame.index in kept:
                    _keep(run_dir / "renders" / "panels", frame, rendering)
                if run_dir is not None and self.config.pictures_every and frame.index % self.config.pictures_every == 0:
                    _write_picture(run_dir / "renders" / f"frame_{frame.index:06d}.png", frame, rendering, row)
        except XrdslamError as error:
            log.warning("the renderings were not evaluated: %s", error)
            group = MetricGroup(f"rendering/{measure.views}", measure.protocol())
            group.refuse(MEASURES, f"rendering stopped after {len(measure.rows)} frames: {error}")
            return group
        if run_dir is not None:
            _write_rows(run_dir / "renders" / "metrics.csv", measure.rows)
        group = measure.group()
        finite = is_finite(trajectories.final)
        group.protocol["frames_without_pose"] = sum(
            index % self.config.every == 0 and not ok for index, ok in zip(poses, finite.tolist(), strict=True)
        )
        return group

    def _reconstruction_group(
        self, estimate: Path, truth: Path, frames: Frames, trajectories: Trajectories
    ) -> MetricGroup:
        config = self.config
        group = MetricGroup(
            "reconstruction",
            {
                "culling": "samples of both surfaces that a frame saw: in its image, on measured depth, not behind it",
                "cull_every": config.cull_every,
                "cull_margin_m": config.cull_margin_m,
                "samples": config.mesh_samples,
                "samples_measured_to": DENSITY * config.mesh_samples,
                "alignment": "the trajectory's SE(3); no ICP",
                "seed": 0,
            },
        )
        try:
            if trajectories.ground_truth is None:
                raise EvaluationError("the sequence has no ground-truth trajectory to align by")
            ate = absolute_trajectory_error(trajectories.final, trajectories.ground_truth, "se3")
            views = _depth_views(frames, trajectories.ground_truth, trajectories.frame_indices, config.cull_every)
            meshes = read_mesh(estimate), read_mesh(truth)
            compare_surfaces(*meshes, views, ate.alignment, config.mesh_samples, config.cull_margin_m).add_to(group)
        except XrdslamError as error:
            group.refuse(SURFACE_MEASURES, str(error))
        return group


def _depth_views(frames: Frames, truth: AnyPoses, indices: Sequence[int], every: int) -> list[DepthView]:
    """Return every n-th frame's depth with its true pose."""
    poses = dict(zip(indices, np.asarray(truth, dtype=np.float64), strict=True))
    wanted = [index for index, pose in poses.items() if index % every == 0 and np.isfinite(pose).all()]
    return [
        DepthView(frame.camera, poses[frame.index], _array(frame.depth))
        for frame in picked(frames, wanted)
        if frame.depth is not None
    ]


def _add_ate(group: MetricGroup, estimate: Poses, truth: Poses) -> TrajectoryError | None:
    try:
        ate = absolute_trajectory_error(estimate, truth, "se3")
    except EvaluationError as error:
        group.refuse(ATE_KEYS, str(error))
        return None
    for key in ATE_STATISTICS:
        group.add(f"ate_{key}", getattr(ate, key))
    group.protocol |= {
        "ate": "distances of camera centres; rmse is the root of the mean square",
        "ate_alignment": "SE(3), Umeyama 1991, estimate onto ground truth, over all matched frames",
        "ate_sim3_alignment": "Sim(3), the same with one scale",
        "is_alignment_rotation_unique": ate.alignment.is_unique,
        "matched_frames": ate.matched,
        "frames_without_ground_truth": ate.missing_ground_truth,
        "frames_without_estimate": ate.missing_estimate,
    }
    return ate


def _add_sim3(group: MetricGroup, estimate: Poses, truth: Poses) -> float | None:
    """Add the ATE up to scale; return that scale (true per estimated metre)."""
    try:
        ate = absolute_trajectory_error(estimate, truth, "sim3")
    except EvaluationError as error:
        group.refuse(("ate_sim3_rmse_cm",), str(error))
        return None
    group.add("ate_sim3_rmse_cm", ate.rmse_cm)
    group.protocol["ate_sim3_scale"] = ate.alignment.scale
    return ate.alignment.scale


def _lost_group(trajectories: Trajectories) -> MetricGroup:
    meaning = "tracking failed, the predicted pose was kept"
    group = MetricGroup("trajectory", {"frames": len(trajectories.final), "lost": meaning})
    if trajectories.is_lost is None:
        group.refuse(("lost_frames",), "no lost mask was given")
    else:
        group.add("lost_frames", int(trajectories.is_lost.sum()))
    return group


def _profile_group(profile: Mapping[str, float], protocol: Mapping[str, str]) -> MetricGroup:
    group = MetricGroup("profile", dict(protocol))
    for key, value in profile.items():
        group.add(key.removeprefix("profile/"), value)
    return group


def _write_picture(path: Path, frame: EvaluatedFrame, rendering: Rendering, row: FrameRow) -> None:
    scores = (("PSNR", row.psnr_db, "dB"), ("depth L1", row.depth_l1_cm, "cm"))
    texts = [f"{name} n/a" if value is None else f"{name} {value:.2f} {unit}" for name, value, unit in scores]
    depth = None if frame.depth is None else _array(frame.depth)
    caption = "   ·   ".join([f"frame {frame.index}", *texts])
    figure = side_by_side(_array(frame.rgb), _array(rendering.rgb), depth, _array(rendering.depth), caption)
    write_figure(figure, path)


def _keep(folder: Path, frame: EvaluatedFrame, rendering: Rendering) -> None:
    """Keep what a report and a replay show of a frame."""
    depth = None if frame.depth is None else _array(frame.depth)
    rgb, rendered = (
        np.rint(255 * np.clip(_array(image), 0, 1)).astype(np.uint8) for image in (frame.rgb, rendering.rgb)
    )
    write_panels(folder, Panels(frame.index, rgb, rendered, depth, _array(rendering.depth)))


def _array(image: Tensor) -> NDArray[np.float32]:
    return np.asarray(image.detach().to("cpu", torch.float32).numpy())


def _write_rows(path: Path, rows: Sequence[FrameRow]) -> None:
    with replaced(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in dataclasses.fields(FrameRow)])
        writer.writeheader()
        writer.writerows(dataclasses.asdict(row) for row in rows)
