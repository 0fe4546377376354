"""A map says what it can, and refuses what it cannot in words."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from xrdslam.core.batch import ImageBatch
from xrdslam.core.errors import PluginError
from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.testing import ToyModel, toy_sequence
from xrdslam.testing.bits import different_leaves


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


class Grown(Bare):
    """Rows in the map itself and in a part of it; a buffer, a parameter that does not move, one of another type."""

    def __init__(self, rows: int, width: int = 3) -> None:
        super().__init__()
        self.points = nn.Parameter(torch.rand(rows, width))
        self.still = nn.Parameter(torch.rand(rows, 1), requires_grad=False)
        self.register_buffer("birth", torch.arange(rows))
        self.register_buffer("absent", None)
        self.part = nn.Module()
        self.part.points = nn.Parameter(torch.rand(2 * rows, width, dtype=torch.float64))


@pytest.mark.parametrize("rows", [0, 1, 5])
@pytest.mark.parametrize("held", [0, 3])
def test_a_map_takes_its_rows_from_what_is_loaded(rows: int, held: int) -> None:
    saved, model = Grown(rows), Grown(held)
    model.load_state_dict(saved.state_dict())
    assert different_leaves(dict(saved.state_dict()), dict(model.state_dict())) == []
    assert [(n, p.requires_grad) for n, p in model.named_parameters()] == [
        ("points", True), ("still", False), ("part.points", True)
    ]  # fmt: skip


def test_only_rows_may_differ() -> None:
    with pytest.raises(RuntimeError, match="size mismatch for points"):
        Grown(2).load_state_dict(Grown(2, width=4).state_dict())
    with pytest.raises(RuntimeError, match="Missing key"):
        Grown(2).load_state_dict({})
