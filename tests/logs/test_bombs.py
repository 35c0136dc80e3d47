"""Small files that would open to much, or take long: refused, or read in memory and steps that fit their size."""

import gc
import json
import random
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import bombs
import numpy as np
import pytest
import small_logs
import zstandard
from bombs import (
    START_NS,
    channel,
    chunk,
    index,
    log,
    lz4_zeros,
    message,
    record,
    schema,
    write,
    zstd_zeros,
)
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from mcap.writer import Writer

from insdvl_replay.checks.imu import turned_by
from insdvl_replay.checks.reference import legs_m
from insdvl_replay.cli.messages import log_failure
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import ImuColumns
from insdvl_replay.core.errors import LogError, Note, most_like
from insdvl_replay.geometry.frames import Steps
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.logs.formats.decoded import JsonReader
from insdvl_replay.logs.formats.definitions import definition_text, parse_definitions
from insdvl_replay.logs.formats.fields import message_layout
from insdvl_replay.logs.formats.log_file import LogChannel, most_opened
from insdvl_replay.logs.formats.readers import channel_paths
from insdvl_replay.logs.formats.recording import open_recording
from insdvl_replay.sim.dive import exact_dive

MB = 1 << 20
IMU = "sensor_msgs/msg/Imu"


def peak_mb(work: Callable[[], object]) -> float:
    """Give the memory that work takes at its most."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / MB
    finally:
        tracemalloc.stop()


@contextmanager
def takes_less_than(limit_s: float) -> Iterator[None]:
    """Hold processor time to a limit that is ten times too long, where work of the wrong order takes minutes."""
    start_s = time.process_time()
    yield
    assert time.process_time() - start_s < limit_s


def cut(body: bytes) -> bytes:
    """Give a log whose last chunk lacks its end, and all that would stand behind it."""
    return (
        log(b"")[: -len(log(b"")) + log(b"").rindex(record(bombs.DATA_END, bytes(4)))] + body[:-10]
    )


@pytest.mark.parametrize("kind", ["whole", pytest.param("cut", marks=pytest.mark.nightly)])
@pytest.mark.parametrize(("compression", "zeros"), [("lz4", lz4_zeros), ("zstd", zstd_zeros)])
def test_a_chunk_that_opens_to_more_than_it_says_is_refused(
    kind: str, compression: str, zeros: Callable[[int], bytes], tmp_path: Path
) -> None:
    packed, path = zeros(256 * MB), tmp_path / "bomb.mcap"

    def refuse() -> None:
        with pytest.raises(LogError, match="is damaged at byte"):
            open_recording(path)
        assert not list(open_recording(path, allow_damaged=True).blocks({1}))

    for announced in (MB, 0, 1 << 60):
        bomb = chunk(packed, announced, compression)
        write(path, log(bomb) if kind == "whole" else cut(bomb))
        limit_mb = most_opened(len(bomb)) / MB if kind == "cut" and announced != MB else 1
        # The lz4 package copies what it has unpacked; the rest is the compiler.
        assert peak_mb(refuse) < 2 * limit_mb + 60


def test_private_records_take_no_memory_of_their_own(tmp_path: Path) -> None:
    content = record(bombs.PRIVATE, b"") * 3_000_000 + message(1, b"payload")
    packed = zstandard.ZstdCompressor().compress(content)
    path = write(tmp_path / "private.mcap", log(chunk(packed, len(content), "zstd")))
    open_recording(path, allow_damaged=True)  # so that what is compiled is loaded
    assert peak_mb(lambda: open_recording(path, allow_damaged=True)) < len(content) / MB + 30


def test_a_file_opens_to_no_more_than_its_size_allows(tmp_path: Path) -> None:
    zeros = zstd_zeros(64 * MB)
    path = write(tmp_path / "many.mcap", log(chunk(zeros, 64 * MB, "zstd") * 17))
    with pytest.raises(
        LogError,
        match=r"the chunks up to here open to 1140850688 bytes, where a file of \d+ may hold 1073741824",
    ):
        open_recording(path)


def test_a_chunk_without_a_record_is_opened_once(tmp_path: Path) -> None:
    path = write(tmp_path / "zeros.mcap", log(chunk(zstd_zeros(4 * MB), 4 * MB, "zstd")))
    seen = open_recording(path, allow_damaged=True)
    assert peak_mb(lambda: [*seen.blocks({1}), *seen.parts[0].saved_times()]) < 1
    assert not [*seen.blocks({1}), *seen.parts[0].saved_times()]


def test_bytes_of_a_damaged_chunk_are_let_go_without_a_collection(tmp_path: Path) -> None:
    packed = zstd_zeros(16 * MB)
    path = write(tmp_path / "short.mcap", log(chunk(packed, 17 * MB, "zstd")))
    list(open_recording(path, allow_damaged=True).blocks({1}))  # what is loaded stays
    gc.disable()
    tracemalloc.start()
    try:
        seen = open_recording(path, allow_damaged=True)
        assert not list(seen.blocks({1}))
        assert seen.damage_error() is not None
        assert tracemalloc.get_traced_memory()[0] < MB
    finally:
        tracemalloc.stop()
        gc.enable()


def test_a_chunk_with_many_channels_stays_open(tmp_path: Path) -> None:
    seen = open_recording(write(tmp_path / "channels.mcap", _many_imus(50, beside=8 * MB)))
    assert peak_mb(lambda: [list(seen.blocks({i})) for i in range(50)]) < 1
    assert len(inspect_log(seen.parts[0].path, Config()).clocks) == 50


def _many_imus(count: int, beside: int) -> bytes:
    body = schema(1, IMU, definition_text(IMU).encode())
    body += b"".join(channel(i, 1, f"/imu{i}") for i in range(count))
    payload = b"\0\1\0\0" + bytes(8) + b"\1\0\0\0\0\0\0\0" + bytes(8 * 37)
    indexes = b""
    for i in range(count):
        indexes += index(i, [(START_NS + i, len(body))])
        body += message(i, payload, START_NS + i)
    body += record(bombs.PRIVATE, bytes(beside))
    packed = zstandard.ZstdCompressor().compress(body)
    return log(chunk(packed, len(body), "zstd", (START_NS, START_NS + count - 1)) + indexes)


def nested(width: int, depth: int) -> str:
    """Give a type of as many levels, each of which holds the next one many times."""
    sections = [
        "\n".join(f"p/T{level + 1} f{i}" for i in range(width)) for level in range(depth)
    ] + ["float64 x"]
    return "".join(
        f"{'=' * 80}\nMSG: p/T{level}\n{section}\n" if level else f"{section}\n"
        for level, section in enumerate(sections)
    )


def test_a_type_that_means_too_many_fields_is_refused_unseen() -> None:
    for width, depth in ((10, 30), (1, 3000)):
        with pytest.raises(
            LogError, match="means more than 65536 fields, or more than 64 within each other"
        ):
            parse_definitions("p/msg/T0", nested(width, depth))
    assert len(parse_definitions("p/msg/T0", nested(1, 60))) == 61
    assert len(parse_definitions("p/msg/T0", nested(10, 3))) == 4


def test_an_array_of_impossible_length_is_refused() -> None:
    for length in ("0", "4294967296", "9" * 5000):
        with pytest.raises(
            LogError, match=r"has an array 'float64\[\d{1,12}\]', which is none or too long"
        ):
            parse_definitions("p/msg/T", f"float64[{length}] x\n")


def test_an_array_is_held_against_the_message_before_its_elements_are_named() -> None:
    definitions = parse_definitions(
        "p/msg/T", f"p/V[{2**32 - 1}] v\n{'=' * 80}\nMSG: p/V\nfloat64 x\n"
    )

    def refuse() -> None:
        with pytest.raises(
            LogError, match="a message of 404 bytes is shorter than its schema and lengths say"
        ):
            message_layout(definitions, "p/msg/T", b"\0\1\0\0" + bytes(400))

    assert peak_mb(refuse) < 1


def test_a_message_holds_a_limited_number_of_fields() -> None:
    definitions = parse_definitions("p/msg/T", f"p/V[300000] v\n{'=' * 80}\nMSG: p/V\nuint8 x\n")
    with pytest.raises(LogError, match="a message holds more than 262144 fields"):
        message_layout(definitions, "p/msg/T", b"\0\1\0\0" + bytes(300_000))


@pytest.mark.parametrize(
    ("count", "links"),
    [
        pytest.param(
            12, lambda i: [other for other in range(12) if other != i], id="each holds all others"
        ),
        pytest.param(1000, lambda i: [i + 1] if i < 999 else [], id="a thousand levels"),
    ],
)
def test_protobuf_types_are_refused_likewise(
    count: int, links: Callable[[int], list[int]]
) -> None:
    files = FileDescriptorSet()
    file = files.file.add(name="a.proto", syntax="proto3", package="p")
    for i in range(count):
        kind = file.message_type.add(name=f"M{i}")
        for number, other in enumerate(links(i), 1):
            kind.field.add(
                name=f"f{other}", number=number, label=1, type=11, type_name=f".p.M{other}"
            )
    bomb = LogChannel(1, "/imu", "p.M0", "protobuf", "protobuf", 1, files.SerializeToString())
    with pytest.raises(LogError, match="the schema means more than 65536 fields"):
        channel_paths(bomb)


def test_names_are_compared_with_a_few_of_many() -> None:
    rng = random.Random(1)
    many = ["".join(rng.choices(ascii_lowercase, k=150)) for _ in range(20_000)]
    with takes_less_than(10.0):
        assert most_like(many[-1][1:], many, 1) == [many[-1]]


def test_of_a_message_of_many_keys_a_few_are_looked_at(tmp_path: Path) -> None:
    """To look at one takes as long as there are keys."""
    payload = json.dumps({f"key{i}": 1.5 for i in range(10_000)}).encode()
    body = schema(1, "imu", b"", "") + channel(1, 1, "/imu", "json") + message(1, payload)
    path = write(tmp_path / "wide.mcap", log(body))
    with takes_less_than(15.0):
        assert [topic.topic for topic in inspect_log(path, Config()).topics] == ["/imu"]


def test_a_field_that_no_message_has_is_looked_for_in_a_limited_number_of_them() -> None:
    reader = JsonReader("", b"", ["absent"])
    for _ in range(20):
        with pytest.raises(LogError, match="a JSON message has no field 'absent'"):
            reader.learn([{"key": 1.5}] * 3)
    with pytest.raises(LogError, match="a JSON message has no field 'absent'"):
        reader.learn([{"key": 1.5}, {"absent": 1.5}])
    reader.learn([{"absent": 1.5}])
    assert "absent" in reader.known


def test_topics_beyond_what_is_looked_at_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from insdvl_replay.inspection import probed_topics

    monkeypatch.setattr(probed_topics, "_MOST_WORK_OF_ALL", 1)
    channels = b"".join(channel(number, 1, f"/topic{number}", "json") for number in (1, 2))
    messages = b"".join(message(number, json.dumps({"depth": 1.5}).encode()) for number in (1, 2))
    inventory = inspect_log(
        write(tmp_path / "two.mcap", log(schema(1, "any", b"", "") + channels + messages)),
        Config(),
    )
    [note] = [note for note in inventory.notes if note.code == "topics_not_looked_at"]
    assert note.count == 1
    assert note.text.endswith(": /topic2")


@pytest.mark.parametrize("kind", ["zstd", "no chunks"])
def test_late_log_times_are_reported_and_no_damage(kind: str, tmp_path: Path) -> None:
    late_ns = 2**63 - small_logs.START_NS
    seen = open_recording(write(tmp_path / "late.mcap", _with_later_log_times(kind, late_ns)))
    assert [note.code for note in seen.notes] == ["log_times_late"]
    inventory = inspect_log(seen.parts[0].path, Config())
    assert inventory.log.start_utc is None
    assert inventory.log.duration_s == pytest.approx(small_logs.SPAN_S, abs=1e-9)


def _with_later_log_times(kind: str, later_ns: int) -> bytes:
    stream = BytesIO()
    writer = Writer(stream, **small_logs.CONTAINERS[kind])
    writer.start()
    channels: dict[str, int] = {}
    for given, channel_, message_ in make_reader(BytesIO(small_logs.written())).iter_messages():
        assert given
        if channel_.topic not in channels:
            number = writer.register_schema(given.name, given.encoding, given.data)
            channels[channel_.topic] = writer.register_channel(channel_.topic, "cdr", number)
        writer.add_message(
            channels[channel_.topic], message_.log_time + later_ns, message_.data, 0
        )
    writer.finish()
    return stream.getvalue()


def test_a_clock_that_is_set_takes_no_memory_and_is_reported(tmp_path: Path) -> None:
    dive = exact_dive("figure-eight", imu_rate_hz=20.0, reference_rate_hz=1.0)
    middle_ns, earlier_ns = int(dive.imu.time_ns.mean()), round(53.9 * 365.25 * 86400e9)

    def until_set(columns: Any) -> Any:
        time_ns = columns.time_ns
        return replace(
            columns, time_ns=np.where(time_ns < middle_ns, time_ns - earlier_ns, time_ns)
        )

    path = tmp_path / "set.mcap"
    parts = {name: until_set(getattr(dive, name)) for name in ("imu", "dvl", "reference")}
    write_dive(path, replace(dive, truth=None, **parts))
    read_dive(path, Config())  # so that what is compiled is loaded
    found: list[Note] = []
    assert peak_mb(lambda: found.extend(read_dive(path, Config()).notes)) < 30
    assert "clock_set" in {note.code for note in found}
    assert "reference_constant" not in {note.code for note in found}


def test_turns_in_a_pause_are_not_made_up() -> None:
    time_ns = np.array([0, 1, 2, 1_000_000, 1_000_001], np.int64) * 1_000_000_000
    imu = ImuColumns(time_ns, np.zeros((5, 3)), np.full((5, 3), 0.01))
    at_s = np.array([0.0, 2.0, 1_000_001.0])
    np.testing.assert_allclose(turned_by(imu, at_s, 2.5)[:, 0], [0.0, 0.02, 0.03], atol=1e-12)
    np.testing.assert_allclose(turned_by(imu, at_s)[:, 0], [0.0, 0.02, 10000.01], atol=1e-6)


def test_legs_begin_where_a_grid_in_time_would_begin_them() -> None:
    rng = np.random.default_rng(3)
    for step_s in (0.5, 1.0, 7.0, 23.0):
        time_s = np.append(0.0, np.cumsum(rng.choice([step_s, 3.0 * step_s], 300)))
        way = rng.normal(size=300) + 1j * rng.normal(size=300)
        rows = np.unique(np.searchsorted(time_s, np.arange(0.0, time_s[-1], 10.0)))
        whole = np.diff(time_s[rows]) < 20.0
        expected = np.diff(np.append(0.0, np.cumsum(way))[rows])[whole]
        np.testing.assert_array_equal(legs_m(Steps(time_s, way, way))[0], expected)


def test_want_of_memory_is_no_error_of_the_program(capsys: pytest.CaptureFixture[str]) -> None:
    assert log_failure(MemoryError("Unable to allocate 8 GiB"), 0) == 3
    assert (
        "error: there is not enough memory: Unable to allocate 8 GiB; hint:"
        in capsys.readouterr().err
    )
