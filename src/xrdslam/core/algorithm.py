"""A method: one map, one way of tracking, one way of mapping, and the trajectory."""

import logging
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from xrdslam.core.batch import BatchKind
from xrdslam.core.camera import Camera
from xrdslam.core.config import AlgorithmConfig
from xrdslam.core.dataset import Dataset, Modality
from xrdslam.core.errors import DataError, PluginError
from xrdslam.core.frame import Frame
from xrdslam.core.loss_guard import LossGuard
from xrdslam.core.mapping import MappingMethod, MappingResult
from xrdslam.core.model import Model
from xrdslam.core.motion import MOTION_MODELS
from xrdslam.core.relocalisation import Relocaliser
from xrdslam.core.tracking import TrackingMethod, TrackingResult
from xrdslam.core.trajectory import Trajectory

__all__ = ["Algorithm", "Scene"]

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Scene:
    """What is known of a sequence before its first frame."""

    camera: Camera
    modalities: frozenset[Modality]
    bounds: Float64[Tensor, "2 3"] | None = None
    """Corners (min, max) [m] where the data states them; a method that needs bounds else finds them in the depth."""
    name: str = ""

    @classmethod
    def of(cls, dataset: Dataset) -> "Scene":
        """Read it off a dataset."""
        return cls(dataset.camera, dataset.modalities, dataset.bounds, dataset.name)


class Algorithm(ABC):
    """Composes a model, a tracking and a mapping method, and owns the trajectory: nobody else says where a frame is.

    An engine calls `track` with every frame in order, then `map`, and `finish` after the last. A subclass says how its
    map is built (`build_model`) and overrides the steps that differ; odometry overrides `build_model` with its patch
    graph and takes `algo/mapping=none`, reconstruction from given poses takes `algo/tracking=ground_truth`.
    """

    needs: ClassVar[frozenset[Modality]] = frozenset({"rgb"})
    """What the map needs of a frame, whichever methods track and map."""
    model: Model

    def __init__(
        self, config: AlgorithmConfig, tracking: TrackingMethod, mapping: MappingMethod, device: str = "cpu"
    ) -> None:
        self.config = config
        self.tracking = tracking
        self.mapping = mapping
        self.device = torch.device(device)
        self.trajectory = Trajectory()
        self.keyframes: list[Frame] = []
        self.guard = LossGuard(tracking.config.lost_agreement)
        self.relocaliser: Relocaliser | None = None
        """Who looks for lost frames (`algo.tracking.relocalise`)."""
        self.hold_out = 0
        """Every n-th frame is tracked and kept from the map (`is_held_out`); 0: none."""

    @abstractmethod
    def build_model(self, scene: Scene, frame: Frame) -> Model:
        """Build the empty map; `frame` is the first one, its pose set (scene bounds come from its depth)."""

    def check(self, scene: Scene) -> None:
        """Refuse data or combinations that cannot work, before the first frame."""
        missing = sorted(self._needs() - scene.modalities)
        if missing:
            raise DataError(
                f"{scene.name} has {', '.join(sorted(scene.modalities))}, but algo={self.config.name} with "
                f"algo/tracking={self.tracking.config.name} and algo/mapping={self.mapping.config.name} needs "
                f"{', '.join(missing)} as well; choose another sequence, or methods that do without"
            )
        if self.tracking.follows_map and not self.mapping.changes_map:
            log.warning(
                "algo/tracking=%s follows the map and algo/mapping=%s makes none: every frame will be lost; "
                "algo/tracking=gicp, constant_velocity or ground_truth do without a map",
                self.tracking.config.name,
                self.mapping.config.name,
            )

    def start(self, scene: Scene, frame: Frame) -> TrackingResult:
        """Set the world by the first frame and build the empty map."""
        fault = frame.fault(self._needs())
        if fault:
            raise DataError(
                f"{scene.name}: frame {frame.index} cannot be the first: {fault}; "
                "begin later with dataset.frames=[start,stop,stride]"
            )
        pose = self.first_pose(frame)
        frame.pose.set_(pose)
        self.model = self.build_model(scene, frame).to(self.device)
        if self.tracking.follows_map and self.mapping.changes_map:
            self._check_batches("tracking", self.tracking.config.name, self.tracking.batch_kinds)
        self._check_batches("mapping", self.mapping.config.name, self.mapping.batch_kinds)
        self.trajectory.append(frame.index, frame.timestamp_ns, pose)
        self.tracking.start(frame, pose)
        self._remember(frame)
        return TrackingResult(pose)

    def first_pose(self, frame: Frame) -> Float[Tensor, "4 4"]:
        """Return the pose that holds the world: the data's or the identity, as `first_pose` says."""
        identity = torch.eye(4, dtype=frame.rgb.dtype, device=frame.device)
        given = frame.T_world_camera_gt
        if self.config.first_pose == "identity":
            return identity
        if given is not None and bool(torch.isfinite(given).all()):
            return given.to(identity)
        if self.config.first_pose == "ground_truth":
            raise DataError(
                f"algo.first_pose=ground_truth: frame {frame.index} has no finite ground-truth pose; use identity"
            )
        return identity

    def track(self, frame: Frame) -> TrackingResult:
        """Predict, track, record. A lost frame, or one that shows nothing, keeps the prediction and is marked.

        With a relocaliser, a lost frame that is recognised is tracked once more, from there.
        """
        predicted = self.predict(frame)
        if fault := frame.fault(self.tracking.needs):
            result = TrackingResult(predicted, is_lost=True, reason=fault)
        else:
            result = self.locate(frame, predicted)
            if result.is_lost and self.relocaliser is not None:
                result = self._find_again(frame, result, self.relocaliser)
        if result.is_lost:
            result = result._replace(T_world_camera=predicted, converged=False)
        frame.pose.set_(result.T_world_camera)
        self.trajectory.append(
            frame.index, frame.timestamp_ns, result.T_world_camera, result.is_lost, result.is_recognised
        )
        self.accept(result.poses)
        if not result.is_lost:
            self.tracking.integrate(frame, result.T_world_camera)
            self._remember(frame)
        return result

    def locate(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"]) -> TrackingResult:
        """Track a frame from a pose; lost as well where what is found is not finite, or is not what the map shows."""
        frame.pose.set_(T_world_camera)
        result = self.tracking.track(frame, self.model, self.trajectory)
        if not result.is_lost and not bool(torch.isfinite(result.T_world_camera).all()):
            return result._replace(is_lost=True, reason="the pose found is not finite")
        return self.guard.judge(frame, self.model, result)

    def _find_again(self, frame: Frame, lost: TrackingResult, relocaliser: Relocaliser) -> TrackingResult:
        """Track a lost frame from where it is recognised; what leads away from there again is not believed."""
        found = relocaliser.find(frame, self.trajectory)
        if found.T_world_camera is None:
            return lost._replace(reason=f"{lost.reason}; not found again: {found.reason}")
        again = self.locate(frame, found.T_world_camera.to(frame.rgb))
        if again.is_lost:
            return again._replace(reason=f"found again by {found.reason}, but lost there: {again.reason}")
        if not relocaliser.agrees(frame, again.T_world_camera, self.trajectory):
            again = again._replace(T_world_camera=found.T_world_camera.to(frame.rgb))
        return again._replace(is_recognised=True, reason=found.reason)

    def _remember(self, frame: Frame) -> None:
        if self.relocaliser is not None:
            self.relocaliser.remember(frame, self.trajectory)

    def predict(self, frame: Frame) -> Float[Tensor, "4 4"]:
        """Return the motion model's guess."""
        return MOTION_MODELS[self.config.motion](self.trajectory).to(frame.rgb)

    def map(self, frame: Frame) -> MappingResult | None:
        """Map a frame where it is due; write back the poses that moved; add it to the keyframes where it is one."""
        if self.is_held_out(frame.index):
            return None
        result = None
        is_sound = frame.fault(self.mapping.needs if self.mapping.changes_map else ()) is None
        if is_sound and self.is_mapped(frame):
            result = self.mapping.map(frame, self.model, self.keyframes)
            self.accept(result.poses)
            self._mend_poses([*self.keyframes, frame], result.poses)
        if is_sound and self.is_keyframe(frame):
            self.trajectory.make_keyframe(frame.index)
            self.keyframes.append(frame)
        return result

    def is_held_out(self, index: int) -> bool:
        """Say whether a frame is kept from the map: the last of every `hold_out`, never the one that begins the map.

        The last, so that a method that maps every k-th frame, counted from 0, loses none of them where k divides n.
        """
        return self.hold_out > 1 and index % self.hold_out == self.hold_out - 1 and index != self.trajectory.first

    def is_mapped(self, frame: Frame) -> bool:
        """Say whether the frame goes into the map: the first, every `map_every`-th, and never a lost one."""
        if self._is_lost(frame):
            return False
        return frame.index % self.config.map_every == 0 or not self.keyframes

    def is_keyframe(self, frame: Frame) -> bool:
        """Say whether the frame becomes a keyframe: the first, every `keyframe_every`-th, and never a lost one."""
        if self._is_lost(frame):
            return False
        return frame.index % self.config.keyframe_every == 0 or not self.keyframes

    def accept(self, poses: Mapping[int, Tensor]) -> None:
        """Write poses that a method moved into the trajectory; a pose that is not finite is refused and said."""
        finite = {index: pose for index, pose in poses.items() if bool(torch.isfinite(pose).all())}
        for index in poses.keys() - finite.keys():
            log.warning("frame %d was moved to a pose that is not finite; the earlier pose is kept", index)
        self.trajectory.update_all(finite)

    def finish(self) -> None:
        """Refine after the last frame."""
        self.accept(self.tracking.finish(self.model))
        self.accept(self.mapping.finish(self.model, self.keyframes).poses)

    def state_dict(self) -> dict[str, dict[str, Tensor]]:
        """Return everything that a resumed run needs, keyframe images excepted (the dataset has them)."""
        return {
            **self.results_state(),
            "model": dict(self.model.state_dict()),
            "tracking": self.tracking.state_dict(),
            "mapping": self.mapping.state_dict(),
            "guard": self.guard.state_dict(),
            "relocaliser": self.relocaliser.state_dict() if self.relocaliser is not None else {},
        }

    def results_state(self) -> dict[str, dict[str, Tensor]]:
        """Return where the frames and the keyframes are."""
        keyframes = {
            "indices": torch.tensor([keyframe.index for keyframe in self.keyframes], dtype=torch.int64),
            "rotations": _stacked([keyframe.pose.rotation for keyframe in self.keyframes]),
            "translations": _stacked([keyframe.pose.translation for keyframe in self.keyframes]),
        }
        return {"trajectory": self.trajectory.state_dict(), "keyframes": keyframes}

    def load_state_dict(self, state: dict[str, dict[str, Tensor]], keyframes: Iterable[Frame]) -> None:
        """Take over what `state_dict` returned; `keyframes` are the frames of `state["keyframes"]["indices"]`."""
        self.load_results(state, keyframes)
        self.tracking.load_state_dict(state["tracking"])
        self.mapping.load_state_dict(state["mapping"])
        self.guard.load_state_dict(state["guard"])
        if self.relocaliser is not None:
            self.relocaliser.load_state_dict(state["relocaliser"])

    def load_results(self, state: dict[str, dict[str, Tensor]], keyframes: Iterable[Frame]) -> None:
        """Take over the map, the trajectory and the keyframes alone: enough to look at them, not to go on."""
        self.trajectory.load_state_dict(state["trajectory"])
        self.model.load_state_dict(state["model"])
        self.keyframes = list(keyframes)
        kept = state["keyframes"]
        for keyframe, *pose in zip(self.keyframes, kept["rotations"], kept["translations"], strict=True):
            keyframe.pose.load_state_dict({"rotation": pose[0], "translation": pose[1]})

    def _needs(self) -> frozenset[Modality]:
        return self.needs | self.tracking.needs | (self.mapping.needs if self.mapping.changes_map else frozenset())

    def _mend_poses(self, frames: Iterable[Frame], moved: Mapping[int, Tensor]) -> None:
        """Give frames whose new pose was refused the believed one back: the next mapping step starts from it."""
        for frame in frames:
            if frame.index in moved and not bool(torch.isfinite(moved[frame.index]).all()):
                frame.pose.set_(self.trajectory.pose(frame.index))

    def _is_lost(self, frame: Frame) -> bool:
        return frame.index in self.trajectory and self.trajectory.lost(frame.index)

    def _check_batches(self, part: str, name: str, kinds: frozenset[BatchKind]) -> None:
        model = type(self.model)
        if kinds and (self.model.batch_kind not in kinds or not model.supports("losses")):
            raise PluginError(
                f"algo/{part}={name} reads {' or '.join(sorted(kinds))} batches, but the map of "
                f"algo={self.config.name} ({model.__name__}) gives "
                f"{self.model.batch_kind + ' batches' if model.supports('losses') else 'no losses'}; "
                f"choose a {part} method of the same family{', or gicp' if part == 'tracking' else ''}"
            )


def _stacked(parameters: list[torch.nn.Parameter]) -> Tensor:
    """Return the parameters themselves, not the matrices made of them: a resumed run has the same bits."""
    return torch.stack([p.detach() for p in parameters]) if parameters else torch.empty(0)
