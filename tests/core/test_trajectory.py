"""The trajectory: one owner of poses, frames that hang on their keyframes."""

import pytest
import torch
from torch import Tensor

from xrdslam.core.geometry import se3, so3
from xrdslam.core.trajectory import Trajectory

TOLERANCE = 1e-14  # products of a few rigid motions of metres in float64, eps = 2.2e-16


def poses(count: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    omega, centre = torch.randn(2, count, 3, dtype=torch.float64, generator=generator).unbind(0)
    return se3.compose(so3.exp(omega), centre)


def walk(count: int = 7, keyframe_every: int = 3) -> tuple[Trajectory, Tensor]:
    trajectory, given = Trajectory(), poses(count)
    for index, pose in enumerate(given):
        trajectory.append(index, 10 * index, pose)
        if index % keyframe_every == 0:
            trajectory.make_keyframe(index)
    return trajectory, given


def assert_close(found: Tensor, expected: Tensor, atol: float = TOLERANCE) -> None:
    torch.testing.assert_close(found, expected, rtol=0, atol=atol)


def test_before_anything_moves_current_and_online_are_what_was_tracked() -> None:
    trajectory, given = walk()
    assert torch.equal(trajectory.online(), given)
    assert_close(trajectory.current(), given)
    assert trajectory.indices == list(range(7))
    assert trajectory.timestamps_ns.tolist() == [0, 10, 20, 30, 40, 50, 60]


def test_moving_a_keyframe_carries_its_followers_rigidly() -> None:
    """What bundle adjustment finds reaches the final trajectory, of the frames between keyframes too."""
    trajectory, given = walk()
    moved = poses(1, seed=5)[0]
    trajectory.update(3, moved)
    change = moved @ se3.inverse(given[3])
    assert_close(trajectory.current()[3:6], change @ given[3:6])
    assert_close(trajectory.current()[[0, 1, 2, 6]], given[[0, 1, 2, 6]])
    assert torch.equal(trajectory.online(), given)


def test_moving_a_follower_moves_nobody_else() -> None:
    trajectory, given = walk()
    moved = poses(1, seed=6)[0]
    trajectory.update(4, moved)
    assert_close(trajectory.current(), torch.cat((given[:4], moved[None], given[5:])))


def test_a_follower_that_becomes_a_keyframe_stays_and_is_left_behind() -> None:
    trajectory, given = walk()
    trajectory.make_keyframe(4)
    trajectory.update(3, poses(1, seed=5)[0])
    assert_close(trajectory.pose(4), given[4])


@pytest.mark.parametrize("order", [(3, 4, 5), (5, 4, 3), (4, 3, 5)])
def test_the_order_in_which_poses_are_reported_is_no_matter(order: tuple[int, ...]) -> None:
    """Frames 4 and 5 hang on 3: written before it, they would be carried along by it."""
    trajectory, _ = walk()
    moved = poses(7, seed=8)
    trajectory.update_all({index: moved[index] for index in order})
    assert_close(trajectory.current()[3:6], moved[3:6])


def test_a_removed_frame_hangs_on_another() -> None:
    trajectory, given = walk()
    trajectory.update(3, trajectory.pose(3), anchor=6)
    moved = poses(1, seed=5)[0]
    trajectory.update(6, moved)
    change = moved @ se3.inverse(given[6])
    assert_close(trajectory.current()[3:], change @ given[3:])  # 4 and 5 hang on 3, which hangs on 6


def test_a_circle_of_anchors_is_refused_and_changes_nothing() -> None:
    trajectory, given = walk()
    trajectory.update(3, given[3], anchor=0)
    with pytest.raises(ValueError, match="frame 0 cannot hang on frame 5, which hangs on it"):
        trajectory.update(0, given[0], anchor=5)
    assert_close(trajectory.current(), given)


def test_a_chain_as_long_as_the_sequence_is_resolved() -> None:
    """Odometry hangs each dropped frame on its neighbour: no recursion, and each product worked out once."""
    trajectory, count = Trajectory(), 3000
    step = se3.compose(so3.exp(torch.tensor([0.0, 0.0, 0.001], dtype=torch.float64)), torch.ones(3).double())
    pose = torch.eye(4, dtype=torch.float64)
    expected = []
    for index in range(count):
        trajectory.append(index, index, pose)
        expected.append(pose)
        pose = pose @ step
    entries = trajectory.state_dict()
    entries["anchors"] = torch.tensor([0, *range(count - 1)])
    entries["T_anchor_frame"] = torch.stack([expected[0], *[step] * (count - 1)])
    trajectory.load_state_dict(entries)
    assert_close(trajectory.current(), torch.stack(expected), atol=1e-9)
    assert_close(trajectory.pose(count - 1), expected[-1], atol=1e-9)


def test_poses_of_float32_do_not_drift_along_a_chain() -> None:
    """A rotation rounded to float32 is 1e-7 off orthonormal; inverted by transposing, that doubles with every link."""
    trajectory = Trajectory()
    given = poses(300).float()
    for index, pose in enumerate(given):
        trajectory.append(index, index, pose)
        if index:
            trajectory.update(index, pose, anchor=index - 1)
    torch.testing.assert_close(trajectory.current(), given.double(), rtol=0, atol=1e-13)
    assert torch.equal(trajectory.online(), given.double())


def test_poses_are_copies() -> None:
    trajectory, given = walk()
    held = given.clone()
    given.zero_()
    for returned in (trajectory.pose(3), trajectory.online(), trajectory.current()):
        returned.zero_()
    assert_close(trajectory.current(), held)
    assert torch.equal(trajectory.online(), held)


def test_float32_poses_with_gradients_are_taken_as_float64_without() -> None:
    trajectory = Trajectory()
    pose = torch.eye(4).requires_grad_()
    trajectory.append(0, 0, pose)
    assert trajectory.pose(0).dtype == torch.float64
    assert not trajectory.pose(0).requires_grad


def test_a_frame_comes_once() -> None:
    trajectory, given = walk()
    with pytest.raises(ValueError, match="frame 3 is in the trajectory already"):
        trajectory.append(3, 99, given[3])
    assert len(trajectory) == 7


def test_lost_frames_are_marked() -> None:
    trajectory = Trajectory()
    for index, is_lost in enumerate((False, True, False)):
        trajectory.append(index, index, torch.eye(4), is_lost)
    assert trajectory.is_lost.tolist() == [False, True, False]
    assert trajectory.lost(1)
    assert not trajectory.lost(2)


def test_an_empty_trajectory_is_empty() -> None:
    trajectory = Trajectory()
    assert len(trajectory) == 0
    assert trajectory.online().shape == trajectory.current().shape == (0, 4, 4)
    assert trajectory.is_lost.shape == trajectory.timestamps_ns.shape == (0,)


@pytest.mark.parametrize("count", [0, 1, 7])
def test_state_comes_back_with_the_same_bits_and_goes_on_the_same(count: int) -> None:
    trajectory, _ = walk(count)
    other = Trajectory()
    other.load_state_dict(trajectory.state_dict())
    for each in (trajectory, other):
        each.append(count, 10 * count, poses(count + 1, seed=3)[count], is_lost=True)
        each.update(0, poses(1, seed=4)[0])
    assert torch.equal(other.current(), trajectory.current())
    assert torch.equal(other.online(), trajectory.online())
    assert torch.equal(other.is_lost, trajectory.is_lost)
    assert torch.equal(other.timestamps_ns, trajectory.timestamps_ns)


def test_what_is_known_of_some_frames_joins_what_is_known_of_others() -> None:
    """As between processes: frames in any order, known ones anew, unknown ones added, `anchor` left as it was."""
    trajectory, given = walk(40)
    other = Trajectory()
    other.load_state_dict(trajectory.state_dict(range(20)))
    moved = poses(2, seed=8)
    trajectory.update_all({9: moved[0], 30: moved[1]})
    news = trajectory.state_dict([9, *reversed(range(20, 40)), 3])
    news.pop("anchor")
    other.merge(news)
    order = other.indices
    assert order == [*range(20), *reversed(range(20, 40))]
    assert torch.equal(other.current(), trajectory.current()[order])
    assert torch.equal(other.online(), given[order])
    assert torch.equal(other.state_dict([9])["T_anchor_frame"], trajectory.state_dict([9])["T_anchor_frame"])
    other.append(40, 400, given[0])
    assert other.state_dict([40])["anchors"].tolist() == [39], "the last keyframe of the whole"


def test_a_long_chain_of_keyframes_adds_no_error() -> None:
    """Poses come in float32, 6e-8 from orthonormal: doubled with each of 100 keyframes that would be 1e23."""
    trajectory = Trajectory()
    step = se3.compose(so3.exp(torch.tensor([0.02, 0.03, -0.01])), torch.tensor([0.02, 0.0, 0.01]))
    pose = torch.eye(4)
    for index in range(100):
        pose = pose @ step
        trajectory.append(index, index, pose)
        trajectory.make_keyframe(index)
        assert (
            trajectory.pose(index) - pose
        ).abs().max() < 2e-5  # 100 float32 products leave pose 1e-5 from orthonormal
