"""Image files of a sequence, read as arrays: colour in [0, 1], depth in metres, damage refused by name.

A decoder is not asked whether a file is whole: depending on its version it fills the missing part of a truncated file
with grey and reports success. The end marker is looked for in the bytes instead (IEND of a PNG, FFD9 of a JPEG), which
also makes a check of thousands of files cheap: `probe_image` reads a few kilobytes and decodes nothing.

What this cannot see: bits flipped inside a JPEG's entropy-coded data, which carries no checksum.
"""

import os
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal

import cv2
import numpy as np
from jaxtyping import Float32, UInt8, UInt16

from xrdslam.core.errors import DataError

__all__ = [
    "COPY_AGAIN",
    "ImageHeader",
    "first_size",
    "probe_depth",
    "probe_image",
    "probe_rgb",
    "read_depth",
    "read_rgb",
]

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
PNG_END = b"\x00\x00\x00\x00IEND\xaeB`\x82"  # length 0, type, CRC: the same 12 bytes in every PNG
PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}  # by colour type; a palette (3) decodes to colour
JPEG_SIGNATURE = b"\xff\xd8\xff"
JPEG_END = b"\xff\xd9"
START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # C4, C8, CC: tables, reserved, arithmetic coding
START_OF_SCAN = 0xDA
COPY_AGAIN = "copy it again from the original, or leave the frame out with dataset.on_error=skip"
UNIT_LEVELS = (np.arange(256) / 255).astype(np.float32)  # level / 255, correctly rounded: 255 maps to exactly 1


@dataclass(frozen=True)
class ImageHeader:
    """What the first bytes of an image file declare; `bits` counts one channel."""

    kind: Literal["png", "jpeg"]
    width: int
    height: int
    channels: int
    bits: int

    @property
    def size(self) -> tuple[int, int]:
        """Width, height [px]."""
        return self.width, self.height


def probe_image(path: Path) -> ImageHeader:
    """Read the header and look for the end marker, without decoding; refuse a missing, empty, cut or foreign file."""
    if path.exists() and not path.is_file():  # opening a pipe would wait for ever
        raise DataError(f"{path}: not a file and cannot be read; {COPY_AGAIN}")
    try:
        with path.open("rb") as file:
            signature = file.read(8)
            if signature == PNG_SIGNATURE:
                return _probe_png(path, file)
            if signature.startswith(JPEG_SIGNATURE):
                return _probe_jpeg(path, file)
    except OSError as error:
        raise _unreadable(path, error) from error
    raise DataError(_foreign(path, signature))


def first_size(images: Mapping[int, Path]) -> tuple[int, int]:
    """Return the width, height [px] of the first image that can be probed, by rising number."""
    faults = []
    for number in sorted(images):
        try:
            return probe_image(images[number]).size
        except DataError as error:
            faults.append(str(error))
    raise DataError(f"none of {len(faults)} images can be read; the first: {faults[0]}")


def probe_rgb(path: Path, may_be_grey: bool = False) -> ImageHeader:
    """Probe a colour image: three channels (or four, alpha is dropped) of 8 bits; or one, where it may be grey."""
    header = probe_image(path)
    if header.bits != 8 or header.channels not in ((1, 3, 4) if may_be_grey else (3, 4)):
        raise DataError(
            f"{path}: a colour image has 3 channels of 8 bits, this {header.kind} has {header.channels} of"
            f" {header.bits}; give the colour images, converted to 8-bit RGB"
        )
    return header


def probe_depth(path: Path) -> ImageHeader:
    """Probe a depth image: a PNG of one channel of 16 bits."""
    header = probe_image(path)
    if (header.kind, header.channels, header.bits) != ("png", 1, 16):
        raise DataError(
            f"{path}: a depth image is a PNG with 1 channel of 16 bits, this {header.kind} has {header.channels} of"
            f" {header.bits}; give the depth as it was recorded, not a preview of it"
        )
    return header


def read_rgb(path: Path, may_be_grey: bool = False) -> Float32[np.ndarray, "h w 3"]:
    """Read a colour image, red first, in [0, 1]; a grey one has three equal channels."""
    header = probe_rgb(path, may_be_grey)
    bgr: UInt8[np.ndarray, "h w 3"] = _decode(path, header.kind, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    rgb = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)
    return np.asarray(cv2.LUT(rgb, UNIT_LEVELS), dtype=np.float32)


def read_depth(path: Path, scale: float, invalid: Sequence[int] = ()) -> Float32[np.ndarray, "h w"]:
    """Read a 16-bit depth image in metres: level / scale [1/m], and 0 where nothing was measured.

    Level 0 is never a measurement; `invalid` names further levels that mean the same in a family (65535 in 7-Scenes).
    """
    header = probe_depth(path)
    levels: UInt16[np.ndarray, "h w"] = _decode(path, header.kind, cv2.IMREAD_UNCHANGED)
    for level in invalid:
        levels[levels == level] = 0
    return np.asarray(np.divide(levels, scale, dtype=np.float32))


def _decode(path: Path, kind: str, flags: int) -> np.ndarray:
    """Decode with OpenCV's flags."""
    try:
        data = np.fromfile(path, dtype=np.uint8)
    except OSError as error:
        raise _unreadable(path, error) from error
    image = cv2.imdecode(data, flags)
    if image is None:
        raise DataError(f"{path}: damaged {kind}, {data.size} bytes that do not decode; {COPY_AGAIN}")
    return np.asarray(image)


def _probe_png(path: Path, file: BinaryIO) -> ImageHeader:
    ihdr = file.read(18)
    if len(ihdr) < 18 or ihdr[4:8] != b"IHDR":
        raise DataError(_truncated(path, "png"))
    width, height, bits, colour = struct.unpack(">IIBB", ihdr[8:18])
    if _tail(file, len(PNG_END)) != PNG_END and not _png_chunks_end(file):
        raise DataError(_truncated(path, "png"))
    return ImageHeader("png", width, height, PNG_CHANNELS.get(colour, 0), 8 if colour == 3 else bits)


def _png_chunks_end(file: BinaryIO) -> bool:
    """Walk the chunks to IEND: for the whole file that has foreign bytes after its end."""
    file.seek(8)
    while len(head := file.read(8)) == 8:
        if head[4:] == b"IEND":
            return len(file.read(4)) == 4
        file.seek(struct.unpack(">I", head[:4])[0] + 4, os.SEEK_CUR)
    return False


def _probe_jpeg(path: Path, file: BinaryIO) -> ImageHeader:
    """Walk the marker segments: the frame header has the size, the entropy-coded data follows the scan header."""
    file.seek(2)
    header = None
    while len(head := file.read(4)) == 4 and head[0] == 0xFF:
        marker, length = head[1], int.from_bytes(head[2:], "big")
        if marker in START_OF_FRAME:
            bits, height, width, channels = struct.unpack(">BHHB", file.read(6).ljust(6, b"\0"))
            header = ImageHeader("jpeg", width, height, channels, bits)
            length -= 6
        if marker == START_OF_SCAN:
            break
        file.seek(length - 2, os.SEEK_CUR)
    start_of_scan = file.tell()
    # Inside entropy-coded data FF is followed by 00, so FFD9 after the scan header is the end and nothing else; before
    # it a thumbnail has one too. Cameras append to the file, hence the search when the last bytes are not the end.
    if header is None or not (_tail(file, 2) == JPEG_END or _holds(file, start_of_scan, JPEG_END)):
        raise DataError(_truncated(path, "jpeg"))
    return header


def _tail(file: BinaryIO, count: int) -> bytes:
    file.seek(-count, os.SEEK_END)
    return file.read(count)


def _holds(file: BinaryIO, start: int, marker: bytes) -> bool:
    file.seek(start)
    return marker in file.read()


def _truncated(path: Path, kind: str) -> str:
    return f"{path}: truncated {kind}, {path.stat().st_size} bytes without its end marker; {COPY_AGAIN}"


def _foreign(path: Path, signature: bytes) -> str:
    if not signature:
        return f"{path}: empty file; {COPY_AGAIN}"
    return f"{path}: neither PNG nor JPEG (it starts with {signature!r}); convert it to one of them"


def _unreadable(path: Path, error: OSError) -> DataError:
    found = "no such file" if isinstance(error, FileNotFoundError) else f"cannot be read ({error.strerror})"
    return DataError(f"{path}: {found}; complete the folder, or leave the frame out with dataset.on_error=skip")
