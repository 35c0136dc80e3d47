"""The encodings of messages: which one a channel has, which fields its type knows, and their reader."""

from collections.abc import Sequence
from functools import cache
from typing import Final

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.container.channel import LogChannel
from insdvl_replay.logs.encoding.cdr import CdrReader, cdr_paths
from insdvl_replay.logs.encoding.field_paths import FieldReader, Kinds, known_paths
from insdvl_replay.logs.encoding.json_fields import JsonReader, json_shape
from insdvl_replay.logs.encoding.protobuf_fields import ProtobufReader, protobuf_shape
from insdvl_replay.logs.encoding.ros2msg import Definition, definition_text, full_name, parse_definitions

ENCODINGS: Final = {"cdr": ("ros2msg", ""), "protobuf": ("protobuf",), "json": ("jsonschema", "")}
"""Of each encoding of messages that can be read, the encodings of its schemas."""


def check_encoding(channel: LogChannel, place: str) -> None:
    """Refuse a channel whose messages cannot be read.

    Parameters
    ----------
    channel : LogChannel
    place : str
        The file, for messages to the user.

    Raises
    ------
    LogError
    """
    if channel.schema_encoding not in ENCODINGS.get(channel.encoding, ()):
        known = ", ".join(f"{name} with {schemas[0]}" for name, schemas in ENCODINGS.items())
        raise LogError(
            f"{place}: messages on '{channel.topic}' are encoded as {channel.encoding or 'nothing'} with "
            f"{channel.schema_encoding or 'no'} schema; only {known} can be read",
            "name another topic, or record the messages in one of these",
        )


def channel_paths(channel: LogChannel, place: str) -> Kinds:
    """List every field path that the schema of a channel knows.

    Parameters
    ----------
    channel : LogChannel
        One that `check_encoding` lets pass.
    place : str
        File and topic, for messages to the user.

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
        return dict(known_paths(protobuf_shape(channel.type_name, channel.schema_data, place)))
    if channel.encoding == "json":
        return dict(known_paths(json_shape(channel.schema_data, place)))
    return dict(cdr_paths(_definitions(channel.type_name, channel.schema_text, place), full_name(channel.type_name)))


def open_reader(channel: LogChannel, paths: Sequence[str], place: str) -> FieldReader:
    """Make the reader of some fields of a channel.

    Parameters
    ----------
    channel : LogChannel
        One that `check_encoding` lets pass.
    paths : sequence of str
        The fields, as `field_paths` says.
    place : str
        File and topic, for messages to the user.

    Returns
    -------
    FieldReader

    Raises
    ------
    LogError
        The schema cannot be read, or knows no such field.
    """
    if channel.encoding == "protobuf":
        return ProtobufReader(channel.type_name, channel.schema_data, paths, place)
    if channel.encoding == "json":
        return JsonReader(channel.type_name, channel.schema_data, paths, place)
    definitions = _definitions(channel.type_name, channel.schema_text, place)
    return CdrReader(definitions, channel.type_name, paths, place)


@cache
def _definitions(type_name: str, schema_text: str, place: str) -> dict[str, Definition]:
    """Parse a schema; one that is empty is that of a known type."""
    try:
        text = schema_text if schema_text.strip() else definition_text(type_name)
        return parse_definitions(type_name, text)
    except LogError as error:
        raise LogError(f"{place}: {error.message}", error.hint) from error
