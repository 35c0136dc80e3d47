"""Layouts of CDR messages, against the encoders of mcap-ros2-support and rosbags."""

import io
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.formats.definitions import parse_definitions
from insdvl_replay.logs.formats.fields import layout_for_texts, message_layout

TYPE = "pkg/msg/Everything"
TEXT = """\
uint8 A=1
bool flag
string word
float64 number
pkg/Empty empty
int16 small
float64[] numbers
byte[] bytes
string[] words
pkg/Nested[] nested
pkg/Nested[2] pair
float32[3] fixed
uint64 last
================================================================================
MSG: pkg/Empty
================================================================================
MSG: pkg/Nested
int8 level
string<=20 label
float64 value
uint16[] counts
"""
DEFINITIONS = parse_definitions(TYPE, TEXT)

words = st.text(
    st.characters(codec="utf-8", exclude_characters="\0", exclude_categories=("Cs",)), max_size=7
)
numbers = st.floats(allow_nan=False)
nested = st.fixed_dictionaries(
    {
        "level": st.integers(-128, 127),
        "label": words,
        "value": numbers,
        "counts": st.lists(st.integers(0, 65535), max_size=3),
    }
)
messages = st.fixed_dictionaries(
    {
        "flag": st.booleans(),
        "word": words,
        "number": numbers,
        "small": st.integers(-32768, 32767),
        "numbers": st.lists(numbers, max_size=3),
        "bytes": st.lists(st.integers(0, 255), max_size=5),
        "words": st.lists(words, max_size=3),
        "nested": st.lists(nested, max_size=3),
        "pair": st.lists(nested, min_size=2, max_size=2),
        "fixed": st.lists(st.floats(width=32, allow_nan=False), min_size=3, max_size=3),
        "last": st.integers(0, 2**64 - 1),
    }
)


def encoded(text: str, message: dict[str, Any]) -> bytes:
    """Serialise a message with mcap-ros2-support."""
    stream = io.BytesIO()
    writer = Writer(stream)
    schema = writer.register_msgdef(TYPE, text)
    writer.write_message("/topic", schema, message, log_time=0)
    writer.finish()
    [(_, _, record)] = make_reader(io.BytesIO(stream.getvalue())).iter_messages()
    return bytes(record.data)


def flat(path: str, value: Any) -> dict[str, Any]:
    """Name the values of a nested message as layouts do."""
    if isinstance(value, dict):
        prefix = f"{path}." if path else ""
        items = [flat(f"{prefix}{name}", inner) for name, inner in value.items()]
        return {name: inner for item in items for name, inner in item.items()}
    if isinstance(value, list) and path.rpartition(".")[2] in ("words", "nested", "pair"):
        items = [flat(f"{path}[{i}]", inner) for i, inner in enumerate(value)]
        return {name: inner for item in items for name, inner in item.items()}
    return {path: value.encode() if isinstance(value, str) else value}


@given(messages)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_layout_finds_and_fills_every_field_as_mcap_ros2_support(message: dict[str, Any]) -> None:
    data = encoded(TEXT, message)
    layout = message_layout(DEFINITIONS, TYPE, data)
    lengths = layout.lengths
    assert layout.size == layout.dtype.itemsize == len(data)
    assert [
        int.from_bytes(data[start : start + 4], "little") for start in layout.length_offsets
    ] == list(lengths)
    [row] = np.frombuffer(data, layout.dtype)
    values = flat("", message) | {"empty.structure_needs_at_least_one_member": 0}
    assert set(layout.dtype.names or ()) == set(values)
    rows = layout.new_messages(3)
    for path, value in values.items():
        np.testing.assert_array_equal(row[path], value, err_msg=path)
        rows[path] = value
    assert rows.tobytes() == 3 * data


def test_an_empty_sequence_is_not_aligned_as_rosbags_writes_it() -> None:
    text = "float64[] values\nuint8 between\nstring word\nfloat32 number\n"
    store, definitions = get_typestore(Stores.EMPTY), parse_definitions(TYPE, text)
    store.register(get_types_from_msg(text, TYPE))
    for values in ([], [1.5, -2.0]):
        message = store.types[TYPE](values=np.array(values), between=9, word="abc", number=0.25)
        data = bytes(store.serialize_cdr(message, TYPE))
        layout = message_layout(definitions, TYPE, data)
        [row] = np.frombuffer(data, layout.dtype, count=1)
        assert (row["between"], row["word"], row["number"], row["values"].tolist()) == (
            9,
            b"abc",
            0.25,
            values,
        )


def test_layout_for_texts_makes_room_for_them() -> None:
    definitions = parse_definitions(TYPE, "string first\nstring second\nuint8 last")
    layout = layout_for_texts(definitions, TYPE, {"second": b"abc"})
    assert layout.lengths == (1, 4)


def test_cut_messages_are_refused() -> None:
    message = {"word": "abc", "numbers": [1.0], "words": ["a"], "nested": [{}], "pair": [{}, {}]}
    data = encoded(TEXT, message)
    for length in range(len(data)):
        with pytest.raises(LogError, match=r"shorter than its schema|starts with bytes"):
            message_layout(DEFINITIONS, TYPE, data[:length])


def test_other_encodings_are_refused() -> None:
    for header in (b"\x00\x00", b"\x01\x00"):
        with pytest.raises(LogError, match=header.hex(" ")):
            message_layout(DEFINITIONS, TYPE, header + encoded(TEXT, {})[2:])


def test_wide_strings_are_refused() -> None:
    definitions = parse_definitions(TYPE, "wstring w")
    with pytest.raises(LogError, match="wstring"):
        layout_for_texts(definitions, TYPE, {})
