"""Recognising a lost frame among remembered views: ORB, perspective from points, generalised ICP, and a verdict."""

import logging
import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32, Float64
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.errors import MissingExtraError
from xrdslam.core.frame import Frame
from xrdslam.core.relocalisation import Relocalisation, Relocaliser
from xrdslam.core.trajectory import Trajectory
from xrdslam.methods.features import Features, detect, match, working_camera
from xrdslam.methods.gicp_map import GaussianMaps
from xrdslam.methods.views import View, ViewMemory, surface_of

__all__ = ["OrbRelocaliser", "depth_agreement"]

log = logging.getLogger(__name__)

NUM_CANDIDATES = 5
"""Views whose matches are looked at closely."""
MIN_INLIERS = 20
"""Matches that a pose must explain, ..."""
MIN_INLIER_SHARE = 0.25
"""... of those that passed the ratio test, ..."""
MIN_SPREAD = 0.06
"""... spread over the image with at least this standard deviation in both directions, in parts of its width."""
REPROJECTION_PX = 3.0
"""How far a match may be off in the working image."""
ITERATIONS = 1000
"""Draws of RANSAC."""
MIN_OVERLAP = 0.15
"""Share of a view's surface that the frame must show in its place, ..."""
MIN_AGREEMENT = 0.8
"""... and share of what agrees of what agrees or is seen through."""
RIVAL = 0.6
"""A pose elsewhere that has this part of the best one's inliers makes both doubtful: two places look alike."""
SAME_M, SAME_RAD = 0.25, 0.25
"""Poses that are as near as this are one."""
ICP_VOXELS_M = (0.3, 0.1)
MIN_REPROJECTED = 0.8
"""Share of the matches that must still lie within twice the tolerance after ICP, which slides along plain walls, ..."""
MIN_DETERMINATION = 0.02
"""... unless the surfaces determine the pose this well ..."""
NEARER = 0.6
"""... and are this much nearer to one another: matches mislead where colour is not registered to depth."""


@dataclass(frozen=True)
class _Hypothesis:
    """A pose that one view suggests."""

    view: View
    T_view_frame: Float64[np.ndarray, "4 4"]
    points_view: Float64[np.ndarray, "n 3"]
    """The matches that it explains: points of the view, ..."""
    pixels: Float64[np.ndarray, "n 2"]
    """... and where the frame has them [px of its working image]."""

    @property
    def num_inliers(self) -> int:
        """How many matches it explains."""
        return len(self.pixels)

    def at(self, T_view_frame: Float64[np.ndarray, "4 4"]) -> "_Hypothesis":
        """Return the same evidence for another pose."""
        return replace(self, T_view_frame=T_view_frame)

    def reprojected(self, camera: Camera, tolerance_px: float) -> float:
        """Return the share of its matches that lie within a tolerance of where the pose puts them."""
        T_frame_view = np.linalg.inv(self.T_view_frame)
        points = self.points_view @ T_frame_view[:3, :3].T + T_frame_view[:3, 3]
        pixels, z = working_camera(camera).project(torch.from_numpy(points))
        off_px = np.linalg.norm(pixels.numpy() - self.pixels, axis=1)
        return float(((off_px < tolerance_px) & (z.numpy() > 0)).mean())

    def in_world(self, trajectory: Trajectory) -> Float64[np.ndarray, "4 4"]:
        pose: np.ndarray = trajectory.pose(self.view.index).numpy() @ self.T_view_frame
        return pose


class OrbRelocaliser(Relocaliser):
    """Remembers views of tracked frames and recognises lost ones by them.

    The views with most clear matches suggest poses (perspective from points, with RANSAC). One is believed where enough
    matches, spread over the image, reproject where they were seen; where the frame measures the depths that the view
    says; and where no other remembered place explains the frame about as well. Generalised ICP between the two depth
    images refines it, where `small_gicp` is installed. The same frames give the same bits.
    """

    def __init__(self, seed: int = 0) -> None:
        self.memory = ViewMemory()
        self._seed = seed
        self._found: tuple[int, View] | None = None

    def remember(self, frame: Frame, trajectory: Trajectory) -> None:
        """Keep a frame that was taken from a new place, and has texture and depth."""
        surface = surface_of(frame)
        if not len(surface):
            return
        reach_m = float(np.median(surface[:, 2]))
        if self.memory.is_new(frame, reach_m, trajectory):
            features = detect(frame).with_points()
            if len(features) >= MIN_INLIERS:
                self.memory.add(View(frame.index, features, surface, reach_m), trajectory)

    def find(self, frame: Frame, trajectory: Trajectory) -> Relocalisation:
        """Recognise a frame, or say why it cannot be."""
        self._found = None
        features, surface = detect(frame), surface_of(frame)
        if not self.memory.views:
            return Relocalisation(None, "no view with texture and depth is remembered")
        if len(features) < MIN_INLIERS:
            return Relocalisation(None, f"{len(features)} corners in the image, {MIN_INLIERS} needed")
        if not len(surface):
            return Relocalisation(None, "no depth to verify a place by")
        cv2.setRNGSeed((self._seed + frame.index) % 2**31)
        tried = [self._suggest(view, features, frame.camera) for view in self._candidates(features)]
        sound = [h for h in tried if h.num_inliers >= MIN_INLIERS]
        if not sound:
            best = max(h.num_inliers for h in tried)
            return Relocalisation(None, f"no view matches (at best {best} points agree, {MIN_INLIERS} needed)")
        return self._judge(frame, surface, sound, trajectory)

    def agrees(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"], trajectory: Trajectory) -> bool:
        """Say whether the depths still agree at another pose of the frame that was found."""
        if self._found is None or self._found[0] != frame.index:
            return False
        view = self._found[1]
        pose = T_world_camera.detach().cpu().double().numpy()
        T_view_frame = np.linalg.inv(trajectory.pose(view.index).numpy()) @ pose
        return _is_seen(depth_agreement(frame, view.surface, T_view_frame))

    def _candidates(self, features: Features) -> list[View]:
        """Return the views with most clear matches among the strongest corners; of equal ones the later first."""
        votes = [len(match(features, view.features, strongest=True)) for view in self.memory.views]
        order = sorted(range(len(votes)), key=lambda i: (-votes[i], -i))
        return [self.memory.views[i] for i in order[:NUM_CANDIDATES]]

    def _suggest(self, view: View, features: Features, camera: Camera) -> _Hypothesis:
        """Return the pose that most matches with a view agree on; without one, with no inliers."""
        nothing = _Hypothesis(view, np.eye(4), np.empty((0, 3)), np.empty((0, 2)))
        pairs = match(features, view.features)
        if len(pairs) < MIN_INLIERS:
            return nothing
        working = working_camera(camera)
        matrix = working.K(torch.float64).numpy()
        points = view.features.points_camera[pairs[:, 1]].astype(np.float64)
        pixels = features.pixels[pairs[:, 0]].astype(np.float64)
        is_found, rotation, translation, inliers = cv2.solvePnPRansac(
            points,
            pixels,
            matrix,
            None,
            iterationsCount=ITERATIONS,
            reprojectionError=REPROJECTION_PX,
            confidence=0.9999,
            flags=cv2.SOLVEPNP_EPNP,
        )
        if not is_found or inliers is None:
            return nothing
        rows = inliers[:, 0]
        if len(rows) < MIN_INLIERS:
            return _Hypothesis(view, np.eye(4), points[rows], pixels[rows])
        if len(rows) < MIN_INLIER_SHARE * len(pairs) or pixels[rows].std(0).min() < MIN_SPREAD * working.width:
            return nothing
        rotation, translation = cv2.solvePnPRefineLM(points[rows], pixels[rows], matrix, None, rotation, translation)
        T_frame_view = np.eye(4)
        T_frame_view[:3, :3], T_frame_view[:3, 3] = cv2.Rodrigues(rotation)[0], translation[:, 0]
        return _Hypothesis(view, np.linalg.inv(T_frame_view), points[rows], pixels[rows])

    def _judge(
        self, frame: Frame, surface: Float32[np.ndarray, "m 3"], sound: list[_Hypothesis], trajectory: Trajectory
    ) -> Relocalisation:
        """Return the best of the poses whose depths agree, unless another place explains the frame as well."""
        seen = [h for h in sound if _is_seen(depth_agreement(frame, h.view.surface, h.T_view_frame))]
        if not seen:
            return Relocalisation(None, f"{len(sound)} views match, but their depths disagree")
        best = max(seen, key=lambda h: h.num_inliers)
        pose = best.in_world(trajectory)
        for other in seen:
            if other.num_inliers >= RIVAL * best.num_inliers and not _is_same(other.in_world(trajectory), pose):
                return Relocalisation(
                    None, f"frames {best.view.index} and {other.view.index} show two places that look alike"
                )
        best = _refine(best, frame, surface)
        self._found = frame.index, best.view
        reason = f"frame {best.view.index} ({best.num_inliers} points agree)"
        return Relocalisation(torch.from_numpy(best.in_world(trajectory)), reason)

    def state_dict(self) -> dict[str, Tensor]:
        """Return the remembered views."""
        return self.memory.state_dict()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take over what `state_dict` returned."""
        self.memory.load_state_dict(state)


def depth_agreement(
    frame: Frame, surface: Float32[np.ndarray, "m 3"], T_view_frame: Float64[np.ndarray, "4 4"]
) -> tuple[float, float]:
    """Return which share of a view's surface the frame measures in its place, and of what it does not see through.

    A point of the view that the frame sees something nearer than may be hidden, and says nothing; one that lies before
    what the frame measured is contradicted.
    """
    if frame.depth is None or not len(surface):
        return 0.0, 0.0
    z, measured = _depths_at(frame, surface, T_view_frame)
    tolerance = 0.02 + 0.03 * measured
    agreeing = int((np.abs(z - measured) <= tolerance).sum())
    contradicted = int((z < measured - tolerance).sum())
    return agreeing / len(surface), agreeing / max(1, agreeing + contradicted)


def _depths_at(
    frame: Frame, surface: Float32[np.ndarray, "m 3"], T_view_frame: Float64[np.ndarray, "4 4"]
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Return the depths [m] that a view's points have in a frame, and those measured there; others are left out."""
    assert frame.depth is not None, "who asks has made sure"
    T_frame_view = np.linalg.inv(T_view_frame)
    points = surface.astype(np.float64) @ T_frame_view[:3, :3].T + T_frame_view[:3, 3]
    pixels, z = frame.camera.project(torch.from_numpy(points))
    u, v = pixels.round().unbind(-1)
    inside = (z > 0) & (u >= 0) & (v >= 0) & (u < frame.camera.width) & (v < frame.camera.height)
    measured = frame.depth.cpu().double()[v[inside].long(), u[inside].long()]
    return z[inside][measured > 0].numpy(), measured[measured > 0].numpy()


def _is_seen(found: tuple[float, float]) -> bool:
    overlap, agreement = found
    return overlap >= MIN_OVERLAP and agreement >= MIN_AGREEMENT


def _is_same(T_world_a: Float64[np.ndarray, "4 4"], T_world_b: Float64[np.ndarray, "4 4"]) -> bool:
    T_a_b = np.linalg.inv(T_world_a) @ T_world_b
    turn_rad = math.acos(min(1.0, max(-1.0, (float(np.trace(T_a_b[:3, :3])) - 1) / 2)))
    return float(np.linalg.norm(T_a_b[:3, 3])) < SAME_M and turn_rad < SAME_RAD


def _refine(found: _Hypothesis, frame: Frame, surface: Float32[np.ndarray, "m 3"]) -> _Hypothesis:
    """Register the frame's surface to the view's; where ICP is missing or not to be believed, the pose stays."""
    try:
        maps = GaussianMaps(ICP_VOXELS_M, num_neighbours=10)
    except MissingExtraError:
        log.debug("small_gicp is not installed: the pose is refined by the tracker alone")
        return found
    maps.insert(found.view.surface, maps.cloud(found.view.surface), np.eye(4))
    cloud = maps.cloud(surface)
    result = maps.register(cloud, found.T_view_frame, coarse=True, max_iterations=30)
    pose = result.T_world_camera
    if not np.isfinite(pose).all() or not _is_same(pose, found.T_view_frame):
        return found
    refined = found.at(pose)
    if not _is_seen(depth_agreement(frame, found.view.surface, pose)):
        return found
    if refined.reprojected(frame.camera, 2 * REPROJECTION_PX) >= MIN_REPROJECTED:
        return refined
    is_determined = result.determination(cloud) >= MIN_DETERMINATION
    return refined if is_determined and _offset_m(refined, frame) <= NEARER * _offset_m(found, frame) else found


def _offset_m(found: _Hypothesis, frame: Frame) -> float:
    """Return how far the frame's depths are from the view's, the median."""
    z, measured = _depths_at(frame, found.view.surface, found.T_view_frame)
    return float(np.median(np.abs(z - measured))) if len(z) else math.inf
