"""What each frame cost: time by stage, memory, map size."""

import numpy as np

from xrdslam.report.charts import Chart, Series, line_chart
from xrdslam.report.run_files import RunFiles

__all__ = ["cost_charts"]

STAGES = (
    ("tracking_ms", "tracking", "var(--accent)"),
    ("mapping_ms", "mapping", "var(--second)"),
    ("reading_ms", "reading", "var(--third)"),
)


def cost_charts(run: RunFiles) -> str:
    """Return charts of time, memory and map size over the frames.

    The first frame builds the map (and may wait for compilers), often a hundred times what any other takes: the scale
    of time is that of the others, what is cut off is said.
    """
    timing = run.timing
    if not timing or len(timing["index"]) < 2:
        return '<p class="none">Fewer than two frames were processed.</p>'
    x = timing["index"]
    charts = [_times(x, timing)]
    memory = timing["rss_mib"]
    if (memory > 0).any():
        charts.append(line_chart(Chart("Resident memory", "MiB", x, [Series("memory", memory, is_area=True)])))
    charts.append(line_chart(Chart("Map", "primitives", x, [Series("map", timing["map_size"], is_area=True)])))
    return "".join(charts)


def _times(x: np.ndarray, timing: dict[str, np.ndarray]) -> str:
    columns = {key: timing[key] for key, _, _ in STAGES}
    rest = np.concatenate([values[1:] for values in columns.values()])
    limit = max(float(np.percentile(rest, 99.5)) * 1.2, 1.0)
    cut = {key: values.max() for key, values in columns.items() if values.max() > limit}
    series = [
        Series(name, np.where(columns[key] <= limit, columns[key], np.nan), colour)
        for key, name, colour in reversed(STAGES)
    ]
    said = "; ".join(f"{key.removesuffix('_ms')} up to {value / 1e3:.1f} s" for key, value in cut.items())
    return line_chart(Chart("Time of a frame", f"ms{f' (not drawn: {said})' if said else ''}", x, series))
