"""The fields of messages: one language of paths for every encoding, and where the fields of a message of ROS are.

``imu.gyroscope`` walks down, ``beams[2]`` takes one element of a list and ``beams[*]`` all of them. A path that ends
at a structure means all numbers in it, in their order; paths joined by commas are side by side.

All messages of a type whose strings and sequences have the same lengths share one layout, so that thousands of them
are read or written as the rows of one structured array. ROS 2 has XCDR version 1, little-endian: every primitive is
aligned to its own size, counted from behind the four bytes of the encapsulation header. ROS 1 has no header, no
alignment, and no zero byte behind its strings. Sources: OMG, "DDS Interoperability Wire Protocol", version 2.5, section
10, and "Extensible and Dynamic Topic Types for DDS", version 1.3, section 7.4.1; `serialization.h` of roscpp_core,
https://github.com/ros/roscpp_core/tree/noetic-devel.
"""

import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Array
from insdvl_replay.core.errors import LogError, most_like, nearest
from insdvl_replay.logs.formats.definitions import (
    LEAVE_OUT,
    PRIMITIVES,
    Definitions,
    full_name,
)
from insdvl_replay.logs.formats.log_file import Block, LogChannel

# By path, (k, n): a row per message; int64 where all are whole, else float64.
Columns = dict[str, Array]
Kinds = Mapping[str, str]  # every path that a type knows, with the type of what is there
# Key of the messages' numbers in columns, where a message may give several rows, or none.
ROWS: Final = ""
TABLE: Final = "table"  # encoding of the rows of a table
ROW: Final = "row number"  # path of the number of a row in its table, from 0
NUMBER: Final = "number"  # kinds of what is decoded message by message
TEXT: Final = "text"
TEXTS: Final = (TEXT, "string", "wstring")
_LISTED: Final = 24  # fields that an error lists at most


@dataclass(frozen=True)
class Element:
    """Which elements of a list in the messages count: those with the texts in the fields; none where no texts are."""

    list_name: str
    fields: tuple[str, ...]
    texts: tuple[str, ...]


class FieldReader(Protocol):
    """Reads some fields of all messages of one channel."""

    @property
    def known(self) -> Kinds:
        """Every path that there is; where no schema tells, those of the messages read so far."""

    def columns(self, block: Block) -> Columns:
        """Return the fields of all messages of a block; what a message lacks is NaN."""


def split_paths(path: str) -> tuple[str, ...]:
    """Split paths that are side by side, such as ``gyro_x, gyro_y, gyro_z``."""
    return tuple(part.strip() for part in path.split(","))


def find_path(path: str, known: Kinds) -> str | None:
    """Return the type of what is at a path, or None where the path is not known."""
    return known.get(re.sub(r"\[\d+\]", "[*]", path))


def check_path(path: str, known: Kinds, type_name: str) -> None:
    """Refuse a path that a type does not know, or at which there are no numbers."""
    kind = find_path(path, known)
    if kind is None:
        meant = nearest(path, known)
        hint = fields_hint(known, path)
        if meant:
            hint = f"the nearest one is '{meant}'; {hint}"
        raise LogError(f"{type_name} has no field '{path}'", hint)
    if kind in TEXTS:
        hint = f"use a field with numbers; {fields_hint(known, path)}"
        raise LogError(f"field '{path}' of {type_name} is text", hint)


def fields_hint(known: Kinds, path: str) -> str:
    """List the fields with numbers, for a hint."""
    numbers = {}
    for name, kind in known.items():
        if kind not in TEXTS and f"{name}[*]" not in known:
            numbers[name] = kind
    if not numbers:
        return "the type has no fields with numbers"
    near = set(most_like(path, numbers, _LISTED))
    shown = [name for name in numbers if name in near]
    shown.sort(key=lambda name: len(re.findall(r"[.\[]", name)))  # the shortest paths first
    listed = ", ".join(f"{name} ({numbers[name]})" for name in shown)
    if len(numbers) > len(near):
        listed += f" and {len(numbers) - len(near)} more"
    return f'its fields are {listed}; for several fields: "p, q, r"'


# Of each encoding of messages that can be read, the encodings of its schemas.
ENCODINGS: Final = {
    "cdr": ("ros2msg", "ros2idl", ""),
    "ros1": ("ros1msg",),
    "protobuf": ("protobuf",),
    "json": ("jsonschema", ""),
}


def check_encoding(channel: LogChannel) -> None:
    """Refuse a channel whose messages cannot be read."""
    if channel.encoding == TABLE:
        return
    if channel.schema_encoding not in ENCODINGS.get(channel.encoding, ()):
        known = ", ".join(f"{name} with {schemas[0]}" for name, schemas in ENCODINGS.items())
        raise LogError(
            f"messages on '{channel.topic}' are encoded as {channel.encoding or 'nothing'} with "
            f"{channel.schema_encoding or 'no'} schema; only {known} can be read",
            "use another topic, or record the messages in one of these encodings",
        )


# --- Messages of ROS 2 and ROS 1.

ENCAPSULATION: Final = b"\x00\x01\x00\x00"  # begins each little-endian XCDR1 message
MOST_PLACES: Final = (
    1 << 18
)  # fields and structures of a message, each element of a list of structures for itself
_SIZES: Final = {name: np.dtype(format_).itemsize for name, format_ in PRIMITIVES.items()}


@dataclass(frozen=True)
class Layout:
    """Where the fields of a message are."""

    dtype: np.dtype[
        np.void
    ]  # the whole message; fields are named by their paths, such as ``beam_unit_vec[0].x``
    length_offsets: tuple[int, ...]  # of the length word of each string and sequence, in order
    lengths: tuple[
        int, ...
    ]  # what these words hold; in CDR a string's length counts its final zero byte

    @property
    def size(self) -> int:
        """Bytes of the message."""
        return self.dtype.itemsize

    def new_messages(self, count: int) -> NDArray[np.void]:
        """Return CDR messages, (count,), whose header and length words are set and whose fields are zero."""
        template = np.zeros(self.size, np.uint8)
        template[:4] = np.frombuffer(ENCAPSULATION, np.uint8)
        for offset, length in zip(self.length_offsets, self.lengths, strict=True):
            template[offset : offset + 4] = np.frombuffer(length.to_bytes(4, "little"), np.uint8)
        return np.tile(template, (count, 1)).view(self.dtype)[:, 0]


def layout_for_texts(
    definitions: Definitions, type_name: str, texts: Mapping[str, bytes]
) -> Layout:
    """Lay out a message in CDR that has to hold the given strings, and no sequences."""
    return _layout_of(definitions, type_name, lambda path, _: len(texts.get(path, b"")) + 1)


def message_layout(
    definitions: Definitions, type_name: str, message: bytes | memoryview, *, is_cdr: bool = True
) -> Layout:
    """Lay out a message as it is."""
    data = bytes(message)
    if is_cdr and data[:2] != ENCAPSULATION[:2]:
        raise LogError(
            f"{type_name}: a message starts with bytes '{data[:2].hex(' ')}' where little-endian CDR has '00 01'",
            "big-endian, parameter-list and XCDR2 messages cannot be read; record with the default middleware",
        )

    def length_at(_: str, offset: int) -> int:
        return int.from_bytes(data[offset : offset + 4], "little")

    return _layout_of(definitions, type_name, length_at, is_cdr=is_cdr, room=len(data))


def _layout_of(
    definitions: Definitions,
    type_name: str,
    length_at: Callable[
        [str, int], int
    ],  # of the string or sequence at a path, whose length word is at an offset
    *,
    is_cdr: bool = True,
    room: int = sys.maxsize,  # bytes of the message
) -> Layout:
    """Pass over the fields of a message in the order of the bytes."""
    offset = len(ENCAPSULATION) if is_cdr else 0
    passed = 0
    names: list[str] = []
    formats: list[Any] = []
    offsets: list[int] = []
    length_offsets: list[int] = []
    lengths: list[int] = []

    def advance(size: int, alignment: int) -> int:
        """Skip a value and return where it starts; refuse sizes that no message has."""
        nonlocal offset, passed
        passed += 1
        if passed > MOST_PLACES:
            text = f"{type_name}: a message holds more than {MOST_PLACES} fields, with those in its lists"
            raise LogError(text, LEAVE_OUT)
        start = offset + (-(offset - len(ENCAPSULATION)) % alignment if is_cdr else 0)
        offset = start + size
        require(offset)
        return start

    def require(end: int) -> None:
        if end > room:
            raise LogError(
                f"{type_name}: a message of {room} bytes is shorter than its schema and lengths say",
                "the log is damaged, or its schema does not match its messages",
            )

    def length_word(path: str) -> int:
        length_offsets.append(advance(4, 4))
        lengths.append(length_at(path, length_offsets[-1]))
        require(offset + lengths[-1])
        return lengths[-1]

    def place(path: str, format_: Any, size: int, alignment: int) -> None:
        offsets.append(advance(size, alignment))
        names.append(path)
        formats.append(format_)

    def value(path: str, kind: str) -> None:
        if kind in definitions:
            structure(f"{path}.", kind)
        elif kind == "string":
            length = length_word(path)
            place(path, f"S{length}", length, 1)
        elif kind in PRIMITIVES:
            place(path, PRIMITIVES[kind], _SIZES[kind], _SIZES[kind])
        else:
            raise LogError(f"field {path} is of type {kind}, which is not supported", LEAVE_OUT)

    def structure(prefix: str, kind: str) -> None:
        advance(0, 1)  # counts structures, which in ROS 1 may have no bytes
        for field in definitions[kind]:
            path = prefix + field.name
            if field.kind == "single":
                value(path, field.type_name)
                continue
            number = field.length if field.kind == "array" else length_word(path)
            if field.type_name in PRIMITIVES:
                size = _SIZES[field.type_name]
                # None at all are not aligned.
                place(
                    path,
                    (PRIMITIVES[field.type_name], (number,)),
                    number * size,
                    size if number else 1,
                )
            else:
                for i in range(number):
                    value(f"{path}[{i}]", field.type_name)

    structure("", full_name(type_name))
    columns: Any = {"names": names, "formats": formats, "offsets": offsets, "itemsize": offset}
    return Layout(np.dtype(columns), tuple(length_offsets), tuple(lengths))
