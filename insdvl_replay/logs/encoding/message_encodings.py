"""The encodings of messages: which one a channel has, which fields its type knows, and their reader."""

from collections.abc import Sequence
from functools import cache
from typing import Final

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.container.records import LogChannel
from insdvl_replay.logs.encoding.cdr import CdrReader, cdr_paths
from insdvl_replay.logs.encoding.decoded_fields import known_paths
from insdvl_replay.logs.encoding.field_paths import FieldReader, Kinds
from insdvl_replay.logs.encoding.json_fields import JsonReader, json_shape
from insdvl_replay.logs.encoding.protobuf_fields import ProtobufReader, protobuf_shape
from insdvl_replay.logs.encoding.ros2msg import Definition, definition_text, full_name, parse_definitions

ENCODINGS: Final = {"cdr": ("ros2msg", ""), "protobuf": ("protobuf",), "json": ("jsonschema", "")}
"""Of each encoding of messages that can be read, the encodings of its schemas."""


def check_encoding(channel: LogChannel) -> None:
    """Refuse a channel whose messages cannot be read.

    Raises
    ------
    LogError
    """
    if channel.schema_encoding not in ENCODINGS.get(channel.encoding, ()):
        known = ", ".join(f"{name} with {schemas[0]}" for name, schemas in ENCODINGS.items())
        raise LogError(
            f"messages on '{channel.topic}' are encoded as {channel.encoding or 'nothing'} with "
            f"{channel.schema_encoding or 'no'} schema; only {known} can be read",
            "name another topic, or record the messages in one of these",
        )


def channel_paths(channel: LogChannel) -> Kinds:
    """List every field path that the schema of a channel knows.

    Parameters
    ----------
    channel : LogChannel
        One that `check_encoding` lets pass.

    Returns
    -------
    mapping of str to str
        By path the type of what is there; empty where only the messages tell, as in JSON without schema.

    Raises
    ------
    LogError
        The schema cannot be read.
    """
    if channel.encoding == "protobuf":
        return dict(known_paths(protobuf_shape(channel.type_name, channel.schema_data)))
    if channel.encoding == "json":
        return dict(known_paths(json_shape(channel.schema_data)))
    return dict(cdr_paths(_definitions(channel.type_name, channel.schema_text), full_name(channel.type_name)))


def open_reader(channel: LogChannel, paths: Sequence[str]) -> FieldReader:
    """Make the reader of some fields of a channel.

    Parameters
    ----------
    channel : LogChannel
        One that `check_encoding` lets pass.
    paths : sequence of str
        The fields, as `field_paths` says.

    Raises
    ------
    LogError
        The schema cannot be read, or knows no such field.
    """
    if channel.encoding == "protobuf":
        return ProtobufReader(channel.type_name, channel.schema_data, paths)
    if channel.encoding == "json":
        return JsonReader(channel.type_name, channel.schema_data, paths)
    definitions = _definitions(channel.type_name, channel.schema_text)
    return CdrReader(definitions, channel.type_name, paths)


@cache
def _definitions(type_name: str, schema_text: str) -> dict[str, Definition]:
    """Parse a schema; one that is empty is that of a known type."""
    return parse_definitions(type_name, schema_text if schema_text.strip() else definition_text(type_name))
