"""Runs to report on, and a browser to look at the reports."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from xrdslam.testing.toy_run import write_toy_run

Browse = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def toy_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a finished run; tests copy it before they change it."""
    return write_toy_run(tmp_path_factory.mktemp("runs") / "toy")


@pytest.fixture
def browse(tmp_path: Path) -> Browse:
    """Return a function that opens a page in headless Chromium."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no chromium is installed: nothing can look at the page")

    def run(url: str, *options: str) -> subprocess.CompletedProcess[str]:
        quiet = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--hide-scrollbars"]
        profile = f"--user-data-dir={tmp_path / 'profile'}"
        command = [chromium, *quiet, profile, "--virtual-time-budget=3000", *options, url]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)

    return run
