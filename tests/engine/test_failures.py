"""Whatever goes wrong, a run says so in one line, has saved what it had, and leaves nothing half done."""

import dataclasses
import errno
import logging
import os
import resource
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from safetensors.torch import load_file

from xrdslam.core import files
from xrdslam.core.config import EngineConfig
from xrdslam.core.errors import RunError
from xrdslam.core.hookspecs import hookimpl
from xrdslam.core.records import MappingMethodInfo
from xrdslam.engine import load_run, run
from xrdslam.testing.killing import saved_in
from xrdslam.testing.toy_plugin import toy_registry
from xrdslam.testing.victim import COMMAND, NUM_FRAMES, victim_config

WRONG = "xrdslam.testing.misbehaving:"


class Plugin:
    """Methods that go wrong, and what a test does while a frame is tracked."""

    def __init__(self) -> None:
        self.at: dict[int, Callable[[], None]] = {}

    @hookimpl
    def xrdslam_mapping_methods(self) -> list[MappingMethodInfo]:
        names = {"spoilt": "SpoiltMapping", "spoilt_at_last": "SpoiltAtLast", "spoilt_fusion": "SpoiltFusion"}
        names |= {"diverging": "DivergingMapping"}
        config = "xrdslam.core.config:IterativeMappingConfig"
        return [MappingMethodInfo(name, WRONG + target, config) for name, target in names.items()]

    @hookimpl
    def xrdslam_frame_tracked(self, frame: Any) -> None:
        self.at.pop(frame.index, lambda: None)()


@pytest.fixture
def plugin() -> Plugin:
    return Plugin()


def go(run_dir: Path, plugin: Plugin, mapping: str = "toy", **changes: Any) -> Any:
    config = victim_config(run_dir, "sequential")
    config.algo.tracking.iterations = config.algo.mapping.iterations = 3
    config.algo.mapping.final_iterations_per_keyframe = 1
    config.algo.mapping.name = mapping
    config.evaluation.pictures_every, config.evaluation.trajectory_pictures = 0, False
    config = dataclasses.replace(config, report=False, **{"engine": EngineConfig(progress=False), **changes})
    registry = toy_registry()
    registry.register(plugin, "wrong 1.0")
    return run(config, run_dir, registry)


def refuse(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Let the disk be full when a file of this name is begun."""
    make = files.tempfile.mkstemp

    def mkstemp(**where: Any) -> tuple[int, str]:
        if f"{where['prefix'][1:-1]}{where['suffix'].removesuffix('.part')}" == name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return make(**where)

    monkeypatch.setattr(files.tempfile, "mkstemp", mkstemp)


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("online.txt", "the trajectories"),
        ("trajectory.safetensors", "the trajectories"),
        ("map.safetensors", "the map"),
        ("metrics.json", "the figures"),
    ],
)
def test_a_full_disk_is_named_and_costs_only_the_file_that_it_has_no_room_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, plugin: Plugin, name: str, what: str
) -> None:
    refuse(monkeypatch, name)
    with pytest.raises(RunError, match=rf"the run is over, but {what} could not be written \(.*No space left.*free sp"):
        go(tmp_path, plugin)
    kept = {"trajectory/online.txt", "map/map.safetensors", "metrics.json", "timing.csv"}
    found = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    missing = {path for path in kept if Path(path).name == name}
    if name == "online.txt":
        missing.add("timing.csv")
    assert kept - found <= missing | {"timing.csv"}
    assert name not in {Path(path).name for path in found}
    assert not [path for path in found if path.endswith(".part")]


def test_a_log_that_the_disk_has_no_room_for_costs_no_run(tmp_path: Path, plugin: Plugin) -> None:
    (tmp_path / "log.txt").symlink_to("/dev/full")
    plugin.at[3] = lambda: logging.getLogger("of a method").warning("a line that has no place")
    assert go(tmp_path, plugin).exit_status == 0
    assert saved_in(tmp_path) == (NUM_FRAMES, True, True)


def test_a_system_that_cuts_files_short_is_named_and_leaves_no_half_of_one(tmp_path: Path) -> None:
    """The limit on file sizes refuses a write in the middle of a file, as a full disk does."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4000, 4000))

    command = [*COMMAND, "run", str(tmp_path), "sequential"]
    answer = subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False, timeout=120, preexec_fn=limit)
    assert answer.returncode == 1
    assert "the run is over, but" in answer.stderr.splitlines()[-1]
    assert "File too large" in answer.stderr.splitlines()[-1]
    assert len((tmp_path / "trajectory/online.txt").read_text().splitlines()) == 1 + NUM_FRAMES
    assert not list(tmp_path.rglob("*.part"))


def test_a_folder_that_is_removed_under_the_run_is_written_anew_and_said(
    tmp_path: Path, plugin: Plugin, caplog: pytest.LogCaptureFixture
) -> None:
    plugin.at[3] = lambda: shutil.rmtree(tmp_path / "run")
    assert go(tmp_path / "run", plugin).exit_status == 0
    assert "was removed during the run" in caplog.text
    assert saved_in(tmp_path / "run") == (NUM_FRAMES, True, True)
    assert len(load_run(tmp_path / "run", toy_registry()).algorithm.trajectory) == NUM_FRAMES


@pytest.mark.parametrize(("mapping", "why"), [("diverging", "its loss is nan"), ("spoilt", "walls is not finite")])
def test_a_map_that_turns_to_nan_is_named_and_the_map_of_the_frame_before_is_saved(
    tmp_path: Path, plugin: Plugin, mapping: str, why: str
) -> None:
    with pytest.raises(RunError, match=f"mapping of frame 3 diverged: {why}"):
        go(tmp_path, plugin, mapping)
    assert saved_in(tmp_path) == (4, True, True)
    assert len(load_file(tmp_path / "map/map.safetensors")["amplitudes"]) == 4 + 2, (
        "three frames, the first brings four"
    )


def test_refining_the_map_at_the_end_may_spoil_it_too(tmp_path: Path, plugin: Plugin) -> None:
    with pytest.raises(RunError, match="refining the map after the last frame diverged: walls is not finite"):
        go(tmp_path, plugin, "spoilt_at_last")
    assert saved_in(tmp_path) == (NUM_FRAMES, True, True)


def test_a_map_that_cannot_be_given_back_is_not_saved(tmp_path: Path, plugin: Plugin) -> None:
    with pytest.raises(RunError, match="mapping of frame 3 diverged: walls is not finite"):
        go(tmp_path, plugin, "spoilt_fusion")
    assert saved_in(tmp_path) == (4, False, True)
    assert "the map is not saved, for it is spoilt: walls is not finite" in (tmp_path / "log.txt").read_text()


def test_a_new_run_takes_away_what_a_killed_one_left_unfinished(tmp_path: Path, plugin: Plugin) -> None:
    (tmp_path / "map").mkdir()
    (tmp_path / "map" / ".mesh-abc.ply.part").write_bytes(b"half")
    go(tmp_path, plugin)
    assert not list(tmp_path.rglob("*.part"))
