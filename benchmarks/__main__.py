"""`python -m benchmarks [group ...] [--update]`: measure, print a table, compare with `baseline.json`.

Groups are the functions in `GROUPS`; each returns its metrics. The exit status is 1 if anything got worse.
"""

import argparse
import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # before torch and numba: two spinning pools on the same cores
os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")

import numba
import torch
from rich.console import Console
from rich.table import Column, Table

from benchmarks.kernels import kernels
from benchmarks.metric import Metric, read_baseline, regressions, write_baseline
from benchmarks.runs import methods, startup

BASELINE = Path(__file__).with_name("baseline.json")
GROUPS: dict[str, Callable[[], list[Metric]]] = {
    "kernels": kernels,
    "methods": methods,
    "startup": startup,
}


def environment() -> dict[str, object]:
    """Say what the figures were measured on."""
    return {
        "machine": platform.machine(),
        "processor": torch.backends.cpu.get_cpu_capability(),
        "threads": torch.get_num_threads(),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numba": numba.__version__,
    }


def table(metrics: list[Metric], baseline: list[Metric]) -> Table:
    """Lay the figures out beside the baseline's."""
    before = {metric.key: metric.value for metric in baseline}
    rows = Table(*(Column(name, no_wrap=True) for name in ("figure", "value", "baseline", "unit", "better is")))
    for metric in metrics:
        base = f"{before[metric.key]:.4g}" if metric.key in before else "-"
        rows.add_row(metric.key, f"{metric.value:.4g}", base, metric.unit, metric.direction)
    return rows


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("groups", nargs="*", metavar="group", help=f"of {', '.join(GROUPS)}; default: all")
    parser.add_argument("--update", action="store_true", help="write the figures into the baseline")
    options = parser.parse_args()
    unknown = set(options.groups) - set(GROUPS)
    if unknown:
        parser.error(f"no group {', '.join(sorted(unknown))}; there are {', '.join(GROUPS)}")
    groups = options.groups or list(GROUPS)
    metrics = [metric for group in groups for metric in GROUPS[group]()]
    baseline, console = read_baseline(BASELINE), Console()
    console.width = max(console.width, 110)  # a key cut short is no key
    console.print(table(metrics, baseline))
    if options.update:
        kept = [metric for metric in baseline if metric.key.split("/")[0] not in groups]
        write_baseline(BASELINE, [*kept, *metrics], environment())
        return 0
    worse = regressions(metrics, baseline, groups)
    for complaint in worse:
        console.print(f"[red]worse:[/red] {complaint}")
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main())
