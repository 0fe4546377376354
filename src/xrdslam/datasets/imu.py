"""Inertial samples beside a sequence of images."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64, Int64

from xrdslam.core.errors import DataError
from xrdslam.core.frame import ImuSamples
from xrdslam.datasets.rigs import read_mounting
from xrdslam.datasets.tables import read_rows
from xrdslam.datasets.times import nanoseconds

__all__ = ["ImuTrack"]


class ImuTrack:
    """Samples in time order, in body axes."""

    def __init__(
        self,
        timestamps_ns: Int64[np.ndarray, " n"],
        angular_velocity: Float64[np.ndarray, "n 3"],
        acceleration: Float64[np.ndarray, "n 3"],
    ) -> None:
        """Take angular velocity [rad/s] and specific force [m/s^2] at rising times."""
        self.timestamps_ns = timestamps_ns
        self.angular_velocity = angular_velocity
        self.acceleration = acceleration

    @classmethod
    def read(cls, folder: Path, faults: list[str]) -> "ImuTrack | None":
        """Read data.csv and sensor.yaml of an IMU's folder, none where there is no such folder; faults are added to."""
        if not folder.is_dir():
            return None
        T_body_imu = read_mounting(folder / "sensor.yaml")
        if np.abs(T_body_imu[:3, 3]).max() > 1e-3:
            raise DataError(
                f"{folder / 'sensor.yaml'}: the IMU sits {T_body_imu[:3, 3].tolist()} m from the body's origin; state"
                " the poses for a body at the IMU, which has no lever arm"
            )
        rows: dict[int, list[float]] = {}
        for cells, source in read_rows(folder / "data.csv"):
            try:
                time_ns, values = _sample(cells, source)
            except DataError as error:
                faults.append(str(error))
                continue
            if time_ns in rows:
                faults.append(f"{source}: the time {cells[0]} stands there twice; remove one of its rows")
            rows.setdefault(time_ns, values)
        times = np.array(sorted(rows), dtype=np.int64)
        table = np.array([rows[time] for time in times.tolist()], dtype=np.float64).reshape(-1, 6)
        turn = T_body_imu[:3, :3].T
        return cls(times, table[:, :3] @ turn, table[:, 3:] @ turn)

    def between(self, after_ns: int, until_ns: int) -> ImuSamples:
        """Return the samples behind one time and up to another, that one included."""
        first, last = np.searchsorted(self.timestamps_ns, [after_ns, until_ns], side="right")
        return ImuSamples(
            torch.from_numpy(self.timestamps_ns[first:last].copy()),
            torch.from_numpy(self.angular_velocity[first:last].astype(np.float32)),
            torch.from_numpy(self.acceleration[first:last].astype(np.float32)),
        )


def _sample(cells: list[str], source: str) -> tuple[int, list[float]]:
    try:
        values = [float(cell) for cell in cells[1:7]]
    except ValueError as error:
        raise DataError(f"{source}: a sample is numbers, found {cells[1:7]}; mend the row") from error
    if len(values) != 6 or not np.isfinite(values).all():
        raise DataError(f"{source}: a sample is a time and 6 finite numbers, found {cells}; mend or remove the row")
    return nanoseconds(cells[0], source, unit=1), values
