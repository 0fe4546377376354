"""The table of a sweep, written into its folder."""

from collections.abc import Sequence
from pathlib import Path

from xrdslam.core.files import write_text
from xrdslam.report.formats import FORMATS
from xrdslam.report.protocols import ProtocolError
from xrdslam.report.sweep import asked_for
from xrdslam.report.table import tabulated

__all__ = ["write_comparison"]


def write_comparison(folder: Path, formats: Sequence[str] = ("html", "markdown")) -> list[Path]:
    """Write mean and spread over seeds of all runs in a folder, and return the files.

    Figures that were measured differently stand in columns of their own.
    """
    asked = asked_for([folder])
    try:
        table = tabulated(asked.runs, asked.missing)
    except ProtocolError:  # two protocols under one name
        table = tabulated(asked.runs, asked.missing, is_split=True)
    written = []
    for name in formats:
        file, write = FORMATS[name]
        write_text(folder / file, write(table))
        written.append(folder / file)
    return written
