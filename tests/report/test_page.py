"""`report.html`: what is on it, that it is one file that a browser shows, that a fault costs only its part."""

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from xrdslam.core.errors import RunError
from xrdslam.pictures.panels import kept_frames
from xrdslam.report.page import write_report
from xrdslam.report.renderings import panels_figure
from xrdslam.report.run_files import read_run
from xrdslam.report.surface import distances_cm
from xrdslam.report.trajectory_view import error_of
from xrdslam.testing.toy_run import box_mesh

Browse = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def page(toy_run: Path) -> str:
    return write_report(toy_run, toy_run / "true_mesh.ply").read_text()


def slides(page: str) -> list[dict[str, object]]:
    found = re.search(r'<script type="application/json">(.*?)</script>', page)
    assert found is not None
    frames: list[dict[str, object]] = json.loads(found[1])
    return frames


def test_the_page_needs_nothing_beside_it(page: str) -> None:
    addresses = re.findall(r"(?:src=|href=|url\(|@import )[\"']?([^ >\"')]+)", page)
    assert addresses
    assert all(address.startswith("data:image/webp;base64,") for address in addresses)
    assert "http://" not in page
    assert "https://" not in page
    assert len(page) < 6_000_000
    assert page.count("<svg") == page.count("</svg>") >= 6


def test_it_says_what_was_measured_and_how(page: str, toy_run: Path) -> None:
    metrics = json.loads((toy_run / "metrics.json").read_text())
    rmse = metrics["trajectory/final/ate_rmse_cm"]
    assert f"<b>{rmse:.2f}</b>" in page
    assert metrics["trajectory/final/protocol"]["ate_alignment"] in page
    assert metrics["rendering/train/protocol"]["mask_meaning"].replace(">", "&gt;") in page
    assert "MS-SSIM has 5 scales" in page  # why that figure does not exist
    for section in ("trajectory", "renderings", "surface", "cost", "settings"):
        assert f'id="{section}"' in page
    assert "keyframe_every: 5" in page
    assert "distance to the true surface" in page
    assert "Not drawn" not in page


def test_the_slider_has_the_kept_frames_with_all_six_pictures(page: str, toy_run: Path) -> None:
    frames = slides(page)
    assert [frame["index"] for frame in frames] == kept_frames(toy_run / "renders" / "panels") == [0, 2, 4, 6, 8, 10]
    for frame in frames:
        pictures = frame["pictures"]
        assert isinstance(pictures, list)
        assert len(pictures) == 6
        assert all(picture.startswith("data:image/webp;base64,") for picture in pictures)
        assert "PSNR" in str(frame["text"])


def test_pictures_stay_within_their_budget(toy_run: Path) -> None:
    run = read_run(toy_run)
    whole = panels_figure(run)
    half = panels_figure(run, budget_bytes=len(whole) * 3 // 8)  # half of the bytes before base64
    assert 0 < len(slides(half)) < len(slides(whole))
    assert len(half) < 0.6 * len(whole)
    assert len(slides(panels_figure(run, budget_bytes=1))) == 1


def test_the_error_of_the_page_is_that_of_the_figures(toy_run: Path) -> None:
    error = error_of(read_run(toy_run))
    metrics = json.loads((toy_run / "metrics.json").read_text())
    assert error is not None
    # trajectories are written with nine decimals [m]
    assert error.rmse_cm == pytest.approx(metrics["trajectory/final/ate_rmse_cm"], abs=1e-6)


def test_distances_to_a_surface_are_those_of_a_closed_form() -> None:
    truth, moved = box_mesh(0.0), box_mesh(0.02)
    centres = moved.vertices[moved.faces].mean(1)
    assert distances_cm(centres, truth, 20_000) == pytest.approx(np.full(12, 2.0), abs=1e-9)
    assert distances_cm(truth.vertices[truth.faces].mean(1), truth, 20_000) == pytest.approx(np.zeros(12), abs=1e-9)


def test_a_part_that_cannot_be_drawn_says_why_and_leaves_the_rest(toy_run: Path, tmp_path: Path) -> None:
    shutil.copytree(toy_run, tmp_path / "run")
    (tmp_path / "run" / "map" / "mesh.ply").write_bytes(b"ply\nno mesh")
    next((tmp_path / "run" / "renders" / "panels").glob("*.jpg")).write_bytes(b"")
    text = write_report(tmp_path / "run").read_text()
    assert text.count("Not drawn: DataError") == 2
    assert "Error of the trajectory" in text


def test_a_run_without_figures_map_or_truth_still_has_a_page(toy_run: Path, tmp_path: Path) -> None:
    shutil.copytree(toy_run, tmp_path / "run")
    for name in ("metrics.json", "keyframes.json", "trajectory/ground_truth.txt", "environment.json"):
        (tmp_path / "run" / name).unlink()
    for name in ("map", "renders"):
        shutil.rmtree(tmp_path / "run" / name)
    text = write_report(tmp_path / "run").read_text()
    assert "This run has no figures" in text
    assert "estimate, not compared" in text
    assert "Not drawn" not in text


def test_what_is_no_run_or_damaged_is_named(toy_run: Path, tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"no run's folder"):
        write_report(tmp_path)
    shutil.copytree(toy_run, tmp_path / "run")
    (tmp_path / "run" / "metrics.json").write_text("{")
    with pytest.raises(RunError, match="damaged"):
        write_report(tmp_path / "run")


@pytest.mark.parametrize("width", [1280, 390])
def test_a_browser_shows_it(page: str, toy_run: Path, browse: Browse, tmp_path: Path, width: int) -> None:
    shot = tmp_path / "shot.png"
    url = (toy_run / "report.html").as_uri()
    dom = browse(url, f"--screenshot={shot}", f"--window-size={width},1600", "--dump-dom").stdout
    assert 'aria-label="frame"' in dom
    assert re.search(r"<label>frame <output>0</output>", dom), "the script ran and shows the first frame"
    assert dom.count('src="data:image/webp') == 6 + 2
    image = cv2.imread(str(shot))
    assert image is not None
    assert image.shape[1] == width
    rows = np.ptp(image.reshape(1600, -1).astype(int), axis=1)
    assert (rows > 60).mean() > 0.5, "most rows of the page show something"
