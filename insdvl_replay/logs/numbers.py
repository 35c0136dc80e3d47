"""The numbers of CDR messages that field paths mean: where they stand in a layout, and what their bits say."""

import math
import re
import sys
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.logs.chunks import gather
from insdvl_replay.logs.field_paths import Columns
from insdvl_replay.logs.layout import Layout


class Numbers:
    """The numbers in the messages of one layout that some paths mean.

    Parameters
    ----------
    layout : Layout
    paths : sequence of str
    """

    def __init__(self, layout: Layout, paths: Sequence[str]) -> None:
        self._columns: dict[str, slice] = {}
        self._dtypes: list[np.dtype[Any]] = []
        places: list[int] = []
        for path in paths:
            first = len(places)
            for dtype, place in _leaves(layout.dtype, path):
                count = math.prod(dtype.shape)
                places += range(place, place + count * dtype.base.itemsize, dtype.base.itemsize)
                self._dtypes += [dtype.base] * count
            self._columns[path] = slice(first, len(places))
        self._places = np.array(places, np.int64)
        self._sizes = np.array([dtype.itemsize for dtype in self._dtypes], np.int64)
        self._signed = np.array([dtype.kind == "i" for dtype in self._dtypes], np.bool_)

    def read(self, data: NDArray[np.uint8], starts: NDArray[np.int64]) -> Columns:
        """Read the numbers of messages that have the layout, by path."""
        bits = read_bits(data, starts, self._places, self._sizes, self._signed)
        return {path: _meant(bits[:, part], self._dtypes[part]) for path, part in self._columns.items()}


def read_bits(
    data: NDArray[np.uint8],
    starts: NDArray[np.int64],
    places: NDArray[np.int64],
    sizes: NDArray[np.int64],
    signed: NDArray[np.bool_],
) -> NDArray[np.int64]:
    """Read little-endian numbers of messages.

    Parameters
    ----------
    data : ndarray of uint8
    starts : ndarray, shape (k,)
        Where in the data each message starts.
    places, sizes : ndarray, shape (n,)
        Where in a message each number starts, and how many bytes it has: 1, 2, 4 or 8. All of them lie in the data.
    signed : ndarray of bool, shape (n,)
        Whether it is a signed whole number.

    Returns
    -------
    ndarray, shape (k, n)
        Their bits; those of a signed number are filled up so that it stays the same.
    """
    if "numba" in sys.modules:
        from insdvl_replay.logs import field_loops

        return field_loops.read_bits(data, starts, places, sizes, signed)
    return bits_plainly(data, starts, places, sizes, signed)


def bits_plainly(
    data: NDArray[np.uint8],
    starts: NDArray[np.int64],
    places: NDArray[np.int64],
    sizes: NDArray[np.int64],
    signed: NDArray[np.bool_],
) -> NDArray[np.int64]:
    """Do what `read_bits` does without the compiler, whose loading would take longer than to read a few messages."""
    bits = np.empty((starts.size, places.size), np.int64)
    for i, (place, size, sign) in enumerate(zip(places.tolist(), sizes.tolist(), signed.tolist(), strict=True)):
        bits[:, i] = gather(data, starts + place, np.dtype(f"<{'i' if sign else 'u'}{size}"))
    return bits


def _meant(bits: NDArray[np.int64], dtypes: Sequence[np.dtype[Any]]) -> NDArray[Any]:
    """Give the numbers that bits mean, whole ones as integers if all are whole."""
    if all(dtype.kind in "biu" for dtype in dtypes):
        return bits
    if all(dtype == np.float64 for dtype in dtypes):
        return bits.view(np.float64)
    columns = np.empty(bits.shape)
    for i, dtype in enumerate(dtypes):
        columns[:, i] = bits[:, i].astype(f"u{dtype.itemsize}").view(dtype)
    return columns


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
