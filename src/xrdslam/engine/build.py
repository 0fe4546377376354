"""From settings to objects: what the registry says stands behind each name."""

import dataclasses

import numpy as np
import torch

from xrdslam.core.algorithm import Algorithm
from xrdslam.core.config import AlgorithmConfig, RunConfig
from xrdslam.core.dataset import Dataset
from xrdslam.core.errors import ConfigError
from xrdslam.core.registry import Registry, installed
from xrdslam.methods.relocalisation import OrbRelocaliser

__all__ = ["algorithm_of", "build_algorithm", "build_dataset", "current_accelerator", "resolve_device", "settings_of"]


def build_dataset(config: RunConfig, registry: Registry | None = None) -> Dataset:
    """Open the dataset of a run and check everything that can be checked before the first frame."""
    registry = registry or installed()
    dataset = registry.dataset(config.dataset.family).load()(config.dataset)
    assert isinstance(dataset, Dataset), f"{type(dataset).__name__} is no Dataset"
    dataset.check()
    return dataset


def build_algorithm(
    config: AlgorithmConfig, seed: int = 0, device: str = "cpu", registry: Registry | None = None, hold_out: int = 0
) -> Algorithm:
    """Compose an algorithm; tracking and mapping draw from streams of their own, both fixed by `seed`.

    `hold_out` keeps every n-th frame from the map (`evaluation.held_out`).
    """
    registry = registry or installed()
    seeds = [int(word) for word in np.random.SeedSequence(seed).generate_state(3)]
    tracking = registry.tracking_method(config.tracking.name).load()(config.tracking, seed=seeds[0])
    mapping = registry.mapping_method(config.mapping.name).load()(config.mapping, seed=seeds[1])
    algorithm = registry.algorithm(config.name).load()(config, tracking, mapping, device)
    assert isinstance(algorithm, Algorithm), f"{type(algorithm).__name__} is no Algorithm"
    algorithm.hold_out = hold_out
    if config.tracking.relocalise:
        algorithm.relocaliser = OrbRelocaliser(seeds[2])
    return algorithm


def algorithm_of(config: RunConfig, device: str, registry: Registry) -> Algorithm:
    """Compose the algorithm of a run; every process of it that asks builds an equal one."""
    return build_algorithm(config.algo, config.seed, device, registry, config.evaluation.held_out)


def resolve_device(name: str) -> str:
    """Return a device that torch has, or say which it has."""
    accelerator = current_accelerator()
    if name == "auto":
        return "cpu" if accelerator is None else str(accelerator)
    try:
        torch.empty(0, device=name)
    except (RuntimeError, AssertionError) as error:
        has = "cpu" if accelerator is None else f"cpu, {accelerator}"
        raise ConfigError(f"device={name}: not usable here ({str(error).splitlines()[0]}); there is {has}") from error
    return name


def current_accelerator() -> torch.device | None:
    """Return the accelerator that torch would use, if any (torch names it from 2.6 on; before, `device=` must)."""
    accelerator = getattr(torch, "accelerator", None)
    return accelerator.current_accelerator() if accelerator is not None and accelerator.is_available() else None


def settings_of(config: RunConfig) -> dict[str, object]:
    """Return a run's settings as plain data."""
    return dataclasses.asdict(config)
