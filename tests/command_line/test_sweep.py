"""Sweeps as their users see them: real processes, under each launcher that is installed."""

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from hydra.errors import MissingConfigException

from xrdslam.command_line.explain import in_one_line
from xrdslam.command_line.ledger import LEDGER, Outcome, folder_name, names_of, read_ledger, read_outcome
from xrdslam.core.errors import ConfigError, RunError
from xrdslam.engine.earlier import left_behind
from xrdslam.engine.recorded import read_config, typed_config

LAUNCHERS = {"joblib": "joblib", "ray": "ray", "submitit_local": "submitit"}
SMALL = ["algo=toy", "dataset=synthetic/room0", "dataset.frames=[0,2,1]", "dataset.size=[32,24]", "report=false"]
SMALL += [
    "engine.progress=false",
    "evaluation.mesh_samples=0",
    "evaluation.trajectory_pictures=false",
    "sweep.dir=here",
]
PATIENCE_S = 240
PLUGIN = '''
"""Ends the process of a run with seed 1; with seed 5 or 6 says that it is there, and waits to be told to end. One with
seed 7 it ends at the third frame, once."""
import os, signal
from pathlib import Path
from xrdslam.core.hookspecs import hookimpl

@hookimpl
def xrdslam_run_started(run):
    if run.config.seed == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    if run.config.seed in (5, 6):
        (run.directory.path / "begun").write_text(str(os.getpid()))
        while True:
            signal.pause()

@hookimpl
def xrdslam_frame_tracked(run, frame, result):
    if run.config.seed == 7 and frame.index == 2 and not run.resumed_after:
        os.kill(os.getpid(), signal.SIGKILL)
'''
Sweep = Callable[..., subprocess.CompletedProcess[str]]


def installed(extra: str) -> bool:
    return importlib.util.find_spec(extra) is not None


def environment(folder: Path) -> dict[str, str]:
    """Return an environment in which the plugin above is installed: workers must find it as well."""
    folder.mkdir()
    (folder / "deadly.py").write_text(PLUGIN)
    info = folder / "deadly-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: deadly\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[xrdslam]\ndeadly = deadly\n")
    kept = {name: value for name, value in os.environ.items() if name != "HYDRA_FULL_ERROR"}
    return kept | {"PYTHONPATH": str(folder)}


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "xrdslam", "-m", *SMALL, *arguments]


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Sweep]:
    """A sweep of which one job was done, one killed, and two cannot be; and what carries it out once more."""
    folder = tmp_path_factory.mktemp("sweep")
    env = environment(folder / "plugin")

    def sweep(*arguments: str) -> subprocess.CompletedProcess[str]:
        asked = command("algo.map_every=1,0", *arguments)
        return subprocess.run(
            asked, cwd=folder, env=env, capture_output=True, text=True, check=False, timeout=PATIENCE_S
        )

    answer = sweep("seed=0,1")
    (folder / "said.txt").write_text(f"{answer.returncode}\n{answer.stdout}\n{answer.stderr}")
    return folder, sweep


def statuses(folder: Path) -> dict[str, str]:
    return {path.parent.name: json.loads(path.read_text())["status"] for path in folder.glob("*/job.json")}


def test_a_job_that_fails_costs_no_other_and_is_listed_at_the_end(swept: tuple[Path, Sweep]) -> None:
    folder, _ = swept
    status, said = (folder / "said.txt").read_text().split("\n", 1)
    assert status == "1", said
    assert statuses(folder / "here") == {
        "algo.map_every=1,seed=0": "done",
        "algo.map_every=1,seed=1": "failed",
        "algo.map_every=0,seed=0": "failed",
        "algo.map_every=0,seed=1": "failed",
    }
    assert "1 of 4 jobs done" in said
    assert f"failed  {folder}/here/algo.map_every=1,seed=1: killed by SIGKILL" in said
    assert f"failed  {folder}/here/algo.map_every=0,seed=0: algo.map_every=0: must be at least 1" in said
    assert "Traceback" not in said


def test_a_sweep_leaves_the_table_of_its_runs_and_says_how_to_go_on(swept: tuple[Path, Sweep]) -> None:
    folder, _ = swept
    said = (folder / "said.txt").read_text()
    assert f"report: {folder}/here/report.html" in said
    table = (folder / "here" / "report.md").read_text()
    assert "| synthetic/room0 | toy | 0 |" in table
    assert "algo.map_every=1,seed=1 (toy on synthetic/room0, seed 1) failed: killed by SIGKILL" in table
    assert f"sweep.dir={folder}/here sweep.skip_done=true" in said


def test_a_second_call_leaves_out_what_is_done_and_nothing_else(swept: tuple[Path, Sweep]) -> None:
    folder, sweep = swept
    done = folder / "here" / "algo.map_every=1,seed=0"
    shutil.copytree(done, folder / "here" / "algo.map_every=1,seed=2")  # seed 0's results under another's name
    before = (done / "metrics.json").read_bytes()
    answer = sweep("seed=0,2", "sweep.skip_done=true")
    assert "algo.map_every=1,seed=0 was done before" in answer.stderr
    assert "algo.map_every=1,seed=2: an earlier run there had seed=0; run anew" in answer.stderr
    assert "2 of 4 jobs done, 1 of them before" in answer.stdout
    assert (done / "metrics.json").read_bytes() == before
    assert "seed: 2" in (folder / "here" / "algo.map_every=1,seed=2" / "config.yaml").read_text()


def test_a_job_that_left_a_checkpoint_is_resumed_from_there(tmp_path: Path) -> None:
    env = environment(tmp_path / "plugin")

    def sweep(*more: str) -> subprocess.CompletedProcess[str]:
        asked = command("seed=7", "dataset.frames=[0,4,1]", "engine.checkpoint_every=1", *more)
        return subprocess.run(
            asked, cwd=tmp_path, env=env, capture_output=True, text=True, check=False, timeout=PATIENCE_S
        )

    assert sweep().returncode == 1
    run_dir = tmp_path / "here" / "run"  # nothing is swept: nothing to be named by
    assert [path.name for path in (run_dir / "checkpoint").iterdir()] == ["after_frame_000001.safetensors"]
    answer = sweep("sweep.skip_done=true")
    assert answer.returncode == 0, answer.stderr
    assert "resumed after frame 1" in (run_dir / "log.txt").read_text()
    assert len((run_dir / "trajectory" / "final.txt").read_text().splitlines()) == 5  # with its heading


def test_results_are_taken_only_where_the_very_run_came_to_its_end(swept: tuple[Path, Sweep], tmp_path: Path) -> None:
    run_dir = tmp_path / "run"
    shutil.copytree(swept[0] / "here" / "algo.map_every=1,seed=0", run_dir)
    config = typed_config(read_config(run_dir))
    config.threads = 0  # whatever the earlier call took
    assert left_behind(config, run_dir) == ("results", "")
    config.threads = 31
    assert left_behind(config, run_dir)[1].startswith("an earlier run there had threads=")
    config.threads = 0
    config.algo.keyframe_every = 77
    assert left_behind(config, run_dir)[1].startswith("an earlier run there had algo.keyframe_every=")
    config = typed_config(read_config(run_dir))
    (run_dir / "metrics.json").write_text('{"cut off')
    assert left_behind(config, run_dir)[0] == "nothing"
    (run_dir / "trajectory" / "trajectory.safetensors").unlink()
    assert "neither results nor a checkpoint" in left_behind(config, run_dir)[1]
    (run_dir / "config.yaml").unlink()
    assert left_behind(config, run_dir) == ("nothing", "an earlier call did not begin it")


def test_a_job_that_was_begun_is_not_taken_for_done(swept: tuple[Path, Sweep], tmp_path: Path) -> None:
    """A killed job leaves `running` behind, whatever lies beside it; so does one whose evaluation was interrupted."""
    from xrdslam.command_line.swept import what_to_do

    run_dir = tmp_path / "run"
    shutil.copytree(swept[0] / "here" / "algo.map_every=1,seed=0", run_dir)
    config = typed_config(read_config(run_dir))
    assert what_to_do(config, run_dir) == ("skip", "")
    Outcome("call", [], "running", run_dir=run_dir).write()
    assert what_to_do(config, run_dir)[0] == "run"
    (run_dir / "job.json").unlink()
    assert what_to_do(config, run_dir) == ("run", "")


@pytest.mark.parametrize("launcher", LAUNCHERS)
def test_launchers_run_jobs_side_by_side_on_their_share_of_the_cores(launcher: str, tmp_path: Path) -> None:
    needs(launcher)
    env = environment(tmp_path / "plugin")
    asked = command(f"launcher={launcher}", "sweep.jobs=2", "seed=0,1", "evaluation.every=2")
    answer = subprocess.run(
        asked, cwd=tmp_path, env=env, capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    assert answer.returncode == 1, answer.stderr
    assert statuses(tmp_path / "here") == {"seed=0": "done", "seed=1": "failed"}
    assert "seed=1: killed by SIGKILL" in answer.stdout
    share = max(1, len(os.sched_getaffinity(0)) // 2)
    assert f"threads: {share}\n" in (tmp_path / "here" / "seed=0" / "config.yaml").read_text()
    recorded = json.loads((tmp_path / "here" / "seed=0" / "environment.json").read_text())
    assert recorded["threads"] == share
    assert "ATE RMSE" in (tmp_path / "here" / "seed=0" / "output.txt").read_text()


@pytest.mark.parametrize("launcher", ["basic", *LAUNCHERS])
def test_ctrl_c_ends_a_sweep_with_nothing_left_running(launcher: str, tmp_path: Path) -> None:
    needs(launcher)
    jobs = ("seed=5", "seed=6")[: 1 if launcher == "basic" else 2]
    sweep, begun = waiting(launcher, jobs, tmp_path)
    os.killpg(sweep.pid, signal.SIGINT)  # as a terminal does
    assert sweep.wait(PATIENCE_S) == 130, (tmp_path / "said.txt").read_text()
    assert statuses(tmp_path / "here") == dict.fromkeys(jobs, "interrupted")
    assert "0 of 2 jobs done" in (tmp_path / "said.txt").read_text()
    assert not [pid for pid in begun if is_there(pid)]


def test_a_worker_that_dies_ends_the_sweep_and_jobs_save_what_there_is(tmp_path: Path) -> None:
    needs("joblib")
    sweep, begun = waiting("joblib", ("seed=5", "seed=6"), tmp_path)
    worker = int(Path(f"/proc/{begun[0]}/stat").read_text().rpartition(")")[2].split()[1])  # the parent
    os.kill(worker, signal.SIGKILL)
    assert sweep.wait(PATIENCE_S) == 1, (tmp_path / "said.txt").read_text()
    said = (tmp_path / "said.txt").read_text()
    assert "the launcher of the sweep ended early (TerminatedWorkerError" in said
    assert "0 of 2 jobs done" in said
    wait_until(lambda: not any(map(is_there, begun)))


def needs(launcher: str) -> None:
    extra = LAUNCHERS.get(launcher, "")
    if extra and not installed(extra):
        pytest.skip(f"extra {extra!r} is not installed: launcher={launcher} cannot be tried")


def waiting(launcher: str, jobs: Sequence[str], folder: Path) -> tuple["subprocess.Popen[bytes]", list[int]]:
    """Start a sweep of two jobs that wait to be told to end, and return it once those in `jobs` run, with their ids."""
    with (folder / "said.txt").open("w") as said:
        sweep = subprocess.Popen(
            command(f"launcher={launcher}", "sweep.jobs=2" if launcher != "basic" else "sweep.jobs=1", "seed=5,6"),
            cwd=folder,
            env=environment(folder / "plugin"),
            stdout=said,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    begun = [folder / "here" / job / "begun" for job in jobs]
    wait_until(lambda: all(path.is_file() and path.read_text() for path in begun) or sweep.poll() is not None)
    assert sweep.poll() is None, (folder / "said.txt").read_text()
    return sweep, [int(path.read_text()) for path in begun]


def is_there(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "nothing came of it"
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["run_dir=x", "seed=0,1"], "say sweep.dir=<folder>"),
        (["seed=0,0"], "seed=0: stands for more than one job"),
        (["sweep.jobs=2", "seed=0,1"], "sweep.jobs=2: launcher=basic runs one job after another"),
        (["sweep.skip_done=true", "seed=0,1"], "holds no sweep; say which one with sweep.dir=<folder>"),
        (["sweep.jobs=-1", "seed=0,1"], "sweep.jobs=-1: must be a number of jobs"),
        (["launcher=nonsense", "seed=0,1"], "no launcher=nonsense"),
        (["seed=0,x"], "Value 'x' of type 'str' could not be converted to Integer"),
    ],
)
def test_what_no_sweep_can_do_is_refused_in_one_line(arguments: Sequence[str], says: str, tmp_path: Path) -> None:
    answer = subprocess.run(
        command(*arguments), cwd=tmp_path, capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    assert answer.returncode == 1
    assert says in answer.stderr + answer.stdout
    assert "Traceback" not in answer.stderr
    assert not list(tmp_path.rglob("config.yaml"))


@pytest.mark.parametrize(("launcher", "extra"), [(key, extra) for key, extra in LAUNCHERS.items()])
def test_a_launcher_whose_extra_is_missing_names_it(launcher: str, extra: str) -> None:
    error = MissingConfigException("not there", f"hydra/launcher/{launcher}", ["basic"])
    assert in_one_line(error) == f"launcher={launcher} needs the extra {extra!r}: pip install 'xrdslam[{extra}]'"


def test_folders_are_named_by_what_is_swept() -> None:
    jobs = [["algo=toy", "dataset=replica/room0", "algo/tracking=gicp", "seed=0"]]
    assert names_of(jobs, ["seed", "dataset"]) == ["dataset=replica-room0,seed=0"]
    assert names_of(jobs, ["algo/tracking"]) == ["algo-tracking=gicp"]
    assert names_of(jobs, []) == ["run"]
    assert folder_name("dataset.frames=[0,20,1]") == "dataset.frames=-0,20,1"
    long = [folder_name("x" * 300 + end) for end in "ab"]
    assert len({*long}) == 2
    assert all(len(name) < 255 for name in long)


def test_a_damaged_ledger_or_outcome_is_named(tmp_path: Path) -> None:
    (tmp_path / LEDGER).write_text("{")
    with pytest.raises(RunError, match=LEDGER):
        read_ledger(tmp_path)
    (tmp_path / "job.json").write_text('{"what": 1}')
    with pytest.raises(RunError, match=r"job\.json"):
        read_outcome(tmp_path)
    assert read_outcome(tmp_path / "elsewhere") is None


def test_an_unfit_number_of_jobs_is_refused() -> None:
    from xrdslam.command_line.settings import SweepConfig

    with pytest.raises(ConfigError, match=r"sweep\.jobs=-1"):
        SweepConfig(jobs=-1)
