"""A run measured again from its directory: the same figures, or those that are asked for, and what is refused."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from xrdslam.command_line.evaluate import main
from xrdslam.core.errors import ConfigError, DataError, RunError
from xrdslam.core.surface import TriangleMesh
from xrdslam.engine.reevaluation import evaluate_again, overlaid
from xrdslam.evaluation import EvaluationConfig
from xrdslam.evaluation.surface_files import read_mesh

COMMAND = [
    "algo=splatam", "preset=small", "dataset=synthetic/room0", "dataset.size=[64,48]", "dataset.frames=[0,6,1]",
    "dataset.lighting=coarse", "threads=1", "engine.progress=false", "evaluation.every=2", "evaluation.held_out=3",
    "evaluation.pictures_every=3", "evaluation.mesh_samples=2000", "evaluation.virtual_views=4",
    "evaluation.cull_every=1", "report=false",
    "evaluation.alignment=none",  # six frames on a nearly straight way do not say how the world is turned
]  # fmt: skip


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Carry a run out with a map that is rendered and meshed, in another process."""
    folder = tmp_path_factory.mktemp("runs") / "finished"
    done = subprocess.run(
        [sys.executable, "-m", "xrdslam", *COMMAND, f"run_dir={folder}"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    (folder / "metrics.json").rename(folder / "at_the_end.json")
    return folder


def at_the_end(folder: Path) -> dict[str, Any]:
    """Return the figures that the run ended with."""
    found: dict[str, Any] = json.loads((folder / "at_the_end.json").read_text())
    return found


def test_the_figures_are_those_of_the_runs_end_to_the_bit(finished: Path) -> None:
    before = at_the_end(finished)
    pictures = {path: path.read_bytes() for path in (finished / "renders").glob("*") if path.is_file()}
    assert sum(isinstance(value, int | float) for value in before.values()) > 50
    assert len(pictures) == 2  # a picture and the rows
    (finished / "metrics.json").write_text(json.dumps({"profile/protocol": before["profile/protocol"]}))
    for path in pictures:
        path.unlink()
    again = evaluate_again(finished)
    assert again == before
    assert json.loads((finished / "metrics.json").read_text()) == before
    assert {path: path.read_bytes() for path in pictures} == pictures


def test_what_is_asked_for_changes_and_the_rest_stays(finished: Path, tmp_path: Path) -> None:
    before = at_the_end(finished)
    estimate = read_mesh(finished / "map" / "mesh.ply")
    TriangleMesh(estimate.vertices, estimate.faces).write(tmp_path / "itself.ply")
    overrides = ["mask=none", "every=1", "culling=frustum", "alignment=none"]
    again = evaluate_again(finished, [f"evaluation.{text}" for text in overrides], tmp_path / "itself.ply")
    rendering, reconstruction = (again[f"{group}/protocol"] for group in ("rendering/train", "reconstruction"))
    assert isinstance(rendering, dict)
    assert isinstance(reconstruction, dict)
    assert (rendering["mask"], rendering["frames"]) == ("none", 4)
    assert reconstruction["culling"] == "frustum"
    for key in (key for key in before if key.startswith(("trajectory/", "profile/")) and not key.endswith("protocol")):
        assert again[key] == before[key], key
    assert float(str(again["reconstruction/precision_5cm_percent"])) > 99  # the mesh against itself
    assert float(str(again["reconstruction/accuracy_cm"])) < before["reconstruction/accuracy_cm"]
    with pytest.raises(DataError, match="no such file"):
        evaluate_again(finished, [], tmp_path / "missing.ply")


def test_the_report_shows_the_surface_that_was_given(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The report of a scene whose dataset has no mesh is drawn with `--gt-mesh`, as the figures are."""
    run_dir = tmp_path / "run"
    shutil.copytree(finished, run_dir)
    config = (run_dir / "config.yaml").read_text()
    (run_dir / "config.yaml").write_text(config.replace("report: false", "report: true"))
    drawn: list[Path | None] = []
    monkeypatch.setattr("xrdslam.engine.results.write_report", lambda _, true_mesh: drawn.append(true_mesh))
    mesh = run_dir / "map" / "mesh.ply"
    evaluate_again(run_dir, ["evaluation.mesh_samples=100", "evaluation.virtual_views=0"], mesh)
    assert drawn == [mesh]


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("evaluation.held_out=4", "what it has seen it cannot unsee"),
        ("algo.map_every=2", "evaluation.<name>=<value> and nothing else"),
        ("evaluation.no_such=1", "there is every, held_out"),
        ("evaluation.every=0", "evaluation.every=0"),
        ("evaluation.mask=all", "valid_depth"),
    ],
)
def test_what_a_finished_run_cannot_take_is_refused(finished: Path, override: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        evaluate_again(finished, [override])


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="no run was begun there"):
        evaluate_again(tmp_path)


def test_overrides_have_the_types_of_the_settings() -> None:
    changed = overlaid(EvaluationConfig(every=3), ["evaluation.cull_margin_m=0.1", "evaluation.lpips_weights=here"])
    assert (changed.every, changed.cull_margin_m, changed.lpips_weights) == (3, 0.1, "here")


def test_the_command_prints_the_figures_and_says_faults_in_one_line(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(
        [
            str(finished / "trajectory" / "final.txt"),
            "--ground-truth",
            str(finished / "trajectory" / "ground_truth.txt"),
        ]
    )
    assert "ATE RMSE, final trajectory" in capsys.readouterr().out
    for arguments in ([str(tmp_path / "none")], [str(finished / "config.yaml")], [str(finished), "evaluation.every=0"]):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert str(ended.value).startswith("xrdslam: ")
        assert "\n" not in str(ended.value)


def test_the_module_runs_as_a_program(finished: Path) -> None:
    command = [sys.executable, "-m", "xrdslam.evaluation", str(finished), "evaluation.mesh_samples=500"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "PSNR, held-out views" in done.stdout
    assert json.loads((finished / "metrics.json").read_text())["reconstruction/protocol"]["samples"] == 500
