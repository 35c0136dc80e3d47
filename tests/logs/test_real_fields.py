"""Every field of every real log, whatever its encoding, equals what the official decoders give."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoders
from mcap_ros2.decoder import DecoderFactory as RosDecoders

from insdvl_replay.logs.formats.definitions import PRIMITIVES
from insdvl_replay.logs.formats.fields import NUMBER, Columns
from insdvl_replay.logs.formats.log_file import Block, LogChannel
from insdvl_replay.logs.formats.readers import channel_paths, open_reader
from insdvl_replay.logs.formats.recording import open_recording

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
LOGS = sorted(
    path for path in DATA.rglob("*.mcap") if not {"mcap_conformance", "ros1"} & set(path.parts)
)
ONE_OF_EACH = ("snapir_01", "run_1", "car_left_back_json", "no_messages", "evo_nav2_turtlebot")
"""A log of each encoding and program."""

pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason="the real logs in ../shared/data are not here"
)


def number_paths(channel: LogChannel) -> list[str]:
    known = channel_paths(channel)
    numbers = [path for path, kind in known.items() if kind == NUMBER or kind in PRIMITIVES]
    return [path for path in numbers if f"{path}[*]" not in known]


def official_decoder(channel: LogChannel) -> Callable[[bytes], Any]:
    if channel.encoding == "json":
        return json.loads
    factory = ProtobufDecoders() if channel.encoding == "protobuf" else RosDecoders()
    schema = Schema(1, channel.schema_data, channel.schema_encoding, channel.type_name)
    decode = factory.decoder_for(channel.encoding, schema)
    assert decode
    return decode


def numbers_of(value: Any, path: str) -> list[float]:
    """Follow a path through a decoded message, the slow and obvious way."""
    if not path:
        return [value]
    name, _, rest = path.partition(".")
    if not name.endswith("[*]"):
        inner = value[name] if isinstance(value, dict) else getattr(value, name)
        absent = (
            hasattr(value, "HasField")
            and hasattr(inner, "DESCRIPTOR")
            and not value.HasField(name)
        )
        return [np.nan] if absent else numbers_of(inner, rest)
    items = value[name[:-3]] if isinstance(value, dict) else getattr(value, name[:-3])
    return [number for item in items for number in numbers_of(item, rest)]


def compare(block: Block, columns: Columns, decode: Callable[[bytes], Any], every: int) -> int:
    compared = 0
    for row in range(0, block.offsets.size, every):
        start = int(block.offsets[row])
        message = decode(bytes(block.buffer[start : start + int(block.sizes[row])]))
        for path, column in columns.items():
            expected = numbers_of(message, path)
            np.testing.assert_array_equal(column[row, : len(expected)], expected, err_msg=path)
            assert np.isnan(column[row, len(expected) :].astype(float)).all()
            compared += len(expected)
    return compared


@pytest.mark.parametrize(
    ("path", "every"),
    [
        *(
            pytest.param(path, 5, marks=pytest.mark.nightly, id=f"{path.stem}-many")
            for path in LOGS
        ),
        *(
            pytest.param(path, 197, id=f"{path.stem}-few")
            for path in LOGS
            if path.stem in ONE_OF_EACH
        ),
    ],
)
def test_fields_equal_those_of_the_official_decoders(path: Path, every: int) -> None:
    log = open_recording(path)
    compared = 0
    for channel in (channel for channel in log.channels if channel.messages):
        if "_Event" in channel.type_name:
            continue  # the official decoder cannot read the schemas of recorded services either
        paths = number_paths(channel)
        reader, decode = open_reader(channel, paths), official_decoder(channel)
        for block in log.blocks({channel.id}):
            compared += compare(block, reader.columns(block), decode, every)
    assert compared or path.stem == "no_messages"
