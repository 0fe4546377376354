"""The metrics file: flat keys, a protocol beside each group, strict JSON, never half a file."""

import json
import math
from pathlib import Path

import pytest

from xrdslam.evaluation import EvaluationError, MetricGroup, assemble, write_metrics


def group() -> MetricGroup:
    filled = MetricGroup("rendering/train", {"stride": 5})
    filled.add("psnr_db", 31.5)
    filled.add("ssim", math.nan, "frame 5 is broken")
    filled.refuse(["ms_ssim", "lpips"], "too small")
    return filled


def test_keys_are_flat_and_the_protocol_stands_beside_them() -> None:
    assert assemble([group(), MetricGroup("profile")]) == {
        "rendering/train/psnr_db": 31.5,
        "rendering/train/ssim": None,
        "rendering/train/ms_ssim": None,
        "rendering/train/lpips": None,
        "rendering/train/protocol": {
            "stride": 5,
            "unavailable": {"ssim": "frame 5 is broken (nan)", "ms_ssim": "too small", "lpips": "too small"},
        },
        "profile/protocol": {},
    }


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_null_with_a_reason(value: float) -> None:
    broken = MetricGroup("profile")
    broken.add("frames_per_second", value)
    assert broken.values == {"frames_per_second": None}
    assert str(value) in broken.unavailable["frames_per_second"]


def test_two_numbers_of_one_name_are_refused() -> None:
    with pytest.raises(EvaluationError, match="rendering/train/psnr_db"):
        assemble([group(), group()])


def test_the_file_is_strict_json_and_reads_back(tmp_path: Path) -> None:
    path = tmp_path / "run" / "metrics.json"
    write_metrics(path, assemble([group()]))

    def refuse(literal: str) -> None:
        raise AssertionError(f"{literal} is no JSON")

    assert json.loads(path.read_text(), parse_constant=refuse) == assemble([group()])
    assert path.stat().st_mode & 0o777 == 0o644
    assert [file.name for file in path.parent.iterdir()] == ["metrics.json"]


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_nan_that_slipped_in_leaves_the_old_file_alone(tmp_path: Path, value: float) -> None:
    path = tmp_path / "metrics.json"
    write_metrics(path, {"a": 1})
    with pytest.raises(EvaluationError, match="NaN or infinite"):
        write_metrics(path, {"a": [value]})
    assert json.loads(path.read_text()) == {"a": 1}


def test_a_write_that_fails_leaves_the_old_file_and_no_litter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "metrics.json"
    write_metrics(path, {"a": 1})

    def full(*_: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(OSError, match="no space left"):
        write_metrics(path, {"a": 2})
    assert json.loads(path.read_text()) == {"a": 1}
    assert [file.name for file in tmp_path.iterdir()] == ["metrics.json"]
