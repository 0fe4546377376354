"""What tells one group of runs from another: settings that differ, seeds aside."""

import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from xrdslam.report.run_files import RunFiles

__all__ = ["Group", "grouped"]

NOT_TELLING = ("seed", "run_dir", "report", "viewer", "threads", "device", "evaluation", "engine.progress")
"""Settings of a run that are no property of the method: where it ran, how it was watched and measured."""
NOT_TELLING_OF_DATA = ("root", "path", "cache", "on_error")


@dataclass(frozen=True, eq=False)
class Group:
    """Runs that differ in their seeds only."""

    dataset: str
    method: str
    runs: Sequence[RunFiles]


def grouped(runs: Sequence[RunFiles]) -> list[Group]:
    """Return the groups, datasets and methods in the order of the runs.

    A name is `<method>`, with the tracker or mapper where it is another's, and the preset; where two groups would have
    one name, the settings that tell them apart are added.
    """
    by_dataset = _split(runs, [_data_settings(run) for run in runs], [run.dataset for run in runs])
    groups = []
    for dataset, those in by_dataset:
        settings = [_method_settings(run) for run in those]
        groups += [Group(dataset, method, own) for method, own in _split(those, settings, [_name(r) for r in those])]
    return groups


def _split(
    runs: Sequence[RunFiles], settings: Sequence[dict[str, str]], names: Sequence[str]
) -> list[tuple[str, list[RunFiles]]]:
    """Return the runs by name and settings; names that stand for several settings say what tells them apart."""
    variants: dict[str, dict[str, list[int]]] = defaultdict(dict)
    for place, (name, own) in enumerate(zip(names, settings, strict=True)):
        variants[name].setdefault(json.dumps(own, sort_keys=True), []).append(place)
    split = []
    for name, places in variants.items():
        firsts = [settings[members[0]] for members in places.values()]
        for first, members in zip(firsts, places.values(), strict=True):
            telling = {k: v for k, v in first.items() if any(other.get(k) != v for other in firsts)}
            extra = " ".join(f"{k}={v}" for k, v in sorted(telling.items()))
            split.append((f"{name} {extra}".strip() if len(places) > 1 else name, [runs[place] for place in members]))
    return split


def _name(run: RunFiles) -> str:
    algo = run.config.get("algo", {})
    parts = [run.method]
    for part in ("tracking", "mapping"):
        chosen = str((algo.get(part) or {}).get("name", run.method))
        if chosen != run.method:
            parts.append(f"{part}={chosen}")
    preset = run.config.get("preset", "published")
    return " ".join(parts + ([f"({preset})"] if preset != "published" else []))


def _method_settings(run: RunFiles) -> dict[str, str]:
    flat = dict(_flat(run.config))
    return {k: v for k, v in flat.items() if not k.startswith("dataset.") and not _is_one_of(k, NOT_TELLING)}


def _data_settings(run: RunFiles) -> dict[str, str]:
    flat = dict(_flat(run.config.get("dataset", {})))
    return {f"dataset.{k}": v for k, v in flat.items() if not _is_one_of(k, NOT_TELLING_OF_DATA)}


def _is_one_of(key: str, prefixes: Sequence[str]) -> bool:
    return any(key == prefix or key.startswith(f"{prefix}.") for prefix in prefixes)


def _flat(settings: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for name, value in settings.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", json.dumps(value).replace(" ", "").strip('"')
