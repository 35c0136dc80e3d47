"""Columns of chosen fields from messages in CDR or of ROS 1: where numbers stand in a layout, and what the bits say.

Messages whose strings and sequences have the same lengths share one `layout`, and are read together. In most logs all
messages of a channel do.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.errors import LogError
from insdvl_replay.core.runtime import is_loaded
from insdvl_replay.logs.container.blocks import Block, gather
from insdvl_replay.logs.encoding.fields import Columns, check_path
from insdvl_replay.logs.encoding.layout import CDR, ENCAPSULATION, ROS1, Layout, Wire, dynamic_lengths, layout_of
from insdvl_replay.logs.encoding.ros2msg import (
    PRIMITIVES,
    ROS1MSG,
    Definition,
    completed_text,
    definition_text,
    full_name,
    parse_definitions,
)

LITTLE_ENDIAN: Final = int.from_bytes(ENCAPSULATION[:2], "little")
"""The first word of messages in CDR that can be read."""
WORD: Final = np.dtype("<u2")
"""How it stands there."""
MOST_NUMBERS: Final = 1 << 16
"""Numbers that are read of one message; a sensor gives some hundreds."""
_LENGTH: Final = np.dtype("<u4")
Bits = NDArray[np.int64]
"""Of n numbers in k messages, shape (n, k)."""
_Run = tuple[slice, np.dtype[Any]]
"""Numbers of one kind that stand side by side among the bits."""


class Numbers:
    """The numbers in the messages of one layout that some paths mean, `MOST_NUMBERS` at most."""

    def __init__(self, layout: Layout, paths: Sequence[str], wire: Wire) -> None:
        self._words = np.array([*([LITTLE_ENDIAN] if wire.head else ()), *layout.lengths], np.int64)[:, None]
        places = [*_places(WORD, 0)] if wire.head else []
        for offset in layout.length_offsets:
            places += _places(_LENGTH, offset)
        self._runs: dict[str, list[_Run]] = {path: [] for path in paths}
        for path, runs in self._runs.items():
            for dtype, offset in _leaves(layout.dtype, path):
                if len(places) + math.prod(dtype.shape) > MOST_NUMBERS:
                    raise LogError(f"'{path}' means more than {MOST_NUMBERS} numbers of a message", "name fewer")
                goes_on = bool(runs) and runs[-1][1] == dtype.base
                first = runs.pop()[0].start if goes_on else len(places)
                places += _places(dtype, offset)
                runs.append((slice(first, len(places)), dtype.base))
        self._places = np.array(places, np.int64).reshape(-1, 3).T.copy()

    def read(self, data: NDArray[np.uint8], starts: NDArray[np.int64]) -> tuple[NDArray[np.bool_], Columns]:
        """Read messages that have the size of the layout: which of them have it, and the numbers of these by path."""
        bits = read_bits(data, starts, self._places)
        fits = np.asarray((bits[: len(self._words)] == self._words).all(axis=0))
        bits = bits if fits.all() else bits[:, fits]
        return fits, {path: _meant(bits, runs) for path, runs in self._runs.items()}


def _places(dtype: np.dtype[Any], offset: int) -> Iterator[tuple[int, int, bool]]:
    """Return offset, size and whether it is signed, of each number of a field."""
    size = dtype.base.itemsize
    return ((offset + size * number, size, dtype.base.kind == "i") for number in range(math.prod(dtype.shape)))


def read_bits(data: NDArray[np.uint8], starts: NDArray[np.int64], places: NDArray[np.int64]) -> Bits:
    """Read little-endian numbers of messages.

    Parameters
    ----------
    starts : ndarray, shape (k,)
        Where in the data each message starts.
    places : ndarray, shape (3, n)
        Of each number in a message: the bytes in front of it; its own, 1, 2, 4 or 8; whether it is a signed whole one.
        All of them lie in the data.

    Returns
    -------
    ndarray, shape (n, k)
        Their bits; those of a signed number are filled up so that it stays the same.
    """
    if is_loaded():
        from insdvl_replay.logs.encoding import number_loops

        return number_loops.read_bits(data, starts, places)
    return read_bits_plainly(data, starts, places)


def read_bits_plainly(data: NDArray[np.uint8], starts: NDArray[np.int64], places: NDArray[np.int64]) -> Bits:
    """Do what `read_bits` does without the compiler, whose loading would take longer than to read a few messages."""
    bits = np.empty((places.shape[1], starts.size), np.int64)
    for number, (offset, size, signed) in enumerate(places.T.tolist()):
        bits[number] = gather(data, starts + offset, np.dtype(f"<{'i' if signed else 'u'}{size}"))
    return bits


def _meant(bits: Bits, runs: Sequence[_Run]) -> NDArray[Any]:
    """Return the numbers that bits mean, shape (k, n), whole ones as integers if all are whole."""
    parts = [_numbers(bits[numbers], dtype) for numbers, dtype in runs]
    return (parts[0] if len(parts) == 1 else np.concatenate([bits[:0], *parts])).T


def _numbers(bits: Bits, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return int64 or float64 for the bits of numbers of one kind."""
    if dtype.kind in "iu":
        return bits
    if dtype.kind == "b":
        return np.asarray(bits != 0, np.int64)
    return np.asarray(bits.view(np.float64) if dtype.itemsize == 8 else bits.astype(np.uint32).view(np.float32), float)


def _leaves(dtype: np.dtype[np.void], path: str) -> Iterator[tuple[np.dtype[Any], int]]:
    """Find the fields of a layout that a path means, or the elements of them, and where they stand in it."""
    base, index = _last_index(path)
    whole, element, places = _pattern(path), _pattern(base), dict(dtype.fields or {})
    for name in dtype.names or ():
        field, place = dtype[name], places[name][1]
        if field.base.kind not in "biuf":
            continue
        if whole.match(name):
            yield field, place
        elif index is not None and field.shape and element.fullmatch(name):
            if index == "*":
                yield field, place
            elif int(index) < field.shape[0]:
                yield field.base, place + int(index) * field.base.itemsize


def _last_index(path: str) -> tuple[str, str | None]:
    match = re.fullmatch(r"(.*)\[(\d+|\*)\]", path)
    return (match[1], match[2]) if match else (path, None)


def _pattern(path: str) -> re.Pattern[str]:
    """Match the field that a path names, and every field below it."""
    return re.compile(re.escape(path).replace(r"\[\*\]", r"\[\d+\]") + r"(?![^.\[])")


_ENCAPSULATIONS: Final = {
    0x00: "big-endian CDR",
    0x02: "a big-endian parameter list",
    0x03: "a parameter list",
    0x06: "big-endian XCDR2",
    0x07: "XCDR2",
    0x08: "big-endian delimited XCDR2",
    0x09: "delimited XCDR2",
    0x0A: "a big-endian XCDR2 parameter list",
    0x0B: "an XCDR2 parameter list",
}
Rows = NDArray[np.int64]


class BinaryReader:
    """Reads some fields of all messages of one type, which stands among its definitions with all types in it."""

    def __init__(
        self, definitions: Mapping[str, Definition], type_name: str, paths: Sequence[str], wire: Wire = CDR
    ) -> None:
        self._definitions = definitions
        self._type_name = full_name(type_name)
        self._paths = tuple(paths)
        self._wire = wire
        self._layouts: dict[tuple[int, ...], Layout] = {}
        self._numbers: dict[tuple[int, ...], Numbers] = {}
        self._latest: Layout | None = None
        self.known = dict(binary_paths(definitions, self._type_name))
        for path in paths:
            check_path(path, self.known, self._type_name)

    def columns(self, block: Block) -> Columns:
        """Read the fields of all messages of a block, shape (k, n); shorter sequences are filled up with NaN."""
        parts = list(self.groups(block))
        return {path: _joined([(rows, columns[path]) for rows, _, columns in parts]) for path in self._paths}

    def groups(self, block: Block) -> Iterator[tuple[Rows, Layout, Columns]]:
        """Read the messages of a block that share a layout, group after group: which they are, and their fields."""
        data = np.frombuffer(block.buffer, np.uint8)
        left = np.arange(len(block))
        while left.size:
            rows, layout, columns = self._next_group(block, data, left)
            yield rows, layout, columns
            left = left[:0] if rows.size == left.size else np.setdiff1d(left, rows, assume_unique=True)

    def _check_encapsulation(self, block: Block, data: NDArray[np.uint8]) -> None:
        if np.any(block.sizes < len(ENCAPSULATION)):
            raise LogError(f"a message of {block.sizes.min()} bytes is no CDR", "the log is damaged")
        kinds = gather(data, block.offsets, WORD)
        wrong = kinds[kinds != LITTLE_ENDIAN]
        if wrong.size:
            second, first = divmod(int(wrong[0]), 256)
            name = _ENCAPSULATIONS.get(second, "no CDR") if first == 0 else "no CDR"
            raise LogError(
                f"{wrong.size} of {kinds.size} messages are {name} "
                f"(they start with bytes '{first:02x} {second:02x}'), not little-endian CDR",
                "record with the default middleware, or convert the log with `ros2 bag convert`",
            )

    def _next_group(self, block: Block, data: NDArray[np.uint8], left: Rows) -> tuple[Rows, Layout, Columns]:
        """Read all messages that share a layout: the latest one if any has it, else that of the first message."""
        if self._latest is not None:
            rows, columns = self._with_layout(block, data, left, self._latest)
            if rows.size:
                return rows, self._latest, columns
        if self._wire.head:
            self._check_encapsulation(block, data)
        layout = self._latest = self._layout(block, int(left[0]))
        rows, columns = self._with_layout(block, data, left, layout)
        if not rows.size:
            raise LogError(
                f"a message of {block.sizes[left[0]]} bytes has {layout.size} by its schema ({self._type_name})",
                "the schema in the log is not that of the messages",
            )
        return rows, layout, columns

    def _with_layout(self, block: Block, data: NDArray[np.uint8], rows: Rows, layout: Layout) -> tuple[Rows, Columns]:
        """Read those of some messages that have a layout: its size, apart from padding at the end, and its lengths."""
        # All that is read of a message lies inside its record, since none is shorter than the layout.
        padding = block.sizes[rows] - layout.size
        rows = _chosen(rows, (padding >= 0) & (padding <= self._wire.most_padding))
        fits, columns = self._numbers_of(layout).read(data, block.offsets[rows])
        return _chosen(rows, fits), columns

    def _layout(self, block: Block, row: int) -> Layout:
        start = int(block.offsets[row])
        message = block.buffer[start : start + int(block.sizes[row])]
        lengths = dynamic_lengths(self._definitions, self._type_name, message, self._wire)
        if lengths not in self._layouts:
            self._layouts[lengths] = layout_of(self._definitions, self._type_name, lengths, self._wire)
        return self._layouts[lengths]

    def _numbers_of(self, layout: Layout) -> Numbers:
        if layout.lengths not in self._numbers:
            self._numbers[layout.lengths] = Numbers(layout, self._paths, self._wire)
        return self._numbers[layout.lengths]


def _chosen(rows: Rows, mask: NDArray[np.bool_]) -> Rows:
    """Return some of the rows; mostly it is all of them, which spares a copy."""
    return rows if mask.all() else rows[mask]


WIRES: Final = {"cdr": CDR, "ros1": ROS1}
"""By the names of the encodings in MCAP, https://mcap.dev/spec/registry."""


@cache
def definitions_by(type_name: str, schema_text: str, encoding: str, schema_encoding: str = "") -> dict[str, Definition]:
    """Parse a schema; one of ROS 2 that is empty is that of a known type, and so are the types that a .msg lacks."""
    if schema_encoding == "ros2idl":
        from insdvl_replay.logs.encoding.ros2idl import parse_idl

        return parse_idl(type_name, schema_text)
    if encoding == "ros1":
        return parse_definitions(type_name, schema_text, ROS1MSG)
    text = schema_text if schema_text.strip() else definition_text(type_name)
    return parse_definitions(type_name, completed_text(type_name, text))


def binary_paths(definitions: Mapping[str, Definition], type_name: str, prefix: str = "") -> Iterator[tuple[str, str]]:
    """List every path that a type knows."""
    for field in definitions[type_name].fields:
        path = f"{prefix}{field.name}"
        yield path, field.type_name
        if field.kind != "single":
            path = f"{path}[*]"
            yield path, field.type_name
        if field.type_name not in PRIMITIVES and field.type_name in definitions:
            yield from binary_paths(definitions, field.type_name, f"{path}.")


def _joined(parts: Sequence[tuple[Rows, NDArray[Any]]]) -> NDArray[Any]:
    """Bring the rows of several layouts into the order of the messages."""
    if len(parts) == 1:
        return parts[0][1]
    count, width = sum(rows.size for rows, _ in parts), max((values.shape[1] for _, values in parts), default=0)
    same = all(values.shape[1] == width and values.dtype == np.int64 for _, values in parts)
    joined = np.zeros((count, width), np.int64) if same else np.full((count, width), np.nan)
    for rows, values in parts:
        joined[rows, : values.shape[1]] = values
    return joined
