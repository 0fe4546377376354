"""Noticing a track that is lost and does not know it."""

import dataclasses
import statistics

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.core.batch import BatchKind
from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.core.tracking import TrackingResult

__all__ = ["LossGuard", "agreement"]

COLUMNS: dict[BatchKind, int] = {"image": 80, "rays": 24}
"""Of the small image that is rendered to ask. Maps that are read by rays pay for each; those that are drawn as a whole
pay for their primitives, and blur in an image that is too small."""
RELATIVE_TOLERANCE = 0.05
"""Depths agree within this part of the measured one: a Kinect's noise at 4 m, ten times that of rendered depth."""
COLOUR_TOLERANCE = 0.1
"""Without depth: colours agree within this, mean absolute difference of the channels."""
MIN_SEEN = 0.05
"""Where map and frame share a smaller part of the image, nothing can be said."""
MEMORY = 20
"""Frames whose agreement counts as what it was lately."""
MIN_MEMORY = 5
"""With fewer nothing is known of it."""


def agreement(frame: Frame, model: Model, T_world_camera: Float[Tensor, "4 4"]) -> float | None:
    """Return the share of the pixels that both frame and map show in which they agree, None where that is too few.

    Every n-th pixel of the frame is asked. Depth decides where the frame has one, colour otherwise.
    """
    step = max(1, round(frame.camera.width / COLUMNS[model.batch_kind]))
    with torch.no_grad():
        image = model.render(_thinned(frame.camera, step), T_world_camera.to(frame.rgb))
        shown = (image.opacity > 0.5) & (image.depth > 0)
        if frame.depth is not None:
            depth = frame.depth[::step, ::step]
            shown &= depth > 0
            is_alike = (image.depth - depth).abs() < RELATIVE_TOLERANCE * depth
        else:
            is_alike = (image.rgb - frame.rgb[::step, ::step]).abs().mean(-1) < COLOUR_TOLERANCE
    num_shown = int(shown.sum())
    if num_shown < MIN_SEEN * shown.numel():
        return None
    return int((is_alike & shown).sum()) / num_shown


class LossGuard:
    """Calls a frame lost where the map agrees with it much less than it did with the frames before.

    A tracker that descends a gradient, or registers points, ends somewhere: after a jump in a wrong place with a loss
    that is finite. Rendered from there, the map is another picture than the frame. How well the two agree at the right
    place depends on the method and on the sensor; so the measure is the median of the last tracked frames, of which
    `algo.tracking.lost_agreement` is the part below which a frame is lost.
    """

    def __init__(self, part: float) -> None:
        """Take the part; 0 never asks."""
        self.part = part
        self._recent: list[float] = []

    def judge(self, frame: Frame, model: Model, result: TrackingResult) -> TrackingResult:
        """Return the result, marked as lost where the map says so."""
        if not self.part or result.is_lost or not model.supports("render") or model.size == 0:
            return result
        share = agreement(frame, model, result.T_world_camera)
        if share is None:
            return result
        usual = statistics.median(self._recent) if len(self._recent) >= MIN_MEMORY else 0.0
        if share < self.part * usual:
            reason = f"the map agrees with {share:.0%} of the pixels at the pose found, lately with {usual:.0%}"
            return result._replace(is_lost=True, reason=reason)
        self._recent = [*self._recent, share][-MEMORY:]
        return result

    def state_dict(self) -> dict[str, Tensor]:
        """Return what a resumed run needs."""
        return {"recent": torch.tensor(self._recent, dtype=torch.float64)}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take over what `state_dict` returned."""
        self._recent = state["recent"].tolist()


def _thinned(camera: Camera, step: int) -> Camera:
    """Return the camera of every `step`-th pixel, whose centres stay where they are (no half-pixel rule here)."""
    return dataclasses.replace(
        camera,
        fx=camera.fx / step,
        fy=camera.fy / step,
        cx=camera.cx / step,
        cy=camera.cy / step,
        width=-(-camera.width // step),
        height=-(-camera.height // step),
    )
