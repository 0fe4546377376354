"""Files from the network: continued where they stopped, checked, unpacked nowhere but into their own folder."""

import hashlib
import logging
import shutil
import stat
import tarfile
import time
import urllib.error
import urllib.request
import zipfile
from collections.abc import Callable
from http.client import HTTPException, HTTPResponse
from pathlib import Path, PurePosixPath

from xrdslam.core.errors import DataError

__all__ = ["fetch", "unpack"]

log = logging.getLogger(__name__)

BLOCK = 1 << 20
ATTEMPTS = 5
TIMEOUT_S = 30.0
WAIT_S = 1.0
RANGE_NOT_SATISFIABLE = 416
NETWORK = (urllib.error.URLError, HTTPException, TimeoutError, ConnectionError)

Progress = Callable[[int, int | None], None]
"""Told the bytes that are there, and of how many if that is known."""


def fetch(
    url: str, path: Path, sha256: str | None = None, progress: Progress | None = None, wait_s: float = WAIT_S
) -> Path:
    """Download a file and return its path; what an earlier attempt left in `<path>.part` is continued.

    The server's ETag or date goes with the request (If-Range), so that a file which changed there is begun anew. A
    connection that fails is tried again after `wait_s`, doubled each time; a hash that differs removes the file.
    """
    if path.is_file():
        _check_hash(path, sha256, url)
        return path
    part = path.with_name(path.name + ".part")
    path.parent.mkdir(parents=True, exist_ok=True)
    for attempt in range(ATTEMPTS):
        try:
            _continue(url, part, progress)
            break
        except NETWORK as error:
            reason = getattr(error, "reason", None) or str(error) or type(error).__name__
            permanent = isinstance(error, urllib.error.HTTPError) and error.code < 500
            if permanent or attempt == ATTEMPTS - 1:
                have = part.stat().st_size if part.exists() else 0
                raise DataError(
                    f"{url}: cannot be downloaded ({reason}); {have} bytes are kept in {part}, the same command"
                    f" continues there. Or download it by hand to {path}"
                ) from error
            log.warning("%s: %s; trying again in %.0f s", url, reason, wait_s)
            time.sleep(wait_s)
            wait_s *= 2
    _check_hash(part, sha256, url)
    part.replace(path)
    _validator(part).unlink(missing_ok=True)
    return path


def unpack(archive: Path, folder: Path) -> Path:
    """Unpack a .zip or .tar[.gz] into a folder that appears when all of it is there; archives inside are unpacked too.

    Members that would land outside the folder (absolute, with .., through links) are refused, all before the first is
    written. Where everything lies in one folder of the archive that is called as `folder`, that level is left out.
    """
    if folder.exists() and any(folder.iterdir()):
        raise DataError(f"{folder}: exists and is not empty; remove it, or choose another dataset.root")
    part = folder.with_name(f".{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        _unpack_into(archive, part)
        for inner in sorted(part.rglob("*.zip")):
            _unpack_into(inner, inner.parent)
            inner.unlink()
        inside = part / folder.name
        kept = inside if inside.is_dir() and len(list(part.iterdir())) == 1 else part
        if folder.exists():
            folder.rmdir()
        kept.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return folder


def _continue(url: str, part: Path, progress: Progress | None) -> None:
    """Append what is missing to a partial file, or begin anew where the server cannot or the file there changed."""
    have = part.stat().st_size if part.exists() else 0
    headers = {"User-Agent": "xrdslam"}
    validator = _validator(part)
    if have and validator.is_file():
        headers |= {"Range": f"bytes={have}-", "If-Range": validator.read_text()}
    else:
        have = 0
    try:
        response = urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=TIMEOUT_S)
    except urllib.error.HTTPError as error:
        total = (error.headers.get("Content-Range") or "").rpartition("/")[2]
        error.close()
        if error.code == RANGE_NOT_SATISFIABLE and total == str(have):
            return  # it was all there
        if error.code == RANGE_NOT_SATISFIABLE:
            part.unlink()
            return _continue(url, part, progress)
        raise
    with response:
        _append(response, part, have if response.status == 206 else 0, progress)


def _append(response: HTTPResponse, part: Path, have: int, progress: Progress | None) -> None:
    tag = response.headers.get("ETag") or response.headers.get("Last-Modified")
    if tag and not tag.startswith("W/"):
        _validator(part).write_text(tag)
    else:
        _validator(part).unlink(missing_ok=True)
    length = response.headers.get("Content-Length")
    total = None if length is None else have + int(length)
    room = shutil.disk_usage(part.parent).free
    if total is not None and total - have > room:
        raise DataError(f"{part}: {(total - have) / 1e9:.1f} GB are missing, {room / 1e9:.1f} GB are free; make room")
    with part.open("r+b" if have else "wb") as file:
        file.seek(have)
        file.truncate()
        while block := response.read(BLOCK):
            file.write(block)
            have += len(block)
            if progress is not None:
                progress(have, total)
    if total is not None and have != total:
        raise ConnectionError(f"the connection ended after {have} of {total} bytes")


def _validator(part: Path) -> Path:
    return part.with_name(part.name + ".tag")


def _check_hash(path: Path, sha256: str | None, url: str) -> None:
    if sha256 is None:
        return
    with path.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    if found != sha256:
        path.unlink()
        _validator(path).unlink(missing_ok=True)
        raise DataError(
            f"{url}: the file has SHA-256 {found}, published is {sha256}; it was removed. Try again: if that gives the"
            " same, the file was replaced there"
        )


def _unpack_into(archive: Path, folder: Path) -> None:
    try:
        if zipfile.is_zipfile(archive):
            _unzip(archive, folder)
        elif tarfile.is_tarfile(archive):
            with tarfile.open(archive) as file:
                for member in file.getmembers():
                    tarfile.data_filter(
                        member, str(folder)
                    )  # raises for the first that leads out, before any is written
                file.extractall(folder, filter="data")
        else:
            raise DataError(f"{archive}: neither a zip nor a tar archive; remove it and download it again")
    except (tarfile.TarError, zipfile.BadZipFile, EOFError, OSError) as error:
        raise DataError(f"{archive}: cannot be unpacked ({error}); remove it and download it again") from error


def _unzip(archive: Path, folder: Path) -> None:
    with zipfile.ZipFile(archive) as file:
        for member in file.infolist():
            path = PurePosixPath(member.filename)
            is_link = stat.S_ISLNK(member.external_attr >> 16)
            if path.is_absolute() or ".." in path.parts or "\\" in member.filename or ":" in path.parts[0] or is_link:
                raise DataError(
                    f"{archive}: holds {member.filename!r}, which leads out of its folder; nothing was unpacked"
                )
        file.extractall(folder)
