"""Columns from CDR bytes agree with what rosbags serialises, whatever the layout of the messages."""

import re
import struct

import numpy as np
import pytest
from blocks import block_of
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.formats.definitions import parse_definitions
from insdvl_replay.logs.formats.readers import BinaryReader

TYPE = "test_msgs/msg/Ping"
MAIN = "string label\nuint8 mode\ntest_msgs/Beam[] beams\nint64 stamp\nfloat32[3] fixed\nfloat64[] free\nbool good\n"
BEAM = "int8 id\nfloat64 velocity\n"
TEXT = f"{MAIN}{'=' * 80}\nMSG: test_msgs/Beam\n{BEAM}"


def serialised(pings: list[dict]) -> list[bytes]:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(BEAM, "test_msgs/msg/Beam") | get_types_from_msg(MAIN, TYPE))
    ping_type, beam_type = store.types[TYPE], store.types["test_msgs/msg/Beam"]
    return [
        bytes(
            store.serialize_cdr(
                ping_type(
                    label=ping["label"],
                    mode=ping["mode"],
                    beams=[
                        beam_type(id=i, velocity=velocity)
                        for i, velocity in enumerate(ping["beams"])
                    ],
                    stamp=ping["stamp"],
                    fixed=np.array(ping["fixed"], np.float32),
                    free=np.array(ping["free"], np.float64),
                    good=ping["good"],
                ),
                TYPE,
            )
        )
        for ping in pings
    ]


def reader(*paths: str) -> BinaryReader:
    return BinaryReader(parse_definitions(TYPE, TEXT), TYPE, paths)


def random_pings(count: int, labels: list[str], beams: list[int]) -> list[dict]:
    rng = np.random.default_rng(3)
    return [
        {
            "label": labels[i % len(labels)],
            "mode": int(rng.integers(256)),
            "beams": rng.normal(size=beams[i % len(beams)]).tolist(),
            "stamp": int(rng.integers(2**62)),
            "fixed": rng.normal(size=3).astype(np.float32).tolist(),
            "free": rng.normal(size=2).tolist(),
            "good": bool(rng.integers(2)),
        }
        for i in range(count)
    ]


def test_columns_equal_what_was_serialised() -> None:
    pings = random_pings(50, ["", "a", "abcdefgh", "xyz"], [4])
    paths = [
        "mode",
        "beams[*].velocity",
        "beams[2].velocity",
        "stamp",
        "fixed",
        "fixed[1]",
        "free[*]",
        "good",
    ]
    columns = reader(*paths).columns(block_of(serialised(pings)))
    beams = np.array([ping["beams"] for ping in pings])
    np.testing.assert_array_equal(columns["beams[*].velocity"], beams)
    np.testing.assert_array_equal(columns["beams[2].velocity"], beams[:, 2:3])
    np.testing.assert_array_equal(columns["fixed"], [ping["fixed"] for ping in pings])
    np.testing.assert_array_equal(columns["fixed[1]"][:, 0], [ping["fixed"][1] for ping in pings])
    np.testing.assert_array_equal(columns["free[*]"], [ping["free"] for ping in pings])
    for path in ("mode", "stamp", "good"):
        assert columns[path].dtype == np.int64
        np.testing.assert_array_equal(columns[path][:, 0], [ping[path] for ping in pings])


def test_shorter_sequences_are_filled_with_nan() -> None:
    pings = random_pings(9, ["dvl"], [4, 0, 3])
    columns = reader("beams[*].velocity").columns(block_of(serialised(pings)))["beams[*].velocity"]
    expected = [ping["beams"] + [np.nan] * (4 - len(ping["beams"])) for ping in pings]
    np.testing.assert_array_equal(columns, expected)


def test_structure_means_all_numbers_in_it() -> None:
    pings = random_pings(3, ["dvl"], [2])
    columns = reader("beams").columns(block_of(serialised(pings)))["beams"]
    np.testing.assert_array_equal(columns[:, [1, 3]], [ping["beams"] for ping in pings])
    np.testing.assert_array_equal(columns[:, [0, 2]], [[0, 1]] * 3)


def test_unknown_path_names_the_nearest_field_and_text_is_no_number() -> None:
    for path in ("beams[*].velocit", "beams.velocity"):
        with pytest.raises(LogError, match=re.escape(f"{TYPE} has no field '{path}'")) as raised:
            reader(path)
        assert "beams[*].velocity" in raised.value.hint
    with pytest.raises(LogError, match="'label' of test_msgs/msg/Ping is text"):
        reader("label")


def test_other_encapsulations_are_refused_by_name() -> None:
    message = bytearray(serialised(random_pings(1, ["dvl"], [4]))[0])
    for kind, name in ((0, "big-endian CDR"), (7, "XCDR2"), (99, "no CDR")):
        message[1] = kind
        with pytest.raises(LogError, match=f"1 of 1 messages are {name} "):
            reader("mode").columns(block_of([bytes(message)]))


def test_message_that_does_not_fit_its_schema_is_refused() -> None:
    first, second = serialised(random_pings(2, ["dvl"], [4]))
    for wrong in (second[:3], second[:-9], second + bytes(4)):
        with pytest.raises(LogError, match="a message of"):
            reader("mode").columns(block_of([first, wrong]))


def test_numbers_of_every_kind_are_read_as_by_struct_wherever_they_are() -> None:
    names = [
        "int8",
        "uint8",
        "byte",
        "char",
        "int16",
        "uint16",
        "int32",
        "uint32",
        "int64",
        "float32",
        "float64",
    ]
    kinds = list(zip(names, "bBBBhHiIqfd", strict=True))
    text = "".join(f"{name} {name}_near\n{name}[40] {name}_row\n" for name, _ in kinds)
    paths = [f"{name}_{end}" for name, _ in kinds for end in ("near", "row", "row[7]")]
    content = np.random.default_rng(5).integers(0, 256, 4000, np.uint8).tobytes()
    place, expected = 0, []
    for _, letter in kinds:
        size = struct.calcsize(letter)
        place += -place % size
        values = struct.unpack_from(f"<41{letter}", content, place)
        expected += [[values[0]], list(values[1:]), [values[8]]]
        place += 41 * size
    columns = BinaryReader(parse_definitions(TYPE, text), TYPE, paths).columns(
        block_of([b"\0\1\0\0" + content[:place]] * 3)
    )
    for path, values in zip(paths, expected, strict=True):
        assert columns[path].tolist() == [values] * 3
        assert columns[path].dtype == (np.float64 if path.startswith("float") else np.int64)


def test_a_bool_of_another_byte_is_one_and_an_empty_sequence_of_floats_is_none() -> None:
    messages = serialised(random_pings(2, ["a"], [1]))
    broken = [message[:-1] + b"\x04" for message in messages]
    columns = reader("good", "free").columns(block_of(broken))
    assert columns["good"].tolist() == [[1], [1]]
    assert columns["good"].dtype == np.int64
    empty = reader("free").columns(
        block_of(serialised([{**random_pings(1, ["a"], [1])[0], "free": []}]))
    )
    assert empty["free"].shape == (1, 0)
    assert empty["free"].dtype == np.float64
