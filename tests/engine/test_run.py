"""A run from configuration to directory: what it writes, repeats, survives and announces."""

import dataclasses
import json
import logging
import signal
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from xrdslam.core.config import (
    AlgorithmConfig,
    EngineConfig,
    IterativeMappingConfig,
    IterativeTrackingConfig,
    RunConfig,
)
from xrdslam.core.errors import ConfigError, DataError
from xrdslam.core.frame import Frame
from xrdslam.core.hookspecs import hookimpl
from xrdslam.core.mapping import GradientMapping, MappingResult
from xrdslam.core.records import AlgorithmInfo, DatasetInfo, MappingMethodInfo, TrackingMethodInfo
from xrdslam.core.registry import Registry
from xrdslam.core.tracking import GradientTracking, TrackingResult
from xrdslam.datasets.config import DatasetConfig
from xrdslam.engine import Run, run
from xrdslam.evaluation import EvaluationConfig, EvaluationError
from xrdslam.testing.toy_sequence import ToySequence, toy_sequence


def open_toy(config: DatasetConfig) -> ToySequence:
    """Stand for a dataset class: build the toy sequence, with the damage that a test asks for."""
    sequence = toy_sequence(6, 48, 36)
    sequence._damaged = frozenset([3]) if config.scene == "damaged" else frozenset()
    sequence.on_error = config.on_error
    return sequence


class Toy:
    """A plugin with everything a run needs, and a memory of what it was told."""

    def __init__(self) -> None:
        self.heard: list[str] = []

    @hookimpl
    def xrdslam_algorithms(self) -> list[AlgorithmInfo]:
        return [AlgorithmInfo("toy", "xrdslam.testing.toy_method:ToyAlgorithm", "xrdslam.core.config:AlgorithmConfig")]

    @hookimpl
    def xrdslam_tracking_methods(self) -> list[TrackingMethodInfo]:
        here = f"{__name__}:"
        return [TrackingMethodInfo(n, here + c) for n, c in (("toy", "GradientTracking"), ("blind", "BlindAtThree"))]

    @hookimpl
    def xrdslam_mapping_methods(self) -> list[MappingMethodInfo]:
        here = f"{__name__}:"
        names = {"toy": "GradientMapping", "failing": "FailingAtThree", "interrupted": "InterruptedAtThree"}
        return [MappingMethodInfo(name, here + target) for name, target in names.items()]

    @hookimpl
    def xrdslam_datasets(self) -> list[DatasetInfo]:
        return [DatasetInfo("toy", f"{__name__}:open_toy", "xrdslam.datasets.config:DatasetConfig")]

    @hookimpl
    def xrdslam_run_started(self, run: Run) -> None:
        self.heard.append("started")

    @hookimpl
    def xrdslam_frame_tracked(self, frame: Frame, result: TrackingResult) -> None:
        self.heard.append(f"tracked {frame.index}")

    @hookimpl
    def xrdslam_map_updated(self, frame: Frame, result: MappingResult) -> None:
        self.heard.append(f"mapped {frame.index}")

    @hookimpl
    def xrdslam_run_finished(self, metrics: dict[str, Any]) -> None:
        self.heard.append("finished")


class BlindAtThree(GradientTracking):
    """Loses frame 3."""

    def track(self, frame: Frame, *rest: Any) -> TrackingResult:
        result = super().track(frame, *rest)
        return result._replace(T_world_camera=torch.full((4, 4), torch.nan)) if frame.index == 3 else result


class FailingAtThree(GradientMapping):
    """Breaks at frame 3."""

    def map(self, frame: Frame, *rest: Any) -> MappingResult:
        if frame.index == 3:
            raise ZeroDivisionError("a fault of the method")
        return super().map(frame, *rest)


class InterruptedAtThree(GradientMapping):
    """Lets the user press Ctrl-C, or a scheduler say stop, while frame 3 is mapped."""

    def map(self, frame: Frame, *rest: Any) -> MappingResult:
        if frame.index == 3:
            signal.raise_signal(signal.SIGTERM if self.generator.initial_seed() % 2 else signal.SIGINT)
        return super().map(frame, *rest)


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Toy:
    import sys

    monkeypatch.setitem(sys.modules, __name__, sys.modules.get(__name__, request.module))
    return Toy()


@pytest.fixture
def registry(toy: Toy) -> Registry:
    registry = Registry()
    registry.register(toy, "toy 1.0")
    return registry


def config_of(tracking: str = "toy", mapping: str = "toy", **changes: Any) -> RunConfig:
    algo = AlgorithmConfig(
        "toy",
        keyframe_every=2,
        tracking=IterativeTrackingConfig(tracking, iterations=5),
        mapping=IterativeMappingConfig(mapping, iterations=5, keyframes="window", window=3),
    )
    evaluation = EvaluationConfig(every=2, pictures_every=4)
    config = RunConfig(algo, DatasetConfig("toy", "room0"), EngineConfig(), evaluation, threads=1)
    return dataclasses.replace(config, **changes)


def test_a_run_leaves_everything_that_is_promised(tmp_path: Path, registry: Registry) -> None:
    summary = run(config_of(), tmp_path, registry)
    assert summary.exit_status == 0
    expected = ["config.yaml", "environment.json", "log.txt", "keyframes.json", "timing.csv", "metrics.json"]
    expected += [f"trajectory/{n}.txt" for n in ("online", "final", "ground_truth")]
    expected += ["map/map.safetensors", "renders/frame_000000.png", "renders/frame_000004.png", "trajectory/final.png"]
    assert [name for name in expected if not (tmp_path / name).is_file()] == []
    assert not list(tmp_path.rglob("*.part"))
    assert json.loads((tmp_path / "keyframes.json").read_text()) == {"keyframes": [0, 2, 4], "lost_frames": []}
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics == summary.metrics
    assert metrics["profile/frames"] == 6
    assert metrics["trajectory/final/ate_rmse_cm"] > 0
    environment = json.loads((tmp_path / "environment.json").read_text())
    assert environment["seed"] == 0
    assert environment["threads"] == 1
    assert "torch" in environment["versions"]


def test_trajectories_are_written_in_tums_format_with_exact_times(tmp_path: Path, registry: Registry) -> None:
    run(config_of(), tmp_path, registry)
    rows = [line.split() for line in (tmp_path / "trajectory/ground_truth.txt").read_text().splitlines()[1:]]
    assert [row[0] for row in rows[:3]] == ["1.000000000", "1.033333333", "1.066666666"]
    numbers = np.array(rows, dtype=float)
    np.testing.assert_allclose(numbers[:, 1:4], toy_sequence(6).poses[:, :3, 3].numpy(), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(numbers[:, 4:], axis=1), 1, atol=1e-6)


def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not(tmp_path: Path, registry: Registry) -> None:
    for name, seed in (("one", 0), ("two", 0), ("three", 1)):
        run(config_of(seed=seed), tmp_path / name, registry)
    files = [(tmp_path / name / "trajectory/final.txt").read_text() for name in ("one", "two", "three")]
    assert files[0] == files[1] != files[2]
    one, two = (load_file(tmp_path / name / "map/map.safetensors") for name in ("one", "two"))
    assert all(torch.equal(one[key], two[key]) for key in one)


def test_hooks_hear_of_everything_in_order(tmp_path: Path, registry: Registry, toy: Toy) -> None:
    run(config_of(), tmp_path, registry)
    frames = [f"{what} {index}" for index in range(6) for what in ("tracked", "mapped")]
    assert toy.heard == ["started", *frames, "finished"]


def test_a_plugin_whose_hook_raises_costs_one_warning_and_no_run(
    tmp_path: Path, registry: Registry, caplog: pytest.LogCaptureFixture
) -> None:
    class Broken:
        @hookimpl
        def xrdslam_frame_tracked(self) -> None:
            raise RuntimeError("not today")

    registry.register(Broken(), "broken 0.1")
    assert run(config_of(), tmp_path, registry).exit_status == 0
    assert len([r for r in caplog.records if "not today" in r.getMessage()]) == 1


def test_a_lost_frame_keeps_its_prediction_is_counted_and_is_not_mapped(
    tmp_path: Path, registry: Registry, toy: Toy, caplog: pytest.LogCaptureFixture
) -> None:
    summary = run(config_of(tracking="blind"), tmp_path, registry)
    assert summary.metrics["trajectory/lost_frames"] == 1
    assert json.loads((tmp_path / "keyframes.json").read_text())["lost_frames"] == [3]
    assert "mapped 3" not in toy.heard
    assert "mapped 4" in toy.heard
    assert len((tmp_path / "trajectory/final.txt").read_text().splitlines()) == 7
    assert any("frame 3 is lost" in record.getMessage() for record in caplog.records)


@pytest.mark.parametrize("seed", range(4))  # the stream of the mapper decides between SIGINT and SIGTERM
def test_an_interrupted_run_saves_what_there_is_and_says_so(tmp_path: Path, registry: Registry, seed: int) -> None:
    assert threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore SIGINT
    try:
        summary = run(config_of(mapping="interrupted", seed=seed), tmp_path, registry)
    finally:
        signal.signal(signal.SIGINT, before)
    assert summary.was_interrupted
    assert summary.exit_status == 130
    assert len((tmp_path / "trajectory/online.txt").read_text().splitlines()) == 1 + 4
    assert load_file(tmp_path / "map/map.safetensors")
    assert json.loads((tmp_path / "metrics.json").read_text())["profile/frames"] == 4  # frame 3 was brought to its end


def test_a_method_that_fails_loses_nothing_that_was_computed(
    tmp_path: Path, registry: Registry, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(ZeroDivisionError, match="a fault of the method"):
        run(config_of(mapping="failing"), tmp_path, registry)
    assert len((tmp_path / "trajectory/online.txt").read_text().splitlines()) == 1 + 4
    assert load_file(tmp_path / "map/map.safetensors")
    assert "a fault of the method" in (tmp_path / "log.txt").read_text()


def test_a_damaged_frame_ends_the_run_or_is_skipped_as_asked(tmp_path: Path, registry: Registry) -> None:
    damaged = DatasetConfig("toy", "damaged")
    with pytest.raises(DataError, match="frame 3 is damaged"):
        run(config_of(dataset=damaged), tmp_path / "raise", registry)
    assert len((tmp_path / "raise/trajectory/online.txt").read_text().splitlines()) == 1 + 3
    skipping = DatasetConfig("toy", "damaged", on_error="skip")
    summary = run(config_of(dataset=skipping), tmp_path / "skip", registry)
    assert summary.metrics["profile/frames"] == 5


def test_a_device_that_is_not_there_is_refused_with_what_there_is(tmp_path: Path, registry: Registry) -> None:
    with pytest.raises(ConfigError, match=r"device=warp9.*there is"):
        run(config_of(device="warp9"), tmp_path, registry)


def test_the_log_handler_goes_with_the_run(tmp_path: Path, registry: Registry) -> None:
    before = list(logging.getLogger().handlers)
    run(config_of(), tmp_path, registry)
    assert logging.getLogger().handlers == before


def test_an_interruption_before_the_first_frame_is_no_fault(
    tmp_path: Path, registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(ToySequence, "__getitem__", interrupt)
    summary = run(config_of(), tmp_path, registry)
    assert summary.exit_status == 130
    assert summary.metrics == {}


def test_held_out_frames_are_tracked_kept_from_the_map_and_compared_apart(
    tmp_path: Path, registry: Registry, toy: Toy
) -> None:
    evaluation = EvaluationConfig(every=1, held_out=3, pictures_every=0)
    metrics = run(config_of(evaluation=evaluation), tmp_path, registry).metrics
    assert [what for what in toy.heard if what.startswith("mapped")] == ["mapped 0", "mapped 1", "mapped 3", "mapped 4"]
    assert metrics["trajectory/protocol"]["frames"] == 6
    assert json.loads((tmp_path / "keyframes.json").read_text())["keyframes"] == [0, 4]  # 2 would have been one
    counts = {kind: metrics[f"rendering/{kind}/protocol"]["frames"] for kind in ("train", "held_out")}
    assert counts == {"train": 4, "held_out": 2}
    assert metrics["rendering/held_out/psnr_db"] != metrics["rendering/train/psnr_db"]
    rows = (tmp_path / "renders" / "metrics.csv").read_text().splitlines()
    assert [row.rpartition(",")[2] for row in rows[1:]] == ["0", "0", "1", "0", "0", "1"]


def test_lpips_weights_that_are_not_there_are_refused_before_the_first_frame(
    tmp_path: Path, registry: Registry, toy: Toy
) -> None:
    with pytest.raises(EvaluationError, match="no file and no folder"):
        run(config_of(evaluation=EvaluationConfig(lpips_weights=str(tmp_path / "none.npz"))), tmp_path, registry)
    assert toy.heard == []
