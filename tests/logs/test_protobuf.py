"""Columns from protobuf bytes agree with what the official library serialised, whatever the message lacks."""

from typing import Any

import numpy as np
import pytest
from blocks import block_of
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.formats.decoded import protobuf_reader

TYPE = "test.Ping"
OPTIONAL, REPEATED = FieldDescriptorProto.LABEL_OPTIONAL, FieldDescriptorProto.LABEL_REPEATED


def add(
    message: DescriptorProto,
    name: str,
    kind: str,
    label: int = OPTIONAL,
    type_name: str | None = None,
) -> None:
    message.field.add(
        name=name,
        number=len(message.field) + 1,
        label=label,
        type=getattr(FieldDescriptorProto, f"TYPE_{kind}"),
        type_name=type_name,
    )


def file() -> FileDescriptorProto:
    described = FileDescriptorProto(name="test.proto", package="test", syntax="proto3")
    beam = described.message_type.add(name="Beam")
    add(beam, "id", "INT32")
    add(beam, "velocity", "FLOAT")
    vector = described.message_type.add(name="Vector")
    for axis in "xyz":
        add(vector, axis, "DOUBLE")
    ping = described.message_type.add(name="Ping")
    add(ping, "stamp_us", "UINT64")
    add(ping, "label", "STRING")
    add(ping, "velocity", "MESSAGE", type_name=".test.Vector")
    add(ping, "beams", "MESSAGE", REPEATED, ".test.Beam")
    add(ping, "powers", "DOUBLE", REPEATED)
    add(ping, "good", "BOOL")
    add(ping, "again", "MESSAGE", type_name=".test.Ping")
    return described


DESCRIPTORS = FileDescriptorSet(file=[file()]).SerializeToString()
POOL = DescriptorPool()
POOL.Add(file())
Ping: Any = GetMessageClass(POOL.FindMessageTypeByName(TYPE))


def columns(pings: list[Any], *paths: str) -> dict[str, Any]:
    reader = protobuf_reader(TYPE, DESCRIPTORS, paths)
    return reader.columns(block_of([ping.SerializeToString() for ping in pings]))


def random_pings(count: int, beams: list[int]) -> list[Any]:
    rng = np.random.default_rng(3)
    return [
        Ping(
            stamp_us=int(rng.integers(2**62)),
            label="x" * i,
            velocity={axis: rng.normal() for axis in "xyz"},
            beams=[{"id": j, "velocity": rng.normal()} for j in range(beams[i % len(beams)])],
            powers=rng.normal(size=2),
            good=bool(rng.integers(2)),
        )
        for i in range(count)
    ]


def test_columns_equal_what_was_serialised() -> None:
    pings = random_pings(40, [4])
    found = columns(
        pings,
        "stamp_us",
        "velocity",
        "beams[*].velocity",
        "beams[2].velocity",
        "powers[1]",
        "good",
    )
    np.testing.assert_array_equal(found["stamp_us"][:, 0], [ping.stamp_us for ping in pings])
    np.testing.assert_array_equal(
        found["velocity"], [[getattr(p.velocity, axis) for axis in "xyz"] for p in pings]
    )
    beams = np.array([[beam.velocity for beam in ping.beams] for ping in pings])
    np.testing.assert_array_equal(found["beams[*].velocity"], beams)
    np.testing.assert_array_equal(found["beams[2].velocity"], beams[:, 2:3])
    np.testing.assert_array_equal(found["powers[1]"][:, 0], [ping.powers[1] for ping in pings])
    np.testing.assert_array_equal(found["good"][:, 0], [ping.good for ping in pings])
    assert found["stamp_us"].dtype == found["good"].dtype == np.int64


def test_structure_means_all_numbers_in_it() -> None:
    pings = random_pings(3, [2])
    expected = [
        [number for beam in ping.beams for number in (beam.id, beam.velocity)] for ping in pings
    ]
    np.testing.assert_array_equal(columns(pings, "beams")["beams"], expected)


def test_what_is_absent_is_nan_and_what_is_zero_is_zero() -> None:
    pings = [*random_pings(1, [3]), Ping(), Ping(velocity={})]
    found = columns(pings, "velocity", "velocity.y", "beams[*].velocity", "stamp_us")
    np.testing.assert_array_equal(found["velocity"][1:], [[np.nan] * 3, [0.0] * 3])
    np.testing.assert_array_equal(found["velocity.y"][1:, 0], [np.nan, 0.0])
    assert np.isnan(found["beams[*].velocity"][1:]).all()
    np.testing.assert_array_equal(found["stamp_us"][1:, 0], [0, 0])


def test_unknown_path_names_the_nearest_field_and_text_is_no_number() -> None:
    for path in ("velocities", "again.velocity", "beams.velocity"):
        with pytest.raises(LogError, match=rf"test\.Ping has no field '{path}'") as raised:
            columns([], path)
        assert "velocity" in raised.value.hint
    with pytest.raises(LogError, match=r"'label' of test\.Ping is text"):
        columns([], "label")


def test_message_that_is_none_is_refused() -> None:
    reader = protobuf_reader(TYPE, DESCRIPTORS, ["stamp_us"])
    with pytest.raises(LogError, match=r"a message of 3 bytes is no test\.Ping"):
        reader.columns(block_of([b"\x0a\xff\xff"]))


def test_schema_that_is_none_or_lacks_a_file_is_refused() -> None:
    broken = file()
    broken.dependency.append("other.proto")
    sets = [
        FileDescriptorSet(file=[one]).SerializeToString()
        for one in (FileDescriptorProto(name="a"), broken)
    ]
    for schema in (b"", b"\xff\xff", *sets):
        with pytest.raises(
            LogError, match=r"the schema of test\.Ping is no complete protobuf FileDescriptorSet"
        ):
            protobuf_reader(TYPE, schema, ["stamp_us"])
