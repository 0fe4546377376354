"""`report.html`: one run on one page, one file that needs nothing beside it."""

import html
import json
import logging
from collections.abc import Callable
from importlib import resources
from pathlib import Path

from omegaconf import OmegaConf

from xrdslam.core.files import write_text
from xrdslam.report.charts import number
from xrdslam.report.costs import cost_charts
from xrdslam.report.renderings import panels_figure, score_charts
from xrdslam.report.run_files import RunFiles, Settings, read_run
from xrdslam.report.surface import surface_figure
from xrdslam.report.trajectory_view import error_chart, path_figure

__all__ = ["page_of", "write_report"]

log = logging.getLogger(__name__)

TILES = (
    ("trajectory/final/ate_rmse_cm", "ATE RMSE", "cm"),
    ("rendering/train/psnr_db", "PSNR, train views", "dB"),
    ("rendering/train/depth_l1_cm", "rendered depth L1", "cm"),
    ("reconstruction/f_score_5cm_percent", "F-score at 5 cm", "%"),
    ("profile/frames_per_second", "frames a second", ""),
    ("profile/peak_rss_mib", "peak memory", "MiB"),
    ("trajectory/lost_frames", "frames lost", ""),
)
UNITS = {"cm": "cm", "db": "dB", "deg": "deg", "percent": "%", "ms": "ms", "s": "s", "mib": "MiB", "second": "1/s"}


def write_report(run_dir: Path, true_mesh: Path | None = None) -> Path:
    """Write `report.html` into a run's directory from what lies there, and return its path.

    `true_mesh` is the mesh of the scene in the ground truth's world, where there is one. A part that cannot be drawn
    says why in its place; RunError where the directory is no run's.
    """
    run = read_run(run_dir)
    path = run_dir / "report.html"
    write_text(path, page_of(run, true_mesh))
    return path


def page_of(run: RunFiles, true_mesh: Path | None = None) -> str:
    """Return the page."""
    style, script = (resources.files("xrdslam.report").joinpath(name).read_text() for name in ("page.css", "page.js"))
    path = f'<div class="two">{_part(lambda: path_figure(run))}{_part(lambda: error_chart(run))}</div>'
    sections = [
        ("Trajectory", path, ["trajectory/final", "trajectory/online", "trajectory"]),
        ("Renderings", _part(lambda: panels_figure(run)) + _charts(_part(lambda: score_charts(run))), _rendering(run)),
        ("Surface", f'<div class="two">{_part(lambda: surface_figure(run, true_mesh))}</div>', ["reconstruction"]),
        ("Cost", _charts(_part(lambda: cost_charts(run))), ["profile"]),
    ]
    body = "".join(_section(run, title, content, groups) for title, content, groups in sections)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{html.escape(run.title)}</title><style>{style}</style></head><body>"
        f"{_head(run)}<main>{body}{_details(run)}</main><script>{script}</script></body></html>\n"
    )


def _part(draw: Callable[[], str]) -> str:
    """Return a part of the page; one that fails costs itself, says why, and leaves the rest."""
    try:
        return draw()
    except Exception as error:  # whatever a damaged file makes of a picture: the other parts are still worth having
        log.warning("a part of the report was left out: %s: %s", type(error).__name__, error)
        return f'<p class="none">Not drawn: {html.escape(f"{type(error).__name__}: {error}")}</p>'


def _head(run: RunFiles) -> str:
    environment = run.environment
    method = run.config.get("algo", {})
    machine = f"{environment.get('processor', '?')}, {environment.get('threads', '?')} threads"
    parts = [
        f"{part}: {method[part]['name']}" for part in ("tracking", "mapping") if "name" in (method.get(part) or {})
    ]
    facts = [
        f"preset {run.config.get('preset', '?')}",
        f"seed {run.seed}",
        f"{len(run.indices)} frames",
        *parts,
        f"{machine}, {environment.get('device', '?')}",
    ]
    chips = "".join(f"<span>{html.escape(str(fact))}</span>" for fact in facts)
    tiles = "".join(_tile(run, *tile) for tile in TILES)
    unfinished = "" if run.is_finished else '<p class="none">This run has no figures: it did not come to its end.</p>'
    return (
        f'<header><p class="brand">xrdslam · run report</p><h1>{html.escape(run.method)} '
        f"<small>on</small> {html.escape(run.dataset)}</h1>"
        f'<div class="chips">{chips}</div>{unfinished}<div class="tiles">{tiles}</div></header>'
    )


def _tile(run: RunFiles, key: str, label: str, unit: str) -> str:
    if key not in run.metrics:
        return ""
    value = run.figure(key)
    if value is None:
        return f'<div class="tile" title="{html.escape(run.reason(key))}"><b>n/a</b><span>{label}</span></div>'
    return f'<div class="tile"><b>{number(value)}</b><small>{unit}</small><span>{label}</span></div>'


def _charts(charts: str) -> str:
    return f'<div class="charts">{charts}</div>' if charts else ""


def _rendering(run: RunFiles) -> list[str]:
    return sorted(
        key.removesuffix("/protocol")
        for key in run.metrics
        if key.startswith("rendering/") and key.endswith("/protocol")
    )


def _section(run: RunFiles, title: str, content: str, groups: list[str]) -> str:
    figures = "".join(_group(run, group) for group in groups if f"{group}/protocol" in run.metrics)
    return f'<section id="{title.lower()}"><h2>{title}</h2>{content}{figures}</section>'


def _group(run: RunFiles, group: str) -> str:
    """Return the figures of a group, folded, with the protocol that they were measured by beside them."""
    keys = [key for key in run.metrics if key.startswith(f"{group}/") and key.count("/") == group.count("/") + 1]
    rows = "".join(_row(run, key) for key in keys if not key.endswith("/protocol"))
    protocol = {name: value for name, value in run.protocol(group).items() if name != "unavailable"}
    terms = "".join(f"<dt>{html.escape(_words(name))}</dt><dd>{_said(value)}</dd>" for name, value in protocol.items())
    return (
        f'<details class="group"><summary>{html.escape(group)}: figures and how they were measured</summary>'
        f'<div class="two"><table>{rows}</table><dl>{terms}</dl></div></details>'
    )


def _row(run: RunFiles, key: str) -> str:
    name = key.rpartition("/")[2]
    words, unit = name.split("_"), ""
    if words[-1] in UNITS and name != "frames_per_second":
        unit = UNITS[words.pop()]
    value = run.figure(key)
    shown = f"<td>{number(value)}</td><td>{unit}</td>"
    if value is None:
        shown = f'<td>n/a</td><td class="why">{html.escape(run.reason(key))}</td>'
    return f"<tr><th>{html.escape(' '.join(words))}</th>{shown}</tr>"


def _details(run: RunFiles) -> str:
    settings = html.escape(OmegaConf.to_yaml(OmegaConf.create(run.config)))
    environment = {k: v for k, v in run.environment.items() if k != "versions"}
    versions = run.environment.get("versions", {})
    return (
        '<section id="settings"><h2>Settings and environment</h2><div class="two">'
        f"<div><h3>Environment</h3><dl>{_terms(environment)}</dl><h3>Versions</h3><dl>{_terms(versions)}</dl></div>"
        f"<details open><summary>config.yaml, resolved</summary><pre>{settings}</pre></details></div></section>"
    )


def _terms(values: Settings) -> str:
    return "".join(f"<dt>{html.escape(_words(k))}</dt><dd>{_said(v)}</dd>" for k, v in values.items())


def _words(name: str) -> str:
    return name.replace("_", " ")


def _said(value: object) -> str:
    if isinstance(value, dict):
        return "; ".join(f"{html.escape(_words(str(k)))}: {_said(v)}" for k, v in value.items())
    if isinstance(value, float):
        return number(value)
    return html.escape(value if isinstance(value, str) else json.dumps(value))
