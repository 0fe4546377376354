"""How well a map renders what was photographed: the rows of single frames, their means and protocol.

The renderer is a function of a camera and a pose: it has no way to see the measured depth of the frame.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor
from torch.utils.data import Dataset

from xrdslam.core.camera import Camera
from xrdslam.core.model import Rendering
from xrdslam.evaluation.errors import EvaluationError
from xrdslam.evaluation.image_quality import depth_l1_cm, ms_ssim, psnr, ssim
from xrdslam.evaluation.lpips import BACKBONES, Lpips
from xrdslam.evaluation.metrics import JsonValue, MetricGroup

__all__ = [
    "MEASURES",
    "Comparison",
    "EvaluatedFrame",
    "FrameRow",
    "Frames",
    "Perceptual",
    "Render",
    "RenderingMetrics",
]

Render = Callable[[Camera, Tensor], Rendering]
Image = Float64[Tensor, "h w 3"]
Depth = Float64[Tensor, "h w"]

IMAGE_MEASURES: dict[str, Callable[[Tensor, Tensor], Tensor]] = {"psnr_db": psnr, "ssim": ssim, "ms_ssim": ms_ssim}
LPIPS_KEYS = {backbone: f"lpips_{backbone}" for backbone in BACKBONES}
MEASURES = (*IMAGE_MEASURES, *LPIPS_KEYS.values(), "depth_l1_cm")
MASK_MEANING = {
    "valid_depth": "both images times [measured depth > 0], all pixels averaged",
    "none": "whole images",
}


VIEWS_MEANING = {
    "train": "frames that the mapper was given or may have been given",
    "held_out": "frames that were tracked and kept from the mapper",
}


@runtime_checkable
class EvaluatedFrame(Protocol):
    """What the evaluation reads of a frame."""

    @property
    def index(self) -> int:
        """Its place in the sequence."""

    @property
    def camera(self) -> Camera:
        """The camera it was taken with."""

    @property
    def rgb(self) -> Float[Tensor, "h w 3"]:
        """Colour in [0, 1]."""

    @property
    def depth(self) -> Float[Tensor, "h w"] | None:
        """Measured depth [m], 0 = none."""


Frames = Iterable[EvaluatedFrame] | Dataset[Any]


@dataclass(frozen=True)
class FrameRow:
    """The numbers of one frame. None: not defined (`RenderingMetrics.reasons` says why); NaN: a broken rendering."""

    index: int
    psnr_db: float | None
    ssim: float | None
    ms_ssim: float | None
    lpips_alex: float | None
    lpips_squeeze: float | None
    depth_l1_cm: float | None


@dataclass(frozen=True)
class Perceptual:
    """The LPIPS networks that there are, where their weights came from, and why there are no others."""

    networks: Mapping[str, Lpips] = field(default_factory=dict)
    sources: Mapping[str, str] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(
        default_factory=lambda: dict.fromkeys(BACKBONES, "no LPIPS weights were asked for")
    )


@dataclass(frozen=True)
class Comparison:
    """What was found of one frame, and why what is missing is missing."""

    row: FrameRow
    reasons: Mapping[str, str]


class RenderingMetrics:
    """Gathers rows of compared frames and their means, under one protocol."""

    def __init__(
        self,
        every: int,
        mask: str = "valid_depth",
        views: str = "train",
        poses: str = "final",
        perceptual: Perceptual | None = None,
    ) -> None:
        """Compare under `mask`; `views` says whether the map was built from these frames, `poses` whose they are."""
        if mask not in MASK_MEANING:
            raise EvaluationError(f"mask {mask!r}: must be one of {', '.join(MASK_MEANING)}")
        self.every, self.mask, self.views, self.poses = every, mask, views, poses
        self.perceptual = perceptual or Perceptual()
        self.rows: list[FrameRow] = []
        self.reasons: dict[str, str] = {}

    def add(self, frame: EvaluatedFrame, rendering: Rendering) -> FrameRow:
        """Compare a rendering with its frame and keep the row."""
        return self.keep(self.compare(frame, rendering))

    def keep(self, comparison: Comparison) -> FrameRow:
        """Take a comparison into the means."""
        self.rows.append(comparison.row)
        self.reasons.update(comparison.reasons)
        return comparison.row

    def compare(self, frame: EvaluatedFrame, rendering: Rendering) -> Comparison:
        """Compare a rendering with its frame, in float64 (LPIPS in float32). Nothing is changed: threads may."""
        if rendering.rgb.shape != frame.rgb.shape or rendering.depth.shape != frame.rgb.shape[:2]:
            raise EvaluationError(
                f"frame {frame.index} is {tuple(frame.rgb.shape)}, its rendering {tuple(rendering.rgb.shape)} "
                f"with depth {tuple(rendering.depth.shape)}; render with the frame's own camera"
            )
        photograph = _exact(frame.rgb)
        measured = None if frame.depth is None else _exact(frame.depth)
        rendered, depth = (_exact(image).to(photograph.device) for image in (rendering.rgb, rendering.depth))
        reasons = {LPIPS_KEYS[name]: reason for name, reason in self.perceptual.reasons.items()}
        scores = self._image_scores(rendered.clamp(0.0, 1.0), photograph, measured, reasons)
        row = FrameRow(frame.index, **scores, depth_l1_cm=_depth_score(depth, measured, reasons))
        return Comparison(row, reasons)

    def _image_scores(
        self, rendered: Image, photograph: Image, measured: Depth | None, reasons: dict[str, str]
    ) -> dict[str, float | None]:
        networks = {LPIPS_KEYS[name]: network for name, network in self.perceptual.networks.items()}
        measures: dict[str, Callable[[Tensor, Tensor], Tensor]] = IMAGE_MEASURES | networks
        scores: dict[str, float | None] = dict.fromkeys((*IMAGE_MEASURES, *LPIPS_KEYS.values()))
        if self.mask == "valid_depth":
            if measured is None or not (measured > 0).any():
                reason = "without measured depth there is no valid-depth mask; evaluation.mask=none compares all"
                reasons.update(dict.fromkeys(measures, reason))
                return scores
            rendered, photograph = (_masked(image, measured > 0) for image in (rendered, photograph))
        return scores | {key: _score(key, measures[key], rendered, photograph, reasons) for key in measures}

    def group(self) -> MetricGroup:
        """Return the means over frames and their protocol; one broken rendering makes a mean null, never better."""
        group = MetricGroup(f"rendering/{self.views}", self.protocol())
        for key in MEASURES:
            scores = {row.index: score for row in self.rows if (score := getattr(row, key)) is not None}
            if not scores:
                group.refuse((key,), self.reasons.get(key, "no frame was rendered"))
            elif all(map(math.isfinite, scores.values())):
                group.add(key, math.fsum(scores.values()) / len(scores))
            else:
                group.refuse((key,), _broken(scores))
        return group

    def protocol(self) -> dict[str, JsonValue]:
        """Say under which conditions these rows were made."""
        scored = {key for key in MEASURES if any(getattr(row, key) is not None for row in self.rows)}
        partly = {key: reason for key, reason in self.reasons.items() if key in scored}
        return {
            **({"left_out_because": dict(partly)} if partly else {}),
            "views": self.views,
            "poses": self.poses,
            "stride": self.every,
            "views_meaning": VIEWS_MEANING[self.views],
            "mask": self.mask,
            "mask_meaning": MASK_MEANING[self.mask],
            "frames": len(self.rows),
            "frames_in_mean": {key: sum(getattr(row, key) is not None for row in self.rows) for key in MEASURES},
            "ground_truth_depth_given_to_renderer": "no",
            "rendering_clamped_to_unit_range": "yes",
            "mean": "over frames, of each frame's value",
            "psnr_db": "peak 1, squared error pooled over pixels and channels",
            "ssim": "Wang 2004, 11x11 Gaussian window, sigma 1.5 px",
            "ms_ssim": "Wang 2003, 5 scales",
            "lpips": "Zhang 2018, v0.1, images scaled from [0, 1] to [-1, 1], each backbone under its own name",
            "lpips_weights": dict(self.perceptual.sources),
            "depth_l1_cm": "mean |rendered - measured| where measured > 0, rendering as is, holes counted",
        }


def _depth_score(depth: Depth, measured: Depth | None, reasons: dict[str, str]) -> float | None:
    if measured is None:
        reasons["depth_l1_cm"] = "a frame has no measured depth"
        return None
    return _score("depth_l1_cm", depth_l1_cm, depth, measured, reasons)


def _score(
    key: str, measure: Callable[[Tensor, Tensor], Tensor], x: Tensor, y: Tensor, reasons: dict[str, str]
) -> float | None:
    try:
        return measure(x, y).item()
    except EvaluationError as error:
        reasons[key] = str(error)
        return None


def _broken(scores: Mapping[int, float]) -> str:
    broken = [index for index, score in scores.items() if math.isnan(score)]
    if broken:
        return f"{len(broken)} renderings have non-finite values, the first is of frame {broken[0]}"
    equal = [index for index, score in scores.items() if math.isinf(score)]
    return f"{len(equal)} renderings are without bound, or equal the photograph; the first is of frame {equal[0]}"


def _exact(image: Tensor) -> Tensor:
    """Return it in float64, on its own device if that can."""
    return image.detach().to("cpu" if image.device.type == "mps" else image.device, torch.float64)


def _masked(image: Image, is_kept: Bool[Tensor, "h w"]) -> Image:
    """Return the image, black where not kept (selected, not multiplied: 0 x NaN is NaN)."""
    return torch.where(is_kept[..., None], image, torch.zeros_like(image))
