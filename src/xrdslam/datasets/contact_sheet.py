"""A picture of a sequence at a glance: frames, their depth, where the depth of one falls on another, the path."""

from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from xrdslam.core.dataset import Dataset
from xrdslam.core.files import replaced
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.datasets.inspection import Inspection

__all__ = ["write_contact_sheet"]

COLUMNS = 6
OVERLAID = 10  # frames between the two that are laid over one another


def write_contact_sheet(dataset: Dataset, inspection: Inspection, path: Path) -> None:
    """Draw it: two rows of frames with their depth, and below the path, the depths and the check of poses."""
    looked_at = inspection.looked_at
    chosen = [looked_at[round(k)] for k in np.linspace(0, len(looked_at) - 1, min(COLUMNS, len(looked_at)))]
    figure = Figure(figsize=(3 * COLUMNS, 10), dpi=80, layout="constrained")
    axes = figure.subplot_mosaic(
        [[f"rgb{i}" for i in range(COLUMNS)], [f"depth{i}" for i in range(COLUMNS)],
         ["path", "path", "depths", "depths", "overlay", "overlay"]],
    )  # fmt: skip
    figure.suptitle("\n".join(line.strip() for line in inspection.lines())[:900], fontsize=10, ha="left", x=0.01)
    far = inspection.depth_quantiles_m[3] if inspection.depth_quantiles_m else 1.0
    frames = {index: dataset[index] for index in chosen}
    for i in range(COLUMNS):
        frame = frames[chosen[i]] if i < len(chosen) else None
        _draw_frame(axes[f"rgb{i}"], axes[f"depth{i}"], frame, far)
    _draw_path(axes["path"], dataset, frames)
    _draw_depths(axes["depths"], list(frames.values()))
    _draw_overlay(axes["overlay"], dataset, inspection)
    with replaced(path) as temporary:
        figure.savefig(temporary, format="png")


def _draw_frame(rgb: Axes, depth: Axes, frame: Frame | None, far: float) -> None:
    rgb.axis("off")
    depth.axis("off")
    if frame is None:
        return
    rgb.imshow(frame.rgb.numpy())
    rgb.set_title(f"frame {frame.index}, {frame.timestamp_ns / 1e9:.3f} s", fontsize=9)
    if frame.depth is not None:
        shown = np.where(frame.depth.numpy() > 0, frame.depth.numpy(), np.nan)
        drawn = depth.imshow(shown, cmap="turbo", vmin=0, vmax=far)
        depth.figure.colorbar(drawn, ax=depth, orientation="horizontal", shrink=0.8, label="depth [m], blank: none")


def _draw_path(axes: Axes, dataset: Dataset, frames: dict[int, Frame]) -> None:
    """Draw the camera centres along the two axes in which they spread most, with the viewing directions of some."""
    records = getattr(dataset, "records", None)
    poses = [r.T_world_camera for r in records] if records else [f.T_world_camera_gt for f in frames.values()]
    known = [np.asarray(pose) for pose in poses if pose is not None and np.isfinite(np.asarray(pose)).all()]
    axes.set_title("camera path" if known else "no poses", fontsize=9)
    if not known:
        axes.axis("off")
        return
    centres = np.array([pose[:3, 3] for pose in known])
    a, b = sorted(np.argsort(np.ptp(centres, axis=0))[1:].tolist())
    axes.plot(centres[:, a], centres[:, b], "-", linewidth=1)
    axes.plot(centres[0, a], centres[0, b], "go", label="first")
    some = known[:: max(1, len(known) // 12)]
    forward = np.array([pose[:3, 2] for pose in some])
    at = np.array([pose[:3, 3] for pose in some])
    axes.quiver(at[:, a], at[:, b], forward[:, a], forward[:, b], width=0.004, color="tab:red", label="looks")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{'xyz'[a]} [m]", ylabel=f"{'xyz'[b]} [m]")
    axes.legend(fontsize=8)


def _draw_depths(axes: Axes, frames: list[Frame]) -> None:
    depths = [frame.depth[frame.depth > 0].numpy() for frame in frames if frame.depth is not None]
    axes.set_title("measured depths" if depths else "no depth", fontsize=9)
    if not depths:
        axes.axis("off")
    else:
        axes.hist(np.concatenate(depths), bins=80, density=True)
        axes.set(xlabel="depth [m]", yticks=[])


def _draw_overlay(axes: Axes, dataset: Dataset, inspection: Inspection) -> None:
    """Draw a frame with the points of another on it, coloured there: right poses make one picture of the two."""
    axes.axis("off")
    if inspection.agreement is None:
        axes.set_title("no depth with poses to check", fontsize=9)
        return
    other = min(OVERLAID, len(dataset) - 1)
    one, two = dataset[0], dataset[other]
    assert one.T_world_camera_gt is not None
    assert two.T_world_camera_gt is not None
    assert one.depth is not None
    picture = two.rgb.clone() * 0.35
    if bool(one.T_world_camera_gt.isfinite().all()) and bool(two.T_world_camera_gt.isfinite().all()):
        T = se3.inverse(two.T_world_camera_gt) @ one.T_world_camera_gt
        pixels, z = two.camera.project(se3.transform(T, one.points_camera()))
        seen = (z > 0) & two.camera.contains(pixels)
        u, v = pixels[seen].round().long().unbind(-1)
        far_first = torch.argsort(z[seen], descending=True)
        colours = one.rgb[one.depth > 0][seen][far_first]
        for dv, du in ((1, 1), (1, 0), (0, 1), (0, 0)):  # two pixels wide, so that points close to a surface
            rows = (v[far_first] + dv).clamp(max=two.camera.height - 1)
            picture[rows, (u[far_first] + du).clamp(max=two.camera.width - 1)] = colours
    axes.imshow(picture.numpy())
    axes.set_title(f"frame 0 moved by the poses onto frame {other} (dark: that frame alone)", fontsize=9)
