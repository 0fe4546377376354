"""`python -m benchmarks.engines RESULTS.json [key=value ...]`: what processes cost, gain, and do to the trajectory.

Each workload is carried out by each engine for each seed, in a process of its own. Figures are added to RESULTS.json,
and what is there is not measured again: `--budget-s` begins nothing after that time, and the same command goes on. The
sequence is what the last arguments choose, by default the embedded room.

`run s` goes from the first frame's reading to the end of the last refinement, for every engine alike; `start s` is what
processes take to be there before it; `command s` is all that a user waits for, imports, files and evaluation too.
"""

import argparse
import json
import math
import statistics
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.runs import figures_of

__all__ = ["main", "table"]

WORKLOADS = {
    "splatam": ["algo=splatam"],
    "splatam, gicp": ["algo=splatam", "algo/tracking=gicp"],
    "co_slam": ["algo=co_slam"],
}
ENGINES = {
    "sequential": ["engine=sequential"],
    "strict": ["engine=multiprocess", "engine.sync=strict"],
    "async": ["engine=multiprocess", "engine.sync=async"],
}
SEQUENCE = ["dataset=synthetic/room0", "dataset.frames=[0,40,1]", "preset=fast"]
COMMAND = "command_s"
COLUMNS = {
    "command s": (COMMAND, 1),
    "start s": ("profile/start_s", 1),
    "run s": ("profile/wall_s", 1),
    "tracking ms": ("profile/tracking_ms_per_frame", 0),
    "mapping ms": ("profile/mapping_ms_per_frame", 0),
    "memory MiB": ("profile/peak_rss_mib", 0),
    "ATE cm": ("trajectory/final/ate_rmse_cm", 2),
    "PSNR dB": ("rendering/train/psnr_db", 1),
}
Results = dict[str, dict[str, float]]


def table(results: Results) -> str:
    """Lay figures out in Markdown: means over seeds, with the standard deviation where there are several."""
    lines = [f"| workload | engine | {' | '.join(COLUMNS)} |", f"|---|---|{'---|' * len(COLUMNS)}"]
    for workload in WORKLOADS:
        for engine in ENGINES:
            cell = [figures for key, figures in results.items() if key.startswith(f"{workload}/{engine}/")]
            if cell:
                shown = [_spread([f.get(key, math.nan) for f in cell], digits) for key, digits in COLUMNS.values()]
                lines.append(f"| {workload} | {engine} | {' | '.join(shown)} |")
    return "\n".join(lines)


def _spread(values: Sequence[float], digits: int) -> str:
    mean = f"{statistics.fmean(values):.{digits}f}"
    return mean if len(values) == 1 else f"{mean} ± {statistics.stdev(values):.{digits}f}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.engines", description=__doc__)
    parser.add_argument("results", type=Path, metavar="RESULTS.json")
    parser.add_argument("sequence", nargs="*", metavar="key=value", default=SEQUENCE, help=" ".join(SEQUENCE))
    parser.add_argument("--workloads", nargs="+", default=[*WORKLOADS], choices=[*WORKLOADS])
    parser.add_argument("--engines", nargs="+", default=[*ENGINES], choices=[*ENGINES])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--budget-s", type=float, default=math.inf)
    options = parser.parse_args(arguments)
    results: Results = json.loads(options.results.read_text()) if options.results.exists() else {}
    until = time.monotonic() + options.budget_s
    for seed in options.seeds:
        for workload in options.workloads:
            for engine in options.engines:
                key = f"{workload}/{engine}/{seed}"
                if key in results or time.monotonic() > until:
                    continue
                began = time.perf_counter()
                figures = figures_of([*WORKLOADS[workload], *ENGINES[engine], *options.sequence, f"seed={seed}"])
                results[key] = figures | {COMMAND: time.perf_counter() - began}
                options.results.write_text(json.dumps(results, indent=1) + "\n")
    print(table(results))


if __name__ == "__main__":
    main()
