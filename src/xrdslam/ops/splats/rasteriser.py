"""The CPU renderer: the numba kernels in order, as one differentiable torch function."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from xrdslam.core.errors import ConfigError
from xrdslam.ops.splats import backward, binning, forward, gradients, layout, projection
from xrdslam.ops.splats.scratch import Scratch
from xrdslam.ops.splats.tile_lists import BuiltLists, MapKey, TileLists
from xrdslam.ops.splats.types import FRUSTUM_CLAMP, PinholeLike, SplatRender
from xrdslam.ops.threads import kernel_threads

__all__ = ["render_numba"]


@dataclass(frozen=True)
class _Settings:
    camera: PinholeLike
    near: float
    lowpass: float
    lists: TileLists | None


@dataclass
class _Map:
    """The map's and the pose's memory as the kernels take it."""

    means: np.ndarray
    log_scales: np.ndarray
    logits: np.ndarray
    colors: np.ndarray
    quats: np.ndarray
    T_camera_world: np.ndarray


@dataclass
class _Drawn:
    """What the backward needs of a forward."""

    scratch: Scratch
    view: np.ndarray
    lists: BuiltLists
    records: np.ndarray
    stops: np.ndarray


def render_numba(
    means: Tensor,
    log_scales: Tensor,
    opacity_logits: Tensor,
    colors: Tensor,
    T_camera_world: Tensor,
    camera: PinholeLike,
    quats_wxyz: Tensor | None = None,
    *,
    near: float = 0.2,
    lowpass: float = 0.3,
    lists: TileLists | None = None,
) -> SplatRender:
    """Render float32 Gaussians on the CPU; see `xrdslam.ops.splats.render` for the meaning of the arguments."""
    side = layout.TILE * layout.TILES_MAX
    if camera.width > side or camera.height > side:
        raise ConfigError(f"image of {camera.width}x{camera.height} px: this renderer takes at most {side} px a side")
    quats = means.new_empty(0, 4) if quats_wxyz is None else quats_wxyz
    settings = _Settings(camera, near, lowpass, lists)
    inputs = (means, log_scales, opacity_logits.reshape(-1), colors, T_camera_world, quats)
    return SplatRender(*_Rasterise.apply(*inputs, settings))  # type: ignore[no-untyped-call]  # torch


class _Rasterise(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *arguments: Any) -> tuple[Tensor, ...]:  # noqa: ANN401  # torch's are untyped
        *tensors, settings = arguments
        camera = settings.camera
        rgb = torch.empty(camera.height, camera.width, 3)
        depth, opacity = torch.empty(camera.height, camera.width), torch.empty(camera.height, camera.width)
        with kernel_threads() as workers:
            drawn = _draw(_map(tensors), tensors, settings, workers, (rgb.numpy(), depth.numpy(), opacity.numpy()))
        if any(ctx.needs_input_grad):
            ctx.save_for_backward(*tensors, rgb, depth, opacity)
            ctx.set_materialize_grads(False)
            ctx.drawn, ctx.camera = drawn, camera
        return rgb, depth, opacity

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *cotangents: Tensor | None) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        tensors, images = ctx.saved_tensors[:6], ctx.saved_tensors[6:]
        pose_only = not (any(ctx.needs_input_grad[:4]) or ctx.needs_input_grad[5])
        d_images = [
            torch.zeros_like(x) if g is None else g.contiguous() for x, g in zip(images, cotangents, strict=True)
        ]
        with kernel_threads() as workers:
            moments = _moments(ctx.drawn, ctx.camera, workers, not pose_only, [t.numpy() for t in (*images, *d_images)])
            grads, d_pose = _chain(ctx.drawn, _map(tensors), tensors, pose_only, moments)
        needed = ctx.needs_input_grad
        ordered = (*grads[:4], d_pose, grads[4])
        return (*(g if need else None for g, need in zip(ordered, needed, strict=False)), None)


def _map(tensors: Sequence[Tensor]) -> _Map:
    means, log_scales, logits, colors, pose, quats = (t.detach().contiguous().numpy() for t in tensors)
    return _Map(means, log_scales, logits, colors, quats, pose)


def _view(pose: np.ndarray, settings: _Settings) -> np.ndarray:
    """Return the pose, the intrinsics and the limits as the kernels read them."""
    camera, lists = settings.camera, settings.lists
    view = np.empty(layout.VIEW, np.float32)
    view[:9], view[9:12] = pose[:3, :3].reshape(9), pose[:3, 3]
    limit_x = FRUSTUM_CLAMP * camera.width / (2 * camera.fx)
    limit_y = FRUSTUM_CLAMP * camera.height / (2 * camera.fy)
    slack = (0.0, 0.0, 0.0) if lists is None else (lists.margin_px, lists.max_translation, lists.max_rotation)
    limits = (limit_x, limit_y, settings.lowpass, settings.near, *slack)
    view[12:] = (camera.fx, camera.fy, camera.cx, camera.cy, *limits)
    return view


def _draw(
    gaussians: _Map, tensors: Sequence[Tensor], settings: _Settings, workers: int, images: tuple[np.ndarray, ...]
) -> _Drawn:
    """Project, list, composite."""
    scratch = Scratch()
    chunk = layout.chunk_size(len(gaussians.means))
    chunks = -(-len(gaussians.means) // chunk)
    view = _view(gaussians.T_camera_world, settings)
    records = scratch.empty((chunks * chunk, layout.RECORD), np.float32)
    lists = _project_again(gaussians, tensors, settings, view, chunk, records)
    if lists is None:
        lists = _project_fresh(gaussians, tensors, settings, view, chunk, records)
    tiles = len(lists.offsets) - 1
    stops = scratch.empty(tiles, np.int64)
    forward.render_tiles(
        workers,
        settings.camera.width,
        settings.camera.height,
        records,
        lists.offsets,
        lists.is_sorted,
        lists.keys,
        scratch.empty(lists.num_slots if not lists.is_sorted else 0, np.uint64),
        lists.entries,
        stops,
        scratch.empty(1, np.int64),
        scratch.empty((workers, layout.BLOCKS**2 * forward.STATE), np.float32),
        scratch.empty((workers, binning.RADIX), np.int64),
        *images,
    )
    lists.is_sorted = True
    return _Drawn(scratch, view, lists, records, stops)


def _project_fresh(
    gaussians: _Map, tensors: Sequence[Tensor], settings: _Settings, view: np.ndarray, chunk: int, records: np.ndarray
) -> BuiltLists:
    """Find what can be seen, project it, and write the lists of all tiles, not yet sorted."""
    camera, scratch = settings.camera, Scratch()
    chunks = -(-len(gaussians.means) // chunk)
    tiles_x, tiles_y = -(-camera.width // layout.TILE), -(-camera.height // layout.TILE)
    candidates, counts = scratch.empty(chunks * chunk, np.int32), scratch.empty(chunks, np.int64)
    slots, slot_counts = scratch.empty((chunks * chunk, 2), np.int32), scratch.empty(chunks, np.int64)
    tile_counts = scratch.empty((chunks, tiles_x * tiles_y), np.int64)
    offsets = scratch.empty(tiles_x * tiles_y + 1, np.int64)
    g, size = gaussians, (camera.width, camera.height)
    projection.find_candidates(view, *size, g.means, g.log_scales, g.logits, chunk, candidates, counts)
    arrays = (g.means, g.log_scales, g.logits, g.colors, g.quats)
    projection.project_fresh(view, *size, *arrays, chunk, candidates, counts, records, slots, tile_counts, slot_counts)
    num_slots = int(binning.place(tile_counts, slot_counts, offsets))
    keys, entries = scratch.empty(num_slots, np.uint64), scratch.empty(num_slots, np.int32)
    binning.scatter(records, chunk, counts, slots, tiles_x, tile_counts, slot_counts, keys)
    built = BuiltLists(scratch, candidates, counts, slots, offsets, entries, keys, num_slots)
    if settings.lists is not None:
        settings.lists.keep(_key(tensors, settings), gaussians.T_camera_world, built)
    return built


def _project_again(
    gaussians: _Map, tensors: Sequence[Tensor], settings: _Settings, view: np.ndarray, chunk: int, records: np.ndarray
) -> BuiltLists | None:
    """Project what the caller's lists hold, if they still hold all that can be seen."""
    if settings.lists is None:
        return None
    settings.lists.num_renders += 1
    lists = settings.lists.held(_key(tensors, settings), gaussians.T_camera_world)
    if lists is None:
        return None
    broken = np.empty(len(lists.counts), np.int64)
    g, size = gaussians, (settings.camera.width, settings.camera.height)
    arrays = (g.means, g.log_scales, g.logits, g.colors, g.quats)
    projection.project_again(view, *size, *arrays, chunk, lists.candidates, lists.counts, lists.slots, records, broken)
    return None if broken.any() else lists


def _key(tensors: Sequence[Tensor], settings: _Settings) -> MapKey:
    means, log_scales, logits, _, _, quats = tensors
    return MapKey.of(settings.camera, (settings.near, settings.lowpass), (means, log_scales, logits, quats))


def _moments(
    drawn: _Drawn, camera: PinholeLike, workers: int, with_color: bool, images: Sequence[np.ndarray]
) -> np.ndarray:
    """Return the gradient slots of all Gaussians in all tiles."""
    lists = drawn.lists
    moments = drawn.scratch.empty((lists.num_slots, layout.RECORD), np.float32)
    state = drawn.scratch.empty((workers, layout.BLOCKS**2 * backward.STATE), np.float32)
    next_tile = drawn.scratch.empty(1, np.int64)
    lists_and_records = (drawn.records, lists.offsets, lists.entries, drawn.stops)
    size = (camera.width, camera.height)
    backward.tile_gradients(workers, *size, with_color, *lists_and_records, next_tile, state, *images, moments)
    return moments


def _chain(
    drawn: _Drawn, gaussians: _Map, tensors: Sequence[Tensor], pose_only: bool, moments: np.ndarray
) -> tuple[list[Tensor], Tensor]:
    """Return the gradients of the map's five tensors (empty ones with `pose_only`) and of T_camera_world."""
    lists, g = drawn.lists, gaussians
    chunk = layout.chunk_size(len(g.means))
    grads = [torch.empty(tensors[k].shape if not pose_only else [0] * tensors[k].ndim) for k in (0, 1, 2, 3, 5)]
    d_pose = np.zeros((len(lists.counts), gradients.POSE), np.float64)
    inputs = (g.means, g.log_scales, g.logits, g.quats, chunk, pose_only)
    outputs = (*(grad.numpy() for grad in grads), d_pose)
    gradients.gaussian_gradients(drawn.view, *inputs, lists.candidates, lists.counts, lists.slots, moments, *outputs)
    total = d_pose.sum(0)
    matrix = np.zeros((4, 4), np.float32)
    matrix[:3, :3], matrix[:3, 3] = total[:9].reshape(3, 3), total[9:]
    return grads, torch.from_numpy(matrix)
