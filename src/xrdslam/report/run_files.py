"""A run read back from its directory: settings, figures, poses, costs."""

import csv
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float64
from numpy.typing import NDArray
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from xrdslam.core.errors import RunError
from xrdslam.core.geometry import so3

__all__ = ["RunFiles", "is_run", "read_run", "runs_in"]

Column = Float64[NDArray[np.float64], " _"]
Poses = Float64[NDArray[np.float64], "n 4 4"]
Settings = dict[str, Any]


@dataclass(frozen=True, eq=False)
class RunFiles:
    """What a run left. Poses are T_world_camera, a row for each tracked frame, NaN where there is none."""

    path: Path
    config: Settings
    environment: Settings
    metrics: Settings
    """Empty where the run has not been evaluated."""
    timing: dict[str, Column]
    """The columns of timing.csv."""
    frames: list[dict[str, float]]
    """The rows of renders/metrics.csv; what is missing in a row was not defined."""
    indices: list[int]
    """The frame index of each row of poses."""
    online: Poses
    final: Poses
    ground_truth: Poses | None
    keyframes: list[int]
    lost: list[int]

    @property
    def method(self) -> str:
        """The name after `algo=`."""
        return str(self.config.get("algo", {}).get("name", "?"))

    @property
    def dataset(self) -> str:
        """`<family>/<scene>`."""
        dataset = self.config.get("dataset", {})
        return f"{dataset.get('family', '?')}/{dataset.get('scene', '?')}"

    @property
    def seed(self) -> int:
        """The seed of every source of random numbers."""
        return int(self.config.get("seed", 0))

    @property
    def title(self) -> str:
        """`<method> on <dataset>`."""
        return f"{self.method} on {self.dataset}"

    @property
    def is_finished(self) -> bool:
        """Say whether the run came to its figures."""
        return bool(self.metrics)

    @property
    def is_lost(self) -> Bool[NDArray[np.bool_], " n"]:
        """Which rows kept a predicted pose."""
        return np.isin(self.indices, self.lost)

    def protocol(self, group: str) -> Settings:
        """Return how the figures of a group were measured."""
        found = self.metrics.get(f"{group}/protocol", {})
        return found if isinstance(found, dict) else {}

    def figure(self, key: str) -> float | None:
        """Return a figure, None where it does not exist."""
        value = self.metrics.get(key)
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None

    def reason(self, key: str) -> str:
        """Say why a figure does not exist."""
        group, _, name = key.rpartition("/")
        why = self.protocol(group).get("unavailable", {})
        return str(why.get(name, "it was not measured"))


def is_run(folder: Path) -> bool:
    """Say whether a folder is a run's."""
    return (folder / "config.yaml").is_file()


def runs_in(folder: Path) -> Iterator[Path]:
    """Yield the run's folder itself, or those of the runs that lie in it (a Hydra sweep), in natural order."""
    if is_run(folder):
        yield folder
        return
    found = {path.parent for path in folder.rglob("config.yaml") if path.parent.name != ".hydra"}
    yield from sorted(found, key=_natural)


def read_run(path: Path) -> RunFiles:
    """Read a run's directory; RunError where it is none, or a file of it is damaged."""
    if not is_run(path):
        raise RunError(f"{path}: no run's folder (it has no config.yaml); give the run_dir of a run, or of a sweep")
    try:
        timing = _columns(path / "timing.csv")
        stamps, poses = _trajectories(path / "trajectory")
        known = _json(path / "keyframes.json")
        indices = [int(index) for index in timing.get("index", [])][: len(stamps)]
        while len(indices) < len(stamps):  # a frame that was being processed when the run ended
            indices.append(indices[-1] + 1 if indices else 0)
        return RunFiles(
            path=path,
            config=_settings(path / "config.yaml"),
            environment=_json(path / "environment.json"),
            metrics=_json(path / "metrics.json"),
            timing=timing,
            frames=list(_rows(path / "renders" / "metrics.csv")),
            indices=indices,
            online=poses["online"],
            final=poses["final"],
            ground_truth=poses["ground_truth"] if np.isfinite(poses["ground_truth"]).any() else None,
            keyframes=[int(index) for index in known.get("keyframes", [])],
            lost=[int(index) for index in known.get("lost_frames", [])],
        )
    except (OSError, ValueError, KeyError, IndexError, OmegaConfBaseException) as error:
        raise RunError(f"{path}: a file of this run is damaged ({error}); run it again, or leave it out") from error


def _trajectories(folder: Path) -> tuple[list[str], dict[str, Poses]]:
    """Return the times of all rows as written, and each trajectory's poses in that order."""
    read = {name: _tum(folder / f"{name}.txt") for name in ("online", "final", "ground_truth")}
    stamps = sorted({stamp for poses in read.values() for stamp in poses}, key=float)
    missing = np.full((4, 4), np.nan)
    return stamps, {
        name: np.stack([poses.get(stamp, missing) for stamp in stamps]) if stamps else np.empty((0, 4, 4))
        for name, poses in read.items()
    }


def _tum(path: Path) -> dict[str, np.ndarray]:
    """Read time, centre, quaternion x y z w by the text of the time, which is exact."""
    if not path.is_file():
        return {}
    rows = [line.split() for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]
    if not rows:
        return {}
    numbers = np.array([row[1:8] for row in rows], dtype=np.float64)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, 3] = numbers[:, :3]
    poses[:, :3, :3] = so3.from_quat_wxyz(torch.from_numpy(numbers[:, [6, 3, 4, 5]].copy())).numpy()
    return {row[0]: pose for row, pose in zip(rows, poses, strict=True)}


def _columns(path: Path) -> dict[str, Column]:
    rows = list(_rows(path))
    return {name: np.array([row[name] for row in rows]) for name in rows[0]} if rows else {}


def _rows(path: Path) -> Iterator[dict[str, float]]:
    if path.is_file():
        with path.open(newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                yield {name: float(value) for name, value in row.items() if value not in ("", None)}


def _settings(path: Path) -> Settings:
    found = OmegaConf.to_container(OmegaConf.load(path))
    if not isinstance(found, dict):
        raise ValueError(f"{path.name} holds no settings")
    return {str(name): value for name, value in found.items()}


def _json(path: Path) -> Settings:
    if not path.is_file():
        return {}
    found = json.loads(path.read_text(encoding="utf-8"))
    return found if isinstance(found, dict) else {}


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort 2_x before 10_x."""
    head = path.name.partition("_")[0]
    return [(int(head) if head.isdigit() else -1, str(path))]
