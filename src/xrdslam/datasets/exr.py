"""Depth in OpenEXR files: one channel of floats [m]. OpenCV's headless wheel reads none, so the extra `exr` does."""

import struct
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from xrdslam.core.errors import DataError, MissingExtraError
from xrdslam.datasets.images import COPY_AGAIN

__all__ = ["probe_exr", "read_exr_depth"]

SIGNATURE = b"\x76\x2f\x31\x01"
TILED_OR_PARTS = 0x200 | 0x1000  # flags in the version word
LINES_PER_BLOCK = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256)  # by the number of the compression
LONGEST_HEADER = 1 << 20


def probe_exr(path: Path) -> tuple[int, int]:
    """Return width, height [px] and look whether the last block of lines is there, without decoding."""
    if not path.is_file():
        raise DataError(f"{path}: no such file; complete the folder, or skip the frame with dataset.on_error=skip")
    with path.open("rb") as file:
        head = file.read(LONGEST_HEADER)
    if head[:4] != SIGNATURE:
        raise DataError(f"{path}: {f'no OpenEXR file (starts with {head[:8]!r})' if head else 'empty'}; {COPY_AGAIN}")
    try:
        attributes, end = _attributes(head)
        left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
        is_tiled = bool(struct.unpack_from("<I", head, 4)[0] & TILED_OR_PARTS)  # their damage shows in decoding only
        lines = LINES_PER_BLOCK[attributes["compression"][0]]
        blocks = -(-(bottom - top + 1) // lines)
        offsets = () if is_tiled else struct.unpack_from(f"<{blocks}Q", head, end)
    except (struct.error, ValueError, KeyError, IndexError) as error:
        raise DataError(f"{path}: truncated OpenEXR file, its header does not end; {COPY_AGAIN}") from error
    if offsets and not _block_is_whole(path, max(offsets)):
        raise DataError(f"{path}: truncated OpenEXR file, {path.stat().st_size} bytes; {COPY_AGAIN}")
    return right - left + 1, bottom - top + 1


def read_exr_depth(path: Path) -> Float32[np.ndarray, "h w"]:
    """Read the only channel of a file, or the one called Z, Y, R or V, whatever the float's width."""
    probe_exr(path)
    try:
        import OpenEXR
    except ImportError as error:
        raise MissingExtraError(
            f"{path}: OpenEXR files need the extra `exr`: pip install 'xrdslam[exr]' (the package OpenEXR)"
        ) from error
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels for name, channel in file.channels().items()}
    except Exception as error:  # OpenEXR raises RuntimeError and others, by version
        raise DataError(f"{path}: damaged OpenEXR file ({error}); {COPY_AGAIN}") from error
    name = next(iter(channels)) if len(channels) == 1 else next((c for c in "ZYRV" if c in channels), None)
    if name is None:
        raise DataError(f"{path}: depth is one channel (or Z, Y, R, V), found {', '.join(channels)}; convert it")
    return np.ascontiguousarray(channels[name], dtype=np.float32)


def _attributes(head: bytes) -> tuple[dict[str, bytes], int]:
    """Return the header's attributes by name, and where the table of offsets begins."""
    found: dict[str, bytes] = {}
    at = 8
    while head[at] != 0:
        name_end = head.index(b"\0", at)
        type_end = head.index(b"\0", name_end + 1)
        (size,) = struct.unpack_from("<I", head, type_end + 1)
        value = head[type_end + 5 : type_end + 5 + size]
        if len(value) < size:
            raise ValueError("an attribute is cut")
        found[head[at:name_end].decode("latin-1")] = value
        at = type_end + 5 + size
    return found, at + 1


def _block_is_whole(path: Path, offset: int) -> bool:
    with path.open("rb") as file:
        file.seek(offset)
        head = file.read(8)  # the block's first line, its size
        return len(head) == 8 and offset + 8 + struct.unpack("<iI", head)[1] <= path.stat().st_size
