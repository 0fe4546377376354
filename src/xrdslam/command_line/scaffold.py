"""A new distribution to start from: a copy of the example, which is tested, under a name of the user's."""

import importlib.util
import keyword
from pathlib import Path

from xrdslam.core.errors import ConfigError

__all__ = ["example_folder", "write_distribution"]

EXAMPLE = "xrdslam.example"
PARTS = ("pyproject.toml", "README.md", "src/xrdslam_toy/*.py", "src/xrdslam_toy/py.typed", "tests/*.py")


def example_folder() -> Path:
    """Return where the example lies."""
    spec = importlib.util.find_spec(EXAMPLE)
    assert spec is not None, "the example is part of this distribution"
    assert spec.submodule_search_locations, "the example is a folder"
    return Path(next(iter(spec.submodule_search_locations)))


def write_distribution(name: str, into: Path) -> Path:
    """Write `xrdslam-<name>` into a folder and return its own; nothing that exists is touched."""
    name = name.removeprefix("xrdslam-").replace("-", "_").lower()
    if not name.isidentifier() or keyword.iskeyword(name):
        raise ConfigError(f"new {name}: a method's name is a Python name, such as my_slam")
    target = into / f"xrdslam-{name.replace('_', '-')}"
    if target.exists():
        raise ConfigError(f"new {name}: {target} exists; choose another name or folder")
    source = example_folder()
    for path in (found for pattern in PARTS for found in sorted(source.glob(pattern))):
        written = target / _renamed(path.relative_to(source).as_posix(), name)
        written.parent.mkdir(parents=True, exist_ok=True)
        written.write_text(_renamed(path.read_text(), name))
    return target


def _renamed(text: str, name: str) -> str:
    """Put a name in the place of the example's, in each way that it is written."""
    camel_case = "".join(part.capitalize() for part in name.split("_"))
    for old, new in (("xrdslam-toy", f"xrdslam-{name.replace('_', '-')}"), ("Toy", camel_case), ("toy", name)):
        text = text.replace(old, new)
    return text
