"""Arrays on disk come back as they were, or not at all."""

from pathlib import Path

import numpy as np
import pytest

from xrdslam.datasets.synthetic.cache import ArrayCache, content_key, user_cache_folder

ARRAYS = {"a": np.arange(12, dtype=np.float32).reshape(3, 4), "b": np.array(2.5), "c": np.zeros((0, 3), np.uint8)}


def test_what_is_put_is_got(tmp_path: Path) -> None:
    cache = ArrayCache(tmp_path / "new")
    assert cache.get("k1") is None
    cache.put("k1", ARRAYS)
    found = cache.get("k1")
    assert found is not None
    assert set(found) == set(ARRAYS)
    for name, array in ARRAYS.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)
    assert [p.name for p in (tmp_path / "new").rglob("*") if p.is_file()] == ["k1.cache"]  # no part left behind


@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "start"])
def test_a_damaged_file_counts_as_absent(tmp_path: Path, damage: str, caplog: pytest.LogCaptureFixture) -> None:
    cache = ArrayCache(tmp_path)
    cache.put("k1", ARRAYS)
    path = next(tmp_path.rglob("*.cache"))
    data = bytearray(path.read_bytes())
    data = {"cut": data[:-7], "empty": bytearray(), "flip": data, "start": data}[damage]
    if damage in ("flip", "start"):
        data[len(data) // 2 if damage == "flip" else 3] ^= 1
    path.write_bytes(data)
    assert cache.get("k1") is None
    assert "damaged" in caplog.text
    cache.put("k1", ARRAYS)
    assert cache.get("k1") is not None


def test_no_folder_keeps_nothing() -> None:
    cache = ArrayCache(None)
    cache.put("k", ARRAYS)
    assert cache.get("k") is None


def test_a_folder_that_cannot_be_written_is_said_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").write_text("in the way")
    cache = ArrayCache(tmp_path / "file")
    cache.put("k", ARRAYS)
    cache.put("k", ARRAYS)
    assert len(caplog.records) == 1
    assert "XRDSLAM_CACHE" in caplog.text


def test_keys_tell_values_shapes_and_types_apart() -> None:
    a = np.arange(4.0)
    keys = [content_key(x) for x in (a, a.reshape(2, 2), a.astype(np.float32), a + 1e-15 * a, (1, 2), (1.0, 2))]
    assert len(set(keys)) == len(keys)
    assert content_key(a, 1) == content_key(a.copy(), 1)
    assert content_key("ab", "c") != content_key("a", "bc")


def test_the_folder_follows_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XRDSLAM_CACHE", str(tmp_path))
    assert user_cache_folder() == tmp_path
    monkeypatch.delenv("XRDSLAM_CACHE")
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert user_cache_folder() == tmp_path / "xdg" / "xrdslam"
