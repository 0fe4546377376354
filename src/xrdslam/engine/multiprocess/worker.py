"""What a worker process is: how it begins, how it reports, how it ends."""

import logging
import os
import pickle
import signal
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.config import RunConfig
from xrdslam.core.dataset import Dataset
from xrdslam.core.errors import XrdslamError
from xrdslam.core.registry import Registry
from xrdslam.engine.build import algorithm_of
from xrdslam.engine.multiprocess.channels import Channels
from xrdslam.engine.seeding import prepare

__all__ = ["Failure", "Job", "LogRecord", "Work", "work"]


@dataclass(frozen=True)
class Job:
    """What a worker is told of the run."""

    config: RunConfig
    dataset: Dataset
    registry: Registry
    device: str
    threads: int
    """Of this process."""
    is_heard: bool
    """Whether a plugin's hooks hear of frames."""

    @property
    def scene(self) -> Scene:
        """What is known of the sequence."""
        return Scene.of(self.dataset)

    def algorithm(self) -> Algorithm:
        """Build the method as every other process does."""
        return algorithm_of(self.config, self.device, self.registry)


@dataclass(frozen=True)
class Failure:
    """Why a worker ended."""

    error: XrdslamError | None
    """What a user can mend."""
    summary: str
    trace: str


@dataclass(frozen=True)
class LogRecord:
    """A line of a worker's log."""

    name: str
    level: int
    message: str


Work = Callable[[Job, Channels], None]


def work(packed: bytes, job: Callable[[Job, Channels], None], channels: Channels, report: Connection) -> None:
    """Be a worker: the target of its process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process of a terminal; the parent decides
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
    threading.Thread(target=_end_with_the_parent, daemon=True).start()
    lock = threading.Lock()
    logging.getLogger().addHandler(_ToParent(report, lock))
    try:
        told: Job = pickle.loads(packed)
        prepare(told.config.seed, told.threads)
        job(told, channels)
    except Exception as error:
        known = error if isinstance(error, XrdslamError) else None
        with lock:
            report.send(Failure(known, f"{type(error).__name__}: {error}", traceback.format_exc()))
        raise SystemExit(1) from None


def _end_with_the_parent() -> None:
    parent = parent_process()
    assert parent is not None, "a worker is started by another process"
    wait([parent.sentinel])
    os._exit(1)


class _ToParent(logging.Handler):
    """Hands what is logged to the parent, whose log it is."""

    def __init__(self, report: Connection, lock: threading.Lock) -> None:
        super().__init__()
        self._report = report
        self._sending = lock

    def emit(self, record: logging.LogRecord) -> None:
        with self._sending:
            self._report.send(LogRecord(record.name, record.levelno, record.getMessage()))
