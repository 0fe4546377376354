"""From a file's pixels to the frame's: undistortion, size, greatest depth."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float32

from xrdslam.core.camera import Camera

__all__ = ["ImageFit"]

Maps = tuple[np.ndarray, np.ndarray]


class ImageFit:
    """Brings colour and depth, each at the size of its files, to one camera without distortion.

    Colour is averaged over the area when it shrinks and interpolated when it grows. Depth takes the value of the
    nearest pixel centre, never a mean: the mean of both sides of an edge is a surface that does not exist.
    """

    def __init__(
        self,
        native: Camera,
        size: Sequence[int] | None = None,
        depth_size: tuple[int, int] | None = None,
        max_depth: float | None = None,
    ) -> None:
        """Take the camera of the colour files, and the knobs: sizes are (width, height) [px], `max_depth` [m]."""
        self.rgb_size = (native.width, native.height)
        self.depth_size = depth_size or self.rgb_size
        self.max_depth = np.inf if max_depth is None else max_depth
        straight = native.undistorted()
        self.camera = straight if size is None else straight.resized(*size)
        self._size = (self.camera.width, self.camera.height)
        self._rgb_maps = _undistort_maps(native, self.rgb_size)
        self._depth_maps = _undistort_maps(native, self.depth_size)

    def rgb(self, image: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h2 w2 3"]:
        """Fit a colour image."""
        if self._rgb_maps is not None:
            image = cv2.remap(image, *self._rgb_maps, cv2.INTER_LINEAR)
        if image.shape[1::-1] == self._size:
            return image
        shrinks = self._size[0] <= image.shape[1] and self._size[1] <= image.shape[0]
        fitted = cv2.resize(image, self._size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
        return np.clip(fitted, 0.0, 1.0)  # weights that sum to one but for rounding reach 1 + 6e-8

    def depth(self, image: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h2 w2"]:
        """Fit a depth image; what is not finite, not positive or beyond `max_depth` becomes 0."""
        if self._depth_maps is not None:
            image = cv2.remap(image, *self._depth_maps, cv2.INTER_NEAREST)
        if image.shape[1::-1] != self._size:
            # INTER_NEAREST takes pixel floor(u' s), half a pixel of the result off the half-pixel rule.
            image = cv2.resize(image, self._size, interpolation=cv2.INTER_NEAREST_EXACT)
        return np.where((image > 0) & (image <= self.max_depth) & (image < np.inf), image, np.float32(0))


def _undistort_maps(native: Camera, size: tuple[int, int]) -> Maps | None:
    """Return the maps for files of a size, none where there is nothing to undistort."""
    return native.resized(*size).undistort_maps() if any(native.distortion) else None
