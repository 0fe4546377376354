"""Traces of a run are found, and nobody else's."""

import subprocess
import sys
from multiprocessing import get_context
from pathlib import Path

from xrdslam.testing.traces import Traces

SLEEPER = """
import multiprocessing, sys, tempfile
lock = multiprocessing.get_context("spawn").Lock()
open(tempfile.mkstemp()[1], "w")
print(lock._semlock.name, flush=True)
sys.stdin.read()
"""


def test_a_process_its_memory_and_its_files_are_found_and_nobody_elses(tmp_path: Path) -> None:
    lock = get_context("spawn").Lock()
    traces, others = Traces(tmp_path / "traces"), Traces(tmp_path / "others")
    pipe = subprocess.PIPE
    command = [sys.executable, "-c", SLEEPER]
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=traces.environment) as process:
        assert process.stdout is not None
        name = process.stdout.readline().strip()
        assert process.pid in traces.processes()
        assert others.processes() == {}
        traces.look()
        left = traces.left()
        assert f"/dev/shm/sem.{name.removeprefix('/')}" in left
        assert len([item for item in left if item.startswith("/dev/shm/")]) == 1
        assert len([item for item in left if item.startswith(str(traces.folder))]) == 1
        process.communicate("")
    assert [item for item in traces.left() if not item.startswith(str(traces.folder))] == []
    assert others.left() == []
    del lock
