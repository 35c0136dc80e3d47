"""The numbers of CDR messages that field paths mean: where they stand in a layout, and what they are.

Numbers that stand near each other are copied out of all messages of a block in one step.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from operator import itemgetter
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.container.blocks import gather
from insdvl_replay.logs.encoding.field_paths import Columns
from insdvl_replay.logs.encoding.layout import ENCAPSULATION, Layout

LITTLE_ENDIAN: Final = int.from_bytes(ENCAPSULATION[:2], "little")
"""The first word of messages that can be read."""
WORD: Final = np.dtype("<u2")
"""How it stands there."""
MOST_NUMBERS: Final = 1 << 16
"""Numbers that are read of one message; a sensor gives some hundreds."""

_LENGTH: Final = np.dtype("<u4")
_NEAR: Final = 16
"""Bytes between numbers that are copied along; to go to each message once more takes longer."""


class _Leaf(NamedTuple):
    """Numbers of one kind, side by side in each message."""

    start: int
    dtype: np.dtype[Any]

    @property
    def end(self) -> int:
        """Where the bytes behind them begin."""
        return self.start + self.dtype.itemsize


class Numbers:
    """The numbers in the messages of one layout that some paths mean.

    Raises
    ------
    LogError
        They mean more than `MOST_NUMBERS`.
    """

    def __init__(self, layout: Layout, paths: Sequence[str]) -> None:
        self._words = [LITTLE_ENDIAN, *layout.lengths]
        leaves = [_Leaf(0, WORD), *(_Leaf(offset, _LENGTH) for offset in layout.length_offsets)]
        self._rows: dict[str, range] = {}
        numbers = len(leaves)
        for path in paths:
            first = len(leaves)
            for dtype, start in _leaves(layout.dtype, path):
                leaves.append(_Leaf(start, dtype))
                numbers += dtype.itemsize // dtype.base.itemsize
                if numbers > MOST_NUMBERS:
                    raise LogError(f"'{path}' means more than {MOST_NUMBERS} numbers of a message", "name fewer")
            self._rows[path] = range(first, len(leaves))
        self._leaves = leaves
        self._neighbours = list(_neighbours(leaves))

    def read(self, data: NDArray[np.uint8], starts: NDArray[np.int64]) -> tuple[NDArray[np.bool_], Columns]:
        """Read messages that have the size of the layout: which of them have it, and the numbers of these by path."""
        found: dict[str, NDArray[Any]] = {}
        for start, dtype in self._neighbours:
            copied = gather(data, starts + start, dtype)
            found |= {name: copied[name] for name in dtype.names or ()}
        fits = np.ones(starts.size, np.bool_)
        for row, word in enumerate(self._words):
            fits &= found[str(row)] == word
        if not fits.all():
            found = {name: values[fits] for name, values in found.items()}
        count = int(np.count_nonzero(fits))
        return fits, {
            path: _side_by_side([found[str(row)] for row in rows], count) for path, rows in self._rows.items()
        }


def _neighbours(leaves: Sequence[_Leaf]) -> Iterator[tuple[int, np.dtype[np.void]]]:
    """Part numbers where many bytes stand between them: where each part starts, and what stands in it, by row."""
    part: dict[int, _Leaf] = {}
    end = 0
    for row, leaf in sorted(enumerate(leaves), key=itemgetter(1)):
        if part and leaf.start - end > _NEAR:
            yield _structure(part, end)
            part = {}
        part[row] = leaf
        end = max(end, leaf.end)
    yield _structure(part, end)


def _structure(part: dict[int, _Leaf], end: int) -> tuple[int, np.dtype[np.void]]:
    start = min(leaf.start for leaf in part.values())
    columns: Any = {
        "names": list(map(str, part)),
        "formats": [leaf.dtype for leaf in part.values()],
        "offsets": [leaf.start - start for leaf in part.values()],
        "itemsize": end - start,
    }
    return start, np.dtype(columns)


def _side_by_side(parts: Iterable[NDArray[Any]], count: int) -> NDArray[Any]:
    """Set numbers side by side, shape (k, n), as integers if all are whole."""
    columns = [_numbers(part if part.ndim > 1 else part[:, None]) for part in parts]
    if not columns:
        return np.empty((count, 0), np.int64)
    dtype = np.dtype(np.int64 if all(column.dtype.kind in "iu" for column in columns) else np.float64)
    return (
        columns[0].astype(dtype)
        if len(columns) == 1
        else np.concatenate(columns, axis=1, dtype=dtype, casting="unsafe")
    )


def _numbers(values: NDArray[Any]) -> NDArray[Any]:
    """Return whole numbers for flags, of which any byte but zero is true."""
    return np.asarray(values.view(np.uint8) != 0, np.int64) if values.dtype.kind == "b" else values


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
