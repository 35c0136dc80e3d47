"""Messages of ROS 2 and ROS 1 as numpy: where each field of a serialised message stands.

All messages of a type whose strings and sequences have the same lengths share one layout, so that thousands of them
are read or written as the rows of one structured array.

ROS 2 has XCDR version 1, little-endian: every primitive is aligned to its own size, counted from behind the four bytes
of the encapsulation header. Source: OMG, "DDS Interoperability Wire Protocol", version 2.5, section 10, and "Extensible
and Dynamic Topic Types for DDS", version 1.3, section 7.4.1. ROS 1 has no header, no alignment, and no zero byte behind
its strings. Source: `serialization.h` of roscpp_core, https://github.com/ros/roscpp_core/tree/noetic-devel.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.encoding.ros2msg import PRIMITIVES, Definition, Field, full_name

ENCAPSULATION: Final = b"\x00\x01\x00\x00"
"""The header of a little-endian XCDR1 message."""

MOST_PLACES: Final = 1 << 18
"""Fields and structures that a message may hold, each element of a list of structures for itself."""
_SIZES: Final = {name: np.dtype(format_).itemsize for name, format_ in PRIMITIVES.items()}


@dataclass(frozen=True)
class Wire:
    """How an encoding puts the fields of a message one behind the other.

    Attributes
    ----------
    head : bytes
        What begins every message.
    is_aligned : bool
        Whether a primitive stands at a multiple of its own size, counted from behind the head.
    most_padding : int
        Bytes that may follow the last field.
    """

    head: bytes
    is_aligned: bool
    most_padding: int


CDR: Final = Wire(ENCAPSULATION, is_aligned=True, most_padding=3)
ROS1: Final = Wire(b"", is_aligned=False, most_padding=0)


@dataclass(frozen=True)
class Layout:
    """Where the fields of a message stand.

    Attributes
    ----------
    dtype : numpy.dtype
        The whole message with what begins it, as one flat structure. Fields are named by their paths, such as
        ``header.stamp.sec`` or ``beam_unit_vec[0].x``; arrays and sequences of primitives are sub-arrays.
    size : int
        Bytes of the message.
    length_offsets : tuple of int
        Offset of the length word of each string and sequence, in order.
    lengths : tuple of int
        What these words hold; in CDR a string's length counts its final zero byte.
    """

    dtype: np.dtype[np.void]
    size: int
    length_offsets: tuple[int, ...]
    lengths: tuple[int, ...]

    def new_messages(self, count: int) -> NDArray[np.void]:
        """Make messages, shape (count,), whose header and length words are set and whose fields are zero."""
        template = np.zeros(self.size, np.uint8)
        template[:4] = np.frombuffer(ENCAPSULATION, np.uint8)
        for offset, length in zip(self.length_offsets, self.lengths, strict=True):
            template[offset : offset + 4] = np.frombuffer(length.to_bytes(4, "little"), np.uint8)
        return np.tile(template, (count, 1)).view(self.dtype)[:, 0]


def layout_of(
    definitions: Mapping[str, Definition], type_name: str, lengths: Sequence[int], wire: Wire = CDR
) -> Layout:
    """Lay out a message whose strings and sequences have the given lengths."""
    remaining = list(reversed(lengths))

    def next_length(path: str) -> int:
        if not remaining:
            raise ValueError(f"{type_name} has more strings and sequences than the {len(lengths)} lengths given")
        return remaining.pop()

    walk = _FieldWalk(definitions, next_length, wire)
    walk.message("", full_name(type_name))
    if remaining:
        raise ValueError(f"{type_name} has fewer strings and sequences than the {len(lengths)} lengths given")
    return walk.layout()


def layout_for_texts(definitions: Mapping[str, Definition], type_name: str, texts: Mapping[str, bytes]) -> Layout:
    """Lay out a message in CDR that has to hold the given strings, and no sequences."""
    walk = _FieldWalk(definitions, lambda path: len(texts.get(path, b"")) + 1, CDR)
    walk.message("", full_name(type_name))
    return walk.layout()


def dynamic_lengths(
    definitions: Mapping[str, Definition], type_name: str, message: bytes | memoryview, wire: Wire = CDR
) -> tuple[int, ...]:
    """Read the lengths of the strings and sequences of one message."""
    data = bytes(message)
    if data[:2] != wire.head[:2] and wire.head:
        raise LogError(
            f"{type_name}: a message starts with bytes '{data[:2].hex(' ')}' where little-endian CDR has '00 01'",
            "big-endian, parameter-list and XCDR2 messages cannot be read; record with the default middleware",
        )

    def next_length(path: str) -> int:
        length = int.from_bytes(data[walk.offset : walk.offset + 4], "little")
        walk.require(walk.offset + 4 + length)
        return length

    walk = _FieldWalk(definitions, next_length, wire, type_name, len(data))
    walk.message("", full_name(type_name))
    return tuple(walk.lengths)


class _FieldWalk:
    """One pass over the fields of a message in the order of the bytes."""

    def __init__(
        self,
        definitions: Mapping[str, Definition],
        next_length: Callable[[str], int],
        wire: Wire,
        type_name: str = "",
        room: int = sys.maxsize,
    ) -> None:
        self.definitions = definitions
        self.next_length = next_length
        self.wire = wire
        self.type_name = type_name
        self.room = room
        self.offset = len(wire.head)
        self.passed = 0
        self.names: list[str] = []
        self.formats: list[Any] = []
        self.offsets: list[int] = []
        self.length_offsets: list[int] = []
        self.lengths: list[int] = []

    def layout(self) -> Layout:
        """Return what the pass has found."""
        columns: Any = {"names": self.names, "formats": self.formats, "offsets": self.offsets, "itemsize": self.offset}
        return Layout(np.dtype(columns), self.offset, tuple(self.length_offsets), tuple(self.lengths))

    def message(self, prefix: str, type_name: str) -> None:
        """Pass over all fields of a message, which in ROS 1 may be none."""
        self.count()
        for field in self.definitions[type_name].fields:
            self.field(prefix + field.name, field)

    def field(self, path: str, field: Field) -> None:
        """Pass over one field, which may be many values."""
        if field.kind == "single":
            self.value(path, field.type_name)
            return
        count = field.length if field.kind == "array" else self.length_word(path)
        if field.type_name in PRIMITIVES:
            self.primitive(path, field.type_name, (count,))
            return
        for i in range(count):
            self.value(f"{path}[{i}]", field.type_name)

    def value(self, path: str, type_name: str) -> None:
        """Pass over one value: a message, a string or a primitive."""
        if type_name in self.definitions:
            self.message(f"{path}.", type_name)
        elif type_name == "string":
            length = self.length_word(path)
            self.place(path, f"S{length}", length)
        elif type_name in PRIMITIVES:
            self.primitive(path, type_name, ())
        else:
            raise LogError(
                f"field {path} is of type {type_name}, which is not supported", "leave its topic out of the roles"
            )

    def primitive(self, path: str, type_name: str, shape: tuple[int, ...]) -> None:
        """Pass over a primitive, or many of them in a row; none at all are not aligned."""
        count = shape[0] if shape else 1
        if count:
            self.align(_SIZES[type_name])
        self.place(path, (PRIMITIVES[type_name], shape), count * _SIZES[type_name])

    def length_word(self, path: str) -> int:
        """Pass over the length of a string or sequence and give it."""
        self.align(4)
        length = self.next_length(path)
        self.length_offsets.append(self.offset)
        self.lengths.append(length)
        self.offset += 4
        return length

    def require(self, end: int) -> None:
        """Refuse a message that is shorter than where its fields end, before many more of them are named."""
        if end > self.room:
            raise LogError(
                f"{self.type_name}: a message of {self.room} bytes is shorter than its schema and lengths say",
                "the log is damaged, or its schema is not that of its messages",
            )

    def align(self, size: int) -> None:
        """Skip padding."""
        if self.wire.is_aligned:
            self.offset += -(self.offset - len(self.wire.head)) % size

    def place(self, path: str, format_: Any, size: int) -> None:
        """Note where a field stands and go behind it."""
        self.require(self.offset + size)
        self.count()
        self.names.append(path)
        self.formats.append(format_)
        self.offsets.append(self.offset)
        self.offset += size

    def count(self) -> None:
        """Refuse a message of more fields and structures than any has, before many of them are named."""
        self.passed += 1
        if self.passed > MOST_PLACES:
            text = f"{self.type_name}: a message holds more than {MOST_PLACES} fields, with those in its lists"
            raise LogError(text, "leave its topic out of the roles")
