"""Processes give the sequential result, bit by bit; whatever goes wrong in one of them, the run ends and saves."""

import csv
import dataclasses
import json
import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Iterator
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import pytest
from safetensors.torch import load_file

from xrdslam.core.config import (
    AlgorithmConfig,
    EngineConfig,
    IterativeMappingConfig,
    IterativeTrackingConfig,
    MultiprocessConfig,
    RunConfig,
)
from xrdslam.core.errors import RunError
from xrdslam.core.hookspecs import hookimpl
from xrdslam.core.records import AlgorithmInfo, DatasetInfo, MappingMethodInfo, TrackingMethodInfo
from xrdslam.core.registry import Registry, installed
from xrdslam.datasets.config import DatasetConfig
from xrdslam.engine import Run, run
from xrdslam.evaluation import EvaluationConfig
from xrdslam.testing.bits import different_leaves
from xrdslam.testing.toy_sequence import ToySequence, toy_sequence
from xrdslam.testing.traces import Traces

WRONG = "xrdslam.testing.misbehaving:"


LONG = 400
"""Frames of a run that a signal is to end: what the parent hears may be frames behind what its workers do."""


def open_toy(config: DatasetConfig) -> ToySequence:
    return toy_sequence(LONG if config.scene == "long" else 6, 48, 36)


class Toy:
    """The toy method, a sequence, and a memory of what was heard. Workers import by name: no class of this file."""

    def __init__(self) -> None:
        self.heard: list[str] = []
        self.seen: list[float] = []

    @hookimpl
    def xrdslam_algorithms(self) -> list[AlgorithmInfo]:
        return [AlgorithmInfo("toy", "xrdslam.testing.toy_method:ToyAlgorithm", "xrdslam.core.config:AlgorithmConfig")]

    @hookimpl
    def xrdslam_tracking_methods(self) -> list[TrackingMethodInfo]:
        names = {"toy": "xrdslam.core.tracking:GradientTracking"}
        wrong = {"failing": "FailingTracking", "killed": "KilledTracking", "leaving": "LeavingTracking"}
        wrong |= {"vanishing": "VanishingTracking"}
        names |= {name: f"{WRONG}{target}" for name, target in wrong.items()}
        return [TrackingMethodInfo(name, target) for name, target in names.items()]

    @hookimpl
    def xrdslam_mapping_methods(self) -> list[MappingMethodInfo]:
        names = {"toy": "xrdslam.core.mapping:GradientMapping", "failing": f"{WRONG}FailingMapping"}
        names |= {"killed": f"{WRONG}KilledMapping", "diverging": f"{WRONG}DivergingMapping"}
        return [MappingMethodInfo(name, target) for name, target in names.items()]

    @hookimpl
    def xrdslam_datasets(self) -> list[DatasetInfo]:
        return [DatasetInfo("toy", f"{__name__}:open_toy", "xrdslam.datasets.config:DatasetConfig")]


class Listener:
    """Hears of frames, and looks at them."""

    def __init__(self) -> None:
        self.heard: list[str] = []
        self.red: list[float] = []

    @hookimpl
    def xrdslam_frame_tracked(self, frame: Any, result: Any) -> None:
        self.heard.append(f"tracked {frame.index}")
        self.red.append(float(frame.rgb[..., 0].mean()))

    @hookimpl
    def xrdslam_map_updated(self, run: Run, frame: Any, result: Any) -> None:
        assert run.algorithm.model.size > 0
        self.heard.append(f"mapped {frame.index}")


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Registry:
    import sys

    monkeypatch.setitem(sys.modules, __name__, sys.modules.get(__name__, request.module))
    registry = Registry()
    registry.register(Toy(), "toy 1.0")
    return registry


@pytest.fixture(autouse=True)
def _nothing_is_left(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No process, no named memory, no file in the temporary folder, no thread survives a run."""
    traces = Traces(tmp_path_factory.mktemp("traces"))
    resource_tracker.ensure_running()  # for the tests' own process, before it is marked
    for name, value in traces.environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(tempfile, "tempdir", str(traces.folder))
    register = resource_tracker.register

    def note(name: str, kind: str) -> None:
        traces.note(name)
        register(name, kind)

    monkeypatch.setattr(resource_tracker, "register", note)
    threads = {thread.name for thread in threading.enumerate()}
    yield
    assert traces.left() == []
    assert {thread.name for thread in threading.enumerate()} <= threads
    assert not multiprocessing.active_children()


def config_of(tracking: str = "toy", mapping: str = "toy", **changes: Any) -> RunConfig:
    algo = AlgorithmConfig(
        "toy",
        keyframe_every=2,
        tracking=IterativeTrackingConfig(tracking, iterations=5),
        mapping=IterativeMappingConfig(
            mapping, iterations=5, keyframes="window", window=3, lr_pose_rotation=1e-3, lr_pose_translation=1e-3
        ),
    )
    evaluation = EvaluationConfig(every=2, pictures_every=0, trajectory_pictures=False)
    config = RunConfig(algo, DatasetConfig("toy", "room0"), MultiprocessConfig(progress=False), evaluation, threads=1)
    return dataclasses.replace(config, **changes)


def assert_same_results(one: Path, two: Path) -> None:
    for name in ("trajectory/online.txt", "trajectory/final.txt", "keyframes.json"):
        assert (one / name).read_text() == (two / name).read_text(), name
    maps = [load_file(folder / "map/map.safetensors") for folder in (one, two)]
    assert not different_leaves(*maps)


def counts(folder: Path) -> list[dict[str, str]]:
    """Return timing.csv without its times and memory."""
    with (folder / "timing.csv").open() as rows:
        return [{k: v for k, v in row.items() if not k.endswith(("_ms", "_mib"))} for row in csv.DictReader(rows)]


def test_turn_by_turn_gives_the_sequential_bits_figures_and_hooks(tmp_path: Path, registry: Registry) -> None:
    expected = run(config_of(engine=EngineConfig(progress=False)), tmp_path / "sequential", registry)
    listener = Listener()
    registry.register(listener, "listener 1.0")
    found = run(config_of(), tmp_path / "strict", registry)
    assert found.exit_status == 0
    assert_same_results(tmp_path / "sequential", tmp_path / "strict")
    assert found.metrics.keys() == expected.metrics.keys()
    measured = [key for key in found.metrics if not key.startswith("profile/")]
    assert {k: found.metrics[k] for k in measured} == {k: expected.metrics[k] for k in measured}
    assert counts(tmp_path / "sequential") == counts(tmp_path / "strict")
    assert found.metrics["profile/tracking_ms_per_frame"] > 0
    assert listener.heard == [f"{what} {index}" for index in range(6) for what in ("tracked", "mapped")]
    assert listener.red == [float(frame.rgb[..., 0].mean()) for frame in toy_sequence(6, 48, 36).frames()]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["splatam", "co_slam"])
def test_turn_by_turn_gives_an_installed_methods_sequential_bits(tmp_path: Path, name: str) -> None:
    registry = installed()
    record = registry.algorithm(name)
    algo = record.load_config()()
    algo.name, algo.keyframe_every, algo.map_every = name, 2, 1
    algo.tracking = registry.tracking_method(record.tracking).load_config()(record.tracking, iterations=3)
    algo.mapping = registry.mapping_method(record.mapping).load_config()(record.mapping, iterations=4)
    algo.mapping.first_iterations = 6
    algo.tracking.first_iterations = algo.mapping.final_iterations_per_keyframe = 3
    family = registry.dataset("synthetic")
    dataset = family.load_config()("synthetic", "room0", frames=[0, 5, 1], size=[64, 48], lighting="coarse")
    for engine in (EngineConfig(progress=False), MultiprocessConfig(progress=False)):
        config = config_of(algo=algo, dataset=dataset, engine=engine)
        config.evaluation.mesh_samples = 0
        run(config, tmp_path / engine.name)
    assert_same_results(tmp_path / "sequential", tmp_path / "multiprocess")


class Killer:
    """Sends a signal when frame 3 is tracked: to a process of the run, or to the one that runs it."""

    def __init__(self, role: str, number: int) -> None:
        self.role = role
        self.number = number

    @hookimpl
    def xrdslam_frame_tracked(self, frame: Any) -> None:
        if frame.index == 3:
            children = {child.name: child.pid for child in multiprocessing.active_children()}
            target = os.getpid() if self.role == "parent" else children[f"xrdslam-{self.role}"]
            assert target is not None
            os.kill(target, self.number)


def assert_saved(folder: Path, frames: int) -> None:
    """Check that trajectory, map and figures of at least some frames are there, whole."""
    rows = (folder / "trajectory/online.txt").read_text().splitlines()[1:]
    assert frames <= len(rows) < LONG
    assert load_file(folder / "map/map.safetensors")["amplitudes"].isfinite().all()
    assert json.loads((folder / "metrics.json").read_text())["profile/frames"] >= frames - 1
    assert not list(folder.rglob("*.part"))


@pytest.mark.parametrize(
    ("tracking", "mapping", "message", "frames"),
    [
        ("killed", "toy", "the tracker was killed by SIGKILL", 3),
        ("vanishing", "toy", "the tracker was killed by SIGKILL", 6),
        ("leaving", "toy", "the tracker ended before its work was done, with exit status 0", 3),
        ("toy", "failing", "the mapper failed: ZeroDivisionError: a fault of the mapper", 4),
    ],
)
def test_a_worker_that_dies_ends_the_run_which_says_why_and_saves(
    tmp_path: Path,
    registry: Registry,
    caplog: pytest.LogCaptureFixture,
    tracking: str,
    mapping: str,
    message: str,
    frames: int,
) -> None:
    config = config_of(tracking, mapping)
    config.algo.mapping.final_iterations_per_keyframe = 2000  # the mapper is not done before the parent looks
    with pytest.raises(RunError, match=message):
        run(config, tmp_path, registry)
    assert_saved(tmp_path, frames)
    if mapping == "failing":
        assert "in map\n" in (tmp_path / "log.txt").read_text()  # the worker's own traceback


def test_the_server_may_die(tmp_path: Path, registry: Registry) -> None:
    registry.register(Killer("server", signal.SIGKILL), "killer 1.0")
    with pytest.raises(RunError, match="the server was killed by SIGKILL"):
        run(config_of(dataset=DatasetConfig("toy", "long")), tmp_path, registry)
    assert_saved(tmp_path, 4)


def test_a_scheduler_that_says_stop_is_heard(tmp_path: Path, registry: Registry) -> None:
    registry.register(Killer("parent", signal.SIGTERM), "killer 1.0")
    summary = run(config_of(dataset=DatasetConfig("toy", "long")), tmp_path, registry)
    assert summary.exit_status == 130
    assert_saved(tmp_path, 4)
