"""Which family a path is of, seen by what lies there."""

from collections.abc import Callable
from pathlib import Path

from xrdslam.core.errors import DataError
from xrdslam.datasets.naming import natural_key

__all__ = ["guess_family"]

VIDEOS = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v")
BAGS = (".bag", ".db3", ".mcap")
IMAGES = (".png", ".jpg", ".jpeg")
MOST_NAMES = 15


def guess_family(path: Path) -> str:
    """Return the family whose files lie at a path; a DataError says what was looked for and what there is."""
    if not path.exists():
        raise DataError(f"{path}: no such file or folder")
    if path.is_file():
        return _of_file(path)
    for family, is_meant in FOLDERS.items():
        if is_meant(path):
            return family
    inside = [child for child in sorted(path.iterdir(), key=lambda p: natural_key(p.name)) if _known(child)]
    if inside:
        names = ", ".join(str(child) for child in inside[:MOST_NAMES])
        raise DataError(f"{path}: is no recording itself, but holds {len(inside)}; inspect one of {names}")
    names = ", ".join(sorted(child.name for child in path.iterdir())[:MOST_NAMES]) or "nothing"
    raise DataError(
        f"{path}: no layout that is known ({', '.join(FOLDERS)}) and no images. There is: {names}. If it is a folder of"
        " images under other names, say so: --family rgbd_folder rgb=<folder> depth=<folder>"
    )


def _of_file(path: Path) -> str:
    suffix = path.suffix.lower()
    family = (
        "video" if suffix in VIDEOS else "rosbag" if suffix in BAGS else "transforms" if suffix == ".json" else None
    )
    if family is None:
        known = ", ".join((*VIDEOS, *BAGS, ".json"))
        raise DataError(f"{path}: a file that is none of {known}; give the folder of the recording")
    return family


def _known(path: Path) -> bool:
    if path.is_file():
        return path.suffix.lower() in (*VIDEOS, *BAGS)
    return path.is_dir() and any(is_meant(path) for is_meant in FOLDERS.values())


def _has(*names: str) -> Callable[[Path], bool]:
    return lambda folder: all((folder / name).exists() for name in names)


def _bags(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.suffix in BAGS]


def _is_euroc(folder: Path) -> bool:
    return any((folder / part / "cam0" / "data.csv").is_file() for part in ("mav0", "."))


def _is_scannet(folder: Path) -> bool:
    inner = folder / "frames" if (folder / "frames").is_dir() else folder
    return (inner / "color").is_dir() and (inner / "intrinsic").is_dir()


def _is_seven_scenes(folder: Path) -> bool:
    places = (folder, *sorted(folder.glob("seq-*")))
    return any(next(place.glob("frame-*.color.*"), None) is not None for place in places)


def _is_co_fusion(folder: Path) -> bool:
    return (folder / "colour").is_dir() and any((folder / f"depth_{kind}").is_dir() for kind in ("noise", "original"))


def _has_images(folder: Path) -> bool:
    places = (folder, *(child for child in sorted(folder.iterdir()) if child.is_dir()))
    return any(path.suffix.lower() in IMAGES for place in places for path in place.iterdir())


FOLDERS: dict[str, Callable[[Path], bool]] = {  # in this order: the last takes any images
    "rosbag": lambda folder: (folder / "metadata.yaml").is_file() and any(_bags(folder)),
    "transforms": _has("transforms.json"),
    "tum_rgbd": _has("rgb.txt", "depth.txt"),
    "replica": _has("traj.txt", "results"),
    "euroc": _is_euroc,
    "scannet": _is_scannet,
    "co_fusion": _is_co_fusion,
    "seven_scenes": _is_seven_scenes,
    "rgbd_folder": _has_images,
}
