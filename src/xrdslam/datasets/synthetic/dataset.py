"""Synthetic rooms as a dataset: rendered on demand, exact in pose and depth, kept on disk."""

import dataclasses
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.dataset import Dataset, Modality
from xrdslam.core.errors import ConfigError
from xrdslam.core.files import write_bytes
from xrdslam.core.frame import Frame
from xrdslam.datasets.synthetic.cache import ArrayCache, content_key, user_cache_folder
from xrdslam.datasets.synthetic.config import SyntheticConfig
from xrdslam.datasets.synthetic.lighting import LightingConfig, bake, light_up
from xrdslam.datasets.synthetic.mesh import ply_bytes, scene_mesh
from xrdslam.datasets.synthetic.motion import handheld_loop
from xrdslam.datasets.synthetic.rooms import build_room
from xrdslam.datasets.synthetic.shading import Lightmap, World
from xrdslam.datasets.synthetic.tracer import render

__all__ = ["SyntheticDataset"]

VERSION = 1
"""Raised with every change that alters a rendered bit: it is part of every key of the cache."""
FRAMES_PER_SECOND = 30
LIGHTING = {"fine": LightingConfig(), "coarse": LightingConfig(spacing=0.3, light_samples=2, gather_rays=12, bounces=1)}


class SyntheticDataset(Dataset):
    """A walk through a procedural room: same seed, same bits, rendered or from the cache, on any number of threads.

    Depth is exact, without noise; the room is closed, so every pixel has one. Colours are those of 8-bit images.
    """

    def __init__(self, config: SyntheticConfig | None = None) -> None:
        """Build the room and the walk; light is computed when the first frame is rendered."""
        self.config = config or SyntheticConfig()
        self.on_error = "skip" if self.config.on_error == "skip" else "raise"
        self._lighting = LIGHTING[self.config.lighting]
        self._cache = ArrayCache(user_cache_folder() / "synthetic" if self.config.cache else None)
        self.scene = build_room(self.config.scene, self.config.seed)
        self._packed = self.scene.pack()
        self._light_key = content_key(VERSION, self._packed.digest(), dataclasses.astuple(self._lighting))
        start, stop, stride = self.config.frames
        self._picked = range(self.config.num_frames)[start : None if stop == -1 else stop : stride]
        if not self._picked:
            raise ConfigError(f"dataset.frames={self.config.frames} picks none of the {self.config.num_frames} frames")
        self._loop = self._walk()

    @property
    def name(self) -> str:
        """`synthetic/<room>`."""
        return f"synthetic/{self.scene.name}"

    @property
    def camera(self) -> Camera:
        """A pinhole with 90 degrees from side to side, its principal point in the middle of the image."""
        width, height = self.config.size or (self.config.width, self.config.height)
        return Camera(0.5 * width, 0.5 * width, 0.5 * (width - 1), 0.5 * (height - 1), width, height)

    @property
    def modalities(self) -> frozenset[Modality]:
        """Colour, depth and ground-truth poses."""
        return frozenset(("rgb", "depth", "pose"))

    @property
    def bounds(self) -> Float64[Tensor, "2 3"]:
        """The room's corners."""
        return torch.from_numpy(self.scene.bounds)

    @property
    def ground_truth_mesh(self) -> Path:
        """The room's surface at 2 cm as a coloured PLY file in the cache folder, made when first asked for."""
        path = user_cache_folder() / "synthetic" / f"{self.scene.name}-{self._light_key}.ply"
        if not path.is_file():
            write_bytes(path, ply_bytes(scene_mesh(self.world)))
        return path

    @cached_property
    def world(self) -> World:
        """The room with its light, ready for the ray caster."""
        stored = self._cache.get(self._light_key)
        if stored is None:
            light = bake(self._packed, self._lighting)
            self._cache.put(self._light_key, {k: np.asarray(v) for k, v in light._asdict().items()})
        else:
            light = Lightmap(**{**stored, "exposure": float(stored["exposure"])})
        return light_up(self._packed, light)

    def __len__(self) -> int:
        return len(self._picked)

    def T_world_camera(self, index: int) -> Float64[np.ndarray, "4 4"]:
        """Return the exact pose of a frame, in double precision."""
        pose: Float64[np.ndarray, "4 4"] = self._loop[self._picked[index] % len(self._loop)]
        return pose

    def __getitem__(self, index: int) -> Frame:
        """Return a frame, from the cache or rendered."""
        pose = self.T_world_camera(index)
        rgb, depth = self._images(pose)
        if self.config.max_depth is not None:
            depth = np.where(depth <= self.config.max_depth, depth, np.float32(0))
        return Frame(
            index=range(len(self))[index],
            timestamp_ns=round(self._picked[index] * 1_000_000_000 / FRAMES_PER_SECOND),
            camera=self.camera,
            rgb=torch.from_numpy(rgb.astype(np.float32) / np.float32(255)),
            depth=torch.from_numpy(depth),
            T_world_camera_gt=torch.from_numpy(pose.astype(np.float32)),
        )

    def _images(self, pose: Float64[np.ndarray, "4 4"]) -> tuple[np.ndarray, np.ndarray]:
        camera = self.camera
        key = content_key(self._light_key, camera, pose)
        stored = self._cache.get(key)
        if stored is not None:
            return stored["rgb"], stored["depth"]
        lens = (camera.fx, camera.fy, camera.cx, camera.cy)
        rgb, depth = render(self.world, lens, camera.width, camera.height, pose)
        self._cache.put(key, {"rgb": rgb, "depth": depth})
        return rgb, depth

    def _walk(self) -> Float64[np.ndarray, "n 4 4"]:
        key = content_key(VERSION, "walk", self._packed.digest(), self.config.seed)
        stored = self._cache.get(key)
        if stored is None:
            stored = {"poses": handheld_loop(self._packed, np.random.default_rng([self.config.seed, 1]))}
            self._cache.put(key, stored)
        poses: Float64[np.ndarray, "n 4 4"] = stored["poses"]
        return poses
