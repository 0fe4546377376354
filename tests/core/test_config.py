"""Settings refuse nonsense with their dotted name and value, before anything runs."""

import dataclasses
import math
import subprocess
import sys

import pytest

from xrdslam.core.config import (
    AlgorithmConfig,
    IterativeMappingConfig,
    IterativeTrackingConfig,
    RunConfig,
    require,
    require_choice,
)
from xrdslam.core.errors import ConfigError
from xrdslam.core.keyframes import KEYFRAME_POLICIES
from xrdslam.core.motion import MOTION_MODELS

TRACKING = ("algo.tracking", IterativeTrackingConfig)
MAPPING = ("algo.mapping", IterativeMappingConfig)
ALGORITHM = ("algo", AlgorithmConfig)
RUN = ("", RunConfig)


@pytest.mark.parametrize(
    ("where", "key", "bad", "edge"),
    [
        (TRACKING, "iterations", 0, 1),
        (TRACKING, "lr_rotation", -1e-9, 0.0),
        (TRACKING, "lr_translation", -1e-9, 0.0),
        (TRACKING, "rotation", "euler", "quaternion"),
        (TRACKING, "num_pixels", 0, 1),
        (TRACKING, "border_px", -1, 0),
        (TRACKING, "stop_patience", -1, 0),
        (TRACKING, "stop_tolerance", -0.1, 0.0),
        (TRACKING, "pivot", "sun", "scene"),
        (MAPPING, "iterations", 0, 1),
        (MAPPING, "first_iterations", -1, 0),
        (MAPPING, "keyframes", "best", "all"),
        (MAPPING, "window", 0, 1),
        (MAPPING, "lr_pose_rotation", -1e-9, 0.0),
        (MAPPING, "lr_pose_translation", -1e-9, 0.0),
        (MAPPING, "pose_accumulate", 0, 1),
        (MAPPING, "num_pixels", 0, 1),
        (ALGORITHM, "map_every", 0, 1),
        (ALGORITHM, "keyframe_every", 0, 1),
        (ALGORITHM, "first_pose", "middle", "identity"),
        (ALGORITHM, "motion", "teleport", "none"),
        (RUN, "seed", -1, 0),
        (RUN, "threads", -1, 0),
    ],
)
def test_each_setting_is_refused_by_name_just_past_its_edge(
    where: tuple[str, type], key: str, bad: object, edge: object
) -> None:
    prefix, config = where
    dotted = f"{prefix}.{key}" if prefix else key
    with pytest.raises(ConfigError) as refused:
        config(**{key: bad})
    assert str(refused.value).startswith(f"{dotted}={bad}: must ")
    assert getattr(config(**{key: edge}), key) == edge


@pytest.mark.parametrize(
    ("config", "key"),
    [
        (config, field.name)
        for config in (IterativeTrackingConfig, IterativeMappingConfig)
        for field in dataclasses.fields(config)
        if isinstance(field.default, float)
    ],
)
def test_nan_is_refused_everywhere(config: type, key: str) -> None:
    """A comparison with NaN is false: `require` asks for what must hold, not for what must not."""
    with pytest.raises(ConfigError, match=f"{key}=nan"):
        config(**{key: math.nan})


def test_choices_in_the_settings_are_those_in_the_code() -> None:
    for policy in KEYFRAME_POLICIES:
        IterativeMappingConfig(keyframes=policy)
    for motion in MOTION_MODELS:
        AlgorithmConfig(motion=motion)
    with pytest.raises(ConfigError) as refused:
        IterativeMappingConfig(keyframes="?")
    assert set(str(refused.value).split("be one of ")[1].split(", ")) == set(KEYFRAME_POLICIES)


def test_messages() -> None:
    require(True, "a.b", 1, "hold")
    with pytest.raises(ConfigError, match=r"^a\.b=1: must hold$"):
        require(False, "a.b", 1, "hold")
    with pytest.raises(ConfigError, match=r"^a=x: must be one of y, z$"):
        require_choice("a", "x", ("y", "z"))


def test_the_settings_of_two_runs_are_not_shared() -> None:
    first, second = AlgorithmConfig(), AlgorithmConfig()
    first.tracking.name = "changed"
    assert second.tracking.name == "???"


def test_settings_import_no_torch() -> None:
    source = "import sys, xrdslam.core.config; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", source], check=False).returncode == 0
