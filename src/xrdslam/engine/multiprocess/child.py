"""A process of a run, from its first moment: it ends with its parent and says why it ended. Imports nothing heavy."""

import faulthandler
import logging
import os
import pickle
import signal
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from types import FrameType
from typing import Any

from xrdslam.core.errors import XrdslamError
from xrdslam.engine.multiprocess.signals import STOPPING, deaf

__all__ = ["Asked", "Done", "Failure", "LogRecord", "Say", "start"]

PATIENCE_S = 10.0
"""How long a process that was asked to end leaves that to its parent."""
Say = Callable[[object], None]
"""Tells the parent something, from any thread."""


@dataclass(frozen=True)
class Failure:
    """Why a process ended."""

    summary: str
    trace: str
    is_lost: bool
    """Whether it lost its connection, which is what happens to a process when another one ends."""
    packed: bytes = b""

    @property
    def error(self) -> XrdslamError | None:
        """What was raised, where a user can mend it."""
        error = pickle.loads(self.packed) if self.packed else None
        return error if isinstance(error, XrdslamError) else None


@dataclass(frozen=True)
class LogRecord:
    """A line of a process's log."""

    name: str
    level: int
    message: str


@dataclass(frozen=True)
class Asked:
    """A process was sent a signal that asks the run to end: whoever sends it to one of them means all."""

    number: int


@dataclass(frozen=True)
class Done:
    """A process has done what it was for; one that ends without a word has not."""


class _Sealed:
    """What a process is to do, opened only when it is ready to say what goes wrong: importing that takes seconds."""

    def __init__(self, content: object) -> None:
        self.content = content

    def __reduce__(self) -> tuple[Any, ...]:
        return _Received, (bytes(ForkingPickler.dumps(self.content)),)


@dataclass(frozen=True)
class _Received:
    data: bytes


def start(role: str, function: Callable[..., None], *args: object) -> tuple[SpawnProcess, Connection]:
    """Start a process that calls `function(*args, say)`; return it, and where its reports come from.

    It logs as this process does, and ends with it. SIGINT and SIGHUP it never hears; SIGTERM it hands on.
    """
    context = get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    level = logging.getLogger().getEffectiveLevel()
    sealed = _Sealed((function, args))
    process = context.Process(target=_be, args=(role, level, sealed, theirs), name=f"xrdslam-{role}", daemon=True)
    try:
        with deaf():
            process.start()
    finally:
        theirs.close()  # the other process's is then the only one: when it ends, so does the pipe
    return process, ours


def _be(role: str, level: int, sealed: _Received, report: Connection) -> None:
    threading.Thread(target=_end_with_the_parent, daemon=True).start()
    lock = threading.Lock()

    def say(something: object) -> None:
        with lock:
            report.send(something)

    _listen(say)
    with suppress(OSError):
        Path("/proc/self/comm").write_text(f"xrdslam-{role}")  # as ps and top name it, 15 letters of it
    faulthandler.enable()  # where a crash in compiled code happened, on stderr
    logging.getLogger().setLevel(level)
    logging.getLogger().addHandler(_ToParent(say))
    try:
        function, args = pickle.loads(sealed.data)
        function(*args, say)
    except Exception as error:
        say(_failure(error))
        raise SystemExit(1) from None
    say(Done())


def _listen(say: Say) -> None:
    """Be deaf to what a terminal sends to every process of it: the parent decides. Hand on SIGTERM."""

    def tell(number: int) -> None:
        with suppress(OSError):
            say(Asked(number))
        time.sleep(PATIENCE_S)
        os._exit(1)

    def hand_on(number: int, _frame: FrameType | None) -> None:
        threading.Thread(target=tell, args=(number,), daemon=True).start()  # this one may be speaking

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, hand_on)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPPING)


def _failure(error: Exception) -> Failure:
    packed = b""
    if isinstance(error, XrdslamError):
        with suppress(Exception):  # an error whose class cannot be packed and unpacked still has its words
            packed = pickle.dumps(error)
            pickle.loads(packed)
    is_lost = isinstance(error, EOFError | ConnectionError)
    return Failure(f"{type(error).__name__}: {error}", traceback.format_exc(), is_lost, packed)


def _end_with_the_parent() -> None:
    parent = parent_process()
    assert parent is not None, "it is started by another process"
    wait([parent.sentinel])
    os._exit(1)


class _ToParent(logging.Handler):
    """Hands what is logged to the parent, whose log it is."""

    def __init__(self, say: Say) -> None:
        super().__init__()
        self._say = say

    def emit(self, record: logging.LogRecord) -> None:
        with suppress(OSError):  # the parent is gone, and so will this process be
            self._say(LogRecord(record.name, record.levelno, self.format(record)))
