"""The scene's surface as a coloured triangle mesh: marching cubes of its signed distance."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8

from xrdslam.datasets.synthetic.compiled import compiled
from xrdslam.datasets.synthetic.distance import nearest, solid_distance
from xrdslam.datasets.synthetic.rows import over_rows
from xrdslam.datasets.synthetic.scene import PackedScene
from xrdslam.datasets.synthetic.shading import World, display_linear, radiance, srgb_byte, surface_frame

__all__ = ["Mesh", "ply_bytes", "scene_mesh"]

BLOCK = 8
"""Voxels along the side of a block that is looked at only if the surface comes near."""


class Mesh(NamedTuple):
    """Triangles whose normals point into free space."""

    vertices: Float32[np.ndarray, "v 3"]
    colours: UInt8[np.ndarray, "v 3"]
    faces: Int32[np.ndarray, "f 3"]


def scene_mesh(world: World, voxel: float = 0.02) -> Mesh:
    """Return all that is solid against air, on a grid of `voxel` [m]: hidden undersides too, insides of solids not."""
    from skimage.measure import marching_cubes

    half, middle = world.scene.size[0, :3], world.scene.centre[0]
    low = middle - half - 1.5 * voxel
    blocks = np.ceil((2 * half + 3 * voxel) / (voxel * BLOCK)).astype(int)
    volume = np.empty(blocks * BLOCK, np.float32)
    over_rows(_fill_blocks, int(blocks.prod()), world.scene, low, voxel, volume)
    extract: Callable[..., tuple[np.ndarray, ...]] = marching_cubes  # scikit-image is not typed
    vertices, faces, _, _ = extract(volume, 0.0, spacing=(voxel,) * 3, gradient_direction="descent")
    points = np.ascontiguousarray(vertices + low, dtype=np.float64)
    colours = np.empty(points.shape, np.uint8)
    over_rows(_colour, len(points), world, points, voxel, colours)
    return Mesh(points.astype(np.float32), colours, faces.astype(np.int32))


def ply_bytes(mesh: Mesh) -> bytes:
    """Return the mesh as a binary PLY file with coloured vertices."""
    vertex = np.empty(len(mesh.vertices), dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3)])
    vertex["xyz"], vertex["rgb"] = mesh.vertices, mesh.colours
    face = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corner", "<i4", 3)])
    face["count"], face["corner"] = 3, mesh.faces
    properties = [f"property float {c}" for c in "xyz"] + [f"property uchar {c}" for c in ("red", "green", "blue")]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertex)}", *properties]
    header += [f"element face {len(face)}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(header).encode() + vertex.tobytes() + face.tobytes()


@compiled
def _fill_blocks(
    begin: int, end: int, scene: PackedScene, low: Float64[np.ndarray, "3"], voxel: float, volume: np.ndarray
) -> None:
    """Set the distances of whole blocks: one number where no surface is near, else the least over the solids near."""
    ny, nz = volume.shape[1] // BLOCK, volume.shape[2] // BLOCK
    reach = 0.5 * math.sqrt(3.0) * voxel * BLOCK  # from a block's middle to its corners
    close = np.empty(len(scene.shape), np.int64)
    for block in range(begin, end):
        x0, y0, z0 = block // (ny * nz) * BLOCK, block // nz % ny * BLOCK, block % nz * BLOCK
        shift = 0.5 * (BLOCK - 1)
        mx, my, mz = low[0] + (x0 + shift) * voxel, low[1] + (y0 + shift) * voxel, low[2] + (z0 + shift) * voxel
        d, _ = nearest(scene, mx, my, mz)
        count = 0
        if abs(d) <= reach:
            for i in range(len(scene.shape)):
                if solid_distance(scene, i, mx, my, mz) <= d + 2.0 * reach:
                    close[count] = i
                    count += 1
        for x in range(x0, x0 + BLOCK):
            for y in range(y0, y0 + BLOCK):
                for z in range(z0, z0 + BLOCK):
                    least = d if count == 0 else math.inf
                    for k in range(count):
                        px, py, pz = low[0] + x * voxel, low[1] + y * voxel, low[2] + z * voxel
                        least = min(least, solid_distance(scene, close[k], px, py, pz))
                    volume[x, y, z] = least


@compiled
def _colour(begin: int, end: int, world: World, points: np.ndarray, w: float, colours: np.ndarray) -> None:
    """Give each point the colour that a camera would see there."""
    for n in range(begin, end):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        _, i = nearest(world.scene, x, y, z)
        hit = surface_frame(world.scene, i, x, y, z)
        rgb = radiance(world, i, hit[0], hit[1], hit[2], hit[3], w, True)
        for c in range(3):
            colours[n, c] = srgb_byte(display_linear(rgb[c], world.light.exposure))
