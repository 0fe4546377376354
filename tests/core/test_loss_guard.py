"""Lost without knowing it: what the map shows at the pose found is another picture than the frame."""

import pytest
import torch
from torch import Tensor

from xrdslam.core.algorithm import Scene
from xrdslam.core.camera import Camera
from xrdslam.core.config import TrackingConfig
from xrdslam.core.errors import ConfigError
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3, so3
from xrdslam.core.loss_guard import COLUMNS, MEMORY, MIN_MEMORY, LossGuard, agreement
from xrdslam.core.model import Model, Rendering
from xrdslam.core.tracking import TrackingResult
from xrdslam.testing import ToyModel, toy_algorithm, toy_sequence

ELSEWHERE = se3.compose(so3.exp(torch.tensor([0.0, 0.6, 0.0])), torch.tensor([0.7, 0.0, 0.4]))


class Wall(Model):
    """A wall at `depth` [m] and of one `level`, over the left part `shown` of every image."""

    def __init__(self, depth: float = 2.0, level: float = 0.5, shown: float = 1.0) -> None:
        super().__init__()
        self.depth, self.level, self.shown = depth, level, shown

    @property
    def size(self) -> int:
        return 1

    def extend(self, frame: Frame, T_world_camera: Tensor) -> int:
        return 0

    def render(self, camera: Camera, T_world_camera: Tensor) -> Rendering:
        size = (camera.height, camera.width)
        opacity = (torch.arange(camera.width) < self.shown * camera.width).float().expand(size)
        return Rendering(torch.full((*size, 3), self.level), torch.full(size, self.depth), opacity)


def wall_frame(depth: Tensor | None = None, width: int = 80, height: int = 60) -> Frame:
    camera = Camera(70.0, 70.0, 39.5, 29.5, width, height)
    return Frame(0, 0, camera, torch.full((height, width, 3), 0.5), depth)


def share_of(model: Model, frame: Frame) -> float:
    found = agreement(frame, model, torch.eye(4))
    assert found is not None
    return found


def test_agreement_is_the_share_of_the_common_pixels() -> None:
    depth = torch.full((60, 80), 2.0)
    assert share_of(Wall(), wall_frame(depth)) == 1
    assert share_of(Wall(1.901), wall_frame(depth)) == 1  # within a twentieth
    assert share_of(Wall(1.899), wall_frame(depth)) == 0
    depth[:15] = 3.0
    assert share_of(Wall(), wall_frame(depth)) == pytest.approx(0.75, abs=0.02)
    depth[:15] = 0.0  # not measured: says nothing
    assert share_of(Wall(), wall_frame(depth)) == 1
    assert share_of(Wall(shown=0.5), wall_frame(depth)) == 1


def test_what_is_hardly_shared_says_nothing() -> None:
    depth = torch.full((60, 80), 2.0)
    assert agreement(wall_frame(depth), Wall(shown=0.02), torch.eye(4)) is None
    assert agreement(wall_frame(torch.zeros(60, 80)), Wall(), torch.eye(4)) is None


def test_without_depth_colour_decides() -> None:
    assert share_of(Wall(level=0.55), wall_frame()) == 1
    assert share_of(Wall(level=0.75), wall_frame()) == 0


def test_every_nth_pixel_is_asked_at_its_own_centre() -> None:
    """The exact map of the toy room agrees to the last pixel, whatever the step."""
    model = ToyModel.exact()
    for width in (80, 160, 320, 333):
        dataset = toy_sequence(1, width, width * 3 // 4, num_balls=0)
        frame = dataset[0]
        assert frame.depth is not None
        assert agreement(frame, model, dataset.poses[0]) == 1
        frame.depth[1::2] *= 2  # rows between the asked ones, at most
        if round(width / COLUMNS["image"]) % 2 == 0:
            assert agreement(frame, model, dataset.poses[0]) == 1


def judged(guard: LossGuard, shares: list[float]) -> list[bool]:
    """Say which frames are lost, where the map agrees with these shares of them."""
    answers = []
    for share in shares:
        depth = torch.full((60, 80), 3.0)
        depth[:, : round(80 * share)] = 2.0
        answers.append(guard.judge(wall_frame(depth), Wall(), TrackingResult(torch.eye(4))).is_lost)
    return answers


def test_a_frame_is_lost_where_the_map_agrees_much_less_than_it_used_to() -> None:
    usual = [0.8] * MIN_MEMORY
    assert judged(LossGuard(0.5), [*usual, 0.45, 0.35, 0.8])[MIN_MEMORY:] == [False, True, False]
    assert not any(judged(LossGuard(0.0), [*usual, 0.0]))
    poor = [0.4] * MIN_MEMORY  # a coarse map: what is usual is measured, not assumed
    assert judged(LossGuard(0.5), [*poor, 0.35])[-1] is False


def test_nothing_is_said_before_enough_is_known() -> None:
    assert judged(LossGuard(1.0), [0.9] * (MIN_MEMORY - 1) + [0.1]) == [False] * MIN_MEMORY


def test_lost_frames_do_not_count_as_usual() -> None:
    assert judged(LossGuard(0.5), [0.8] * MIN_MEMORY + [0.1] * 3 * MEMORY)[MIN_MEMORY:] == [True] * 3 * MEMORY


def test_what_the_tracker_lost_stays_lost_with_its_reason() -> None:
    result = TrackingResult(torch.eye(4), is_lost=True, reason="said by the tracker")
    assert LossGuard(0.5).judge(wall_frame(torch.full((60, 80), 2.0)), Wall(), result) is result


def test_its_memory_survives_a_checkpoint() -> None:
    guard, other = LossGuard(0.5), LossGuard(0.5)
    judged(guard, [0.8] * MIN_MEMORY)
    other.load_state_dict(guard.state_dict())
    assert judged(other, [0.35]) == [True]


def test_a_track_that_lands_elsewhere_with_a_finite_loss_is_lost() -> None:
    """The toy room, and a jump that gradient descent cannot follow; not mapped, no keyframe, the run goes on."""
    dataset = toy_sequence(14, 48, 36)
    frames = list(dataset.frames())
    algorithm = toy_algorithm()
    algorithm.start(Scene.of(dataset), frames[0])
    algorithm.map(frames[0])
    for frame in frames[1:]:
        tracked = frame
        if frame.index >= 10:
            rgb, depth = dataset._view(ELSEWHERE.double() @ dataset.poses[frame.index])
            tracked = Frame(frame.index, frame.timestamp_ns, frame.camera, rgb, depth)
        result = algorithm.track(tracked)
        algorithm.map(tracked)
        assert result.is_lost == (frame.index >= 10), (frame.index, result.reason)
    assert "the map agrees with" in result.reason
    assert max(frame.index for frame in algorithm.keyframes) < 10


@pytest.mark.parametrize("part", [-0.1, 1.1, float("nan")])
def test_a_part_that_makes_no_sense_is_refused(part: float) -> None:
    with pytest.raises(ConfigError, match=r"algo\.tracking\.lost_agreement"):
        TrackingConfig("toy", lost_agreement=part)
