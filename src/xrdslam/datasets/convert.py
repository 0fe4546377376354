"""Any sequence, written in a layout that other tools read."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from xrdslam.core.dataset import Dataset
from xrdslam.core.errors import DataError
from xrdslam.core.files import write_text
from xrdslam.core.frame import Frame
from xrdslam.datasets.times import NS_PER_S

__all__ = ["LAYOUTS", "convert"]

MOST_LEVELS = 65535


def convert(dataset: Dataset, layout: str, folder: Path, depth_scale: float | None = None) -> int:
    """Write every frame in a layout and return how many; the folder appears when all is written, or not at all.

    Colour is kept to the bit that 8 have, depth to half a level of `depth_scale` (levels per metre; default the
    layout's), poses and, in TUM's layout, times exactly. Frames that on_error=skip leaves out are left out.
    """
    if folder.exists():
        raise DataError(f"{folder}: exists; choose a folder that does not")
    if "depth" not in dataset.modalities:
        raise DataError(f"{dataset.name}: has no depth, which the layout of {layout} needs")
    write, default_scale = LAYOUTS[layout]
    part = folder.with_name(f".{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        count = write(dataset, part, depth_scale or default_scale)
        part.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return count


def _write_replica(dataset: Dataset, folder: Path, scale: float) -> int:
    """Write results/frame*.png, depth*.png, traj.txt and cam_params.json; there is no place for times."""
    poses = []
    for count, frame in enumerate(dataset.frames()):
        pose = frame.T_world_camera_gt
        if pose is None or not bool(pose.isfinite().all()):
            raise DataError(
                f"{dataset.name}: frame {frame.index} has no known pose, and this layout has one for each; convert to"
                " tum_rgbd, or choose frames that have with dataset.frames"
            )
        _write_images(frame, folder / "results" / f"frame{count:06d}.png", folder / "results" / f"depth{count:06d}.png",
                      scale)  # fmt: skip
        poses.append(" ".join(repr(float(v)) for v in pose.double().flatten()))
    c = dataset.camera
    camera = {"w": c.width, "h": c.height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy, "scale": scale}
    write_text(folder / "cam_params.json", json.dumps({"camera": camera}, indent=2) + "\n")
    write_text(folder / "traj.txt", "\n".join(poses) + "\n")
    return len(poses)


def _write_tum_rgbd(dataset: Dataset, folder: Path, scale: float) -> int:
    """Write rgb/, depth/ and their lists, groundtruth.txt where there are poses, and the camera as calibration.txt."""
    lists: dict[str, list[str]] = {"rgb": [], "depth": []}
    truth = []
    for frame in dataset.frames():
        stamp = f"{frame.timestamp_ns // NS_PER_S}.{frame.timestamp_ns % NS_PER_S:09d}"
        _write_images(frame, folder / "rgb" / f"{stamp}.png", folder / "depth" / f"{stamp}.png", scale)
        for name, lines in lists.items():
            lines.append(f"{stamp} {name}/{stamp}.png")
        pose = None if frame.T_world_camera_gt is None else frame.T_world_camera_gt.double().numpy()
        if pose is not None and np.isfinite(pose).all():
            quat_xyzw = Rotation.from_matrix(pose[:3, :3]).as_quat()
            truth.append(" ".join([stamp, *(repr(float(v)) for v in (*pose[:3, 3], *quat_xyzw))]))
    for name, lines in lists.items():
        write_text(folder / f"{name}.txt", "\n".join(["# timestamp filename", *lines, ""]))
    if truth:
        write_text(folder / "groundtruth.txt", "\n".join(["# timestamp tx ty tz qx qy qz qw", *truth, ""]))
    c = dataset.camera
    write_text(
        folder / "calibration.txt",
        " ".join(map(repr, (float(c.fx), float(c.fy), float(c.cx), float(c.cy), c.width, c.height))) + "\n",
    )
    return len(lists["rgb"])


def _write_images(frame: Frame, rgb: Path, depth: Path, scale: float) -> None:
    rgb.parent.mkdir(parents=True, exist_ok=True)
    depth.parent.mkdir(parents=True, exist_ok=True)
    assert frame.depth is not None, "asked for before the first frame"
    levels = np.round(frame.depth.double().numpy() * scale)
    if levels.max() > MOST_LEVELS:
        raise DataError(
            f"frame {frame.index}: a depth of {float(frame.depth.max()):.2f} m is more than 65535 levels of which"
            f" {scale:g} are a metre; give --depth-scale 1000 (up to 65 m), or cut at {MOST_LEVELS / scale:.2f} m with"
            " max_depth"
        )
    colour = np.round(frame.rgb.numpy() * 255).astype(np.uint8)
    for path, image in ((rgb, colour[..., ::-1]), (depth, levels.astype(np.uint16))):
        if not cv2.imwrite(str(path), image):
            raise DataError(f"{path}: cannot be written; is there room?")


LAYOUTS: dict[str, tuple[Callable[[Dataset, Path, float], int], float]] = {
    "replica": (_write_replica, 6553.5),
    "tum_rgbd": (_write_tum_rgbd, 5000.0),
}
"""Each layout: what writes it, and its levels of depth per metre."""
