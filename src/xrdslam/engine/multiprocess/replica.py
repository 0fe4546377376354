"""A process's own copy of the algorithm, kept to what all of them share."""

from collections.abc import Iterator

import torch
from torch import Tensor

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.core.shared_algorithm import Steps
from xrdslam.core.trajectory import Trajectory
from xrdslam.engine.multiprocess.frame_ring import FrameRing, Holder
from xrdslam.engine.multiprocess.messages import Mapped, Message, Paused, Resumed, Tracked, pack, unpack
from xrdslam.engine.multiprocess.shared_state import Published, SharedState, same_bits

__all__ = ["Replica", "SharedTrajectory", "map_state"]

MODEL = "model."
TRACKING = "tracking."
KEYFRAMES = "keyframes."
EXTRA_STATE = "_extra_state"


class SharedTrajectory(Trajectory):
    """A trajectory that notes what changed in it, so that others can follow."""

    def __init__(self) -> None:
        super().__init__()
        self._changed: dict[int, None] = {}
        self._has_new_anchor = False

    def _hang(self, index: int, anchor: int, T_world_camera: Tensor) -> None:
        super()._hang(index, anchor, T_world_camera)
        self._changed[index] = None

    def make_keyframe(self, index: int) -> None:
        """Let a frame stand on its own, and later ones hang on it."""
        super().make_keyframe(index)
        self._has_new_anchor = True

    def take_changes(self) -> dict[str, Tensor]:
        """Return what changed since the last call, for `merge`: poses as they are kept, so that nothing is rounded."""
        changes = self.state_dict(self._changed)
        if not self._has_new_anchor:
            del changes["anchor"]
        self._changed, self._has_new_anchor = {}, False
        return changes


class Replica:
    """An algorithm of the same build in each process; what one of them does to its own, the others hear and repeat.

    Tracking and mapping keep their inner state where they run. The trajectory, the keyframes and the map are kept
    equal: poses by steps from the server, images and maps in shared memory.
    """

    def __init__(
        self,
        algorithm: Algorithm,
        scene: Scene,
        shared: Steps,
        reader: str,
        ring: FrameRing,
        holder: Holder | None,
        own: tuple[type, ...],
    ) -> None:
        """Take a newly built algorithm; `shared` is the server's instance, which knows this process as `reader`.

        Steps of the kinds `own` are made here.
        """
        self.algorithm = algorithm
        self.scene = scene
        self.trajectory = SharedTrajectory()
        self._shared = shared
        self._reader = reader
        self._ring = ring
        self._holder = holder
        self._own = own
        self._known = 0
        self._version = 0
        self._pending: dict[int, tuple[Tracked, Frame | None]] = {}
        algorithm.trajectory = self.trajectory

    def record(self, message: Message) -> int:
        """Tell the others of a step made here; return its number."""
        return self._shared.record(pack(message))

    def news(self) -> Iterator[Message]:
        """Yield the steps that others made since the last call, each once it is repeated here."""
        for entry in self._shared.since(self._known, self._reader):
            message = unpack(entry)
            self._known += 1
            if not isinstance(message, self._own):
                self._repeat(message)
                yield message
            elif not isinstance(message, Paused):  # in the order of all: the last word is the same everywhere
                self.trajectory.merge(message.trajectory)

    def hold(self, tracked: Tracked, frame: Frame) -> None:
        """Keep a frame that is tracked here until it is known whether it is a keyframe."""
        self._pending[frame.index] = (tracked, frame)

    def frame(self, index: int) -> Frame:
        """Return a frame that is tracked and not mapped yet, at the pose that it was given."""
        tracked, frame = self._pending[index]
        return self._ring.frame(tracked.frame).to(self.algorithm.device) if frame is None else frame

    def settle(self, index: int, is_keyframe: bool) -> Frame | None:
        """Hear that a frame is mapped: let go of it, unless it is a keyframe, which is returned."""
        frame = self.frame(index) if is_keyframe else None
        tracked, _ = self._pending.pop(index)
        is_first = index == self.trajectory.indices[0]  # whoever joins later begins with it
        if not is_keyframe and not is_first and self._holder is not None:
            self._ring.let_go(tracked.frame, self._holder)
        return frame

    def _repeat(self, message: Message) -> None:
        if isinstance(message, Paused):
            return
        if isinstance(message, Resumed):
            self._take_up(message)
            return
        if isinstance(message, Tracked):
            self._pending[message.frame.index] = (message, None)
            if len(self.trajectory) == 0:
                self.algorithm.start(self.scene, self.frame(message.frame.index))
                self.trajectory.take_changes()
        self.trajectory.merge(message.trajectory)
        if isinstance(message, Mapped):
            keyframe = self.settle(message.index, message.is_keyframe)
            if keyframe is not None:
                self.algorithm.keyframes.append(keyframe)

    def _take_up(self, resumed: Resumed) -> None:
        device = self.algorithm.device
        self.algorithm.start(self.scene, self._ring.frame(resumed.first).to(device))
        self.trajectory.take_changes()
        self.trajectory.load_state_dict(resumed.trajectory)
        self.algorithm.keyframes = [self._ring.frame(keyframe).to(device) for keyframe in resumed.keyframes]

    def load_latest(self, maps: SharedState, changes: SharedState) -> None:
        """Load the latest map, and what tracking changed in it since; for who only looks on."""
        if not len(self.trajectory):
            return
        published = maps.read()
        if published is not None and published.version > self._version:
            self._version = published.version
            self.load_map(published)
        elif published is not None:  # keyframes that were not known yet when it was loaded have their poses there
            self._load_keyframes(published)
        changed = changes.read()
        if changed is not None and changed.base == self._version:
            self.load_changes(changed)

    def load_map(self, published: Published) -> None:
        """Take over a published map and the poses of its keyframes."""
        state = {k.removeprefix(MODEL): t for k, t in published.tensors.items() if k.startswith(MODEL)}
        self.algorithm.model.load_state_dict(state)
        self._load_keyframes(published)

    def _load_keyframes(self, published: Published) -> None:
        kept = {k.removeprefix(KEYFRAMES): t for k, t in published.tensors.items() if k.startswith(KEYFRAMES)}
        if kept:
            _load_poses(self.algorithm.keyframes, kept["rotations"], kept["translations"])

    def load_changes(self, published: Published) -> None:
        """Take over what tracking changed, in the map or in itself."""
        state = {k.removeprefix(MODEL): t for k, t in published.tensors.items() if k.startswith(MODEL)}
        tracking = {k.removeprefix(TRACKING): t for k, t in published.tensors.items() if k.startswith(TRACKING)}
        _load_some(self.algorithm.model, state)
        if tracking:
            self.algorithm.tracking.load_state_dict(tracking)

    def changes_since(self, loaded: Published | None) -> dict[str, Tensor]:
        """Return the map's tensors that are not, bit by bit, what was loaded."""
        before = loaded.tensors if loaded is not None else {}
        state = {f"{MODEL}{name}": tensor for name, tensor in self.algorithm.model.state_dict().items()}
        return {k: t for k, t in state.items() if k not in before or not same_bits(t, before[k])}


def map_state(algorithm: Algorithm) -> dict[str, Tensor]:
    """Return what others need of an algorithm that maps: the map, and the keyframes' poses in their parameters."""
    state = {f"{MODEL}{name}": tensor for name, tensor in algorithm.model.state_dict().items()}
    poses = [keyframe.pose for keyframe in algorithm.keyframes]
    if poses:
        state[f"{KEYFRAMES}rotations"] = torch.stack([pose.rotation.detach() for pose in poses])
        state[f"{KEYFRAMES}translations"] = torch.stack([pose.translation.detach() for pose in poses])
    return state


def _load_some(model: Model, changes: dict[str, Tensor]) -> None:
    """Load a part of a map's state. Random streams alone are set alone: the optimiser keeps the parameters it has."""
    if all(name.rpartition(".")[2] == EXTRA_STATE for name in changes):
        for name, value in changes.items():
            model.get_submodule(name.rpartition(".")[0]).set_extra_state(value)
    else:
        model.load_state_dict(model.state_dict() | changes)


@torch.no_grad()
def _load_poses(keyframes: list[Frame], rotations: Tensor, translations: Tensor) -> None:
    for keyframe, rotation, translation in zip(keyframes, rotations, translations, strict=False):
        keyframe.pose.rotation.copy_(rotation)
        keyframe.pose.translation.copy_(translation)
