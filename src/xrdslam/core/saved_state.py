"""A nest of tensors with a header of plain data, in one file that appears whole or not at all.

The file is safetensors, its header JSON in the file's own metadata: reading it executes nothing.
"""

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file as save_arrays
from safetensors.torch import save_file as save_tensors
from torch import Tensor

from xrdslam.core.errors import DataError, PluginError
from xrdslam.core.files import replaced

__all__ = ["load_state", "read_header", "save_state"]

METADATA = "xrdslam"
"""Where in safetensors' metadata our header lies."""
NUMPY_HAS = frozenset(
    {torch.bool, torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64}
    | {torch.float16, torch.float32, torch.float64}
)


def save_state(path: Path, state: Mapping[str, object], header: Mapping[str, object]) -> None:
    """Write nested mappings of tensors, on whatever device, and a header that JSON can hold.

    PluginError where a leaf is no tensor: what a checkpoint cannot hold, a resumed run would lack.
    """
    tensors: dict[str, Tensor] = {}
    stored: set[int] = set()
    for key, tensor in _leaves(state):
        kept = tensor.detach().to("cpu").contiguous()
        address = kept.untyped_storage().data_ptr()
        tensors[key] = kept.clone() if address in stored else kept  # a file has no two names for one memory
        stored.add(address)
    text = json.dumps({"header": dict(header), "empty": list(_empty(state))})
    with replaced(path) as temporary:
        try:
            _write(temporary, tensors, {METADATA: text})
        except SafetensorError as error:  # what the system refuses arrives under this name
            raise OSError(f"{path} cannot be written: {error}") from error
        with temporary.open("rb") as written:
            os.fsync(written.fileno())  # an older file may go once this one has its name


def _write(path: Path, tensors: dict[str, Tensor], metadata: dict[str, str]) -> None:
    """Write tensors as arrays, but for types that numpy lacks: the other way keeps two types a length for ever."""
    if all(tensor.dtype in NUMPY_HAS for tensor in tensors.values()):
        save_arrays({name: tensor.numpy() for name, tensor in tensors.items()}, path, metadata)
    else:
        save_tensors(tensors, path, metadata)


def load_state(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the nest and the header of a file that `save_state` wrote; DataError where it is damaged or another's."""
    header, empty, tensors = _read(path, with_tensors=True)
    nest: dict[str, Any] = {}
    for key in empty:
        _place(nest, key, {})
    for key, tensor in tensors.items():
        _place(nest, key, tensor)
    return nest, header


def read_header(path: Path) -> dict[str, Any]:
    """Return the header alone."""
    return _read(path, with_tensors=False)[0]


def _read(path: Path, with_tensors: bool) -> tuple[dict[str, Any], list[str], dict[str, Tensor]]:
    try:
        with safe_open(path, "pt") as file:
            about = json.loads((file.metadata() or {})[METADATA])
            # Copies lie where torch puts its tensors: a kernel that reads aligned memory then gives the same bits.
            names = file.keys() if with_tensors else ()
            return about["header"], about["empty"], {name: file.get_tensor(name).clone() for name in names}
    except (SafetensorError, OSError, KeyError, ValueError) as error:
        raise DataError(f"{path}: not a whole file of this program's ({type(error).__name__}: {error})") from error


def _leaves(tree: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, Tensor]]:
    for key, value in tree.items():
        path = f"{prefix}{key}"
        if "/" in key:
            raise PluginError(f"state_dict() has the name {path!r}: a slash cannot be saved, use dots")
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{path}/")
        elif isinstance(value, Tensor):
            yield path, value
        else:
            raise PluginError(
                f"state_dict() has {path!r}, a {type(value).__name__}: only tensors are saved, for a file must not "
                "execute code when it is read; give numbers as a tensor (get_extra_state too)"
            )


def _empty(tree: Mapping[str, object], prefix: str = "") -> Iterator[str]:
    """Yield the mappings without entries, which a list of tensors has no place for."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _empty(value, f"{prefix}{key}/") if value else (f"{prefix}{key}",)


def _place(nest: dict[str, Any], path: str, value: object) -> None:
    *folders, name = path.split("/")
    for folder in folders:
        nest = nest.setdefault(folder, {})
    nest[name] = value
