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
# Fields and structures of a message, each element of a list of structures for itself.
MOST_PLACES: Final = 1 << 18
_SIZES: Final = {name: np.dtype(format_).itemsize for name, format_ in PRIMITIVES.items()}


@dataclass(frozen=True)
class Layout:
    """Where the fields of a message are."""

    # The whole message; fields are named by their paths, such as ``beam_unit_vec[0].x``.
    dtype: np.dtype[np.void]
    length_offsets: tuple[int, ...]  # of the length word of each string and sequence, in order
    # What these words hold; in CDR a string's length counts its final zero byte.
    lengths: tuple[int, ...]

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

    def length_at(path: str, _: int) -> int:
        return len(texts.get(path, b"")) + 1

    return _Passage(definitions, type_name, length_at).layout()


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

    passage = _Passage(definitions, type_name, length_at, is_cdr=is_cdr, room=len(data))
    return passage.layout()


class _Passage:
    """Passes over the fields of a message in the order of the bytes."""

    def __init__(
        self,
        definitions: Definitions,
        type_name: str,
        # Of the string or sequence at a path, whose length word is at an offset.
        length_at: Callable[[str, int], int],
        *,
        is_cdr: bool = True,
        room: int = sys.maxsize,  # bytes of the message
    ) -> None:
        self._definitions = definitions
        self._type_name = type_name
        self._length_at = length_at
        self._is_cdr = is_cdr
        self._room = room
        self._offset = len(ENCAPSULATION) if is_cdr else 0
        self._passed = 0
        self._names: list[str] = []
        self._formats: list[Any] = []
        self._offsets: list[int] = []
        self._length_offsets: list[int] = []
        self._lengths: list[int] = []

    def layout(self) -> Layout:
        """Pass over all fields and return where they are."""
        self._structure("", full_name(self._type_name))
        columns: Any = {
            "names": self._names,
            "formats": self._formats,
            "offsets": self._offsets,
            "itemsize": self._offset,
        }
        return Layout(np.dtype(columns), tuple(self._length_offsets), tuple(self._lengths))

    def _structure(self, prefix: str, kind: str) -> None:
        self._advance(0, 1)  # counts structures, which in ROS 1 may have no bytes
        for field in self._definitions[kind]:
            path = prefix + field.name
            if field.kind == "single":
                self._value(path, field.type_name)
                continue
            number = field.length if field.kind == "array" else self._length_word(path)
            if field.type_name in PRIMITIVES:
                size = _SIZES[field.type_name]
                format_ = (PRIMITIVES[field.type_name], (number,))
                # None at all are not aligned.
                self._place(path, format_, number * size, size if number else 1)
            else:
                for i in range(number):
                    self._value(f"{path}[{i}]", field.type_name)

    def _value(self, path: str, kind: str) -> None:
        if kind in self._definitions:
            self._structure(f"{path}.", kind)
        elif kind == "string":
            length = self._length_word(path)
            self._place(path, f"S{length}", length, 1)
        elif kind in PRIMITIVES:
            self._place(path, PRIMITIVES[kind], _SIZES[kind], _SIZES[kind])
        else:
            raise LogError(f"field {path} is of type {kind}, which is not supported", LEAVE_OUT)

    def _length_word(self, path: str) -> int:
        place = self._advance(4, 4)
        length = self._length_at(path, place)
        self._length_offsets.append(place)
        self._lengths.append(length)
        self._require(self._offset + length)
        return length

    def _place(self, path: str, format_: Any, size: int, alignment: int) -> None:
        self._offsets.append(self._advance(size, alignment))
        self._names.append(path)
        self._formats.append(format_)

    def _advance(self, size: int, alignment: int) -> int:
        """Skip a value and return where it starts; refuse sizes that no message has."""
        self._passed += 1
        if self._passed > MOST_PLACES:
            text = f"{self._type_name}: a message holds more than {MOST_PLACES} fields, with those in its lists"
            raise LogError(text, LEAVE_OUT)
        start = self._offset
        if self._is_cdr:
            start += -(start - len(ENCAPSULATION)) % alignment
        self._offset = start + size
        self._require(self._offset)
        return start

    def _require(self, end: int) -> None:
        if end > self._room:
            raise LogError(
                f"{self._type_name}: a message of {self._room} bytes is shorter than its schema and lengths say",
                "the log is damaged, or its schema does not match its messages",
            )
