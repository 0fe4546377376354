"""Many runs in one table: a row for each dataset and method, mean and spread over seeds."""

import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from xrdslam.core.errors import RunError
from xrdslam.report.protocols import by_protocol, check_protocols, conditions
from xrdslam.report.published import PublishedFigure, published_figure
from xrdslam.report.run_files import RunFiles
from xrdslam.report.variants import Group, grouped

__all__ = ["COLUMNS", "Cell", "Column", "Row", "Table", "tabulated"]


@dataclass(frozen=True)
class Column:
    """A figure, and how it is shown."""

    key: str
    label: str
    unit: str
    digits: int
    best: str
    """`low` or `high`; empty where neither is better."""
    note: str = ""
    """What is special to how it was measured, where a figure has several columns."""

    @property
    def title(self) -> str:
        """Label and unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


COLUMNS = (
    Column("trajectory/final/ate_rmse_cm", "ATE RMSE", "cm", 2, "low"),
    Column("trajectory/lost_frames", "lost", "frames", 0, "low"),
    Column("rendering/train/psnr_db", "PSNR", "dB", 2, "high"),
    Column("rendering/train/ssim", "SSIM", "", 3, "high"),
    Column("rendering/train/ms_ssim", "MS-SSIM", "", 3, "high"),
    Column("rendering/train/lpips_alex", "LPIPS (alex)", "", 3, "low"),
    Column("rendering/train/depth_l1_cm", "depth L1", "cm", 2, "low"),
    Column("rendering/held_out/psnr_db", "PSNR, held out", "dB", 2, "high"),
    Column("rendering/held_out/depth_l1_cm", "depth L1, held out", "cm", 2, "low"),
    Column("reconstruction/accuracy_cm", "accuracy", "cm", 2, "low"),
    Column("reconstruction/completion_cm", "completion", "cm", 2, "low"),
    Column("reconstruction/mesh_depth_l1_cm", "mesh depth L1", "cm", 2, "low"),
    Column("reconstruction/f_score_1cm_percent", "F-score 1 cm", "%", 1, "high"),
    Column("reconstruction/f_score_5cm_percent", "F-score 5 cm", "%", 1, "high"),
    Column("profile/frames_per_second", "speed", "frames/s", 2, "high"),
    Column("profile/peak_rss_mib", "memory", "MiB", 0, "low"),
)


@dataclass(frozen=True)
class Cell:
    """A figure of a group: one value for each seed that has it."""

    values: tuple[float, ...]
    reason: str = ""
    """Why there is none."""
    is_best: bool = False
    published: PublishedFigure | None = None

    @property
    def mean(self) -> float | None:
        """Over seeds."""
        return statistics.fmean(self.values) if self.values else None

    @property
    def std(self) -> float | None:
        """Of the sample (n - 1); None for a single value."""
        return statistics.stdev(self.values) if len(self.values) > 1 else None


@dataclass(frozen=True)
class Row:
    """A method on a dataset."""

    dataset: str
    method: str
    seeds: tuple[int, ...]
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Table:
    """What is printed."""

    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...]
    missing: tuple[str, ...]
    """Runs that have no figures, and why."""


def tabulated(
    runs: Sequence[RunFiles],
    missing: Sequence[str] = (),
    published: Mapping[str, list[PublishedFigure]] | None = None,
    keys: Sequence[str] | None = None,
    is_split: bool = False,
) -> Table:
    """Return the table of finished runs.

    `published` holds figures by method; `keys` picks and orders columns. RunError where there is nothing to show,
    ProtocolError where a column would hold two protocols, unless `is_split` gives each its own.
    """
    finished = [run for run in runs if run.is_finished]
    if not finished:
        raise RunError(f"none of {len(runs) + len(missing)} runs has figures (metrics.json): {'; '.join(missing)}")
    wanted = _wanted(finished, keys)
    if not is_split:
        check_protocols(finished, [column.key for column in wanted])
    members = [(column, set(map(id, own))) for column in wanted for column, own in _columns(finished, column)]
    groups = grouped(finished)
    rows = [_row(group, members, published or {}) for group in groups]
    columns = tuple(column for column, _ in members)
    return Table(
        columns, tuple(_with_best(rows, columns)), (*_notes(finished), *_protocols(finished, columns)), tuple(missing)
    )


def _wanted(runs: Sequence[RunFiles], keys: Sequence[str] | None) -> list[Column]:
    known = {column.key: column for column in COLUMNS}
    if keys is None:
        return [column for column in COLUMNS if any(run.figure(column.key) is not None for run in runs)]
    there = {key for run in runs for key in run.metrics if not key.endswith("/protocol")}
    absent = [key for key in keys if key not in there]
    if absent:
        raise RunError(f"--columns {','.join(absent)}: none of the runs has it; there is {', '.join(sorted(there))}")
    return [known.get(key, Column(key, key, "", 3, "")) for key in keys]


def _columns(runs: Sequence[RunFiles], column: Column) -> list[tuple[Column, list[RunFiles]]]:
    split = by_protocol(runs, column.key)
    return [(Column(**{**vars(column), "note": note}), own) for note, own in split.items()] or [(column, [])]


def _row(
    group: Group, members: Sequence[tuple[Column, set[int]]], published: Mapping[str, list[PublishedFigure]]
) -> Row:
    # Figures were published for a method as it was: with a tracker or mapper of another's it is another.
    figures = published.get(group.runs[0].method, []) if "=" not in group.method.partition(" (")[0] else []
    cells = []
    for column, own in members:
        runs = [run for run in group.runs if id(run) in own]
        values = tuple(value for run in runs if (value := run.figure(column.key)) is not None)
        reason = "" if values else group.runs[0].reason(column.key)
        cells.append(Cell(values, reason, published=published_figure(figures, group.dataset, column.key)))
    return Row(group.dataset, group.method, tuple(sorted(run.seed for run in group.runs)), tuple(cells))


def _with_best(rows: Sequence[Row], columns: Sequence[Column]) -> list[Row]:
    """Mark the best mean of each column among the methods of a dataset; alone or equal, none is."""
    marked = []
    for row in rows:
        rivals = [other for other in rows if other.dataset == row.dataset]
        cells = []
        for place, column in enumerate(columns):
            means = [mean for rival in rivals if (mean := rival.cells[place].mean) is not None]
            best = max(means, default=None) if column.best == "high" else min(means, default=None)
            is_best = bool(column.best) and len(set(means)) > 1 and row.cells[place].mean == best
            cells.append(Cell(row.cells[place].values, row.cells[place].reason, is_best, row.cells[place].published))
        marked.append(Row(row.dataset, row.method, row.seeds, tuple(cells)))
    return marked


def _notes(runs: Sequence[RunFiles]) -> list[str]:
    hardware: dict[str, int] = {}
    for run in runs:
        known = {name: run.environment.get(name, "?") for name in ("processor", "cores", "threads", "device")}
        text = "{processor}, {cores} cores, {threads} threads, {device}".format(**known)
        hardware[text] = hardware.get(text, 0) + 1
    counted = "; ".join(f"{text} ({count} runs)" if len(hardware) > 1 else text for text, count in hardware.items())
    return [
        f"Hardware: {counted}.",
        "Mean ± standard deviation of the sample (n - 1) over seeds; bold: best of a dataset.",
    ]


def _protocols(runs: Sequence[RunFiles], columns: Sequence[Column]) -> Iterator[str]:
    """Yield how the figures of each group were measured: what all of them share."""
    for group in dict.fromkeys(column.key.rpartition("/")[0] for column in columns):
        shared: dict[str, str] = {}
        for key in (column.key for column in columns if column.key.rpartition("/")[0] == group):
            ways = [conditions(run, key) for run in runs if run.figure(key) is not None]
            shared |= {entry: way for entry, way in (ways or [{}])[0].items() if all(w.get(entry) == way for w in ways)}
        if shared:
            said = "; ".join(f"{entry.replace('_', ' ')}: {way}" for entry, way in shared.items())
            yield f"Measured, {group}: {said}."
