"""Columns of chosen fields from protobuf messages, whose log describes their types itself.

Source: https://protobuf.dev/programming-guides/encoding/ and the MCAP registry, https://mcap.dev/spec/registry#protobuf.
"""

from collections.abc import Iterator, Sequence
from itertools import count
from typing import Any

from google.protobuf.message import DecodeError, Message
from mcap.exceptions import McapError
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory

from insdvl_replay.core.errors import LogError, error_context
from insdvl_replay.logs.container.blocks import Block
from insdvl_replay.logs.encoding.field_errors import check_path
from insdvl_replay.logs.encoding.field_paths import (
    MOST_LEVELS,
    MOST_PATHS,
    NUMBER,
    TEXT,
    Columns,
    Shape,
    known_paths,
    numbers_at,
    rows_as_columns,
    too_large,
)


class ProtobufReader:
    """Reads some fields of all messages of one type.

    Parameters
    ----------
    type_name : str
        Full name of the type.
    schema_data : bytes
        A serialised ``FileDescriptorSet`` with the type and all that it uses.
    paths : sequence of str
        The fields, as `field_paths` says.
    place : str
        File and topic, for messages to the user.

    Raises
    ------
    LogError
        The schema cannot be read, or the type has no such field.
    """

    def __init__(self, type_name: str, schema_data: bytes, paths: Sequence[str], place: str) -> None:
        self._place = place
        self._type_name = type_name
        self._message_class = _message_class(type_name, schema_data, place)
        shape = protobuf_shape(type_name, schema_data, place)
        self.known = dict(known_paths(shape))
        for path in paths:
            check_path(path, self.known, type_name, place)
        self._numbers = {path: numbers_at(path, shape, _access) for path in paths}

    def columns(self, block: Block) -> Columns:
        """Read the fields of all messages of a block.

        Parameters
        ----------
        block : Block

        Returns
        -------
        dict of str to ndarray, shape (k, n)
            By path. A structure that a message lacks is NaN; a lone number that it lacks has its default, as in every
            protobuf decoder.

        Raises
        ------
        LogError
            A message cannot be decoded.
        """
        messages = self._decoded(block)
        return {
            path: rows_as_columns([numbers(message) for message in messages]) for path, numbers in self._numbers.items()
        }

    def _decoded(self, block: Block) -> list[Message]:
        parse = self._message_class.FromString
        messages = []
        for offset, size in zip(block.offsets.tolist(), block.sizes.tolist(), strict=True):
            try:
                messages.append(parse(bytes(block.buffer[offset : offset + size])))
            except DecodeError as error:
                raise LogError(
                    f"{self._place}: a message of {size} bytes is no {self._type_name}: {error}",
                    "the schema in the log is not that of the messages, or the log is damaged",
                ) from error
        return messages


def protobuf_shape(type_name: str, schema_data: bytes, place: str) -> Shape:
    """Describe the messages of a type.

    Parameters
    ----------
    type_name : str
    schema_data : bytes
        A serialised ``FileDescriptorSet``.
    place : str
        File and topic, for messages to the user.

    Returns
    -------
    Shape

    Raises
    ------
    LogError
        The schema cannot be read.
    """
    descriptor = _message_class(type_name, schema_data, place).DESCRIPTOR
    with error_context(place):
        return _structure(descriptor, (), count())


def _message_class(type_name: str, schema_data: bytes, place: str) -> Any:
    schema = Schema(id=1, name=type_name, encoding="protobuf", data=schema_data)
    try:
        decode = DecoderFactory().decoder_for("protobuf", schema)
    except (DecodeError, McapError, TypeError, KeyError) as error:
        raise LogError(
            f"{place}: the schema of {type_name} is no complete protobuf FileDescriptorSet ({error})",
            "record the log again with the descriptors of all files that the type uses",
        ) from error
    except RecursionError as error:
        raise too_large(f"{place}: {type_name}") from error
    return type(decode(b"")) if decode else None


def _structure(descriptor: Any, above: tuple[str, ...], numbers: Iterator[int]) -> Shape:
    """Describe a message type; a type within itself and maps, whose keys no path can name, are left out."""
    above = (*above, descriptor.full_name)
    if len(above) > MOST_LEVELS:
        raise too_large(above[0])
    fields = {}
    for field in descriptor.fields:
        inner = field.message_type
        if inner is not None and (inner.full_name in above or inner.GetOptions().map_entry):
            continue
        if next(numbers) == MOST_PATHS:
            raise too_large(above[0])
        fields[field.name] = Shape(
            kind=inner.full_name if inner else _kind(field),
            fields=_structure(inner, above, numbers).fields if inner else {},
            is_list=field.is_repeated,
            may_be_absent=field.has_presence and not field.has_default_value,
        )
    return Shape(descriptor.full_name, fields)


def _kind(field: Any) -> str:
    return TEXT if field.cpp_type == field.CPPTYPE_STRING else NUMBER


def _access(message: Any, name: str, shape: Shape) -> Any:
    if shape.may_be_absent and not message.HasField(name):
        return None
    return getattr(message, name)
