"""Recognising lost frames: found to centimetres where there is evidence, and not at all where there is none."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.camera import Camera
from xrdslam.core.config import AlgorithmConfig, TrackingConfig
from xrdslam.core.dataset import Dataset, Modality
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3, so3
from xrdslam.core.model import Model
from xrdslam.core.tracking import TrackingMethod, TrackingResult
from xrdslam.core.trajectory import Trajectory
from xrdslam.methods import relocalisation, views
from xrdslam.methods.features import detect, match
from xrdslam.methods.no_mapping import NoMapping
from xrdslam.methods.relocalisation import OrbRelocaliser, depth_agreement
from xrdslam.testing import AlgorithmContract, ToyModel
from xrdslam.testing.bits import different_leaves, through_a_file

CAMERA = Camera(260.0, 260.0, 159.5, 119.5, 320, 240)
LOW, HIGH = torch.tensor([-2.0, -1.3, -2.5]), torch.tensor([2.0, 1.3, 2.5])
"""Corners of the room [m]."""
TILE_M = 0.04

Paint = Callable[[Tensor, Tensor], Tensor]
"""(points on the walls [m], number of the wall) -> grey, in [0, 1]."""


def hashed(*numbers: Tensor) -> Tensor:
    """Return a number in [0, 1) for each row of whole numbers, alike for equal ones."""
    state = torch.zeros_like(numbers[0], dtype=torch.int64)
    for number in numbers:
        state = (state * 1_000_003 + number.long() * 7_919 + 12_345) % 2_147_483_647
        state = ((state ^ (state >> 15)) * 48_271) % 2_147_483_647
        state = ((state ^ (state >> 13)) * 69_621) % 2_147_483_647  # a linear mix alone would paint stripes
    return (state % 1000) / 1000


def tiles(points: Tensor, wall: Tensor) -> Tensor:
    """Paint every wall with squares of random greys: corners that are nowhere alike."""
    return hashed(*(points / TILE_M).floor().unbind(-1), wall)


def wallpaper(points: Tensor, wall: Tensor) -> Tensor:
    """Paint every wall with the same motif every 24 cm."""
    return hashed(*((points / TILE_M).floor() % 6).unbind(-1))


def plain(points: Tensor, wall: Tensor) -> Tensor:
    return torch.full(points.shape[:-1], 0.5)


def opposite_alike(points: Tensor, wall: Tensor) -> Tensor:
    """Paint the room so that half a turn about its middle changes nothing."""
    sign = torch.where(points[..., 2:] < 0, -1.0, 1.0)
    turned = points * torch.cat((sign, torch.ones_like(sign), sign), -1)
    return hashed(*(turned / TILE_M).floor().unbind(-1))


def view(
    T_world_camera: Tensor, paint: Paint = tiles, index: int = 0, with_depth: bool = True, camera: Camera = CAMERA
) -> Frame:
    directions = camera.rays().double() @ T_world_camera[:3, :3].double().mT
    origin = T_world_camera[:3, 3].double()
    distances = (torch.where(directions > 0, HIGH.double(), LOW.double()) - origin) / directions
    depth, axis = distances.min(-1)
    points = origin + depth[..., None] * directions
    heading = directions.gather(-1, axis[..., None])[..., 0] > 0
    # A point lies on its wall but for rounding, which must not change the tile.
    points = points.scatter(-1, axis[..., None], torch.where(heading, 7.5, -7.5)[..., None].double() * TILE_M)
    grey = paint(points, 2 * axis + heading).float()
    return Frame(index, index, camera, grey[..., None].expand(-1, -1, 3), depth.float() if with_depth else None)


def pose(translation: list[float], rotation: list[float]) -> Tensor:
    return se3.compose(so3.exp(torch.tensor(rotation)), torch.tensor(translation))


WALK = [pose([0.1 * k - 0.4, 0.1, -0.5], [0.02 * k, 0.12 * k - 0.5, 0.0]) for k in range(9)]
NEAR = pose([0.35, -0.1, -0.25], [-0.05, 0.25, 0.12])
"""Some 40 cm and 15 degrees off the nearest of the walk."""


def walked(paint: Paint = tiles, walk: list[Tensor] = WALK) -> tuple[OrbRelocaliser, Trajectory]:
    relocaliser, trajectory = OrbRelocaliser(), Trajectory()
    for index, T_world_camera in enumerate(walk):
        trajectory.append(index, index, T_world_camera)
        relocaliser.remember(view(T_world_camera, paint, index), trajectory)
    return relocaliser, trajectory


@pytest.fixture(scope="module")
def tiled() -> tuple[OrbRelocaliser, Trajectory]:
    return walked()


def error_of(found: Tensor, truth: Tensor) -> tuple[float, float]:
    between = se3.inverse(truth.double()) @ found.double()
    return float(between[:3, 3].norm()), float(so3.log(between[:3, :3]).norm())


def test_a_view_from_elsewhere_is_found(tiled: tuple[OrbRelocaliser, Trajectory]) -> None:
    relocaliser, trajectory = tiled
    found = relocaliser.find(view(NEAR, index=50), trajectory)
    assert found.T_world_camera is not None, found.reason
    off_m, off_rad = error_of(found.T_world_camera, NEAR)
    assert off_m < 0.02, found.reason  # a pixel of 320 at 2 m is 8 mm
    assert off_rad < 0.01
    assert "points agree" in found.reason
    assert se3.is_rigid(found.T_world_camera, 1e-6)


def test_the_same_frames_give_the_same_bits(tiled: tuple[OrbRelocaliser, Trajectory]) -> None:
    first = tiled[0].find(view(NEAR, index=50), tiled[1])
    resumed = OrbRelocaliser()
    resumed.load_state_dict(through_a_file(tiled[0].state_dict()))
    assert not different_leaves(tiled[0].state_dict(), resumed.state_dict())
    for relocaliser in (walked()[0], resumed):
        again = relocaliser.find(view(NEAR, index=50), tiled[1])
        assert first.T_world_camera is not None
        assert again.T_world_camera is not None
        assert torch.equal(first.T_world_camera, again.T_world_camera)


def test_it_follows_what_mapping_moves(tiled: tuple[OrbRelocaliser, Trajectory]) -> None:
    """Views are where the trajectory says now, not where they were when they were seen."""
    relocaliser, _ = tiled
    shift, moved = pose([1.0, 2.0, 0.5], [0.3, 0.2, 0.1]), Trajectory()
    for index, T_world_camera in enumerate(WALK):
        moved.append(index, index, shift @ T_world_camera)
    found = relocaliser.find(view(NEAR, index=50), moved)
    assert found.T_world_camera is not None
    assert error_of(found.T_world_camera, shift @ NEAR)[0] < 0.02


def test_without_small_gicp_the_pose_of_the_points_stands(
    tiled: tuple[OrbRelocaliser, Trajectory], monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(*_: object, **__: object) -> None:
        raise relocalisation.MissingExtraError("not installed")

    monkeypatch.setattr(relocalisation, "GaussianMaps", missing)
    found = tiled[0].find(view(NEAR, index=50), tiled[1])
    assert found.T_world_camera is not None
    assert error_of(found.T_world_camera, NEAR)[0] < 0.03


def unregistered(T_world_camera: Tensor, index: int = 0) -> Frame:
    """A frame whose colours were taken through a longer lens than its depths, and nobody put them together."""
    frame = view(T_world_camera, index=index)
    long = dataclasses.replace(CAMERA, fx=286.0, fy=286.0)
    rgb = view(T_world_camera, index=index, camera=long).rgb
    return Frame(index, index, CAMERA, rgb, frame.depth)


def test_depth_corrects_what_colour_misleads() -> None:
    relocaliser, trajectory = OrbRelocaliser(), Trajectory()
    corner = pose([-0.6, -0.3, -0.9], [-0.45, 0.7, 0.0])  # of three walls: depth tells every motion
    trajectory.append(0, 0, corner)
    relocaliser.remember(unregistered(corner), trajectory)
    there = corner @ pose([0.2, 0.05, 0.1], [-0.05, 0.1, 0.03])
    frame = unregistered(there, 50)
    found = relocaliser.find(frame, trajectory)
    assert found.T_world_camera is not None, found.reason
    off_m, off_rad = error_of(found.T_world_camera, there)
    assert off_m < 0.002
    assert off_rad < 0.001
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(relocalisation, "_refine", lambda found, *_: found)
        by_colour = relocaliser.find(frame, trajectory)
    assert by_colour.T_world_camera is not None
    assert error_of(by_colour.T_world_camera, there)[0] > 0.01, "the matches alone lead elsewhere"


def test_registration_does_not_slide_along_a_wall() -> None:
    """Before a plain wall, surfaces that are nearer to one another say nothing of the motion along it."""
    T_view_frame = pose([0.1, 0.05, 0.0], [0.0, 0.0, 0.0])
    before_a_wall = pose([0.0, 0.0, 1.2], [0.0, 0.0, 0.0])
    seen, frame = view(before_a_wall), view(before_a_wall @ T_view_frame, index=50)
    surface = views.surface_of(seen)
    points = surface[::40].astype(np.float64)
    pixels, _ = relocalisation.working_camera(CAMERA).project(torch.from_numpy(points - [0.1, 0.05, 0.0]))
    start = (T_view_frame @ pose([0.01, 0.0, 0.03], [0.01, 0.0, 0.0])).double().numpy()
    found = relocalisation._Hypothesis(views.View(0, detect(seen), surface, 1.3), start, points, pixels.numpy())
    assert relocalisation._refine(found, frame, views.surface_of(frame)) is found
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(relocalisation, "MIN_DETERMINATION", 0.0)
        slid = relocalisation._refine(found, frame, views.surface_of(frame))
    assert error_of(torch.from_numpy(slid.T_view_frame), T_view_frame)[0] > 0.05
    assert relocalisation._offset_m(slid, frame) < 0.001 < relocalisation._offset_m(found, frame)


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (view(NEAR, plain, 50), "corners in the image"),
        (view(NEAR, tiles, 50, with_depth=False), "no depth to verify"),
        (view(pose([0.0, 0.0, 0.0], [0.0, 3.1, 0.0]), tiles, 50), "no view matches"),
    ],
)
def test_what_cannot_be_recognised_is_not(tiled: tuple[OrbRelocaliser, Trajectory], frame: Frame, reason: str) -> None:
    found = tiled[0].find(frame, tiled[1])
    assert found.T_world_camera is None
    assert reason in found.reason


def test_nothing_is_found_where_nothing_is_remembered() -> None:
    trajectory = Trajectory()
    trajectory.append(0, 0, WALK[0])
    relocaliser = OrbRelocaliser()
    for frame in (view(WALK[0], plain), view(WALK[0], tiles, with_depth=False)):
        relocaliser.remember(frame, trajectory)
    found = relocaliser.find(view(NEAR, index=50), trajectory)
    assert found == (None, "no view with texture and depth is remembered")


def test_a_texture_that_repeats_is_no_evidence() -> None:
    """Each corner of a wallpaper has twins: the pose that would come out may be periods away."""
    relocaliser, trajectory = walked(wallpaper)
    assert relocaliser.memory.views  # it has corners enough
    found = relocaliser.find(view(NEAR, wallpaper, 50), trajectory)
    assert found.T_world_camera is None, found.reason


def test_two_places_that_look_alike_make_both_doubtful() -> None:
    """Matches, reprojection and depth all agree, at either end of the room."""
    half_turn = pose([0.0, 0.0, 0.0], [0.0, np.pi, 0.0])
    there = pose([0.2, 0.1, 0.4], [0.05, 0.1, 0.0])
    for walk, is_found in (([there], True), ([there, half_turn @ there], False)):
        relocaliser, trajectory = walked(opposite_alike, walk)
        frame = view(there @ pose([0.1, 0.05, -0.1], [0.02, 0.06, 0.0]), opposite_alike, 50)
        found = relocaliser.find(frame, trajectory)
        assert (found.T_world_camera is not None) == is_found, found.reason
    assert "look alike" in found.reason


def test_a_match_whose_depth_is_another_is_rejected(tiled: tuple[OrbRelocaliser, Trajectory]) -> None:
    """A photograph of the room: every corner is there, and what lies behind it is not."""
    frame = view(NEAR, index=50)
    assert frame.depth is not None
    frame.depth.mul_(1.5)
    found = tiled[0].find(frame, tiled[1])
    assert found.T_world_camera is None
    assert "depths disagree" in found.reason


def test_a_refinement_that_leads_away_is_noticed(tiled: tuple[OrbRelocaliser, Trajectory]) -> None:
    relocaliser, trajectory = tiled
    frame = view(NEAR, index=50)
    assert relocaliser.find(frame, trajectory).T_world_camera is not None
    assert relocaliser.agrees(frame, NEAR, trajectory)
    assert not relocaliser.agrees(frame, NEAR @ pose([0.3, 0.0, 0.3], [0.0, 0.3, 0.0]), trajectory)
    assert not relocaliser.agrees(view(NEAR, index=51), NEAR, trajectory)  # not the frame that was found


def test_hidden_surfaces_say_nothing_and_missing_ones_contradict() -> None:
    frame = view(WALK[0])
    surface = views.surface_of(frame)
    assert depth_agreement(frame, surface, np.eye(4)) == (1.0, 1.0)
    assert frame.depth is not None
    frame.depth[:120] *= 0.5  # something came before the upper half
    overlap, agreement = depth_agreement(frame, surface, np.eye(4))
    assert overlap == pytest.approx(0.5, abs=0.02)
    assert agreement == 1.0
    frame.depth[:120] *= 4  # something went away there
    assert depth_agreement(frame, surface, np.eye(4))[1] == pytest.approx(0.5, abs=0.02)


def test_corners_are_matched_at_any_size() -> None:
    """The same view at half the size has the same corners, by and large, to a pixel of its own."""
    frame = view(WALK[4])
    assert frame.depth is not None
    small = CAMERA.resized(160, 120)
    rgb = frame.rgb.reshape(120, 2, 160, 2, 3).mean((1, 3))
    half = Frame(1, 1, small, rgb, frame.depth[::2, ::2].contiguous())
    whole, part = detect(frame), detect(half)
    pairs = match(whole, part)
    assert len(pairs) > 100
    enlarged = (part.pixels[pairs[:, 1]] + 0.5) * 2 - 0.5  # the working images are of 640 and 320 px
    off = np.linalg.norm(whole.pixels[pairs[:, 0]] - enlarged, axis=1)
    assert np.median(off) < 4


def test_memory_is_bounded_and_spread(monkeypatch: pytest.MonkeyPatch) -> None:
    """With too many views the one nearest to another goes, so that every place keeps one."""
    monkeypatch.setattr(views, "MAX_VIEWS", 4)
    dense = [WALK[0], WALK[2], WALK[3], WALK[4], WALK[6], WALK[8]]
    relocaliser, _ = walked(walk=dense)
    kept = [v.index for v in relocaliser.memory.views]
    assert len(kept) == 4
    assert {0, 5} <= set(kept)
    assert sum(t.numel() * t.element_size() for t in relocaliser.state_dict().values()) < 4 * 110_000


def test_a_place_is_remembered_once(tiled: tuple[OrbRelocaliser, Trajectory]) -> None:
    relocaliser, trajectory = walked(walk=[*WALK, *WALK])
    assert [v.index for v in relocaliser.memory.views] == [v.index for v in tiled[0].memory.views]
    assert len(trajectory) == 2 * len(WALK)


def test_an_empty_memory_is_a_state_too() -> None:
    empty, other = OrbRelocaliser(), walked(walk=WALK[:2])[0]
    state: dict[str, Any] = through_a_file(empty.state_dict())
    other.load_state_dict(state)
    assert other.memory.views == []


# The whole way: an algorithm that loses its track, with and without


class Walk(Dataset):
    """Eight frames along the walk, and four more from behind a gap of 70 cm and 50 degrees."""

    def __init__(self) -> None:
        there = pose([0.3, -0.1, 0.2], [-0.1, -0.55, 0.1])
        self.poses = [*WALK[:8], *(there @ pose([0.02 * k, 0.0, 0.0], [0.0, 0.02 * k, 0.0]) for k in range(4))]

    @property
    def name(self) -> str:
        return "tiled/room"

    @property
    def camera(self) -> Camera:
        return CAMERA

    @property
    def modalities(self) -> frozenset[Modality]:
        return frozenset({"rgb", "depth", "pose"})

    def __len__(self) -> int:
        return len(self.poses)

    def __getitem__(self, index: int) -> Frame:
        frame = view(self.poses[index], index=index)
        frame.T_world_camera_gt = self.poses[index]
        return frame


class Nearsighted(TrackingMethod):
    """Finds the true pose where the prediction is within 25 cm and 0.25 rad of it, else nothing."""

    needs = frozenset({"rgb", "depth"})

    def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
        assert frame.T_world_camera_gt is not None
        off_m, off_rad = error_of(frame.pose.matrix().detach(), frame.T_world_camera_gt)
        is_lost = off_m > 0.25 or off_rad > 0.25
        return TrackingResult(frame.T_world_camera_gt, is_lost=is_lost, reason="too far off" if is_lost else "")


class Unmapped(Algorithm):
    """Makes no map."""

    def build_model(self, scene: Scene, frame: Frame) -> Model:
        return ToyModel()


class TestContract(AlgorithmContract):
    """Lost and found frames are resumed to the bit like all others."""

    accuracy = 1e-5

    def make_algorithm(self) -> Algorithm:
        config = AlgorithmConfig("unmapped", tracking=TrackingConfig("nearsighted", relocalise=True))
        algorithm = Unmapped(config, Nearsighted(config.tracking), NoMapping(config.mapping))
        algorithm.relocaliser = OrbRelocaliser(self.seed)
        return algorithm

    def make_sequence(self) -> Walk:
        return Walk()


@pytest.mark.parametrize("relocalises", [False, True])
def test_behind_a_gap_the_frames_are_found_or_reported_lost(relocalises: bool) -> None:
    algorithm = TestContract().make_algorithm()
    algorithm.relocaliser = algorithm.relocaliser if relocalises else None
    dataset = Walk()
    frames = list(dataset.frames())
    algorithm.start(Scene.of(dataset), frames[0])
    results = [algorithm.track(frame) for frame in frames[1:]]
    found = [frame.index for frame, result in zip(frames[1:], results, strict=True) if result.is_recognised]
    assert found == ([8] if relocalises else [])  # the next ones are tracked from there
    assert algorithm.trajectory.is_lost.tolist() == [i >= 8 and not relocalises for i in range(12)]


def test_a_tracker_that_is_led_astray_again_is_not_believed() -> None:
    """What it makes of the found pose must agree with what was recognised; else the found pose stands."""

    class Astray(Nearsighted):
        def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
            result = super().track(frame, model, trajectory)
            is_found = frame.index == 8 and not result.is_lost
            return result._replace(T_world_camera=WALK[0]) if is_found else result

    algorithm = TestContract().make_algorithm()
    algorithm.tracking = Astray(algorithm.tracking.config)
    dataset = Walk()
    frames = list(dataset.frames())
    algorithm.start(Scene.of(dataset), frames[0])
    results = [algorithm.track(frame) for frame in frames[1:]]
    assert results[7].is_recognised
    assert error_of(results[7].T_world_camera, dataset.poses[8])[0] < 0.03


def test_a_frame_that_shows_nothing_is_not_looked_for() -> None:
    algorithm = TestContract().make_algorithm()
    dataset = Walk()
    frames = list(dataset.frames())
    algorithm.start(Scene.of(dataset), frames[0])
    frames[1].rgb.fill_(torch.nan)
    assert algorithm.track(frames[1]).reason == "its image is not finite"
