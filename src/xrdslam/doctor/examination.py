"""Every check, one after another: cheap ones first, so that what they find is on the screen while the others work."""

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict

from xrdslam.doctor import computing, installation, machine, places
from xrdslam.doctor.finding import Finding, fail

__all__ = ["checks", "examine", "main"]

Check = Callable[[], Iterable[Finding]]


def main(arguments: Sequence[str] | None = None, given: Mapping[str, str] | None = None) -> None:
    """Print what was found, and end with status 1 where something is broken.

    `given` is the environment as it was before anything of ours was set in it.
    """
    parser = argparse.ArgumentParser(prog="python -m xrdslam.doctor", description=__doc__)
    parser.add_argument("--json", action="store_true", help="a list of findings for programs")
    chosen = parser.parse_args(arguments)
    found = []
    for finding in examine(checks(os.environ if given is None else given)):
        found.append(finding)
        if not chosen.json:
            print(finding, flush=True)
    broken = [finding for finding in found if finding.status == "FAIL"]
    if chosen.json:
        print(json.dumps([asdict(finding) for finding in found], indent=2))
    else:
        warned = sum(finding.status == "warn" for finding in found)
        print(f"\n{f'{len(broken)} broken' if broken else 'runs can work'}; warnings: {warned}")
    sys.exit(1 if broken else 0)


def examine(checks: Mapping[str, Check]) -> Iterator[Finding]:
    """Carry checks out; one that raises is itself a finding."""
    for name, check in checks.items():
        try:
            yield from check()
        except Exception as error:  # the next check may say why
            said = " ".join(str(error).split())
            yield fail(name, f"the check itself failed ({type(error).__name__}: {said})", "see the other lines")


def checks(given: Mapping[str, str]) -> dict[str, Check]:
    """Return every check by name, those that import torch and numba last."""
    registry = installation.discovered()
    return {
        "versions": machine.versions,
        "machine": machine.machine,
        "cores": machine.cores,
        "variables": lambda: machine.variables(given),
        "extras": machine.extras,
        "run folder": places.run_folder,
        "cache folder": places.cache_folder,
        "shared memory": places.shared_memory,
        "data": lambda: places.data(registry),
        "threads": computing.threads,
        "kernel": computing.kernel,
        "openmp": computing.openmp,
        "accelerator": computing.accelerator,
        "processes": computing.processes,
        "plugins": lambda: installation.plugins(registry),
    }
