"""The numbers of CDR messages that field paths mean: where they stand in a layout, and what their bits say."""

import math
import re
from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.compiled import is_loaded
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.container.blocks import gather
from insdvl_replay.logs.encoding.field_paths import Columns
from insdvl_replay.logs.encoding.layout import ENCAPSULATION, Layout

LITTLE_ENDIAN: Final = int.from_bytes(ENCAPSULATION[:2], "little")
"""The first word of messages that can be read."""

Bits = NDArray[np.int64]
"""Of n numbers in k messages, shape (n, k)."""


class Places(NamedTuple):
    """Where numbers stand in a message, and how.

    Attributes
    ----------
    start, size : ndarray, shape (n,)
        Bytes in front of each number, and those of its own: 1, 2, 4 or 8.
    signed : ndarray of bool, shape (n,)
        Whether it is a signed whole number.
    """

    start: NDArray[np.int64]
    size: NDArray[np.int64]
    signed: NDArray[np.bool_]


MOST_NUMBERS: Final = 1 << 16
"""Numbers that are read of one message; a sensor gives some hundreds."""

_Run = tuple[slice, np.dtype[Any]]
"""Numbers of one kind that stand side by side."""


class Numbers:
    """The numbers in the messages of one layout that some paths mean.

    Parameters
    ----------
    layout : Layout
    paths : sequence of str

    Raises
    ------
    LogError
        They mean more than `MOST_NUMBERS`.
    """

    def __init__(self, layout: Layout, paths: Sequence[str]) -> None:
        self._runs: dict[str, list[_Run]] = {path: [] for path in paths}
        self._words = np.array([LITTLE_ENDIAN, *layout.lengths])[:, None]
        end = len(self._words)
        starts, sizes = [np.array([0, *layout.length_offsets])], [np.array([2] + [4] * len(layout.lengths))]
        signed = [np.zeros(end, np.bool_)]
        for path, runs in self._runs.items():
            for dtype, start in _leaves(layout.dtype, path):
                count, size = math.prod(dtype.shape), dtype.base.itemsize
                if end + count > MOST_NUMBERS:
                    raise LogError(f"'{path}' means more than {MOST_NUMBERS} numbers of a message", "name fewer")
                starts.append(start + size * np.arange(count))
                sizes.append(np.full(count, size))
                signed.append(np.full(count, dtype.base.kind == "i"))
                first = runs.pop()[0].start if runs and runs[-1][1] == dtype.base else end
                end += count
                runs.append((slice(first, end), dtype.base))
        self._places = Places(np.concatenate(starts), np.concatenate(sizes), np.concatenate(signed))

    def read(self, data: NDArray[np.uint8], starts: NDArray[np.int64]) -> tuple[NDArray[np.bool_], Columns]:
        """Read messages that have the size of the layout: which of them have it, and the numbers of these by path."""
        bits = read_bits(data, starts, self._places)
        fits = np.asarray((bits[: len(self._words)] == self._words).all(axis=0))
        bits = bits if fits.all() else bits[:, fits]
        return fits, {path: _meant(bits, runs) for path, runs in self._runs.items()}


def read_bits(data: NDArray[np.uint8], starts: NDArray[np.int64], places: Places) -> Bits:
    """Read little-endian numbers of messages.

    Parameters
    ----------
    data : ndarray of uint8
    starts : ndarray, shape (k,)
        Where in the data each message starts.
    places : Places
        Of n numbers in each message; all of them lie in the data.

    Returns
    -------
    ndarray, shape (n, k)
        Their bits, number by number; those of a signed one are filled up so that it stays the same.
    """
    if is_loaded():
        from insdvl_replay.logs.encoding import field_loops

        return field_loops.read_bits(data, starts, places)
    return bits_plainly(data, starts, places)


def bits_plainly(data: NDArray[np.uint8], starts: NDArray[np.int64], places: Places) -> Bits:
    """Do what `read_bits` does without the compiler, whose loading would take longer than to read a few messages."""
    bits = np.empty((places.start.size, starts.size), np.int64)
    for i, (start, size, signed) in enumerate(zip(*(column.tolist() for column in places), strict=True)):
        bits[i] = gather(data, starts + start, np.dtype(f"<{'i' if signed else 'u'}{size}"))
    return bits


def _meant(bits: Bits, runs: Sequence[_Run]) -> NDArray[Any]:
    """Give the numbers that bits mean, whole ones as integers if all are whole."""
    parts = [_numbers(bits[numbers], dtype) for numbers, dtype in runs]
    return (parts[0] if len(parts) == 1 else np.concatenate([bits[:0], *parts])).T


def _numbers(bits: Bits, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Give int64 or float64 for the bits of numbers of one kind."""
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
