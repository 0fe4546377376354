"""Whole runs, as a user starts them, measured against the bare kernel in the same session."""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import torch

from benchmarks.metric import Metric
from xrdslam.core.camera import Camera
from xrdslam.ops import splats

__all__ = ["figures_of", "methods", "startup"]

RUNS = {
    "splatam_published": ["algo=splatam", "dataset=synthetic/room0", "dataset.frames=[0,12,1]"],
    "splatam_fast": ["algo=splatam", "dataset=synthetic/room0", "dataset.frames=[0,60,1]", "preset=fast"],
    "splatam_gicp": [
        "algo=splatam",
        "algo/tracking=gicp",
        "dataset=synthetic/room0",
        "dataset.frames=[0,30,1]",
        "preset=fast",
    ],
}
"""What each run is: short cuts of the embedded room, so that every machine has them."""


def methods() -> list[Metric]:
    """Run every method and return accuracies, and iteration times as multiples of one bare render and backward."""
    metrics = []
    for name, arguments in RUNS.items():
        before = kernel_ms()
        figures = figures_of(arguments)
        yardstick = (before + kernel_ms()) / 2
        metrics += _metrics(f"methods/{name}", figures, yardstick)
    return metrics


def _metrics(key: str, figures: dict[str, float], yardstick_ms: float) -> list[Metric]:
    tracking, mapping = (figures[f"profile/{stage}_ms_per_iteration"] for stage in ("tracking", "mapping"))
    rows = [
        Metric(f"{key}/ate_rmse", figures["trajectory/final/ate_rmse_cm"], "cm", "lower", 0.25, 0.1),
        Metric(f"{key}/psnr", figures["rendering/train/psnr_db"], "dB", "higher", 0.02),
        Metric(f"{key}/depth_l1", figures["rendering/train/depth_l1_cm"], "cm", "lower", 0.25, 0.1),
        Metric(f"{key}/mapping_iteration", mapping / yardstick_ms, "renders", "lower", 0.3),
        Metric(f"{key}/peak_rss", figures["profile/peak_rss_mib"], "MiB", "lower", 0.2),
    ]
    if tracking == tracking:  # a tracker without iterations has none
        rows.append(Metric(f"{key}/tracking_iteration", tracking / yardstick_ms, "renders", "lower", 0.3))
    return rows


def figures_of(arguments: list[str]) -> dict[str, float]:
    """Carry out a run in a process of its own and return its metrics; what does not exist is NaN."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "xrdslam", *arguments, f"run_dir={folder}/run", "engine.progress=false"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        metrics = json.loads((Path(folder) / "run" / "metrics.json").read_text())
    return {k: float("nan") if v is None else v for k, v in metrics.items() if v is None or isinstance(v, int | float)}


def kernel_ms(width: int = 320, height: int = 240, rounds: int = 15) -> float:
    """Return the median time [ms] of rendering a wall of one Gaussian a pixel and going back, all gradients."""
    camera = Camera(width / 2, width / 2, (width - 1) / 2, (height - 1) / 2, width, height)
    depth = 2 + 0.3 * torch.sin(camera.pixels()[..., 0] / 20)
    means = camera.unproject(camera.pixels(), depth).reshape(-1, 3)
    log_scales = (depth.reshape(-1, 1) / camera.fx).log()
    parameters = (means, log_scales, torch.zeros(len(means), 1), torch.rand(len(means), 3, generator=_seed()))
    means, log_scales, opacity_logits, colors = (parameter.requires_grad_() for parameter in parameters)
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        image = splats.render(means, log_scales, opacity_logits, colors, torch.eye(4), camera)
        torch.autograd.backward([image.rgb.sum() + image.depth.sum()])
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)


def _seed() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def startup(rounds: int = 5) -> list[Metric]:
    """Measure `--help` in multiples of starting Python and importing Hydra, turn by turn."""
    commands = {"help": ["-m", "xrdslam", "--help"], "hydra": ["-c", "import hydra, rich"]}
    times: dict[str, list[float]] = {name: [] for name in commands}
    for _ in range(rounds):
        for name, command in commands.items():
            start = time.perf_counter()
            subprocess.run([sys.executable, *command], check=True, stdout=subprocess.DEVNULL)
            times[name].append(time.perf_counter() - start)
    ratio = statistics.median(times["help"]) / statistics.median(times["hydra"])
    return [Metric("startup/help", ratio, "starts of Hydra", "lower", 0.3)]
