"""Comparing renderings with photographs: masks, strides, what the renderer is told, what breaks a mean."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity
from torch import Tensor
from torch.utils.data import Dataset

from xrdslam.core.camera import Camera
from xrdslam.core.model import Rendering
from xrdslam.evaluation import EvaluationConfig, EvaluationError, RenderingMetrics, Trajectories
from xrdslam.evaluation.rendering import Frames, Render
from xrdslam.evaluation.survey import Survey


@dataclass
class Shot:
    index: int
    camera: Camera
    rgb: Tensor
    depth: Tensor | None


def shot(index: int = 0, height: int = 20, width: int = 30, has_depth: bool = True, grey: float = 0.5) -> Shot:
    camera = Camera(30.0, 30.0, width / 2, height / 2, width, height)
    rgb = torch.full((height, width, 3), grey)
    return Shot(index, camera, rgb, torch.full((height, width), 2.0) if has_depth else None)


def rendering(frame: Shot, brighter: float = 0.1, deeper: float = 0.03) -> Rendering:
    depth = torch.full(frame.rgb.shape[:2], 2.0 + deeper)
    return Rendering(frame.rgb + brighter, depth, torch.ones_like(depth))


def poses(*indices: int) -> Trajectories:
    known = np.tile(np.eye(4), (len(indices), 1, 1))
    return Trajectories(known, known.copy(), indices=indices)


def surveyed(render: Render, frames: Frames, trajectories: Trajectories, every: int) -> list[int]:
    """Return the indices of the frames that were compared."""
    survey = Survey(EvaluationConfig(every=every), trajectories)
    survey.go(render, frames)
    return [row.index for row in survey.metrics["train"].rows]


def test_a_row_of_one_frame() -> None:
    row = RenderingMetrics(every=5).add(shot(7), rendering(shot(7)))
    assert row.index == 7
    assert row.psnr_db == pytest.approx(20.0, abs=1e-5)
    assert row.depth_l1_cm == pytest.approx(3.0, rel=1e-5)
    assert row.ssim == pytest.approx((2 * 0.5 * 0.6 + 1e-4) / (0.25 + 0.36 + 1e-4), rel=1e-6)


def test_means_are_over_frames_and_carry_their_protocol() -> None:
    measure = RenderingMetrics(every=10, mask="none")
    measure.add(shot(0), rendering(shot(0), 0.1, 0.01))
    measure.add(shot(10), rendering(shot(10), 0.01, 0.05))
    metrics = measure.group().flat()
    assert metrics["rendering/train/psnr_db"] == pytest.approx(30.0, abs=1e-4)  # (20 + 40) / 2: a mean of dB
    assert metrics["rendering/train/depth_l1_cm"] == pytest.approx(3.0, rel=1e-5)
    protocol = metrics["rendering/train/protocol"]
    assert (
        protocol.items()
        >= {
            "views": "train",
            "stride": 10,
            "mask": "none",
            "frames": 2,
            "ground_truth_depth_given_to_renderer": "no",
        }.items()
    )


def half_measured(bad_side: str) -> tuple[Shot, Rendering]:
    """Depth was measured on the left half; the rendering is off by 0.1 on one side, and so is its depth."""
    frame = shot()
    frame.depth[:, 15:] = 0.0
    seen = rendering(frame, 0.0, 0.0)
    columns = slice(0, 15) if bad_side == "left" else slice(15, None)
    seen.rgb[:, columns] += 0.1
    seen.depth[:, columns] += 0.1
    return frame, seen


def test_the_valid_depth_mask_blacks_out_both_images_where_nothing_was_measured() -> None:
    row = RenderingMetrics(5, "valid_depth").add(*half_measured("left"))
    assert row.psnr_db == pytest.approx(-10 * math.log10(0.01 / 2), abs=1e-5)  # half the pixels are black and equal
    assert row.depth_l1_cm == pytest.approx(10.0, rel=1e-5)


def test_the_mask_is_not_inverted() -> None:
    row = RenderingMetrics(5, "valid_depth").add(*half_measured("right"))
    assert row.psnr_db == math.inf
    assert row.ssim == pytest.approx(1.0)
    assert row.depth_l1_cm == 0.0


@pytest.mark.parametrize("side", ["left", "right"])
def test_without_a_mask_every_pixel_counts(side: str) -> None:
    row = RenderingMetrics(5, "none").add(*half_measured(side))
    assert row.psnr_db == pytest.approx(-10 * math.log10(0.01 / 2), abs=1e-5)


def test_ssim_and_ms_ssim_stand_under_their_own_names() -> None:
    rng = np.random.default_rng(0)
    frame = shot(height=170, width=180)
    frame.rgb = torch.from_numpy(rng.random((170, 180, 3), dtype=np.float32))
    seen = rendering(frame, 0.0)
    seen = seen._replace(
        rgb=(frame.rgb + 0.2 * torch.randn(frame.rgb.shape, generator=torch.manual_seed(0))).clamp(0, 1)
    )
    row = RenderingMetrics(5).add(frame, seen)
    expected = structural_similarity(
        frame.rgb.double().numpy(),
        seen.rgb.double().numpy(),
        data_range=1.0,
        channel_axis=-1,
        gaussian_weights=True,
        use_sample_covariance=False,
    )
    assert row.ssim == pytest.approx(expected, abs=1e-10)
    assert row.ms_ssim is not None
    assert abs(row.ms_ssim - expected) > 0.02


def test_small_images_have_no_ms_ssim_and_say_why() -> None:
    measure = RenderingMetrics(5)
    measure.add(shot(), rendering(shot()))
    metrics = measure.group().flat()
    assert metrics["rendering/train/ms_ssim"] is None
    assert isinstance(metrics["rendering/train/ssim"], float)
    assert "161 px" in metrics["rendering/train/protocol"]["unavailable"]["ms_ssim"]


def test_the_renderer_gets_a_camera_and_a_pose_and_nothing_else() -> None:
    calls: list[tuple[object, ...]] = []

    def render(*arguments: object, **named: object) -> Rendering:
        assert not named
        calls.append(arguments)
        return rendering(shot())

    frames = [shot(0), shot(5)]
    trajectories = poses(0, 5)
    trajectories.final[:, 0, 3] = 7.0
    surveyed(render, frames, trajectories, every=5)
    assert len(calls) == 2
    for camera, pose in calls:
        assert camera == frames[0].camera
        assert pose.dtype == torch.float32  # the frame's
        assert torch.equal(pose.double(), torch.from_numpy(trajectories.final[0]))


def test_nothing_is_recorded_for_gradients() -> None:
    weight = torch.ones(1, requires_grad=True)
    recorded = []

    def render(camera: Camera, T_world_camera: Tensor) -> Rendering:
        rgb = shot().rgb * weight
        recorded.append(rgb.requires_grad)
        return Rendering(rgb, shot().depth, shot().depth)

    surveyed(render, [shot()], poses(0), 1)
    assert recorded == [False]


@pytest.mark.parametrize(("every", "expected"), [(1, list(range(11))), (5, [0, 5, 10]), (50, [0])])
def test_the_stride_takes_multiples_the_last_frame_too(every: int, expected: list[int]) -> None:
    frames = [shot(i) for i in range(11)]
    assert surveyed(lambda _c, _T: rendering(shot()), frames, poses(*range(11)), every) == expected


def test_frames_without_a_pose_are_not_rendered() -> None:
    known = poses(0, 5, 10)
    known.final[1, 0, 0] = math.nan
    assert surveyed(lambda _c, _T: rendering(shot()), [shot(i) for i in (0, 5, 10, 15)], known, 5) == [0, 10]


def test_a_dataset_is_read_only_where_needed() -> None:
    class Sequence(Dataset[Shot]):
        read: list[int] = []  # one instance

        def __getitem__(self, index: int) -> Shot:
            self.read.append(index)
            return shot(index)

    sequence = Sequence()
    assert surveyed(lambda _c, _T: rendering(shot()), sequence, poses(*range(12)), 5) == [0, 5, 10]
    assert sorted(sequence.read) == [0, 5, 10]


def test_without_measured_depth_the_numbers_say_so() -> None:
    measure = RenderingMetrics(5, "valid_depth")
    measure.add(shot(has_depth=False), rendering(shot()))
    metrics = measure.group().flat()
    assert all(metrics[f"rendering/train/{key}"] is None for key in ("psnr_db", "ssim", "ms_ssim", "depth_l1_cm"))
    assert "mask=none" in metrics["rendering/train/protocol"]["unavailable"]["psnr_db"]
    unmasked = RenderingMetrics(5, "none").add(shot(has_depth=False), rendering(shot()))
    assert unmasked.psnr_db == pytest.approx(20.0, abs=1e-5)
    assert unmasked.depth_l1_cm is None


def test_a_frame_with_an_empty_depth_image_is_no_perfect_frame() -> None:
    measure = RenderingMetrics(5, "valid_depth")
    empty = shot(0)
    empty.depth[:] = 0.0
    measure.add(empty, rendering(empty))
    measure.add(shot(5), rendering(shot(5)))
    metrics = measure.group().flat()
    assert metrics["rendering/train/psnr_db"] == pytest.approx(20.0, abs=1e-5)
    protocol = metrics["rendering/train/protocol"]
    assert protocol["frames"] == 2
    assert protocol["frames_in_mean"] == {
        "psnr_db": 1,
        "ssim": 1,
        "ms_ssim": 0,
        "lpips_alex": 0,
        "lpips_squeeze": 0,
        "depth_l1_cm": 1,
    }
    assert "psnr_db" in protocol["left_out_because"]


def test_one_broken_rendering_breaks_the_mean() -> None:
    measure = RenderingMetrics(5)
    measure.add(shot(0), rendering(shot(0)))
    broken = rendering(shot(5))
    broken.rgb[3, 3] = math.nan
    measure.add(shot(5), broken)
    metrics = measure.group().flat()
    assert metrics["rendering/train/psnr_db"] is None
    assert metrics["rendering/train/depth_l1_cm"] == pytest.approx(3.0, rel=1e-5)
    assert "first is of frame 5" in metrics["rendering/train/protocol"]["unavailable"]["psnr_db"]


def test_colours_beyond_white_are_white() -> None:
    row = RenderingMetrics(5).add(shot(grey=0.9), rendering(shot(grey=0.9), brighter=5.0))
    assert row.psnr_db == pytest.approx(20.0, abs=1e-5)


def test_unnormalised_depth_is_taken_as_it_is() -> None:
    frame = shot()
    seen = Rendering(frame.rgb, frame.depth * 0.9, torch.full_like(frame.depth, 0.9))
    assert RenderingMetrics(5).add(frame, seen).depth_l1_cm == pytest.approx(20.0, rel=1e-5)


def test_a_rendering_of_another_size_is_refused() -> None:
    with pytest.raises(EvaluationError, match="frame 3 is"):
        RenderingMetrics(5).add(shot(3), rendering(shot(3, height=10)))


def test_no_frames_no_numbers() -> None:
    metrics = RenderingMetrics(5).group().flat()
    assert metrics["rendering/train/psnr_db"] is None
    assert metrics["rendering/train/protocol"]["unavailable"]["psnr_db"] == "no frame was rendered"


def test_an_unknown_mask_is_refused() -> None:
    with pytest.raises(EvaluationError, match="valid_depth"):
        RenderingMetrics(5, "inverted")
