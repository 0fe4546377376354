"""Reconstruction figures: offsets, holes, walls behind walls, mirrors, and what nobody saw."""

from pathlib import Path

import numpy as np
import pytest

from xrdslam.core.camera import Camera
from xrdslam.core.errors import DataError
from xrdslam.core.surface import TriangleMesh
from xrdslam.evaluation.alignment import Alignment
from xrdslam.evaluation.culling import DepthView, Seen, seen, seen_under
from xrdslam.evaluation.errors import EvaluationError
from xrdslam.evaluation.metrics import MetricGroup
from xrdslam.evaluation.reconstruction import compare_surfaces, moved, sampled
from xrdslam.evaluation.surface_files import read_mesh

CAMERA = Camera(100.0, 100.0, 99.5, 99.5, 200, 200)
SAMPLES = 20000


def _square(z: float, low: float = -1.0, high: float = 1.0) -> TriangleMesh:
    """Return a square that faces the camera at the origin, from `low` to 1 along x."""
    vertices = np.array([[low, -1, z], [high, -1, z], [high, 1, z], [low, 1, z]], np.float32)
    return TriangleMesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]))


def _view(z: float = 2.0) -> DepthView:
    return DepthView(CAMERA, np.eye(4), np.full((200, 200), z, np.float32))


def _by_the_view(margin_m: float = 0.06) -> Seen:
    return seen_under("frustum_occlusion", [_view()], [], margin_m)


def _figures(estimate: TriangleMesh, truth: TriangleMesh, margin_m: float = 0.06) -> dict[str, float]:
    group = MetricGroup("reconstruction")
    compare_surfaces(estimate, truth, _by_the_view(margin_m), SAMPLES).add_to(group)
    return {key: float(value) for key, value in group.values.items() if value is not None}


def test_a_surface_agrees_with_itself() -> None:
    """Samples lie 0.5 / sqrt(density) from the nearest of 5 * 20000 / 4 = 25000 a square metre: 0.32 cm."""
    figures = _figures(_square(2.0), _square(2.0))
    assert figures["accuracy_cm"] == pytest.approx(0.32, abs=0.03)
    assert figures["completion_cm"] == pytest.approx(0.32, abs=0.03)
    assert figures["f_score_5cm_percent"] == 100


@pytest.mark.parametrize("offset", [-0.10, 0.04])
def test_an_offset_is_the_accuracy_and_the_completion(offset: float) -> None:
    figures = _figures(_square(2.0 + offset), _square(2.0))
    expected = 100 * abs(offset)
    assert figures["accuracy_cm"] == pytest.approx(expected, abs=0.2)
    assert figures["completion_cm"] == pytest.approx(expected, abs=0.2)
    assert figures["precision_1cm_percent"] == 0
    assert figures["recall_5cm_percent"] == (100 if expected < 5 else 0)


def test_a_hole_costs_completion_and_not_accuracy() -> None:
    """The half with x < 0 is missing: the distance to the rest is 0 to 1 m there, a quarter of a metre on average."""
    figures = _figures(_square(2.0, low=0.0), _square(2.0))
    assert figures["accuracy_cm"] < 0.8
    assert figures["completion_cm"] == pytest.approx(25, abs=1)
    assert figures["recall_5cm_percent"] == pytest.approx(52.5, abs=1)


def test_a_wall_behind_the_wall_was_not_seen() -> None:
    front, behind = _square(2.0), _square(3.0)
    both = TriangleMesh(
        np.concatenate((front.vertices, behind.vertices)), np.concatenate((front.faces, behind.faces + 4))
    )
    assert _figures(both, front)["accuracy_cm"] < 0.8
    assert _figures(front, both)["completion_cm"] < 0.8


def test_a_wall_before_the_wall_counts() -> None:
    front, before = _square(2.0), _square(1.5, low=-0.5, high=0.5)
    both = TriangleMesh(
        np.concatenate((front.vertices, before.vertices)), np.concatenate((front.faces, before.faces + 4))
    )
    assert _figures(both, front)["accuracy_cm"] > 10


def test_the_estimate_is_aligned_first_and_a_mirror_is_no_alignment() -> None:
    truth = _square(2.0, low=0.2)
    elsewhere = TriangleMesh(truth.vertices - np.array([5, 0, 0], np.float32), truth.faces)
    shift = Alignment(1.0, np.eye(3), np.array([5.0, 0, 0]))
    group = MetricGroup("reconstruction")
    compare_surfaces(moved(elsewhere, shift), truth, _by_the_view(), SAMPLES).add_to(group)
    assert float(group.values["accuracy_cm"] or 0) < 0.8
    mirrored = TriangleMesh(truth.vertices * np.array([-1, 1, 1], np.float32), truth.faces)
    assert _figures(mirrored, truth)["accuracy_cm"] > 20


def test_what_counts_as_seen() -> None:
    points = np.array([[0, 0, 2], [0, 0, 2.05], [0, 0, 2.2], [0, 0, -2], [3, 0, 2], [0.5, 0, 1], [np.nan, 0, 1]])
    visible = seen(points, [_view()], 0.06)
    assert visible.tolist() == [True, True, False, False, False, True, False]
    assert not seen(points, [_view(0.0)], 0.06).any(), "a pixel without depth saw nothing"


def test_samples_are_even_over_the_area() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [8, 0, 0], [5, 1, 0]], np.float32)
    points = sampled(TriangleMesh(vertices, np.array([[0, 1, 2], [3, 4, 5]])), 40000, np.random.default_rng(0))
    small = points[:, 0] < 3
    assert small.mean() == pytest.approx(0.25, abs=0.01)
    np.testing.assert_allclose(points[small].mean(0), [1 / 3, 1 / 3, 0], atol=0.01)


def test_the_same_seed_gives_the_same_figures() -> None:
    assert _figures(_square(2.01), _square(2.0)) == _figures(_square(2.01), _square(2.0))


@pytest.mark.parametrize("empty", ["estimate", "truth"])
def test_an_empty_surface_and_one_that_nobody_saw_are_refused(empty: str) -> None:
    for other in (TriangleMesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int64)), _square(-3.0)):
        pair = (other, _square(2.0)) if empty == "estimate" else (_square(2.0), other)
        with pytest.raises(EvaluationError, match=r"no area|no frame saw"):
            _figures(*pair)


def test_meshes_are_read_as_written_and_polygons_are_cut(tmp_path: Path) -> None:
    mesh = _square(2.0)
    mesh.write(tmp_path / "square.ply")
    again = read_mesh(tmp_path / "square.ply")
    np.testing.assert_array_equal(again.vertices, mesh.vertices)
    np.testing.assert_array_equal(again.faces, mesh.faces)
    quad = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    quad += "element face 1\nproperty list uchar int vertex_index\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"
    (tmp_path / "quad.ply").write_text(quad)
    assert read_mesh(tmp_path / "quad.ply").faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    (tmp_path / "foreign.ply").write_text("no mesh")
    for path in (tmp_path / "foreign.ply", tmp_path / "missing.ply"):
        with pytest.raises(DataError, match=path.name):
            read_mesh(path)
