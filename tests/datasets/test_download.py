"""Downloads from a server on loopback that stops, changes its file, lies; archives that lead out of their folder."""

import hashlib
import io
import os
import stat
import tarfile
import threading
import zipfile
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from xrdslam.core.errors import DataError
from xrdslam.datasets.catalogue import source_of, sources
from xrdslam.datasets.download import fetch, unpack

BODY = bytes(range(256)) * 4096  # 1 MiB


class Server(ThreadingHTTPServer):
    """Serves `body`; ends a connection after `stop_after` bytes as often as `stops` says."""

    daemon_threads = True

    def __init__(self) -> None:
        self.body, self.tag, self.knows_ranges = BODY, '"one"', True
        self.stops, self.stop_after = 0, 300_000
        self.requests: list[str | None] = []
        super().__init__(("127.0.0.1", 0), Handler)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/archive.zip"


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        server = self.server
        asked = self.headers.get("Range")
        server.requests.append(asked)
        if self.path != "/archive.zip":
            self.send_error(404)
            return
        start = 0
        if asked and server.knows_ranges and self.headers.get("If-Range") == server.tag:
            start = int(asked.removeprefix("bytes=").rstrip("-"))
        if start >= len(server.body) > 0 and asked:
            self.send_response(416)
            self.send_header("Content-Range", f"bytes */{len(server.body)}")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        body = server.body[start:]
        self.send_response(206 if start else 200)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("ETag", server.tag)
        self.end_headers()
        if server.stops > 0:
            server.stops -= 1
            self.wfile.write(body[: server.stop_after])
            self.close_connection = True
            return
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield made
    made.shutdown()
    made.server_close()
    thread.join()


@pytest.fixture(autouse=True)
def _no_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.lower().endswith("_proxy")]:
        monkeypatch.delenv(name)


def test_a_broken_connection_is_continued_where_it_ended(server: Server, tmp_path: Path) -> None:
    server.stops = 2
    path = fetch(server.url, tmp_path / "archive.zip", hashlib.sha256(BODY).hexdigest(), wait_s=0.0)
    assert path.read_bytes() == BODY
    assert server.requests == [None, "bytes=300000-", "bytes=600000-"]
    assert [p.name for p in tmp_path.iterdir()] == ["archive.zip"]


def test_a_later_command_continues_what_an_earlier_one_left(server: Server, tmp_path: Path) -> None:
    server.stops = 5
    server.stop_after = 1000
    with pytest.raises(DataError, match=r"cannot be downloaded .*5000 bytes are kept in .*the same command continues"):
        fetch(server.url, tmp_path / "archive.zip", wait_s=0.0)
    server.requests.clear()
    seen: list[tuple[int, int | None]] = []
    fetch(server.url, tmp_path / "archive.zip", progress=lambda done, total: seen.append((done, total)))
    assert (tmp_path / "archive.zip").read_bytes() == BODY
    assert server.requests == ["bytes=5000-"]
    assert seen[-1] == (len(BODY), len(BODY))


def test_a_file_that_changed_meanwhile_is_begun_anew(server: Server, tmp_path: Path) -> None:
    server.stops = 1
    server.stop_after = 1000
    (tmp_path / "archive.zip.part").write_bytes(b"old" * 100)
    (tmp_path / "archive.zip.part.tag").write_text('"other"')
    server.body = b"new" * 1000
    server.stops = 0
    assert fetch(server.url, tmp_path / "archive.zip").read_bytes() == b"new" * 1000


@pytest.mark.parametrize("knows_ranges", [True, False])
def test_a_whole_partial_file_and_a_server_without_ranges(server: Server, tmp_path: Path, knows_ranges: bool) -> None:
    (tmp_path / "archive.zip.part").write_bytes(BODY)
    (tmp_path / "archive.zip.part.tag").write_text(server.tag)
    server.knows_ranges = knows_ranges
    assert fetch(server.url, tmp_path / "archive.zip").read_bytes() == BODY


def test_a_wrong_hash_removes_the_file(server: Server, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"SHA-256 .*, published is 00; it was removed"):
        fetch(server.url, tmp_path / "archive.zip", "00")
    assert not list(tmp_path.iterdir())


def test_an_address_that_is_not_there_is_not_tried_again(server: Server, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"cannot be downloaded \(Not Found\)"):
        fetch(server.url.replace("archive", "nothing"), tmp_path / "x.zip")
    assert len(server.requests) == 1


def test_a_server_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot be downloaded"):
        fetch("http://127.0.0.1:1/archive.zip", tmp_path / "x.zip", wait_s=0.0)


def zipped(path: Path, members: dict[str, bytes], link: str | None = None) -> Path:
    with zipfile.ZipFile(path, "w") as file:
        for name, data in members.items():
            file.writestr(name, data)
        if link is not None:
            info = zipfile.ZipInfo("link")
            info.external_attr = (stat.S_IFLNK | 0o777) << 16
            file.writestr(info, link)
    return path


def tarred(path: Path, members: dict[str, bytes], link: str | None = None) -> Path:
    with tarfile.open(path, "w:gz") as file:
        if link is not None:
            info = tarfile.TarInfo("link")
            info.type, info.linkname = tarfile.SYMTYPE, link
            file.addfile(info)
        for name, data in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            file.addfile(info, io.BytesIO(data))
    return path


def test_archives_are_unpacked_and_the_scenes_own_level_left_out(tmp_path: Path) -> None:
    tar = tarred(tmp_path / "a.tgz", {"room/rgb/1.png": b"1", "room/rgb.txt": b"2"})
    assert (unpack(tar, tmp_path / "one" / "room") / "rgb.txt").read_bytes() == b"2"
    flat = zipped(tmp_path / "b.zip", {"mav0/cam0/data.csv": b"3"})
    assert (unpack(flat, tmp_path / "V1") / "mav0" / "cam0" / "data.csv").read_bytes() == b"3"


def test_archives_inside_an_archive_are_unpacked_where_they_lie(tmp_path: Path) -> None:
    inner = zipped(tmp_path / "seq-01.zip", {"seq-01/frame-000000.pose.txt": b"1"}).read_bytes()
    outer = zipped(tmp_path / "chess.zip", {"chess/seq-01.zip": inner, "chess/split.txt": b""})
    folder = unpack(outer, tmp_path / "root" / "chess")
    assert (folder / "seq-01" / "frame-000000.pose.txt").read_bytes() == b"1"
    assert not list(folder.rglob("*.zip"))


@pytest.mark.parametrize("name", ["../out.txt", "/out.txt", "a/../../out.txt", "a\\..\\..\\out.txt", "C:/out.txt"])
def test_a_zip_that_leads_out_writes_nothing(tmp_path: Path, name: str) -> None:
    archive = zipped(tmp_path / "bad.zip", {"good.txt": b"", name: b"bad"})
    with pytest.raises(DataError, match="leads out of its folder; nothing was unpacked"):
        unpack(archive, tmp_path / "in" / "scene")
    assert not [path for path in tmp_path.rglob("*.txt")]
    assert not Path("/out.txt").exists()


@pytest.mark.parametrize("name", ["../out.txt", "a/../../out.txt"])
def test_a_tar_that_leads_out_writes_nothing(tmp_path: Path, name: str) -> None:
    archive = tarred(tmp_path / "bad.tgz", {"good.txt": b"", name: b"bad"})
    with pytest.raises(DataError, match="cannot be unpacked"):
        unpack(archive, tmp_path / "in" / "scene")
    assert not [path for path in tmp_path.rglob("*.txt")]


def test_links_that_lead_out_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="leads out"):
        unpack(zipped(tmp_path / "a.zip", {}, link="../.."), tmp_path / "scene")
    with pytest.raises(DataError, match="cannot be unpacked"):
        unpack(tarred(tmp_path / "a.tgz", {"link/out.txt": b""}, link="../.."), tmp_path / "scene")
    assert not (tmp_path / "scene").exists()


@pytest.mark.parametrize("data", [b"", b"<html>moved</html>", b"PK\x03\x04 cut"])
def test_what_is_no_archive_is_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.zip").write_bytes(data)
    with pytest.raises(DataError, match=r"a\.zip: .*remove it and download it again"):
        unpack(tmp_path / "a.zip", tmp_path / "scene")
    assert not (tmp_path / "scene").exists()


def test_a_folder_that_has_something_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "mine.txt").write_text("mine")
    with pytest.raises(DataError, match="exists and is not empty"):
        unpack(zipped(tmp_path / "a.zip", {"x": b""}), tmp_path / "scene")
    assert (tmp_path / "scene" / "mine.txt").read_text() == "mine"


def test_every_scene_that_can_be_downloaded_has_a_folder_inside_its_root() -> None:
    assert len(sources()) == 1 + 7 + 7 + 11
    for name, source in sources().items():
        assert source.url.startswith(("http://", "https://")), name
        assert "/" not in source.folder
    assert source_of("replica/room0") == source_of("replica")
    for name, advice in (("scannet/scene0000_00", "terms are signed"), ("euroc/V3", "there is .*euroc/V1_01_easy")):
        with pytest.raises(DataError, match=advice):
            source_of(name)
