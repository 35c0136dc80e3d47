"""Columns of chosen fields, from the bytes of a block of messages.

Messages whose strings and sequences have the same lengths share one `layout`, and are read together. In most logs all
messages of a channel do.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.container.blocks import Block, gather
from insdvl_replay.logs.encoding.cdr_numbers import LITTLE_ENDIAN, WORD, Numbers
from insdvl_replay.logs.encoding.field_paths import Columns, check_path
from insdvl_replay.logs.encoding.layout import ENCAPSULATION, Layout, dynamic_lengths, layout_of
from insdvl_replay.logs.encoding.ros2msg import PRIMITIVES, Definition, full_name

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
_LONGEST_PADDING: Final = 3

Rows = NDArray[np.int64]


class CdrReader:
    """Reads some fields of all messages of one type.

    Parameters
    ----------
    definitions : mapping of str to Definition
        The type and all types in it.
    type_name : str
        Type of the messages.
    paths : sequence of str
        The fields, as `field_paths` says.

    Raises
    ------
    LogError
        The type has no such field.
    """

    def __init__(self, definitions: Mapping[str, Definition], type_name: str, paths: Sequence[str]) -> None:
        self._definitions = definitions
        self._type_name = full_name(type_name)
        self._paths = tuple(paths)
        self._layouts: dict[tuple[int, ...], Layout] = {}
        self._numbers: dict[tuple[int, ...], Numbers] = {}
        self._latest: Layout | None = None
        self.known = dict(cdr_paths(definitions, self._type_name))
        for path in paths:
            check_path(path, self.known, self._type_name)

    def columns(self, block: Block) -> Columns:
        """Read the fields of all messages of a block.

        Returns
        -------
        dict of str to ndarray, shape (k, n)
            By path. Messages whose sequences are shorter than others' are filled up with NaN.
        """
        data = np.frombuffer(block.buffer, np.uint8)
        parts: list[tuple[Rows, Columns]] = []
        left = np.arange(len(block))
        while left.size:
            rows, columns = self._next_group(block, data, left)
            parts.append((rows, columns))
            left = left[:0] if rows.size == left.size else np.setdiff1d(left, rows, assume_unique=True)
        return {path: _joined([(rows, columns[path]) for rows, columns in parts]) for path in self._paths}

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

    def _next_group(self, block: Block, data: NDArray[np.uint8], left: Rows) -> tuple[Rows, Columns]:
        """Read all messages that share a layout: the latest one if any has it, else that of the first message."""
        if self._latest is not None:
            rows, columns = self._with_layout(block, data, left, self._latest)
            if rows.size:
                return rows, columns
        self._check_encapsulation(block, data)
        layout = self._latest = self._layout(block, int(left[0]))
        rows, columns = self._with_layout(block, data, left, layout)
        if not rows.size:
            raise LogError(
                f"a message of {block.sizes[left[0]]} bytes has {layout.size} by its schema ({self._type_name})",
                "the schema in the log is not that of the messages",
            )
        return rows, columns

    def _with_layout(self, block: Block, data: NDArray[np.uint8], rows: Rows, layout: Layout) -> tuple[Rows, Columns]:
        """Read those of some messages that have a layout: its size, apart from padding at the end, and its lengths."""
        # All that is read of a message lies inside its record, since none is shorter than the layout.
        padding = block.sizes[rows] - layout.size
        rows = _chosen(rows, (padding >= 0) & (padding <= _LONGEST_PADDING))
        fits, columns = self._numbers_of(layout).read(data, block.offsets[rows])
        return _chosen(rows, fits), columns

    def _layout(self, block: Block, row: int) -> Layout:
        start = int(block.offsets[row])
        message = block.buffer[start : start + int(block.sizes[row])]
        lengths = dynamic_lengths(self._definitions, self._type_name, message)
        if lengths not in self._layouts:
            self._layouts[lengths] = layout_of(self._definitions, self._type_name, lengths)
        return self._layouts[lengths]

    def _numbers_of(self, layout: Layout) -> Numbers:
        if layout.lengths not in self._numbers:
            self._numbers[layout.lengths] = Numbers(layout, self._paths)
        return self._numbers[layout.lengths]


def _chosen(rows: Rows, mask: NDArray[np.bool_]) -> Rows:
    """Return some of the rows; mostly it is all of them, which spares a copy."""
    return rows if mask.all() else rows[mask]


def cdr_paths(definitions: Mapping[str, Definition], type_name: str, prefix: str = "") -> Iterator[tuple[str, str]]:
    """List every path that a type knows."""
    for field in definitions[type_name].fields:
        path = f"{prefix}{field.name}"
        yield path, field.type_name
        if field.kind != "single":
            path = f"{path}[*]"
            yield path, field.type_name
        if field.type_name not in PRIMITIVES and field.type_name in definitions:
            yield from cdr_paths(definitions, field.type_name, f"{path}.")


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
