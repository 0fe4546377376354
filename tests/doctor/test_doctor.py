"""Each check against what it is there for, broken on purpose: the line, and the exit status."""

import json
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterable
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from xrdslam.command_line.extras import EXTRAS, Extra
from xrdslam.core.registry import Registry
from xrdslam.doctor import computing, installation, machine, places
from xrdslam.doctor.examination import checks, examine, main
from xrdslam.doctor.finding import Finding, fail, ok, warn

PATIENCE_S = 240


def only(findings: Iterable[Finding]) -> Finding:
    (finding,) = findings
    return finding


def named(findings: Iterable[Finding], check: str) -> Finding:
    return next(finding for finding in findings if finding.check == check)


@pytest.fixture(scope="module")
def examined(tmp_path_factory: pytest.TempPathFactory) -> subprocess.CompletedProcess[str]:
    """One whole examination, in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "xrdslam.doctor", "--json"],
        cwd=tmp_path_factory.mktemp("here"),
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )


def test_all_is_well_where_the_tests_run(examined: subprocess.CompletedProcess[str]) -> None:
    assert examined.returncode == 0, examined.stdout + examined.stderr
    found = [Finding(**line) for line in json.loads(examined.stdout)]
    assert {finding.status for finding in found} <= {"ok", "warn"}
    for check in ("versions", "cores", "run folder", "shared memory", "threads", "kernel", "processes", "plugin"):
        assert named(found, check).status in ("ok", "warn"), check
    assert all(finding.advice for finding in found if finding.status != "ok")


def test_a_broken_plugin_fails_with_its_cause_and_status_1(tmp_path: Path) -> None:
    (tmp_path / "broken_slam").mkdir()
    (tmp_path / "broken_slam" / "__init__.py").write_text("import a_module_that_is_not_there")
    info = tmp_path / "broken_slam-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-slam\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text("[xrdslam]\nbroken = broken_slam\n")
    answer = subprocess.run(
        [sys.executable, "-m", "xrdslam.doctor"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )
    assert answer.returncode == 1
    line = next(line for line in answer.stdout.splitlines() if "plugin broken" in line)
    assert line.startswith("FAIL ")
    assert "broken-slam 1.2: ModuleNotFoundError: No module named 'a_module_that_is_not_there'" in line
    assert "upgrade or uninstall" in line
    assert "1 broken" in answer.stdout.splitlines()[-1]
    assert answer.stderr == ""


def test_a_method_that_does_not_import_fails_by_name() -> None:
    registry = Registry.discover([])
    assert [(f.check, f.status) for f in installation.plugins(registry)] == [("algorithms", "warn")]
    point = EntryPoint("mine", "nowhere.at_all", "xrdslam")
    finding = named(installation.plugins(Registry.discover([point])), "plugin mine")
    assert finding.status == "FAIL"


def test_lines_are_aligned_and_say_what_to_do() -> None:
    lines = [str(ok("cores", "2 of 2")), str(warn("OpenMP", "two", "mind it")), str(fail("kernel", "no", "reinstall"))]
    assert lines == [
        "ok   cores                 2 of 2",
        "warn OpenMP                two; mind it",
        "FAIL kernel                no; reinstall",
    ]


@pytest.mark.parametrize(("broken", "status"), [(False, 0), (True, 1)])
def test_the_exit_status_says_whether_anything_is_broken(
    broken: bool, status: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def check() -> Iterable[Finding]:
        yield warn("this", "is so", "mind it")
        if broken:
            raise ZeroDivisionError("a defect of the check")

    monkeypatch.setattr(
        "xrdslam.doctor.examination.checks", lambda _: {"this": check, "that": lambda: [ok("that", "")]}
    )
    with pytest.raises(SystemExit) as end:
        main([], {})
    assert end.value.code == status
    said = capsys.readouterr().out
    assert ("FAIL this" in said) == broken
    assert "ok   that" in said  # a check that raises keeps no other from being made
    assert "warnings: 1" in said


def test_every_check_is_carried_out() -> None:
    assert len(checks({})) == 15
    assert [f.status for f in examine({"a": lambda: [ok("a", "")]})] == ["ok"]


@pytest.mark.parametrize(
    ("given", "check", "status", "says"),
    [
        ({}, "OMP_WAIT_POLICY", "ok", "not set"),
        ({"OMP_WAIT_POLICY": "PASSIVE"}, "OMP_WAIT_POLICY", "ok", "PASSIVE"),
        ({"OMP_WAIT_POLICY": "active"}, "OMP_WAIT_POLICY", "warn", "spin"),
        ({"NUMBA_THREADING_LAYER": "workqueue"}, "NUMBA_THREADING_LAYER", "warn", "set omp"),
        ({"OMP_NUM_THREADS": "1"}, "OMP_NUM_THREADS", "ok", "threads="),
        ({"NUMBA_NUM_THREADS": "1000"}, "NUMBA_NUM_THREADS", "ok", "caps"),
        ({"NUMBA_NUM_THREADS": "0"}, "NUMBA_NUM_THREADS", "warn", "unset it"),
    ],
)
def test_variables_are_held_against_what_runs_want(given: dict[str, str], check: str, status: str, says: str) -> None:
    finding = named(machine.variables(given), check)
    assert finding.status == status
    assert says in str(finding)


def test_a_container_with_less_time_than_cores_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "CGROUPS", tmp_path)
    group = tmp_path / "box"
    group.mkdir()
    monkeypatch.setattr(Path, "read_text", _reading({"/proc/self/cgroup": "0::/box\n"}))
    assert machine.cgroup_cores() is None
    (group / "cpu.max").write_bytes(b"max 100000\n")
    assert machine.cgroup_cores() is None
    assert only(machine.cores()).status == "ok"
    (tmp_path / "cpu.max").write_bytes(b"50000 100000\n")  # the group above grants less
    assert machine.cgroup_cores() == 0.5
    finding = only(machine.cores())
    assert finding.status == "warn"
    assert "threads=1" in finding.advice


def _reading(texts: dict[str, str]) -> Callable[..., str]:
    original = Path.read_text
    return lambda path, *rest, **named: texts.get(str(path)) or original(path, *rest, **named)


def test_a_requirement_that_is_missing_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "requires", lambda _: ["torch>=2", "not-there>=1", "ray; extra == 'ray'"])
    finding = named(machine.versions(), "requirements")
    assert (finding.status, finding.found) == ("FAIL", "not installed: not-there>=1")


def test_extras_are_found_missing_or_there_in_part(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, none, part = ("json", "csv"), ("not_there", "nor.this"), ("json", "not_there")
    monkeypatch.setattr(
        machine, "EXTRAS", [Extra(str(i), modules, "x=y") for i, modules in enumerate((whole, none, part))]
    )
    lines = [str(finding) for finding in machine.extras()]
    assert [line.split()[0] for line in lines] == ["ok", "ok", "warn"]
    assert "not installed; pip install 'xrdslam[1]' gives x=y" in lines[1]
    assert "not_there is missing for x=y; pip install 'xrdslam[2]'" in lines[2]


def test_every_extra_that_is_declared_is_known() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    assert {extra.name for extra in EXTRAS} == set(project["optional-dependencies"]) - {"dev", "test"}


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file where a folder should be: permissions would not stop root."""
    (tmp_path / "file").touch()
    monkeypatch.setenv("XRDSLAM_CACHE", str(tmp_path / "file" / "cache"))
    finding = only(places.cache_folder())
    assert finding.status == "warn"
    assert "Not a directory" in finding.found
    assert "XRDSLAM_CACHE" in finding.advice
    finding = only(places.run_folder(tmp_path / "file" / "outputs"))
    assert finding.status == "FAIL"
    assert "run_dir=<folder>" in finding.advice
    assert only(places.run_folder(tmp_path / "new" / "outputs")).status in ("ok", "warn")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("check", "advice"), [(places.run_folder, "run_dir=<folder>"), (places.cache_folder, "XRDSLAM_CACHE")]
)
def test_little_space_is_said(
    check: Callable[[], Iterable[Finding]], advice: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XRDSLAM_CACHE", str(tmp_path))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=2**30))
    finding = only(check())
    assert finding.status == "warn"
    assert "1.0 GiB free" in finding.found
    assert advice in finding.advice


def test_little_shared_memory_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    assert only(places.shared_memory()).status == "ok"
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=2**20))
    finding = only(places.shared_memory())
    assert finding.status == "warn"
    assert "1 MiB free" in finding.found
    monkeypatch.setattr(shutil, "disk_usage", _refusing)
    assert "engine=sequential" in only(places.shared_memory()).advice
    monkeypatch.delattr(os, "memfd_create")
    assert "memfd_create" in only(places.shared_memory()).found


def _refusing(*_: object) -> None:
    raise OSError("no such device")


def test_scenes_are_found_where_they_are_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "data" / "Replica").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    found, absent = places.data(installation.discovered())
    assert "replica in data/Replica" in found.found
    assert "tum_rgbd in data/TUM_RGBD" in absent.found


def test_threads_that_are_not_those_asked_for_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("xrdslam.engine.seeding.prepare", lambda seed, threads: torch.set_num_threads(1))
    monkeypatch.setattr("xrdslam.engine.seeding.num_threads", lambda _: 3)
    finding = only(computing.threads())
    assert finding.status == "warn"
    assert "asks for 3: torch takes 1" in finding.found


def test_a_kernel_that_is_wrong_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    from xrdslam.ops import one_blob

    exact = one_blob.one_blob_torch
    assert named(computing.kernel(), "kernel").status == "ok"
    monkeypatch.setattr(one_blob, "one_blob_torch", lambda points: exact(points) * 1.01)
    finding = named(computing.kernel(), "kernel")
    assert finding.status == "FAIL"
    assert "differs from its torch twin" in finding.found


def test_a_kernel_that_does_not_compile_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: object) -> None:
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr("xrdslam.ops.one_blob.one_blob", broken)
    finding = only(computing.kernel())
    assert finding.status == "FAIL"
    assert "no locator" in finding.found
    assert "NUMBA_CACHE_DIR" in finding.advice


def test_a_kernel_cache_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    assert computing._cache(str(tmp_path)).status == "ok"
    assert computing._cache(str(tmp_path / "gone")).status == "warn"
    assert computing._cache(None).status == "warn"


def test_two_openmp_libraries_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    import threadpoolctl

    def pool(api: str, path: str) -> dict[str, object]:
        return {"user_api": api, "internal_api": "a", "num_threads": 2, "filepath": path}

    one = [pool("openmp", "/a/libgomp.so"), pool("blas", "/a/libopenblas.so")]
    monkeypatch.setattr(threadpoolctl, "threadpool_info", lambda: one)
    assert only(computing.openmp()).status == "ok"
    monkeypatch.setattr(threadpoolctl, "threadpool_info", lambda: [*one, pool("openmp", "/b/libiomp5.so")])
    finding = only(computing.openmp())
    assert finding.status == "warn"
    assert "/a/libgomp.so, /b/libiomp5.so" in finding.found


def test_an_accelerator_that_does_not_compute_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("xrdslam.engine.build.current_accelerator", lambda: None)
    assert only(computing.accelerator()).status == "ok"
    monkeypatch.setattr("xrdslam.engine.build.current_accelerator", lambda: torch.device("cpu"))
    assert "computes the torch twins, to 0e+00" in only(computing.accelerator()).found

    def refuse(*_: object) -> None:
        raise RuntimeError("no kernel image is available")

    monkeypatch.setattr("xrdslam.ops.one_blob.one_blob_torch", refuse)
    finding = only(computing.accelerator())
    assert finding.status == "warn"
    assert "device=cpu" in finding.advice


def _die() -> None:
    os._exit(3)


def test_a_process_that_cannot_start_or_dies_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(computing, "_answer", _die)
    finding = only(computing.processes())
    assert finding.status == "FAIL"
    assert "ended with 3" in finding.found
    monkeypatch.setattr("multiprocessing.process.BaseProcess.start", _refusing)
    assert "none can be started" in only(computing.processes()).found
