"""Which program wrote a saved state: its format, its methods, their versions."""

import logging
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from xrdslam.core.config import AlgorithmConfig
from xrdslam.core.errors import RunError
from xrdslam.core.registry import Registry

__all__ = ["FORMAT", "authorship", "check_authorship", "check_format"]

FORMAT = 2
"""Raised with every change of what a saved state holds; another number is refused."""
log = logging.getLogger(__name__)


def authorship(algo: AlgorithmConfig, registry: Registry) -> dict[str, Any]:
    """Return what a header says of its writer."""
    records = {
        "algo": registry.algorithm(algo.name),
        "algo/tracking": registry.tracking_method(algo.tracking.name),
        "algo/mapping": registry.mapping_method(algo.mapping.name),
    }
    distributions = {"xrdslam": version("xrdslam")}
    for record in records.values():
        name, _, number = record.distribution.rpartition(" ")
        distributions[name] = number
    methods = {group: record.name for group, record in records.items()}
    return {"format": FORMAT, "methods": methods, "distributions": distributions}


def check_format(header: Mapping[str, Any], path: Path) -> None:
    """Raise a RunError for a state of another format than this version's."""
    if header.get("format") != FORMAT:
        raise RunError(
            f"{path}: format {header.get('format')}, this version reads format {FORMAT}; "
            "begin the run anew, or install the version that wrote it (environment.json names it)"
        )


def check_authorship(
    header: Mapping[str, Any], algo: AlgorithmConfig, registry: Registry, path: Path, same_bits: bool
) -> None:
    """Raise a RunError for the state of another method; for one of another version where the same bits are promised."""
    check_format(header, path)
    here = authorship(algo, registry)
    for group, name in here["methods"].items():
        if header["methods"].get(group) != name:
            raise RunError(f"{path}: written for {group}={header['methods'].get(group)}, not for {group}={name}")
    others = {name: number for name, number in header["distributions"].items() if here["distributions"][name] != number}
    if not others:
        return
    wrote = " ".join(f"{name}=={number}" for name, number in others.items())
    installed = ", ".join(f"{name} {here['distributions'][name]}" for name in others)
    if same_bits:
        raise RunError(
            f"{path}: written by {wrote}, installed is {installed}; `pip install {wrote}` goes on with the same bits, "
            "else begin the run anew"
        )
    log.warning("%s: written by %s, installed is %s", path, wrote, installed)
