"""The command line as its users see it: real processes, their output and exit status."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

Answer = subprocess.CompletedProcess[str]
Ask = Callable[..., Answer]


@pytest.fixture
def ask(tmp_path: Path) -> Ask:
    """Run `python -m xrdslam` in an empty folder."""

    def run(*arguments: str, **environment: str) -> Answer:
        command = [sys.executable, "-m", "xrdslam", *arguments]
        kept = {name: value for name, value in os.environ.items() if name != "HYDRA_FULL_ERROR"}
        return subprocess.run(
            command, cwd=tmp_path, env=kept | environment, capture_output=True, text=True, check=False, timeout=120
        )

    return run


def in_process(code: str, cwd: Path) -> str:
    """Run Python code in a fresh interpreter and return what it printed."""
    return subprocess.run(
        [sys.executable, "-c", code], cwd=cwd, capture_output=True, text=True, check=True, timeout=120
    ).stdout


def test_help_lists_what_is_installed(ask: Ask) -> None:
    page = ask("--help")
    assert page.returncode == 0
    for name in ("splatam", "gicp", "ground_truth", "constant_velocity", "none", "replica", "seven_scenes", "room0"):
        assert name in page.stdout
    assert "[xrdslam-splatam 0" in page.stdout


@pytest.mark.parametrize(
    "arguments",
    [["--help"], ["algo=splatam", "dataset=synthetic/room0", "--cfg", "job"], ["-sc", "query=bash"]],
    ids=["help", "cfg", "completion"],
)
def test_asking_imports_nothing_heavy(arguments: list[str], tmp_path: Path) -> None:
    code = f"""
import os, sys
os.environ["COMP_LINE"] = "xrdslam algo="
sys.argv = ["xrdslam", *{arguments!r}]
from xrdslam.__main__ import main
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
print("heavy:", {{"torch", "numba", "numpy", "cv2", "scipy", "skimage"}} & set(sys.modules))
"""
    assert in_process(code, tmp_path).endswith("heavy: set()\n")


def test_the_environment_of_threads_is_set_unless_the_user_set_it(tmp_path: Path) -> None:
    code = """
import os
os.environ["NUMBA_THREADING_LAYER"] = "workqueue"
os.environ.pop("OMP_WAIT_POLICY", None)
import xrdslam.__main__
print(os.environ["OMP_WAIT_POLICY"], os.environ["NUMBA_THREADING_LAYER"])
"""
    assert in_process(code, tmp_path) == "passive workqueue\n"


def test_completion_knows_methods_scenes_and_settings(ask: Ask) -> None:
    def complete(line: str) -> set[str]:
        answer = ask("-sc", "query=bash", COMP_LINE=f"xrdslam {line}", COMP_POINT=str(8 + len(line)))
        return set(answer.stdout.split())

    assert "algo=splatam" in complete("algo=")
    assert complete("dataset=replica/room") == {f"dataset=replica/room{i}" for i in range(3)}
    assert complete("algo=splatam dataset=replica/room0 algo.tracking.it") == {"algo.tracking.iterations="}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("algo=foo dataset=replica/room0", ["no algorithm 'foo'", "splatam", "pip install xrdslam-foo"]),
        ("algo=splatm dataset=replica/room0", ["did you mean 'splatam'"]),
        ("algo=splatam dataset=replica/attic", ["no scene 'attic'", "room0", "replica/custom dataset.path="]),
        ("algo=splatam dataset=repica/room0", ["no dataset family 'repica'", "did you mean 'replica'"]),
        ("algo=splatam dataset=replica", ["names no scene", "room0"]),
        ("algo=splatam dataset=replica/room0 algo/tracking=bar", ["no tracking method 'bar'", "gicp"]),
        ("algo=splatam dataset=replica/room0 algo/mapping=gicp", ["no mapping method 'gicp'", "none, splatam"]),
        ("algo=splatam dataset=replica/room0 preset=fats", ["preset=fats", "did you mean 'fast'"]),
        ("dataset=replica/room0", ["choose algo=", "splatam"]),
        ("algo=splatam", ["choose a dataset", "synthetic/room0"]),
        ("algo=splatam dataset=replica/room0 algo.tracking.iterations=-3", ["algo.tracking.iterations=-3", "at least"]),
        ("algo=splatam dataset=replica/room0 algo.tracking.iterations=x", ["algo.tracking.iterations=x", "Integer"]),
        ("algo=splatam dataset=replica/room0 algo.tracking.no=1", ["algo.tracking.no", "SplatamTrackingConfig"]),
        ("algo=splatam dataset=replica/room0", ["dataset.root=data/Replica"]),
    ],
)
def test_what_a_user_can_mend_is_said_in_one_line_with_status_1(ask: Ask, arguments: str, says: list[str]) -> None:
    answer = ask(*arguments.split())
    assert answer.returncode == 1
    assert answer.stdout == ""
    assert answer.stderr.startswith("xrdslam: ")
    assert answer.stderr.count("\n") == 1
    for part in says:
        assert part in answer.stderr


def test_a_user_who_wants_the_traceback_gets_it(ask: Ask) -> None:
    answer = ask("algo=foo", "dataset=replica/room0", HYDRA_FULL_ERROR="1")
    assert answer.returncode == 1
    assert "Traceback" in answer.stderr


def test_a_defect_keeps_its_traceback(tmp_path: Path) -> None:
    code = """
import sys
from xrdslam import engine
def broken(*_):
    raise ZeroDivisionError("a defect")
engine.run = broken
sys.argv = ["xrdslam", "algo=splatam", "dataset=replica/room0"]
from xrdslam.__main__ import main
main()
"""
    answer = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
    )
    assert answer.returncode == 1
    assert "Traceback" in answer.stderr
    assert "ZeroDivisionError: a defect" in answer.stderr


@pytest.fixture
def broken(tmp_path: Path) -> dict[str, str]:
    """Return an environment in which a plugin is installed whose module, and whose package of YAML, do not import."""
    (tmp_path / "broken_slam").mkdir()
    (tmp_path / "broken_slam" / "__init__.py").write_text("import a_module_that_is_not_there")
    info = tmp_path / "broken_slam-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-slam\nVersion: 1.2\n")
    points = "[xrdslam]\nbroken = broken_slam.plugin\n[xrdslam.conf]\nbroken = broken_slam.conf\n"
    (info / "entry_points.txt").write_text(points)
    return {"PYTHONPATH": str(tmp_path)}


def test_a_broken_plugin_costs_one_warning_and_no_other_method(ask: Ask, broken: dict[str, str]) -> None:
    answer = ask("algo=splatam", "dataset=replica/room0", "--cfg", "job", **broken)
    assert answer.returncode == 0
    assert answer.stderr.count("\n") == 1
    for part in ("'broken'", "broken-slam 1.2", "a_module_that_is_not_there"):
        assert part in answer.stderr


def test_a_broken_plugin_is_listed_as_such_and_answers_with_its_cause(ask: Ask, broken: dict[str, str]) -> None:
    assert "broken-slam 1.2" in ask("--help", **broken).stdout.partition("Broken plugins")[2]
    answer = ask("algo=broken", "dataset=replica/room0", **broken)
    assert answer.returncode == 1
    assert "a_module_that_is_not_there" in answer.stderr.partition("xrdslam: ")[2]


def test_a_sweep_runs_every_combination_into_folders_of_its_own(ask: Ask, tmp_path: Path) -> None:
    small = ["algo=toy", "dataset=synthetic/room0", "dataset.frames=[0,2,1]", "dataset.size=[32,24]"]
    answer = ask("-m", *small, "algo/tracking=toy,ground_truth", "seed=3", "engine.progress=false", "report=false")
    assert answer.returncode == 0, answer.stderr
    configs = sorted(tmp_path.glob("outputs/sweeps/*/*/config.yaml"))
    assert [path.parent.name for path in configs] == ["algo-tracking=ground_truth", "algo-tracking=toy"]
    assert all(f"run_dir: {path.parent}" in path.read_text() for path in configs)
    assert not list(tmp_path.rglob(".hydra"))
