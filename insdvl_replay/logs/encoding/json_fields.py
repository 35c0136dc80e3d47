"""Columns of chosen fields from JSON messages, with or without a JSON schema."""

from collections.abc import Mapping, Sequence
from functools import reduce
from itertools import islice
from typing import Any, Final

import msgspec

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.container.blocks import Block
from insdvl_replay.logs.encoding.field_errors import check_path
from insdvl_replay.logs.encoding.field_paths import (
    NUMBER,
    TEXT,
    Columns,
    Numbers,
    Shape,
    known_paths,
    numbers_at,
    rows_as_columns,
)

_STRUCTURE: Final = "object"
_EXAMPLES: Final = 100
"""Messages from which the fields are learnt that no schema names."""
_DEEPEST: Final = 32
"""Levels of structures within structures that are looked at."""
_FIRST: Final = ("sec", "nsec", "nanosec", "x", "y", "z", "w")
"""The members of a JSON object have no order; these names have one in every vector, quaternion and time."""


class JsonReader:
    """Reads some fields of all messages of one channel.

    Parameters
    ----------
    type_name : str
        Name of the schema; may be empty.
    schema_data : bytes
        A JSON schema; may be empty, then the first messages tell which fields there are.
    paths : sequence of str
        The fields, as `field_paths` says.

    Raises
    ------
    LogError
        The schema is no JSON.
    """

    def __init__(self, type_name: str, schema_data: bytes, paths: Sequence[str]) -> None:
        self._type_name = type_name or "a JSON message"
        self._paths = tuple(paths)
        self._shape = json_shape(schema_data)
        self.known = dict(known_paths(self._shape))
        self._numbers: dict[str, Numbers] = {}
        self._decode = msgspec.json.Decoder().decode

    def columns(self, block: Block) -> Columns:
        """Read the fields of all messages of a block.

        Parameters
        ----------
        block : Block

        Returns
        -------
        dict of str to ndarray, shape (k, n)
            By path. Whatever is absent, null or no number is NaN.

        Raises
        ------
        LogError
            A message is no JSON, or none of the first has the field.
        """
        messages = self._decoded(block)
        if not self._numbers:
            self._learn(messages)
        return {
            path: rows_as_columns([numbers(message) for message in messages]) for path, numbers in self._numbers.items()
        }

    def _learn(self, messages: Sequence[Any]) -> None:
        for message in islice(messages, _EXAMPLES):
            self._shape = _merged(self._shape, _shape_of(message))
        self.known = dict(known_paths(self._shape))
        for path in self._paths:
            check_path(path, self.known, self._type_name)
        self._numbers = {path: numbers_at(path, self._shape, _access) for path in self._paths}

    def _decoded(self, block: Block) -> list[Any]:
        messages = []
        for offset, size in zip(block.offsets.tolist(), block.sizes.tolist(), strict=True):
            try:
                messages.append(self._decode(block.buffer[offset : offset + size]))
            except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
                raise LogError(
                    f"a message of {size} bytes is no JSON: {error}",
                    "JSON knows no NaN and no infinity; a recorder must write null",
                ) from error
        return messages


def json_shape(schema_data: bytes) -> Shape:
    """Describe messages by their JSON schema, as far as it tells.

    Parameters
    ----------
    schema_data : bytes
        May be empty.

    Returns
    -------
    Shape

    Raises
    ------
    LogError
        The schema is no JSON.
    """
    if not schema_data.strip():
        return Shape(_STRUCTURE)
    try:
        schema = msgspec.json.decode(schema_data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise LogError(f"the JSON schema is no JSON: {error}", "a schema may also be left out") from error
    described = _shape_by(schema)
    return described if described.kind == _STRUCTURE else Shape(_STRUCTURE)


def _shape_by(schema: Any, level: int = 0) -> Shape:
    """Follow the properties and items of a schema."""
    if not isinstance(schema, Mapping) or level > _DEEPEST:
        return Shape(TEXT)
    kind = schema.get("type")
    if kind == "array":
        return _list_of(_shape_by(schema.get("items", {"type": "number"}), level + 1))
    if kind == "object":
        properties = schema.get("properties")
        known = properties if isinstance(properties, Mapping) else {}
        return _object({name: _shape_by(inner, level + 1) for name, inner in known.items()})
    return Shape(NUMBER if kind in ("number", "integer", "boolean") else TEXT, may_be_absent=True)


def _shape_of(value: Any, level: int = 0) -> Shape:
    """Tell the shape by an example."""
    if level > _DEEPEST:
        return Shape(TEXT, may_be_absent=True)
    if isinstance(value, dict):
        return _object({name: _shape_of(inner, level + 1) for name, inner in value.items()})
    if isinstance(value, list):
        return _list_of(reduce(_merged, (_shape_of(item, level + 1) for item in value), Shape(TEXT)))
    return Shape(NUMBER if isinstance(value, int | float) else TEXT, may_be_absent=True)


def _list_of(inner: Shape) -> Shape:
    """Describe a list; one of lists has no path, so that its inner lists are as closed as text."""
    return Shape(TEXT if inner.is_list else inner.kind, {} if inner.is_list else inner.fields, True, True)


def _object(fields: Mapping[str, Shape]) -> Shape:
    order = sorted(fields, key=lambda name: _FIRST.index(name) if name in _FIRST else -1)
    return Shape(_STRUCTURE, {name: fields[name] for name in order}, may_be_absent=True)


def _merged(shape: Shape, example: Shape) -> Shape:
    """Add what an example shows; text, null and an empty list give way to it."""
    if shape.kind != _STRUCTURE or example.kind != _STRUCTURE:
        return example if shape.kind == TEXT else shape
    fields = dict(shape.fields)
    for name, inner in example.fields.items():
        fields[name] = _merged(fields.get(name, Shape(TEXT)), inner)
    return Shape(_STRUCTURE, _object(fields).fields, shape.is_list, shape.may_be_absent)


def _access(structure: Any, name: str, shape: Shape) -> Any:
    inner = structure.get(name) if isinstance(structure, dict) else None
    return None if shape.is_list and not isinstance(inner, list) else inner
