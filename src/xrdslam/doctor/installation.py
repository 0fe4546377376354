"""Plugins: whether what is registered can be used."""

import logging
from collections.abc import Iterator

from xrdslam.core.errors import XrdslamError
from xrdslam.core.hookspecs import REGISTRATION_HOOKS
from xrdslam.core.records import AlgorithmInfo
from xrdslam.core.registry import Registry
from xrdslam.doctor.finding import Finding, fail, ok, warn

__all__ = ["discovered", "plugins"]


def discovered() -> Registry:
    """Find what is installed; what is broken is for the report, not for the log."""
    log = logging.getLogger("xrdslam.core.registry")
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        return Registry.discover()
    finally:
        log.setLevel(before)


def plugins(registry: Registry) -> Iterator[Finding]:
    """Report each plugin that is broken with its cause, and how many names the others bring."""
    for plugin in registry.broken.values():
        yield fail(f"plugin {plugin.name}", f"{plugin.distribution}: {_cause(plugin.cause)}", "upgrade or uninstall it")
    sound: dict[str, list[str]] = {}
    for kind in REGISTRATION_HOOKS.values():
        for info in registry.all(kind).values():
            try:
                info.load()
                if info.config:
                    info.load_config()()
            except XrdslamError as error:
                yield fail(f"{info.kind} {info.name}", _cause(error), "upgrade or uninstall that distribution")
            else:
                sound.setdefault(info.distribution, []).append(info.name)
    for distribution, names in sorted(sound.items()):
        yield ok("plugin", f"{distribution}: {', '.join(dict.fromkeys(names))}")
    if not registry.all(AlgorithmInfo):
        yield warn("algorithms", "no method is installed", "pip install xrdslam-<name>")


def _cause(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
