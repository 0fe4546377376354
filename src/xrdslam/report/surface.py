"""The map's surface as a picture, coloured by how far it is from the true one where that is known."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Float64, Int, UInt8
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from xrdslam.core.surface import PointCloud, TriangleMesh
from xrdslam.evaluation.alignment import Alignment
from xrdslam.evaluation.errors import EvaluationError
from xrdslam.evaluation.surface_alignment import surface_alignment
from xrdslam.evaluation.surface_files import read_mesh
from xrdslam.pictures.clouds import read_cloud
from xrdslam.pictures.outside import Drawing, Outside
from xrdslam.pictures.palette import ERROR, coloured, hexadecimal
from xrdslam.report.charts import number
from xrdslam.report.renderings import data_uri
from xrdslam.report.run_files import RunFiles

__all__ = ["distances_cm", "surface_figure"]

SIZE_PX = (960, 600)
BACKGROUND = (238, 239, 241)
TURNS_DEG = (-28.0, 32.0)
WORST_CM = 5.0
"""The end of the colour scale, the same in every report."""
SAMPLES = 300_000
Distances = Float64[NDArray[np.float64], " n"]


def surface_figure(run: RunFiles, true_mesh: Path | None) -> str:
    """Return pictures of the mesh (else of the cloud) from behind the cameras."""
    mesh_file, cloud_file = run.path / "map" / "mesh.ply", run.path / "map" / "cloud.ply"
    surface: TriangleMesh | PointCloud
    if mesh_file.is_file():
        surface = mesh = read_mesh(mesh_file)
        mesh.colors = read_cloud(mesh_file).colors
        points, size = mesh.vertices, f"{len(mesh.faces):,} triangles"
    elif cloud_file.is_file():
        surface = cloud = read_cloud(cloud_file)
        points, size = cloud.points, f"{len(cloud.points):,} points"
    else:
        return '<p class="none">The method writes neither a mesh nor a cloud.</p>'
    if not len(points):
        return '<p class="none">The map has no surface.</p>'
    view, other = (Outside.behind(points, run.final, turn, aspect=SIZE_PX[0] / SIZE_PX[1]) for turn in TURNS_DEG)
    drawing = Drawing(surface, view, SIZE_PX)
    first = _figure("as mapped", size, drawing.picture(BACKGROUND))
    if true_mesh is not None and true_mesh.is_file() and isinstance(surface, TriangleMesh):
        colors = _by_distance(run, surface, drawing.shown, read_mesh(true_mesh))
        return first + _figure("distance to the true surface", _scale(), drawing.picture(BACKGROUND, colors))
    aside = Drawing(surface, other, SIZE_PX).picture(BACKGROUND)
    return first + _figure("from another side", "no true surface to compare with", aside)


def distances_cm(
    points_world: Float64[NDArray[np.float64], "n 3"], truth: TriangleMesh, count: int = SAMPLES, seed: int = 0
) -> Distances:
    """Return how far points are from a surface [cm].

    That is the distance along the normal of the true surface where its nearest sample lies, where that sample is no
    farther than three spacings aside (exact on flat surfaces), and the distance to the sample elsewhere.
    """
    samples, normals = _samples(truth, count, np.random.default_rng(seed))
    spacing = np.sqrt(_area(truth) / count)
    away, nearest = cKDTree(samples).query(points_world, workers=-1)
    along = np.abs(((points_world - samples[nearest]) * normals[nearest]).sum(1))
    aside = np.sqrt(np.maximum(away**2 - along**2, 0.0))
    metres: np.ndarray = np.where(aside <= 3 * spacing, along, away)
    return 100 * metres


def _samples(mesh: TriangleMesh, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return points spread over a mesh, and the unit normals there."""
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    drawn = np.searchsorted(np.cumsum(areas), rng.random(count) * areas.sum(), side="right").clip(0, len(areas) - 1)
    u, v = rng.random((2, count))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u)[:, None], np.where(flip, 1 - v, v)[:, None]
    a, b, c = corners[drawn, 0], corners[drawn, 1], corners[drawn, 2]
    return a + u * (b - a) + v * (c - a), normals[drawn] / areas[drawn][:, None]


def _area(mesh: TriangleMesh) -> float:
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(doubled, axis=1).sum() / 2)


def _by_distance(
    run: RunFiles, mesh: TriangleMesh, shown: Int[np.ndarray, " s"], truth: TriangleMesh
) -> Float[np.ndarray, "v 3"]:
    """Return colours of vertices: of those that belong to a shown triangle, the others are not asked for."""
    motion = _motion(run)
    asked = np.unique(mesh.faces[shown])
    vertices = mesh.vertices[asked].astype(np.float64)
    away = distances_cm(vertices if motion is None else motion.apply(vertices), truth)
    colors = np.zeros((len(mesh.vertices), 3))
    colors[asked] = coloured(away, ERROR, 0.0, WORST_CM) / 255
    return colors


def _figure(title: str, note: str, image: UInt8[np.ndarray, "h w 3"]) -> str:
    _, data = cv2.imencode(".webp", image[..., ::-1].copy(), [cv2.IMWRITE_WEBP_QUALITY, 80])
    uri = data_uri(bytes(data.tobytes()))
    return (
        f'<figure class="surface"><figcaption><b>{title}</b> <small>{note}</small></figcaption>'
        f'<img alt="{title}" src="{uri}" width="{SIZE_PX[0]}" height="{SIZE_PX[1]}"></figure>'
    )


def _scale() -> str:
    stops = ",".join(hexadecimal(np.array(colour, np.uint8)) for colour in ERROR)
    ramp = f'<i class="ramp" style="background:linear-gradient(90deg,{stops})"></i>'
    return f"0{ramp}≥ {number(WORST_CM)} cm"


def _motion(run: RunFiles) -> Alignment | None:
    """Return what lays the run's world on the true one, as its figures have it; None where the poses do not say."""
    if run.ground_truth is None:
        return None
    try:
        return surface_alignment(run.final, run.ground_truth).motion
    except EvaluationError:
        return None
