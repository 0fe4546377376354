"""What a sequence holds, in figures that show what was read wrong."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from xrdslam.core.camera import Camera
from xrdslam.core.dataset import Dataset
from xrdslam.core.errors import DataError
from xrdslam.core.frame import Frame
from xrdslam.datasets.consistency import Agreement, agreement

__all__ = ["Inspection", "inspect_dataset"]

MOST_FRAMES = 24
AGREES = 0.03
"""Kinects agree within 1 %, rendered depth within 0.01 %; what misses by more than this is worth a look."""


@dataclasses.dataclass
class Inspection:
    """Figures of a sequence; depth and poses where there are any. Some `looked_at` frames stand for all."""

    name: str
    num_frames: int
    looked_at: list[int]
    num_damaged: int
    first_fault: str
    camera: Camera
    modalities: list[str]
    seconds: float
    frames_per_second: float
    largest_gap_s: float
    depth_quantiles_m: list[float] | None
    """Of measured pixels: least, 5 %, half, 95 %, greatest."""
    depth_share: float | None
    """Pixels that have a depth."""
    num_poses: int
    path_m: float
    extent_m: list[float] | None
    """Of the camera centres along x, y, z."""
    agreement: Agreement | None

    def lines(self) -> Iterator[str]:
        """Yield what a user reads."""
        c = self.camera
        yield f"{self.name}: {self.num_frames} frames, {', '.join(self.modalities)}"
        yield (
            f"  time         {self.seconds:.2f} s, {self.frames_per_second:.2f} frames/s,"
            f" largest gap {self.largest_gap_s * 1000:.0f} ms"
        )
        yield f"  camera       {c.width}x{c.height} px, fx {c.fx:.2f}, fy {c.fy:.2f}, cx {c.cx:.2f}, cy {c.cy:.2f} px"
        yield f"               {field_of_view_deg(c):.1f} degrees wide, centre {centre_offset(c)}"
        yield from self._depth_lines()
        yield from self._pose_lines()
        if self.num_damaged:
            yield f"  DAMAGED      {self.num_damaged} frames, first: {self.first_fault}"
        for warning in self.warnings():
            yield f"  LOOK HERE    {warning}"

    def _depth_lines(self) -> Iterator[str]:
        if self.depth_quantiles_m is None or self.depth_share is None:
            yield "  depth        none"
            return
        least, low, half, high, most = self.depth_quantiles_m
        yield (
            f"  depth        {self.depth_share:.0%} of pixels; median {half:.2f} m, 5-95 % {low:.2f}-{high:.2f} m,"
            f" range {least:.3f}-{most:.2f} m"
        )

    def _pose_lines(self) -> Iterator[str]:
        if not self.num_poses or self.extent_m is None:
            yield "  poses        none"
            return
        x, y, z = self.extent_m
        yield (
            f"  poses        {self.num_poses} of {self.num_frames} frames; path {self.path_m:.2f} m,"
            f" extent {x:.2f} x {y:.2f} x {z:.2f} m"
        )
        if self.agreement is not None:
            a = self.agreement
            yield (
                f"  reprojection depth under the poses is off by {a.as_read:.2%} of itself (median, {a.num_pairs} pairs"
                f" of frames, {a.motion_m * 100:.1f} cm apart)"
            )

    def warnings(self) -> Iterator[str]:
        """Yield what is likely to be wrong."""
        c, a = self.camera, self.agreement
        if not (0.35 < (c.cx + 0.5) / c.width < 0.65 and 0.35 < (c.cy + 0.5) / c.height < 0.65):
            yield "the principal point is far from the middle: intrinsics of another size, or of a cropped image?"
        if not 20 < field_of_view_deg(c) < 130:
            yield "the field of view is unusual: intrinsics of another size?"
        if not 0.8 < c.fx / c.fy < 1.25:
            yield "fx and fy differ by more than a quarter: pixels of most cameras are square"
        if self.depth_quantiles_m is not None and not 0.1 < self.depth_quantiles_m[2] < 20:
            yield f"a median depth of {self.depth_quantiles_m[2]:.3g} m: is dataset.depth_scale right?"
        if self.depth_share is not None and self.depth_share < 0.2:
            yield f"only {self.depth_share:.0%} of pixels have a depth"
        if a is not None and a.better is not None:
            yield (f"depth would agree better ({a.otherwise[a.better]:.2%} instead of {a.as_read:.2%}) if {a.better}")
        elif a is not None and a.as_read > AGREES:
            yield f"depth and poses disagree by {a.as_read:.0%}: wrong intrinsics, drift, or times that are off?"


def inspect_dataset(dataset: Dataset) -> Inspection:
    """Look at up to `MOST_FRAMES` frames, evenly spread, and at the neighbours that the reprojection needs."""
    faults = _faults(dataset)
    looked_at = sorted({round(k) for k in np.linspace(0, len(dataset) - 1, min(MOST_FRAMES, len(dataset)))})
    frames: dict[int, Frame] = {}

    def read(index: int) -> Frame:
        return dataset[index]

    depths, shares = [], []
    for index in looked_at:
        try:
            frames[index] = read(index)
        except DataError as error:
            faults.setdefault(index, str(error))
            continue
        depth = frames[index].depth
        if depth is not None:
            measured = depth[depth > 0].numpy()
            depths.append(measured[:: max(1, len(measured) // 20_000)])
            shares.append(float((depth > 0).float().mean()))
    if not frames:
        raise DataError(f"{dataset.name}: no frame of {len(looked_at)} can be read; first: {min(faults.items())[1]}")
    times, centres = _times_and_centres(dataset, frames)
    gaps = np.diff(times) / 1e9
    values = np.concatenate(depths) if depths else np.zeros(0)
    known = np.isfinite(centres).all(1)
    usable = {"depth", "pose"} <= dataset.modalities and not faults
    return Inspection(
        name=dataset.name,
        num_frames=len(dataset),
        looked_at=list(frames),
        num_damaged=len(faults),
        first_fault=min(faults.items())[1] if faults else "",
        camera=dataset.camera,
        modalities=sorted(dataset.modalities),
        seconds=float(gaps.sum()),
        frames_per_second=1 / float(np.median(gaps)) if len(gaps) else 0.0,
        largest_gap_s=float(gaps.max()) if len(gaps) else 0.0,
        depth_quantiles_m=np.quantile(values, [0, 0.05, 0.5, 0.95, 1]).tolist() if len(values) else None,
        depth_share=float(np.mean(shares)) if shares else None,
        num_poses=int(known.sum()),
        path_m=float(np.linalg.norm(np.diff(centres[known], axis=0), axis=1).sum()),
        extent_m=np.ptp(centres[known], axis=0).tolist() if known.any() else None,
        agreement=agreement(read, len(dataset)) if usable else None,
    )


def field_of_view_deg(camera: Camera) -> float:
    """Return the horizontal field of view."""
    left, right = camera.cx + 0.5, camera.width - 0.5 - camera.cx
    return float(np.degrees(np.arctan(left / camera.fx) + np.arctan(right / camera.fx)))


def centre_offset(camera: Camera) -> str:
    """Say how far the principal point is from the image's middle."""
    dx, dy = camera.cx - (camera.width - 1) / 2, camera.cy - (camera.height - 1) / 2
    return f"({dx:+.1f}, {dy:+.1f}) px from the middle"


def _faults(dataset: Dataset) -> dict[int, str]:
    """Return what is wrong with which frame without decoding any; -1 is the sequence as a whole."""
    try:
        dataset.check()
    except DataError as error:
        found = getattr(dataset, "fault_of", None)
        faults = {} if found is None else {i: f for i in range(len(dataset)) if (f := found(i)) is not None}
        return faults or {-1: str(error)}
    return {}


def _times_and_centres(dataset: Dataset, frames: dict[int, Frame]) -> tuple[np.ndarray, np.ndarray]:
    """Return times [ns] and camera centres [m] of all frames where the dataset lists them, else of those read."""
    records = getattr(dataset, "records", None)
    if records is not None:
        poses = [record.T_world_camera for record in records]
        return np.array([record.timestamp_ns for record in records], dtype=np.int64), _centres(poses)
    poses = [frame.T_world_camera_gt for frame in frames.values()]
    return np.array([frame.timestamp_ns for frame in frames.values()], dtype=np.int64), _centres(poses)


def _centres(poses: list[np.ndarray | None]) -> np.ndarray:
    unknown = np.full(3, np.nan)
    return np.array([unknown if pose is None else np.asarray(pose)[:3, 3] for pose in poses]).reshape(-1, 3)
