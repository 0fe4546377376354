"""Depth in the files that recordings have: 16-bit PNG, NPY, OpenEXR."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from xrdslam.core.errors import DataError
from xrdslam.datasets.exr import probe_exr, read_exr_depth
from xrdslam.datasets.images import COPY_AGAIN, probe_depth, read_depth

__all__ = ["DEPTH_SUFFIXES", "probe_any_depth", "read_any_depth"]

DEPTH_SUFFIXES = (".png", ".npy", ".exr")


def probe_any_depth(path: Path) -> tuple[int, int]:
    """Return width, height [px] without decoding; DataError where the file is missing, cut or of another kind."""
    if path.suffix == ".npy":
        return _load(path).shape[1::-1]
    return probe_exr(path) if path.suffix == ".exr" else probe_depth(path).size


def read_any_depth(path: Path, scale: float, invalid: Sequence[int] = ()) -> Float32[np.ndarray, "h w"]:
    """Read depth [m]: floats are metres, integers levels of which `scale` are a metre."""
    if path.suffix == ".exr":
        return read_exr_depth(path)
    if path.suffix == ".png":
        return read_depth(path, scale, invalid)
    values = np.array(_load(path))
    if values.dtype.kind == "f":
        return values.astype(np.float32)
    values = np.where(np.isin(values, invalid), 0, values)
    return np.asarray(values / np.float32(scale), dtype=np.float32)


def _load(path: Path) -> np.ndarray:
    """Map an array into memory: what is missing at its end is noticed."""
    if not path.is_file():
        raise DataError(f"{path}: no such file; complete the folder, or skip the frame with dataset.on_error=skip")
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise DataError(f"{path}: damaged NPY ({error}); {COPY_AGAIN}") from error
    if not isinstance(values, np.ndarray) or values.ndim != 2 or values.dtype.kind not in "fui":
        kind = f"{values.dtype} of {values.shape}" if isinstance(values, np.ndarray) else type(values).__name__
        raise DataError(f"{path}: depth is a 2-D array of numbers, found {kind}; convert it")
    return values
