"""What is installed: plugins of entry-point group `xrdslam`, found one by one so that one fault costs one plugin."""

import difflib
import functools
import itertools
import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

import pluggy

from xrdslam.core.errors import PluginError, UnknownNameError
from xrdslam.core.hookspecs import PROJECT, REGISTRATION_HOOKS, HookSpecs
from xrdslam.core.records import (
    AlgorithmInfo,
    DatasetInfo,
    Info,
    MappingMethodInfo,
    MetricInfo,
    TrackingMethodInfo,
    ViewerInfo,
)

__all__ = ["BrokenPlugin", "Registry", "installed"]

log = logging.getLogger(__name__)
Record = TypeVar("Record", bound=Info)


@dataclass(frozen=True)
class BrokenPlugin:
    """An entry point that could not be used, and why."""

    name: str
    distribution: str
    cause: BaseException

    def __str__(self) -> str:
        return (
            f"plugin {self.name!r} of {self.distribution} cannot be used ({type(self.cause).__name__}: {self.cause}); "
            "upgrade or uninstall that distribution"
        )


class Registry:
    """Names and what they stand for, each with the distribution that registered it.

    A plugin that cannot be loaded costs one warning and raises a PluginError only when its name is asked for; so does a
    name that two distributions register. An unknown name raises an UnknownNameError saying what there is.
    """

    def __init__(self) -> None:
        self.broken: dict[str, BrokenPlugin] = {}
        self._manager = pluggy.PluginManager(PROJECT)
        self._manager.add_hookspecs(HookSpecs)
        self._distributions: dict[Any, str] = {}
        self._silenced: set[tuple[str, Any]] = set()
        self._records: dict[type[Info], dict[str, list[Info]]] = {kind: {} for kind in REGISTRATION_HOOKS.values()}

    @classmethod
    def discover(cls, points: Iterable[EntryPoint] | None = None) -> "Registry":
        """Load every installed plugin (or those given), one by one, in the order of their names."""
        registry = cls()
        found = entry_points(group=PROJECT) if points is None else points
        for point in sorted(found, key=lambda point: point.name):
            distribution = f"{point.dist.name} {point.dist.version}" if point.dist else "an unknown distribution"
            try:
                registry.register(point.load(), distribution)
            except (Exception, SystemExit) as error:
                registry.refuse(BrokenPlugin(point.name, distribution, error))
        return registry

    def __reduce__(self) -> tuple[Any, ...]:
        """Go to another process as names and import strings; run-time hooks stay where they were registered."""
        records = [claim for claims in self._records.values() for claim in itertools.chain(*claims.values())]
        return _of_records, (records,)

    def hears(self, hook: str) -> bool:
        """Say whether any plugin implements a run-time hook."""
        return bool(getattr(self._manager.hook, hook).get_hookimpls())

    def register(self, plugin: object, distribution: str) -> None:
        """Take in a module or object with hooks; raises before anything of it is taken in."""
        try:
            self._manager.register(plugin)
            self._manager.check_pending()  # finds hooks whose names are misspelt
            records = list(_returned_records(self._manager, plugin))
        except (Exception, SystemExit):
            if self._manager.is_registered(plugin):
                self._manager.unregister(plugin)
            raise
        self._distributions[plugin] = distribution
        for record in records:
            self._add(replace(record, distribution=distribution))

    @contextmanager
    def listening(self, plugin: object, whose: str) -> Iterator[None]:
        """Let an object's run-time hooks be called for a while: the viewer of one run."""
        self.register(plugin, whose)
        try:
            yield
        finally:
            self._manager.unregister(plugin)
            del self._distributions[plugin]
            self._silenced = {(hook, silenced) for hook, silenced in self._silenced if silenced is not plugin}

    def refuse(self, plugin: BrokenPlugin) -> None:
        """Record a plugin that cannot be used, with one warning."""
        if plugin.name not in self.broken:
            log.warning("%s", plugin)
        self.broken[plugin.name] = plugin

    def notify(self, hook: str, **arguments: object) -> bool:
        """Call a run-time hook of every plugin; say whether all of them, if any, heard it.

        One that raises is reported and not called again: it costs no run.
        """
        is_heard = True
        for implementation in getattr(self._manager.hook, hook).get_hookimpls():
            if (hook, implementation.plugin) in self._silenced:
                is_heard = False
                continue
            try:
                implementation.function(*[arguments[name] for name in implementation.argnames])
            except Exception as error:
                whose = self._distributions.get(implementation.plugin, "a plugin")
                log.warning("hook %s of %s raised %r; it is not called again", hook, whose, error)
                self._silenced.add((hook, implementation.plugin))
                is_heard = False
        return is_heard

    def all(self, kind: type[Record]) -> dict[str, Record]:
        """Return every usable record of a kind, by name; names that two distributions claim are left out."""
        return {name: claims[0] for name, claims in sorted(self._claims(kind).items()) if len(claims) == 1}

    def get(self, kind: type[Record], name: str) -> Record:
        """Return the record of a name, or raise an error that says what to do about it."""
        claims = self._claims(kind).get(name, [])
        if len(claims) > 1:
            raise PluginError(_clash(claims))
        if claims:
            return claims[0]
        if name in self.broken:
            raise PluginError(str(self.broken[name])) from self.broken[name].cause
        raise UnknownNameError(self._unknown(kind, name))

    def algorithm(self, name: str) -> AlgorithmInfo:
        """Return the record of an algorithm."""
        return self.get(AlgorithmInfo, name)

    def tracking_method(self, name: str) -> TrackingMethodInfo:
        """Return the record of a tracking method."""
        return self.get(TrackingMethodInfo, name)

    def mapping_method(self, name: str) -> MappingMethodInfo:
        """Return the record of a mapping method."""
        return self.get(MappingMethodInfo, name)

    def dataset(self, family: str) -> DatasetInfo:
        """Return the record of a dataset family."""
        return self.get(DatasetInfo, family)

    def metric(self, name: str) -> MetricInfo:
        """Return the record of a metric."""
        return self.get(MetricInfo, name)

    def viewer(self, name: str) -> ViewerInfo:
        """Return the record of a viewer."""
        return self.get(ViewerInfo, name)

    def _claims(self, kind: type[Record]) -> dict[str, list[Record]]:
        return self._records[kind]  # type: ignore[return-value]  # the dict maps each kind to its own records

    def _add(self, record: Info) -> None:
        claims = self._records[type(record)].setdefault(record.name, [])
        claims.append(record)
        if len(claims) > 1:
            log.warning("%s", _clash(claims))

    def _unknown(self, kind: type[Info], name: str) -> str:
        known = list(self.all(kind))
        near = difflib.get_close_matches(name, known, n=1)
        advice = f"did you mean {near[0]!r}?" if near else f"try `pip install {PROJECT}-{name.replace('_', '-')}`;"
        return f"no {kind.kind} {name!r}; {advice} installed: {', '.join(known) or 'none'}"


def _of_records(records: list[Info]) -> Registry:
    registry = Registry()
    for record in records:
        registry._records[type(record)].setdefault(record.name, []).append(record)
    return registry


@functools.cache
def installed() -> Registry:
    """Return what is installed in this environment, found once a process."""
    return Registry.discover()


def _returned_records(manager: pluggy.PluginManager, plugin: object) -> Iterator[Info]:
    """Call the registration hooks of one plugin and check what they return."""
    for caller in manager.get_hookcallers(plugin) or []:
        expected = REGISTRATION_HOOKS.get(caller.name)
        if expected is None:
            continue
        for implementation in caller.get_hookimpls():
            if implementation.plugin is plugin:
                yield from _checked(caller.name, expected, implementation.function())


def _checked(hook: str, expected: type[Info], returned: object) -> list[Info]:
    if not isinstance(returned, list) or not all(type(record) is expected for record in returned):
        raise PluginError(f"{hook} must return a list of {expected.__name__}, not {returned!r}")
    return returned


def _clash(claims: Iterable[Info]) -> str:
    first, *others = claims
    whose = ", ".join([first.distribution, *(claim.distribution for claim in others)])
    return f"{first.kind} {first.name!r} is registered by more than one distribution ({whose}); uninstall all but one"
