"""Records of ArduPilot's DataFlash logs (.BIN): two bytes, the number of a kind, and values laid out by a record FMT.

There is no checksum, so a record counts where it ends at the next one or at the end of the file. Behind damage the
reading goes on at the next record that does. Sources: ArduPilot/ardupilot@014a9c4, libraries/AP_Logger/LogStructure.h
and README.md, the table of format letters. The multipliers of the records FMTU repeat what these letters say.
"""

import re
import struct
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Array, Floats, Integers, Mask, TimeNs
from insdvl_replay.core.errors import counted_clause
from insdvl_replay.logs.formats.instrument_file import InstrumentFile

Bytes = NDArray[np.uint8]
_HEAD: Final = (0xA3, 0x95)
_HEAD_SIZE: Final = 3
_FORMAT_KIND: Final = 128
_FORMAT: Final = struct.Struct("<3xBB4s16s64s")  # kind, size, name, letters, labels
_FORMAT_HEAD: Final = re.compile(rb"\xa3\x95\x80", re.DOTALL)
_LONGEST: Final = 1 << 8  # a size is one byte
_PIECE: Final = 1 << 22  # bytes that are decoded at a time
# What the letters of a format stand for, and what the numbers are multiplied with.
_LETTERS: Final = {
    "a": ("(32,)<i2", 1.0), "b": ("i1", 1.0), "B": ("u1", 1.0), "h": ("<i2", 1.0), "H": ("<u2", 1.0),
    "i": ("<i4", 1.0), "I": ("<u4", 1.0), "q": ("<i8", 1.0), "Q": ("<u8", 1.0), "f": ("<f4", 1.0),
    "d": ("<f8", 1.0), "g": ("<f2", 1.0), "n": ("S4", 1.0), "N": ("S16", 1.0), "Z": ("S64", 1.0),
    "c": ("<i2", 0.01), "C": ("<u2", 0.01), "e": ("<i4", 0.01), "E": ("<u4", 0.01), "L": ("<i4", 1e-7),
    "M": ("u1", 1.0),
}  # fmt: skip


class Layout(NamedTuple):
    """How the records of a kind are laid out."""

    name: str
    dtype: np.dtype[Any]
    factors: dict[str, float]  # by label


class Records(NamedTuple):
    """All records of a kind."""

    offsets: TimeNs  # (k,), bytes from the begin of the file
    rows: Array  # (k,), structured
    factors: dict[str, float]

    def has(self, *labels: str) -> bool:
        """Return whether the records have all of some values."""
        return set(labels) <= self.factors.keys()

    def values(self, label: str) -> Floats:
        """Return the values with a label, (k,)."""
        return self.rows[label].astype(np.float64) * self.factors[label]

    def whole(self, label: str) -> Integers:
        """Return the values with a label as whole numbers, (k,)."""
        return self.rows[label].astype(np.int64)

    def chosen(self, rows: Array) -> "Records":
        """Return some of the records, by a mask or their numbers."""
        return Records(self.offsets[rows], self.rows[rows], self.factors)


def layout_of(record: bytes) -> tuple[int, Layout] | None:
    """Return the number of a kind and its layout, as a record FMT tells them; None where they cannot be."""
    if len(record) < _FORMAT.size:
        return None
    kind, size, *texts = _FORMAT.unpack_from(record)
    name, letters, joined = [text.rstrip(b"\0").decode("ascii", "replace") for text in texts]
    labels = joined.split(",") if joined else []
    is_named = name.isidentifier() and all(label.isidentifier() for label in labels)
    if not is_named or not set(letters) <= _LETTERS.keys() or not letters:
        return None
    if len(labels) != len(letters) or len(set(labels)) < len(labels):
        return None
    fields: list[tuple[str, str]] = [("head ", f"V{_HEAD_SIZE}")]
    factors: dict[str, float] = {}
    for label, letter in zip(labels, letters, strict=True):
        number_type, factor = _LETTERS[letter]
        fields.append((label, number_type))
        if not number_type.startswith(("S", "(")):
            factors[label] = factor
    dtype = np.dtype(fields)
    if dtype.itemsize != size:
        return None
    return kind, Layout(name, dtype, factors)


class DataflashFile(InstrumentFile):
    """A file of such records; a class for what they mean has `tables`."""

    records = "records"

    def read_records(self, wanted: frozenset[str]) -> dict[str, Records]:
        """Return the records of some kinds by their names; the others are passed over."""
        layouts = self._layouts()
        sizes = np.zeros(_LONGEST, np.int64)
        sizes[_FORMAT_KIND] = _FORMAT.size
        for kind, layout in layouts.items():
            sizes[kind] = layout.dtype.itemsize
        offsets: dict[int, list[TimeNs]] = {}
        rows: dict[int, list[Array]] = {}
        for place, data, heads in self._heads(sizes):
            kinds = data[heads + 2]
            for kind in np.unique(kinds).tolist():
                starts = heads[kinds == kind]
                if kind == _FORMAT_KIND:
                    self._check_formats(place, data, starts, layouts)
                elif layouts[kind].name in wanted:
                    offsets.setdefault(kind, []).append(place + starts)
                    rows.setdefault(kind, []).append(_rows(data, starts, layouts[kind].dtype))
                else:
                    self.pass_over(layouts[kind].name, len(starts))
        found: dict[str, Records] = {}
        for kind, parts in rows.items():
            name, _, factors = layouts[kind]
            at = np.concatenate(offsets[kind])
            found[name] = Records(at, np.concatenate(parts), factors)
        return found

    def _layouts(self) -> dict[int, Layout]:
        """Return the layouts of all kinds; a kind has that of its first record FMT."""
        layouts: dict[int, Layout] = {}
        names: set[str] = set()
        for start in range(0, len(self.file), _PIECE):
            data = bytes(self.file.read(start, start + _PIECE + _FORMAT.size))
            for head in _FORMAT_HEAD.finditer(data):
                found = layout_of(data[head.start() : head.start() + _FORMAT.size])
                if found is None or found[0] in layouts or found[1].name in names:
                    continue
                if found[0] != _FORMAT_KIND:
                    layouts[found[0]] = found[1]
                    names.add(found[1].name)
        return layouts

    def _heads(self, sizes: TimeNs) -> Iterator[tuple[int, Bytes, TimeNs]]:
        """Give pieces of the file, their places, and where records begin in them, (k,); what is none is lost."""
        place = 0
        while place < len(self.file):
            data = np.frombuffer(self.file.read(place, place + _PIECE + 2 * _LONGEST), np.uint8)
            is_last = place + len(data) == len(self.file)
            heads = _records_in(data, sizes, is_last=is_last)
            if not is_last:
                heads = heads[heads < _PIECE]
            ends = heads + sizes[data[heads + 2]]
            reached = len(data) if is_last else _PIECE
            if len(ends):
                reached = max(reached, int(ends[-1]))
            self._lose_gaps(place, np.append(0, ends), np.append(heads, reached))
            yield place, data, heads
            place += reached

    def _lose_gaps(
        self,
        place: int,
        begins: TimeNs,
        ends: TimeNs,
    ) -> None:
        """Lose the bytes between records."""
        for gap in np.flatnonzero(ends > begins).tolist():
            count = int(ends[gap] - begins[gap])
            what = counted_clause(count, "bytes are no record of a known format")
            # There were at least so many.
            self.lose(place + int(begins[gap]), what, 1 + count // _LONGEST)

    def _check_formats(
        self,
        place: int,
        data: Bytes,
        starts: TimeNs,
        layouts: dict[int, Layout],
    ) -> None:
        """Lose records FMT that cannot be, or that contradict the first one of their kind."""
        for start in starts.tolist():
            found = layout_of(data[start : start + _FORMAT.size].tobytes())
            if found is None:
                self.lose(place + start, "a record FMT tells no layout")
            elif found[0] != _FORMAT_KIND and layouts.get(found[0]) != found[1]:
                self.lose(place + start, f"a record FMT tells another layout of {found[1].name}")


def _records_in(data: Bytes, sizes: TimeNs, *, is_last: bool) -> TimeNs:
    """Return where the records begin in a piece, (k,): those that end where another one begins, or the file."""
    heads = np.flatnonzero((data[:-2] == _HEAD[0]) & (data[1:-1] == _HEAD[1]))
    heads = heads[sizes[data[heads + 2]] > 0]
    ends = heads + sizes[data[heads + 2]]
    begins: Mask = np.zeros(len(data) + _LONGEST, np.bool_)
    begins[heads] = True
    begins[len(data)] = is_last
    is_followed = begins[ends]
    heads = heads[is_followed]
    ends = ends[is_followed]
    return np.asarray(heads[_are_outside(heads, ends)])


def _are_outside(heads: TimeNs, ends: TimeNs) -> Mask:
    """Find the records, (k,), that begin within no other one: two bytes of its values may look like a head."""
    are_outside = np.ones(len(heads), np.bool_)
    reached = np.maximum.accumulate(ends)
    overlapping = 1 + np.flatnonzero(heads[1:] < reached[:-1])
    last = 0
    for number in overlapping.tolist():
        # What is within another one covers nothing itself.
        if are_outside[number - 1]:
            last = number - 1
        are_outside[number] = heads[number] >= ends[last]
    return are_outside


def _rows(data: Bytes, starts: TimeNs, dtype: np.dtype[Any]) -> Array:
    """Return records of one kind as rows, (k,)."""
    places = starts[:, None] + np.arange(dtype.itemsize)
    return np.asarray(data[places].view(dtype)[:, 0])
