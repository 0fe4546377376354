"""Plugins are found one by one: what one of them does wrong costs that one, and the message says whose it is."""

import dataclasses
import itertools
import logging
from collections.abc import Callable
from pathlib import Path

import pytest

from xrdslam.core.errors import PluginError, UnknownNameError
from xrdslam.core.hookspecs import REGISTRATION_HOOKS, hookimpl
from xrdslam.core.records import AlgorithmInfo, TrackingMethodInfo
from xrdslam.core.registry import Registry

Install = Callable[..., None]
SERIAL = itertools.count()

GOOD = """
from xrdslam.core.hookspecs import hookimpl
from xrdslam.core.records import AlgorithmInfo

@hookimpl
def xrdslam_algorithms():
    return [AlgorithmInfo("{name}", "nowhere:Nothing", "nowhere:Config", "a method")]
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Put a distribution with one plugin where Python looks, as an installer would."""
    monkeypatch.syspath_prepend(tmp_path)

    def put(distribution: str, source: str, version: str = "1.2", point: str = "") -> None:
        module = f"{distribution.replace('-', '_')}_plugin_{next(SERIAL)}"  # a module is imported once a process
        (tmp_path / f"{module}.py").write_text(source)
        info = tmp_path / f"{distribution.replace('-', '_')}-{version}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: {version}\n")
        (info / "entry_points.txt").write_text(f"[xrdslam]\n{point or distribution} = {module}\n")

    return put


def test_a_record_knows_its_distribution_and_version(install: Install) -> None:
    install("other-slam", GOOD.format(name="other"))
    assert Registry.discover().algorithm("other").distribution == "other-slam 1.2"


def test_a_broken_plugin_costs_one_warning_and_nothing_else(install: Install, caplog: pytest.LogCaptureFixture) -> None:
    install("broken-slam", "import a_module_that_is_not_there", version="3.4", point="broken")
    install("other-slam", GOOD.format(name="other"))
    with caplog.at_level(logging.WARNING):
        registry = Registry.discover()
    assert registry.algorithm("other").name == "other"
    assert len(caplog.records) == 1
    for part in ("'broken'", "broken-slam 3.4", "ModuleNotFoundError", "a_module_that_is_not_there"):
        assert part in caplog.text


def test_a_broken_plugin_raises_with_its_cause_when_it_is_asked_for(install: Install) -> None:
    install("broken-slam", "raise RuntimeError('no licence today')", point="broken")
    registry = Registry.discover()
    with pytest.raises(PluginError, match=r"'broken' of broken-slam 1\.2.*RuntimeError: no licence today") as caught:
        registry.algorithm("broken")
    assert isinstance(caught.value.__cause__, RuntimeError)


@pytest.mark.parametrize(
    ("source", "cause"),
    [
        ("raise SystemError('x')", "SystemError"),
        ("raise SystemExit(0)", "SystemExit"),
        ("def f(:", "SyntaxError"),
        (GOOD.format(name="a").replace("return [", "return 3 or ["), "list of AlgorithmInfo"),
        (GOOD.format(name="a").replace("return [", "raise ValueError('late') or ["), "late"),
        (GOOD.format(name="a").replace("xrdslam_algorithms", "xrdslam_algoritms"), "xrdslam_algoritms"),
        (GOOD.format(name="a").replace("algorithms()", "algorithms(self_made)"), "self_made"),
        (GOOD.format(name="a").replace("AlgorithmInfo", "DatasetInfo"), "list of AlgorithmInfo"),
    ],
    ids=[
        "raises",
        "exits",
        "does not parse",
        "returns no list",
        "hook raises",
        "misspelt",
        "wrong argument",
        "wrong record",
    ],
)
def test_whatever_a_plugin_does_wrong_is_found_at_discovery_and_is_its_own(
    install: Install, source: str, cause: str
) -> None:
    install("bad-slam", source, point="bad")
    install("other-slam", GOOD.format(name="other"))
    registry = Registry.discover()
    assert registry.algorithm("other").name == "other"
    assert cause in str(registry.broken["bad"])
    assert "a" not in registry.all(AlgorithmInfo)
    registry.register(object(), "late 1.0")  # nothing of the bad one is left that would fail again


def test_two_distributions_with_one_name_are_both_named_and_neither_is_taken(
    install: Install, caplog: pytest.LogCaptureFixture
) -> None:
    install("first-slam", GOOD.format(name="same"))
    install("second-slam", GOOD.format(name="same"), version="2.0")
    with caplog.at_level(logging.WARNING):
        registry = Registry.discover()
    assert "first-slam 1.2, second-slam 2.0" in caplog.text
    assert len(caplog.records) == 1
    assert "same" not in registry.all(AlgorithmInfo)
    with pytest.raises(PluginError, match=r"first-slam 1\.2, second-slam 2\.0"):
        registry.algorithm("same")


def test_one_name_may_stand_for_an_algorithm_and_a_tracking_method(install: Install) -> None:
    both = GOOD.format(name="both") + GOOD.format(name="both").replace("AlgorithmInfo", "TrackingMethodInfo").replace(
        "xrdslam_algorithms", "xrdslam_tracking_methods"
    )
    install("both-slam", both)
    registry = Registry.discover()
    assert type(registry.algorithm("both")) is AlgorithmInfo
    assert type(registry.tracking_method("both")) is TrackingMethodInfo


def test_a_near_miss_is_corrected_and_a_stranger_is_told_what_to_install(install: Install) -> None:
    install("other-slam", GOOD.format(name="other"))
    registry = Registry.discover()
    with pytest.raises(UnknownNameError, match=r"no algorithm 'othr'; did you mean 'other'\?.*installed:.*other"):
        registry.algorithm("othr")
    with pytest.raises(UnknownNameError, match=r"no algorithm 'new_method'.*`pip install xrdslam-new-method`"):
        registry.algorithm("new_method")


def test_an_empty_registry_says_so() -> None:
    with pytest.raises(UnknownNameError, match="installed: none"):
        Registry().viewer("any")


def test_a_target_that_does_not_import_is_a_plugin_error_with_the_distribution(install: Install) -> None:
    install("other-slam", GOOD.format(name="other"))
    with pytest.raises(PluginError, match=r"other-slam 1\.2.*'nowhere:Nothing'.*ModuleNotFoundError"):
        Registry.discover().algorithm("other").load()


def test_the_core_registers_its_own_through_the_same_hooks() -> None:
    registry = Registry.discover()
    for name in ("ground_truth", "constant_velocity", "gicp"):
        assert registry.tracking_method(name).distribution.startswith("xrdslam ")
    assert registry.mapping_method("none").distribution.startswith("xrdslam ")
    for family in ("synthetic", "replica", "seven_scenes"):
        assert registry.dataset(family).distribution.startswith("xrdslam ")


def test_every_registered_target_and_configuration_imports() -> None:
    registry = Registry.discover()
    assert not registry.broken
    for kind in REGISTRATION_HOOKS.values():
        for info in registry.all(kind).values():
            assert isinstance(info.load(), type), info
            assert dataclasses.is_dataclass(info.load_config()), info


class Watcher:
    """A plugin with run-time hooks that read fewer arguments than there are."""

    def __init__(self, fails: bool = False) -> None:
        self.heard: list[object] = []
        self.fails = fails


def _watcher(fails: bool = False) -> Watcher:
    from xrdslam.core.hookspecs import hookimpl

    class Plugin(Watcher):
        @hookimpl
        def xrdslam_frame_tracked(self, frame: object) -> None:
            self.heard.append(frame)
            if self.fails:
                raise ZeroDivisionError("one division too many")

    return Plugin(fails)


def test_run_time_hooks_hear_what_they_ask_for_and_a_failing_one_is_silenced(
    caplog: pytest.LogCaptureFixture,
) -> None:
    registry = Registry()
    good, bad = _watcher(), _watcher(fails=True)
    registry.register(good, "good 1.0")
    registry.register(bad, "bad 1.0")
    for frame in ("first", "second", "third"):
        registry.notify("xrdslam_frame_tracked", run=None, frame=frame, result=None)
    assert good.heard == ["first", "second", "third"]
    assert bad.heard == ["first"]
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "bad 1.0" in caplog.text
    assert "one division too many" in caplog.text


def test_a_listener_hears_for_as_long_as_it_is_let(caplog: pytest.LogCaptureFixture) -> None:
    class Viewer:
        heard = 0

        @hookimpl
        def xrdslam_run_started(self) -> None:
            self.heard += 1
            if self.heard == 2:
                raise ValueError("not now")

    registry, viewer = Registry(), Viewer()
    for _ in range(2):
        with registry.listening(viewer, "viewer=test"):
            registry.notify("xrdslam_run_started", run=None)
            registry.notify("xrdslam_run_started", run=None)
            registry.notify("xrdslam_run_started", run=None)
    registry.notify("xrdslam_run_started", run=None)
    assert viewer.heard == 2 + 3, "silenced after its fault, and no longer than it listened"
    assert "viewer=test raised" in caplog.text
