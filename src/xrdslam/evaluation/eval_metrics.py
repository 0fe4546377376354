"""A run's numbers and pictures, from its poses and its map, in one call."""

from collections.abc import Mapping
from pathlib import Path

from xrdslam.core.errors import XrdslamError
from xrdslam.evaluation.config import EvaluationConfig
from xrdslam.evaluation.errors import EvaluationError
from xrdslam.evaluation.lpips import BACKBONES, Lpips
from xrdslam.evaluation.lpips_weights import find_lpips
from xrdslam.evaluation.metrics import JsonValue, MetricGroup, Metrics, assemble, write_metrics
from xrdslam.evaluation.plots import trajectory_figure, write_figure
from xrdslam.evaluation.rendering import Frames, Perceptual, Render
from xrdslam.evaluation.surface_group import reconstruction_group
from xrdslam.evaluation.survey import Survey
from xrdslam.evaluation.trajectories import Trajectories
from xrdslam.evaluation.trajectory import Poses
from xrdslam.evaluation.trajectory_files import StampedPoses, associated
from xrdslam.evaluation.trajectory_group import coverage_group, trajectory_group

__all__ = ["EvalMetrics"]


class EvalMetrics:
    """Evaluates runs under one configuration.

    metrics = EvalMetrics(config).evaluate(Trajectories(online, final, truth), render, dataset, run_dir=folder)
    """

    def __init__(self, config: EvaluationConfig | None = None) -> None:
        """Use the defaults where nothing is configured."""
        self.config = config or EvaluationConfig()

    def check(self) -> None:
        """Refuse weights that were given and cannot be used, before a run that would only say so at its end."""
        if self.config.lpips_weights is not None:
            perceptual = self._perceptual()
            if not perceptual.networks:
                raise EvaluationError("; ".join(perceptual.reasons.values()))

    def evaluate(
        self,
        trajectories: Trajectories,
        render: Render | None = None,
        frames: Frames = (),
        profile: Mapping[str, JsonValue] | None = None,
        profile_protocol: Mapping[str, JsonValue] | None = None,
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
            coverage_group(trajectories),
        ]
        has_surfaces = surfaces is not None and self.config.mesh_samples > 0
        survey = Survey(self.config, trajectories, run_dir, Perceptual() if render is None else self._perceptual())
        survey.go(render, frames, wants_depth=has_surfaces)
        if render is not None:
            groups += survey.groups()
            if run_dir is not None and survey.fault is None:
                survey.write_rows(run_dir / "renders" / "metrics.csv")
        if surfaces is not None and has_surfaces:
            groups.append(reconstruction_group(self.config, *surfaces, survey.depth_views, trajectories))
        if profile:
            groups.append(_profile_group(profile, profile_protocol or {}))
        metrics = assemble(groups)
        if run_dir is not None:
            write_metrics(run_dir / "metrics.json", metrics)
        return metrics

    def evaluate_files(self, estimate: StampedPoses, truth: StampedPoses) -> Metrics:
        """Return the figures of one trajectory whose poses are matched to the true ones by their times."""
        tolerance_s = self.config.max_time_difference_s
        found, true = associated(estimate, truth, tolerance_s)
        group, _ = trajectory_group("final", found, true, True, self.config.rpe_delta_frames)
        group.protocol |= {
            "association": "poses that are each other's nearest in time",
            "max_time_difference_s": tolerance_s,
        }
        return assemble([group])

    def _trajectory_group(
        self, name: str, estimate: Poses, trajectories: Trajectories, run_dir: Path | None
    ) -> MetricGroup:
        truth = trajectories.ground_truth
        group, error = trajectory_group(
            name, estimate, truth, trajectories.has_metric_scale, self.config.rpe_delta_frames
        )
        if run_dir is not None and self.config.trajectory_pictures:
            title = f"{name.capitalize()} trajectory"
            figure = trajectory_figure(estimate, truth, error, trajectories.is_lost, title)
            write_figure(figure, run_dir / "trajectory" / f"{name}.png")
        return group

    def _perceptual(self) -> Perceptual:
        """Load each LPIPS network once; one without weights, or with broken ones, is n/a with the reason."""
        networks: dict[str, Lpips] = {}
        sources: dict[str, str] = {}
        reasons: dict[str, str] = {}
        for backbone in BACKBONES:
            try:
                networks[backbone], sources[backbone] = find_lpips(backbone, self.config.lpips_weights)
            except XrdslamError as error:
                reasons[backbone] = str(error)
        return Perceptual(networks, sources, reasons)


def _profile_group(profile: Mapping[str, JsonValue], protocol: Mapping[str, JsonValue]) -> MetricGroup:
    group = MetricGroup("profile", dict(protocol))
    for key, value in profile.items():
        if isinstance(value, int | float):
            group.add(key.removeprefix("profile/"), value)
        else:
            group.refuse((key.removeprefix("profile/"),), "the run gave no value")
    return group
