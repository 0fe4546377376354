"""A finished run read for replay, and its video."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from xrdslam.core.errors import DataError, RunError
from xrdslam.core.surface import PointCloud, TriangleMesh, write_ply
from xrdslam.pictures.splat_files import read_splats
from xrdslam.testing.toy_run import write_toy_run
from xrdslam.viewer.__main__ import main
from xrdslam.viewer.recorded import Recorded
from xrdslam.viewer.video import Film


@pytest.fixture(scope="module")
def toy_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_toy_run(tmp_path_factory.mktemp("runs") / "toy")


@pytest.fixture(scope="module")
def recorded(toy_run: Path) -> Recorded:
    return Recorded.read(toy_run)


def test_the_truth_lies_on_the_estimate(recorded: Recorded) -> None:
    assert recorded.truth is not None
    assert recorded.errors_cm is not None
    distances = 100 * np.linalg.norm(recorded.truth - recorded.centres, axis=1)
    # a rigid motion keeps distances; trajectories have nine decimals [m]
    np.testing.assert_allclose(distances, recorded.errors_cm, atol=1e-6)


def test_a_moment_has_the_latest_pictures_up_to_it(recorded: Recorded) -> None:
    rows = {row: panels.index for row in (0, 1, 5, 11) if (panels := recorded.panels_at(row)) is not None}
    assert rows == {0: 0, 1: 0, 5: 4, 11: 10}
    assert "LOST" in recorded.caption(6)
    assert recorded.caption(0).startswith("frame 0, error ")


def test_without_a_mesh_the_cloud_is_shown_and_without_a_map_the_path(toy_run: Path, tmp_path: Path) -> None:
    shutil.copytree(toy_run, tmp_path / "run")
    assert isinstance(Recorded.read(tmp_path / "run").surface, TriangleMesh)
    (tmp_path / "run" / "map" / "mesh.ply").unlink()
    assert len(Recorded.read(tmp_path / "run").surface.points) == 8  # type: ignore[union-attr]
    (tmp_path / "run" / "map" / "cloud.ply").unlink()
    bare = Recorded.read(tmp_path / "run").surface
    assert isinstance(bare, PointCloud)
    assert len(bare.points) == 12


def test_a_video_shows_the_path_growing_and_the_pictures_changing(recorded: Recorded) -> None:
    film = Film(recorded)
    first, last = film.picture(0).astype(int), film.picture(11).astype(int)
    stage, column = np.s_[60:-10, :848], np.s_[60:-10, 864:1264]
    assert (np.abs(last[stage] - first[stage]).max(-1) > 40).sum() > 30  # the path
    assert np.abs(last[column] - first[column]).mean() > 1  # the pictures
    bar = [(picture[-2] == [63, 184, 176]).all(-1).sum() for picture in (first, last)]
    assert bar[0] < 120
    assert bar[1] == 1280


def test_the_command_writes_a_video_that_can_be_read(
    toy_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.mp4"
    main([str(toy_run), "--video", str(out)])
    assert capsys.readouterr().out.strip() == f"{out}: 12 frames"
    video = cv2.VideoCapture(str(out))
    assert int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == 12
    read, frame = video.read()
    assert read
    assert frame.shape == (720, 1280, 3)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.mp4"]


def test_what_is_no_run_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"xrdslam: .*no run's folder"):
        main([str(tmp_path)])


def test_a_run_without_frames_is_refused(toy_run: Path, tmp_path: Path) -> None:
    shutil.copytree(toy_run, tmp_path / "run")
    shutil.rmtree(tmp_path / "run" / "trajectory")
    with pytest.raises(RunError, match="no frame was tracked"):
        Recorded.read(tmp_path / "run")


def test_gaussians_come_back_as_their_covariances_and_colours(tmp_path: Path) -> None:
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
    names += ["rot_0", "rot_1", "rot_2", "rot_3"]
    table = np.zeros(2, dtype=[(name, "f4") for name in names])
    table["scale_0"], table["scale_1"], table["scale_2"] = np.log([3.0, 2.0, 1.0])
    table["rot_0"] = table["rot_3"] = np.sqrt(0.5)  # a quarter turn about z
    table["f_dc_0"] = 0.5 / 0.28209479
    write_ply(tmp_path / "splats.ply", {"vertex": table})
    splats = read_splats(tmp_path / "splats.ply")
    np.testing.assert_allclose(splats.covariances[0], np.diag([4.0, 9.0, 1.0]), atol=1e-5)
    np.testing.assert_allclose(splats.colors[0], [1.0, 0.5, 0.5], atol=1e-6)
    np.testing.assert_allclose(splats.opacities, 0.5)
    assert len(read_splats(tmp_path / "splats.ply", most=1).means) == 1
    (tmp_path / "bad.ply").write_bytes(b"ply")
    with pytest.raises(DataError, match=r"bad.ply"):
        read_splats(tmp_path / "bad.ply")
