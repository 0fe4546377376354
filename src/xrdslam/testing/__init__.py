"""Contract suites that plugin authors subclass, and toy sequences to run them on. Needs pytest."""

import pytest

pytest.register_assert_rewrite(
    *(f"xrdslam.testing.{name}_contract" for name in ("algorithm", "dataset", "kernel", "model")),
    "xrdslam.testing.model_checks",
)

from xrdslam.testing.algorithm_contract import AlgorithmContract  # noqa: E402  # after the rewrite is asked for
from xrdslam.testing.dataset_contract import DatasetContract  # noqa: E402
from xrdslam.testing.kernel_contract import KernelContract  # noqa: E402
from xrdslam.testing.model_contract import ModelContract  # noqa: E402
from xrdslam.testing.running import run  # noqa: E402
from xrdslam.testing.toy_method import ToyAlgorithm, ToyModel, ToyRayModel, toy_algorithm  # noqa: E402
from xrdslam.testing.toy_sequence import ToySequence, toy_sequence  # noqa: E402

__all__ = [
    "AlgorithmContract",
    "DatasetContract",
    "KernelContract",
    "ModelContract",
    "ToyAlgorithm",
    "ToyModel",
    "ToyRayModel",
    "ToySequence",
    "run",
    "toy_algorithm",
    "toy_sequence",
]
