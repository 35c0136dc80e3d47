"""Columns of chosen fields from JSON messages, with or without a JSON schema."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import reduce
from typing import Any, Final

import msgspec

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.encoding.decoded_fields import DecodedFields, Shape, known_paths
from insdvl_replay.logs.encoding.fields import NUMBER, TEXT, Kinds
from insdvl_replay.logs.encoding.json5_text import as_json, without_nan

_STRUCTURE: Final = "object"
_EXAMPLES: Final = 100
"""Messages from which the fields are learnt that no schema names."""
_MOST_LOOKS: Final = 1 << 20
"""Fields at which is looked for those that no schema names; then one message is taken for all that come with it."""
_DEEPEST: Final = 32
"""Levels of structures within structures that are looked at."""
_FIRST: Final = ("sec", "nsec", "nanosec", "x", "y", "z", "w")
"""The members of a JSON object have no order; these names have one in every vector, quaternion and time."""


class JsonReader(DecodedFields):
    """Reads some fields of all messages of one channel; where there is no schema, the first of them tell the fields."""

    def __init__(self, type_name: str, schema_data: bytes, paths: Sequence[str]) -> None:
        super().__init__(type_name or "a JSON message", paths, _decoded, _access)
        self._shape = self._found = json_shape(schema_data)
        self.known = json_paths(schema_data)
        self._looks = 0
        self._missing: LogError | None = None

    def learn(self, messages: Sequence[Any]) -> None:
        """Add what the first messages show to what the schema says.

        Where they lack a field, a reader of damaged logs asks again for fewer and fewer of them, each time in vain.
        """
        examples = messages[:_EXAMPLES]
        if self._missing is not None and self._looks > _MOST_LOOKS:
            examples = messages[:1]
            if not set(self._paths) <= {path for path, _ in known_paths(_shape_of(examples[0]))}:
                raise LogError(self._missing.what, self._missing.hint)
        try:
            self.find(reduce(_merged, map(_shape_of, examples), self._shape))
        except LogError as error:
            self._missing = error
            self._looks += len(examples) * len(self.known)
            raise


_DECODER: Final = msgspec.json.Decoder()


def _decoded(message: memoryview) -> Any:
    try:
        return _DECODER.decode(message)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return _decoded_as_json5(message)


def _decoded_as_json5(message: memoryview) -> Any:
    """Read a message that is no JSON but JSON5, as BlueOS records."""
    with suppress(msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return _DECODER.decode(without_nan(bytes(message)))
    try:
        return _DECODER.decode(as_json(bytes(message).decode("utf-8")))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise LogError(
            f"a message of {len(message)} bytes is neither JSON nor JSON5: {error}", "the log is damaged"
        ) from error


def json_paths(schema_data: bytes) -> Kinds:
    """List every path that a JSON schema knows."""
    return dict(known_paths(json_shape(schema_data)))


def json_shape(schema_data: bytes) -> Shape:
    """Describe messages by their JSON schema, as far as it tells."""
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
    """Find the shape by an example."""
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
