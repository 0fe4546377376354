"""Where LPIPS weights come from: a path, an environment variable, or what other packages left on the machine.

Nothing is downloaded. In this order, the first that holds a backbone's weights is taken:

1. `evaluation.lpips_weights`, else the environment variable `XRDSLAM_LPIPS_WEIGHTS`: a file, or a folder with
   `lpips_<backbone>_v0.1.npz` (or .safetensors) for each backbone. Arrays are named `features.<layer>.weight`, `.bias`
   and `lin<k>`. Once given they must be right: what is wrong with them is an error, not a reason to look elsewhere.
2. torchvision's ImageNet backbone in the cache of `torch.hub`, with the heads that the package `lpips` or
   `torchmetrics` brings along.
"""

import importlib.util
import os
from collections.abc import Mapping
from pathlib import Path
from pickle import UnpicklingError
from zipfile import BadZipFile

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from xrdslam.core.errors import DataError
from xrdslam.evaluation.errors import EvaluationError
from xrdslam.evaluation.lpips import BACKBONES, Lpips

__all__ = ["VARIABLE", "find_lpips"]

VARIABLE = "XRDSLAM_LPIPS_WEIGHTS"
HUB_FILES = {"alex": "alexnet-*.pth", "squeeze": "squeezenet1_1-*.pth"}
HEADS = {"lpips": "weights/v0.1", "torchmetrics": "functional/image/lpips_models"}
"""Packages that bring the heads, and where in them."""


def find_lpips(backbone: str, path: str | None = None) -> tuple[Lpips, str]:
    """Return a backbone's measure and where its weights came from; EvaluationError says where there were none."""
    given = path or os.environ.get(VARIABLE)
    if given:
        file = _file_of(backbone, Path(given).expanduser())
        return Lpips(backbone, _read(file)), f"{file.name}, {'evaluation.lpips_weights' if path else VARIABLE}"
    features, heads = _hub_file(backbone), _heads_file(backbone)
    if features is None or heads is None:
        lacking = "backbone in torch.hub's cache" if features is None else f"heads in {' or '.join(HEADS)}"
        raise EvaluationError(
            f"no LPIPS weights for {backbone}: no evaluation.lpips_weights, no {VARIABLE}, no {lacking}"
        )
    weights = {k: v for k, v in _read(features).items() if k.startswith("features.")} | _flat_heads(_read(heads))
    return Lpips(
        backbone, weights
    ), f"{features.name} of torchvision and {heads.name} of {heads.relative_to(heads.parents[2]).parts[0]}"


def _file_of(backbone: str, given: Path) -> Path:
    """Return the file of a backbone: the given one where its name says so, or the one in the given folder."""
    names = [f"lpips_{backbone}_v0.1{suffix}" for suffix in (".npz", ".safetensors")]
    if given.is_dir():
        found = [given / name for name in names if (given / name).is_file()]
        if not found:
            raise EvaluationError(f"{given}: holds no {names[0]} (or .safetensors)")
        return found[0]
    if not given.is_file():
        raise DataError(f"evaluation.lpips_weights or {VARIABLE}: {given} is no file and no folder")
    others = [name for name in BACKBONES if name != backbone and name in given.name]
    if others and backbone not in given.name:
        raise EvaluationError(f"the given LPIPS weights, {given.name}, are those of {others[0]}, not of {backbone}")
    return given


def _hub_file(backbone: str) -> Path | None:
    return next(iter(sorted(Path(torch.hub.get_dir(), "checkpoints").glob(HUB_FILES[backbone]))), None)


def _heads_file(backbone: str) -> Path | None:
    """Return the heads in an installed package, which is not imported for it."""
    for package, folder in HEADS.items():
        spec = importlib.util.find_spec(package)
        for root in (spec.submodule_search_locations or []) if spec is not None else []:
            file = Path(root, folder, f"{backbone}.pth")
            if file.is_file():
                return file
    return None


def _flat_heads(heads: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Turn `lin0.model.1.weight`, 1x1 convolutions, into vectors `lin0`."""
    return {name.split(".")[0]: value.reshape(-1) for name, value in heads.items() if name.startswith("lin")}


def _read(file: Path) -> dict[str, Tensor]:
    """Read arrays; nothing in a file is executed."""
    try:
        if file.suffix == ".safetensors":
            return load_file(file)
        if file.suffix == ".npz":
            with file.open("rb") as opened, np.load(opened, allow_pickle=False) as arrays:
                return {name: torch.from_numpy(arrays[name]) for name in arrays.files}
        weights: dict[str, Tensor] = torch.load(file, map_location="cpu", weights_only=True)
        return weights
    except (OSError, ValueError, SafetensorError, UnpicklingError, BadZipFile, RuntimeError) as error:
        raise DataError(
            f"{file}: cannot be read as LPIPS weights ({error}); give an npz or safetensors file"
        ) from error
