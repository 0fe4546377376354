"""Co-SLAM's mapper: global bundle adjustment of the map and all keyframes on banked rays."""

from collections.abc import Sequence
from typing import ClassVar

import torch
from torch import Tensor, nn

from xrdslam.algorithms.co_slam.bank import RayBank, in_world, rays_of
from xrdslam.algorithms.co_slam.config import CoSlamMappingConfig
from xrdslam.core.batch import Batch, BatchKind, RayBatch
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3, so3
from xrdslam.core.mapping import GradientMapping, MappingProblem, MappingResult
from xrdslam.core.model import Model
from xrdslam.core.optimisation import Optimum, ParameterGroup
from xrdslam.core.pose import move_, stacked
from xrdslam.core.sampling import sample_rays

__all__ = ["CoSlamMapping"]

_FINAL_KEYFRAMES = 16
"""So many keyframes give rays to an iteration of the last ones: each costs a few small operations."""


class CoSlamMapping(GradientMapping):
    """All keyframes' rays and the current frame's, all poses but the first free; poses step on summed gradients."""

    batch_kinds: ClassVar[frozenset[BatchKind]] = frozenset({"rays"})
    config: CoSlamMappingConfig

    def __init__(self, config: CoSlamMappingConfig, seed: int = 0) -> None:
        super().__init__(config, seed)
        self.bank = RayBank()

    def map(self, frame: Frame, model: Model, keyframes: Sequence[Frame]) -> MappingResult:
        """Take the rays of keyframes that came since, then adjust."""
        self._take_rays(keyframes)
        return super().map(frame, model, keyframes)

    def _take_rays(self, keyframes: Sequence[Frame]) -> None:
        for keyframe in keyframes[len(self.bank.indices) :]:
            self.bank.add(keyframe, self.config.bank_share, self.generator)

    def select(self, frame: Frame, keyframes: Sequence[Frame]) -> list[Frame]:
        """Take every keyframe."""
        return [*(k for k in keyframes if k.index != frame.index), frame]

    def movable(self, problem: MappingProblem) -> list[Frame]:
        """Return all but the anchor; with a single keyframe nothing moves, as published."""
        if len(problem.window) < 3:
            return []
        moved = super().movable(problem)
        return moved if self.config.moves_current else [f for f in moved if f is not problem.window[-1]]

    def pose_groups(self, problem: MappingProblem) -> list[ParameterGroup]:
        """Return the poses as two stacked parameters: a step costs the same for five keyframes and for five hundred."""
        frames = self.movable(problem)
        if not frames:
            return []
        with torch.no_grad():
            matrices = stacked([f.pose for f in frames])
            rotations, centers = nn.Parameter(so3.log(matrices[:, :3, :3])), nn.Parameter(matrices[:, :3, 3].clone())
        problem.memory["poses"] = rotations, centers
        config = self.config
        return [
            ParameterGroup("rotations", [rotations], config.lr_pose_rotation, accumulate=config.pose_accumulate),
            ParameterGroup("centers", [centers], config.lr_pose_translation, accumulate=config.pose_accumulate),
        ]

    def optimise(self, problem: MappingProblem) -> Optimum:
        """Adjust, then give the frames their poses."""
        optimum = super().optimise(problem)
        if "poses" in problem.memory:
            rotations, centers = problem.memory["poses"]
            matrices = se3.compose(so3.exp(rotations), centers).detach()
            sound = torch.isfinite(matrices).flatten(1).all(1)
            frames = [f for f, is_sound in zip(self.movable(problem), sound.tolist(), strict=True) if is_sound]
            move_([f.pose for f in frames], matrices[sound])
        return optimum

    def batch(self, problem: MappingProblem) -> Batch:
        """Draw banked rays, and rays of the current frame: its share of all, and never fewer than the least.

        When the map settles, rays are drawn from whole keyframes: what the bank lacks between its pixels is colour.
        """
        frame = problem.window[-1]
        total = self.config.num_pixels
        if problem.is_final:
            return self._any_rays(problem)
        if len(self.bank.indices) == 0:
            return sample_rays([frame], [frame.pose.matrix().detach()], total, self.generator)
        rotations, centers = self._poses(problem)
        current = max(total // len(self.bank.indices), self.config.min_current_pixels)
        pose = torch.cat((torch.cat((rotations[-1], centers[-1, :, None]), 1), torch.eye(4).to(centers)[3:]))
        new = sample_rays([frame], [pose], current, self.generator)
        old = self.bank.draw(total, rotations, centers, self.generator)
        new.frame_slot += len(self.bank.indices)
        parts = zip(_columns(old), _columns(new), strict=True)
        return RayBatch(*(torch.cat(pair) for pair in parts))

    def losses(self, problem: MappingProblem, iteration: int) -> dict[str, Tensor]:
        """Return the map's losses; when the map settles, colour counts for more and nothing is smoothed any more."""
        found = super().losses(problem, iteration)
        if problem.is_final:
            found.pop("smoothness", None)
            if "rgb" in found:
                found["rgb"] = self.config.final_rgb_factor * found["rgb"]
        return found

    def _any_rays(self, problem: MappingProblem) -> Batch:
        """Draw pixels of whole keyframes, as many of each."""
        keyframes = problem.window
        slots = torch.randperm(len(keyframes), generator=self.generator)[:_FINAL_KEYFRAMES]
        share = -(-self.config.num_pixels // len(slots))
        parts = []
        for slot in slots.tolist():
            frame = keyframes[slot]
            pixels = torch.randint(frame.camera.width * frame.camera.height, (share,), generator=self.generator)
            parts.append(rays_of(frame, pixels.to(frame.device)))
        rays = torch.cat(parts)
        return in_world(rays, slots.repeat_interleave(share).to(rays.device), *self._poses(problem))

    def _poses(self, problem: MappingProblem) -> tuple[Tensor, Tensor]:
        """Return the rotations and centres of the whole window, those that move with their gradients."""
        fixed = problem.memory.get("fixed")
        if fixed is None:
            with torch.no_grad():
                matrices = stacked([f.pose for f in problem.window])
            moved = {f.index for f in self.movable(problem)}
            places = torch.tensor([i for i, f in enumerate(problem.window) if f.index in moved], dtype=torch.int64)
            fixed = problem.memory["fixed"] = (matrices, places.to(matrices.device))
        matrices, places = fixed
        if "poses" not in problem.memory:
            return matrices[:, :3, :3], matrices[:, :3, 3]
        rotations, centers = problem.memory["poses"]
        return (
            matrices[:, :3, :3].index_copy(0, places, so3.exp(rotations)),
            matrices[:, :3, 3].index_copy(0, places, centers),
        )

    def state_dict(self) -> dict[str, Tensor]:
        """Return what a resumed run needs, the bank among it."""
        return super().state_dict() | {f"bank.{k}": v for k, v in self.bank.state_dict().items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take over what `state_dict` returned."""
        super().load_state_dict(state)
        prefix = "bank."
        self.bank.load_state_dict({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})


def _columns(batch: RayBatch) -> tuple[Tensor, ...]:
    return batch.origins_world, batch.directions_world, batch.rgb, batch.depth, batch.frame_slot
