"""A table as Markdown, CSV, LaTeX and HTML: the same figures, notes and gaps in each."""

import csv
import html
import io
from collections.abc import Callable, Mapping
from importlib import resources

from xrdslam.report.table import Cell, Column, Table

__all__ = ["FORMATS", "as_csv", "as_html", "as_latex", "as_markdown"]


def as_markdown(table: Table) -> str:
    """Return a table for a README."""
    sources = _sources(table)
    head = ["dataset", "method", "seeds", *(_title(column) for column in table.columns)]
    lines = [_piped(head), _piped(["---"] * 3 + ["---:"] * len(table.columns))]
    for row in table.rows:
        cells = [_text(c, column, sources, "**{}**") for c, column in zip(row.cells, table.columns, strict=True)]
        lines.append(_piped([row.dataset, row.method, _seeds(row.seeds), *cells]))
    return "\n".join([*lines, "", *(f"{line}  " for line in _below(table, sources)), ""])


def as_csv(table: Table) -> str:
    """Return one line a figure: for whoever calculates on."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = ("dataset", "method", "metric", "protocol", "unit", "seeds", "mean", "std", "values", "published", "source")
    writer.writerow(names)
    for row in table.rows:
        for cell, column in zip(row.cells, table.columns, strict=True):
            own = (row.dataset, row.method, column.key, column.note, column.unit, " ".join(map(str, row.seeds)))
            values = " ".join(f"{value:.8g}" for value in cell.values)
            known = (cell.published.value, _source(cell)) if cell.published else ("", "")
            writer.writerow([*own, _plain(cell.mean), _plain(cell.std), values, *known])
    return text.getvalue()


def as_latex(table: Table) -> str:
    """Return a tabular for a paper (package booktabs)."""
    sources = _sources(table)
    head = ["dataset", "method", "seeds", *(_title(column) for column in table.columns)]
    lines = [f"\\begin{{tabular}}{{lll{'r' * len(table.columns)}}}", "\\toprule"]
    lines += [f"{' & '.join(map(_escaped, head))} \\\\", "\\midrule"]
    for row in table.rows:
        cells = [
            _text(cell, column, sources, "\\textbf{{{}}}", _escaped)
            for cell, column in zip(row.cells, table.columns, strict=True)
        ]
        first = [_escaped(text) for text in (row.dataset, row.method, _seeds(row.seeds))]
        lines.append(f"{' & '.join([*first, *cells])} \\\\")
    lines += ["\\bottomrule", "\\end{tabular}", *(f"% {line}" for line in _below(table, sources))]
    return "\n".join([*lines, ""])


def as_html(table: Table) -> str:
    """Return one page that needs nothing beside it."""
    sources = _sources(table)
    style = resources.files("xrdslam.report").joinpath("page.css").read_text()
    heads = ["dataset", "method", "seeds", *(_title(column) for column in table.columns)]
    head = "".join(f"<th>{html.escape(text)}</th>" for text in heads)
    body = []
    for row in table.rows:
        cells = [
            f"<td{' class=best' if cell.is_best else ''}>{_text(cell, column, sources, '<b>{}</b>', html.escape)}</td>"
            for cell, column in zip(row.cells, table.columns, strict=True)
        ]
        first = "".join(f"<td>{html.escape(t)}</td>" for t in (row.dataset, row.method, _seeds(row.seeds)))
        body.append(f"<tr>{first}{''.join(cells)}</tr>")
    notes = "".join(f"<p>{html.escape(line)}</p>" for line in _below(table, sources))
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        f'content="width=device-width,initial-scale=1"><title>xrdslam · {len(table.rows)} rows</title>'
        f'<style>{style}</style></head><body class="wider"><header><p class="brand">xrdslam · comparison</p>'
        f"<h1>{_heading(table)}</h1></header>"
        f'<main><section class="wide"><table class="grid"><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></section>"
        f'<section class="notes">{notes}</section></main></body></html>\n'
    )


FORMATS: Mapping[str, tuple[str, Callable[[Table], str]]] = {
    "markdown": ("report.md", as_markdown),
    "csv": ("report.csv", as_csv),
    "latex": ("report.tex", as_latex),
    "html": ("report.html", as_html),
}
"""Each format, the name of its file, and who writes it."""


def _text(
    cell: Cell, column: Column, sources: list[str], bold: str, escape: Callable[[str], str] = lambda text: text
) -> str:
    if cell.mean is None:
        text = "n/a" if cell.reason else ""
    else:
        text = f"{cell.mean:.{column.digits}f}" + ("" if cell.std is None else f" ± {cell.std:.{column.digits}f}")
    text = escape(text)
    text = bold.format(text) if cell.is_best else text
    if cell.published is None:
        return text
    place = sources.index(_source(cell)) + 1
    return f"{text} {escape(f'(published {cell.published.value:g} [{place}])')}"


def _below(table: Table, sources: list[str]) -> list[str]:
    """Return the lines under the table."""
    reasons = {
        column.title: cell.reason
        for row in table.rows
        for cell, column in zip(row.cells, table.columns, strict=True)
        if cell.reason
    }
    lines = [*table.notes, *(f"n/a, {title}: {reason}." for title, reason in reasons.items())]
    lines += [f"[{place}] {source}" for place, source in enumerate(sources, 1)]
    if table.missing:
        lines.append(f"Missing, {len(table.missing)} of the runs asked for: {'; '.join(table.missing)}.")
    return lines


def _sources(table: Table) -> list[str]:
    return list(dict.fromkeys(_source(cell) for row in table.rows for cell in row.cells if cell.published))


def _source(cell: Cell) -> str:
    assert cell.published is not None, "asked only of cells that have one"
    figure = cell.published
    return f"{figure.dataset}, {figure.scene}: {figure.source}"


def _title(column: Column) -> str:
    return f"{column.title} ({column.note})" if column.note else column.title


def _seeds(seeds: tuple[int, ...]) -> str:
    return ", ".join(map(str, seeds))


def _heading(table: Table) -> str:
    datasets, methods = ({row.dataset for row in table.rows}, {row.method for row in table.rows})
    return html.escape(f"{len(methods)} methods on {', '.join(sorted(datasets))}")


def _piped(cells: list[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"


def _plain(value: float | None) -> str:
    return "" if value is None else f"{value:.8g}"


def _escaped(text: str) -> str:
    for plain, latex in (("\\", "\\textbackslash "), *((c, f"\\{c}") for c in "&%$#_{}"), ("±", "$\\pm$")):
        text = text.replace(plain, latex)
    return text
