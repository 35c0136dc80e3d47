"""The fields of messages: one language of paths for every encoding, and the reader for the encoding of a channel.

``imu.gyroscope`` walks down, ``beams[2]`` takes one element of a list and ``beams[*]`` all of them. A path that ends
at a structure means all numbers in it, in their order; paths joined by commas are side by side.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from numpy.typing import NDArray

from insdvl_replay.core.errors import LogError, most_like, nearest
from insdvl_replay.logs.formats.log_file import Block, LogChannel

Columns = dict[str, NDArray[Any]]  # by path, (k, n): a row per message; int64 where all are whole, else float64
Kinds = Mapping[str, str]  # every path that a type knows, with the type of what is there
ROWS: Final = ""  # key of the messages' numbers in columns, where a message may give several rows, or none
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
        raise LogError(f"{type_name} has no field '{path}'", f"the nearest one is '{meant}'; {hint}" if meant else hint)
    if kind in TEXTS:
        raise LogError(f"field '{path}' of {type_name} is text", f"name one of numbers; {fields_hint(known, path)}")


def fields_hint(known: Kinds, path: str) -> str:
    """List the fields with numbers, for a hint."""
    numbers = {name: kind for name, kind in known.items() if kind not in TEXTS and f"{name}[*]" not in known}
    if not numbers:
        return "the type has no fields of numbers"
    near = set(most_like(path, numbers, _LISTED))
    shortest_first = sorted(
        (name for name in numbers if name in near), key=lambda name: len(re.findall(r"[.\[]", name))
    )
    listed = ", ".join(f"{name} ({numbers[name]})" for name in shortest_first)
    more = f" and {len(numbers) - len(near)} more" if len(numbers) > len(near) else ""
    return f'its fields are {listed}{more}; "p, q, r" sets fields side by side'


# Of each encoding of messages that can be read, the encodings of its schemas.
ENCODINGS: Final = {
    "cdr": ("ros2msg", "ros2idl", ""),
    "ros1": ("ros1msg",),
    "protobuf": ("protobuf",),
    "json": ("jsonschema", ""),
}


def check_encoding(channel: LogChannel) -> None:
    """Refuse a channel whose messages cannot be read."""
    if channel.schema_encoding not in ENCODINGS.get(channel.encoding, ()):
        known = ", ".join(f"{name} with {schemas[0]}" for name, schemas in ENCODINGS.items())
        raise LogError(
            f"messages on '{channel.topic}' are encoded as {channel.encoding or 'nothing'} with "
            f"{channel.schema_encoding or 'no'} schema; only {known} can be read",
            "name another topic, or record the messages in one of these",
        )


def channel_paths(channel: LogChannel) -> Kinds:
    """Return every field path that the schema of a readable channel knows; empty where only the messages tell."""
    return open_reader(channel, ()).known


def open_reader(channel: LogChannel, paths: Sequence[str], element: Element | None = None) -> FieldReader:
    """Make the reader of some fields of a readable channel; a LogError names a field that its schema does not know."""
    # What reads an encoding is not loaded before a log has it: protobuf's takes longer than to read a short log.
    if channel.encoding in ("protobuf", "json"):
        from insdvl_replay.logs.formats.decoded import JsonReader, protobuf_reader

        if element is not None:
            text = f"elements of '{element.list_name}' by their texts are read from CDR and messages of ROS 1 alone"
            raise LogError(text, "record the one that is meant on a topic of its own")
        make = protobuf_reader if channel.encoding == "protobuf" else JsonReader
        return make(channel.type_name, channel.schema_data, paths)
    from insdvl_replay.logs.formats.definitions import definitions_of
    from insdvl_replay.logs.formats.layout import BinaryReader

    definitions = definitions_of(channel.type_name, channel.schema_text, channel.encoding, channel.schema_encoding)
    return BinaryReader(definitions, channel.type_name, paths, is_cdr=channel.encoding == "cdr", element=element)
