"""What evaluations of published systems are known to get wrong, a test for each.

Every one of them was found in a tool that people compare with, or in a report of numbers that could not be repeated.
"""

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from skimage.metrics import structural_similarity
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.model import Rendering
from xrdslam.core.surface import TriangleMesh
from xrdslam.evaluation import EvalMetrics, EvaluationConfig, Metrics, RenderingMetrics, Trajectories
from xrdslam.evaluation.alignment import Alignment
from xrdslam.evaluation.lpips import Lpips
from xrdslam.evaluation.reconstruction import compare_surfaces
from xrdslam.evaluation.survey import Survey
from xrdslam.evaluation.trajectory import absolute_trajectory_error

CAMERA = Camera(60.0, 60.0, 39.5, 29.5, 80, 60)
WALL_M = 2.0


@dataclass
class Shot:
    index: int
    camera: Camera
    rgb: Tensor
    depth: Tensor | None


def shots(count: int = 12) -> list[Shot]:
    """Return pictures of a wall, 2 m before every camera."""
    pattern = torch.rand(60, 80, 3, generator=torch.Generator().manual_seed(0))
    return [Shot(i, CAMERA, pattern, torch.full((60, 80), WALL_M)) for i in range(count)]


def path(count: int = 12) -> np.ndarray:
    """Return a walk that stays before the wall z = 2 and looks at it."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    t = np.arange(float(count))
    poses[:, :3, 3] = np.stack((0.02 * t, 0.05 * np.sin(t), np.zeros(count)), 1)
    return poses


def exact(camera: Camera, T_world_camera: Tensor) -> Rendering:
    frame = shots(1)[0]
    assert frame.depth is not None
    return Rendering(frame.rgb, frame.depth, torch.ones(60, 80))


def square(z: float = WALL_M, pieces: int = 1, left: float = -2.0, right: float = 2.0) -> TriangleMesh:
    """Return a wall, its left half cut into `pieces` x `pieces` squares."""
    corners, faces = [], []
    for low, high, count in ((left, 0.0, pieces), (0.0, right, 1)):
        x, y = np.linspace(low, high, count + 1), np.linspace(-2, 2, count + 1)
        for i in range(count):
            for j in range(count):
                start = len(corners)
                corners += [[x[i], y[j], z], [x[i + 1], y[j], z], [x[i + 1], y[j + 1], z], [x[i], y[j + 1], z]]
                faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
    return TriangleMesh(np.array(corners, np.float32), np.array(faces))


def with_mesh(
    folder: Path, estimate: TriangleMesh, truth: TriangleMesh, final: np.ndarray | None = None, **settings: object
) -> Metrics:
    estimate.write(folder / "estimate.ply")
    truth.write(folder / "truth.ply")
    config = EvaluationConfig(
        mesh_samples=4000, virtual_views=6, pictures_every=0, trajectory_pictures=False, **settings
    )  # type: ignore[arg-type]  # of all kinds
    trajectories = Trajectories(path(), path() if final is None else final, path())
    surfaces = (folder / "estimate.ply", folder / "truth.ply")
    return EvalMetrics(config).evaluate(trajectories, frames=shots(), surfaces=surfaces)


def everywhere(points: np.ndarray) -> np.ndarray:
    return np.ones(len(points), np.bool_)


def number(metrics: Metrics, key: str) -> float:
    value = metrics[key]
    assert isinstance(value, int | float), f"{key} is {value}"
    return float(value)


# Trajectories


def test_the_last_frame_is_in_the_error() -> None:
    """A count that begins at 0 used as a number of frames drops the last one."""
    late = path()
    late[-1, :3, 3] += [0.0, 0.0, 0.12]
    error = absolute_trajectory_error(late, path(), "none")
    assert error.rmse_cm == pytest.approx(12 / math.sqrt(12))


def test_poses_that_are_left_out_are_counted() -> None:
    """Infinite ground truth (as ScanNet has it) and missing estimates shrink an average without a word."""
    truth, found = path(), path()
    truth[3, 0, 3], found[5], found[6] = np.inf, np.nan, np.nan
    protocol = EvalMetrics().evaluate(Trajectories(found, found, truth, np.zeros(12, np.bool_)))[
        "trajectory/final/protocol"
    ]
    assert isinstance(protocol, dict)
    assert (protocol["matched_frames"], protocol["frames_without_ground_truth"]) == (9, 1)
    assert protocol["frames_without_estimate"] == 2


def test_a_run_that_stopped_early_or_was_lost_is_not_complete() -> None:
    """A tracker that gives up has the best error of all, over the frames that it has."""
    lost = np.zeros(12, np.bool_)
    lost[8:] = True
    metrics = EvalMetrics().evaluate(Trajectories(path(), path(), path(), lost, sequence_frames=20))
    assert number(metrics, "trajectory/lost_percent") == pytest.approx(100 * 4 / 12)
    assert number(metrics, "trajectory/coverage_percent") == pytest.approx(100 * 8 / 20)


def test_what_was_reported_and_what_was_found_later_are_two_trajectories() -> None:
    """Which of the two a published error is of is rarely said."""
    drifted = path() * np.where(np.arange(16).reshape(4, 4) == 3, 1.5, 1.0)
    metrics = EvalMetrics().evaluate(Trajectories(drifted, path(), path()))
    assert number(metrics, "trajectory/final/ate_rmse_cm") < 1e-6 < 1 < number(metrics, "trajectory/online/ate_rmse_cm")


def test_a_mirror_image_is_no_solution() -> None:
    mirrored, truth = path(), path()
    truth[:, 2, 3] = mirrored[:, 2, 3] = 0.1 * np.cos(np.arange(12.0) ** 2)
    mirrored[:, 1, 3] *= -1
    assert absolute_trajectory_error(mirrored, truth, "sim3").rmse_cm > 1


# Renderings


def test_a_renderer_is_given_a_camera_and_a_pose_and_no_measured_depth() -> None:
    """Renderers that are told where the surface is sample there, and look better than any novel view will."""
    told: list[tuple[object, ...]] = []

    def render(*given: object) -> Rendering:
        told.append(given)
        return exact(CAMERA, torch.eye(4))

    metrics = EvalMetrics().evaluate(Trajectories(path(), path(), path()), render, shots())
    assert [[type(thing) for thing in given] for given in told] == [[Camera, Tensor]] * 3
    assert all(pose.shape == (4, 4) for _, pose in told)  # type: ignore[attr-defined]  # a tensor, as just seen
    protocol = metrics["rendering/train/protocol"]
    assert isinstance(protocol, dict)
    assert protocol["ground_truth_depth_given_to_renderer"] == "no"


def test_views_that_built_the_map_and_views_that_did_not_stand_apart() -> None:
    held_out = np.arange(12) % 4 == 3

    def render(camera: Camera, T_world_camera: Tensor) -> Rendering:
        """Remember what was shown, blur what was not."""
        index = round(float(T_world_camera[0, 3]) / 0.02)
        seen = exact(camera, T_world_camera)
        return seen._replace(rgb=seen.rgb + 0.1) if index % 4 == 3 else seen._replace(rgb=(seen.rgb + 0.01).clamp(0, 1))

    trajectories = Trajectories(path(), path(), path(), is_held_out=held_out)
    metrics = EvalMetrics(EvaluationConfig(every=1, held_out=4)).evaluate(trajectories, render, shots())
    assert number(metrics, "rendering/train/psnr_db") > 39
    assert number(metrics, "rendering/held_out/psnr_db") < 22
    frames = [metrics[f"rendering/{kind}/protocol"]["frames"] for kind in ("train", "held_out")]  # type: ignore[index, call-overload]  # dicts
    assert frames == [9, 3]
    assert "rendering/held_out/psnr_db" not in EvalMetrics().evaluate(
        Trajectories(path(), path(), path()), render, shots()
    )


def test_compared_frames_are_picked_by_their_place_not_by_being_keyframes() -> None:
    survey = Survey(EvaluationConfig(every=5), Trajectories(path(), path(), path()))
    survey.go(exact, shots())
    assert [row.index for row in survey.metrics["train"].rows] == [0, 5, 10]


def half_measured() -> Shot:
    frame = shots(1)[0]
    assert frame.depth is not None
    frame.depth[:, 40:] = 0.0
    return frame


def test_the_mask_keeps_what_was_measured_and_not_the_rest() -> None:
    frame = half_measured()
    wrong_where_unmeasured, wrong_where_measured = exact(CAMERA, torch.eye(4)), exact(CAMERA, torch.eye(4))
    wrong_where_unmeasured.rgb[:, 40:] = 1 - wrong_where_unmeasured.rgb[:, 40:]
    wrong_where_measured = wrong_where_measured._replace(rgb=wrong_where_measured.rgb.clone())
    wrong_where_measured.rgb[:, :40] = 1 - wrong_where_measured.rgb[:, :40]
    measure = RenderingMetrics(1)
    assert measure.add(frame, wrong_where_unmeasured).psnr_db == math.inf
    found = measure.add(frame, wrong_where_measured).psnr_db
    assert found is not None
    assert found < 15


def test_photograph_and_rendering_are_masked_alike() -> None:
    """A black rendering beside an unmasked photograph is charged for every hole of the sensor."""
    black = exact(CAMERA, torch.eye(4))
    black = black._replace(rgb=black.rgb * (torch.arange(80) < 40)[None, :, None])
    assert RenderingMetrics(1).add(half_measured(), black).psnr_db == math.inf


def test_ssim_is_not_ms_ssim() -> None:
    """MS-SSIM is some 0.05 higher, and is printed as SSIM in many tables."""
    big = Camera(100.0, 100.0, 90.0, 85.0, 180, 170)
    v, u = torch.meshgrid(torch.arange(170.0), torch.arange(180.0), indexing="ij")
    picture = (0.5 + 0.3 * torch.sin(u / 6) * torch.cos(v / 7))[..., None].repeat(1, 1, 3)
    noise = 0.1 * torch.randn(170, 180, 3, generator=torch.Generator().manual_seed(0))
    seen = Rendering((picture + noise).clamp(0, 1), torch.ones(170, 180), torch.ones(170, 180))
    row = RenderingMetrics(1, "none").add(Shot(0, big, picture, None), seen)
    reference = structural_similarity(
        picture.double().numpy(), seen.rgb.double().numpy(),
        data_range=1.0, channel_axis=-1, gaussian_weights=True, use_sample_covariance=False,
    )  # fmt: skip
    assert row.ssim == pytest.approx(reference, abs=1e-9)
    assert row.ms_ssim is not None
    assert row.ms_ssim > reference + 0.05


@pytest.fixture
def lpips_folder(tmp_path: Path) -> Path:
    """Write weights for alex alone: a network whose first layer looks at single colours."""
    generator = torch.Generator().manual_seed(0)
    weights = {}
    for layer, shape in {
        0: (64, 3, 11),
        3: (192, 64, 5),
        6: (384, 192, 3),
        8: (256, 384, 3),
        10: (256, 256, 3),
    }.items():
        outputs, inputs, side = shape
        values = torch.randn(outputs, inputs, side, side, generator=generator) * (2 / (inputs * side**2)) ** 0.5
        weights |= {
            f"features.{layer}.weight": values.numpy(),
            f"features.{layer}.bias": np.full(outputs, 0.1, np.float32),
        }
    heads = {f"lin{k}": np.ones(c, np.float32) for k, c in enumerate((64, 192, 384, 256, 256))}
    np.savez(tmp_path / "lpips_alex_v0.1.npz", **weights, **heads)
    return tmp_path


def test_a_perceptual_network_is_loaded_once_and_named_by_its_backbone(
    lpips_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built = []
    original = Lpips.__init__

    def counted(self: Lpips, backbone: str, weights: dict[str, Tensor]) -> None:
        built.append(backbone)
        original(self, backbone, weights)

    monkeypatch.setattr(Lpips, "__init__", counted)

    def render(camera: Camera, T_world_camera: Tensor) -> Rendering:
        seen = exact(camera, T_world_camera)
        return seen._replace(rgb=seen.rgb.flip(0))

    config = EvaluationConfig(every=2, lpips_weights=str(lpips_folder))
    metrics = EvalMetrics(config).evaluate(Trajectories(path(), path(), path()), render, shots())
    assert built == ["alex"]
    assert number(metrics, "rendering/train/lpips_alex") > 0.01
    assert metrics["rendering/train/lpips_squeeze"] is None
    protocol = metrics["rendering/train/protocol"]
    assert isinstance(protocol, dict)
    assert "lpips_squeeze_v0.1.npz" in str(protocol["unavailable"])
    assert "rendering/train/lpips" not in metrics


def test_perceptual_networks_see_images_from_minus_one_to_one(lpips_folder: Path) -> None:
    """Handed [0, 1], a network sees grey pictures and finds all of them alike."""
    with np.load(lpips_folder / "lpips_alex_v0.1.npz") as arrays:
        weights = {name: torch.from_numpy(arrays[name]) for name in arrays.files}
    x, y = torch.rand(2, 64, 64, 3, generator=torch.Generator().manual_seed(1))
    right = Lpips("alex", weights)(x, y).item()
    assert right != pytest.approx(Lpips("alex", weights)((x + 1) / 2, (y + 1) / 2).item(), rel=0.05)
    first = weights["features.0.weight"], weights["features.0.bias"]
    shift, scale = torch.tensor([-0.030, -0.088, -0.188]), torch.tensor([0.458, 0.448, 0.450])
    scaled = ((2 * torch.stack((x, y)) - 1 - shift) / scale).permute(0, 3, 1, 2)
    features = torch.nn.functional.conv2d(scaled, *first, stride=4, padding=2).relu()
    unit = features / (features.norm(dim=1, keepdim=True) + 1e-10)
    only_first = {k: v if k == "lin0" or "features" in k else torch.zeros_like(v) for k, v in weights.items()}
    expected = (unit[0] - unit[1]).square().sum(0).mean().item()
    assert Lpips("alex", only_first)(x, y).item() == pytest.approx(expected, rel=1e-5)


def test_a_hole_in_rendered_depth_costs_its_depth() -> None:
    seen = exact(CAMERA, torch.eye(4))
    seen.depth[:, :20] = 0.0
    assert RenderingMetrics(1).add(shots(1)[0], seen).depth_l1_cm == pytest.approx(100 * WALL_M * 20 / 80)


# Surfaces


def test_what_was_seen_is_told_by_the_true_poses() -> None:
    """Culled at its own poses, a run that drifted away is asked only about what it believes to have seen."""
    turned = path()
    turned[:, :3, :3] = Rotation.from_euler("y", 90, degrees=True).as_matrix()
    survey = Survey(EvaluationConfig(cull_every=1), Trajectories(turned, turned, path()))
    survey.go(None, shots(), wants_depth=True)
    assert np.array_equal(np.stack([view.T_world_camera for view in survey.depth_views]), path())


def test_protocols_of_culling_differ_and_are_named(tmp_path: Path) -> None:
    """A second wall behind the first: seen through it by the frustum alone."""
    front, behind = square(), square(3.0)
    both = TriangleMesh(
        np.concatenate((front.vertices, behind.vertices)), np.concatenate((front.faces, behind.faces + 4 * 2))
    )
    found = {name: with_mesh(tmp_path, front, both, culling=name) for name in ("frustum", "frustum_occlusion")}
    assert number(found["frustum"], "reconstruction/completion_cm") > 40
    assert number(found["frustum_occlusion"], "reconstruction/completion_cm") < 4
    for name, metrics in found.items():
        assert metrics["reconstruction/protocol"]["culling"] == name  # type: ignore[index, call-overload]  # a dict


def test_the_same_surface_has_the_same_figures_twice(tmp_path: Path) -> None:
    """Unseeded samples and views move the third digit."""
    first, again = (with_mesh(tmp_path, square(2.02), square()) for _ in range(2))
    assert first == again
    assert first["reconstruction/protocol"]["seed"] == 0  # type: ignore[index, call-overload]  # a dict
    other = with_mesh(tmp_path, square(2.02), square(), seed=1)
    assert other["reconstruction/accuracy_cm"] != first["reconstruction/accuracy_cm"]
    assert other["reconstruction/mesh_depth_l1_cm"] != first["reconstruction/mesh_depth_l1_cm"]


def test_precision_does_not_depend_on_how_finely_a_wall_is_cut() -> None:
    """Measured at vertices, a mesh improves by cutting what is right into small pieces."""

    def precision(pieces: int) -> float:
        estimate = square(pieces=pieces)
        on_the_right = estimate.vertices[:, 0] > 0
        vertices = estimate.vertices.copy()
        vertices[on_the_right, 2] += 0.2  # the half that is not cut leans away from the wall
        truth = square()
        error = compare_surfaces(TriangleMesh(vertices, estimate.faces), truth, everywhere, 8000)
        return float((error.to_truth_m < 0.05).mean())

    assert precision(1) == pytest.approx(precision(30), abs=0.02)
    assert 0.5 < precision(1) < 0.75  # a quarter of the right half is within 5 cm


def test_a_missing_surface_is_not_free(tmp_path: Path) -> None:
    """Pixels where the estimate has no depth are left out by the published tool: half a room then scores as a whole."""
    whole, half = (with_mesh(tmp_path, mesh, square()) for mesh in (square(), square(left=0.0)))
    assert number(whole, "reconstruction/mesh_depth_l1_cm") < 0.01
    assert number(half, "reconstruction/mesh_depth_l1_cm") > 30
    assert number(half, "reconstruction/missing_surface_percent") > 20
    assert number(half, "reconstruction/completion_cm") > 5


def test_registration_of_the_surfaces_is_off_unless_asked_for_and_always_said(tmp_path: Path) -> None:
    """ICP on top of the trajectory's alignment takes away an error of the map."""
    plain = with_mesh(tmp_path, square(2.03), square())
    fitted = with_mesh(tmp_path, square(2.03), square(), icp="point_to_point")
    assert number(plain, "reconstruction/mesh_depth_l1_cm") == pytest.approx(3.0, abs=0.5)
    assert number(fitted, "reconstruction/mesh_depth_l1_cm") < 0.5
    assert [m["reconstruction/protocol"]["icp"] for m in (plain, fitted)] == ["none", "point_to_point"]  # type: ignore[index, call-overload]  # dicts


def test_the_scale_of_the_alignment_reaches_the_mesh(tmp_path: Path) -> None:
    truth = square(2.0)
    half = TriangleMesh(
        Alignment(0.5, np.eye(3), np.zeros(3)).apply(truth.vertices.astype(np.float64)).astype(np.float32), truth.faces
    )
    final = path()
    final[:, :3, 3] *= 0.5
    assert number(with_mesh(tmp_path, half, truth, final, alignment="sim3"), "reconstruction/mesh_depth_l1_cm") < 0.1
    assert number(with_mesh(tmp_path, half, truth, final, alignment="se3"), "reconstruction/mesh_depth_l1_cm") > 50


def test_a_mesh_of_another_world_has_no_figures_and_a_reason(tmp_path: Path) -> None:
    """The wrong ground-truth mesh gave NaN."""
    metrics = with_mesh(tmp_path, square(), square(-9.0))
    assert metrics["reconstruction/mesh_depth_l1_cm"] is None
    assert metrics["reconstruction/accuracy_cm"] is None
    assert "one world" in str(metrics["reconstruction/protocol"]) or "same world" in str(
        metrics["reconstruction/protocol"]
    )


# The evaluation as a whole


def test_without_a_mesh_everything_else_is_evaluated_and_written(tmp_path: Path) -> None:
    """The published tool returns early without a mesh, and writes no file with one."""
    config = EvaluationConfig(pictures_every=0, trajectory_pictures=False)
    metrics = EvalMetrics(config).evaluate(Trajectories(path(), path(), path()), exact, shots(), run_dir=tmp_path)
    assert number(metrics, "trajectory/final/ate_rmse_cm") < 1e-6
    assert json.loads((tmp_path / "metrics.json").read_text()) == metrics


def test_no_window_and_no_accelerator_are_needed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    with_mesh(tmp_path, square(), square(), culling="virtual_cameras")
    assert not {"open3d", "pyrender", "OpenGL", "pyglet", "vtk"} & set(sys.modules)


def test_one_broken_rendering_is_not_left_out_of_a_mean() -> None:
    """Averages over what is finite improve with every rendering that fails."""

    def broken(camera: Camera, T_world_camera: Tensor) -> Rendering:
        seen = exact(camera, T_world_camera)
        seen = seen._replace(rgb=(seen.rgb + 0.1).clamp(0, 1))
        if round(float(T_world_camera[0, 3]) / 0.02) != 3:
            return seen
        return seen._replace(rgb=torch.full_like(seen.rgb, torch.nan), depth=torch.full_like(seen.depth, torch.nan))

    metrics = EvalMetrics(EvaluationConfig(every=1)).evaluate(Trajectories(path(), path(), path()), broken, shots())
    assert [metrics[f"rendering/train/{key}"] for key in ("psnr_db", "ssim", "depth_l1_cm")] == [None] * 3
    assert "frame 3" in str(metrics["rendering/train/protocol"])
