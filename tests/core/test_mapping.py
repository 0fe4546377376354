"""Gradient mapping: the map comes to explain its frames, and poses come to where they belong."""

import math

import pytest
import torch
from torch import Tensor

from xrdslam.core.config import IterativeMappingConfig
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3, so3
from xrdslam.core.mapping import GradientMapping, MappingProblem
from xrdslam.core.model import Model
from xrdslam.core.optimisation import GroupedOptimiser, ParameterGroup
from xrdslam.testing import ToyModel, ToyRayModel, toy_sequence

MODELS = [ToyModel, ToyRayModel]


def frames(count: int) -> list[Frame]:
    found = list(toy_sequence(count, 32, 24, num_balls=0).frames())
    for frame in found:
        assert frame.T_world_camera_gt is not None
        frame.pose.set_(frame.T_world_camera_gt)
    return found


def config(**settings: object) -> IterativeMappingConfig:
    quick = {"iterations": 60, "keyframes": "all", "num_pixels": 256}
    return IterativeMappingConfig("toy", **(quick | settings))  # type: ignore[arg-type]  # mypy sees one type for all


@pytest.mark.parametrize("model_class", MODELS)
def test_the_map_comes_to_explain_the_first_frame(model_class: type[ToyModel]) -> None:
    (frame,) = frames(1)
    model = model_class()
    result = GradientMapping(config(iterations=150)).map(frame, model, [])
    assert result.num_added == model.size == 4
    assert result.iterations == 150
    assert result.poses == {}
    flat = float(frame.rgb.var(dim=(0, 1)).mean())  # what one colour for all would leave
    with torch.no_grad():
        rendering = model.render(frame.camera, frame.pose.matrix())
    assert (
        float((rendering.rgb - frame.rgb).square().mean()) < 0.4 * flat
    )  # four of the room's eight waves are known: 0.33
    assert frame.depth is not None
    assert float((rendering.depth - frame.depth).abs().mean()) < 0.01


class Fixed(ToyModel):
    """Grows no further, so that its parameters are the same ones from call to call."""

    def extend(self, frame: Frame, T_world_camera: Tensor) -> int:
        return super().extend(frame, T_world_camera) if self.size == 0 else 0


class FixedOnRays(Fixed, ToyRayModel):
    pass


class PosesOnly(GradientMapping):
    def groups(self, problem: MappingProblem) -> list[ParameterGroup]:
        return []


@pytest.mark.parametrize("model_class", [Fixed, FixedOnRays])
def test_a_pose_that_is_off_comes_back_and_is_reported_and_the_anchor_stays(model_class: type[ToyModel]) -> None:
    """Bundle adjustment against a map that is right: the moved pose is in the result (it is the only way out)."""
    window = frames(3)
    truth = [frame.pose.matrix().detach().clone() for frame in window]
    offset = se3.compose(so3.exp(torch.tensor([0.005, -0.01, 0.005])), torch.tensor([0.015, -0.01, 0.01]))
    for frame, pose in zip(window[1:], truth[1:], strict=True):
        frame.pose.set_(pose @ offset)
    mapping = PosesOnly(config(iterations=200, lr_pose_rotation=1e-3, lr_pose_translation=1e-3))
    model = model_class.exact()
    result = mapping.map(window[2], model, window[:2])
    assert sorted(result.poses) == [1, 2]
    for index in (1, 2):
        assert torch.equal(result.poses[index], window[index].pose.matrix().detach())
        before, after = (float((m - truth[index])[:3, 3].norm()) for m in (truth[index] @ offset, result.poses[index]))
        assert after < 0.5 * before
    assert torch.equal(window[0].pose.matrix().detach(), truth[0])


def test_the_first_frame_of_all_holds_the_world() -> None:
    """With poses free to move, the first frame's is not: the whole world could drift with it."""
    (frame,) = frames(1)
    before = frame.pose.matrix().detach().clone()
    result = GradientMapping(config(lr_pose_rotation=1e-2, lr_pose_translation=1e-2)).map(frame, ToyModel(), [])
    assert result.poses == {}
    assert torch.equal(frame.pose.matrix().detach(), before)


def test_without_rates_no_pose_moves() -> None:
    window = frames(3)
    before = [frame.pose.matrix().detach().clone() for frame in window]
    result = GradientMapping(config(iterations=5)).map(window[2], ToyModel.exact(), window[:2])
    assert result.poses == {}
    assert all(torch.equal(f.pose.matrix().detach(), b) for f, b in zip(window, before, strict=True))
    assert all(f.pose.rotation.grad is None for f in window)


def test_poses_step_on_gradients_summed_over_iterations() -> None:
    """Five iterations, every third of them due: one step, by its rate (Adam's first); the two left over are dropped."""
    window = frames(2)
    start = window[1].pose.translation.detach().clone()
    mapping = GradientMapping(config(iterations=5, pose_accumulate=3, lr_pose_rotation=0.0, lr_pose_translation=1e-3))
    for calls in (1, 2):
        mapping.map(window[1], ToyRayModel.exact(), window[:1])
        moved = (window[1].pose.translation.detach() - start).abs()
        assert float(moved.max()) <= calls * 1e-3 * 1.0001
    assert float(moved.max()) > 0


def test_the_window_is_chosen_by_the_policy() -> None:
    window = frames(5)
    chosen = GradientMapping(config(keyframes="window", window=3)).select(window[4], window[:4])
    assert [frame.index for frame in chosen] == [2, 3, 4]


def test_the_first_frame_has_iterations_of_its_own() -> None:
    mapping = GradientMapping(config(iterations=3, first_iterations=7))
    model = ToyModel()
    window = frames(2)
    assert mapping.map(window[0], model, []).iterations == 7
    assert mapping.map(window[1], model, window[:1]).iterations == 3
    assert GradientMapping(config(iterations=3)).map(window[0], ToyModel(), []).iterations == 3


def test_a_frame_is_mapped_from_the_pose_it_has() -> None:
    class Seen(ToyModel):
        poses: list[Tensor]

        def extend(self, frame: Frame, T_world_camera: Tensor) -> int:
            self.poses = [T_world_camera]
            return super().extend(frame, T_world_camera)

    (frame,) = frames(1)
    model = Seen()
    GradientMapping(config(iterations=1)).map(frame, model, [])
    assert torch.equal(model.poses[0], frame.pose.matrix().detach())
    assert not model.poses[0].requires_grad


def two_calls(keep: bool, between: bool = False) -> tuple[GradientMapping, Model]:
    """Map two frames; `between` takes the method through its state."""
    window = frames(2)
    model, settings = Fixed(), config(iterations=4, keep_optimiser=keep)
    mapping = GradientMapping(settings, seed=1)
    mapping.map(window[0], model, [])
    if between:
        state, mapping = mapping.state_dict(), GradientMapping(settings, seed=9)
        mapping.load_state_dict({key: tensor.clone() for key, tensor in state.items()})
    mapping.map(window[1], model, window[:1])
    return mapping, model


def test_moments_are_kept_or_begun_anew_and_saved_where_kept() -> None:
    for keep in (True, False):
        (kept, model), (resumed, other) = two_calls(keep), two_calls(keep, between=True)
        assert all(torch.equal(a, b) for a, b in zip(model.parameters(), other.parameters(), strict=True))
        steps = [float(v) for k, v in kept.state_dict().items() if k.endswith("step")]
        assert steps == ([8.0, 8.0] if keep else [])
        assert kept.state_dict().keys() == resumed.state_dict().keys()
    first, second = (two_calls(keep)[1] for keep in (True, False))
    assert not torch.equal(*(next(iter(m.parameters())) for m in (first, second)))


def test_kept_moments_do_not_outlive_the_parameters_they_belong_to() -> None:
    """A map that replaces its parameters when it grows: they are optimised, with moments of their own."""
    window = frames(2)
    model = ToyModel()
    mapping = GradientMapping(config(iterations=5, keep_optimiser=True))
    mapping.map(window[0], model, [])
    walls = mapping.state_dict()["optimiser.0.0.step"]
    mapping.map(window[1], model, window[:1])
    assert not torch.equal(model.amplitudes[4], torch.zeros(3))  # the row that the second frame brought has moved
    assert float(mapping.state_dict()["optimiser.0.0.step"]) == float(walls) == 10.0  # the same tensor, gone on
    assert float(mapping.state_dict()["optimiser.1.0.step"]) == 5.0


def test_a_window_frame_is_drawn_for_each_image_batch() -> None:
    window = frames(3)
    mapping = GradientMapping(config())
    problem = MappingProblem(ToyModel.exact(), window, False, 0)
    drawn = [mapping.batch(problem) for _ in range(60)]
    counts = [sum(getattr(batch, "frame") is frame for batch in drawn) for frame in window]  # noqa: B009
    assert sum(counts) == 60
    assert min(counts) > 5  # 20 expected, sigma 3.7: four of them


def test_rays_are_drawn_over_the_whole_window() -> None:
    window = frames(3)
    batch = GradientMapping(config(num_pixels=30)).batch(MappingProblem(ToyRayModel.exact(), window, False, 0))
    slots = getattr(batch, "frame_slot")  # noqa: B009  # the model takes rays
    assert slots.bincount().tolist() == [10, 10, 10]


def test_a_map_without_losses_to_descend_is_left_alone() -> None:
    class NoGroups(ToyModel):
        def parameter_groups(self) -> list[ParameterGroup]:
            return []

    (frame,) = frames(1)
    result = GradientMapping(config(iterations=2)).map(frame, NoGroups(), [])
    assert result.iterations == 2
    assert math.isfinite(result.loss)


@pytest.mark.parametrize("model_class", MODELS)
def test_after_the_last_frame_the_map_settles_and_no_pose_moves(
    model_class: type[ToyModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    rates: list[float] = []
    original = GroupedOptimiser.step

    def noted(self: GroupedOptimiser, iteration: int) -> None:
        rates.append(self.groups[0].lr * self.groups[0].schedule(iteration))
        original(self, iteration)

    window = frames(3)
    model = model_class()
    mapping = GradientMapping(
        config(
            iterations=20,
            lr_pose_rotation=1e-2,
            lr_pose_translation=1e-2,
            final_iterations_per_keyframe=10,
            final_rates=[2.0, 0.02],
        )
    )
    for position, frame in enumerate(window):
        mapping.map(frame, model, window[:position])
    poses = [frame.pose.matrix().detach().clone() for frame in window]
    monkeypatch.setattr(GroupedOptimiser, "step", noted)
    result = mapping.finish(model, window)
    assert result.iterations == len(rates) == 30
    assert result.poses == {}
    own = model.parameter_groups()[0].lr
    assert [rates[0], rates[15]] == pytest.approx([2 * own, 0.2 * own])
    assert all(torch.equal(f.pose.matrix(), pose) for f, pose in zip(window, poses, strict=True))


def test_without_final_iterations_nothing_happens_after_the_last_frame() -> None:
    window, model = frames(1), ToyModel()
    mapping = GradientMapping(config(iterations=5))
    mapping.map(window[0], model, [])
    before = [p.detach().clone() for p in model.parameters()]
    assert mapping.finish(model, window).iterations == 0
    assert all(torch.equal(p, q) for p, q in zip(model.parameters(), before, strict=True))
