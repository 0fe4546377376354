"""A gap in a sequence, from the command line's settings to the figures: reported where nobody looks, else found."""

import json
from pathlib import Path

import numpy as np
import pytest

import xrdslam.builtin
from xrdslam.core.config import AlgorithmConfig, EngineConfig, MappingConfig, MultiprocessConfig, RunConfig
from xrdslam.core.registry import Registry
from xrdslam.datasets.synthetic.config import SyntheticConfig
from xrdslam.engine import RunSummary, run
from xrdslam.evaluation import EvaluationConfig
from xrdslam.evaluation.trajectory_files import read_tum
from xrdslam.methods.config import GicpTrackingConfig
from xrdslam.testing.toy_plugin import ToyPlugin

GAP = 8
"""Frames before the gap; four come behind it."""


@pytest.fixture(scope="module")
def registry() -> Registry:
    registry = Registry()
    registry.register(xrdslam.builtin, "xrdslam 1.0")
    registry.register(ToyPlugin(), "toy 1.0")
    return registry


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that keeps the room's light and frames between the runs."""
    return tmp_path_factory.mktemp("rooms")


def went(folder: Path, registry: Registry, engine: EngineConfig, relocalise: bool) -> RunSummary:
    """Follow the room by its depth, from the prediction alone: a gap of 28 frames is more than that can bridge."""
    tracking = GicpTrackingConfig(relocalise=relocalise, coarse_voxels_m=[], min_overlap=0.6)
    algo = AlgorithmConfig("toy", tracking=tracking, mapping=MappingConfig("none"))
    dataset = SyntheticConfig(width=160, height=120, lighting="coarse", frames=[0, GAP + 32, 1], drop=[GAP, GAP + 28])
    evaluation = EvaluationConfig(every=100, pictures_every=0, trajectory_pictures=False)
    return run(RunConfig(algo, dataset, engine, evaluation, threads=1, report=False), folder, registry)


def error_cm(folder: Path) -> np.ndarray:
    estimate, truth = (read_tum(folder / "trajectory" / f"{name}.txt") for name in ("final", "ground_truth"))
    shift: np.ndarray = (estimate.T_world_camera - truth.T_world_camera)[:, :3, 3]
    return 100 * np.linalg.norm(shift, axis=1)


def test_a_gap_is_reported_or_bridged_in_either_engine(
    tmp_path: Path, registry: Registry, room: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XRDSLAM_CACHE", str(room))
    sequential = EngineConfig(progress=False)
    left = went(tmp_path / "left", registry, sequential, relocalise=False)
    assert left.metrics["trajectory/lost_frames"] == 4
    assert left.metrics["trajectory/recognised_frames"] == 0
    assert json.loads((tmp_path / "left/keyframes.json").read_text())["lost_frames"] == [*range(GAP, GAP + 4)]
    assert error_cm(tmp_path / "left")[GAP:].min() > 20
    found = went(tmp_path / "found", registry, sequential, relocalise=True)
    assert found.metrics["trajectory/lost_frames"] == 0
    assert found.metrics["trajectory/recognised_frames"] == 1
    assert error_cm(tmp_path / "found").max() < 2
    went(tmp_path / "processes", registry, MultiprocessConfig(progress=False), relocalise=True)
    for name in ("trajectory/online.txt", "trajectory/final.txt", "keyframes.json"):
        assert (tmp_path / "processes" / name).read_text() == (tmp_path / "found" / name).read_text()
