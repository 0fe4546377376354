"""What ROS messages hold: the time of a header, images in their encodings, depth, a camera."""

import struct
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from xrdslam.core.errors import DataError
from xrdslam.datasets.source import Lens
from xrdslam.datasets.times import NS_PER_S

__all__ = ["camera_info", "decode_depth", "decode_rgb", "header_time_ns"]

COLOUR = {  # encoding: channels, OpenCV's conversion to RGB
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8UC1": (1, cv2.COLOR_GRAY2RGB),
    "8UC3": (3, cv2.COLOR_BGR2RGB),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUYV),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUYV),
}
DEPTH: dict[str, np.dtype[Any]] = {"16UC1": np.dtype("u2"), "mono16": np.dtype("u2"), "32FC1": np.dtype("f4")}
DEPTH_HEADER = struct.Struct("<iff")  # of compressedDepth: what it is, and two numbers for floats
PINHOLE = ("plumb_bob", "rational_polynomial", "")
REMEDY = "record it again, or skip the frame with dataset.on_error=skip"


def header_time_ns(raw: bytes, is_ros2: bool, fallback_ns: int) -> int:
    """Return the stamp of a serialised message that begins with a header, `fallback_ns` where it was not set."""
    if is_ros2:
        order = "<" if raw[1] & 1 else ">"
        seconds, nanoseconds = struct.unpack_from(f"{order}iI", raw, 4)
    else:
        seconds, nanoseconds = struct.unpack_from("<II", raw, 4)
    return seconds * NS_PER_S + nanoseconds or fallback_ns


def decode_rgb(message: Any, source: str) -> UInt8[np.ndarray, "h w 3"]:  # noqa: ANN401  # classes made at run time
    """Return an Image or CompressedImage, red first."""
    if not hasattr(message, "encoding"):
        bgr = cv2.imdecode(np.asarray(message.data, dtype=np.uint8), cv2.IMREAD_COLOR)
        if bgr is None:
            raise DataError(f"{source}: damaged {message.format!r}, {len(message.data)} bytes do not decode; {REMEDY}")
        return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))
    if message.encoding not in COLOUR:
        raise DataError(f"{source}: encoding {message.encoding!r}; colour is read as {', '.join(COLOUR)}")
    channels, conversion = COLOUR[message.encoding]
    pixels = _pixels(message, np.dtype("u1"), channels, source)
    image = pixels if channels > 1 else pixels[..., 0]
    return image if conversion is None else np.asarray(cv2.cvtColor(np.ascontiguousarray(image), conversion))


def decode_depth(message: Any, scale: float, source: str) -> Float32[np.ndarray, "h w"]:  # noqa: ANN401
    """Return depth [m] of an Image (16UC1: levels of which `scale` are a metre, 32FC1: metres) or compressedDepth."""
    if not hasattr(message, "encoding"):
        return _decode_compressed(message, scale, source)
    if message.encoding not in DEPTH:
        raise DataError(f"{source}: encoding {message.encoding!r}; depth is read as {', '.join(DEPTH)}")
    values = _pixels(message, DEPTH[message.encoding], 1, source)[..., 0]
    return np.asarray(values if values.dtype.kind == "f" else values / np.float32(scale), dtype=np.float32)


def _decode_compressed(message: Any, scale: float, source: str) -> np.ndarray:  # noqa: ANN401
    """Decode what compressed_depth_image_transport writes; floats are quantised as d = a / (level - b)."""
    data = np.asarray(message.data, dtype=np.uint8)
    has_header = "compressedDepth" in message.format
    levels = cv2.imdecode(data[DEPTH_HEADER.size if has_header else 0 :], cv2.IMREAD_UNCHANGED) if len(data) else None
    if levels is None or levels.ndim != 2 or levels.dtype != np.uint16:
        raise DataError(f"{source}: {message.format!r} is no 16-bit PNG of depth, or damaged; {REMEDY}")
    if not message.format.startswith("32FC1"):
        return np.asarray(levels / np.float32(scale), dtype=np.float32)
    _, a, b = DEPTH_HEADER.unpack(data[: DEPTH_HEADER.size].tobytes())
    with np.errstate(divide="ignore"):
        return np.where(levels > 0, a / (levels - np.float32(b)), 0).astype(np.float32)


def camera_info(message: Any, source: str, is_rectified: bool) -> Lens:  # noqa: ANN401
    """Return the lens and size of a CameraInfo; a rectified image has no distortion left."""
    K = np.asarray(getattr(message, "k", None) if hasattr(message, "k") else message.K, dtype=np.float64)
    D = np.asarray(getattr(message, "d", None) if hasattr(message, "d") else message.D, dtype=np.float64)
    distortion = () if is_rectified or not D.any() else tuple(D.tolist())
    if distortion and message.distortion_model not in PINHOLE:
        raise DataError(
            f"{source}: distortion_model {message.distortion_model!r}; only a pinhole's ({', '.join(PINHOLE[:2])}) is"
            " undone here: record the rectified images"
        )
    if min(K[0], K[4]) <= 0:
        raise DataError(f"{source}: fx {K[0]}, fy {K[4]}: the camera was not calibrated; set dataset.intrinsics=[...]")
    return Lens(
        (float(K[0]), float(K[4]), float(K[2]), float(K[5])),
        distortion,
        source,
        (int(message.width), int(message.height)),
    )


def _pixels(message: Any, dtype: np.dtype[Any], channels: int, source: str) -> np.ndarray:  # noqa: ANN401
    """Return h x w x channels; rows may be padded, and of either byte order."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    row = width * channels * dtype.itemsize
    data = np.asarray(message.data, dtype=np.uint8)
    if len(data) < height * step or step < row:
        raise DataError(f"{source}: {len(data)} bytes, {height} rows of {step} are {height * step}; {REMEDY}")
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])
    order = dtype.newbyteorder(">" if message.is_bigendian and dtype.itemsize > 1 else "<")
    return rows.view(order).astype(dtype, copy=False).reshape(height, width, channels)
