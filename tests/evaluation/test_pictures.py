"""What is in the pictures: axes, colours, gaps, common scales."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from xrdslam.evaluation import absolute_trajectory_error, side_by_side, trajectory_figure, write_figure


def path_in_xz(n: int = 50) -> np.ndarray:
    poses = np.tile(np.eye(4), (n, 1, 1))
    angle = np.linspace(0, 5, n)
    poses[:, :3, 3] = np.stack([2 * np.cos(angle), 0.1 * np.sin(3 * angle), 3 * np.sin(angle)], 1)
    return poses


def disturbed(poses: np.ndarray) -> np.ndarray:
    moved = poses.copy()
    moved[:, :3, 3] += np.random.default_rng(0).normal(size=(len(poses), 3)) * 0.02
    return moved


def path_of(figure: Figure) -> LineCollection:
    return next(c for c in figure.axes[0].collections if isinstance(c, LineCollection))


def read(figure: Figure, tmp_path: Path) -> np.ndarray:
    write_figure(figure, tmp_path / "sub" / "picture.png")
    assert [file.name for file in (tmp_path / "sub").iterdir()] == ["picture.png"]
    return cv2.imread(str(tmp_path / "sub" / "picture.png"))[..., ::-1]


def test_the_view_is_along_the_axis_of_least_extent_and_says_so(tmp_path: Path) -> None:
    truth, estimate = path_in_xz(), disturbed(path_in_xz())
    error = absolute_trajectory_error(estimate, truth)
    figure = trajectory_figure(estimate, truth, error, title="Final trajectory")
    top, below = figure.axes[:2]
    assert (top.get_xlabel(), top.get_ylabel()) == ("x [m]", "z [m]")
    assert top.get_aspect() == 1.0
    assert f"ATE RMSE {error.rmse_cm:.3g} cm" in top.get_title(loc="left")
    assert below.get_ylabel() == "error [cm]"
    np.testing.assert_allclose(below.lines[0].get_ydata(), error.errors_cm)
    assert figure.axes[-1].get_ylabel() == "error [cm]"  # the colour bar
    np.testing.assert_allclose(path_of(figure).get_array(), error.errors_cm[1:])
    assert [text.get_text() for text in top.get_legend().get_texts()] == ["ground truth", "start"]
    assert read(figure, tmp_path).std() > 10


def test_the_aligned_estimate_is_drawn_over_the_truth() -> None:
    truth = path_in_xz()
    estimate = truth.copy()
    estimate[:, :3, 3] += [100.0, 50.0, -30.0]
    figure = trajectory_figure(estimate, truth, absolute_trajectory_error(estimate, truth))
    segments = np.array(path_of(figure).get_segments())
    np.testing.assert_allclose(segments[:, 1], truth[1:, [0, 2], 3], atol=1e-9)


def test_gaps_stay_gaps_and_lost_frames_are_marked(tmp_path: Path) -> None:
    truth, estimate = path_in_xz(), disturbed(path_in_xz())
    estimate[20:23] = np.nan
    lost = np.zeros(50, dtype=bool)
    lost[[30, 31]] = True
    figure = trajectory_figure(estimate, truth, absolute_trajectory_error(estimate, truth), lost)
    assert len(path_of(figure).get_segments()) == 49 - 4
    title = figure.axes[0].get_title(loc="left")
    assert "47 of 50 frames" in title
    assert "2 lost" in title
    assert figure.axes[0].get_legend().get_texts()[-1].get_text() == "lost"
    read(figure, tmp_path)


def test_without_ground_truth_the_path_is_coloured_by_frame(tmp_path: Path) -> None:
    figure = trajectory_figure(path_in_xz())
    assert figure.axes[-1].get_ylabel() == "frame"
    assert "not compared" in figure.axes[0].get_title(loc="left")
    read(figure, tmp_path)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_hardly_any_frames_are_drawn_without_a_fuss(n: int, tmp_path: Path) -> None:
    read(trajectory_figure(path_in_xz(50)[:n]), tmp_path)


def test_a_path_of_nothing_but_missing_poses_is_drawn_without_a_fuss(tmp_path: Path) -> None:
    read(trajectory_figure(np.full((9, 4, 4), np.nan)), tmp_path)


def test_a_perfect_estimate_is_drawn_without_a_fuss(tmp_path: Path) -> None:
    truth = path_in_xz()
    read(trajectory_figure(truth, truth, absolute_trajectory_error(truth, truth)), tmp_path)


WIDTH, HEIGHT = 400, 200


def panel(picture: np.ndarray, row: int, column: int, v: float = 0.5, u: float = 0.5) -> np.ndarray:
    """The colour at a place of a panel: margins 12, strips 40 and 28, gaps 8 px."""
    left, top = 12 + column * (WIDTH + 8), 40 + row * (28 + HEIGHT + 8) + 28
    return picture[int(top + v * HEIGHT), int(left + u * WIDTH)].astype(int)


def test_the_six_panels_show_what_they_say(tmp_path: Path) -> None:
    rgb = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    rgb[..., 0] = 1.0
    rendered = rgb.copy()
    rendered[:, WIDTH // 2 :] = [1.0, 0.6, 0.0]  # mean difference 0.2: the end of the scale
    depth = np.tile(np.linspace(1.0, 3.0, WIDTH, dtype=np.float32), (HEIGHT, 1))
    depth[: HEIGHT // 4] = 0.0
    rendered_depth = depth.copy()
    rendered_depth[HEIGHT // 2 :, : WIDTH // 2] = 0.0  # a hole where there was a measurement
    picture = read(side_by_side(rgb, rendered, depth, rendered_depth, "frame 3"), tmp_path)
    assert picture.shape == (40 + 2 * (28 + HEIGHT) + 8 + 12, 3 * WIDTH + 2 * 8 + 2 * 12, 3)
    np.testing.assert_array_equal(panel(picture, 0, 0), [255, 0, 0])
    np.testing.assert_allclose(panel(picture, 0, 1, u=0.75), [255, 153, 0], atol=1)
    black, white_hot = panel(picture, 0, 2, u=0.25), panel(picture, 0, 2, u=0.75)
    assert black.sum() < 20
    assert white_hot.sum() > 600
    missing = [0x3A, 0x3F, 0x4A]
    np.testing.assert_array_equal(panel(picture, 1, 0, v=0.1), missing)
    np.testing.assert_array_equal(panel(picture, 1, 1, v=0.75, u=0.25), missing)
    np.testing.assert_array_equal(panel(picture, 1, 2, v=0.1), missing)  # not measured: no error is known
    np.testing.assert_array_equal(panel(picture, 1, 2, v=0.75, u=0.25), white_hot)  # the hole is an error in full
    np.testing.assert_array_equal(panel(picture, 1, 2, v=0.75, u=0.75), black)
    for u in (0.6, 0.75, 0.9):  # one colour map for both depths
        np.testing.assert_array_equal(panel(picture, 1, 0, v=0.75, u=u), panel(picture, 1, 1, v=0.75, u=u))


def test_pictures_without_depth_and_with_broken_pixels_are_drawn_without_a_fuss(tmp_path: Path) -> None:
    rgb = np.full((30, 60, 3), 0.5, np.float32)
    broken = rgb.copy()
    broken[3] = np.nan
    depth = np.full((30, 60), np.nan, np.float32)
    figure = side_by_side(rgb, broken, None, depth)
    assert [text.get_text() for axes in figure.axes for text in axes.texts] == ["none", "none"]
    assert read(figure, tmp_path).shape[1] == 3 * 320 + 40
