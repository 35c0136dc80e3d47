"""The fields of messages: one language of paths, whatever the encoding, and the reader for that of a channel.

``imu.gyroscope`` walks down, ``beams[2]`` takes one element of a list and ``beams[*]`` all of them. A path that ends
at a structure means all numbers in it, in their order; paths joined by commas stand side by side.

What reads an encoding is not loaded before a log has it: protobuf's takes longer than to read a short log.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from numpy.typing import NDArray

from insdvl_replay.core.errors import LogError, most_like, nearest
from insdvl_replay.logs.container.blocks import Block
from insdvl_replay.logs.container.records import LogChannel

Columns = dict[str, NDArray[Any]]
"""By field path, one row per message and one column per number; int64 where all numbers are whole, else float64."""
ROWS: Final = ""
"""Stands among columns of which messages may give several rows, or none: the number of the message, row by row."""
Kinds = Mapping[str, str]
"""Every path that a type knows, with the type of what is there."""
NUMBER: Final = "number"
"""Kind of a `Shape` that is one number."""
TEXT: Final = "text"
"""Kind of a `Shape` that holds no numbers."""
MOST_PATHS: Final = 1 << 16
"""Paths that a type may have: those of real types are hundreds, and a short schema can mean billions."""
MOST_LEVELS: Final = 64
"""Structures within structures that a type may have; those of real types are less than ten."""
_LISTED: Final = 24
"""Fields that an error lists at most."""
TEXTS: Final = (TEXT, "string", "wstring")
"""Kinds of what holds no numbers."""


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
        """Read the fields of all messages of a block.

        Returns
        -------
        dict of str to ndarray, shape (k, n)
            By path. What a message lacks is NaN.
        """


def split_paths(path: str) -> tuple[str, ...]:
    """Part paths that stand side by side, such as ``gyro_x, gyro_y, gyro_z``."""
    return tuple(part.strip() for part in path.split(","))


def find_path(path: str, known: Kinds) -> str | None:
    """Return the type of what stands at a path, or None where the path is not known."""
    return known.get(re.sub(r"\[\d+\]", "[*]", path))


def too_large(type_name: str) -> LogError:
    """Make the error with which a type is refused that has more than `MOST_PATHS` or `MOST_LEVELS`."""
    text = f"{type_name}: the schema means more than {MOST_PATHS} fields, or more than {MOST_LEVELS} within each other"
    return LogError(text, "leave its topic out of the roles")


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
    """List the fields with numbers, for a hint to the user."""
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


ENCODINGS: Final = {
    "cdr": ("ros2msg", "ros2idl", ""),
    "ros1": ("ros1msg",),
    "protobuf": ("protobuf",),
    "json": ("jsonschema", ""),
}
"""Of each encoding of messages that can be read, the encodings of its schemas."""


def check_encoding(channel: LogChannel) -> None:
    """Raise a LogError for a channel whose messages cannot be read."""
    if channel.schema_encoding not in ENCODINGS.get(channel.encoding, ()):
        known = ", ".join(f"{name} with {schemas[0]}" for name, schemas in ENCODINGS.items())
        raise LogError(
            f"messages on '{channel.topic}' are encoded as {channel.encoding or 'nothing'} with "
            f"{channel.schema_encoding or 'no'} schema; only {known} can be read",
            "name another topic, or record the messages in one of these",
        )


def channel_paths(channel: LogChannel) -> Kinds:
    """List every field path that the schema of a channel knows, once `check_encoding` has let it pass.

    Returns
    -------
    mapping of str to str
        By path the type of what is there; empty where only the messages tell, as in JSON without schema.
    """
    if channel.encoding == "protobuf":
        from insdvl_replay.logs.encoding.protobuf_fields import protobuf_paths

        return protobuf_paths(channel.type_name, channel.schema_data)
    if channel.encoding == "json":
        from insdvl_replay.logs.encoding.json_fields import json_paths

        return json_paths(channel.schema_data)
    from insdvl_replay.logs.encoding.binary_fields import binary_paths, definitions_by
    from insdvl_replay.logs.encoding.ros2msg import full_name

    definitions = definitions_by(channel.type_name, channel.schema_text, channel.encoding, channel.schema_encoding)
    return dict(binary_paths(definitions, full_name(channel.type_name)))


def open_reader(channel: LogChannel, paths: Sequence[str], element: Element | None = None) -> FieldReader:
    """Make the reader of some fields of a channel, once `check_encoding` has let it pass.

    Raises
    ------
    LogError
        The schema cannot be read, or knows no such field; elements are asked of what is decoded message by message.
    """
    if element is not None and channel.encoding in ("protobuf", "json"):
        text = f"elements of '{element.list_name}' by their texts are read from CDR and messages of ROS 1 alone"
        raise LogError(text, "record the one that is meant on a topic of its own")
    if channel.encoding == "protobuf":
        from insdvl_replay.logs.encoding.protobuf_fields import ProtobufReader

        return ProtobufReader(channel.type_name, channel.schema_data, paths)
    if channel.encoding == "json":
        from insdvl_replay.logs.encoding.json_fields import JsonReader

        return JsonReader(channel.type_name, channel.schema_data, paths)
    from insdvl_replay.logs.encoding.binary_fields import WIRES, BinaryReader, definitions_by

    definitions, wire = (
        definitions_by(channel.type_name, channel.schema_text, channel.encoding, channel.schema_encoding),
        WIRES[channel.encoding],
    )
    if element is None:
        return BinaryReader(definitions, channel.type_name, paths, wire)
    from insdvl_replay.logs.encoding.list_elements import ElementReader

    return ElementReader(definitions, channel.type_name, paths, wire, element)
