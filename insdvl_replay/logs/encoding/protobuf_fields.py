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

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.encoding.decoded_fields import DecodedFields, Shape, known_paths
from insdvl_replay.logs.encoding.fields import MOST_LEVELS, MOST_PATHS, NUMBER, TEXT, Kinds, too_large


class ProtobufReader(DecodedFields):
    """Reads some fields of all messages of one type, by the serialised ``FileDescriptorSet`` with all that it uses."""

    def __init__(self, type_name: str, schema_data: bytes, paths: Sequence[str]) -> None:
        parse = _message_class(type_name, schema_data).FromString

        def decode(message: memoryview) -> Message:
            try:
                return parse(bytes(message))
            except DecodeError as error:
                raise LogError(
                    f"a message of {len(message)} bytes is no {type_name}: {error}",
                    "the schema in the log is not that of the messages, or the log is damaged",
                ) from error

        super().__init__(type_name, paths, decode, _access)
        self.find(protobuf_shape(type_name, schema_data))


def protobuf_paths(type_name: str, schema_data: bytes) -> Kinds:
    """List every path that a type knows."""
    return dict(known_paths(protobuf_shape(type_name, schema_data)))


def protobuf_shape(type_name: str, schema_data: bytes) -> Shape:
    """Describe the messages of a type."""
    descriptor = _message_class(type_name, schema_data).DESCRIPTOR
    return _structure(descriptor, (), count())


def _message_class(type_name: str, schema_data: bytes) -> Any:
    schema = Schema(id=1, name=type_name, encoding="protobuf", data=schema_data)
    try:
        decode = DecoderFactory().decoder_for("protobuf", schema)
    except (DecodeError, McapError, TypeError, KeyError) as error:
        raise LogError(
            f"the schema of {type_name} is no complete protobuf FileDescriptorSet ({error})",
            "record the log again with the descriptors of all files that the type uses",
        ) from error
    except RecursionError as error:
        raise too_large(type_name) from error
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
