"""Fields of messages that are decoded one by one to structures, as those in JSON and protobuf are."""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.logs.container.blocks import Block
from insdvl_replay.logs.encoding.fields import NUMBER, TEXT, Columns, Kinds, check_path


@dataclass(frozen=True)
class Shape:
    """What stands at a place of a message: a `NUMBER`, a `TEXT`, or a structure of some name, with its fields in order.

    Any number of them stand in a list. What may be absent is told apart from zero by the message.
    """

    kind: str
    fields: Mapping[str, "Shape"] = field(default_factory=dict)
    is_list: bool = False
    may_be_absent: bool = False

    @property
    def is_plain(self) -> bool:
        """Whether one number stands there in every message."""
        return self.kind == NUMBER and not self.is_list and not self.may_be_absent

    @property
    def width(self) -> int:
        """How many numbers stand there in every message; those in lists do not count."""
        if self.is_list:
            return 0
        return int(self.kind == NUMBER) + sum(inner.width for inner in self.fields.values())


Numbers = Callable[[Any], Sequence[float]]
"""Reads the numbers at a place of a decoded message."""
Access = Callable[[Any, str, Shape], Any]
"""Takes a field out of a decoded structure; None where it is absent."""


class DecodedFields:
    """Reads some fields of messages of which a structure is made, one by one."""

    def __init__(
        self, type_name: str, paths: Sequence[str], decode: Callable[[memoryview], Any], access: Access
    ) -> None:
        self._type_name = type_name
        self._paths = tuple(paths)
        self._decode = decode
        self._access = access
        self._numbers: dict[str, Numbers] = {}
        self._found = Shape(TEXT)
        self.known: Kinds = {}

    def find(self, shape: Shape) -> None:
        """Find the fields in the messages of a shape; a LogError names one that is not there."""
        self.known = dict(known_paths(shape))
        for path in self._paths:
            check_path(path, self.known, self._type_name)
        self._numbers = {path: numbers_at(path, shape, self._access) for path in self._paths}
        self._found = shape

    def of(self, paths: Sequence[str]) -> Self:
        """Return a reader of other fields of the messages in which this one has found its own."""
        other = copy(self)
        other._paths = tuple(paths)
        other.find(self._found)
        return other

    def learn(self, messages: Sequence[Any]) -> None:
        """Look at the first messages, where only they tell what is in them."""

    def columns(self, block: Block) -> Columns:
        """Read the fields of all messages of a block, as `fields.FieldReader.columns`."""
        places = zip(block.offsets.tolist(), block.sizes.tolist(), strict=True)
        messages = [self._decode(block.buffer[offset : offset + size]) for offset, size in places]
        if not self._numbers:
            self.learn(messages)
        return {
            path: rows_as_columns([numbers(message) for message in messages]) for path, numbers in self._numbers.items()
        }


def known_paths(shape: Shape, prefix: str = "") -> Iterator[tuple[str, str]]:
    """List every path of a structure, behind a prefix that ends in a dot."""
    for name, inner in shape.fields.items():
        path = f"{prefix}{name}"
        yield path, inner.kind
        if inner.is_list:
            path = f"{path}[*]"
            yield path, inner.kind
        yield from known_paths(inner, f"{path}.")


def numbers_at(path: str, shape: Shape, access: Access) -> Numbers:
    """Make the reader of one path that the shape of the whole message knows."""
    return _inside(shape, [_step(part) for part in path.split(".")], access)


def rows_as_columns(rows: Sequence[Sequence[float]]) -> NDArray[Any]:
    """Make an array of rows, shape (k, n), int64 where all numbers are whole; shorter rows are filled up with NaN."""
    widths = {len(row) for row in rows}
    if len(widths) > 1:
        filled = np.full((len(rows), max(widths)), np.nan)
        for row, filled_row in zip(rows, filled, strict=True):
            filled_row[: len(row)] = row
        return filled
    values = np.array(rows).reshape(len(rows), -1) if widths != {0} else np.empty((len(rows), 0))
    if values.dtype == np.object_:
        values = np.vectorize(_as_float, otypes=[np.float64])(values)
    return values.astype(np.int64 if values.dtype.kind in "bi" else np.float64, copy=False)


def _step(part: str) -> tuple[str, slice]:
    """Part a name from the elements that it takes of a list."""
    match = re.fullmatch(r"(.*)\[(\d+)\]", part)
    if match:
        return match[1], slice(int(match[2]), int(match[2]) + 1)
    return part.removesuffix("[*]"), slice(None)


def _inside(shape: Shape, steps: Sequence[tuple[str, slice]], access: Access) -> Numbers:
    if shape.kind == NUMBER:
        return _number
    if steps:
        name, chosen = steps[0]
        return _field(name, shape.fields[name], chosen, steps[1:], access)
    if len(shape.fields) > 1 and all(inner.is_plain for inner in shape.fields.values()):
        # Only attributes are never absent: a vector of them is read at once.
        return attrgetter(*shape.fields)
    parts = [_field(name, inner, slice(None), (), access) for name, inner in shape.fields.items() if inner.kind != TEXT]
    return lambda value: [number for part in parts for number in part(value)]


def _field(name: str, shape: Shape, chosen: slice, rest: Sequence[tuple[str, slice]], access: Access) -> Numbers:
    inside = _inside(shape, rest, access)
    if shape.is_list:

        def elements(value: Any) -> list[float]:
            items = access(value, name, shape)
            return [number for item in items[chosen] for number in inside(item)] if items is not None else []

        return elements
    missing = [math.nan] * _width(shape, rest)

    def single(value: Any) -> Sequence[float]:
        inner = access(value, name, shape)
        return missing if inner is None else inside(inner)

    return single


def _width(shape: Shape, steps: Sequence[tuple[str, slice]]) -> int:
    for name, _ in steps:
        if shape.is_list:
            return 0
        shape = shape.fields[name]
    return shape.width


def _as_float(number: float) -> float:
    """Return a whole number of any size as a float, NaN where it has none."""
    try:
        return float(number)
    except OverflowError:
        return math.nan


def _number(value: Any) -> list[float]:
    return [value if isinstance(value, int | float) else math.nan]
