"""Binary records that tell how long they are and end with a sum of their bytes, and what lies between them.

A record has two bytes by which it begins, the number of its bytes before the sum (16 bits, the smaller byte first),
its content, and the sum of all these bytes, of which 16 bits are kept.
"""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Array, Integers
from insdvl_replay.logs.formats.instrument_file import InstrumentFile, Record

_LONGEST: Final = (1 << 16) + 1  # bytes of a record
_SUM: Final = 2  # bytes of the sum
_MOST_COUNTED: Final = 10_000  # damaged records of one gap


def checked_records(
    file: InstrumentFile,
    heads: Sequence[bytes],
    fewest: int,
) -> Iterator[list[Record]]:
    """Give the sound records, some megabytes at a time; what is damaged between them is lost.

    Parameters
    ----------
    file : InstrumentFile
        Whose bytes are searched.
    heads : sequence of bytes
        Two bytes each, by one of which a record begins.
    fewest : int
        Bytes that a record has at least, without its sum.
    """
    gap = _Gap(file, heads)
    rest = b""
    for start, piece in file.pieces():
        text = rest + piece
        first = start - len(rest)
        # A record that begins behind this place may go on in the next piece.
        until = max(0, len(text) - _LONGEST)
        if start + len(piece) == len(file.file):
            until = len(text)
        records: list[Record] = []
        place = 0
        for begin, end in _sound(text, heads, fewest, until):
            # What looks like a record inside another one is its content.
            if begin < place:
                continue
            gap.add(first + place, text[place:begin])
            gap.close(end - begin)
            records.append(Record(first + begin, text[begin:end]))
            place = end
        left = max(place, until)
        gap.add(first + place, text[place:left])
        rest = text[left:]
        yield records
    gap.close(0)


class _Gap:
    """What lies between two sound records: damaged ones, or bytes of something else."""

    def __init__(
        self,
        file: InstrumentFile,
        heads: Sequence[bytes],
    ) -> None:
        self._file = file
        self._heads = heads
        self._size = 0
        self._usual = 0  # bytes of the record before
        self._damaged_at: int | None = None  # where the first record in it begins

    def add(
        self,
        offset: int,
        content: bytes,
    ) -> None:
        """Take more bytes of it."""
        self._size += len(content)
        if self._damaged_at is not None:
            return
        places = [content.find(head) for head in self._heads]
        found = [place for place in places if place >= 0]
        if found:
            self._damaged_at = offset + min(found)

    def close(self, next_size: int) -> None:
        """Report it; the size of the record behind it tells how many are lost in a long one."""
        usual = self._usual or next_size or self._size
        self._usual = next_size
        if self._damaged_at is not None:
            count = max(1, round(self._size / usual))
            for _ in range(min(count, _MOST_COUNTED)):
                self._file.lose(self._damaged_at, "a record is cut, or its checksum is wrong")
        elif self._size:
            self._file.pass_over(f"bytes between {self._file.records}")
        self._size = 0
        self._damaged_at = None


def _sound(
    text: bytes,
    heads: Sequence[bytes],
    fewest: int,
    until: int,
) -> Iterator[tuple[int, int]]:
    """Give begin and end of what is a record by its length and its sum, and begins before a place."""
    values = np.frombuffer(text, np.uint8)
    begins = _places(values, heads)
    begins = begins[(begins < until) & (begins + fewest + _SUM <= len(values))]
    lengths = _words(values, begins + 2)
    sum_at = begins + lengths
    fits = (lengths >= fewest) & (sum_at + _SUM <= len(values))
    begins = begins[fits]
    sum_at = sum_at[fits]
    summed = np.zeros(len(values) + 1, np.int64)
    np.cumsum(values, dtype=np.int64, out=summed[1:])
    sums = (summed[sum_at] - summed[begins]) & 0xFFFF
    right = sums == _words(values, sum_at)
    ends = sum_at[right] + _SUM
    yield from zip(begins[right].tolist(), ends.tolist(), strict=True)


def _places(
    values: Array,
    heads: Sequence[bytes],
) -> Integers:
    """Return where heads are, in order."""
    is_head = np.zeros(max(0, len(values) - 1), np.bool_)
    for first, second in heads:
        is_head |= (values[:-1] == first) & (values[1:] == second)
    return np.flatnonzero(is_head)


def _words(
    values: Array,
    places: Integers,
) -> Integers:
    """Return numbers of 16 bits, the smaller byte first."""
    return values[places].astype(np.int64) | values[places + 1].astype(np.int64) << 8
