"""`python -m xrdslam.report RUNS...`: one run on a page, many in a table."""

import argparse
import logging
import sys
from collections.abc import Sequence
from pathlib import Path

from xrdslam.core.errors import UnknownNameError, XrdslamError
from xrdslam.core.files import write_text
from xrdslam.core.registry import Registry, installed
from xrdslam.report.formats import FORMATS
from xrdslam.report.page import write_report
from xrdslam.report.published import PublishedFigure, published_figures
from xrdslam.report.run_files import RunFiles, is_run, read_run
from xrdslam.report.sweep import asked_for
from xrdslam.report.table import tabulated
from xrdslam.report.true_mesh import true_mesh_of

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Do what the arguments say; an error that a user can mend is one line, exit status 1."""
    parser = _parser()
    chosen = parser.parse_args(arguments)
    logging.basicConfig(format="%(levelname)s %(message)s")
    try:
        unknown = sorted(set(chosen.format) - FORMATS.keys())
        if unknown:
            raise XrdslamError(f"--format {','.join(unknown)}: must be among {', '.join(FORMATS)}")
        _page(chosen) if _is_page(chosen) else _table(chosen)
    except XrdslamError as error:
        sys.exit(f"xrdslam: {error}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m xrdslam.report", description=__doc__)
    add = parser.add_argument
    add("runs", nargs="+", type=Path, metavar="RUNS", help="folders of runs, or of sweeps")
    add("--reference", choices=["published"], help="put what was published for a method beside its figures")
    add("--format", type=_list, default=["markdown"], help=f"any of {','.join(FORMATS)} (markdown)")
    add("--out", type=Path, help="write report.md, .csv, .tex, .html into this folder; else the table is printed")
    add("--columns", type=_list, help="keys of metrics.json to show, in this order")
    add("--split", action="store_true", help="a column for each protocol, where figures were measured differently")
    add("--gt-mesh", type=Path, help="of a single run: the true surface (else the dataset's)")
    return parser


def _list(text: str) -> list[str]:
    return [part for part in text.split(",") if part]


def _is_page(chosen: argparse.Namespace) -> bool:
    is_table = chosen.reference or chosen.out or chosen.columns or chosen.format != ["markdown"]
    return len(chosen.runs) == 1 and is_run(chosen.runs[0]) and not is_table


def _page(chosen: argparse.Namespace) -> None:
    run = read_run(chosen.runs[0])
    print(write_report(run.path, chosen.gt_mesh or true_mesh_of(run, installed())))


def _table(chosen: argparse.Namespace) -> None:
    asked = asked_for(chosen.runs)
    published = _published(asked.runs, installed()) if chosen.reference else None
    table = tabulated(asked.runs, asked.missing, published, chosen.columns, chosen.split)
    for name in chosen.format:
        file, write = FORMATS[name]
        if chosen.out is None:
            print(write(table), end="")
        else:
            write_text(chosen.out / file, write(table))
            print(chosen.out / file)


def _published(runs: Sequence[RunFiles], registry: Registry) -> dict[str, list[PublishedFigure]]:
    """Return what was published for the methods of runs; a method that is not installed here brings nothing (said)."""
    found = {}
    for method in dict.fromkeys(run.method for run in runs):
        try:
            found[method] = published_figures(registry.algorithm(method))
        except UnknownNameError as error:
            logging.getLogger(__name__).warning("no published figures of %s: %s", method, error)
    return found


if __name__ == "__main__":
    main()
