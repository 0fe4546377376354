"""Taking an algorithm through a sequence as the sequential engine does, without its files, checkpoints and clocks."""

from collections.abc import Iterable

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.frame import Frame

__all__ = ["run"]


def run(algorithm: Algorithm, scene: Scene, frames: Iterable[Frame]) -> Algorithm:
    """Start at the first frame, track and map every other, refine; return the algorithm."""
    algorithm.check(scene)
    for position, frame in enumerate(frames):
        if position == 0:
            algorithm.start(scene, frame)
        else:
            algorithm.track(frame)
        algorithm.map(frame)
    algorithm.finish()
    return algorithm
