"""The run directory: every file that a run leaves, each whole or absent."""

import json
import os
import platform
import subprocess
from collections.abc import Sequence
from importlib.metadata import distributions
from pathlib import Path

import torch
from jaxtyping import Float
from omegaconf import OmegaConf
from torch import Tensor

from xrdslam.core.config import RunConfig
from xrdslam.core.errors import RunError
from xrdslam.core.files import remove_unfinished, write_text
from xrdslam.core.geometry import so3
from xrdslam.engine.build import settings_of

__all__ = ["RunDirectory"]

REPORTED = ("xrdslam", "torch", "numpy", "numba", "hydra-core", "opencv-python-headless", "scikit-image", "small_gicp")


class RunDirectory:
    """The layout of a run's results."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            for name in ("trajectory", "map", "renders"):
                (path / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunError(f"run_dir={path}: cannot be made ({error}); choose a folder that can be written") from error

    @property
    def map(self) -> Path:
        """Where the map's files go."""
        return self.path / "map"

    @property
    def map_state(self) -> Path:
        """The map's own state, for `load_run` and for other programs."""
        return self.map / "map.safetensors"

    @property
    def trajectory_state(self) -> Path:
        """Trajectory, keyframe poses and costs, to the bit."""
        return self.path / "trajectory" / "trajectory.safetensors"

    def clear(self) -> None:
        """Remove the results of an earlier run: where this one fails they would be mistaken for its own."""
        for path in (self.map_state, self.trajectory_state, self.path / "metrics.json", self.path / "timing.csv"):
            path.unlink(missing_ok=True)
        remove_unfinished(self.path)

    @property
    def renders(self) -> Path:
        """Where pictures go."""
        return self.path / "renders"

    @property
    def is_there(self) -> bool:
        """Whether the run's settings are where they were written."""
        return (self.path / "config.yaml").is_file()

    def write_settings(self, config: RunConfig, device: str) -> None:
        """Write what is known before the first frame."""
        self.write_config(config)
        self.write_environment(config, device)

    def write_config(self, config: RunConfig) -> None:
        """Write config.yaml: every setting of the run, resolved."""
        write_text(self.path / "config.yaml", OmegaConf.to_yaml(OmegaConf.create(settings_of(config))))

    def write_environment(self, config: RunConfig, device: str) -> None:
        """Write environment.json: what a reader needs to judge or repeat the run."""
        environment = {
            "versions": _versions(),
            "python": platform.python_version(),
            "platform": platform.platform(),
            "processor": _processor(),
            "cores": os.cpu_count(),
            "threads": torch.get_num_threads(),
            "device": device,
            "seed": config.seed,
            "commit": _commit(),
        }
        write_text(self.path / "environment.json", json.dumps(environment, indent=2) + "\n")

    def write_trajectory(self, name: str, timestamps_ns: Sequence[int], poses: Float[Tensor, "n 4 4"]) -> None:
        """Write trajectory/<name>.txt as TUM does: time [s], centre [m], quaternion x y z w; no row without a pose."""
        lines = ["# timestamp tx ty tz qx qy qz qw"]
        for stamp, T_world_camera in zip(timestamps_ns, poses.double(), strict=True):
            if bool(torch.isfinite(T_world_camera).all()):
                w, x, y, z = so3.to_quat_wxyz(T_world_camera[:3, :3]).tolist()
                numbers = " ".join(f"{v:.9f}" for v in (*T_world_camera[:3, 3].tolist(), x, y, z, w))
                lines.append(f"{stamp // 10**9}.{stamp % 10**9:09d} {numbers}")
        write_text(self.path / "trajectory" / f"{name}.txt", "\n".join(lines) + "\n")

    def write_keyframes(self, indices: Sequence[int], lost: Sequence[int]) -> None:
        """Write keyframes.json."""
        text = json.dumps({"keyframes": list(indices), "lost_frames": list(lost)}, indent=2)
        write_text(self.path / "keyframes.json", text + "\n")


def _versions() -> dict[str, str]:
    found = {d.metadata["Name"]: d.version for d in distributions() if d.metadata["Name"]}
    return {n: v for n, v in sorted(found.items()) if n in REPORTED or n.replace("_", "-").startswith("xrdslam-")}


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


def _commit() -> str | None:
    """Return the commit of the source tree that runs, None for an installed wheel."""
    here = Path(__file__).resolve().parent
    command = ["git", "-C", str(here), "describe", "--always", "--dirty", "--abbrev=40"]
    if not any((parent / ".git").exists() for parent in here.parents[2:4]):
        return None
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=5, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None
