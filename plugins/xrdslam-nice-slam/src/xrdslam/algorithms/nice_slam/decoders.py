"""The decoders of occupancy: our own, which come with the package, or the published ones, by their file."""

import hashlib
from pathlib import Path
from typing import NamedTuple

import torch
from safetensors.torch import load_file
from torch import Tensor

from xrdslam.algorithms.nice_slam.grid import CHANNELS
from xrdslam.core.errors import ConfigError, DataError
from xrdslam.ops.feature_decoder import FeatureDecoder

__all__ = ["GeometryDecoders", "geometry_decoders", "published_state"]

OWN = Path(__file__).parent / "weights" / "decoders.safetensors"
PUBLISHED_SHA256 = ("40aa38f5", "f445a")
"""How the sum of the published `middle_fine.pt` begins and ends."""
PUBLISHED_PREFIXES = {"middle": "decoder.coarse.", "fine": "decoder.fine."}
"""The published checkpoint calls its middle level coarse."""


class GeometryDecoders(NamedTuple):
    """Frozen; the logit of a point is middle(p), or middle(p) + fine(p)."""

    middle: FeatureDecoder
    fine: FeatureDecoder
    are_own: bool


def geometry_decoders(path: str | None) -> GeometryDecoders:
    """Load our decoders, or with a path the published ones; DataError where the file is another one."""
    if path is None:
        state = load_file(OWN)
        states = {
            level: {k.removeprefix(f"{level}."): v for k, v in state.items() if k.startswith(f"{level}.")}
            for level in PUBLISHED_PREFIXES
        }
    else:
        check_published(Path(path))
        states = published_state(torch.load(path, map_location="cpu", weights_only=True), path)
    middle, fine = FeatureDecoder(CHANNELS, 1), FeatureDecoder(2 * CHANNELS, 1)
    for decoder, level in ((middle, "middle"), (fine, "fine")):
        try:
            decoder.load_state_dict(states[level])
        except RuntimeError as error:
            raise DataError(f"algo.map.decoders={path}: no {level} decoder of NICE-SLAM: {error}") from error
        decoder.requires_grad_(False)
    return GeometryDecoders(middle, fine, path is None)


def check_published(path: Path) -> None:
    """Refuse what is not the published file, before torch reads it."""
    if not path.is_file():
        raise ConfigError(f"algo.map.decoders={path}: no such file; leave it out for the decoders of this package")
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    found, (begin, end) = digest.hexdigest(), PUBLISHED_SHA256
    if not (found.startswith(begin) and found.endswith(end)):
        raise DataError(
            f"algo.map.decoders={path}: SHA-256 {found}, the published middle_fine.pt has {begin}...{end}; "
            "download it again, or leave the setting out for the decoders of this package"
        )


def published_state(checkpoint: object, path: str | None = None) -> dict[str, dict[str, Tensor]]:
    """Return the states of both decoders out of a published checkpoint, which holds a whole network under "model"."""
    model = checkpoint.get("model") if isinstance(checkpoint, dict) else None
    if not isinstance(model, dict):
        raise DataError(f"algo.map.decoders={path}: holds no network under the key 'model'")
    return {
        level: {k.removeprefix(prefix): v for k, v in model.items() if k.startswith(prefix)}
        for level, prefix in PUBLISHED_PREFIXES.items()
    }
