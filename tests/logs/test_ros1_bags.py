"""Bags of ROS 1: the same columns as from MCAP, whoever wrote them and however, and what is damaged is told."""

import bz2
import struct
import time
from pathlib import Path

import lz4.frame
import numpy as np
import other_bags
import pytest
from small_logs import DVL_MESSAGES, IMU_MESSAGES, written

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import LogError
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.log_file import DamageError
from insdvl_replay.logs.formats.recording import Recording, open_recording
from insdvl_replay.logs.formats.ros1_bag import messages_in

Fields = dict[str, bytes]


def record(fields: Fields, data: bytes) -> bytes:
    """Write a record as the format says: http://wiki.ros.org/Bags/Format/2.0."""
    header = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value
        for name, value in fields.items()
    )
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def message(
    connection: int, sec: int, nanosec: int, data: bytes, *, turned: bool = False
) -> bytes:
    fields = {
        "op": b"\2",
        "conn": struct.pack("<I", connection),
        "time": struct.pack("<II", sec, nanosec),
    }
    return record(dict(reversed(fields.items())) if turned else fields, data)


def connection(number: int, topic: str = "/depth", definition: bytes = b"float64 z") -> bytes:
    told = {
        "topic": topic.encode(),
        "type": b"p/Depth",
        "md5sum": b"*",
        "message_definition": definition,
    }
    header = record(told, b"")[4:-4]
    return record(
        {"op": b"\7", "conn": struct.pack("<I", number), "topic": topic.encode()}, header
    )


def chunk(content: bytes, compression: str = "none", size: int | None = None) -> bytes:
    packed = {"none": bytes, "bz2": bz2.compress, "lz4": lz4.frame.compress}.get(
        compression, bytes
    )(content)
    size = len(content) if size is None else size
    return record(
        {"op": b"\5", "compression": compression.encode(), "size": struct.pack("<I", size)}, packed
    )


def unclosed(*records: bytes) -> bytes:
    """Write a bag as it is while it is recorded."""
    header = {"op": b"\3", "index_pos": bytes(8), "conn_count": bytes(4), "chunk_count": bytes(4)}
    return b"#ROSBAG V2.0\n" + record(header, bytes(40)) + b"".join(records)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Dive:
    path = tmp_path_factory.mktemp("whole") / "dive.mcap"
    path.write_bytes(written())
    return read_dive(path, Config())


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return other_bags.bag(tmp_path / "dive.bag", "bz2")


def assert_same(one: Dive, other: Dive) -> None:
    for role in ("imu", "dvl"):
        expected = vars(getattr(other, role))
        for name, values in vars(getattr(one, role)).items():
            np.testing.assert_array_equal(values, expected[name], err_msg=f"{role}.{name}")


@pytest.mark.parametrize("compression", ["", "bz2", "lz4"], ids=["plain", "bz2", "lz4"])
def test_a_bag_of_rosbags_gives_the_columns_of_the_mcap(
    compression: str, whole: Dive, tmp_path: Path
) -> None:
    bag = other_bags.bag(tmp_path / "dive.bag", compression)
    dive = read_dive(bag, Config())
    assert_same(dive, whole)
    assert dive.name == "dive"
    assert {one.topic: one.messages for one in dive.channels} == {
        "/imu": IMU_MESSAGES,
        "/dvl": DVL_MESSAGES,
    }
    assert not inspect_log(bag, Config(), deep=True).notes


def payloads(log: Recording) -> dict[tuple[str, str], list[tuple[int, bytes]]]:
    found: dict[tuple[str, str], list[tuple[int, bytes]]] = {}
    for one in log.channels:
        messages = found.setdefault((one.topic, one.metadata["callerid"]), [])
        for block in log.blocks({one.id}):
            rows = zip(
                block.log_time.tolist(), block.offsets.tolist(), block.sizes.tolist(), strict=True
            )
            messages += [
                (time_ns, bytes(block.buffer[start : start + size]))
                for time_ns, start, size in rows
            ]
    return found


def test_a_recorded_bag_holds_what_its_mcap_holds(ros1: Path) -> None:
    """Every message of every connection, as roscpp recorded it and as it was converted; and the same roles."""
    paths = [ros1 / f"rexrov2_simulated.{suffix}" for suffix in ("bag", "mcap")]
    bag, mcap = map(open_recording, paths)
    one, other = payloads(bag), payloads(mcap)
    assert one == other
    assert (
        sum(map(len, one.values())) == sum(channel.messages for channel in bag.channels) == 10367
    )
    types = {channel.topic: channel.type_name for channel in mcap.channels}
    assert {channel.topic: channel.type_name for channel in bag.channels} == types
    assert not bag.notes
    assert bag.parts[0].span_ns == mcap.parts[0].span_ns
    seen, expected = (inspect_log(path, Config(), deep=True) for path in paths)
    assert (seen.roles, seen.topics, seen.reference) == (
        expected.roles,
        expected.topics,
        expected.reference,
    )
    assert [clock for clock in seen.clocks if clock.role] == [
        clock for clock in expected.clocks if clock.role
    ]
    assert next(role.topic for role in seen.roles if role.role == "imu") == "/rexrov2/imu"


def index_start(data: bytes) -> int:
    return int.from_bytes(data[data.index(b"index_pos=") + 10 :][:8], "little")


def test_a_bag_that_was_not_closed_is_read_with_a_note(bag: Path, whole: Dive) -> None:
    data = bag.read_bytes()
    start = index_start(data)
    bag.write_bytes(
        data[:start].replace(b"index_pos=" + start.to_bytes(8, "little"), b"index_pos=" + bytes(8))
    )
    dive = read_dive(bag, Config())
    assert_same(dive, whole)
    [note] = [note for note in dive.notes if note.severity == "warning"]
    assert note.text == "dive.bag was not closed by its recorder: the last messages may be missing"
    log = open_recording(bag)
    assert log.log_times().keys() == {channel.id for channel in log.channels}


def test_a_bag_without_indexes_behind_its_chunks_is_read_if_it_was_not_closed(
    tmp_path: Path,
) -> None:
    path = tmp_path / "dive.bag"
    inside = connection(3) + message(3, 1, 5, b"a" * 8) + message(3, 2, 0, b"b" * 8, turned=True)
    path.write_bytes(unclosed(chunk(inside, "bz2"), chunk(message(3, 4, 0, b"c" * 8), "lz4")))
    log = open_recording(path)
    [channel] = log.channels
    assert (channel.topic, channel.type_name, channel.messages) == ("/depth", "p/Depth", 3)
    assert log.log_times()[channel.id].tolist() == [1_000_000_005, 2_000_000_000, 4_000_000_000]
    assert [
        bytes(block.buffer[start:][:8])
        for block in log.blocks({channel.id})
        for start in block.offsets
    ] == [letter * 8 for letter in (b"a", b"b", b"c")]


def test_headers_of_any_form_are_read_in_time(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    forms = rng.integers(0, 2, 300).astype(bool).tolist()
    content = b"".join(
        message(i % 3, i, 7, bytes(i % 5), turned=turned) for i, turned in enumerate(forms)
    )
    (connections, time_ns, _, _, sizes), others = messages_in(memoryview(content))
    assert not others
    for number in range(3):
        is_own = connections == number
        assert (time_ns[is_own] // 10**9).tolist() == list(range(number, 300, 3))
        assert sizes[is_own].tolist() == [i % 5 for i in range(number, 300, 3)]


def test_a_bag_that_was_cut_gives_what_is_whole_of_it(bag: Path, whole: Dive) -> None:
    """In its only chunk, and in what stands behind its chunks."""
    data = bag.read_bytes()
    start = index_start(data)
    for size, hint in (
        (int(0.6 * start), "no message"),
        ((len(data) + start) // 2, "--allow-damaged uses"),
    ):
        bag.write_bytes(data[:size])
        with pytest.raises(
            LogError, match=r"dive\.bag: is damaged at byte \d+: a record says it has"
        ) as raised:
            read_dive(bag, Config())
        assert hint in raised.value.hint
    dive = read_dive(bag, Config(), allow_damaged=True)
    [note] = [note for note in dive.notes if note.code == "log_damaged"]
    assert "dive.bag is damaged in" in note.text
    size = dive.imu.time_ns.size
    np.testing.assert_array_equal(dive.imu.specific_force_b, whole.imu.specific_force_b[:size])


def test_an_end_that_contradicts_a_chunk_is_reported(bag: Path) -> None:
    """The last bytes of the bag say how many messages its last connection has in its last chunk."""
    data = bag.read_bytes()
    bag.write_bytes(data[:-4] + bytes([data[-4] ^ 1]) + data[-3:])
    with pytest.raises(LogError, match="the end of the bag does not agree with one of its chunks"):
        open_recording(bag)


def test_every_flipped_byte_of_a_packed_bag_is_found(tmp_path: Path, whole: Dive) -> None:
    """But for callers, checksums of types and what fills the header up, on which nothing hangs."""
    data = other_bags.bag(tmp_path / "dive.bag", "bz2").read_bytes()
    path = tmp_path / "flipped.bag"
    rng, refused = np.random.default_rng(4), 0
    for place in rng.choice(len(data), 60, replace=False).tolist():
        path.write_bytes(
            data[:place] + bytes([data[place] ^ 1 << int(rng.integers(8))]) + data[place + 1 :]
        )
        try:
            dive = read_dive(path, Config())
        except LogError:
            refused += 1
        else:
            assert_same(dive, whole)
    assert refused > 40


DEPTHS = connection(0) + message(0, 1, 0, bytes(8))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (chunk(DEPTHS, size=7), "a chunk opens to"),
        (chunk(DEPTHS, "bz2", size=len(DEPTHS) - 1), "a chunk opens to"),
        (chunk(DEPTHS, "bz2", size=2**32 - 1), "says it opens to 4294967295"),
        (chunk(DEPTHS, "bz2", size=1 << 27), "says it opens to 134217728"),
        (chunk(DEPTHS, "xz"), "compressed with 'xz'"),
        (
            record({"op": b"\5", "compression": b"bz2", "size": b"\1\0\0\0"}, b"no bz2"),
            "cannot be decompressed",
        ),
        (chunk(message(7, 1, 0, bytes(8))), "of connection 7, which is not defined"),
        (
            chunk(DEPTHS) + chunk(connection(0, "/other")),
            "connection 0 is not the same in two places",
        ),
        (chunk(DEPTHS[:-1]), "in the chunk, "),
        (
            chunk(DEPTHS)
            + record({"op": b"\4", "conn": bytes(4), "count": b"\2\0\0\0"}, bytes(12)),
            "does not have its 1 entries",
        ),
        (chunk(record({"op": b"\2"}, b"")), "no field 'time' of 8 bytes"),
        (chunk(b"\xff" * 40), "a record says its header has 4294967295 bytes"),
        (message(0, 1, 0, b""), "a record of kind 2 is in the wrong place"),
        (b"\x08\0\0\0\7\0\0\0abcd\0\0\0\0", "has no named fields"),
        (b"\0" * 5, "5 bytes are left where a record needs at least 8"),
        (record({"op": b"\3", "encryptor": b"rosbag/AesCbcEncryptor"}, b""), "is encrypted"),
        (record({"op": b"\3"}, b""), "the bag has 2 headers"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_no_bag_is_reported_by_its_place(
    content: bytes, said: str, tmp_path: Path
) -> None:
    path = tmp_path / "dive.bag"
    path.write_bytes(unclosed(content))
    with pytest.raises(LogError) as raised:
        open_recording(path)
    assert said in raised.value.message
    assert raised.value.hint


SMALL = record({"op": b"\x63"}, b"")
LIKE = message(0, 1, 0, b"")


def test_a_chunk_of_more_than_65536_other_records_is_left_at_the_next() -> None:
    """Such a record is too short for a message, so the rest of the chunk need not be looked at."""
    content = memoryview(SMALL * ((1 << 16) + 10))
    with pytest.raises(DamageError) as raised:
        messages_in(content)
    assert raised.value.damage == (
        (1 << 16) * len(SMALL),
        "more than 65536 records of a chunk are not messages",
    )


@pytest.mark.parametrize("inside", [bytes(1), SMALL, LIKE], ids=["zeros", "others", "alike"])
@pytest.mark.nightly
def test_a_small_bag_cannot_ask_for_much(inside: bytes, tmp_path: Path) -> None:
    """Chunks that bz2 packs ten thousand times; together they open to no more than a log of their size may hold."""
    one = chunk(inside * ((16 << 20) // len(inside)), "bz2")
    assert len(one) < 20_000
    path = tmp_path / "bomb.bag"
    path.write_bytes(unclosed(*[one] * 30))
    start_s = time.process_time()
    with pytest.raises(LogError, match=r"dive|bomb\.bag: is damaged at byte"):
        open_recording(path)
    assert time.process_time() - start_s < 30.0
    assert (len(SMALL), len(LIKE)) == (16, 46)
