"""Tables of comma-separated values whose first column is a time."""

import csv
import re
from collections.abc import Iterator
from pathlib import Path

from xrdslam.datasets.poses import read_text

__all__ = ["read_rows"]

NUMBER = re.compile(r"[+-]?\d+(\.\d*)?([eE][+-]?\d+)?")


def read_rows(path: Path) -> Iterator[tuple[list[str], str]]:
    """Yield the cells of each row and "file, line n"; comments, blank rows and a first row of titles are left out."""
    for n, row in enumerate(csv.reader(read_text(path, "comma-separated rows").splitlines()), 1):
        cells = [cell.strip() for cell in row]
        is_title = n == 1 and bool(cells) and not NUMBER.fullmatch(cells[0])
        if any(cells) and not cells[0].startswith("#") and not is_title:
            yield cells, f"{path}, line {n}"
