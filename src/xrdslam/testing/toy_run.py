"""A run's directory as a run leaves it, of the toy room, made in a second: for tests of what reads runs."""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.config import AlgorithmConfig, MappingConfig, RunConfig, TrackingConfig
from xrdslam.core.files import write_text
from xrdslam.core.model import Rendering
from xrdslam.core.surface import PointCloud, TriangleMesh
from xrdslam.datasets.config import DatasetConfig
from xrdslam.engine.directory import RunDirectory
from xrdslam.engine.profile import FrameCost, Profile
from xrdslam.evaluation import EvalMetrics, EvaluationConfig, Trajectories
from xrdslam.testing.toy_method import ToyModel
from xrdslam.testing.toy_room import WALLS
from xrdslam.testing.toy_sequence import toy_sequence

__all__ = ["box_mesh", "write_toy_run"]


def write_toy_run(
    folder: Path,
    method: str = "toy",
    seed: int = 0,
    num_frames: int = 12,
    error_m: float = 0.01,
    evaluation: EvaluationConfig | None = None,
    threads: int = 1,
) -> Path:
    """Write a finished run whose camera centres are off by about `error_m`, drawn by `seed`; return its folder.

    The map is the room without its balls; its mesh is a box a centimetre too large, and the true one lies beside the
    run's files as `true_mesh.ply`.
    """
    algo = AlgorithmConfig(method, tracking=TrackingConfig(method), mapping=MappingConfig(method))
    measured = evaluation or EvaluationConfig(every=2, pictures_every=100, trajectory_pictures=False, mesh_samples=2000)
    dataset = DatasetConfig("toy", "room0")
    config = RunConfig(algo, dataset, evaluation=measured, seed=seed, threads=threads, run_dir=str(folder))
    directory = RunDirectory(folder)
    directory.write_config(config)
    directory.write_environment(config, "cpu")
    sequence = toy_sequence(num_frames, 96, 72)
    truth = sequence.poses
    estimate = truth.clone()
    drawn = torch.randn(num_frames, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    estimate[:, :3, 3] += error_m * drawn
    stamps = [1_000_000_000 + index * 33_333_333 for index in range(num_frames)]
    for name, poses in (("online", estimate), ("final", estimate), ("ground_truth", truth)):
        directory.write_trajectory(name, stamps, poses)
    directory.write_keyframes(range(0, num_frames, 4), [num_frames // 2])
    box_mesh(0.01).write(directory.map / "mesh.ply")
    box_mesh(0.0).write(folder / "true_mesh.ply")
    PointCloud(box_mesh(0.0).vertices, np.full((8, 3), 0.5)).write(directory.map / "cloud.ply")
    profile = _profile(num_frames)
    write_text(folder / "timing.csv", profile.csv())
    model = ToyModel.exact()

    def render(camera: Camera, T_world_camera: Tensor) -> Rendering:
        with torch.no_grad():
            return model.render(camera, T_world_camera)

    is_lost = np.arange(num_frames) == num_frames // 2
    trajectories = Trajectories(estimate.numpy(), estimate.numpy(), truth.numpy(), is_lost)
    protocol = {"threads": str(threads), "device": "cpu", "preset": "published"}
    EvalMetrics(measured).evaluate(trajectories, render, sequence, profile.metrics(), protocol, folder)
    return folder


def box_mesh(margin_m: float) -> TriangleMesh:
    """Return the walls of the toy room, `margin_m` farther out, fronts inwards."""
    low, high = (WALLS[0] - margin_m).tolist(), (WALLS[1] + margin_m).tolist()
    corners = np.array([[(low, high)[i >> axis & 1][axis] for axis in range(3)] for i in range(8)])
    quads = [(0, 2, 6, 4), (1, 5, 7, 3), (0, 4, 5, 1), (2, 3, 7, 6), (0, 1, 3, 2), (4, 6, 7, 5)]
    outwards = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    faces = np.array(outwards)
    corner = corners[faces]
    normals = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    looks_out = (normals * (corner.mean(1) - corners.mean(0))).sum(1) > 0
    faces[looks_out] = faces[looks_out][:, ::-1]
    return TriangleMesh(corners, faces, (corners - corners.min(0)) / np.ptp(corners, axis=0))


def _profile(num_frames: int) -> Profile:
    """Return costs that grow from frame to frame."""
    profile = Profile(wall_s=0.1 * num_frames, cpu_s=0.1 * num_frames)
    for index in range(num_frames):
        profile.frames.append(
            FrameCost(
                index,
                reading_ms=1.0,
                tracking_ms=20.0 + index,
                mapping_ms=60.0 + 2 * index,
                tracking_iterations=10,
                mapping_iterations=20,
                map_size=1000 + 10 * index,
                rss_mib=300.0 + index,
                is_lost=index == num_frames // 2,
                is_keyframe=index % 4 == 0,
            )
        )
    return profile
