"""What the processes of a run cost together."""

import copy
import time

from xrdslam.engine.multiprocess.messages import Finished, Mapped, Message, Meter, Paused, Resumed, Spent, Tracked
from xrdslam.engine.profile import Profile

__all__ = ["Accounts"]


class Accounts:
    """Adds up what the processes used; the clock runs from the first frame's reading to the last refinement.

    What was spent before the run was taken up stays, and the time that checkpoints take is not counted.
    """

    def __init__(self, profile: Profile, asked_s: float) -> None:
        """Begin; `asked_s` is when the engine was asked to, on the clock of all processes."""
        self._profile = profile
        self._earlier = copy.copy(profile)
        self._asked_s = asked_s
        self._began_s = asked_s
        self._paused_s = 0.0
        self._meter = Meter()
        self._spent: dict[type[Message], Spent] = {}

    def note(self, message: Message) -> None:
        """Read what a process had spent when it spoke."""
        if not isinstance(message, Resumed):
            self._spent[type(message)] = message.spent
        if isinstance(message, Tracked):
            self._began_s = message.began_s

    def go_on(self, paused: Paused) -> None:
        """Leave out the time since tracker and mapper began to wait."""
        self._paused_s += time.perf_counter() - paused.spent.at_s

    def settle(self) -> None:
        """Bring the profile up to date."""
        profile, spent = self._profile, self._spent
        mapper = spent.get(Finished) or spent.get(Mapped)
        workers = [s for s in (spent.get(Tracked), mapper) if s is not None]
        profile.wall_s, profile.cpu_s, profile.peak_rss_mib = self._earlier.wall_s, self._earlier.cpu_s, 0.0
        if workers:
            profile.wall_s += max(s.at_s for s in workers) - self._began_s - self._paused_s
            profile.start_s = self._began_s - self._asked_s
        for process in (self._meter.read(), *workers):
            profile.add_process(process.cpu_s, process.peak_rss_mib)

    def count_drops(self, num_dropped: int) -> None:
        """Add the frames that the viewer was not shown."""
        self._profile.viewer_drops = (self._earlier.viewer_drops or 0) + num_dropped
