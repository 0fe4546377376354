"""A sequence of the toy room: exact depth and poses, rendered in milliseconds, nothing to download."""

from collections.abc import Collection

import torch
from jaxtyping import Float64
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.dataset import Dataset, Modality
from xrdslam.core.errors import DataError
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3, so3
from xrdslam.testing.toy_room import BALLS, PAINT, WALLS, colour, distance_to_balls, distance_to_walls

__all__ = ["ToySequence", "toy_sequence"]

FRAME_INTERVAL_NS = 33_333_333


class ToySequence(Dataset):
    """A hand-held walk of about 2 cm and 1 degree a frame; every read renders anew, so a changed frame harms nobody."""

    def __init__(
        self,
        num_frames: int,
        camera: Camera,
        seed: int = 0,
        num_balls: int = 2,
        modalities: Collection[Modality] = ("rgb", "depth", "pose"),
        damaged: Collection[int] = (),
    ) -> None:
        """Walk as `seed` says; reading one of the `damaged` frames raises a DataError."""
        self._camera = camera
        self._modalities = frozenset(modalities)
        self._damaged = frozenset(damaged)
        self._balls = BALLS[:num_balls]
        self._poses = _walk(num_frames, seed)
        self._seed = seed

    @property
    def name(self) -> str:
        return f"toy/room{self._seed}"

    @property
    def camera(self) -> Camera:
        return self._camera

    @property
    def modalities(self) -> frozenset[Modality]:
        return self._modalities

    @property
    def poses(self) -> Float64[Tensor, "n 4 4"]:
        """T_world_camera of every frame, exact."""
        return self._poses

    def __len__(self) -> int:
        return len(self._poses)

    def __getitem__(self, index: int) -> Frame:
        position = range(len(self))[index]
        if position in self._damaged:
            raise DataError(f"{self.name}: frame {position} is damaged")
        rgb, depth = self._view(self._poses[position])
        return Frame(
            index=position,
            timestamp_ns=1_000_000_000 + position * FRAME_INTERVAL_NS,
            camera=self._camera,
            rgb=rgb,
            depth=depth if "depth" in self._modalities else None,
            T_world_camera_gt=self._poses[position].float() if "pose" in self._modalities else None,
        )

    def _view(self, T_world_camera: Tensor) -> tuple[Tensor, Tensor]:
        """Render colour and depth at the pixel centres, in float64, rounded to float32."""
        directions_camera = self._camera.rays(self._camera.pixels(torch.float64)).reshape(-1, 3)
        directions = directions_camera @ T_world_camera[:3, :3].T
        origins = T_world_camera[:3, 3].expand_as(directions)
        to_balls = distance_to_balls(origins, directions, self._balls)
        depth = torch.minimum(distance_to_walls(origins, directions, WALLS), to_balls)
        rgb = colour(origins + depth[:, None] * directions, PAINT)
        size = (self._camera.height, self._camera.width)
        return rgb.reshape(*size, 3).float(), depth.reshape(size).float()


def toy_sequence(
    num_frames: int = 6, width: int = 64, height: int = 48, seed: int = 0, num_balls: int = 2
) -> ToySequence:
    """Return a short walk through the toy room, seen by a camera of about 60 degrees."""
    focal = 0.9 * width
    camera = Camera(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)
    return ToySequence(num_frames, camera, seed, num_balls)


def _walk(num_frames: int, seed: int) -> Float64[Tensor, "n 4 4"]:
    """Return a smooth path that stays within half a metre for some fifty frames, looking into a corner of the room."""
    generator = torch.Generator().manual_seed(seed)
    steps = torch.arange(num_frames, dtype=torch.float64)[:, None]
    swing, sway = torch.randn(2, 3, dtype=torch.float64, generator=generator)
    turn = 0.25 * torch.sin(0.06 * steps) * swing / swing.norm()
    drift = 0.4 * torch.sin(0.05 * steps) * sway / sway.norm()
    look = so3.exp(torch.tensor([-0.25, 0.5, 0.0], dtype=torch.float64))
    centre = torch.tensor([0.1, 0.1, -0.8], dtype=torch.float64)
    return se3.compose(so3.exp(turn) @ look, centre + drift)
