"""A contract is worth what it refuses: each broken toy turns exactly the test red that its fault is about."""

import os
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.batch import Batch, Stage
from xrdslam.core.camera import Camera
from xrdslam.core.config import AlgorithmConfig
from xrdslam.core.dataset import Dataset
from xrdslam.core.errors import PluginError
from xrdslam.core.frame import Frame
from xrdslam.core.mapping import MappingResult
from xrdslam.core.model import Model, Rendering
from xrdslam.core.optimisation import ParameterGroup
from xrdslam.core.tracking import TrackingResult
from xrdslam.testing import (
    AlgorithmContract,
    DatasetContract,
    KernelContract,
    ModelContract,
    ToyAlgorithm,
    ToyModel,
    ToySequence,
    toy_algorithm,
    toy_sequence,
)


class WritesToImages(ToyAlgorithm):
    def track(self, frame: Frame) -> TrackingResult:
        frame.rgb.mul_(0.99)
        return super().track(frame)


class ForgetsItsState(ToyAlgorithm):
    """A drift that grows with every frame and is not in state_dict()."""

    seen = 0

    def predict(self, frame: Frame) -> Tensor:
        self.seen += 1
        predicted = super().predict(frame).clone()
        predicted[0, 3] += 1e-3 * self.seen
        return predicted


class ForgetsWhatItsMapCounts(ToyAlgorithm):
    """The map paints a shade at every third frame, by a count that is not in its state_dict()."""

    class model_class(ToyModel):
        frames = 0

        def extend(self, frame: Frame, T_world_camera: Tensor) -> int:
            self.frames += 1
            added = super().extend(frame, T_world_camera)
            with torch.no_grad():
                self.amplitudes.add_(0.01 if self.frames % 3 == 0 else 0.0)
            return added


class SavesWhatItDoesNotLoad(ToyAlgorithm):
    """A count that is saved, and begins at 0 after loading: resumed twice, it is gone."""

    seen = 0

    def track(self, frame: Frame) -> TrackingResult:
        self.seen += 1
        return super().track(frame)

    def state_dict(self) -> dict[str, dict[str, Tensor]]:
        return {**super().state_dict(), "seen": {"count": torch.tensor(self.seen)}}


class SavesCode(ToyAlgorithm):
    """An object that only pickle could save."""

    def state_dict(self) -> dict[str, dict[str, Any]]:
        return {**super().state_dict(), "config": {"tracking": self.tracking.config}}


class DrawsFromTheGlobalStream(ToyAlgorithm):
    def predict(self, frame: Frame) -> Tensor:
        predicted = super().predict(frame).clone()
        predicted[:3, 3] += 1e-3 * torch.rand(3)
        return predicted


class IsNotRepeatable(ToyAlgorithm):
    def predict(self, frame: Frame) -> Tensor:
        predicted = super().predict(frame).clone()
        predicted[0, 3] += 1e-3 * int.from_bytes(os.urandom(2)) / 65536
        return predicted


class SaysNan(ToyAlgorithm):
    def track(self, frame: Frame) -> TrackingResult:
        if frame.index != 4:
            return super().track(frame)
        self.trajectory.append(frame.index, frame.timestamp_ns, torch.full((4, 4), torch.nan))
        return TrackingResult(torch.full((4, 4), torch.nan))


class LosesCount(ToyAlgorithm):
    def track(self, frame: Frame) -> TrackingResult:
        frame.index += 1
        return super().track(frame)


class CannotStandDamage(ToyAlgorithm):
    def track(self, frame: Frame) -> TrackingResult:
        assert frame.depth is not None
        assert bool((frame.depth > 0).any()), "no depth"
        return super().track(frame)


class MapsDamage(ToyAlgorithm):
    def map(self, frame: Frame) -> MappingResult:
        return self.mapping.map(frame, self.model, self.keyframes)


class NeedsNothing(ToyAlgorithm):
    def check(self, scene: Scene) -> None:
        pass


class TakesAnySetting(AlgorithmConfig):
    def __post_init__(self) -> None:
        pass


def broken_algorithm(algorithm_class: type[ToyAlgorithm]) -> AlgorithmContract:
    class Contract(AlgorithmContract):
        accuracy = 1e-4

        def make_algorithm(self) -> Algorithm:
            algorithm = toy_algorithm(self.seed)
            algorithm.__class__ = algorithm_class
            algorithm.model_class = algorithm_class.model_class
            if algorithm_class is NeedsNothing:
                algorithm.config.__class__ = TakesAnySetting
            return algorithm

        def make_sequence(self) -> Dataset:
            return toy_sequence(5, 24, 18, num_balls=0)

    return Contract()


@pytest.mark.parametrize(
    ("algorithm_class", "test"),
    [
        (ToyAlgorithm, "test_follows_the_camera"),  # a tenth of a millimetre was promised, centimetres are delivered
        (WritesToImages, "test_frames_are_not_written_to"),
        (ForgetsItsState, "test_a_resumed_run_gives_the_same_bits"),
        (ForgetsWhatItsMapCounts, "test_a_resumed_run_gives_the_same_bits"),
        (SavesWhatItDoesNotLoad, "test_a_resumed_run_gives_the_same_bits"),
        (DrawsFromTheGlobalStream, "test_a_resumed_run_gives_the_same_bits"),
        (IsNotRepeatable, "test_the_same_seed_gives_the_same_bits"),
        (SaysNan, "test_every_pose_is_finite_and_rigid"),
        (LosesCount, "test_the_trajectory_has_every_frame_once_and_in_order"),
        (CannotStandDamage, "test_a_frame_without_depth_costs_no_run"),
        (MapsDamage, "test_a_frame_of_nan_costs_no_run"),
    ],
)
def test_a_broken_algorithm_is_caught(algorithm_class: type[ToyAlgorithm], test: str) -> None:
    with pytest.raises(AssertionError):
        getattr(broken_algorithm(algorithm_class), test)()


def test_an_algorithm_whose_state_is_code_is_caught() -> None:
    with pytest.raises(PluginError, match=r"config/tracking.*only tensors"):
        broken_algorithm(SavesCode).test_every_pose_is_finite_and_rigid()


@pytest.mark.parametrize(
    "test", ["test_data_without_what_it_needs_is_refused", "test_settings_that_make_no_sense_are_refused"]
)
def test_an_algorithm_that_refuses_nothing_is_caught(test: str) -> None:
    with pytest.raises(pytest.fail.Exception, match="DID NOT RAISE"):
        getattr(broken_algorithm(NeedsNothing), test)()


def test_each_contract_has_a_reference_run_of_its_own() -> None:
    sound, nan = broken_algorithm(ToyAlgorithm), broken_algorithm(SaysNan)
    sound.test_every_pose_is_finite_and_rigid()
    with pytest.raises(AssertionError):
        nan.test_every_pose_is_finite_and_rigid()


class StartsFull(ToyModel):
    @property
    def size(self) -> int:
        return 1 + len(self.amplitudes)


class AddsTheSameAgain(ToyModel):
    def extend(self, frame: Frame, T_world_camera: Tensor) -> int:
        self.amplitudes = nn.Parameter(torch.zeros(len(self.amplitudes) + 4, 3))
        return 4


class WritesToDepth(ToyModel):
    def extend(self, frame: Frame, T_world_camera: Tensor) -> int:
        assert frame.depth is not None
        frame.depth[frame.depth > 3] = 0
        return super().extend(frame, T_world_camera)


class HoldsAStranger(ToyModel):
    def parameter_groups(self) -> list[ParameterGroup]:
        return [*super().parameter_groups(), ParameterGroup("stranger", [nn.Parameter(torch.zeros(1))], 1e-3)]


class CutsTheGradient(ToyModel):
    def losses(self, batch: Batch, stage: Stage) -> dict[str, Tensor]:
        return {key: 0.0 * loss for key, loss in super().losses(batch, stage).items()}


class AveragesNothing(ToyModel):
    def losses(self, batch: Batch, stage: Stage) -> dict[str, Tensor]:
        depth = getattr(batch, "frame").depth  # noqa: B009  # the toy reads images
        return {**super().losses(batch, stage), "mean": depth[depth > 0].mean()}


class RendersNan(ToyModel):
    def render(self, camera: Camera, T_world_camera: Tensor) -> Rendering:
        rgb, depth, opacity = super().render(camera, T_world_camera)
        return Rendering(rgb, torch.where(opacity > 0, depth, torch.nan), opacity)


class CountsItsViews(ToyModel):
    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("views", torch.zeros(()))

    def render(self, camera: Camera, T_world_camera: Tensor) -> Rendering:
        self.get_buffer("views").add_(1)
        return super().render(camera, T_world_camera)


class IsNeverEmpty(ToyModel):
    def render(self, camera: Camera, T_world_camera: Tensor) -> Rendering:
        rgb, depth, opacity = super().render(camera, T_world_camera)
        return Rendering(rgb, depth, torch.ones_like(opacity))


class ForgetsAShade(ToyModel):
    shade = 0.0

    def extend(self, frame: Frame, T_world_camera: Tensor) -> int:
        self.shade = 0.1
        return super().extend(frame, T_world_camera)

    def render(self, camera: Camera, T_world_camera: Tensor) -> Rendering:
        rgb, depth, opacity = super().render(camera, T_world_camera)
        return Rendering(rgb + self.shade, depth, opacity)


def broken_model(model_class: type[ToyModel]) -> ModelContract:
    class Contract(ModelContract):
        def make_model(self, scene: Scene, frame: Frame) -> Model:
            return model_class()

        def make_sequence(self) -> Dataset:
            return toy_sequence(2, 24, 18)

    return Contract()


@pytest.mark.parametrize(
    ("model_class", "test"),
    [
        (StartsFull, "test_an_empty_map_says_so"),
        (AddsTheSameAgain, "test_extending_grows_the_map_by_what_it_lacks"),
        (WritesToDepth, "test_extending_changes_neither_the_frame_nor_its_pose"),
        (HoldsAStranger, "test_parameter_groups_are_sound"),
        (CutsTheGradient, "test_mapping_losses_reach_the_map"),
        (CutsTheGradient, "test_tracking_losses_reach_the_pose"),
        (AveragesNothing, "test_losses_are_numbers_where_no_depth_was_measured"),
        (RendersNan, "test_renders_the_empty_map"),
        (CountsItsViews, "test_renders_every_size_of_image"),
        (IsNeverEmpty, "test_renders_the_empty_map"),
        (ForgetsAShade, "test_a_saved_map_comes_back_whatever_its_size"),
    ],
)
def test_a_broken_map_is_caught(model_class: type[ToyModel], test: str) -> None:
    with pytest.raises(AssertionError):
        getattr(broken_model(model_class), test)()


class Cached(ToySequence):
    """Hands out the same frame twice."""

    def __getitem__(self, index: int) -> Frame:
        frames: dict[int, Frame] = self.__dict__.setdefault("frames_read", {})
        if index not in frames:
            frames[index] = super().__getitem__(index)
        return frames[index]


class Changed(ToySequence):
    """Changes each frame by `change`."""

    change: Any = None

    def __getitem__(self, index: int) -> Frame:
        frame = super().__getitem__(index)
        type(self).change(frame)
        return frame


def _millimetres(frame: Frame) -> None:
    assert frame.depth is not None
    frame.depth.mul_(1000)


def _bytes(frame: Frame) -> None:
    frame.rgb.mul_(255)


def _no_time(frame: Frame) -> None:
    frame.timestamp_ns = 5


def _off_by_one(frame: Frame) -> None:
    frame.index += 1


def _scaled(frame: Frame) -> None:
    assert frame.T_world_camera_gt is not None
    frame.T_world_camera_gt[:3, :3] *= 1.1


def _inverted(frame: Frame) -> None:
    assert frame.T_world_camera_gt is not None
    frame.T_world_camera_gt.copy_(torch.linalg.inv(frame.T_world_camera_gt))


def _opengl(frame: Frame) -> None:
    assert frame.T_world_camera_gt is not None
    frame.T_world_camera_gt[:3, 1:3] *= -1


def _holes_of_nan(frame: Frame) -> None:
    assert frame.depth is not None
    frame.depth[0] = torch.nan


def _no_depth(frame: Frame) -> None:
    frame.depth = None


def _damaged_silently(frame: Frame) -> None:
    frame.rgb.zero_()


@pytest.mark.parametrize(
    ("change", "test"),
    [
        (_millimetres, "test_depth_is_in_metres"),
        (_holes_of_nan, "test_depth_is_in_metres"),
        (_bytes, "test_images_have_the_agreed_form"),
        (_damaged_silently, "test_images_have_the_agreed_form"),
        (_no_time, "test_time_goes_forward"),
        (_off_by_one, "test_indexing_equals_iteration"),
        (_scaled, "test_poses_are_rigid"),
        (_inverted, "test_depth_and_poses_agree"),
        (_opengl, "test_depth_and_poses_agree"),
        (_no_depth, "test_carries_what_it_says"),
    ],
)
def test_a_broken_dataset_is_caught(change: Callable[[Frame], None], test: str) -> None:
    class Broken(Changed):
        pass

    Broken.change = staticmethod(change)

    class Contract(DatasetContract):
        def make_dataset(self) -> Dataset:
            return Broken(20, toy_sequence(1, 24, 18).camera)

    with pytest.raises(AssertionError):
        getattr(Contract(), test)()


def test_a_dataset_that_hands_out_its_own_images_is_caught() -> None:
    class Contract(DatasetContract):
        cached = Cached(2, toy_sequence(1, 24, 18).camera)

        def make_dataset(self) -> Dataset:
            return self.cached

    with pytest.raises(AssertionError, match="writing to a frame"):
        Contract().test_a_frame_belongs_to_who_read_it()


class Kernel(KernelContract):
    """Sound: x^3 by its twin."""

    def kernel(self, x: Tensor) -> Tensor:
        return self.twin(x)

    def twin(self, x: Tensor) -> Tensor:
        return x * x * x

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        return (torch.randn(20, dtype=dtype, generator=generator).requires_grad_(),)

    def empty_inputs(self) -> tuple[Tensor, ...]:
        return (torch.zeros(0, requires_grad=True),)


class WrongValue(Kernel):
    def kernel(self, x: Tensor) -> Tensor:
        return 1.001 * x * x * x


class WrongGradient(Kernel):
    def kernel(self, x: Tensor) -> Tensor:
        return x * x * x.detach()


class WrongTwin(Kernel):
    def twin(self, x: Tensor) -> Tensor:
        return x * x * x.detach()


class NoGradient(Kernel):
    def twin(self, x: Tensor) -> Tensor:
        return x * 0.0


class CountsThreads(Kernel):
    def kernel(self, x: Tensor) -> Tensor:
        return x * x * x * (1 + 1e-6 * torch.get_num_threads())


class WritesToItsInput(Kernel):
    def kernel(self, x: Tensor) -> Tensor:
        x.detach().mul_(2)
        return x


@pytest.mark.parametrize(
    ("kernel_class", "test"),
    [
        (WrongValue, "test_forward_equals_the_twin"),
        (WrongGradient, "test_backward_equals_the_twin"),
        (NoGradient, "test_backward_equals_the_twin"),
        (WrongTwin, "test_the_twin_agrees_with_finite_differences"),
        (CountsThreads, "test_one_and_two_threads_give_the_same_bits"),
        (WritesToItsInput, "test_inputs_are_not_written_to"),
    ],
)
def test_a_broken_kernel_is_caught(kernel_class: type[Kernel], test: str) -> None:
    getattr(Kernel(), test)()
    with pytest.raises(AssertionError):
        getattr(kernel_class(), test)()
