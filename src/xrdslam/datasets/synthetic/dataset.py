"""Synthetic rooms as a dataset: rendered on demand, exact in pose and depth, kept on disk."""

import dataclasses
import logging
import time
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
from xrdslam.datasets.synthetic.motion import MotionConfig, handheld_loop
from xrdslam.datasets.synthetic.rooms import build_room
from xrdslam.datasets.synthetic.sensor import arrived, expose, measure_depth, shutter_poses, to_linear
from xrdslam.datasets.synthetic.shading import Lightmap, World
from xrdslam.datasets.synthetic.tracer import render

__all__ = ["SyntheticDataset"]

log = logging.getLogger(__name__)
VERSION = 2
"""Raised with every change that alters a rendered bit: it is part of every key of the cache."""
FRAMES_PER_SECOND = 30
LIGHTING = {"fine": LightingConfig(), "coarse": LightingConfig(spacing=0.3, light_samples=2, gather_rays=12, bounces=1)}


class SyntheticDataset(Dataset):
    """A walk through a procedural room: same seed, same bits, rendered or from the cache, on any number of threads.

    Depth is exact and every pixel has one, for the room is closed; colours are those of 8-bit images. What
    `dataset.sensor` switches on is done to them as they are handed out; the cache holds the perfect frames.
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
        numbers = self.config.picked(self.config.num_frames)
        has_arrived = arrived(self.config.num_frames, self.config.sensor, self.config.seed)
        self._picked = [number for number in numbers if has_arrived[number]]
        if not self._picked:
            raise ConfigError(f"dataset.frames={self.config.frames} picks none of the {self.config.num_frames} frames")
        self.loop = self._walk()  # poses of one round; the frame after the last is the first

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
            solids = len(self.scene.solids)
            log.info("%s: light is computed once for %d solids, then kept on disk", self.name, solids)
            began = time.perf_counter()
            light = bake(self._packed, self._lighting)
            log.info("%s: light is there after %.0f s", self.name, time.perf_counter() - began)
            self._cache.put(self._light_key, {k: np.asarray(v) for k, v in light._asdict().items()})
        else:
            light = Lightmap(**{**stored, "exposure": float(stored["exposure"])})
        return light_up(self._packed, light)

    def __len__(self) -> int:
        return len(self._picked)

    def T_world_camera(self, index: int) -> Float64[np.ndarray, "4 4"]:
        """Return the exact pose of a frame, in double precision."""
        pose: Float64[np.ndarray, "4 4"] = self.loop[self._picked[index] % len(self.loop)]
        return pose

    def __getitem__(self, index: int) -> Frame:
        """Return a frame, from the cache or rendered."""
        pose, number = self.T_world_camera(index), self._picked[index]
        rgb, depth = self._measured(pose, number)
        if self.config.max_depth is not None:
            depth = np.where(depth <= self.config.max_depth, depth, np.float32(0))
        return Frame(
            index=range(len(self))[index],
            timestamp_ns=round(number * 1_000_000_000 / FRAMES_PER_SECOND),
            camera=self.camera,
            rgb=torch.from_numpy(rgb.astype(np.float32) / np.float32(255)),
            depth=torch.from_numpy(depth),
            T_world_camera_gt=torch.from_numpy(pose.astype(np.float32)),
        )

    def _measured(self, pose: Float64[np.ndarray, "4 4"], number: int) -> tuple[np.ndarray, np.ndarray]:
        """Return what the camera delivers of a frame: perfect images, or what `dataset.sensor` makes of them."""
        rgb, depth = self._images(pose)
        config, seed = self.config.sensor, self.config.seed
        if config.exposure_ms or config.exposure_drift or config.white_balance_drift or config.rgb_noise:
            linear = self._open_shutter(number) if config.exposure_ms else to_linear(rgb)
            rgb = expose(linear, config, seed, number)
        return rgb, measure_depth(depth, self.camera, config, seed, number)

    def _open_shutter(self, number: int) -> np.ndarray:
        """Return the mean light [linear, float32] over the time that the shutter is open."""
        poses = shutter_poses(self.loop, number % len(self.loop), self.config.sensor)
        key = content_key(self._light_key, self.camera, poses)
        stored = self._cache.get(key)
        if stored is not None:
            return np.asarray(stored["light"], dtype=np.float32) / np.float32(65535)
        mean = sum(to_linear(self._render(pose)[0]) for pose in poses) / np.float32(len(poses))
        light = np.rint(mean * np.float32(65535)).astype(np.uint16)
        self._cache.put(key, {"light": light})
        return light.astype(np.float32) / np.float32(65535)

    def _images(self, pose: Float64[np.ndarray, "4 4"]) -> tuple[np.ndarray, np.ndarray]:
        key = content_key(self._light_key, self.camera, pose)
        stored = self._cache.get(key)
        if stored is not None:
            return stored["rgb"], stored["depth"]
        rgb, depth = self._render(pose)
        self._cache.put(key, {"rgb": rgb, "depth": depth})
        return rgb, depth

    def _render(self, pose: Float64[np.ndarray, "4 4"]) -> tuple[np.ndarray, np.ndarray]:
        camera = self.camera
        lens = (camera.fx, camera.fy, camera.cx, camera.cy)
        return render(self.world, lens, camera.width, camera.height, pose)

    def _walk(self) -> Float64[np.ndarray, "n 4 4"]:
        key = content_key(VERSION, "walk", self._packed.digest(), self.scene.pace, self.config.seed)
        stored = self._cache.get(key)
        if stored is None:
            pace = MotionConfig(self.scene.pace.way_m, self.scene.pace.turn_deg)
            stored = {"poses": handheld_loop(self._packed, np.random.default_rng([self.config.seed, 1]), pace)}
            self._cache.put(key, stored)
        poses: Float64[np.ndarray, "n 4 4"] = stored["poses"]
        return poses
