"""Gradient tracking: finds the pose of a frame in a map that is exactly right, and says when it cannot."""

import pytest
import torch
from torch import Tensor

from xrdslam.core.batch import Batch, Stage
from xrdslam.core.config import IterativeTrackingConfig
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3, so3
from xrdslam.core.tracking import GradientTracking, TrackingResult, frozen
from xrdslam.core.trajectory import Trajectory
from xrdslam.testing import ToyModel, ToyRayModel, toy_sequence

OFFSET = se3.compose(so3.exp(torch.tensor([0.01, -0.015, 0.005])), torch.tensor([0.02, -0.01, 0.015]))
MODELS = [ToyModel, ToyRayModel]


def off_by(offset: Tensor, num_balls: int = 0) -> tuple[Frame, Tensor]:
    """Return a frame whose predicted pose is off by 1 degree and 27 mm, and its true pose."""
    frame = toy_sequence(1, 32, 24, num_balls=num_balls)[0]
    assert frame.T_world_camera_gt is not None
    frame.pose.set_(frame.T_world_camera_gt @ offset)
    return frame, frame.T_world_camera_gt


def config(**settings: object) -> IterativeTrackingConfig:
    quick = {"iterations": 100, "lr_rotation": 2e-3, "lr_translation": 2e-3, "num_pixels": 256}
    return IterativeTrackingConfig("toy", **(quick | settings))  # type: ignore[arg-type]  # mypy sees one type for all


def tracked(model: ToyModel, frame: Frame, seed: int = 0, **settings: object) -> TrackingResult:
    return GradientTracking(config(**settings), seed).track(frame, model, Trajectory())


@pytest.mark.parametrize("model_class", MODELS)
@pytest.mark.parametrize("rotation", ["axis_angle", "quaternion"])
@pytest.mark.parametrize("pivot", ["camera", "scene"])
def test_the_true_pose_is_found(model_class: type[ToyModel], rotation: str, pivot: str) -> None:
    frame, truth = off_by(OFFSET)
    result = tracked(model_class.exact(), frame, rotation=rotation, pivot=pivot)
    error = se3.inverse(truth) @ result.T_world_camera
    assert not result.is_lost
    assert result.iterations == 100
    assert float(error[:3, 3].norm()) < 3e-3  # of 27 mm
    assert float(so3.log(error[:3, :3]).norm()) < 1.5e-3  # of 19 mrad


def test_the_map_keeps_its_values_its_gradients_and_its_switches() -> None:
    model = ToyModel.exact()
    model.walls.requires_grad_(False)
    before = {key: value.clone() for key, value in model.state_dict().items()}
    tracked(model, off_by(OFFSET)[0], iterations=3)
    assert all(torch.equal(before[key], value) for key, value in model.state_dict().items())
    assert [p.requires_grad for p in (model.walls, model.amplitudes)] == [False, True]
    assert model.amplitudes.grad is None


def test_the_map_thaws_after_an_error() -> None:
    model = ToyModel.exact()

    def fail() -> None:
        with frozen(model):
            assert not any(p.requires_grad for p in model.parameters())
            raise RuntimeError("on purpose")

    with pytest.raises(RuntimeError, match="on purpose"):
        fail()
    assert all(p.requires_grad for p in model.parameters())


def test_the_pose_returned_has_the_loss_that_is_returned() -> None:
    frame, _ = off_by(OFFSET)
    model = ToyModel.exact()
    result = tracked(model, frame, iterations=7)
    frame.pose.set_(result.T_world_camera)
    again = tracked(model, frame, iterations=1)
    assert abs(again.loss - result.loss) < 1e-5 * result.loss  # the pose went through float32 once more


def test_the_best_pose_is_kept_or_the_last() -> None:
    """A rate that overshoots from the true pose: the best is where it began."""
    frame, truth = off_by(torch.eye(4))
    best, last = (tracked(ToyModel.exact(), frame, iterations=5, keep_best=k) for k in (True, False))
    torch.testing.assert_close(best.T_world_camera, truth, rtol=0, atol=1e-6)
    assert last.loss > best.loss


def test_an_empty_map_loses_the_frame_and_keeps_the_prediction() -> None:
    frame, _ = off_by(OFFSET)
    predicted = frame.pose.matrix().detach()
    result = tracked(ToyModel(), frame)
    assert result.is_lost
    assert not result.converged
    assert result.reason == "the map is empty"
    assert torch.equal(result.T_world_camera, predicted)


def test_losses_that_are_never_finite_lose_the_frame() -> None:
    class Nan(ToyModel):
        def losses(self, batch: Batch, stage: Stage) -> dict[str, Tensor]:
            return {key: loss * torch.nan for key, loss in super().losses(batch, stage).items()}

    frame, _ = off_by(OFFSET)
    result = tracked(Nan.exact(), frame, iterations=3)
    assert result.is_lost
    assert result.reason == "the tracking loss is not finite"
    assert torch.equal(result.T_world_camera, frame.pose.matrix().detach())


def test_one_loss_of_nan_costs_no_frame() -> None:
    """It makes Adam's moments NaN; what was measured before it is kept."""

    class NanOnce(ToyModel):
        calls = 0

        def losses(self, batch: Batch, stage: Stage) -> dict[str, Tensor]:
            self.calls += 1
            factor = torch.nan if self.calls == 6 else 1.0
            return {key: loss * factor for key, loss in super().losses(batch, stage).items()}

    frame, _ = off_by(OFFSET)
    result = tracked(NanOnce.exact(), frame, iterations=10)
    expected = tracked(ToyModel.exact(), frame, iterations=10)
    assert not result.is_lost
    assert bool(torch.isfinite(result.T_world_camera).all())
    assert result.loss >= expected.loss


def test_the_frame_and_its_predicted_pose_are_left_alone() -> None:
    frame, _ = off_by(OFFSET)
    before = {key: value.clone() for key, value in frame.state_dict().items()}
    tracked(ToyModel.exact(), frame, iterations=3)
    assert all(torch.equal(before[key], value) for key, value in frame.state_dict().items())
    assert frame.pose.rotation.grad is None


@pytest.mark.parametrize("model_class", MODELS)
def test_the_seed_decides(model_class: type[ToyModel]) -> None:
    frame, _ = off_by(OFFSET)
    results = [tracked(model_class.exact(), frame, seed=s, iterations=5).T_world_camera for s in (1, 1, 2)]
    assert torch.equal(results[0], results[1])
    assert torch.equal(results[0], results[2]) == (model_class is ToyModel)  # whole images need no random numbers


def test_it_stops_where_nothing_improves() -> None:
    frame, _ = off_by(torch.eye(4))
    result = tracked(ToyModel.exact(), frame, stop_patience=3, lr_rotation=0.0, lr_translation=0.0)
    assert result.iterations == 4  # one that sets the mark, three that do not pass it
    assert tracked(ToyModel.exact(), frame, iterations=9, lr_rotation=0.0, lr_translation=0.0).iterations == 9


def test_its_random_numbers_go_on_after_a_resume() -> None:
    frame, _ = off_by(OFFSET)
    one, other = (GradientTracking(config(iterations=3), seed) for seed in (1, 2))
    one.track(frame, ToyRayModel.exact(), Trajectory())
    other.load_state_dict(one.state_dict())
    results = [t.track(frame, ToyRayModel.exact(), Trajectory()).T_world_camera for t in (one, other)]
    assert torch.equal(*results)


@pytest.mark.parametrize(("num_poses", "expected"), [(0, 9), (1, 9), (2, 4)])
def test_a_frame_whose_motion_cannot_be_predicted_gets_iterations_of_its_own(num_poses: int, expected: int) -> None:
    trajectory = Trajectory()
    for index in range(num_poses):
        trajectory.append(index, index, torch.eye(4))
    tracker = GradientTracking(IterativeTrackingConfig("toy", iterations=4, first_iterations=9))
    assert tracker.track(off_by(OFFSET)[0], ToyModel.exact(), trajectory).iterations == expected
