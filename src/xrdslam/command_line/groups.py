"""The YAML that installed distributions bring: packages named by entry points of group `xrdslam.conf`."""

import importlib.util
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

__all__ = ["CONF_GROUP", "OVERLAYS", "conf_packages", "options"]

CONF_GROUP = "xrdslam.conf"
"""The entry-point group, and the core's own package of YAML."""

OVERLAYS = {"algo": "algo", "algo/tracking": "tracking", "algo/mapping": "mapping"}
"""Each choice that settings and presets are laid over, and the folder they lie in: `settings/tracking/<method>/`."""


def conf_packages() -> dict[str, Path]:
    """Return the packages of YAML and their folders, the core's first. One that cannot be found is left out.

    The registry has reported a plugin that does not import; its settings must not cost the others theirs.
    """
    names = [CONF_GROUP, *sorted(point.value for point in entry_points(group=CONF_GROUP))]
    found = {}
    for name in names:
        try:
            spec = importlib.util.find_spec(name)
        except Exception:  # whatever a broken parent package raises
            continue
        if spec is not None and spec.submodule_search_locations:
            found[name] = Path(next(iter(spec.submodule_search_locations)))
    return found


def options(group: str) -> Iterator[str]:
    """Yield the options of a group in all packages, below it too: `replica/room0` of `dataset`."""
    for folder in conf_packages().values():
        for path in sorted((folder / group).rglob("*.yaml")):
            yield path.relative_to(folder / group).with_suffix("").as_posix()
