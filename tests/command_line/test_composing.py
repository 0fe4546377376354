"""What is laid over what: defaults, published settings of the dataset's family, preset, command line."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_module
from hydra.core.hydra_config import HydraConfig
from hydra.errors import ConfigCompositionException, MissingConfigException
from omegaconf import DictConfig

from xrdslam.command_line.compose import check_preset, run_config
from xrdslam.core.config import RunConfig
from xrdslam.core.errors import ConfigError


@pytest.fixture(autouse=True)
def _hydra() -> Iterator[None]:
    with initialize_config_module("xrdslam.conf", version_base="1.3", job_name="xrdslam"):
        yield


def composed(*overrides: str) -> DictConfig:
    return compose("config", overrides=["algo=splatam", "dataset=replica/room0", *overrides])


def typed(*overrides: str) -> RunConfig:
    cfg = compose("config", overrides=["algo=splatam", "dataset=replica/room0", *overrides], return_hydra_config=True)
    HydraConfig.instance().set_config(cfg)
    choices = dict(cfg.hydra.runtime.choices)
    return run_config(composed(*overrides), choices, Path("somewhere"))


def test_settings_arrive_as_the_dataclasses_that_hold_their_defaults() -> None:
    from xrdslam.algorithms.splatam.config import SplatamConfig
    from xrdslam.datasets.config import ReplicaConfig

    config = typed()
    assert config.algo == SplatamConfig()
    assert config.dataset == ReplicaConfig(scene="room0")
    assert config.run_dir == "somewhere"


@pytest.mark.parametrize(
    ("dataset", "settings", "iterations", "window", "ratio"),
    [
        ("replica/room0", "replica", 40, 24, 3.0),
        ("seven_scenes/chess", "seven_scenes", 200, 20, 2.0),  # takes those of TUM RGB-D
    ],
)
def test_a_family_brings_its_published_settings(
    dataset: str, settings: str, iterations: int, window: int, ratio: float
) -> None:
    cfg = composed(f"dataset={dataset}")
    assert cfg.settings == settings
    assert cfg.algo.tracking.iterations == iterations
    assert cfg.algo.mapping.window == window
    assert cfg.algo.map.scene_radius_ratio == ratio


def test_settings_of_another_family_can_be_asked_for() -> None:
    assert composed("settings=scannet").algo.tracking.lr_rotation == 5e-4
    assert composed("dataset=seven_scenes/chess", "settings=none").algo.tracking.iterations == 40


def test_a_preset_lies_over_settings_and_the_command_line_over_both() -> None:
    tum = ("dataset=seven_scenes/chess", "preset=small")
    assert composed(*tum).algo.tracking.iterations == 10  # 200 by the family
    assert composed(*tum).algo.tracking.lr_translation == 2e-3  # by the family, the preset is silent
    assert composed(*tum, "algo.tracking.iterations=7").algo.tracking.iterations == 7


def test_an_exchanged_method_takes_none_of_the_settings_of_the_one_it_replaces() -> None:
    from xrdslam.methods.config import GicpTrackingConfig

    config = typed("dataset=seven_scenes/chess", "preset=small", "algo/tracking=gicp")
    assert config.algo.tracking == GicpTrackingConfig()
    assert config.algo.mapping.iterations == 15  # the preset of the mapping that stays


@pytest.mark.parametrize("tracking", ["ground_truth", "constant_velocity", "gicp", "splatam"])
@pytest.mark.parametrize("mapping", ["none", "splatam"])
def test_every_tracking_goes_with_every_mapping(tracking: str, mapping: str) -> None:
    config = typed(f"algo/tracking={tracking}", f"algo/mapping={mapping}")
    assert (config.algo.tracking.name, config.algo.mapping.name) == (tracking, mapping)


def test_a_preset_that_none_of_the_chosen_methods_has_is_refused() -> None:
    choices: dict[str, str | None] = {
        "algo": "other",
        "algo/tracking": "gicp",
        "algo/mapping": "none",
        "preset": "fast",
    }
    with pytest.raises(ConfigError, match=r"preset=fast: none of algo=other, algo/tracking=gicp.*there is published"):
        check_preset(choices)
    check_preset({**choices, "algo/tracking": "splatam"})
    check_preset({**choices, "preset": "published"})


def test_a_viewer_brings_its_settings() -> None:
    assert typed().viewer.name == "none"
    assert typed("viewer=viser", "viewer.port=9000").viewer.port == 9000


@pytest.mark.parametrize(
    ("override", "names"),
    [
        ("algo.tracking.iterations=-3", "algo.tracking.iterations=-3"),
        ("algo.mapping.window=0", "algo.mapping.window=0"),
        ("algo.map.near_m=0", "algo.map.near_m=0"),
        ("algo.first_pose=here", "algo.first_pose=here"),
        ("seed=-1", "seed=-1"),
        ("dataset.on_error=ignore", "dataset.on_error"),
        ("evaluation.every=0", "evaluation.every=0"),
    ],
)
def test_nonsense_is_refused_by_its_dotted_name(override: str, names: str) -> None:
    with pytest.raises(ConfigError, match=f"^{names}"):
        typed(override)


@pytest.mark.parametrize(
    "override", ["algo.tracking.iterations=many", "algo.tracking.itertions=3", "seed=1.5", "dataset.frames=3", "new=1"]
)
def test_a_wrong_type_or_an_unknown_key_does_not_compose(override: str) -> None:
    with pytest.raises(ConfigCompositionException, match=override.partition("=")[0]):
        composed(override)


@pytest.mark.parametrize(
    "override",
    [
        "viewer=foo",
        "algo=foo",
        "dataset=replica/attic",
        "algo/tracking=foo",
        "preset=foo",
        "settings=foo",
        "engine=foo",
    ],
)
def test_an_unknown_option_does_not_compose(override: str) -> None:
    with pytest.raises(MissingConfigException, match=override.replace("=", "/")):
        composed(override)


@pytest.mark.parametrize(
    ("override", "expected"),
    [("[5,null,2]", [5, None, 2]), ("[0,10,1]", [0, 10, 1])],
)
def test_a_slice_of_frames_may_be_open(override: str, expected: list[Any]) -> None:
    assert typed(f"dataset.frames={override}").dataset.frames == expected
