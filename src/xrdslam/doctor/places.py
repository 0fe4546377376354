"""Where runs read and write: folders, space, shared memory."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from xrdslam.core.errors import XrdslamError
from xrdslam.core.records import DatasetInfo
from xrdslam.core.registry import Registry
from xrdslam.datasets.synthetic.cache import user_cache_folder
from xrdslam.doctor.finding import Finding, fail, ok, warn

__all__ = ["cache_folder", "data", "run_folder", "shared_memory"]

GIB = 2**30
ROOM_GIB = 2.0
"""Below this a long run may fill the disk."""
SHARED_MEMORY = Path("/dev/shm")
SHARED_MIB = 16
"""Semaphores take little; libraries that hand arrays to other processes take more."""


def run_folder(folder: Path = Path("outputs")) -> Iterator[Finding]:
    """Report whether a run's folder can be made, and the space that there is."""
    where, refusal = _written(folder)
    name = "run folder"
    if refusal:
        yield fail(name, f"{folder.absolute()} cannot be written ({refusal})", "run elsewhere, or say run_dir=<folder>")
        return
    yield _room(name, folder.absolute(), where, "say run_dir=<folder> on another disk")


def cache_folder() -> Iterator[Finding]:
    """Report whether rendered frames can be kept."""
    folder = user_cache_folder()
    where, refusal = _written(folder)
    name = "cache folder"
    if refusal:
        yield warn(
            name,
            f"{folder} cannot be written ({refusal}): synthetic rooms are rendered again in every run",
            "set XRDSLAM_CACHE to a folder that can",
        )
        return
    yield _room(name, folder, where, "set XRDSLAM_CACHE to a folder on another disk")


def _written(folder: Path) -> tuple[Path, str]:
    """Try to write where a folder is or would be made; return that place, and why it was refused."""
    where = folder.absolute()
    while not where.exists() and where != where.parent:
        where = where.parent
    try:
        with tempfile.TemporaryFile(dir=where) as file:
            file.write(b"\0" * 4096)
            file.flush()
    except OSError as error:
        return where, error.strerror or str(error)
    return where, ""


def _room(name: str, folder: Path, where: Path, advice: str) -> Finding:
    free = shutil.disk_usage(where).free / GIB
    found = f"{folder} can be written, {free:.1f} GiB free"
    return warn(name, found, f"free space, or {advice}") if free < ROOM_GIB else ok(name, found)


def shared_memory() -> Iterator[Finding]:
    """Report what processes of a run need in common: anonymous memory, and named semaphores in /dev/shm."""
    name, instead = "shared memory", "engine=multiprocess cannot work; use engine=sequential (the default)"
    if not hasattr(os, "memfd_create"):
        yield warn(name, "this system has no memfd_create", instead)
        return
    try:
        import multiprocessing

        multiprocessing.get_context("spawn").Semaphore()
        free = shutil.disk_usage(SHARED_MEMORY).free / 2**20
    except OSError as error:
        yield warn(name, f"{SHARED_MEMORY} gives no semaphore ({error})", instead)
        return
    found = f"{SHARED_MEMORY} has {free:.0f} MiB free"
    if free < SHARED_MIB:
        yield warn(name, found, f"engine=multiprocess and launchers want {SHARED_MIB} (docker run --shm-size=1g)")
    else:
        yield ok(name, found)


def data(registry: Registry) -> Iterator[Finding]:
    """Report which families' scenes lie where they are looked for."""
    found: list[str] = []
    absent: list[str] = []
    for family, info in registry.all(DatasetInfo).items():
        try:
            config = info.load_config()
        except XrdslamError:
            continue  # it is reported with its plugin
        root = getattr(config, "root", "")
        if root in ("", ".", "data"):
            continue  # no scenes of known names
        (found if Path(root).is_dir() else absent).append(f"{family} in {root}")
    yield ok("data", f"found: {', '.join(found) or 'no folder of scenes'}; synthetic rooms need none")
    if absent:
        yield ok("data elsewhere", f"not found, say dataset.root=<folder>: {', '.join(absent)}")
