"""The camera of files: what the command line says, else what the data says, with where it was said."""

import logging
from typing import NamedTuple

from xrdslam.core.camera import Camera
from xrdslam.core.errors import DataError
from xrdslam.datasets.config import FilesConfig
from xrdslam.datasets.sequence import SourceCamera

__all__ = ["Lens", "stated_lens"]

log = logging.getLogger(__name__)


class Lens(NamedTuple):
    """Intrinsics without a size: fx, fy, cx, cy [px] and OpenCV's distortion, and where that was stated."""

    intrinsics: tuple[float, float, float, float]
    distortion: tuple[float, ...] = ()
    stated_in: str = ""
    size: tuple[int, int] | None = None

    def source(
        self,
        size: tuple[int, int],
        config: FilesConfig,
        depth_scale: float,
        depth_size: tuple[int, int] | None = None,
        invalid: tuple[int, ...] = (),
    ) -> SourceCamera:
        """Return the camera of files of a size; a principal point outside the image is one of another size."""
        camera = self._camera(size)
        if not (0 < camera.cx < size[0] and 0 < camera.cy < size[1]):
            raise DataError(
                f"{self.stated_in}: the principal point ({camera.cx:g}, {camera.cy:g}) is outside the images of"
                f" {size[0]}x{size[1]} px; give the intrinsics of these images: all four scale with the size"
            )
        return SourceCamera(
            camera,
            self.stated_in,
            depth_scale=config.depth_scale or depth_scale,
            invalid_depth=(*invalid, *config.invalid_depth),
            depth_size=depth_size,
        )

    def _camera(self, size: tuple[int, int]) -> Camera:
        """Return the camera of images of a size; intrinsics stated for another one of the same shape are scaled."""
        width, height = self.size or size
        try:
            camera = Camera(*self.intrinsics, width, height, self.distortion)
        except DataError as error:
            raise DataError(f"{self.stated_in}: {error}") from error
        if (width, height) == size:
            return camera
        if abs(width * size[1] - height * size[0]) > max(width, height, *size):
            raise DataError(
                f"{self.stated_in}: is for {width}x{height} px, but the images have {size[0]}x{size[1]} px, which is"
                " another shape; give the intrinsics of these images"
            )
        log.info("%s: scaled from %dx%d px to the images' %dx%d px", self.stated_in, width, height, *size)
        return camera.resized(*size)


def stated_lens(config: FilesConfig, known: Lens | None, stated_in: str) -> Lens | None:
    """Return the lens that is set on the command line, else the one that is known, if any."""
    if config.intrinsics is not None:
        fx, fy, cx, cy = config.intrinsics
        return Lens((fx, fy, cx, cy), tuple(config.distortion), f"dataset.intrinsics={config.intrinsics}")
    if known is None:
        return None
    distortion = tuple(config.distortion) or known.distortion
    return Lens(known.intrinsics, distortion, stated_in, known.size)
