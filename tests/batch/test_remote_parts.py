"""Remote logs that a camera fills: only chunks that a replay can use are fetched, and the replay is the same."""

import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_logs import CAMERA, with_camera
from remote_server import LogServer, served
from small_logs import simulated

from insdvl_replay.batch.dive_paths import find_dives
from insdvl_replay.batch.inspect_logs import Look
from insdvl_replay.batch.manifest import fetch_dives
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import LogError
from insdvl_replay.inspection.survey import inspect_log, inspect_summary
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.logs.formats import remote, remote_parts
from insdvl_replay.logs.formats.mcap_file import PARTS
from insdvl_replay.logs.formats.remote import fetched, file_digest, read_summary
from insdvl_replay.logs.formats.remote_parts import is_picture
from insdvl_replay.sim.dive import simulate_dive

pytestmark = pytest.mark.usefixtures("cache")
PICTURE = 100_000
PICTURES = 40
TAIL = 128 << 10  # of a log, which is asked for first


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A log of 4 MB with a camera, which counts as a long one."""
    monkeypatch.setattr(remote, "LEAST_BYTES", 1 << 20)
    path = tmp_path / "camera.mcap"
    with_camera(path, simulated(), PICTURE, PICTURES)
    return path


@contextmanager
def server_of(log: Path) -> Iterator[LogServer]:
    with served({"/camera.mcap": log.read_bytes()}) as server:
        yield server


def bytes_needed(server: LogServer) -> int:
    """Return the length of the chunks that have other messages than pictures, with their indexes."""
    summary = read_summary(f"{server.url}/camera.mcap", 1 << 30)
    (camera,) = [channel.id for channel in summary.channels if channel.topic == CAMERA]
    chunks = [chunk for chunk in summary.chunks if {*chunk.message_index_offsets} != {camera}]
    server.sent = 0
    server.asked.clear()
    return sum(chunk.chunk_length + chunk.message_index_length for chunk in chunks)


def columns_of(path: Path) -> dict[str, Any]:
    """Return the columns of a dive, and the summary of its notes."""
    dive = read_dive(path, Config())
    columns = {
        **vars(dive.imu),
        **{f"dvl_{name}": value for name, value in vars(dive.dvl).items()},
    }
    return {name: value for name, value in columns.items() if isinstance(value, np.ndarray)}


def test_only_chunks_of_sensors_are_fetched_and_the_dive_is_the_same(log: Path) -> None:
    with server_of(log) as server:
        needed = bytes_needed(server)
        path = fetched(f"{server.url}/camera.mcap")
        assert server.sent - TAIL < 1.3 * needed
    assert path.parent.name == file_digest(path)
    ours = columns_of(path)
    whole = columns_of(log)
    assert ours.keys() == whole.keys()
    for name, values in whole.items():
        np.testing.assert_array_equal(ours[name], values, err_msg=name)
    (note,) = [note for note in read_dive(path, Config()).notes if note.code == "log_parts"]
    assert note.count == PICTURES
    assert CAMERA in note.text
    assert note.severity == "info"


def test_the_shorter_log_is_sound_and_names_what_is_left_out(log: Path) -> None:
    with server_of(log) as server:
        path = fetched(f"{server.url}/camera.mcap")
    found = inspect_log(path, Config(), deep=True)
    whole = inspect_log(log, Config(), deep=True)
    assert found.log.has_summary
    assert found.log.profile == whole.log.profile
    assert {*found.log.metadata} == {PARTS, "vehicle"}
    ours = {topic.topic: topic.messages for topic in found.topics}
    theirs = {topic.topic: topic.messages for topic in whole.topics}
    assert ours.pop(CAMERA) == 0
    assert theirs.pop(CAMERA) == PICTURES
    assert ours == theirs
    codes = {note.code for note in found.notes}
    assert not codes & {"log_damaged", "log_summary"}


def test_it_is_kept_and_asked_for_once(log: Path) -> None:
    with server_of(log) as server:
        url = f"{server.url}/camera.mcap"
        path = fetched(url)
        server.asked.clear()
        assert fetched(url) == path
        assert server.asked == ["HEAD"]
        assert fetched(url, offline=True) == path


def test_the_whole_is_fetched_where_it_is_wanted_or_its_digest_is_listed(log: Path) -> None:
    with server_of(log) as server:
        url = f"{server.url}/camera.mcap"
        part = fetched(url)
        sha256 = file_digest(log)
        assert fetched(url, sha256).read_bytes() == log.read_bytes()
        assert fetched(url, whole=True).read_bytes() == log.read_bytes()
        assert fetched(url).parent.name == sha256, "the whole serves, too"
        assert part.parent.name != sha256
        dives = find_dives([url])
        (deep,) = Look(deep=True).fetched(dives, fetch_dives)
        assert deep.path.read_bytes() == log.read_bytes()
        assert inspect_summary(url, Config()).log.chunks > PICTURES


@pytest.mark.parametrize(
    "fault",
    ["short", "few pictures", "no ranges", "loose messages", "huge chunks", "much metadata"],
)
def test_other_logs_are_fetched_whole(
    fault: str, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if fault == "short":
        monkeypatch.setattr(remote, "LEAST_BYTES", 1 << 30)
    if fault == "few pictures":
        with_camera(log, simulated(), 1000, 3)
        monkeypatch.setattr(remote, "LEAST_BYTES", 1)
    if fault == "loose messages":
        monkeypatch.setattr(remote_parts, "_SLACK_BYTES", -(1 << 30))
    if fault == "huge chunks":
        monkeypatch.setattr(remote_parts, "_MOST_OF_CHUNK", PICTURE)
    if fault == "much metadata":
        monkeypatch.setattr(remote_parts, "_MOST_METADATA", 10)
    with server_of(log) as server:
        server.has_ranges = fault != "no ranges"
        assert fetched(f"{server.url}/camera.mcap").read_bytes() == log.read_bytes()


@pytest.mark.parametrize(
    ("fault", "value"), [("flips", True), ("cut", 100), ("changes", True), ("stalls", True)]
)
def test_nothing_is_kept_of_a_server_that_misbehaves(
    fault: str, value: Any, log: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote, "STALLED_S", 0.3)
    with server_of(log) as server:
        read = remote._parts_of

        def misbehaving(url: str, size: int) -> Any:
            parts = read(url, size)
            setattr(server, fault, value)
            return parts

        monkeypatch.setattr(remote, "_parts_of", misbehaving)
        if fault == "flips":
            # Only the reader knows the checksum of a chunk.
            with pytest.raises(LogError):
                read_dive(fetched(f"{server.url}/camera.mcap"), Config())
            return
        with pytest.raises(LogError):
            fetched(f"{server.url}/camera.mcap")
    assert not [path for path in cache.rglob("*.mcap") if path.is_file()]


def test_types_of_pictures_are_known_by_each_spelling() -> None:
    for name in ("sensor_msgs/msg/Image", "sensor_msgs/Image", "foxglove.CompressedVideo"):
        assert is_picture(name)
    for name in ("sensor_msgs/msg/Imu", "mine/msg/Image", "", "geometry_msgs/msg/TwistStamped"):
        assert not is_picture(name)


@pytest.mark.nightly
def test_of_a_gigabyte_with_a_camera_at_most_1_3_times_the_sensors_are_fetched(
    tmp_path: Path,
) -> None:
    dive = tmp_path / "dive.mcap"
    write_dive(dive, simulate_dive("figure-eight", seed=1, duration_s=600.0), is_compressed=False)
    log = tmp_path / "camera.mcap"
    with_camera(log, dive.read_bytes(), 2_000_000, 500, messages_between=100)
    assert log.stat().st_size > 1e9
    with (
        log.open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content,
        served({"/camera.mcap": content}) as server,  # type: ignore[dict-item]
    ):
        needed = bytes_needed(server)
        path = fetched(f"{server.url}/camera.mcap")
        assert server.sent <= 1.3 * needed
        assert server.asked.count("GET") < 550
    ours = columns_of(path)
    for name, values in columns_of(log).items():
        np.testing.assert_array_equal(ours[name], values, err_msg=name)
