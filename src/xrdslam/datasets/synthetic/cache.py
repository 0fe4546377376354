"""Arrays kept on disk under the hash of what they were computed from.

A file is a digest and the arrays it vouches for. It is written beside its place and moved there, so that readers see a
whole file or none; a file that does not match its digest counts as absent.
"""

import hashlib
import io
import logging
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from xrdslam.core.files import write_bytes

__all__ = ["ArrayCache", "content_key", "user_cache_folder"]

log = logging.getLogger(__name__)
DIGEST = 16


def user_cache_folder() -> Path:
    """Return XRDSLAM_CACHE, or the platform's folder for data that may be thrown away."""
    chosen = os.environ.get("XRDSLAM_CACHE")
    if chosen:
        return Path(chosen).expanduser()
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "xrdslam" / "Cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "xrdslam"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "xrdslam"


def content_key(*parts: object) -> str:
    """Return the hash of arrays (by their bytes) and plain values (by their repr)."""
    state = hashlib.blake2b(digest_size=DIGEST)
    for part in parts:
        if isinstance(part, np.ndarray):
            state.update(repr((part.dtype.str, part.shape)).encode())
            state.update(np.ascontiguousarray(part).tobytes())
        else:
            state.update(repr(part).encode())
        state.update(b"|")
    return state.hexdigest()


class ArrayCache:
    """Arrays by key in a folder; `None` for a folder keeps nothing."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder

    def get(self, key: str) -> dict[str, Any] | None:
        """Return the arrays stored under a key; None where there is no sound file."""
        if self.folder is None:
            return None
        try:
            data = self._path(key).read_bytes()
        except OSError:
            return None
        if hashlib.blake2b(data[DIGEST:], digest_size=DIGEST).digest() != data[:DIGEST]:
            log.warning("%s is damaged and will be written anew", self._path(key))
            return None
        with np.load(io.BytesIO(data[DIGEST:]), allow_pickle=False) as arrays:
            return dict(arrays)

    def put(self, key: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Store arrays; a folder that cannot be written is said once, and nothing is kept from then on."""
        if self.folder is None:
            return
        stream = io.BytesIO()
        np.savez(stream, allow_pickle=False, **arrays)
        payload = stream.getvalue()
        try:
            write_bytes(self._path(key), hashlib.blake2b(payload, digest_size=DIGEST).digest() + payload)
        except OSError as error:
            log.warning("nothing is cached: %s; set XRDSLAM_CACHE to a folder that can be written", error)
            self.folder = None

    def _path(self, key: str) -> Path:
        assert self.folder is not None
        return self.folder / key[:2] / f"{key}.cache"
