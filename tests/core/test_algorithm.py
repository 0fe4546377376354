"""The composition: who owns poses, what is mapped, what a lost frame costs, what is refused before the first frame."""

import dataclasses
import logging
from collections.abc import Callable, Sequence

import pytest
import torch
from torch import Tensor

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.config import AlgorithmConfig, MappingConfig, TrackingConfig
from xrdslam.core.dataset import Dataset, Modality
from xrdslam.core.errors import ConfigError, DataError, PluginError
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3, so3
from xrdslam.core.mapping import MappingMethod, MappingResult
from xrdslam.core.model import Model
from xrdslam.core.tracking import TrackingMethod, TrackingResult
from xrdslam.core.trajectory import Trajectory
from xrdslam.testing import ToyModel, ToyRayModel, ToySequence, run, toy_algorithm, toy_sequence

SHIFT = se3.compose(so3.exp(torch.tensor([0.0, 0.1, 0.0])), torch.tensor([0.5, 0.0, 0.0]))
NAN = torch.full((4, 4), torch.nan)


class Counting(Model):
    """A map that remembers what it was extended by."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[int] = []

    @property
    def size(self) -> int:
        return len(self.seen)

    def extend(self, frame: Frame, T_world_camera: Tensor) -> int:
        self.seen.append(frame.index)
        return 1


class Scripted(TrackingMethod):
    """Says what `answer` says of each frame's true pose; remembers what it was told."""

    needs = frozenset({"rgb", "depth", "pose"})

    def __init__(self, answer: Callable[[Frame, Tensor], TrackingResult]) -> None:
        super().__init__(TrackingConfig("scripted"))
        self.answer = answer
        self.predicted: dict[int, Tensor] = {}
        self.integrated: dict[int, Tensor] = {}

    def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
        self.predicted[frame.index] = frame.pose.matrix().detach().clone()
        assert frame.T_world_camera_gt is not None
        return self.answer(frame, frame.T_world_camera_gt)

    def integrate(self, frame: Frame, T_world_camera: Tensor) -> None:
        self.integrated[frame.index] = T_world_camera


class Moving(MappingMethod):
    """Moves poses as `move` says."""

    def __init__(
        self, move: Callable[[Frame, Sequence[Frame]], dict[int, Tensor]] = lambda frame, keyframes: {}
    ) -> None:
        super().__init__(MappingConfig("moving"))
        self.move = move
        self.last: dict[int, Tensor] = {}

    def map(self, frame: Frame, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        model.extend(frame, frame.pose.matrix().detach())
        return MappingResult(poses=self.move(frame, keyframes))

    def finish(self, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        return MappingResult(poses=self.last)


class Composed(Algorithm):
    model: Counting

    def build_model(self, scene: Scene, frame: Frame) -> Model:
        self.first_seen = frame.pose.matrix().detach()
        return Counting()


def exactly(frame: Frame, truth: Tensor) -> TrackingResult:
    return TrackingResult(truth)


def composed(
    answer: Callable[[Frame, Tensor], TrackingResult] = exactly,
    mapping: MappingMethod | None = None,
    **settings: object,
) -> tuple[Composed, Scripted]:
    config = AlgorithmConfig("composed", **settings)  # type: ignore[arg-type]  # mypy sees one type for all
    tracking = Scripted(answer)
    return Composed(config, tracking, mapping or Moving()), tracking


def sequence(count: int = 8) -> ToySequence:
    return toy_sequence(count, 16, 12)


def go(algorithm: Algorithm, dataset: Dataset | None = None) -> Algorithm:
    dataset = dataset or sequence()
    return run(algorithm, Scene.of(dataset), dataset.frames())


# What is tracked, mapped, kept


def test_what_the_tracker_finds_is_the_trajectory() -> None:
    algorithm, tracking = composed()
    go(algorithm)
    truth = torch.stack(
        [frame.T_world_camera_gt.double() for frame in sequence() if frame.T_world_camera_gt is not None]
    )
    assert torch.equal(algorithm.trajectory.online(), truth)
    torch.testing.assert_close(algorithm.trajectory.current(), truth, rtol=0, atol=1e-14)
    assert sorted(tracking.integrated) == list(range(8))
    assert not algorithm.trajectory.is_lost.any()


def test_the_tracker_starts_from_the_motion_models_guess() -> None:
    algorithm, tracking = composed()
    go(algorithm)
    poses = algorithm.trajectory.online()
    expected = poses[4] @ se3.inverse(poses[3]) @ poses[4]
    torch.testing.assert_close(tracking.predicted[5].double(), expected, rtol=0, atol=1e-6)
    algorithm, tracking = composed(motion="none")
    go(algorithm)
    torch.testing.assert_close(tracking.predicted[5].double(), poses[4], rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("map_every", "keyframe_every", "mapped", "keyframes"),
    [(1, 5, [0, 1, 2, 3, 4, 5, 6, 7], [0, 5]), (3, 2, [0, 3, 6], [0, 2, 4, 6]), (100, 100, [0], [0])],
)
def test_frames_are_mapped_and_kept_in_their_rhythm(
    map_every: int, keyframe_every: int, mapped: list[int], keyframes: list[int]
) -> None:
    algorithm, _ = composed(map_every=map_every, keyframe_every=keyframe_every)
    go(algorithm)
    assert algorithm.model.seen == mapped
    assert [frame.index for frame in algorithm.keyframes] == keyframes


# Who owns poses


def test_poses_that_mapping_moves_reach_the_final_trajectory_and_carry_their_frames() -> None:
    """What bundle adjustment finds must not stay in the mapper's copy."""
    moving = Moving(
        lambda frame, keyframes: {0: SHIFT @ keyframes[0].pose.matrix().detach()} if frame.index == 7 else {}
    )
    algorithm, _ = composed(mapping=moving, keyframe_every=4)
    go(algorithm)
    online, final = algorithm.trajectory.online(), algorithm.trajectory.current()
    torch.testing.assert_close(final[:4], SHIFT.double() @ online[:4], rtol=0, atol=1e-6)
    torch.testing.assert_close(final[4:], online[4:], rtol=0, atol=1e-14)


def test_the_current_frame_moved_together_with_its_keyframe_is_where_mapping_says() -> None:
    """Whichever is reported first: a frame written before its keyframe would be carried along once more."""
    moved = {3: SHIFT, 0: SHIFT @ SHIFT}
    for order in ((3, 0), (0, 3)):
        moving = Moving(lambda frame, keyframes, order=order: {i: moved[i] for i in order} if frame.index == 3 else {})
        algorithm, _ = composed(mapping=moving)
        go(algorithm, sequence(4))
        for index, pose in moved.items():
            torch.testing.assert_close(algorithm.trajectory.pose(index), pose.double(), rtol=0, atol=1e-6)


def test_the_next_prediction_follows_what_mapping_moved() -> None:
    moving = Moving(lambda frame, keyframes: {frame.index: SHIFT} if frame.index == 2 else {})
    algorithm, tracking = composed(mapping=moving, motion="none")
    go(algorithm)
    torch.testing.assert_close(tracking.predicted[3], SHIFT, rtol=0, atol=1e-6)


def test_trackers_may_revise_earlier_poses() -> None:
    algorithm, _ = composed(lambda frame, truth: TrackingResult(truth, poses={0: SHIFT} if frame.index == 3 else {}))
    go(algorithm, sequence(4))
    torch.testing.assert_close(algorithm.trajectory.pose(0), SHIFT.double(), rtol=0, atol=1e-14)


def test_the_last_refinement_reaches_the_final_trajectory() -> None:
    moving = Moving()
    moving.last = {5: SHIFT}
    algorithm, _ = composed(mapping=moving)
    go(algorithm)
    torch.testing.assert_close(algorithm.trajectory.pose(5), SHIFT.double(), rtol=0, atol=1e-6)
    assert not torch.equal(algorithm.trajectory.online()[5], SHIFT.double())


def test_a_pose_of_nan_from_mapping_is_refused_and_does_not_linger(caplog: pytest.LogCaptureFixture) -> None:
    """Neither in the trajectory nor in the keyframe, whose pose the next mapping step starts from."""

    def move(frame: Frame, keyframes: Sequence[Frame]) -> dict[int, Tensor]:
        if frame.index != 6:
            return {}
        for moved in (keyframes[0], frame):
            moved.pose.load_state_dict({"rotation": torch.full((3,), torch.nan), "translation": torch.zeros(3)})
        return {0: NAN, 6: NAN, 5: SHIFT}

    algorithm, _ = composed(mapping=Moving(move), keyframe_every=2)
    with caplog.at_level(logging.WARNING):
        go(algorithm)
    assert bool(torch.isfinite(algorithm.trajectory.current()).all())
    torch.testing.assert_close(algorithm.trajectory.pose(0), algorithm.trajectory.online()[0], rtol=0, atol=1e-14)
    torch.testing.assert_close(algorithm.trajectory.pose(5), SHIFT.double(), rtol=0, atol=1e-6)
    for keyframe in algorithm.keyframes:
        assert bool(torch.isfinite(keyframe.pose.matrix()).all())
    assert sorted(r.getMessage()[:13] for r in caplog.records) == ["frame 0 was m", "frame 6 was m"]


# Lost frames


def lost_at_five(frame: Frame, truth: Tensor) -> TrackingResult:
    return TrackingResult(SHIFT, is_lost=True, reason="scripted") if frame.index == 5 else TrackingResult(truth)


def nan_at_five(frame: Frame, truth: Tensor) -> TrackingResult:
    return TrackingResult(NAN if frame.index == 5 else truth)


@pytest.mark.parametrize(("answer", "reason"), [(lost_at_five, "scripted"), (nan_at_five, "not finite")])
def test_a_lost_frame_keeps_its_prediction_and_stays_out_of_the_map(
    answer: Callable[[Frame, Tensor], TrackingResult], reason: str
) -> None:
    algorithm, tracking = composed(answer)
    dataset = sequence()
    frames = list(dataset.frames())
    algorithm.start(Scene.of(dataset), frames[0])
    algorithm.map(frames[0])
    for frame in frames[1:]:
        result = algorithm.track(frame)
        mapped = algorithm.map(frame)
        if frame.index == 5:
            assert result.is_lost
            assert not result.converged
            assert reason in result.reason
            assert mapped is None
            torch.testing.assert_close(result.T_world_camera, tracking.predicted[5], rtol=0, atol=1e-6)
    torch.testing.assert_close(frames[5].pose.matrix().detach(), tracking.predicted[5], rtol=0, atol=1e-6)
    assert algorithm.trajectory.is_lost.tolist() == [i == 5 for i in range(8)]
    torch.testing.assert_close(algorithm.trajectory.pose(5), tracking.predicted[5].double(), rtol=0, atol=1e-6)
    assert algorithm.model.seen == [0, 1, 2, 3, 4, 6, 7]
    assert [frame.index for frame in algorithm.keyframes] == [0]  # the fifth was due
    assert 5 not in tracking.integrated


class Spoilt(ToySequence):
    """The frame `at` shows nothing."""

    at = 5
    value = 0.0
    image = False

    def __getitem__(self, index: int) -> Frame:
        frame = super().__getitem__(index)
        if index == self.at:
            assert frame.depth is not None
            (frame.rgb if self.image else frame.depth).fill_(self.value)
        return frame


def spoilt(at: int, value: float, image: bool = False) -> Spoilt:
    dataset = Spoilt(8, sequence().camera)
    dataset.at, dataset.value, dataset.image = at, value, image
    return dataset


@pytest.mark.parametrize(("value", "image"), [(0.0, False), (torch.nan, False), (torch.nan, True), (torch.inf, True)])
def test_a_frame_that_shows_nothing_is_lost_before_anyone_looks_at_it(value: float, image: bool) -> None:
    algorithm, tracking = composed()
    go(algorithm, spoilt(5, value, image))
    assert algorithm.trajectory.is_lost.tolist() == [i == 5 for i in range(8)]
    assert 5 not in tracking.predicted
    assert algorithm.model.seen == [0, 1, 2, 3, 4, 6, 7]


def test_a_frame_that_only_the_mapper_cannot_use_is_tracked_and_not_mapped() -> None:
    class NeedsDepth(Moving):
        needs = frozenset({"rgb", "depth"})

    algorithm, tracking = composed(mapping=NeedsDepth(), keyframe_every=1)
    tracking.needs = frozenset({"rgb", "pose"})  # type: ignore[misc]  # of this one tracker
    go(algorithm, spoilt(5, 0.0))
    assert not algorithm.trajectory.is_lost.any()
    assert 5 in tracking.integrated
    assert 5 not in algorithm.model.seen
    assert 5 not in [frame.index for frame in algorithm.keyframes]


def test_a_first_frame_that_shows_nothing_is_refused() -> None:
    algorithm, _ = composed()
    with pytest.raises(
        DataError, match=r"frame 0 cannot be the first: no pixel has a depth; begin later with dataset\.fr"
    ):
        go(algorithm, spoilt(0, 0.0))


def test_lost_for_good_the_camera_comes_to_rest_and_the_run_ends() -> None:
    """The first lost frame is the prediction; then each step is half the one before: two steps in all, at most."""
    algorithm, _ = composed(lambda frame, truth: TrackingResult(truth, is_lost=frame.index > 1))
    go(algorithm)
    poses = algorithm.trajectory.current()
    steps = se3.inverse(poses[:-1]) @ poses[1:]
    torch.testing.assert_close(steps[1], steps[0], rtol=0, atol=1e-5)  # float32 predictions
    for index in range(2, 7):
        torch.testing.assert_close(steps[index, :3, 3], 0.5 * steps[index - 1, :3, 3], rtol=0, atol=1e-5)
        turns = [so3.log(steps[i, :3, :3]) for i in (index, index - 1)]
        torch.testing.assert_close(turns[0], 0.5 * turns[1], rtol=0, atol=1e-5)
    assert algorithm.trajectory.is_lost.tolist() == [False, False, *[True] * 6]


# The first pose


@pytest.mark.parametrize(("first_pose", "is_given"), [("auto", True), ("ground_truth", True), ("identity", False)])
def test_the_world_is_where_the_configuration_says(first_pose: str, is_given: bool) -> None:
    algorithm, tracking = composed(first_pose=first_pose)
    go(algorithm, sequence(1))
    given = sequence(1)[0].T_world_camera_gt
    assert given is not None
    expected = given if is_given else torch.eye(4)
    torch.testing.assert_close(algorithm.trajectory.pose(0), expected.double(), rtol=0, atol=1e-14)
    torch.testing.assert_close(algorithm.first_seen, expected)  # the map is built with the frame in its place
    assert torch.equal(tracking.integrated[0], expected)


def test_without_ground_truth_the_world_is_the_first_camera_or_the_run_is_refused() -> None:
    dataset = ToySequence(1, sequence().camera, modalities=["rgb", "depth"])
    frame = dataset[0]
    for given in (None, NAN):
        frame.T_world_camera_gt = given
        assert torch.equal(composed()[0].first_pose(frame), torch.eye(4))
        with pytest.raises(DataError, match=r"first_pose=ground_truth: frame 0 has no finite ground-truth pose"):
            composed(first_pose="ground_truth")[0].first_pose(frame)


# What is refused before the first frame


@pytest.mark.parametrize("missing", ["rgb", "depth", "pose"])
def test_a_modality_that_is_needed_and_missing_is_named(missing: Modality) -> None:
    algorithm, _ = composed()
    scene = Scene.of(sequence())
    algorithm.check(scene)
    with pytest.raises(DataError, match=rf"algo=composed with algo/tracking=scripted and .*=moving needs {missing}"):
        algorithm.check(dataclasses.replace(scene, modalities=scene.modalities - {missing}))


def test_a_mapper_that_makes_no_map_needs_nothing_of_the_frames() -> None:
    class Nothing(Moving):
        needs = frozenset({"imu"})
        changes_map = False

    algorithm, _ = composed(mapping=Nothing())
    algorithm.check(Scene.of(sequence()))


def test_following_a_map_that_nobody_makes_is_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    class Nothing(Moving):
        changes_map = False

    toy = toy_algorithm()
    toy.mapping = Nothing()
    with caplog.at_level(logging.WARNING):
        toy.check(Scene.of(sequence()))
    assert "every frame will be lost" in caplog.text


def test_a_tracker_that_cannot_read_the_map_is_refused() -> None:
    class RaysOnly(type(toy_algorithm().tracking)):  # type: ignore[misc]  # the toy's own tracker
        batch_kinds = frozenset({"rays"})

    for model_class, is_fine in ((ToyRayModel, True), (ToyModel, False)):
        toy = toy_algorithm(0, model_class)
        toy.tracking = RaysOnly(toy.tracking.config)
        if is_fine:
            toy.start(Scene.of(sequence()), sequence()[0])
        else:
            with pytest.raises(
                PluginError, match=r"reads rays batches, but the map .* \(ToyModel\) gives image batches"
            ):
                toy.start(Scene.of(sequence()), sequence()[0])


def test_a_map_without_losses_cannot_be_descended() -> None:
    toy = toy_algorithm()
    toy.build_model = lambda scene, frame: Counting()  # type: ignore[method-assign]
    with pytest.raises(PluginError, match="gives no losses"):
        toy.start(Scene.of(sequence()), sequence()[0])


def test_a_pose_that_is_finite_but_not_rigid_is_a_loud_error() -> None:
    """It is a bug of the tracker: neither a pose nor a lost frame."""
    algorithm, _ = composed(lambda frame, truth: TrackingResult(2 * truth))
    with pytest.raises(DataError, match="not a rigid motion"):
        go(algorithm)


def test_settings_that_make_no_sense_are_refused() -> None:
    for key, value in (("map_every", 0), ("keyframe_every", 0), ("first_pose", "last"), ("motion", "teleport")):
        with pytest.raises(ConfigError, match=f"algo.{key}={value}"):
            composed(**{key: value})


# State


def test_before_any_keyframe_the_state_is_complete_too() -> None:
    algorithm, _ = composed()
    dataset = sequence(1)
    algorithm.start(Scene.of(dataset), dataset[0])
    algorithm.model.state_dict()
    state = algorithm.state_dict()
    assert state["keyframes"]["indices"].dtype == torch.int64
    algorithm.load_state_dict(state, [])
    assert algorithm.keyframes == []
    assert len(algorithm.trajectory) == 1


def test_keyframe_poses_come_back_with_the_same_bits() -> None:
    """As parameters: exp(log(R)) would be an ulp off, and a resumed run another one."""
    algorithm, _ = composed(keyframe_every=1)
    go(algorithm)
    state = algorithm.state_dict()
    other, _ = composed(keyframe_every=1)
    frames = list(sequence().frames())
    other.start(Scene.of(sequence()), frames[0])
    other.load_state_dict(state, frames)
    for a, b in zip(algorithm.keyframes, other.keyframes, strict=True):
        assert torch.equal(a.pose.rotation, b.pose.rotation)
        assert torch.equal(a.pose.translation, b.pose.translation)


def test_a_whole_method_follows_the_toy_room() -> None:
    """Gradient tracking and mapping together: millimetres to centimetres on a path of 16 cm."""
    dataset = toy_sequence(8, 32, 24, num_balls=0)
    algorithm = go(toy_algorithm(), dataset)
    errors = (algorithm.trajectory.current() - dataset.poses)[:, :3, 3].norm(dim=-1)
    assert float(errors.max()) < 0.06
    assert not algorithm.trajectory.is_lost.any()
