"""Frames that are kept from the mapper: tracked like the others, in no map and no window."""

from collections.abc import Sequence

import pytest

from xrdslam.core.algorithm import Scene
from xrdslam.core.config import IterativeMappingConfig
from xrdslam.core.frame import Frame
from xrdslam.core.mapping import GradientMapping, MappingResult
from xrdslam.core.model import Model
from xrdslam.testing import run, toy_algorithm, toy_sequence
from xrdslam.testing.toy_sequence import ToySequence


class Watched(GradientMapping):
    """Remembers which frames it was shown, as the current one or in the window."""

    def __init__(self) -> None:
        super().__init__(IterativeMappingConfig("watched", iterations=1, keyframes="all"))
        self.mapped: list[int] = []
        self.shown: set[int] = set()

    def map(self, frame: Frame, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        self.mapped.append(frame.index)
        self.shown |= {frame.index, *(keyframe.index for keyframe in keyframes)}
        return super().map(frame, model, keyframes)


def followed(
    hold_out: int, sequence: ToySequence | None = None, first: int = 0, **settings: int
) -> tuple[Watched, list[int], list[int]]:
    """Run; return the mapper, the keyframes and the frames of the trajectory."""
    sequence = sequence or toy_sequence(10, 16, 12)
    algorithm = toy_algorithm(**settings)
    mapper = algorithm.mapping = Watched()
    algorithm.hold_out = hold_out
    frames = [frame for frame in sequence.frames() if frame.index >= first]
    run(algorithm, Scene.of(sequence), iter(frames))
    return mapper, [keyframe.index for keyframe in algorithm.keyframes], algorithm.trajectory.indices


@pytest.mark.parametrize(("hold_out", "kept"), [(2, [1, 3, 5, 7, 9]), (4, [3, 7]), (100, []), (0, [])])
def test_the_last_of_every_n_frames_is_tracked_and_never_mapped(hold_out: int, kept: list[int]) -> None:
    mapper, keyframes, tracked = followed(hold_out, keyframe_every=1)
    others = [index for index in range(10) if index not in kept]
    assert tracked == list(range(10))
    assert mapper.mapped == others
    assert keyframes == others
    assert not mapper.shown & set(kept)


def test_a_mapper_that_takes_every_fifth_frame_loses_none_of_them() -> None:
    assert followed(5, map_every=5, keyframe_every=5)[0].mapped == [0, 5]


def test_the_frame_that_begins_the_map_is_never_held_out() -> None:
    mapper, keyframes, tracked = followed(2, first=3, keyframe_every=1)
    assert tracked == list(range(3, 10))
    assert mapper.mapped == keyframes == [3, 4, 6, 8]
