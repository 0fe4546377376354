"""The machine, what is installed on it, and what its environment says."""

import importlib.util
import os
import platform
import re
from collections.abc import Iterator, Mapping
from importlib.metadata import PackageNotFoundError, distributions, requires, version
from pathlib import Path

from xrdslam.command_line.extras import EXTRAS
from xrdslam.doctor.finding import Finding, fail, ok, warn

__all__ = ["cgroup_cores", "cores", "extras", "machine", "variables", "versions"]

SHOWN = ("torch", "numba", "numpy", "hydra-core")
CGROUPS = Path("/sys/fs/cgroup")
SET_BY_US = {
    "OMP_WAIT_POLICY": ("passive", "threads that wait spin, and starve those of the other library"),
    "NUMBA_THREADING_LAYER": ("omp", "kernels do not share their threads with torch"),
}
"""What `python -m xrdslam` sets where the user did not, and what another value costs."""
CAPS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


def versions() -> Iterator[Finding]:
    """Report ours, those of what runs rest on, and what is required and not there."""
    shown = [f"{name} {version(name)}" for name in SHOWN if _is_there(name)]
    yield ok("versions", ", ".join([f"xrdslam {version('xrdslam')}", *shown]))
    ours = sorted(
        {f"{d.name} {d.version}" for d in distributions() if d.name and d.name.replace("_", "-").startswith("xrdslam-")}
    )
    if ours:
        yield ok("distributions", ", ".join(ours))
    needed = [line.partition(";")[0] for line in requires("xrdslam") or () if "extra" not in line]
    absent = [need for need in needed if not _is_there(re.split(r"[<>=!~ \[]", need)[0])]
    if absent:
        yield fail("requirements", f"not installed: {', '.join(absent)}", "pip install --force-reinstall xrdslam")


def _is_there(distribution: str) -> bool:
    try:
        version(distribution)
    except PackageNotFoundError:
        return False
    return True


def machine() -> Iterator[Finding]:
    """Report what figures of speed depend on."""
    yield ok("python", f"{platform.python_version()} on {platform.platform()}")
    yield ok("processor", f"{_processor()}, {os.cpu_count()} cores")


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def cores() -> Iterator[Finding]:
    """Report the cores that are ours: by affinity, and by a container's share of processor time."""
    ours, share = len(os.sched_getaffinity(0)), cgroup_cores()
    if share is not None and share < ours:
        threads = max(1, int(share))
        yield warn(
            "cores",
            f"{ours} by affinity, but processor time for {share:g} (cgroup)",
            f"say threads={threads}: more wait for one another",
        )
    else:
        limit = "no limit of processor time" if share is None else f"processor time for {share:g}"
        yield ok("cores", f"{ours} of {os.cpu_count()} by affinity, {limit}")


def cgroup_cores() -> float | None:
    """Return the cores' worth of time that control groups (version 2) grant, None where they set no limit."""
    try:
        path = next(line[3:] for line in Path("/proc/self/cgroup").read_text().splitlines() if line.startswith("0::"))
    except (OSError, StopIteration):
        return None
    folder, shares = CGROUPS / path.strip("/"), []
    while folder.is_relative_to(CGROUPS):
        limit = folder / "cpu.max"
        if limit.is_file():
            quota, _, period = limit.read_text().strip().partition(" ")
            if quota != "max":
                shares.append(int(quota) / int(period))
        folder = folder.parent
    return min(shares, default=None)


def variables(given: Mapping[str, str]) -> Iterator[Finding]:
    """Report the variables that threads heed. `given` is the environment before anything of ours was set in it."""
    for name, (wanted, cost) in SET_BY_US.items():
        value = given.get(name)
        if value is None:
            yield ok(name, f"not set: `python -m xrdslam` sets {wanted}, other programs should")
        elif value.lower() == wanted:
            yield ok(name, value)
        else:
            yield warn(name, f"{value}: {cost}", f"unset it, or set {wanted}")
    for name in CAPS:
        if name in given:
            held = "caps numba's kernels" if name == "NUMBA_NUM_THREADS" else "the setting threads= goes before it"
            lower = given[name].isdigit() and int(given[name]) < len(os.sched_getaffinity(0))
            is_cap = name == "NUMBA_NUM_THREADS" and lower
            said = f"{given[name]}: {held}"
            yield warn(name, said, "unset it where runs should use all cores") if is_cap else ok(name, said)


def extras() -> Iterator[Finding]:
    """Report which optional parts are there; one that is there in part is worse than one that is not."""
    for extra in EXTRAS:
        absent = [module for module in extra.modules if not _is_found(module)]
        name = f"extra {extra.name}"
        if not absent:
            yield ok(name, f"found: {extra.gives}")
        elif len(absent) == len(extra.modules):
            yield ok(name, f"not installed; {extra.command} gives {extra.gives}")
        else:
            yield warn(name, f"in part: {', '.join(absent)} is missing for {extra.gives}", extra.command)


def _is_found(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):
        return False
