"""Messages of ROS 1: columns agree with what rosbags writes and reads; `test_ros1_bags` has whole dives."""

import struct
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blocks import block_of
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.formats.definitions import PRIMITIVES, definitions_of
from insdvl_replay.logs.formats.fields import message_layout
from insdvl_replay.logs.formats.readers import BinaryReader, channel_paths, open_reader
from insdvl_replay.logs.formats.recording import open_recording

TYPE = "test_msgs/msg/Ping"
MAIN = (
    "Header header\nbyte LOW=-3\nstring NAME=of a # sonar\nbool good\nbyte low\nchar high\nfloat64 x\nstring[] names\n"
    "duration age\ntime[2] seen\nstd_msgs/Empty nothing\ntest_msgs/Beam[] beams\nint16[3] fixed\nuint64 last"
)
BEAM = "int8 id\nfloat32 velocity"
HEADER = "uint32 seq\ntime stamp\nstring frame_id"
SECTIONS = {"std_msgs/Header": HEADER, "std_msgs/Empty": "", "test_msgs/Beam": BEAM}
TEXT = "\n".join([MAIN, *(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in SECTIONS.items())])


STORE = get_typestore(Stores.ROS1_NOETIC)
STORE.register(get_types_from_msg(BEAM, "test_msgs/msg/Beam") | get_types_from_msg(MAIN, TYPE))


def serialised(ping: dict[str, Any]) -> bytes:
    types = STORE.types
    time, duration = types["builtin_interfaces/msg/Time"], types["builtin_interfaces/msg/Duration"]
    header = types["std_msgs/msg/Header"](
        seq=ping["seq"], stamp=time(sec=7, nanosec=8), frame_id=ping["frame"]
    )
    message = types[TYPE](
        header=header,
        good=True,
        low=ping["low"],
        high=ping["high"],
        x=ping["x"],
        names=ping["names"],
        age=duration(sec=-4, nanosec=5),
        seen=[time(sec=1, nanosec=2), time(sec=2**31 - 1, nanosec=3)],
        nothing=types["std_msgs/msg/Empty"](),
        beams=[
            types["test_msgs/msg/Beam"](id=-i, velocity=number)
            for i, number in enumerate(ping["beams"])
        ],
        fixed=np.array([-1, 2, -3], np.int16),
        last=2**62,
    )
    return bytes(STORE.serialize_ros1(message, TYPE))


def reader(*paths: str) -> BinaryReader:
    return BinaryReader(definitions_of(TYPE, TEXT, "ros1"), TYPE, paths, is_cdr=False)


@given(
    frame=st.text(max_size=5),
    names=st.lists(st.text(max_size=3), max_size=3),
    beams=st.lists(st.floats(width=32, allow_nan=False), max_size=4),
    low=st.integers(-128, 127),
    high=st.integers(0, 255),
)
def test_columns_equal_what_rosbags_serialised(
    frame: str, names: list[str], beams: list[float], low: int, high: int
) -> None:
    ping = {
        "seq": 12,
        "frame": frame,
        "low": low,
        "high": high,
        "x": -0.5,
        "names": names,
        "beams": beams,
    }
    expected = {
        "header.seq": [12],
        "header.stamp": [7, 8],
        "good": [1],
        "low": [low],
        "high": [high],
        "x": [-0.5],
        "age": [-4, 5],
        "seen": [1, 2, 2**31 - 1, 3],
        "beams[*].velocity": beams,
        "beams[*].id": [-i for i in range(len(beams))],
        "fixed": [-1, 2, -3],
        "last": [2**62],
    }
    columns = reader(*expected).columns(block_of([serialised(ping)] * 2))
    for path, numbers in expected.items():
        np.testing.assert_array_equal(columns[path], [numbers] * 2)


PING = {
    "seq": 1,
    "frame": "dvl",
    "low": 0,
    "high": 0,
    "x": 1.0,
    "names": ["a", "b"],
    "beams": [1.0, 2.0],
}


def test_messages_of_other_lengths_are_side_by_side() -> None:
    pings = [PING, PING | {"beams": [3.0]}, PING | {"names": []}]
    columns = reader("beams[*].velocity").columns(block_of([serialised(ping) for ping in pings]))
    np.testing.assert_array_equal(
        columns["beams[*].velocity"], [[1.0, 2.0], [3.0, np.nan], [1.0, 2.0]]
    )


def test_a_message_has_exactly_the_bytes_of_its_fields() -> None:
    data = serialised(PING)
    for wrong in (*(data[:length] for length in range(len(data))), data + b"\0"):
        with pytest.raises(
            LogError, match=r"a message of \d+ bytes (is shorter|has \d+ by its schema)"
        ):
            reader("x").columns(block_of([wrong]))


def test_hostile_lengths_are_refused_before_anything_is_made() -> None:
    data = bytearray(serialised(PING))
    for place in range(len(data) - 4):
        hostile = bytes(data[:place]) + struct.pack("<I", 2**32 - 1) + bytes(data[place + 4 :])
        try:
            columns = reader("x").columns(block_of([hostile]))
        except LogError:
            continue
        assert columns["x"].shape == (1, 1)


def test_structures_without_fields_are_counted_too() -> None:
    """They take no byte of the message, which could else hold any number of them."""
    definitions = definitions_of("p/T0", f"p/T1[4294967295] t\n{'=' * 80}\nMSG: p/T1\n", "ros1")
    with pytest.raises(LogError, match="a message holds more than 262144 fields"):
        message_layout(definitions, "p/T0", b"", is_cdr=False)


def test_a_type_without_fields_has_no_bytes() -> None:
    definitions = definitions_of("std_msgs/Empty", "", "ros1")
    assert message_layout(definitions, "std_msgs/msg/Empty", b"", is_cdr=False).size == 0
    assert (
        BinaryReader(definitions, "std_msgs/Empty", [], is_cdr=False).columns(block_of([b"", b""]))
        == {}
    )


def test_times_go_on_to_2106_and_durations_may_be_negative() -> None:
    """For rosbags both are signed; the format has times without a sign."""
    fields = BinaryReader(
        definitions_of("p/T", "time t\nduration d", "ros1"), "p/T", ["t", "d"], is_cdr=False
    )
    columns = fields.columns(block_of([b"\xff" * 16]))
    assert columns["t"].tolist() == [[2**32 - 1, 2**32 - 1]]
    assert columns["d"].tolist() == [[-1, -1]]


def test_what_a_schema_lacks_is_reported_with_what_writes_it() -> None:
    with pytest.raises(LogError, match="the schema uses std_msgs/msg/Header") as error:
        definitions_of(TYPE, "Header header", "ros1")
    assert "`mcap convert`" in error.value.hint


def test_recorded_messages_are_those_that_rosbags_reads(ros1: Path) -> None:
    """All numbers of some messages of five types, by the type that stands in the log."""
    rexrov = ros1 / "rexrov2_simulated.mcap"
    log = open_recording(rexrov)
    wanted = {
        "/rexrov2/imu",
        "/rexrov2/pose_gt",
        "/rexrov2/dvl",
        "/rexrov2/pressure",
        "/est/state",
    }
    for channel in (one for one in log.channels if one.topic in wanted):
        known = channel_paths(channel)
        leaves = [
            path
            for path, kind in known.items()
            if kind in PRIMITIVES and f"{path}[*]" not in known
        ]
        fields = open_reader(channel, leaves)
        (found,) = _joined([fields.columns(block) for block in log.blocks({channel.id})])
        expected = _read_by_rosbags(rexrov, channel.topic, channel.type_name, channel.schema_text)
        assert len(expected) == len(range(0, channel.messages, EVERY)) > 10
        for path in leaves:
            numbers = [_at(message, path) for message in expected]
            np.testing.assert_array_equal(found[path][::EVERY], numbers, err_msg=path)


EVERY = 20


def _joined(parts: list[dict[str, np.ndarray]]) -> list[dict[str, np.ndarray]]:
    return [{path: np.concatenate([part[path] for part in parts]) for path in parts[0]}]


def _read_by_rosbags(log: Path, topic: str, type_name: str, text: str) -> list[Any]:
    store = get_typestore(Stores.EMPTY)
    full = type_name.replace("/", "/msg/")
    store.register(get_types_from_msg(text, full) | get_typestore(Stores.ROS1_NOETIC).fielddefs)
    with log.open("rb") as stream:
        messages = make_reader(stream).iter_messages(topics=[topic], log_time_order=False)
        return [
            store.deserialize_ros1(message.data, full)
            for _, _, message in islice(messages, 0, None, EVERY)
        ]


def _at(value: Any, path: str) -> list[float]:
    """Give the numbers at a path of a message of rosbags."""
    name, _, rest = path.partition(".")
    inner = getattr(value, name.partition("[")[0])
    items = list(inner) if "[" in name else [inner]
    return [number for item in items for number in (_at(item, rest) if rest else [float(item)])]
