"""The toys are plugins like any other: each contract holds for them, which is also how a contract is used."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.config import IterativeMappingConfig
from xrdslam.core.dataset import Dataset
from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.testing import (
    AlgorithmContract,
    DatasetContract,
    KernelContract,
    ModelContract,
    ToyModel,
    ToyRayModel,
    ToySequence,
    toy_algorithm,
    toy_sequence,
)


class TestToySequence(DatasetContract):
    consistency = 0.02  # half a pixel is 1/(2 * 0.9 * 64) of depth across it: 0.9 % on a slant of 45 degrees

    def make_dataset(self) -> Dataset:
        return toy_sequence(4)

    def make_damaged(self) -> tuple[Dataset, int]:
        return ToySequence(4, toy_sequence().camera, damaged=[2]), 2


class TestToyModel(ModelContract):
    def make_model(self, scene: Scene, frame: Frame) -> Model:
        return ToyModel()


class TestToyRayModel(ModelContract):
    def make_model(self, scene: Scene, frame: Frame) -> Model:
        return ToyRayModel()


class TestToyAlgorithm(AlgorithmContract):
    accuracy = 0.08  # four of eight waves of paint are known at the first frame: a rough map, 2 cm a frame

    def make_algorithm(self) -> Algorithm:
        return toy_algorithm(self.seed)

    def make_sequence(self) -> Dataset:
        return toy_sequence(6, 32, 24, num_balls=0)


class TestToyAlgorithmOnRaysWithMovingPosesAndKeptMoments(TestToyAlgorithm):
    def make_algorithm(self) -> Algorithm:
        mapping = IterativeMappingConfig(
            "toy", 20, keyframes="random", window=3, lr_pose_rotation=1e-3, lr_pose_translation=1e-3,
            pose_accumulate=3, num_pixels=256, keep_optimiser=True,
        )  # fmt: skip
        return toy_algorithm(self.seed, ToyRayModel, mapping=mapping)


class TestAKernel(KernelContract):
    """x^2 y and a mask, the gradient by hand."""

    def kernel(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        return _SquareTimes.apply(x, y), x > 0  # type: ignore[no-untyped-call]

    def twin(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        return x * x * y, x > 0

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
        x, y = torch.randn(2, 50, dtype=dtype, generator=generator).unbind(0)
        return x.clone().requires_grad_(), y.clone().requires_grad_()

    def empty_inputs(self) -> tuple[Tensor, Tensor]:
        return torch.zeros(0, requires_grad=True), torch.zeros(0, requires_grad=True)


class _SquareTimes(torch.autograd.Function):
    @staticmethod
    def forward(ctx: torch.autograd.function.FunctionCtx, x: Tensor, y: Tensor) -> Tensor:
        ctx.save_for_backward(x, y)
        return x.square() * y

    @staticmethod
    def backward(ctx: torch.autograd.function.FunctionCtx, cotangent: Tensor) -> tuple[Tensor, Tensor]:
        x, y = ctx.saved_tensors  # type: ignore[attr-defined]
        return 2 * x * y * cotangent, x.square() * cotangent


def test_a_contract_without_its_factory_says_what_is_missing() -> None:
    calls: list[tuple[Callable[[], object], str]] = [
        (AlgorithmContract().test_every_pose_is_finite_and_rigid, "make_algorithm"),
        (ModelContract().test_an_empty_map_says_so, "make_model"),
        (DatasetContract().test_passes_its_own_check, "make_dataset"),
    ]
    for call, missing in calls:
        with pytest.raises(NotImplementedError, match=missing):
            call()
