"""State in a file: what went in comes out, to the bit; what executes code does not go in."""

import ctypes
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from xrdslam.core.errors import DataError, PluginError
from xrdslam.core.saved_state import load_state, read_header, save_state
from xrdslam.testing.bits import different_leaves


def test_a_nest_of_every_kind_of_tensor_comes_back(tmp_path: Path) -> None:
    shared = torch.arange(6.0)
    state = {
        "model": {"points.x": torch.tensor([[0.0, -0.0, torch.nan, torch.inf]]), "flag": torch.tensor(True)},
        "tracking": {},
        "deep": {
            "er": {"empty": torch.empty(0, 3), "turned": torch.arange(6).reshape(2, 3).T, "count": torch.tensor(7)}
        },
        "twice": {"all": shared, "tail": shared[3:], "again": shared},
        "half": torch.ones(3, dtype=torch.float16),
        "learnt": torch.nn.Parameter(torch.ones(2)),
    }
    header = {"frame": 3, "cost": 0.1 + 0.2, "name": "é", "nothing": None}
    save_state(tmp_path / "a" / "state.safetensors", state, header)
    nest, about = load_state(tmp_path / "a" / "state.safetensors")
    assert different_leaves(state, nest) == []
    assert nest["tracking"] == {}
    assert about == header == read_header(tmp_path / "a" / "state.safetensors")
    assert nest["deep"]["er"]["turned"].data_ptr() % 64 == 0, "kernels that read aligned memory give the same bits"
    nest["twice"]["all"].zero_()
    assert float(nest["twice"]["again"].sum()) == 15


def test_a_type_that_numpy_lacks_comes_back(tmp_path: Path) -> None:
    state = {"a": {"brain": torch.tensor([1.5, torch.nan], dtype=torch.bfloat16)}, "count": torch.tensor(7)}
    save_state(tmp_path / "state", state, {})
    assert different_leaves(state, load_state(tmp_path / "state")[0]) == []


def test_a_state_that_grows_leaves_nothing_behind(tmp_path: Path) -> None:
    """A long run writes one that is larger every fifty frames."""
    save_state(tmp_path / "state", {"rows": torch.zeros(12_345)}, {})
    kept = len(ctypes._pointer_type_cache)  # type: ignore[attr-defined]  # for ever, a type for each length
    for rows in range(12_346, 12_366):
        save_state(tmp_path / "state", {"rows": torch.zeros(rows)}, {})
    assert len(ctypes._pointer_type_cache) == kept  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("state", "says"),
    [
        ({"model": {"_extra_state": {"generator": 3}}}, r"'model/_extra_state/generator', a int: only tensors"),
        ({"a": {"run": print}}, r"'a/run', a builtin_function"),
        ({"a/b": torch.zeros(1)}, "a slash cannot be saved"),
    ],
)
def test_what_cannot_be_saved_is_the_plugins_fault_and_named(tmp_path: Path, state: Any, says: str) -> None:
    with pytest.raises(PluginError, match=says):
        save_state(tmp_path / "state.safetensors", state, {})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-8]),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_text(json.dumps({"frame": 3})),
        lambda path: path.unlink(),
    ],
    ids=["cut", "empty", "other", "gone"],
)
def test_a_damaged_file_is_named(tmp_path: Path, damage: Callable[[Path], object]) -> None:
    path = tmp_path / "state.safetensors"
    save_state(path, {"a": torch.zeros(100)}, {})
    damage(path)
    for read in (load_state, read_header):
        with pytest.raises(DataError, match=r"state\.safetensors: not a whole file"):
            read(path)


def test_a_safetensors_file_of_somebody_elses_is_refused(tmp_path: Path) -> None:
    from safetensors.torch import save_file

    save_file({"a": torch.zeros(1)}, tmp_path / "other.safetensors")
    with pytest.raises(DataError, match="not a whole file of this program"):
        load_state(tmp_path / "other.safetensors")


def test_a_folder_that_cannot_be_written_is_an_os_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OSError, match="file"):
        save_state(tmp_path / "file" / "state.safetensors", {"a": torch.zeros(1)}, {})
