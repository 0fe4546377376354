"""A map says what it can, and refuses what it cannot in words."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from xrdslam.core.batch import ImageBatch
from xrdslam.core.errors import PluginError
from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.testing import ToyModel, toy_sequence


class Bare(Model):
    @property
    def size(self) -> int:
        return 0

    def extend(self, frame: Frame, T_world_camera: Tensor) -> int:
        return 0


@pytest.mark.parametrize("capability", ["losses", "render", "mesh", "point_cloud"])
def test_a_map_supports_what_its_class_brings(capability: str) -> None:
    assert ToyModel.supports(capability) == (capability in ("losses", "render"))
    assert not Bare.supports(capability)


def test_a_map_refuses_what_it_cannot() -> None:
    frame = toy_sequence(1, 16, 12)[0]
    pose = torch.eye(4)
    calls: dict[str, Callable[[Bare], object]] = {
        "losses": lambda m: m.losses(ImageBatch(frame, pose), "mapping"),
        "render": lambda m: m.render(frame.camera, pose),
        "mesh": lambda m: m.mesh([]),
        "point_cloud": lambda m: m.point_cloud(),
    }
    for capability, call in calls.items():
        with pytest.raises(PluginError, match=f"the map Bare has no '{capability}'"):
            call(Bare())


def test_by_default_a_map_moves_nothing_and_exports_nothing(tmp_path: Path) -> None:
    assert Bare().parameter_groups() == []
    assert Bare().export(tmp_path) == []
