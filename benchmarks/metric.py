"""One measured figure, and when it counts as a regression."""

import json
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

__all__ = ["Metric", "read_baseline", "regressions", "write_baseline"]


@dataclass(frozen=True)
class Metric:
    """A figure under a key `<group>/<workload>/<name>`: ratios, not seconds, so that machines can be compared."""

    key: str
    value: float
    unit: str
    direction: Literal["lower", "higher"]
    """Which way is better."""
    rel_tol: float = 0.3
    """How much worse than the baseline it may be, as a fraction of the baseline."""
    abs_tol: float = 0.0

    def regressed(self, base: "Metric") -> bool:
        """Say whether this figure is worse than the baseline's by more than the tolerance; NaN always is."""
        slack = abs(base.value) * self.rel_tol + self.abs_tol
        worse_by = self.value - base.value if self.direction == "lower" else base.value - self.value
        return not worse_by <= slack  # the negation makes NaN a failure


def regressions(found: Iterable[Metric], baseline: Iterable[Metric], groups: Iterable[str]) -> list[str]:
    """List in words what is worse than the baseline; NaN is, and what vanished from a measured group."""
    by_key, wanted = {metric.key: metric for metric in found}, tuple(f"{group}/" for group in groups)
    complaints = [f"{key}: {metric.value}" for key, metric in by_key.items() if math.isnan(metric.value)]
    for base in baseline:
        metric = by_key.get(base.key)
        if metric is None:
            if base.key.startswith(wanted):
                complaints.append(f"{base.key}: vanished, was {base.value:.4g} {base.unit}")
        elif metric.regressed(base) and not math.isnan(metric.value):
            complaints.append(f"{base.key}: {metric.value:.4g} {base.unit}, was {base.value:.4g}")
    return complaints


def read_baseline(path: Path) -> list[Metric]:
    """Read the committed figures; none if there is no file yet."""
    if not path.exists():
        return []
    return [Metric(**entry) for entry in json.loads(path.read_text())["metrics"]]


def write_baseline(path: Path, metrics: Iterable[Metric], environment: dict[str, Any]) -> None:
    """Write figures as the new baseline, by key, with what they were measured on."""
    entries = [asdict(metric) for metric in sorted(metrics, key=lambda metric: metric.key)]
    path.write_text(json.dumps({"environment": environment, "metrics": entries}, indent=2) + "\n")
