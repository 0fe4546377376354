"""`python -m xrdslam.plugins`: what is installed, whether it works, and a new method to start from."""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from xrdslam.command_line.help import inventory
from xrdslam.command_line.scaffold import write_distribution
from xrdslam.core.errors import XrdslamError
from xrdslam.core.hookspecs import REGISTRATION_HOOKS
from xrdslam.core.registry import Registry, installed

__all__ = ["check", "main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Do what the arguments say; exit status 1 where something is wrong."""
    parser = argparse.ArgumentParser(prog="python -m xrdslam.plugins", description=__doc__)
    commands = parser.add_subparsers(dest="command")
    commands.add_parser("list", help="what is installed (the default)")
    commands.add_parser("check", help="import everything that is registered, and build its settings")
    new = commands.add_parser("new", help="write a working distribution with its contract test")
    new.add_argument("name", help="of the method, such as my_slam")
    new.add_argument("--into", type=Path, default=Path(), help="the folder to write it into")
    chosen = parser.parse_args(arguments)
    if chosen.command == "check":
        faults = list(check(installed()))
        sys.exit("\n".join(faults) if faults else None)
    if chosen.command == "new":
        _new(chosen.name, chosen.into)
    else:
        print(inventory(installed()))


def check(registry: Registry) -> Iterator[str]:
    """Yield what is wrong with what is installed; print what is right."""
    yield from (str(plugin) for plugin in registry.broken.values())
    for kind in REGISTRATION_HOOKS.values():
        for info in registry.all(kind).values():
            try:
                info.load()
                if info.config:
                    info.load_config()()
            except XrdslamError as error:
                yield str(error)
            else:
                print(f"ok  {kind.kind} {info.name}  [{info.distribution}]")


def _new(name: str, into: Path) -> None:
    try:
        folder = write_distribution(name, into)
    except XrdslamError as error:
        sys.exit(f"xrdslam: {error}")
    print(f"{folder}: pip install --editable {folder} && pytest {folder}")


if __name__ == "__main__":
    main()
