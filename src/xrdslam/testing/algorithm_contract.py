"""The contract of a method: subclass, name it, and pytest runs the rest."""

import dataclasses
import random
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from jaxtyping import Float64
from torch import Tensor

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.config import AlgorithmConfig
from xrdslam.core.dataset import Dataset
from xrdslam.core.errors import ConfigError, DataError
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.core.registry import installed
from xrdslam.testing.bits import different_leaves, frame_images, through_a_file
from xrdslam.testing.model_checks import check_losses, check_parameter_groups, check_rendering, check_surface
from xrdslam.testing.spoilt import not_finite, without_depth
from xrdslam.testing.toy_sequence import toy_sequence

__all__ = ["AlgorithmContract"]


_LACKS = "state_dict() lacks something, or draws are global"


@dataclass
class _Run:
    """What a run left behind."""

    algorithm: Algorithm
    changed: dict[int, list[str]] = field(default_factory=dict)
    """Frame index -> which of its images were written to."""
    checkpoints: list[dict[str, Any]] = field(default_factory=list)
    """The state after each frame, as it comes back from a file."""


class AlgorithmContract:
    """What every method must keep to, held on a few frames of a toy room.

    ```python
    class TestMySlam(AlgorithmContract):
        name = "my_slam"  # as registered; or override make_algorithm
        settings = {"tracking.iterations": 5}  # whatever makes it quick
        accuracy = 0.05  # optional: no camera centre is farther off [m]
    ```
    """

    name: ClassVar[str] = ""
    settings: ClassVar[dict[str, Any]] = {}
    seed: ClassVar[int] = 0
    accuracy: ClassVar[float | None] = None
    _reference: ClassVar[_Run | None] = None

    def __init_subclass__(cls, **kwargs: object) -> None:
        super().__init_subclass__(**kwargs)
        cls._reference = None  # each contract has a reference run of its own

    def make_config(self) -> AlgorithmConfig:
        """Return the settings of the registered method, `settings` laid over them."""
        record = installed().algorithm(self.name)
        config: AlgorithmConfig = record.load_config()()
        if config.name == "???":
            config.name = self.name
        if config.tracking.name == "???":
            config.tracking = installed().tracking_method(record.tracking).load_config()()
        if config.mapping.name == "???":
            config.mapping = installed().mapping_method(record.mapping).load_config()()
        for key, value in self.settings.items():
            *parents, leaf = key.split(".")
            holder: Any = config
            for parent in parents:
                holder = getattr(holder, parent)
            assert hasattr(holder, leaf), f"settings: {type(holder).__name__} has no {leaf!r}"
            setattr(holder, leaf, value)
        return config

    def make_algorithm(self) -> Algorithm:
        """Build the method; every call must build an equal one."""
        if not self.name:
            raise NotImplementedError(f"{type(self).__name__} needs a `name`, or a make_algorithm() of its own")
        from xrdslam.engine.build import build_algorithm

        return build_algorithm(self.make_config(), seed=self.seed)

    def make_sequence(self) -> Dataset:
        """Return what is run on; at least five frames."""
        return toy_sequence(num_frames=6)

    def test_every_pose_is_finite_and_rigid(self) -> None:
        trajectory = self._run_once().algorithm.trajectory
        for kind, poses in (("online", trajectory.online()), ("final", trajectory.current())):
            _assert_rigid(poses, kind)

    def test_the_trajectory_has_every_frame_once_and_in_order(self) -> None:
        trajectory = self._run_once().algorithm.trajectory
        frames = list(self.make_sequence().frames())
        assert trajectory.indices == [frame.index for frame in frames]
        assert trajectory.timestamps_ns.tolist() == [frame.timestamp_ns for frame in frames]

    def test_follows_the_camera(self) -> None:
        if self.accuracy is None:
            pytest.skip("set `accuracy` [m] to hold the trajectory to the toy room's")
        trajectory = self._run_once().algorithm.trajectory
        given = [frame.T_world_camera_gt for frame in self.make_sequence().frames()]
        truth = torch.stack([pose.double() for pose in given if pose is not None])
        found = trajectory.current()
        in_first = [se3.inverse(poses[:1]) @ poses for poses in (found, truth)]  # both in the first camera's frame
        worst = float((in_first[0] - in_first[1])[:, :3, 3].norm(dim=-1).max())
        assert worst <= self.accuracy, f"a camera centre is {worst:.4f} m off, at most {self.accuracy} m was promised"

    def test_the_same_seed_gives_the_same_bits(self) -> None:
        first, second = self._run_once().algorithm, self._run().algorithm
        changed = different_leaves(first.state_dict(), second.state_dict())
        assert not changed, f"two runs with one seed differ in {changed}"

    def test_frames_are_not_written_to(self) -> None:
        changed = self._run_once().changed
        assert not changed, f"images that were written to, by frame: {changed}; copy before changing"

    def test_a_resumed_run_gives_the_same_bits(self) -> None:
        """Each frame is carried out by a new process's algorithm, so to speak, that knows only what was saved.

        State goes through a file; whatever is not in it (a global random stream too) is another one afterwards.
        """
        reference = self._run_once()
        frames = list(self.make_sequence().frames())
        for position, saved in enumerate(reference.checkpoints[:-1]):
            resumed = self._resume(saved)
            lost = different_leaves(saved, resumed.state_dict())
            assert not lost, f"load_state_dict() does not take over {lost}: a run resumed twice would lack it"
            resumed.track(frames[position + 1])
            resumed.map(frames[position + 1])
            expected = reference.checkpoints[position + 1]
            changed = different_leaves(expected, resumed.state_dict())
            assert not changed, f"resumed before frame {position + 1}, {changed} differ after it: {_LACKS}"
        resumed = self._resume(reference.checkpoints[-1])
        resumed.finish()
        changed = different_leaves(reference.algorithm.state_dict(), resumed.state_dict())
        assert not changed, f"resumed before finish(), {changed} differ after it: {_LACKS}"

    def test_a_frame_without_depth_costs_no_run(self) -> None:
        self._survives(without_depth)

    def test_a_frame_of_nan_costs_no_run(self) -> None:
        self._survives(not_finite)

    def test_a_single_frame_is_a_run(self) -> None:
        algorithm = self._run(stop=1).algorithm
        assert len(algorithm.trajectory) == 1
        _assert_rigid(algorithm.trajectory.current(), "final")

    def test_the_map_keeps_the_contract_of_maps(self) -> None:
        algorithm = self._run_once().algorithm
        model, frame = algorithm.model, next(self.make_sequence().frames())
        pose = algorithm.trajectory.pose(frame.index).float()
        check_parameter_groups(model)
        check_surface(model, frame.camera, pose)
        if model.supports("render"):
            check_rendering(model, frame.camera, pose)
        if model.supports("losses"):
            check_losses(model, frame, pose, "mapping")
            check_losses(model, frame, pose, "tracking")

    def test_data_without_what_it_needs_is_refused(self) -> None:
        algorithm, scene = self.make_algorithm(), Scene.of(self.make_sequence())
        algorithm.check(scene)
        with pytest.raises(DataError):
            algorithm.check(dataclasses.replace(scene, modalities=frozenset()))

    def test_settings_that_make_no_sense_are_refused(self) -> None:
        algorithm = self.make_algorithm()
        for config in (algorithm.config, algorithm.tracking.config, algorithm.mapping.config):
            for key in (f.name for f in dataclasses.fields(config) if _is_a_count_or_rate(config, f.name)):
                with pytest.raises(ConfigError, match=key):
                    dataclasses.replace(config, **{key: type(getattr(config, key))(-1)})

    def test_listing_it_imports_nothing_heavy(self) -> None:
        if not self.name:
            pytest.skip("not registered: no `name`")
        source = (
            "import sys; from xrdslam.core.registry import installed; "
            f"record = installed().algorithm({self.name!r}); record.load_config(); "
            "sys.exit('torch is imported to list it' if 'torch' in sys.modules else 0)"
        )
        listed = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=False)
        assert listed.returncode == 0, listed.stderr
        assert issubclass(installed().algorithm(self.name).load(), Algorithm)

    def _run_once(self) -> _Run:
        cls = type(self)
        if cls._reference is None:
            cls._reference = self._run()
        return cls._reference

    def _run(self, stop: int | None = None, spoil: Callable[[int, Frame], Frame] | None = None) -> _Run:
        dataset = self.make_sequence()
        algorithm = self._fresh()
        kept = _Run(algorithm)
        for position, frame in zip(range(stop or len(dataset)), dataset.frames(), strict=False):
            frame = frame if spoil is None else spoil(position, frame)
            before = frame_images(frame)
            if position == 0:
                algorithm.check(Scene.of(dataset))
                algorithm.start(Scene.of(dataset), frame)
            else:
                algorithm.track(frame)
            algorithm.map(frame)
            if changed := different_leaves(before, frame_images(frame)):
                kept.changed[frame.index] = changed
            if spoil is None and stop is None:
                kept.checkpoints.append(through_a_file(algorithm.state_dict()))
        algorithm.finish()
        return kept

    def _resume(self, checkpoint: dict[str, Any]) -> Algorithm:
        """Return an algorithm that takes over a checkpoint as the engine has it do."""
        dataset = self.make_sequence()
        algorithm = self._fresh()
        algorithm.start(Scene.of(dataset), next(dataset.frames()))
        kept = checkpoint["keyframes"]["indices"].tolist()
        algorithm.load_state_dict(checkpoint, [frame for frame in dataset.frames() if frame.index in kept])
        _seed_everything(self.seed + 1)
        return algorithm

    def _fresh(self) -> Algorithm:
        _seed_everything(self.seed)
        return self.make_algorithm()

    def _survives(self, spoil: Callable[[Frame], Frame]) -> None:
        algorithm = self._run(spoil=lambda position, frame: spoil(frame) if position == 3 else frame).algorithm
        assert len(algorithm.trajectory) == len(self.make_sequence())
        for kind, poses in (("online", algorithm.trajectory.online()), ("final", algorithm.trajectory.current())):
            _assert_rigid(poses, kind)
        state = algorithm.model.state_dict()
        spoilt = [key for key, t in state.items() if t.is_floating_point() and not bool(torch.isfinite(t).all())]
        assert not spoilt, f"the damaged frame left the map with numbers that are not finite: {spoilt}"


def _seed_everything(seed: int) -> None:
    """Seed the global streams as an engine does."""
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002  # libraries may draw from numpy's global stream
    torch.manual_seed(seed)


def _assert_rigid(poses: Float64[Tensor, "n 4 4"], kind: str) -> None:
    for position, pose in enumerate(poses):
        assert se3.is_rigid(pose), f"{kind} pose {position} is not a finite rigid motion: {pose.tolist()}"


def _is_a_count_or_rate(config: object, key: str) -> bool:
    """Say whether a setting is one that -1 makes no sense for, by the words that all methods share."""
    value = getattr(config, key)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and (key.endswith(("iterations", "_every")) or key.startswith(("num_", "lr_")) or key == "window")
