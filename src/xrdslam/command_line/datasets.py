"""`python -m xrdslam.datasets`: what there is, what a recording holds, getting and converting it."""

import argparse
import dataclasses
import logging
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

from xrdslam.command_line.explain import in_one_line
from xrdslam.command_line.groups import options
from xrdslam.core.dataset import Dataset
from xrdslam.core.errors import ConfigError, DataError, XrdslamError
from xrdslam.core.records import DatasetInfo
from xrdslam.core.registry import installed

__all__ = ["main", "open_dataset"]

EXAMPLES = """\
examples
  python -m xrdslam.datasets list
  python -m xrdslam.datasets inspect my/recording
  python -m xrdslam.datasets inspect my/recording depth_scale=5000 pose_axes=opengl
  python -m xrdslam.datasets inspect clip.bag rgb_topic=/front/color/image_raw
  python -m xrdslam.datasets download tum_rgbd/fr1_desk
  python -m xrdslam.datasets convert clip.bag --to tum_rgbd --into data/clip

What stands behind a path are the settings of its family, as after `dataset.` on the command line of a run."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Do what the arguments say; what a user can mend is said in one line, exit status 1."""
    chosen = _parser().parse_args(arguments)
    logging.basicConfig(
        level=logging.INFO if getattr(chosen, "verbose", False) else logging.WARNING, format="%(message)s"
    )
    try:
        chosen.action(chosen)
    except (XrdslamError, OmegaConfBaseException) as error:
        sys.exit(f"xrdslam.datasets: {in_one_line(error)}")
    except KeyboardInterrupt:
        sys.exit(130)


def open_dataset(path: Path, family: str | None, settings: Sequence[str]) -> Dataset:
    """Open the recording at a path with `name=value` settings, as the family that is said or guessed."""
    from xrdslam.datasets.guess import guess_family

    family = family or guess_family(path)
    info = installed().dataset(family)
    schema = OmegaConf.structured(info.load_config())
    given = OmegaConf.from_dotlist([_setting(word) for word in settings])
    known = [field.name for field in dataclasses.fields(info.load_config())]
    for key in given:
        if key not in known:
            raise ConfigError(f"{key!s}: {family} has no such setting; there is {', '.join(known)}")
    config = OmegaConf.to_object(OmegaConf.merge(schema, {"path": str(path), "scene": "custom"}, given))
    dataset = info.load()(config)
    assert isinstance(dataset, Dataset), f"{type(dataset).__name__} is no Dataset"
    return dataset


def _setting(word: str) -> str:
    if "=" not in word:
        raise ConfigError(f"{word}: a setting is name=value, such as depth_scale=5000")
    return word.removeprefix("dataset.")


def _list(_: argparse.Namespace) -> None:
    from xrdslam.datasets.catalogue import sources

    addresses = sources()
    for name, info in installed().all(DatasetInfo).items():
        print(f"{name:<14}{info.summary}  [{info.distribution}]")
        root = getattr(info.load_config()(), "root", "")
        for scene in sorted(options(f"dataset/{name}")):
            if scene == "custom":
                continue
            here = "here" if (Path(root) / scene).is_dir() else ""
            had = "can be downloaded" if f"{name}/{scene}" in addresses or name in addresses else ""
            print(f"    {name}/{scene:<26}{here or had}".rstrip())
        print(f"    {name}/custom dataset.path=<path>")


def _inspect(chosen: argparse.Namespace) -> None:
    from xrdslam.datasets.contact_sheet import write_contact_sheet
    from xrdslam.datasets.inspection import inspect_dataset

    dataset = open_dataset(chosen.path, chosen.family, chosen.settings)
    dataset.on_error = "raise"
    inspection = inspect_dataset(dataset)
    print("\n".join(inspection.lines()))
    sheet = chosen.sheet or Path(f"{inspection.name.replace('/', '_')}.png")
    write_contact_sheet(dataset, inspection, sheet)
    print(f"  picture      {sheet}")
    family = inspection.name.partition("/")[0]
    settings = " ".join(shlex.quote(f"dataset.{_setting(word)}") for word in chosen.settings)
    path = shlex.quote(f"dataset.path={chosen.path}")
    print(f"  run it       python -m xrdslam algo=<name> dataset={family}/custom {path} {settings}".rstrip())


def _download(chosen: argparse.Namespace) -> None:
    from xrdslam.datasets.catalogue import source_of
    from xrdslam.datasets.download import fetch, unpack

    family = chosen.name.partition("/")[0]
    info = installed().dataset(family)
    source = source_of(chosen.name)
    root = chosen.root or Path(info.load_config()().root)
    folder = root / source.folder if source.folder else root
    if folder.is_dir() and any(folder.iterdir()):
        raise DataError(f"{folder}: is there and not empty; remove it to download it again")
    print(f"{source.url}\n  into {folder}; terms: {source.terms}")
    archive = root.parent / "downloads" / source.url.rpartition("/")[2]
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns) as bar:
        task = bar.add_task(archive.name, total=None)
        fetch(source.url, archive, source.sha256, lambda done, total: bar.update(task, completed=done, total=total))
    unpack(archive, folder)
    archive.unlink()
    print(f"  python -m xrdslam algo=<name> dataset={chosen.name} dataset.root={root}")


def _convert(chosen: argparse.Namespace) -> None:
    from xrdslam.datasets.convert import convert

    dataset = open_dataset(chosen.path, chosen.family, chosen.settings)
    dataset.check()
    count = convert(dataset, chosen.to, chosen.into, chosen.depth_scale)
    skipped = f", {dataset.num_skipped} left out" if dataset.num_skipped else ""
    print(f"{chosen.into}: {count} frames of {dataset.name} in the layout of {chosen.to}{skipped}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m xrdslam.datasets",
        description=__doc__,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands: Any = parser.add_subparsers(required=True, metavar="list | inspect | download | convert")
    commands.add_parser("list", help="families and scenes").set_defaults(action=_list)
    source = argparse.ArgumentParser(add_help=False)
    source.add_argument("path", type=Path, help="a folder, bag, video or transforms.json")
    source.add_argument("settings", nargs="*", help="settings of its family, such as depth_scale=5000")
    source.add_argument("--family", help="what it is, where the guess is wrong")
    source.add_argument("--verbose", action="store_true", help="say what was looked for and found")
    inspect = commands.add_parser(
        "inspect", parents=[source], help="what a recording holds, and whether it fits together"
    )
    inspect.add_argument("--sheet", type=Path, help="where the picture goes (default <family>_<name>.png)")
    inspect.set_defaults(action=_inspect)
    download = commands.add_parser("download", help="get a scene from its publisher; continues where it stopped")
    download.add_argument("name", help="<family>/<scene>")
    download.add_argument("--root", type=Path, help="the folder that holds the family's scenes")
    download.set_defaults(action=_download)
    convert = commands.add_parser("convert", parents=[source], help="write any recording in another layout")
    convert.add_argument("--to", required=True, choices=("replica", "tum_rgbd"), help="the layout")
    convert.add_argument("--into", required=True, type=Path, help="a folder that does not exist yet")
    convert.add_argument("--depth-scale", type=float, help="levels of depth per metre in what is written")
    convert.set_defaults(action=_convert)
    return parser
