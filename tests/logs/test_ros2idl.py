"""Schemas in ROS 2's part of IDL: parsed as rosbags parses them, and messages that it wrote by them are read."""

import random
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blocks import block_of
from mcap.writer import Writer
from rosbag_messages import START_NS, header, imu_messages, serialised, store_with, xyz
from rosbags.typesys import get_types_from_idl

from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.definitions import definition_text, parse_definitions
from insdvl_replay.logs.formats.readers import BinaryReader

TYPE = "test_msgs/msg/Ping"
RULE = "=" * 80
PING = """// generated from rosidl_adapter/resource/msg.idl.em
// with input from test_msgs/msg/Ping.msg
#include "test_msgs/msg/Beam.idl"
#include "std_msgs/msg/Header.idl"

module test_msgs {
  module msg {
    module Ping_Constants {
      const uint8 MODE_BOTTOM = 1;
      @verbatim (language="comment", text=
        "a comment (with a bracket" "\\n" "and struct Beam { in it }")
      const string NAME = "};";
    };
    typedef double double__9[9];
    typedef double row[3];
    typedef test_msgs::msg::Beam test_msgs__msg__Beam__2[2];
    /* of a # sonar */
    @verbatim (language="comment", text="all of it")
    struct Ping {
      std_msgs::msg::Header header;
      boolean good;
      octet low;
      @unit (value="m/s")
      int8 tiny, other;
      unsigned short few;
      long long many;
      double x;
      @default (value=TRUE)
      string<20> name;
      sequence<string> names;
      double__9 covariance;
      double rows[6];
      test_msgs__msg__Beam__2 pair;
      sequence<Beam, 4> beams;
      sequence<float> ranges;
      uint64 last;
    };
  };
};
"""
BEAM = """#ifndef __beam
module test_msgs { module msg { struct Beam { uint8 id; geometry_msgs::msg::Vector3 direction; float velocity; }; }; };
#endif
"""


def structure(name: str, members: str) -> str:
    """Write a structure in its modules."""
    package, module, last = name.split("/")
    return f"module {package} {{ module {module} {{ struct {last} {{ {members} }}; }}; }};"


MEMBERS = {
    "geometry_msgs/msg/Vector3": "double x; double y; double z;",
    "std_msgs/msg/Header": "builtin_interfaces::msg::Time stamp; string frame_id;",
    "builtin_interfaces/msg/Time": "int32 sec; uint32 nanosec;",
}
OTHERS = {
    "test_msgs/msg/Beam": BEAM,
    **{name: structure(name, members) for name, members in MEMBERS.items()},
}
TEXT = "\n".join(f"{RULE}\nIDL: {name}\n{text}" for name, text in {TYPE: PING, **OTHERS}.items())
PATHS = (
    "header.stamp", "good", "low", "tiny", "other", "few", "many", "x", "covariance", "rows", "pair",
    "beams[*].velocity", "beams[*].direction", "ranges", "last",
)  # fmt: skip


def oracle() -> Any:
    """Make a store of rosbags with its own parse of the same texts, but no arrays of arrays, which it does not read."""
    store = store_with({})
    for text in (PING, *OTHERS.values()):
        stripped = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
        types = get_types_from_idl(stripped)
        store.register(
            {
                name: fields
                for name, fields in types.items()
                if name not in store.fielddefs and fields[1]
            }
        )
    return store


def beam(i: int) -> dict[str, Any]:
    return {"id": i, "direction": xyz((i, 2 * i, -i)), "velocity": 0.5 * i}


def message(count: int) -> dict[str, Any]:
    return {
        "header": {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "sonar" * count},
        "good": True,
        "low": 100,
        "tiny": -3,
        "other": 4,
        "few": 65_000,
        "many": -(2**50),
        "x": 0.25,
        "name": "a" * count,
        "names": ["b" * i for i in range(count)],
        "covariance": np.arange(9.0),
        "rows": np.arange(6.0),
        "pair": [beam(1), beam(2)],
        "beams": [beam(i) for i in range(count)],
        "ranges": 1.5 * np.arange(count),
        "last": 2**62,
    }


@pytest.mark.parametrize("count", [0, 3])
def test_messages_that_rosbags_wrote_by_its_own_parse_are_read(count: int) -> None:
    data = serialised(oracle(), TYPE, message(count))
    columns = BinaryReader(parse_definitions(TYPE, TEXT, "ros2idl"), TYPE, PATHS).columns(
        block_of([data])
    )
    expected = message(count)
    assert columns["header.stamp"].tolist() == [[7, 8]]
    for name in ("good", "low", "tiny", "other", "few", "many", "x", "last"):
        assert columns[name].tolist() == [[expected[name]]], name
    for name in ("covariance", "rows", "ranges"):
        np.testing.assert_array_equal(columns[name], [expected[name]])
    np.testing.assert_array_equal(columns["pair"], [[1, 1, 2, -1, 0.5, 2, 2, 4, -2, 1.0]])
    np.testing.assert_array_equal(columns["beams[*].velocity"], [[0.5 * i for i in range(count)]])
    np.testing.assert_array_equal(
        columns["beams[*].direction"], [[x for i in range(count) for x in (i, 2 * i, -i)]]
    )


WRONG = [
    (PING, "uses std_msgs/msg/Header in test_msgs/msg/Ping and does not define it"),
    (TEXT.replace("struct Ping", "union Ping"), "is not ROS 2's part of IDL"),
    (TEXT.replace("struct Ping {", "struct Ping : Beam {"), "is not ROS 2's part of IDL"),
    (TEXT.replace("struct Ping", "struct Pong"), "does not define it"),
    (TEXT.replace("sequence<float>", "sequence<row>"), "arrays are not supported"),
    (TEXT.replace("double__9[9]", "double__9[SIZE]"), "Cannot resolve constant 'SIZE'"),
    (TEXT.replace("double__9[9]", f"double__9[{10**50}]"), "an array of '1000"),
    (TEXT.replace("float velocity;", "Ping ping;"), "contains itself"),
    (TEXT[:-6], "is not ROS 2's part of IDL"),
]


def test_what_cannot_be_parsed_is_refused_with_its_place() -> None:
    for text, what in WRONG:
        with pytest.raises(LogError, match=re.escape(what)) as refused:
            parse_definitions(TYPE, text, "ros2idl")
        assert refused.value.hint


@pytest.mark.parametrize("count", [15, pytest.param(60, marks=pytest.mark.nightly)])
def test_harmed_texts_are_refused_or_parsed_and_nothing_else(count: int) -> None:
    rng = random.Random(5)
    refused = 0
    for _ in range(count):
        first, length = rng.randrange(len(TEXT)), rng.choice((1, 3, 20))
        put_in = rng.choice(
            (
                "",
                "}",
                "{",
                "@",
                "(",
                '"',
                "::",
                "/*",
                "<<<<",
                "9" * 40,
                "sequence<" * 50,
                TEXT[:first],
            )
        )
        try:
            parse_definitions(TYPE, TEXT[:first] + put_in + TEXT[first + length :], "ros2idl")
        except LogError:
            refused += 1
    assert count / 4 < refused < count


def test_a_dvl_that_is_described_in_idl_is_found_by_its_type(tmp_path: Path) -> None:
    members = {
        "geometry_msgs/msg/TwistStamped": "std_msgs::msg::Header header; geometry_msgs::msg::Twist twist;",
        "geometry_msgs/msg/Twist": "Vector3 linear; Vector3 angular;",
        **MEMBERS,
    }
    named = {name: structure(name, text) for name, text in members.items()}
    text = "\n".join(f"{RULE}\nIDL: {name}\n{one}" for name, one in named.items())
    types = {"/imu": "sensor_msgs/msg/Imu", "/dvl": "geometry_msgs/msg/TwistStamped"}
    path, store = tmp_path / "dive.mcap", store_with({})
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        imu = writer.register_schema(
            types["/imu"], "ros2msg", definition_text(types["/imu"]).encode()
        )
        dvl = writer.register_schema(types["/dvl"], "ros2idl", text.encode())
        ids = {
            "/imu": writer.register_channel("/imu", "cdr", imu),
            "/dvl": writer.register_channel("/dvl", "cdr", dvl),
        }
        pings = [
            (
                "/dvl",
                types["/dvl"],
                0.1 * i,
                {"header": header(0.1 * i), "twist": {"linear": xyz((1.0, 0.01 * i, 0.0))}},
            )
            for i in range(20)
        ]
        for topic, type_name, time_s, values in [*imu_messages(), *pings]:
            time_ns = START_NS + round(time_s * 1e9)
            writer.add_message(ids[topic], time_ns, serialised(store, type_name, values), time_ns)
        writer.finish()
    dive = read_dive(path, Config())
    assert dive.dvl.velocity_d is not None
    np.testing.assert_allclose(dive.dvl.velocity_d[:, 1], 0.01 * np.arange(20))
    assert "builtin_definition" not in {note.code for note in dive.notes}
