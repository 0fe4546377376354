"""The settings refuse nonsense, and cost nothing to import."""

import subprocess
import sys
from types import ModuleType

import pytest

from xrdslam.core.errors import ConfigError
from xrdslam.evaluation.config import EvaluationConfig


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("every", 0),
        ("every", -5),
        ("every", 2.5),
        ("every", True),
        ("pictures_every", -1),
        ("rpe_delta_frames", 0),
        ("mask", "valid"),
        ("mask", ""),
        ("trajectory_pictures", 1),
        ("held_out", 1),
        ("held_out", -2),
        ("culling", "occlusion"),
        ("alignment", "umeyama"),
        ("icp", True),
        ("virtual_views", -1),
        ("mesh_samples", 1.5),
        ("cull_margin_m", 0.0),
        ("max_time_difference_s", -0.02),
        ("seed", -1),
    ],
)
def test_nonsense_is_refused_by_its_dotted_name_and_value(name: str, value: object) -> None:
    config = EvaluationConfig()
    setattr(config, name, value)  # past the type checker of the tests, as a YAML file would come
    with pytest.raises(ConfigError) as error:
        config.__post_init__()
    assert str(error.value).startswith(f"evaluation.{name}={value!r}: ")


@pytest.mark.parametrize(
    ("name", "value"),
    [("every", 1), ("pictures_every", 0), ("rpe_delta_frames", 30), ("mask", "none"), ("held_out", 2)],
)
def test_the_limits_themselves_are_allowed(name: str, value: object) -> None:
    assert getattr(EvaluationConfig(**{name: value}), name) == value


def test_settings_come_without_torch_and_matplotlib_and_pictures_without_pyplot() -> None:
    code = (
        "import sys\n"
        "import xrdslam.evaluation.config\n"
        "print([name for name in ('torch', 'matplotlib', 'cv2') if name in sys.modules])\n"
        "from xrdslam.evaluation import EvalMetrics, side_by_side, trajectory_figure\n"
        "print('matplotlib.pyplot' in sys.modules)\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split("\n")[:2] == ["[]", "False"]


def test_the_package_offers_what_it_names() -> None:
    import xrdslam.evaluation

    offered = {name: getattr(xrdslam.evaluation, name) for name in xrdslam.evaluation.__all__}
    assert not [name for name, value in offered.items() if isinstance(value, ModuleType)]  # no name of a module
    with pytest.raises(AttributeError, match="no_such_metric"):
        _ = xrdslam.evaluation.no_such_metric
