"""The gate: what counts as a regression."""

import math
from pathlib import Path

import pytest

from benchmarks import metric
from benchmarks.metric import Metric


@pytest.mark.parametrize(
    ("direction", "value", "worse"),
    [
        ("lower", 129.0, False),
        ("lower", 131.0, True),
        ("lower", 1.0, False),
        ("higher", 71.0, False),
        ("higher", 69.0, True),
        ("higher", 1000.0, False),
        ("lower", math.nan, True),
        ("higher", math.nan, True),
        ("lower", math.inf, True),
    ],
)
def test_worse_by_more_than_the_tolerance_is_a_regression(direction: str, value: float, worse: bool) -> None:
    base = Metric("kernels/a/b", 100.0, "ms", direction, 0.3)
    assert Metric("kernels/a/b", value, "ms", direction, 0.3).regressed(base) is worse


def test_a_figure_that_vanished_or_is_nan_is_a_regression_and_a_new_one_is_not() -> None:
    base = [Metric("kernels/a/x", 1.0, "ms", "lower"), Metric("methods/b/y", 1.0, "ms", "lower")]
    new = Metric("kernels/a/new", 5.0, "ms", "lower")
    assert metric.regressions([new], base, ["kernels"]) == ["kernels/a/x: vanished, was 1 ms"]
    nan = Metric("kernels/a/x", math.nan, "ms", "lower")
    assert metric.regressions([nan], base, ["kernels"]) == ["kernels/a/x: nan"]
    assert metric.regressions([base[0]], base, ["kernels"]) == []


def test_a_baseline_survives_its_file(tmp_path: Path) -> None:
    path = tmp_path / "baseline.json"
    assert metric.read_baseline(path) == []
    metrics = [Metric("b", 2.5, "x twin", "higher", 0.4), Metric("a", 1.0, "ms", "lower")]
    metric.write_baseline(path, metrics, {"threads": 2})
    assert metric.read_baseline(path) == metrics[::-1]
