"""EuRoC MAV: grey global-shutter images, an IMU, no depth.

    <root>/V1_01_easy/mav0/cam0/data.csv            time [ns], file; likewise cam1
                           cam0/data/<time>.png     752x480, 8 bits, grey
                           cam0/sensor.yaml         intrinsics, distortion, T_BS (camera to body)
                           imu0/data.csv            time [ns], angular velocity [rad/s], specific force [m/s^2]
                           imu0/sensor.yaml         T_BS (IMU to body)
                           state_groundtruth_estimate0/data.csv     time [ns], p, q (w first) of the BODY, and more

The first row of a csv may or may not be a comment. Times are integers throughout: as float64 they lose their last
digits. A frame carries the IMU's samples since the frame before it, in body axes; the first carries none. Poses are the
camera's: T_world_camera = T_world_body T_body_camera; `T_body_camera` is for those who use the IMU.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import torch

from xrdslam.core.dataset import Modality
from xrdslam.core.errors import DataError
from xrdslam.core.frame import Frame, StereoView
from xrdslam.datasets.config import EurocConfig
from xrdslam.datasets.fit import ImageFit
from xrdslam.datasets.folders import dataset_name, inside, scene_folder
from xrdslam.datasets.imu import ImuTrack
from xrdslam.datasets.rigs import Mounted, read_mounted, rectified_pair
from xrdslam.datasets.sequence import Record, RgbdSequence, SourceCamera
from xrdslam.datasets.tables import read_rows
from xrdslam.datasets.times import NS_PER_S, nanoseconds
from xrdslam.datasets.tracks import Track, read_track

__all__ = ["EurocDataset"]


class EurocDataset(RgbdSequence):
    """A sequence of EuRoC MAV, through one camera or, rectified, through both."""

    may_be_grey: ClassVar[bool] = True

    def __init__(self, config: EurocConfig) -> None:
        """Read the tables, the sensors' mountings and the ground truth."""
        scene = scene_folder(config)
        self.folder = scene / "mav0" if (scene / "mav0").is_dir() else scene
        mounted = read_mounted(self.folder / config.camera / "sensor.yaml")
        self._right: dict[int, Path] = {}
        self._right_fit: ImageFit | None = None
        images, faults = _images(self.folder / config.camera)
        if config.stereo:
            mounted = self._read_right(config, mounted, faults)
        self.T_body_camera = mounted.T_body_sensor
        self.imu = ImuTrack.read(self.folder / "imu0", faults)
        truth = _ground_truth(self.folder, faults)
        tolerance_ns = round(config.max_time_offset_s * NS_PER_S)
        records = [
            Record(
                time_ns,
                path,
                T_world_camera=None if truth is None else truth.at(time_ns, tolerance_ns) @ self.T_body_camera,
                fault=self._lacks_right(path, time_ns) if config.stereo else None,
            )
            for time_ns, path in images.items()
        ]
        name = dataset_name(config, scene)
        super().__init__(config, name, records, SourceCamera(mounted.camera, mounted.stated_in), faults)
        if mounted.maps is not None:
            self._fit.rectify(mounted.maps)

    @property
    def modalities(self) -> frozenset[Modality]:
        """What every frame carries."""
        stereo: frozenset[Modality] = frozenset({"stereo"} if self._right_fit is not None else ())
        imu: frozenset[Modality] = frozenset({"imu"} if self.imu is not None else ())
        return super().modalities | stereo | imu

    def __getitem__(self, index: int) -> Frame:
        """Read one frame, with the IMU's samples since the one before it in the list."""
        frame = super().__getitem__(index)
        before = self.records[frame.index - 1].timestamp_ns if frame.index else frame.timestamp_ns
        frame.imu = None if self.imu is None else self.imu.between(before, frame.timestamp_ns)
        if self._right_fit is not None:
            path = self._right[frame.timestamp_ns]
            rgb = self.read_rgb(path)
            self._hold_to_size(path, rgb.shape[1::-1], self._right_fit.rgb_size)
            frame.stereo = StereoView(torch.from_numpy(self._right_fit.rgb(rgb)), self._baseline_m)
        return frame

    def frames(self, start: int = 0) -> Iterator[Frame]:
        """Yield every frame; where one is skipped, the next carries the samples since the last that came."""
        before = self.records[start - 1].timestamp_ns if start else None  # the frame that a resumed run ended with
        for frame in super().frames(start):
            if self.imu is not None and before is not None:
                frame.imu = self.imu.between(before, frame.timestamp_ns)
            before = frame.timestamp_ns
            yield frame

    def probe(self, record: Record) -> None:
        """Look at the left image, and at the right one where there is one."""
        super().probe(record)
        if self._right_fit is not None:
            path = self._right[record.timestamp_ns]
            self._hold_to_size(path, self.probe_rgb(path), self._right_fit.rgb_size)

    def _read_right(self, config: EurocConfig, left: Mounted, faults: list[str]) -> Mounted:
        """Find the right images and rectify both cameras; return the left one."""
        right = read_mounted(self.folder / "cam1" / "sensor.yaml")
        self._right, more = _images(self.folder / "cam1")
        faults.extend(more)
        left, right, self._baseline_m = rectified_pair(left, right)
        self._right_fit = ImageFit(right.camera, config.size, crop=config.crop)
        assert right.maps is not None, "a rectified camera has maps"
        self._right_fit.rectify(right.maps)
        return left

    def _lacks_right(self, path: Path, time_ns: int) -> str | None:
        if time_ns in self._right:
            return None
        return (
            f"{path}: cam1/data.csv has no image of this time; complete it, leave such frames out with"
            " dataset.on_error=skip, or take one camera with dataset.stereo=false"
        )


def _images(folder: Path) -> tuple[dict[int, Path], list[str]]:
    """Return the images of a camera by their times [ns], in order, and what is wrong with the table's lines."""
    found: dict[int, Path] = {}
    faults = []
    for cells, source in read_rows(folder / "data.csv"):
        try:
            if len(cells) < 2:
                raise DataError(f"{source}: a row is a time and a file, found {cells}; complete it")
            time_ns, path = nanoseconds(cells[0], source, unit=1), inside(folder / "data", cells[1], source)
        except DataError as error:
            faults.append(str(error))
            continue
        if time_ns in found:
            faults.append(f"{source}: the time {cells[0]} stands there twice; remove one of its rows")
        found.setdefault(time_ns, path)
    if not found:
        raise DataError(f"{folder / 'data.csv'}: lists no image; it has a row `time,file` for each")
    return dict(sorted(found.items())), faults


def _ground_truth(folder: Path, faults: list[str]) -> Track | None:
    """Return the body's poses, none where the folder has no ground truth."""
    path = folder / "state_groundtruth_estimate0" / "data.csv"
    if not path.is_file():
        return None
    track, found = read_track(read_rows(path), "wxyz", unit=1)
    faults.extend(found)
    return track
