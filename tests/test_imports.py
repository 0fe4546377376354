"""Who may import whom, read off the source of every portion; and what must cost nothing to import."""

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PLUGINS = sorted(path.parent for path in ROOT.glob("plugins/*/pyproject.toml"))
PORTIONS = [ROOT / "src", *(plugin / "src" for plugin in PLUGINS)]

MAY_IMPORT: dict[str, set[str]] = {
    "core": set(),
    "ops": {"core"},
    "datasets": {"core", "ops"},
    "evaluation": {"core", "ops", "pictures"},
    "methods": {"core", "ops"},
    "pictures": {"core", "ops"},
    "report": {"core", "evaluation", "pictures"},
    "viewer": {"core", "evaluation", "pictures", "report"},
    "engine": {"core", "ops", "datasets", "evaluation", "methods", "report"},
    "testing": {"core", "ops", "datasets", "evaluation", "methods", "engine", "pictures"},
    "builtin": {"core"},
    "command_line": {"core", "datasets", "evaluation", "engine", "report"},
    "doctor": {"core", "ops", "datasets", "engine", "command_line"},
    "plugins": {"core", "command_line"},
    "__main__": {"command_line"},
    "hydra_plugins": {"core", "command_line"},
    "algorithms": {"core", "ops"},
}
"""Each part of the house, and which others it may import, beside itself."""


SOURCES = [path for portion in PORTIONS for path in sorted(portion.rglob("*.py"))]


def module_of(path: Path) -> tuple[str, ...]:
    portion = next(portion for portion in PORTIONS if path.is_relative_to(portion))
    parts = path.relative_to(portion).with_suffix("").parts
    return parts[:-1] if parts[-1] == "__init__" else parts


def part_of(module: tuple[str, ...]) -> str:
    """`core` of xrdslam.core.camera; `algorithms` of a plugin; `__main__` of what only starts a command line."""
    if module in (("xrdslam", "datasets", "__main__"), ("xrdslam", "evaluation", "__main__")):
        return "__main__"
    return module[1] if module[0] == "xrdslam" else module[0]


def imported(path: Path) -> set[tuple[str, ...]]:
    """Return every module that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {tuple(alias.name.split(".")) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            base = tuple((node.module or "").split("."))
            found |= {(*base, alias.name) for alias in node.names}
    return found


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: ".".join(module_of(path)))
def test_a_part_imports_only_what_it_may(path: Path) -> None:
    module = module_of(path)
    part = part_of(module)
    for name in imported(path):
        if name[0] != "xrdslam" or len(name) == 1:
            continue
        other = part_of(name)
        assert other == part or other in MAY_IMPORT[part], f"{'.'.join(module)} imports {'.'.join(name)}"
        if part == other == "algorithms":
            assert name[2] == module[2], f"plugin {module[2]} imports plugin {name[2]}"


def test_the_rules_are_about_every_part_that_there_is() -> None:
    assert {part_of(module_of(path)) for path in SOURCES} - {"xrdslam"} <= set(MAY_IMPORT)


def test_the_rules_find_what_they_forbid(tmp_path: Path) -> None:
    source = tmp_path / "example.py"
    source.write_text("def f():\n    from xrdslam.engine import run\n    import xrdslam.viewer.live\n")
    assert imported(source) == {("xrdslam", "engine", "run"), ("xrdslam", "viewer", "live")}


@pytest.mark.parametrize("portion", PORTIONS, ids=lambda portion: portion.parent.name)
def test_nothing_lies_at_the_roots_of_the_namespaces(portion: Path) -> None:
    """One stray file there hides every other portion from Python."""
    for root in ("xrdslam", "xrdslam/algorithms", "hydra_plugins"):
        assert not (portion / root / "__init__.py").exists()


def test_the_core_names_no_plugin() -> None:
    words = {plugin.name.removeprefix("xrdslam-").replace("-", "_") for plugin in PLUGINS}
    for path in (*(ROOT / "src").rglob("*.py"), *(ROOT / "conf").rglob("*.yaml")):
        code = _without_comments(path) if path.suffix == ".py" else path.read_text()
        assert not words & set(_words(code)), f"{path.relative_to(ROOT)} names a plugin"


def _without_comments(path: Path) -> str:
    """Return a file's code: docstrings may cite a paper, code may not know a method."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        for block in ("body", "orelse", "finalbody"):
            statements = getattr(node, block, None)
            if isinstance(statements, list):
                kept = [s for s in statements if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant))]
                setattr(node, block, kept)
    return ast.unparse(tree)


def _words(text: str) -> list[str]:
    return "".join(c if c.isalnum() or c == "_" else " " for c in text.lower()).split()


def test_the_type_checker_is_told_of_every_portion() -> None:
    """`mypy -p xrdslam` would check the first one and be silent about the rest."""
    files = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mypy"]["files"]
    examples = sorted(path.parent for path in ROOT.glob("examples/*/pyproject.toml"))
    assert files == [str((folder / "src").relative_to(ROOT)) for folder in (ROOT, *PLUGINS, *examples)]


def test_every_part_says_that_it_is_typed() -> None:
    for portion in PORTIONS:
        for package in (*portion.glob("xrdslam/[a-z]*/"), *portion.glob("xrdslam/algorithms/*/")):
            if any(package.glob("*.py")):
                assert (package / "py.typed").exists(), f"{package} has no py.typed"


CHEAP = [
    "xrdslam.core",
    "xrdslam.core.config",
    "xrdslam.core.errors",
    "xrdslam.core.registry",
    "xrdslam.builtin",
    "xrdslam.command_line.help",
    "xrdslam.command_line.schemas",
    "xrdslam.datasets.config",
    "xrdslam.evaluation.config",
    "xrdslam.methods.config",
    "xrdslam.viewer.config",
    *(f"xrdslam.algorithms.{plugin.name.removeprefix('xrdslam-').replace('-', '_')}.plugin" for plugin in PLUGINS),
    *(f"xrdslam.algorithms.{plugin.name.removeprefix('xrdslam-').replace('-', '_')}.config" for plugin in PLUGINS),
]


def test_names_and_settings_import_nothing_heavy() -> None:
    code = f"""
import importlib, sys
for name in {CHEAP!r}:
    importlib.import_module(name)
    heavy = {{"torch", "numba", "numpy", "scipy", "cv2", "skimage"}} & set(sys.modules)
    assert not heavy, f"{{name}} imports {{heavy}}"
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
