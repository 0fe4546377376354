"""Rooms, each built from a seed: `ROOMS` maps a name to its builder."""

from collections.abc import Callable

import numpy as np

from xrdslam.core.errors import UnknownNameError
from xrdslam.datasets.synthetic.bedroom import bedroom
from xrdslam.datasets.synthetic.dining_room import dining_room
from xrdslam.datasets.synthetic.living_room import living_room
from xrdslam.datasets.synthetic.lounge import lounge
from xrdslam.datasets.synthetic.meeting_room import meeting_room
from xrdslam.datasets.synthetic.open_office import open_office
from xrdslam.datasets.synthetic.scene import Scene
from xrdslam.datasets.synthetic.seminar_room import seminar_room
from xrdslam.datasets.synthetic.study import study

__all__ = ["ROOMS", "build_room"]


def build_room(name: str, seed: int) -> Scene:
    """Return the room of that name; the seed changes books, ornaments, patterns, and what is moved about."""
    if name not in ROOMS:
        raise UnknownNameError(f"no synthetic room {name!r}; there is {', '.join(sorted(ROOMS))}")
    return ROOMS[name](np.random.default_rng(seed))


ROOMS: dict[str, Callable[[np.random.Generator], Scene]] = {
    "room0": living_room,
    "room1": bedroom,
    "room2": dining_room,
    "office0": lounge,
    "office1": study,
    "office2": meeting_room,
    "office3": open_office,
    "office4": seminar_room,
}
"""Named after Replica's, whose sizes and walking pace they follow in spirit; nothing else is taken from there."""
