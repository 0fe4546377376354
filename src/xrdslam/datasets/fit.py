"""From a file's pixels to the frame's: undistortion, crop, size, greatest depth."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float32

from xrdslam.core.camera import Camera
from xrdslam.core.errors import ConfigError

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
        crop: Sequence[int] | None = None,
        rgb_size: tuple[int, int] | None = None,
    ) -> None:
        """Take the camera of the files, and the knobs.

        Sizes are (width, height) [px]; files of another size than the camera's are the same view, sampled otherwise.
        `crop` is what is cut off at the left, top, right, bottom [px of the camera]; `max_depth` is in metres.
        """
        self.rgb_size = rgb_size or (native.width, native.height)
        self.depth_size = depth_size or self.rgb_size
        self.max_depth = np.inf if max_depth is None else max_depth
        straight = native.undistorted()
        self._whole = (native.width, native.height)
        self._window = _window(straight, crop) if crop is not None and any(crop) else None
        kept = straight if self._window is None else straight.cropped(*self._window)
        self.camera = kept if size is None else kept.resized(*size)
        self._size = (self.camera.width, self.camera.height)
        self._rgb_maps = _undistort_maps(native, self.rgb_size)
        self._depth_maps = _undistort_maps(native, self.depth_size)

    def rectify(self, maps: Maps) -> None:
        """Take maps of the colour files in place of the lens's: those of a camera that was turned as well."""
        self._rgb_maps = maps

    def rgb(self, image: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h2 w2 3"]:
        """Fit a colour image."""
        if self._rgb_maps is not None:
            image = cv2.remap(image, *self._rgb_maps, cv2.INTER_LINEAR)
        if self._window is not None:
            image = self._cut(_resized_rgb(image, self._whole))
        return _resized_rgb(image, self._size)

    def depth(self, image: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h2 w2"]:
        """Fit a depth image; what is not finite, not positive or beyond `max_depth` becomes 0."""
        if self._depth_maps is not None:
            image = cv2.remap(image, *self._depth_maps, cv2.INTER_NEAREST)
        if self._window is not None:
            image = self._cut(_resized_depth(image, self._whole))
        image = _resized_depth(image, self._size)
        return np.where((image > 0) & (image <= self.max_depth) & (image < np.inf), image, np.float32(0))

    def _cut(self, image: np.ndarray) -> np.ndarray:
        assert self._window is not None, "only called where there is something to cut"
        left, top, width, height = self._window
        return np.ascontiguousarray(image[top : top + height, left : left + width])


def _resized_rgb(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    if image.shape[1::-1] == size:
        return image
    shrinks = size[0] <= image.shape[1] and size[1] <= image.shape[0]
    fitted = cv2.resize(image, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    return np.clip(fitted, 0.0, 1.0)  # weights that sum to one but for rounding reach 1 + 6e-8


def _resized_depth(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    if image.shape[1::-1] == size:
        return image
    # INTER_NEAREST takes pixel floor(u' s), half a pixel of the result off the half-pixel rule.
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST_EXACT))


def _window(camera: Camera, crop: Sequence[int]) -> tuple[int, int, int, int]:
    """Return the left, top, width, height that a crop leaves."""
    left, top, right, bottom = crop
    width, height = camera.width - left - right, camera.height - top - bottom
    if min(width, height) < 1:
        raise ConfigError(
            f"dataset.crop={list(crop)}: nothing is left of images of {camera.width}x{camera.height} px;"
            " it is [left, top, right, bottom], what is cut off at each edge in pixels"
        )
    return left, top, width, height


def _undistort_maps(native: Camera, size: tuple[int, int]) -> Maps | None:
    """Return the maps for files of a size, none where there is nothing to undistort."""
    return native.resized(*size).undistort_maps() if any(native.distortion) else None
