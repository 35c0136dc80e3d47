"""Field paths: one language for the fields of a message, whatever its encoding.

``imu.gyroscope`` walks down, ``beams[2]`` takes one element of a list and ``beams[*]`` all of them. A path that ends
at a structure means all numbers in it, in their order; paths joined by commas stand side by side.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.container.blocks import Block

Columns = dict[str, NDArray[Any]]
"""By field path, one row per message and one column per number; int64 where all numbers are whole, else float64."""

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

TEXTS: Final = (TEXT, "string", "wstring")
"""Kinds of what holds no numbers."""


class FieldReader(Protocol):
    """Reads some fields of all messages of one channel."""

    @property
    def known(self) -> Kinds:
        """Every path that there is; where no schema tells, those of the messages read so far."""

    def columns(self, block: Block) -> Columns:
        """Read the fields of all messages of a block.

        Parameters
        ----------
        block : Block

        Returns
        -------
        dict of str to ndarray, shape (k, n)
            By path. What a message lacks is NaN.

        Raises
        ------
        LogError
            A message cannot be read.
        """


@dataclass(frozen=True)
class Shape:
    """What stands at a place of a message.

    Attributes
    ----------
    kind : str
        `NUMBER`, `TEXT`, or the name of a structure.
    fields : mapping of str to Shape
        What is in a structure, in order.
    is_list : bool
        Whether any number of them stand there.
    may_be_absent : bool
        Whether a message tells that nothing stands there, apart from zero.
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


def split_paths(path: str) -> tuple[str, ...]:
    """Part paths that stand side by side.

    Parameters
    ----------
    path : str
        Such as ``gyro_x, gyro_y, gyro_z``.

    Returns
    -------
    tuple of str
    """
    return tuple(part.strip() for part in path.split(","))


def find_path(path: str, known: Kinds) -> str | None:
    """Give the type of what stands at a path, or None where the path is not known.

    Parameters
    ----------
    path : str
    known : mapping of str to str

    Returns
    -------
    str or None
    """
    return known.get(re.sub(r"\[\d+\]", "[*]", path))


def too_large(type_name: str) -> LogError:
    """Make the error with which a type is refused that has more than `MOST_PATHS` or `MOST_LEVELS`.

    Parameters
    ----------
    type_name : str

    Returns
    -------
    LogError
    """
    text = f"{type_name}: the schema means more than {MOST_PATHS} fields, or more than {MOST_LEVELS} within each other"
    return LogError(text, "leave its topic out of the roles")


def known_paths(shape: Shape, prefix: str = "") -> Iterator[tuple[str, str]]:
    """List every path of a structure.

    Parameters
    ----------
    shape : Shape
    prefix : str
        Path of the structure, with a dot behind it.

    Yields
    ------
    path, kind : str
    """
    for name, inner in shape.fields.items():
        path = f"{prefix}{name}"
        yield path, inner.kind
        if inner.is_list:
            path = f"{path}[*]"
            yield path, inner.kind
        yield from known_paths(inner, f"{path}.")


def numbers_at(path: str, shape: Shape, access: Access) -> Numbers:
    """Make the reader of one path.

    Parameters
    ----------
    path : str
        One that the shape knows.
    shape : Shape
        Of the whole message.
    access : Access
        Of the encoding.

    Returns
    -------
    Numbers
    """
    return _inside(shape, [_step(part) for part in path.split(".")], access)


def rows_as_columns(rows: Sequence[Sequence[float]]) -> NDArray[Any]:
    """Make an array of the rows; shorter ones are filled up with NaN.

    Parameters
    ----------
    rows : sequence of sequences of float

    Returns
    -------
    ndarray, shape (k, n)
        int64 where all numbers are whole, else float64.
    """
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
    """Give a whole number of any size as a float, NaN where it has none."""
    try:
        return float(number)
    except OverflowError:
        return math.nan


def _number(value: Any) -> list[float]:
    return [value if isinstance(value, int | float) else math.nan]
