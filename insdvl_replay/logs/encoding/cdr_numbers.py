"""The numbers of CDR messages that field paths mean: where they stand in a layout, and what their bits say."""

import math
import re
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.compiled import is_loaded
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

Bits = NDArray[np.int64]
"""Of n numbers in k messages, shape (n, k)."""

_Run = tuple[slice, np.dtype[Any]]
"""Numbers of one kind that stand side by side among the bits."""


class Numbers:
    """The numbers in the messages of one layout that some paths mean.

    Raises
    ------
    LogError
        They mean more than `MOST_NUMBERS`.
    """

    def __init__(self, layout: Layout, paths: Sequence[str]) -> None:
        self._words = np.array([LITTLE_ENDIAN, *layout.lengths])[:, None]
        places = [*_places(WORD, 0)]
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
        self._places = np.array(places, np.int64).T.copy()

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
