"""Checkpoints: what a run was after one of its frames, in a file, so that a resumed run goes on with the same bits."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from xrdslam.core.files import remove_unfinished
from xrdslam.core.saved_state import save_state
from xrdslam.engine.authorship import authorship
from xrdslam.engine.build import settings_of
from xrdslam.engine.context import Run
from xrdslam.engine.heap import give_back
from xrdslam.engine.random_numbers import streams

__all__ = ["Checkpoints", "header_of", "known_poses", "newest_checkpoint"]

FOLDER = "checkpoint"
log = logging.getLogger(__name__)


class Checkpoints:
    """Writes the newest state of a run; an older one stays until the new one is whole.

    A state is whole between frames only: `changing` surrounds whatever is done with one, and nothing is saved inside.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self.folder = run.directory.path / FOLDER
        self._is_whole = True
        newest = newest_checkpoint(run.directory.path)
        self._saved_after = -1 if newest is None else _frame_of(newest)

    @contextmanager
    def changing(self) -> Iterator[None]:
        """Surround a frame's tracking and mapping; what raises inside leaves no whole state behind."""
        self._is_whole = False
        yield
        self._is_whole = True

    def save_if_due(self) -> None:
        """Save every `engine.checkpoint_every` frames."""
        every = self.run.config.engine.checkpoint_every
        if every and len(self.run.algorithm.trajectory) % every == 0:
            self.save()

    def save_if_whole(self) -> None:
        """Save what an end between two frames left; inside a frame there is only the checkpoint before."""
        trajectory = self.run.algorithm.trajectory
        if self._is_whole and len(trajectory) and trajectory.indices[-1] != self._saved_after:
            self.save()

    def save(self, state: Mapping[str, object] | None = None, drawn: Mapping[str, object] | None = None) -> None:
        """Write the state; where the disk refuses, say so and go on: the run itself has lost nothing.

        `state` is the algorithm's and `drawn` says where random numbers are, both of this process if not given.
        """
        last = self.run.algorithm.trajectory.indices[-1]
        path = self.folder / f"after_frame_{last:06d}.safetensors"
        with self.run.profile.paused():
            try:
                self._write(path, state or self.run.algorithm.state_dict(), drawn or {"streams": streams()})
                self._remove(all_but=path)
            except OSError as error:
                log.error("no checkpoint after frame %d: %s; the one before stays", last, error)
                return
            finally:
                give_back()  # copies of the whole map, needed no more until the next one
        self._saved_after = last
        log.debug("checkpoint after frame %d: %s", last, path)

    def _write(self, path: Path, state: Mapping[str, object], drawn: Mapping[str, object]) -> None:
        header = {**header_of(self.run), "config": settings_of(self.run.config), **drawn}
        save_state(path, {**state, "ground_truth": known_poses(self.run)}, header)

    def remove(self) -> None:
        """Remove every checkpoint: a run that has ended has its map, one that begins anew has nothing to go on from."""
        self._remove()
        if self.folder.is_dir():
            self.folder.rmdir()
        self._saved_after = -1

    def advice(self) -> str:
        """Say how the run can be taken up again."""
        if self._saved_after < 0:
            return "there is no checkpoint to resume from (engine.checkpoint_every=N writes one every N frames)"
        return f"resume={self.run.directory.path} goes on after frame {self._saved_after}"

    def _remove(self, all_but: Path | None = None) -> None:
        for path in self.folder.glob("after_frame_*.safetensors"):
            if path != all_but:
                path.unlink()
        remove_unfinished(self.folder)


def newest_checkpoint(run_dir: Path) -> Path | None:
    """Return the checkpoint of a run that was written last, None where there is none."""
    return max((run_dir / FOLDER).glob("after_frame_*.safetensors"), key=_frame_of, default=None)


def known_poses(run: Run) -> dict[str, Tensor]:
    """Return the ground truth that frames brought so far."""
    poses = torch.stack([*run.ground_truth.values()]) if run.ground_truth else torch.empty(0, 4, 4).double()
    return {"indices": torch.tensor([*run.ground_truth], dtype=torch.int64), "poses": poses}


def header_of(run: Run) -> dict[str, Any]:
    """Return what is said of a run beside its tensors: who wrote it, up to which frame, at what cost."""
    indices = run.algorithm.trajectory.indices
    return {
        **authorship(run.config.algo, run.registry),
        "frame": indices[-1] if indices else -1,
        "profile": run.profile.state(),
        "resumed_after": run.resumed_after,
        "has_ended": run.has_ended,
    }


def _frame_of(path: Path) -> int:
    return int(path.stem.rpartition("_")[2])
