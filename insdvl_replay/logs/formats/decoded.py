"""Columns of chosen fields from messages that are decoded one by one: protobuf and JSON.

Sources: https://protobuf.dev/programming-guides/encoding/ and https://mcap.dev/spec/registry for protobuf, whose logs
describe their types themselves.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, field
from functools import reduce
from itertools import count
from operator import attrgetter
from typing import Any, Final, Self

import msgspec
import numpy as np

from insdvl_replay.core.dive_columns import Array
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.formats.definitions import MOST_LEVELS, MOST_PATHS, too_large
from insdvl_replay.logs.formats.fields import NUMBER, TEXT, Columns, Kinds, check_path
from insdvl_replay.logs.formats.log_file import Block

_STRUCTURE: Final = "object"  # the kind of a JSON object

Numbers = Callable[[Any], Sequence[float]]  # reads the numbers at a place of a decoded message
# Takes a field out of a decoded structure; None where it is absent.
Access = Callable[[Any, str, "Shape"], Any]


@dataclass(frozen=True)
class Shape:
    """What is at a place of a message: a number, a text, or a structure of some name with its fields in order."""

    kind: str
    fields: Mapping[str, "Shape"] = field(default_factory=dict)
    is_list: bool = False
    may_be_absent: bool = False  # what may be absent is told apart from zero by the message

    @property
    def width(self) -> int:
        """How many numbers every message has there; those in lists do not count."""
        if self.is_list:
            return 0
        return int(self.kind == NUMBER) + sum(inner.width for inner in self.fields.values())

    def paths(self, prefix: str = "") -> Iterator[tuple[str, str]]:
        """Give every path of a structure, with its kind; the prefix ends in a dot."""
        for name, inner in self.fields.items():
            path = f"{prefix}{name}"
            yield path, inner.kind
            if inner.is_list:
                path = f"{path}[*]"
                yield path, inner.kind
            yield from inner.paths(f"{path}.")


class DecodedFields:
    """Reads some fields of messages that are decoded one by one."""

    def __init__(
        self,
        type_name: str,
        paths: Sequence[str],
        decode: Callable[[memoryview], Any],
        access: Access,
        shape: Shape | None = None,  # of all messages, where their schema tells it
    ) -> None:
        self._type_name = type_name
        self._paths = tuple(paths)
        self._decode = decode
        self._access = access
        self._numbers: dict[str, Numbers] = {}
        self._shape = shape or Shape(_STRUCTURE)
        self.known: Kinds = dict(self._shape.paths())
        if shape is not None:
            self._find(shape)

    def _find(self, shape: Shape) -> None:
        """Find the fields in messages of a shape; a LogError names one that is not there."""
        self.known = dict(shape.paths())
        for path in self._paths:
            check_path(path, self.known, self._type_name)
        self._numbers = {path: _inside(shape, _steps(path), self._access) for path in self._paths}
        self._shape = shape

    def of(self, paths: Sequence[str]) -> Self:
        """Return a reader of other fields of the messages in which this one has found its own."""
        other = copy(self)
        other._paths = tuple(paths)
        other._find(self._shape)
        return other

    def learn(self, messages: Sequence[Any]) -> None:
        """Look at the first messages, where only they tell what is in them."""

    def columns(self, block: Block) -> Columns:
        """Return the fields of all messages of a block, (k, n)."""
        places = zip(block.offsets.tolist(), block.sizes.tolist(), strict=True)
        messages = [self._decode(block.buffer[offset : offset + size]) for offset, size in places]
        if not self._numbers:
            self.learn(messages)
        columns: Columns = {}
        for path, numbers in self._numbers.items():
            columns[path] = _as_rows([numbers(message) for message in messages])
        return columns


def _as_rows(rows: Sequence[Sequence[float]]) -> Array:
    """Return rows of numbers, (k, n), int64 where all are whole; shorter rows are filled up with NaN."""
    widths = {len(row) for row in rows}
    if len(widths) > 1:
        filled = np.full((len(rows), max(widths)), np.nan)
        for row, filled_row in zip(rows, filled, strict=True):
            filled_row[: len(row)] = row
        return filled
    if widths == {0}:
        return np.empty((len(rows), 0))
    values = np.array(rows).reshape(len(rows), -1)
    if values.dtype == np.object_:  # whole numbers of any size
        values = np.vectorize(_as_float, otypes=[np.float64])(values)
    kind = np.int64 if values.dtype.kind in "bi" else np.float64
    return values.astype(kind, copy=False)


def _as_float(number: float) -> float:
    try:
        return float(number)
    except OverflowError:
        return math.nan


def _steps(path: str) -> list[tuple[str, slice]]:
    """Split a path into names, each with the elements that it takes of a list."""
    steps = []
    for part in path.split("."):
        match = re.fullmatch(r"(.*)\[(\d+)\]", part)
        if match:
            chosen = int(match[2])
            steps.append((match[1], slice(chosen, chosen + 1)))
        else:
            steps.append((part.removesuffix("[*]"), slice(None)))
    return steps


def _inside(shape: Shape, steps: Sequence[tuple[str, slice]], access: Access) -> Numbers:
    """Make the reader of the numbers at the end of some steps."""
    if shape.kind == NUMBER:
        return _as_number
    if steps:
        name, chosen = steps[0]
        return _field(name, shape.fields[name], chosen, steps[1:], access)
    if _is_vector(shape):
        return attrgetter(*shape.fields)
    parts = [
        _field(name, part, slice(None), (), access)
        for name, part in shape.fields.items()
        if part.kind != TEXT
    ]

    def joined(value: Any) -> list[float]:
        numbers: list[float] = []
        for part in parts:
            numbers += part(value)
        return numbers

    return joined


def _as_number(value: Any) -> list[float]:
    if isinstance(value, int | float):
        return [value]
    return [math.nan]


def _is_vector(shape: Shape) -> bool:
    """Return whether a structure has several numbers and nothing else, none of which is ever absent.

    Those of protobuf, whose attributes are never absent, are read at once.
    """
    if len(shape.fields) < 2:
        return False
    return all(
        part.kind == NUMBER and not part.is_list and not part.may_be_absent
        for part in shape.fields.values()
    )


def _field(
    name: str,
    shape: Shape,
    chosen: slice,
    rest: Sequence[tuple[str, slice]],
    access: Access,
) -> Numbers:
    inside = _inside(shape, rest, access)
    end = shape
    for step, _ in rest:
        end = end if end.is_list else end.fields[step]
    missing = [math.nan] * end.width

    def elements(value: Any) -> list[float]:
        numbers: list[float] = []
        for item in (access(value, name, shape) or ())[chosen]:
            numbers += inside(item)
        return numbers

    def single(value: Any) -> Sequence[float]:
        inner = access(value, name, shape)
        if inner is None:
            return missing
        return inside(inner)

    if shape.is_list:
        return elements
    return single


# --- Protobuf.


def protobuf_reader(type_name: str, schema_data: bytes, paths: Sequence[str]) -> DecodedFields:
    """Make the reader of a type by the serialised ``FileDescriptorSet`` with all that it uses."""
    from google.protobuf.message import DecodeError
    from mcap.exceptions import McapError
    from mcap.records import Schema
    from mcap_protobuf.decoder import DecoderFactory

    schema = Schema(
        id=1,
        name=type_name,
        encoding="protobuf",
        data=schema_data,
    )
    try:
        decode_any = DecoderFactory().decoder_for("protobuf", schema)
        if decode_any is None:
            raise TypeError("it is empty")
        kind: Any = type(decode_any(b""))
    except (DecodeError, McapError, TypeError, KeyError) as error:
        raise LogError(
            f"the schema of {type_name} is no complete protobuf FileDescriptorSet ({error})",
            "record the log again with the descriptors of all files that the type uses",
        ) from error
    except RecursionError as error:
        raise too_large(type_name) from error

    def decode(message: memoryview) -> Any:
        try:
            return kind.FromString(bytes(message))
        except DecodeError as error:
            raise LogError(
                f"a message of {len(message)} bytes is no {type_name}: {error}",
                "the schema does not match the messages, or the log is damaged",
            ) from error

    def access(message: Any, name: str, shape: Shape) -> Any:
        if shape.may_be_absent and not message.HasField(name):
            return None
        return getattr(message, name)

    return DecodedFields(
        type_name, paths, decode, access, _protobuf_shape(kind.DESCRIPTOR, (), count())
    )


def _protobuf_shape(descriptor: Any, above: tuple[str, ...], numbers: Iterator[int]) -> Shape:
    """Describe a message type; a type within itself and maps, whose keys no path can name, are left out."""
    above = (*above, descriptor.full_name)
    if len(above) > MOST_LEVELS:
        raise too_large(above[0])
    fields = {}
    for member in descriptor.fields:
        inner = member.message_type
        if inner is not None and (inner.full_name in above or inner.GetOptions().map_entry):
            continue
        if next(numbers) == MOST_PATHS:
            raise too_large(above[0])
        kind = TEXT if member.cpp_type == member.CPPTYPE_STRING else NUMBER
        inside: Mapping[str, Shape] = {}
        if inner is not None:
            kind = inner.full_name
            inside = _protobuf_shape(inner, above, numbers).fields
        fields[member.name] = Shape(
            kind=kind,
            fields=inside,
            is_list=member.is_repeated,
            may_be_absent=member.has_presence and not member.has_default_value,
        )
    return Shape(descriptor.full_name, fields)


# --- JSON.

_EXAMPLES: Final = 100  # messages from which the fields are learnt that no schema names
# Searches in vain before one message is taken for all that come with it.
_MOST_FAILURES: Final = 20
_DEEPEST: Final = 32  # levels of structures within structures that are looked at
# Of members, which have no order, these come last, in this one.
_LAST: Final = ("sec", "nsec", "nanosec", "x", "y", "z", "w")
_DECODER: Final = msgspec.json.Decoder()
_NO_NUMBER: Final = re.compile(rb"(?<=[:,\[])\s*[+-]?(?:NaN|Infinity)(?=[\s,}\]])")
_UNREADABLE: Final = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)


class JsonReader(DecodedFields):
    """Reads some fields of JSON messages; what their schema does not tell, the first of them do."""

    def __init__(
        self,
        type_name: str,
        schema_data: bytes,
        paths: Sequence[str],
    ) -> None:
        super().__init__(type_name or "a JSON message", paths, _decoded, _member)
        self._shape = _schema_shape(schema_data)
        self.known = dict(self._shape.paths())
        self._failures = 0

    def learn(self, messages: Sequence[Any]) -> None:
        """Add what the first messages show to what the schema says."""
        # Where they lack a field, a reader of damaged logs asks again for fewer and fewer of them, each time in vain.
        examples = messages[: _EXAMPLES if self._failures < _MOST_FAILURES else 1]
        try:
            self._find(reduce(_merged, map(_shape_of, examples), self._shape))
        except LogError:
            self._failures += 1
            raise


def _decoded(message: memoryview) -> Any:
    """Decode a message; in JSON5, as BlueOS records it, NaN and infinities are null."""
    with suppress(*_UNREADABLE):
        return _DECODER.decode(message)
    try:
        return _DECODER.decode(_NO_NUMBER.sub(b"null", bytes(message)))
    except _UNREADABLE as error:
        raise LogError(
            f"a message of {len(message)} bytes is not JSON: {error}", "the log is damaged"
        ) from error


def _member(structure: Any, name: str, shape: Shape) -> Any:
    if not isinstance(structure, dict):
        return None
    inner = structure.get(name)
    if shape.is_list and not isinstance(inner, list):
        return None
    return inner


def _schema_shape(schema_data: bytes) -> Shape:
    """Describe messages by their JSON schema, as far as it tells."""
    if not schema_data.strip():
        return Shape(_STRUCTURE)
    try:
        schema = msgspec.json.decode(schema_data)
    except _UNREADABLE as error:
        raise LogError(
            f"the JSON schema is no JSON: {error}",
            "record the log again with a correct schema, or without one",
        ) from error

    def described(schema: Any, level: int) -> Shape:
        kind = None
        if isinstance(schema, Mapping) and level <= _DEEPEST:
            kind = schema.get("type")
        if kind == "array":
            return _list_of(described(schema.get("items", {"type": "number"}), level + 1))
        if kind == "object":
            known = schema.get("properties")
            if not isinstance(known, Mapping):
                return _object({})
            return _object({name: described(inner, level + 1) for name, inner in known.items()})
        if kind in ("number", "integer", "boolean"):
            return Shape(NUMBER, may_be_absent=True)
        return Shape(TEXT, may_be_absent=True)

    shape = described(schema, 0)
    if shape.kind == _STRUCTURE:
        return shape
    return Shape(_STRUCTURE)


def _shape_of(value: Any, level: int = 0) -> Shape:
    """Describe a message by an example."""
    if isinstance(value, dict) and level <= _DEEPEST:
        return _object({name: _shape_of(inner, level + 1) for name, inner in value.items()})
    if isinstance(value, list) and level <= _DEEPEST:
        items = (_shape_of(item, level + 1) for item in value)
        return _list_of(reduce(_merged, items, Shape(TEXT)))
    if isinstance(value, int | float):
        return Shape(NUMBER, may_be_absent=True)
    return Shape(TEXT, may_be_absent=True)


def _list_of(inner: Shape) -> Shape:
    """Describe a list; one of lists has no path, so that its inner lists are as closed as text."""
    if inner.is_list:
        return Shape(TEXT, {}, is_list=True, may_be_absent=True)
    return Shape(inner.kind, inner.fields, is_list=True, may_be_absent=True)


def _object(fields: Mapping[str, Shape]) -> Shape:
    others = [name for name in fields if name not in _LAST]
    last = [name for name in _LAST if name in fields]
    return Shape(_STRUCTURE, {name: fields[name] for name in [*others, *last]}, may_be_absent=True)


def _merged(shape: Shape, example: Shape) -> Shape:
    """Add what an example shows; text, null and an empty list give way to it."""
    if shape.kind != _STRUCTURE or example.kind != _STRUCTURE:
        if shape.kind == TEXT:
            return example
        return shape
    fields = dict(shape.fields)
    for name, inner in example.fields.items():
        fields[name] = _merged(fields.get(name, Shape(TEXT)), inner)
    return Shape(_STRUCTURE, _object(fields).fields, shape.is_list, shape.may_be_absent)
