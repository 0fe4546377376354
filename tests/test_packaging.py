"""What users install: wheels are built, put into an empty environment beside their dependencies, and run there."""

import ast
import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
PLUGINS = sorted(path.parent for path in ROOT.glob("plugins/*/pyproject.toml"))
TOY = ROOT / "examples" / "xrdslam-toy"
DISTRIBUTIONS = {folder.name: folder for folder in (*PLUGINS, TOY)} | {"xrdslam": ROOT}
MODULES = {"hydra-core": "hydra", "opencv-python-headless": "cv2", "pyyaml": "yaml", "scikit-image": "skimage"}
"""Distributions whose module has another name."""


@pytest.fixture(scope="session")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Build every distribution from a copy of its sources."""
    built = {}
    for name, folder in DISTRIBUTIONS.items():
        copy = tmp_path_factory.mktemp("sources") / name
        copy.mkdir()
        for part in ("src", "conf", "examples", "pyproject.toml", "setup.py", "README.md", "LICENSE"):
            if (folder / part).is_dir():
                shutil.copytree(folder / part, copy / part, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
            elif (folder / part).exists():
                shutil.copy(folder / part, copy / part)
        command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", copy.parent, copy]
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        built[name] = next(copy.parent.glob("*.whl"))
    return built


@pytest.fixture(scope="session")
def dependencies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with everything that is installed here except this project."""
    folder = tmp_path_factory.mktemp("dependencies")
    for entry in Path(sysconfig.get_paths()["purelib"]).iterdir():
        if "xrdslam" not in entry.name and not entry.name.endswith(".pth"):
            (folder / entry.name).symlink_to(entry)
    return folder


class Environment:
    """An environment of its own, with wheels installed in it."""

    def __init__(self, folder: Path, dependencies: Path, *wheels: Path) -> None:
        venv.create(folder, with_pip=False, symlinks=True)
        self.python = folder / "bin" / "python"
        self.folder = folder
        site = next(folder.glob("lib/python*/site-packages"))
        (site / "dependencies.pth").write_text(f"{dependencies}\n")
        self._check(sys.executable, "-m", "pip", "--python", self.python, "install", "--no-deps", "--no-index", *wheels)

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run Python there, away from the checkout."""
        return self._check(self.python, *arguments)

    def _check(self, *command: str | Path) -> subprocess.CompletedProcess[str]:
        kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
        done = subprocess.run(
            command, cwd=self.folder, env=kept, capture_output=True, text=True, check=False, timeout=300
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        return done


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_a_wheel_holds_every_module_and_every_setting_and_no_root(wheels: dict[str, Path], name: str) -> None:
    held = set(zipfile.ZipFile(wheels[name]).namelist())
    source = DISTRIBUTIONS[name] / "src"
    needed = {
        path.relative_to(source).as_posix()
        for kind in ("*.py", "*.yaml", "*.css", "*.js", "py.typed")
        for path in source.rglob(kind)
    }
    if name == "xrdslam":
        conf = ROOT / "conf"
        needed |= {"xrdslam/conf/" + path.relative_to(conf).as_posix() for path in conf.rglob("*.[yp]*")}
    assert needed <= held, f"missing: {sorted(needed - held)}"
    assert not {"xrdslam/__init__.py", "xrdslam/algorithms/__init__.py", "hydra_plugins/__init__.py"} & held
    surplus = {path for path in held if path.endswith((".py", ".yaml")) and "/example/" not in path} - needed
    assert not surplus, f"not in the sources: {sorted(surplus)}"


def test_the_licence_is_in_the_wheel(wheels: dict[str, Path]) -> None:
    archive = zipfile.ZipFile(wheels["xrdslam"])
    licence = next(name for name in archive.namelist() if name.endswith("licenses/LICENSE"))
    assert "Apache License" in archive.read(licence).decode()


def test_a_method_of_somebody_else_runs_from_wheels(
    wheels: dict[str, Path], dependencies: Path, tmp_path: Path
) -> None:
    environment = Environment(tmp_path, dependencies, wheels["xrdslam"], wheels["xrdslam-toy"])
    where = environment.run(
        "-c", "import xrdslam.core, xrdslam_toy; print(xrdslam.core.__file__, xrdslam_toy.__file__)"
    )
    assert where.stdout.count(str(tmp_path)) == 2
    page = environment.run("-m", "xrdslam", "--help").stdout
    assert "toy" in page
    assert "splatam" not in page
    small = ["algo=toy", "dataset=synthetic/room0", "dataset.frames=[0,3,1]", "dataset.size=[64,48]"]
    done = environment.run("-W", "error", "-m", "xrdslam", *small, "run_dir=run", "engine.progress=false")
    assert "plugin" not in done.stderr
    assert len((tmp_path / "run" / "trajectory" / "final.txt").read_text().strip().splitlines()) >= 3
    assert (tmp_path / "run" / "metrics.json").exists()


def test_our_plugins_and_a_stranger_live_side_by_side_from_wheels(
    wheels: dict[str, Path], dependencies: Path, tmp_path: Path
) -> None:
    environment = Environment(tmp_path, dependencies, *wheels.values())
    page = environment.run("-m", "xrdslam", "--help").stdout
    for plugin in PLUGINS:
        name = plugin.name.removeprefix("xrdslam-").replace("-", "_")
        assert f"[{plugin.name} " in page
        choice = [f"algo={name}", "dataset=seven_scenes/chess", "algo/tracking=toy", "--cfg", "job"]
        assert "settings: seven_scenes" in environment.run("-m", "xrdslam", *choice).stdout
        environment.run("-c", f"from xrdslam.core.registry import installed; installed().algorithm({name!r}).load()")


def test_the_console_script_is_installed(wheels: dict[str, Path], dependencies: Path, tmp_path: Path) -> None:
    environment = Environment(tmp_path, dependencies, wheels["xrdslam"])
    script = tmp_path / "bin" / "xrdslam"
    assert "none installed: pip install xrdslam-<name>" in environment._check(script, "--help").stdout


def test_a_new_distribution_keeps_its_contract_as_it_is_written(
    wheels: dict[str, Path], dependencies: Path, tmp_path: Path
) -> None:
    environment = Environment(tmp_path / "first", dependencies, wheels["xrdslam"])
    environment.run("-m", "xrdslam.plugins", "new", "my-slam")
    written = tmp_path / "first" / "xrdslam-my-slam"
    assert not [path for path in written.rglob("*") if "toy" in path.name.lower()]
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", tmp_path, written]
    subprocess.run(build, check=True, capture_output=True, timeout=300)
    second = Environment(tmp_path / "second", dependencies, wheels["xrdslam"], next(tmp_path.glob("*.whl")))
    assert "algorithm my_slam  [xrdslam-my-slam 0.1.0]" in second.run("-m", "xrdslam.plugins", "check").stdout
    tests = str(written / "tests")
    assert " passed" in second.run("-m", "pytest", "-p", "no:cacheprovider", "--rootdir", tests, tests).stdout
    again = subprocess.run(
        [second.python, "-m", "xrdslam.plugins", "new", "my-slam", "--into", tmp_path / "first"],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert again.returncode == 1
    assert "exists" in again.stderr


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_what_is_imported_is_declared(name: str) -> None:
    """What the core depends on comes with it; tests may also use what its own tests need."""
    folder, core = DISTRIBUTIONS[name], _project(ROOT)
    optional = [extra for extras in _project(folder).get("optional-dependencies", {}).values() for extra in extras]
    required = [*_project(folder)["dependencies"], *core["dependencies"], *optional]
    ours = {"omegaconf", "xrdslam", "hydra_plugins", name.replace("-", "_"), *sys.stdlib_module_names}
    ours |= {"benchmarks"} if folder == ROOT else set()
    for part, extra in (("src", []), ("tests", core["optional-dependencies"]["test"])):
        declared = ours | {_module(requirement) for requirement in (*required, *extra)}
        imported = {path: _imported(path) for path in (folder / part).rglob("*.py")}
        undeclared = {str(path): names - declared for path, names in imported.items() if names - declared}
        assert not undeclared


def _project(folder: Path) -> dict[str, Any]:
    project: dict[str, Any] = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    return project


def _imported(path: Path) -> set[str]:
    """Return the top-level modules that a file imports, wherever in it."""
    nodes = list(ast.walk(ast.parse(path.read_text())))
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    return {name.partition(".")[0] for name in names}


def _module(requirement: str) -> str:
    """Return the module that a requirement brings."""
    name = requirement
    for end in "[<>=!~; ":
        name = name.partition(end)[0]
    return MODULES.get(name, name.replace("-", "_"))
