"""Every field by which a type is known, of every type that rosbags can write: the numbers that it wrote are read.

rosbags has its own definitions of the types of ROS, and its own parser of the others' texts.
"""

import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import other_bags
import pytest
from mcap.writer import Writer
from rosbag_messages import START_NS, store_with, text_of
from rosbags.typesys.store import Typestore

from insdvl_replay.logs.columns.topics import TYPES, KnownType, Types
from insdvl_replay.logs.formats.fields import find_path, split_paths
from insdvl_replay.logs.formats.readers import channel_paths, open_reader
from insdvl_replay.logs.formats.recording import open_recording

TABLES: list[Types] = [*TYPES.values()]
NOT_SHIPPED = ("dvl1000_ros/msg/DVL", "tf/msg/tfMessage")
"""Of ROS 1 alone, whose logs all have definitions."""
NAMES = sorted({name for types in TABLES for name in types if "/" in name} - {*NOT_SHIPPED})
MESSAGES = 5


def entries(name: str) -> list[KnownType]:
    return [types[name] for types in TABLES if name in types]


def made(store: Typestore, name: str, rng: np.random.Generator) -> Any:
    """Make a message with some number in every field, three elements in every list, and texts of several lengths."""
    return store.types[name](
        **{field: value(store, kind, rng) for field, kind in store.get_msgdef(name).fields}
    )


def value(store: Typestore, kind: Any, rng: np.random.Generator) -> Any:
    node, argument = int(kind[0]), kind[1]
    if node == 1:
        return primitive(argument[0], rng)
    if node == 2:
        return made(store, argument, rng)
    inner, length = argument
    values = [value(store, inner, rng) for _ in range(length or 3)]
    return (
        np.array(values, inner[1][0]) if int(inner[0]) == 1 and inner[1][0] != "string" else values
    )


def primitive(name: str, rng: np.random.Generator) -> Any:
    if name == "string":
        return "x" * int(rng.integers(0, 5))
    if name == "bool":
        return bool(rng.integers(0, 2))
    if name.startswith("float"):
        return np.dtype(name).type(rng.normal()).item()
    kind = np.iinfo({"byte": "int8", "octet": "int8", "char": "int8"}.get(name, name))
    return int(rng.integers(max(kind.min, 0), min(kind.max, 2**31 - 1)))


def numbers(store: Typestore, item: Any) -> Iterator[float]:
    """Give all numbers of a part of a message, in the order of its fields."""
    if isinstance(item, list | np.ndarray):
        for one in item:
            yield from numbers(store, one)
    elif hasattr(item, "__msgtype__"):
        for field, _ in store.get_msgdef(item.__msgtype__).fields:
            yield from numbers(store, getattr(item, field))
    elif not isinstance(item, str):
        yield float(item)


def at_path(item: Any, path: str) -> Any:
    """Follow a path through a message."""
    for number, step in enumerate(parts := path.split(".")):
        match = re.fullmatch(r"(\w+)(?:\[(\d+|\*)\])?", step)
        assert match
        item = getattr(item, match[1])
        if match[2] == "*":
            return [
                at_path(one, ".".join(parts[number + 1 :])) if parts[number + 1 :] else one
                for one in item
            ]
        item = item if match[2] is None else item[int(match[2])]
    return item


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_numbers_that_rosbags_wrote_are_read(encoding: str, tmp_path: Path) -> None:
    for name in NAMES:
        try:
            assert_numbers_are_read(name, encoding, tmp_path)
        except BaseException as error:
            error.add_note(name)
            raise


def assert_numbers_are_read(name: str, encoding: str, tmp_path: Path) -> None:
    text, rng = text_of(name), np.random.default_rng(zlib.crc32(name.encode()))
    store = store_with({name: text})
    messages = [made(store, name, rng) for _ in range(MESSAGES)]
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        channel_id = writer.register_channel(
            "/it", "cdr", writer.register_schema(name, "ros2msg", text.encode())
        )
        for i, message in enumerate(messages):
            writer.add_message(
                channel_id, START_NS + i, bytes(store.serialize_cdr(message, name)), START_NS + i
            )
        writer.finish()
    if encoding == "ros1":
        path = other_bags.ros1_mcap(tmp_path / "ros1.mcap", path.read_bytes())
    log = open_recording(path)
    [channel] = log.channels
    assert channel.encoding == encoding
    known = channel_paths(channel)
    named = {
        one
        for entry in entries(name)
        for fields in entry.fields.values()
        for one in split_paths(fields)
    }
    stamps = {entry.stamp for entry in entries(name)} | {"header.stamp"}
    lacking = {one for one in named if not find_path(one, known)}
    paths = sorted((named - lacking) | {one for one in stamps if find_path(one, known)})
    assert paths
    # A frame of the messages before PX4 1.13.
    assert lacking <= {"local_frame"}
    [block] = log.blocks({channel.id})
    columns = open_reader(channel, paths).columns(block)
    for one in paths:
        expected = [list(numbers(store, at_path(message, one))) for message in messages]
        np.testing.assert_array_equal(columns[one], expected, err_msg=one)
