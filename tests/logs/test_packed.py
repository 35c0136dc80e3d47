"""Logs that are compressed as a whole are those that were compressed, as long as they open to what can be believed."""

import gc
import hashlib
import tempfile
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import other_bags
import pytest
import zstandard
from instrument_logs import told
from small_logs import written

from insdvl_replay.batch.dive_paths import find_dives
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.logs.formats import packed


def log_of(kind: str, folder: Path) -> Path:
    """Write a log in a container."""
    path = folder / f"plain.{kind}"
    if kind == "mcap":
        path.write_bytes(written())
        return path
    if kind == "bag":
        return other_bags.bag(path)
    return next(other_bags.ros2_bag(folder / "of_ros2").glob("*.db3"))


@pytest.mark.parametrize("kind", ["mcap", "db3", "bag"])
def test_packed_log_is_the_plain_one(kind: str, tmp_path: Path) -> None:
    plain = log_of(kind, tmp_path)
    path = tmp_path / "packed" / f"dive.{kind}.zstd"
    path.parent.mkdir()
    path.write_bytes(zstandard.compress(plain.read_bytes()))
    found = read_dive(path, Config())
    expected = read_dive(plain, Config())
    np.testing.assert_array_equal(found.imu.specific_force_b, expected.imu.specific_force_b)
    np.testing.assert_array_equal(found.dvl.velocity_d, expected.dvl.velocity_d)
    assert found.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert found.paths == (path,)
    assert [dive.path for dive in find_dives([str(path.parent)])] == [path]
    assert [dive.path for dive in find_dives([f"{path.parent}/*"])] == [path]


def test_unpacked_copy_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    path = tmp_path / "dive.mcap.zstd"
    path.write_bytes(zstandard.compress(written()))
    read_dive(path, Config())
    assert len(list((tmp_path / "temporary").iterdir())) == 1
    packed._unpacked.cache_clear()
    gc.collect()
    assert not list((tmp_path / "temporary").iterdir())


def test_worker_processes_remove_their_copies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    path = tmp_path / "dive.mcap.zstd"
    path.write_bytes(zstandard.compress(written()))
    worker = get_context("fork").Process(target=read_dive, args=(path, Config()))
    worker.start()
    worker.join()
    assert worker.exitcode == 0
    assert not list((tmp_path / "temporary").iterdir())


@pytest.mark.parametrize("announced", [True, False])
def test_cut_file_is_damaged_and_read_as_far_as_it_goes(announced: bool, tmp_path: Path) -> None:
    plain = tmp_path / "plain.mcap"
    write_dive(plain, told().dive, is_compressed=False)
    compressor = zstandard.ZstdCompressor(write_content_size=announced)
    whole = compressor.compress(plain.read_bytes())
    path = tmp_path / "dive.mcap.zstd"
    path.write_bytes(whole[: len(whole) * 3 // 4])
    with pytest.raises(LogError, match="is damaged at byte") as raised:
        read_dive(path, Config())
    assert "--allow-damaged uses" in raised.value.hint
    dive = read_dive(path, Config(), allow_damaged=True)
    assert 1000 < len(dive.imu.time_ns) < len(told().dive.imu.time_ns)
    assert "log_damaged" in {note.code for note in dive.notes}


def test_changed_bytes_are_damage(tmp_path: Path) -> None:
    whole = bytearray(zstandard.ZstdCompressor(write_checksum=True).compress(written()))
    whole[-1] ^= 1
    path = tmp_path / "dive.mcap.zstd"
    path.write_bytes(whole)
    with pytest.raises(LogError, match="is compressed and cannot be unpacked"):
        read_dive(path, Config())


def test_bomb_is_refused_by_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packed, "_USUAL", 1 << 20)
    path = tmp_path / "dive.mcap.zstd"
    path.write_bytes(zstandard.compress(written() + bytes(20_000_000)))
    with pytest.raises(LogError, match=r"opens to more than \d+ bytes, the most that") as raised:
        read_dive(path, Config())
    assert raised.value.hint == f"if that is right, unpack it: `zstd -d {path}`"


def test_what_is_no_log_is_named(tmp_path: Path) -> None:
    path = tmp_path / "dive.mcap.zstd"
    path.write_bytes(zstandard.compress(b"calm sea\n" * 20))
    with pytest.raises(LogError, match="is compressed with zstd, and has no log in it"):
        read_dive(path, Config())


@pytest.mark.parametrize(
    ("announced", "size", "found"),
    [
        (True, 4, "it ends within its head"),
        (True, 6, "it ends within its head"),
        (True, 12, r"it opens to 0 bytes, but \d+ were announced"),
        (False, 8, "it ends within its first block"),
    ],
)
def test_cut_begin_is_damage(announced: bool, size: int, found: str, tmp_path: Path) -> None:
    compressor = zstandard.ZstdCompressor(write_content_size=announced)
    path = tmp_path / "dive.mcap.zstd"
    path.write_bytes(compressor.compress(written())[:size])
    with pytest.raises(LogError, match=f"cannot be unpacked: {found}\nhint"):
        read_dive(path, Config())


def test_nothing_that_is_compressed_is_nothing(tmp_path: Path) -> None:
    path = tmp_path / "dive.mcap.zstd"
    path.write_bytes(zstandard.compress(b""))
    with pytest.raises(LogError, match="is compressed and empty"):
        read_dive(path, Config())
