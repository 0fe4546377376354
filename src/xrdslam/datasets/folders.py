"""The folder of a scene: where it is, what it holds, and what there is instead."""

import difflib
import os
from pathlib import Path

from xrdslam.core.errors import DataError
from xrdslam.datasets.config import DatasetConfig

__all__ = ["dataset_name", "inside", "recording", "scene_folder", "subfolders"]


def scene_folder(config: DatasetConfig, *aliases: str) -> Path:
    """Return `dataset.path` if set, else `dataset.root`/`dataset.scene`; a DataError says what there is instead.

    `aliases` are other names that the scene's folder may have.
    """
    if config.path:
        folder = Path(config.path).expanduser()
        if not folder.is_dir():
            raise DataError(f"dataset.path={config.path}: no such folder{_nearby(folder)}")
        return folder
    root = Path(config.root).expanduser()
    if not root.is_dir():
        raise DataError(
            f"dataset.root={config.root}: no such folder to look for scene {config.scene!r} in; set dataset.root to the"
            " folder that holds the scenes, or dataset.path to the scene's own"
        )
    folder = root / config.scene
    for alias in aliases:
        if (root / alias).is_dir():
            return root / alias
    if not folder.is_dir():
        raise DataError(f"{folder}: no such scene{_nearby(folder)} Or set dataset.path to the scene's own folder")
    return folder


def recording(config: DatasetConfig, what: str) -> Path:
    """Return `dataset.path`, a file or a folder; a DataError says what it should be or what there is instead."""
    if not config.path:
        raise DataError(f"dataset={config.family}/{config.scene}: where is it? Set dataset.path=<{what}>")
    path = Path(config.path).expanduser()
    if not path.exists():
        raise DataError(f"dataset.path={config.path}: no such file or folder{_nearby(path, folders_only=False)}")
    return path


def inside(folder: Path, name: str, source: str) -> Path:
    """Return the path of a file that a list names; one that leads out of the folder is refused, naming `source`."""
    if os.path.isabs(name) or os.path.normpath(name).split(os.sep)[0] == "..":
        raise DataError(f"{source}: {name!r} leads out of {folder}; name files inside the folder")
    return folder / name


def dataset_name(config: DatasetConfig, folder: Path) -> str:
    """Return `<family>/<scene>`; a scene given by its path is called as its folder."""
    return f"{config.family}/{folder.resolve().name if config.path else config.scene}"


def subfolders(folder: Path) -> list[str]:
    """Return the names of the visible folders in a folder, sorted."""
    return sorted(p.name for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))


def _nearby(folder: Path, folders_only: bool = True) -> str:
    """Say what there is beside a folder that is missing."""
    parent = next(p for p in folder.absolute().parents if p.is_dir())
    names = subfolders(parent) if folders_only else sorted(p.name for p in parent.iterdir() if p.name[0] != ".")[:20]
    near = difflib.get_close_matches(folder.name, names, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ";"
    return f"{hint} In {parent} there is: {', '.join(names) if names else 'nothing'}."
