"""A run that was killed, interrupted or failed goes on where it was, to the bit; another's checkpoint is refused.

Past 300 lines: every test needs the same small plugin and the same run.
"""

import dataclasses
import json
import logging
import random
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from xrdslam.core.config import (
    AlgorithmConfig,
    EngineConfig,
    IterativeMappingConfig,
    IterativeTrackingConfig,
    RunConfig,
)
from xrdslam.core.errors import ConfigError, DataError, RunError
from xrdslam.core.frame import Frame
from xrdslam.core.hookspecs import hookimpl
from xrdslam.core.keyframes import select_keyframes
from xrdslam.core.mapping import GradientMapping
from xrdslam.core.records import AlgorithmInfo, DatasetInfo, MappingMethodInfo, TrackingMethodInfo
from xrdslam.core.registry import Registry, installed
from xrdslam.core.saved_state import load_state, save_state
from xrdslam.datasets.config import DatasetConfig
from xrdslam.datasets.synthetic.config import SyntheticConfig
from xrdslam.engine import checkpoints, load_run, resume, run
from xrdslam.engine.checkpoints import newest_checkpoint
from xrdslam.engine.random_numbers import restore_streams, seed_streams, streams
from xrdslam.engine.results import evaluate
from xrdslam.evaluation import EvaluationConfig
from xrdslam.testing.bits import different_leaves
from xrdslam.testing.toy_sequence import ToySequence, toy_sequence

SIZE = (7, 40, 30)


def open_toy(config: DatasetConfig) -> ToySequence:
    """Stand for a dataset class; the scene says which frame is damaged."""
    sequence = toy_sequence(*SIZE)
    sequence._damaged = frozenset([4]) if config.root == "damaged" else frozenset()
    sequence.on_error = config.on_error
    return sequence


class DrawsFromGlobalStreams(GradientMapping):
    """Chooses its window by numpy's and torch's global numbers; Python's are drawn by the checker of shapes too."""

    def select(self, frame: Frame, keyframes: Any) -> list[Frame]:
        drawn = np.random.rand() + float(torch.rand(()))  # noqa: NPY002  # the stream under test
        window = 1 + int(drawn)
        return select_keyframes("random", keyframes, frame, window, self.generator)


class Toy:
    """A plugin with everything a run needs; `at` says what happens while a frame is mapped."""

    def __init__(self) -> None:
        self.at: dict[int, Callable[[], None]] = {}
        self.seen: list[int] = []

    @hookimpl
    def xrdslam_algorithms(self) -> list[AlgorithmInfo]:
        return [AlgorithmInfo("toy", "xrdslam.testing.toy_method:ToyAlgorithm", "xrdslam.core.config:AlgorithmConfig")]

    @hookimpl
    def xrdslam_tracking_methods(self) -> list[TrackingMethodInfo]:
        config = "xrdslam.core.config:IterativeTrackingConfig"
        return [TrackingMethodInfo("toy", "xrdslam.core.tracking:GradientTracking", config)]

    @hookimpl
    def xrdslam_mapping_methods(self) -> list[MappingMethodInfo]:
        config = "xrdslam.core.config:IterativeMappingConfig"
        return [MappingMethodInfo(n, f"{__name__}:DrawsFromGlobalStreams", config) for n in ("toy", "other")]

    @hookimpl
    def xrdslam_datasets(self) -> list[DatasetInfo]:
        return [DatasetInfo("toy", f"{__name__}:open_toy", "xrdslam.datasets.config:DatasetConfig")]

    @hookimpl
    def xrdslam_frame_tracked(self, frame: Frame) -> None:
        self.seen.append(frame.index)
        self.at.pop(frame.index, lambda: None)()


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Toy:
    monkeypatch.setitem(sys.modules, __name__, request.module)
    return Toy()


@pytest.fixture
def registry(toy: Toy) -> Registry:
    registry = Registry()
    registry.register(toy, "toy 1.0")
    return registry


def config_of(**changes: Any) -> RunConfig:
    algo = AlgorithmConfig(
        "toy",
        keyframe_every=2,
        map_every=2,
        tracking=IterativeTrackingConfig("toy", iterations=4),
        mapping=IterativeMappingConfig(
            "toy", 4, lr_pose_rotation=1e-3, lr_pose_translation=1e-3, pose_accumulate=3, keep_optimiser=True
        ),
    )
    evaluation = EvaluationConfig(every=3, pictures_every=0, trajectory_pictures=False)
    config = RunConfig(algo, DatasetConfig("toy", "room0"), EngineConfig(), evaluation, threads=1)
    return dataclasses.replace(config, **changes)


@pytest.fixture
def uninterrupted(tmp_path: Path, registry: Registry, toy: Toy) -> Path:
    run(config_of(), tmp_path / "whole", registry)
    toy.seen.clear()
    return tmp_path / "whole"


def results(run_dir: Path) -> dict[str, Any]:
    """Return every bit of a run's trajectory and map, and the figures that time has no part in."""
    states = {name: load_state(run_dir / name)[0] for name in ("trajectory/trajectory.safetensors", RESULT)}
    metrics = json.loads((run_dir / "metrics.json").read_text())
    return {**states, "metrics": {key: value for key, value in metrics.items() if not key.startswith("profile/")}}


RESULT = "map/map.safetensors"


def columns(run_dir: Path) -> list[list[str]]:
    """Return timing.csv without times and memory."""
    rows = [line.split(",") for line in (run_dir / "timing.csv").read_text().splitlines()]
    kept = [i for i, name in enumerate(rows[0]) if not name.endswith(("_ms", "_mib"))]
    return [[row[i] for i in kept] for row in rows]


@pytest.mark.parametrize("stop", [0, 1, 4, 6])
def test_an_interrupted_run_goes_on_with_the_same_bits(
    tmp_path: Path, registry: Registry, toy: Toy, uninterrupted: Path, stop: int
) -> None:
    toy.at[stop] = lambda: signal.raise_signal(signal.SIGTERM)
    begun = run(config_of(), tmp_path / "run", registry)
    assert begun.was_interrupted
    assert toy.seen == list(range(stop + 1)), "the frame under way is brought to its end, no other is begun"
    seed_streams(99)
    ended = resume(tmp_path / "run", registry=registry)
    assert toy.seen == list(range(SIZE[0])), "no frame is done twice"
    assert ended.exit_status == 0
    changed = different_leaves(results(uninterrupted), results(tmp_path / "run"))
    assert [name for name in changed if "resumed_after" not in name and "protocol" not in name] == []
    assert columns(tmp_path / "run") == columns(uninterrupted)
    assert ended.metrics["profile/frames"] == SIZE[0]
    assert not (tmp_path / "run/checkpoint").exists()


def test_a_run_may_be_interrupted_again_and_again(
    tmp_path: Path, registry: Registry, toy: Toy, uninterrupted: Path
) -> None:
    """Also where no frame has been mapped since the last time: what was loaded is saved again, all of it."""
    toy.at = {index: lambda: signal.raise_signal(signal.SIGTERM) for index in (2, 3, 4, 5)}
    run(config_of(), tmp_path / "run", registry)
    while toy.at:
        assert resume(tmp_path / "run", registry=registry).was_interrupted
    summary = resume(tmp_path / "run", registry=registry)
    assert summary.metrics["profile/protocol"]["resumed_after_frames"] == "2, 3, 4, 5"
    expected, found = results(uninterrupted), results(tmp_path / "run")
    assert different_leaves(expected[RESULT], found[RESULT]) == []


def test_every_global_stream_is_taken_back() -> None:
    def draw() -> list[Any]:
        legacy = np.random  # the stream under test
        return [random.random(), random.gauss(0, 1), legacy.rand(), legacy.randn(), torch.rand(()), torch.randn(())]

    seed_streams(3)
    draw()  # leaves a second normal number waiting in Python's stream and in numpy's
    state = json.loads(json.dumps(streams()))
    expected = draw()
    seed_streams(4)
    restore_streams(state)
    assert draw() == expected


def test_a_failure_between_two_frames_costs_none_and_one_inside_a_frame_those_since_the_last_checkpoint(
    tmp_path: Path, registry: Registry, toy: Toy, uninterrupted: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(DataError, match="frame 4 is damaged"):
        run(config_of(dataset=DatasetConfig("toy", "room0", root="damaged")), tmp_path / "between", registry)
    assert f"resume={tmp_path / 'between'} goes on after frame 3" in caplog.text
    resume(tmp_path / "between", ["dataset.root=data"], registry)

    def fail() -> None:
        raise KeyboardInterrupt  # as a second Ctrl-C does

    toy.at[5] = fail
    run(config_of(engine=EngineConfig(checkpoint_every=2)), tmp_path / "inside", registry)
    toy.seen.clear()
    resume(tmp_path / "inside", registry=registry)
    assert toy.seen == [4, 5, 6]
    for name in ("between", "inside"):
        assert different_leaves(results(uninterrupted)[RESULT], results(tmp_path / name)[RESULT]) == []


KILLED = """
import os, signal, sys
from pathlib import Path
from xrdslam.core import files
from xrdslam.engine.recorded import read_config, typed_config
from xrdslam.engine import run

written = 0
def replace(source, target, real=os.replace):
    global written
    written += "checkpoint" in str(target)
    if written == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    real(source, target)

files.os.replace = replace
folder = Path(sys.argv[1])
run(typed_config(read_config(folder)), folder)
"""


def test_a_run_killed_while_it_writes_a_checkpoint_goes_on_from_the_one_before(tmp_path: Path) -> None:
    """SIGKILL leaves no time for anything: the file that was nearly done is nobody's, the older one is whole."""
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    data = SyntheticConfig(num_frames=8, size=[32, 24], lighting="coarse", cache=False)
    sparse = EvaluationConfig(every=4, pictures_every=0, trajectory_pictures=False, mesh_samples=0)
    engine = EngineConfig(checkpoint_every=2, progress=False)
    toy = installed().algorithm("toy").load_config()  # the example, which is a plugin like any other
    run(RunConfig(toy(keyframe_every=3), data, engine, sparse, threads=1), whole)
    killed.mkdir()
    shutil.copy(whole / "config.yaml", killed)

    def start(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)

    assert start("-c", KILLED, str(killed)).returncode == -signal.SIGKILL
    left = sorted(path.name for path in (killed / "checkpoint").iterdir())
    assert len(left) == 2
    assert left[0].endswith(".part")
    assert left[1] == "after_frame_000003.safetensors"
    answer = start("-m", "xrdslam", f"resume={killed}")
    assert answer.returncode == 0, answer.stderr
    assert "ATE RMSE" in answer.stdout
    assert different_leaves(results(whole)[RESULT], results(killed)[RESULT]) == []
    assert not list(killed.rglob("*.part"))


def test_a_disk_that_refuses_a_checkpoint_costs_no_run(
    tmp_path: Path, registry: Registry, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    real = save_state

    def save(path: Path, *rest: Any) -> None:
        if path.name == "after_frame_000003.safetensors":
            raise OSError("no space left on device")
        real(path, *rest)

    monkeypatch.setattr(checkpoints, "save_state", save)
    seen: list[str] = []
    monkeypatch.setattr(checkpoints.Checkpoints, "remove", lambda self: seen.extend(map(str, self.folder.glob("*"))))
    assert run(config_of(engine=EngineConfig(checkpoint_every=2)), tmp_path, registry).exit_status == 0
    assert "no checkpoint after frame 3: no space left on device; the one before stays" in caplog.text
    assert [Path(name).name for name in seen] == ["after_frame_000005.safetensors"], "only the newest is kept"


def test_a_new_run_in_an_old_folder_has_nothing_of_the_old_one(tmp_path: Path, registry: Registry, toy: Toy) -> None:
    run(config_of(), tmp_path, registry)
    toy.at[0] = lambda: signal.raise_signal(signal.SIGTERM)
    run(config_of(seed=1), tmp_path, registry)
    assert len(load_run(tmp_path, registry).algorithm.trajectory) == 1
    toy.at[0] = lambda: signal.raise_signal(signal.SIGTERM)
    run(config_of(seed=2), tmp_path, registry)
    assert resume(tmp_path, registry=registry).exit_status == 0
    assert load_run(tmp_path, registry).config.seed == 2


def test_a_finished_run_is_opened_as_it_was(tmp_path: Path, registry: Registry, uninterrupted: Path) -> None:
    loaded = load_run(uninterrupted, registry)
    before = json.loads((uninterrupted / "metrics.json").read_text())
    state = load_state(uninterrupted / RESULT)[0]
    assert different_leaves(state, dict(loaded.algorithm.model.state_dict())) == []
    again = evaluate(loaded)
    assert {key for key in before if before[key] != again[key]} == set()


def test_a_run_that_was_killed_is_opened_at_its_newest_checkpoint(tmp_path: Path, registry: Registry, toy: Toy) -> None:
    """A run that was interrupted, resumed and killed has results of the first end and a checkpoint after it."""
    toy.at[1] = lambda: signal.raise_signal(signal.SIGTERM)
    run(config_of(), tmp_path, registry)
    assert len(load_run(tmp_path, registry).algorithm.trajectory) == 2

    def die() -> None:
        raise SystemExit  # like a kill, it leaves nothing but what is on disk

    toy.at[5] = die
    with pytest.raises(SystemExit):
        resume(tmp_path, ["engine.checkpoint_every=2"], registry)
    loaded = load_run(tmp_path, registry)
    assert len(loaded.algorithm.trajectory) == 4
    assert [frame.index for frame in loaded.algorithm.keyframes] == [0, 2]


@pytest.fixture
def begun(tmp_path: Path, registry: Registry, toy: Toy) -> Path:
    toy.at[2] = lambda: signal.raise_signal(signal.SIGTERM)
    run(config_of(), tmp_path / "begun", registry)
    return tmp_path / "begun"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda h: h.update(format=0), r"format 0, this version reads format 2"),
        (lambda h: h["distributions"].update(toy="0.9"), r"written by toy==0.9, installed is toy 1.0; `pip install"),
        (lambda h: h["distributions"].update(xrdslam="0.0.1"), r"written by xrdslam==0.0.1"),
        (lambda h: h["methods"].update({"algo/mapping": "other"}), r"algo/mapping=other, not for algo/mapping=toy"),
    ],
)
def test_what_another_version_or_method_wrote_is_refused(
    begun: Path, registry: Registry, change: Callable[[Any], None], says: str
) -> None:
    path = newest_checkpoint(begun)
    assert path is not None
    state, header = load_state(path)
    change(header)
    save_state(path, state, header)
    with pytest.raises(RunError, match=says):
        resume(begun, registry=registry)


def test_another_version_may_still_look_at_a_run(
    begun: Path, registry: Registry, caplog: pytest.LogCaptureFixture
) -> None:
    path = begun / "trajectory/trajectory.safetensors"
    state, header = load_state(path)
    header["distributions"]["toy"] = "0.9"
    save_state(path, state, header)
    assert len(load_run(begun, registry).algorithm.trajectory) == 3
    assert "written by toy==0.9, installed is toy 1.0" in caplog.text


def test_a_state_that_does_not_fit_and_a_damaged_one_are_named(begun: Path, registry: Registry) -> None:
    path = newest_checkpoint(begun)
    assert path is not None
    state, header = load_state(path)
    state["model"]["walls"] = torch.zeros(2, 4)
    save_state(path, state, header)
    with pytest.raises(RunError, match=r"after_frame_000002.*does not fit algo=toy.*walls"):
        resume(begun, registry=registry)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(DataError, match=r"after_frame_000002.*not a whole file"):
        resume(begun, registry=registry)


def test_where_there_is_nothing_to_resume_it_is_said(uninterrupted: Path, registry: Registry, tmp_path: Path) -> None:
    with pytest.raises(RunError, match="has ended"):
        resume(uninterrupted, registry=registry)
    with pytest.raises(RunError, match="left no checkpoint"):
        resume(tmp_path / "nowhere", registry=registry)
    with pytest.raises(RunError, match="no run was begun there"):
        load_run(tmp_path / "nowhere", registry)


def test_a_recorded_setting_that_the_installed_version_lacks_is_named(begun: Path, registry: Registry) -> None:
    path = newest_checkpoint(begun)
    assert path is not None
    state, header = load_state(path)
    header["config"]["algo"]["tracking"]["speed"] = 3
    save_state(path, state, header)
    with pytest.raises(ConfigError, match=r"algo\.tracking\.speed: the recorded setting does not fit"):
        resume(begun, registry=registry)


def test_costs_go_on_where_they_were(begun: Path, registry: Registry, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    first = json.loads((begun / "metrics.json").read_text())
    summary = resume(begun, registry=registry)
    assert summary.metrics["profile/wall_s"] > first["profile/wall_s"]
    rows = (begun / "timing.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows[1:]] == [str(i) for i in range(SIZE[0])]
    assert "resumed after frame 2" in caplog.text
