"""What of a frame can be recognised: ORB corners, with their points where depth was measured."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float32, Int64, UInt8

from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame

__all__ = ["Features", "detect", "match", "working_camera"]

WIDTH = 640
"""Width [px] that images are brought to, so that corners and their errors mean the same at every size; no image is
made larger than twice: that would be larger corners of the same few pixels."""
NUM_FEATURES = 1000
STRONGEST = 400
"""Features that a first, quick comparison looks at."""
RATIO = 0.8
"""A match is clear where the second best is this much worse (Lowe's test): a texture that repeats has none."""


@dataclass(frozen=True)
class Features:
    """Corners, the strongest first; descriptors, pixels [px] of the working image, camera-frame points [m]."""

    descriptors: UInt8[np.ndarray, "n 32"]
    pixels: Float32[np.ndarray, "n 2"]
    points_camera: Float32[np.ndarray, "n 3"]
    """NaN where no depth was measured."""

    def __len__(self) -> int:
        return len(self.descriptors)

    def with_points(self) -> "Features":
        """Return those whose depth was measured."""
        known = np.isfinite(self.points_camera).all(1)
        return Features(self.descriptors[known], self.pixels[known], self.points_camera[known])


def working_camera(camera: Camera) -> Camera:
    """Return the camera of a frame's image at `WIDTH`, or at twice its size."""
    width = min(WIDTH, 2 * camera.width)
    return camera.resized(width, max(1, round(camera.height * width / camera.width)))


def detect(frame: Frame) -> Features:
    """Find ORB features (Rublee et al., ICCV 2011) of a frame; the same image gives the same bits."""
    camera = working_camera(frame.camera)
    grey = cv2.cvtColor((frame.rgb.cpu().clamp(0, 1) * 255).round().to(torch.uint8).numpy(), cv2.COLOR_RGB2GRAY)
    is_smaller = camera.width < frame.camera.width
    image = cv2.resize(
        grey, (camera.width, camera.height), interpolation=cv2.INTER_AREA if is_smaller else cv2.INTER_LINEAR
    )
    orb = cv2.ORB.create(nfeatures=NUM_FEATURES, fastThreshold=7)
    corners, descriptors = orb.detectAndCompute(image, None)
    if not corners:
        return Features(np.empty((0, 32), np.uint8), np.empty((0, 2), np.float32), np.empty((0, 3), np.float32))
    order = np.argsort([-corner.response for corner in corners], kind="stable")
    pixels = np.array([corner.pt for corner in corners], np.float32)[order]
    return Features(np.ascontiguousarray(descriptors[order]), pixels, _points(frame, camera, pixels))


def _points(frame: Frame, camera: Camera, pixels: Float32[np.ndarray, "n 2"]) -> Float32[np.ndarray, "n 3"]:
    """Return the points behind pixels of the working image, by the depth of the nearest pixel of the frame."""
    if frame.depth is None:
        return np.full((len(pixels), 3), np.nan, np.float32)
    scale = np.array([frame.camera.width / camera.width, frame.camera.height / camera.height])
    nearest = np.rint((pixels + 0.5) * scale - 0.5).astype(np.int64)
    u, v = (np.clip(nearest[:, k], 0, n - 1) for k, n in enumerate((frame.camera.width, frame.camera.height)))
    depth = frame.depth.cpu()[torch.from_numpy(v), torch.from_numpy(u)]
    points = camera.unproject(torch.from_numpy(pixels), depth).numpy()
    points[~(depth > 0).numpy()] = np.nan
    return points


def match(query: Features, train: Features, strongest: bool = False) -> Int64[np.ndarray, "n 2"]:
    """Return pairs (query's row, train's row) that pass the ratio test and are each other's best."""
    count = STRONGEST if strongest else NUM_FEATURES
    ours, theirs = query.descriptors[:count], train.descriptors[:count]
    if len(ours) < 2 or len(theirs) < 2:
        return np.empty((0, 2), np.int64)
    distances, nearest = cv2.batchDistance(ours, theirs, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=2)
    _, back = cv2.batchDistance(theirs, ours, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=1)
    rows = np.arange(len(ours))
    is_clear = distances[:, 0] < RATIO * distances[:, 1]
    is_mutual = back[nearest[:, 0], 0] == rows
    kept = rows[is_clear & is_mutual]
    return np.stack((kept, nearest[kept, 0]), 1)
