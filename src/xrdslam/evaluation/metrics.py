"""The numbers of a run as one flat JSON object, each group with the protocol it was measured under.

    {"rendering/train/psnr_db": 34.1, "rendering/train/ssim": null,
     "rendering/train/protocol": {"stride": 5, ..., "unavailable": {"ssim": "images of 8 px ..."}}}

A number that is not defined or not finite is `null`, never NaN (no JSON), and its reason is in `protocol.unavailable`.
"""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from xrdslam.core.files import write_text
from xrdslam.evaluation.errors import EvaluationError

__all__ = ["JsonValue", "MetricGroup", "Metrics", "assemble", "write_metrics"]


JsonValue = str | int | float | bool | None | list["JsonValue"] | dict[str, "JsonValue"]
Metrics = dict[str, JsonValue]


@dataclass
class MetricGroup:
    """Numbers that share a protocol. `name` is the prefix of their keys (`trajectory/final`)."""

    name: str
    protocol: dict[str, JsonValue] = field(default_factory=dict)
    values: dict[str, float | int | None] = field(default_factory=dict)
    unavailable: dict[str, str] = field(default_factory=dict)

    def add(self, key: str, value: float | int, reason_if_not_finite: str = "the computed value is not finite") -> None:
        """Add `<group>/<key>`; a NaN or an infinity becomes null with its reason."""
        if math.isfinite(value):
            self.values[key] = value
        else:
            self.refuse((key,), f"{reason_if_not_finite} ({value})")

    def refuse(self, keys: Iterable[str], reason: str) -> None:
        """Say why these numbers do not exist."""
        for key in keys:
            self.values[key] = None
            self.unavailable[key] = reason

    def flat(self) -> Metrics:
        """Return the group as entries of `metrics.json`, the protocol last."""
        protocol: dict[str, JsonValue] = dict(self.protocol)
        if self.unavailable:
            protocol["unavailable"] = dict(self.unavailable)
        entries: Metrics = {f"{self.name}/{key}": value for key, value in self.values.items()}
        return {**entries, f"{self.name}/protocol": protocol}


def assemble(groups: Iterable[MetricGroup]) -> Metrics:
    """Join groups into one flat object; two numbers of one name are a mistake."""
    metrics: Metrics = {}
    for group in groups:
        flat = group.flat()
        twice = metrics.keys() & flat.keys()
        if twice:
            raise EvaluationError(f"two groups of metrics bring {sorted(twice)}; give one of them another name")
        metrics.update(flat)
    return metrics


def write_metrics(path: Path, metrics: Mapping[str, JsonValue]) -> None:
    """Write strict JSON so that a reader sees the old file or the new one, never half of it."""
    try:
        text = json.dumps(metrics, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    except ValueError as error:
        raise EvaluationError(f"{path}: a metric is NaN or infinite; it must be null, with a reason") from error
    write_text(path, text)
