"""What readers of instruments and autopilots share: records that are decoded as the file is opened, and what is lost.

A reader decodes a file into tables, each a channel with the name of a type of `known_types.toml`, so that roles,
units, axes, checks and clocks are those of any other log. Single records that are damaged are left out, with a note.
Where they are more than few, the file is refused as any damaged log is, unless damage is allowed.
"""

import re
from abc import abstractmethod
from codecs import BOM_UTF8
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import (
    Array,
    Floats,
    Mask,
    TimeNs,
)
from insdvl_replay.core.errors import (
    LogError,
    Note,
    counted_clause,
    listed,
)
from insdvl_replay.core.notes import note
from insdvl_replay.core.units import TIME_UNITS_NS
from insdvl_replay.logs.formats.log_file import (
    Damage,
    FileBytes,
    UnusableFileError,
    damage_note,
)
from insdvl_replay.logs.formats.recorder_clock import one_clock
from insdvl_replay.logs.formats.table_rows import (
    RowsFile,
    clear_missing,
)

LARGEST_FILE: Final = 1 << 31  # bytes; more than any instrument writes of a dive
LONGEST_RECORD: Final = 1 << 20  # bytes; in more without an end there is no record
MOST_NUMBERS: Final = 1 << 28  # that tables hold together: two gigabytes
LATEST_S: Final = 4e9  # differences of times in ns must be whole numbers of 64 bits, too
_PIECE: Final = 1 << 20  # bytes that are decoded at a time
_FEW: Final = 0.05  # share of the records that may be damaged; of more the file is refused
_KEPT: Final = 100  # damaged places that are remembered
_KINDS: Final = 20  # kinds of other records that are told apart
_LINE_END: Final = re.compile(rb"[\r\n]+")


class InstrumentTable(NamedTuple):
    """Records of one kind, decoded."""

    topic: str  # the same in all parts of a dive, so that they are read as one
    type_name: str  # of `known_types.toml`; a type that is not known there is only listed
    time_ns: TimeNs  # (k,), since 1970 or the start of the instrument
    columns: Mapping[
        str, Array
    ]  # by dotted name, (k,) or (k, n); NaN where a record has no number
    period_ns: int = 0  # after which the times repeat, where they have no date


class Record(NamedTuple):
    """The bytes of a record, and where they are in the file."""

    offset: int
    content: bytes


class InstrumentFile(RowsFile):
    """A file as an instrument wrote it; a reader is a class with `tables`."""

    records = "records"  # what the format calls them, for notes
    # What helps where a file has nothing that can be used.
    nothing_hint = (
        "check that the instrument was recorded while it measured, and copy the file again"
    )

    def __init__(self, file: FileBytes) -> None:
        super().__init__(file)
        self._lost: list[Damage] = []
        self._lost_count = 0
        self._others = Counter[str]()
        self._notes: list[Note] = []
        if len(file) > LARGEST_FILE:
            what = f"has {len(file)} bytes; a file of this kind is read up to {LARGEST_FILE}"
            raise LogError(what, "split it at the end of a record, and give the parts", self.path)
        with self.watched():
            numbers = 0
            for table in self.tables():
                numbers += _numbers_of(table)
                self.require_room(numbers)
                self._add(table)
        if not self.channels:
            raise self._nothing_error()

    @abstractmethod
    def tables(self) -> Iterator[InstrumentTable]:
        """Decode the file; what cannot be decoded goes to `lose`, what is of other kinds to `pass_over`."""

    def require_room(self, numbers: int) -> None:
        """Refuse a file whose tables would have too many numbers."""
        if numbers > MOST_NUMBERS:
            what = f"has more than {MOST_NUMBERS} numbers"
            raise LogError(what, "split it, and give the parts", self.path)

    def lose(
        self,
        offset: int,
        found: str,
        count: int = 1,
    ) -> None:
        """Leave out a damaged record, or several, that begin at a place of the file."""
        self._lost_count += count
        if len(self._lost) < _KEPT:
            self._lost.append(Damage(offset, found))

    def pass_over(self, kind: str, count: int = 1) -> None:
        """Leave out sound records of a kind that a replay has no use for."""
        if kind not in self._others and len(self._others) >= _KINDS:
            kind = "others"
        self._others[kind] += count

    def with_times(self, offsets: Floats, time_s: Floats) -> Mask:
        """Return which records have a time that can be, (k,); the others are lost, by their places in the file."""
        known = (time_s >= 0.0) & (time_s < LATEST_S)
        for offset in offsets[~known]:
            self.lose(int(offset), "a record has no time")
        return np.asarray(known)

    def summed_us(self, since_last_ms: Floats) -> Floats:
        """Return times from 0, us, (k,), of records that tell how long after the last one they are, and report it.

        A record that does not tell it has no time, NaN.
        """
        count = len(since_last_ms)
        self.add_note(note("times_summed", count, file=self.path.name, records=self.records))
        known = (since_last_ms >= 0.0) & (since_last_ms < 1e3 * LATEST_S)
        summed_ms = np.cumsum(np.where(known, since_last_ms, 0.0))
        return np.where(known, 1e3 * summed_ms, np.nan)

    def add_note(self, one: Note) -> None:
        """Report something that was assumed."""
        self._notes.append(one)

    def pieces(self) -> Iterator[tuple[int, bytes]]:
        """Give the bytes of the file in its order, some megabytes at a time, with their places."""
        for start in range(0, len(self.file), _PIECE):
            yield start, bytes(self.file.read(start, start + _PIECE))

    def text_records(self, boundary: re.Pattern[bytes] = _LINE_END) -> Iterator[list[Record]]:
        """Give the records of a text, some thousands at a time; they are split as the pattern says.

        The last one may be cut. One that is too long is lost.
        """
        rest = b""
        for start, piece in self.pieces():
            first = start - len(rest)
            text = rest + piece
            if not start and text.startswith(BOM_UTF8):
                text = text.removeprefix(BOM_UTF8)
                first = len(BOM_UTF8)
            parts = _split(text, boundary, first)
            rest = parts.pop().content
            if len(rest) > LONGEST_RECORD:
                end = start + len(piece) - len(rest)
                self.lose(end, f"{len(rest)} bytes without an end of a record")
                rest = b""
            if parts:
                yield parts
        if rest.strip():
            yield [Record(len(self.file) - len(rest), rest)]

    def _add(self, table: InstrumentTable) -> None:
        """Make a channel of a table, of the longest part with one clock."""
        if not len(table.time_ns):
            return
        kept: Mask = np.ones(len(table.time_ns), np.bool_)
        clock = one_clock([table.time_ns])
        if clock is not None:
            kept = clock.holds(table.time_ns)
            self.add_note(clock.note)
        widths: dict[str, int] = {}
        for name, values in table.columns.items():
            widths[name] = 1 if values.ndim == 1 else values.shape[1]
        rows: Floats = np.empty((int(np.count_nonzero(kept)), 1 + sum(widths.values())))
        rows[:, 0] = np.flatnonzero(kept)
        place = 1
        for name, values in table.columns.items():
            end = place + widths[name]
            rows[:, place:end] = values.reshape(len(kept), -1)[kept]
            place = end
        clear_missing(rows)
        channel = self.add_channel(table.topic, table.type_name, widths, rows, table.time_ns[kept])
        if table.period_ns:
            self.periods_ns[channel.id] = table.period_ns

    def shift(self, channel_id: int, shift_ns: int) -> None:
        """Shift the times of a table, which had no date, so that it overlaps the others."""
        self._shift(channel_id, shift_ns)
        days = shift_ns / TIME_UNITS_NS["d"]
        said = note("times_without_date", days=days)
        self.add_note(said.about(self.channels[channel_id].topic))

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was found wrong, and what was assumed."""
        notes = list(self._notes)
        if self.damages:
            notes.append(damage_note(self.path.name, self.damages, "the rest is lost"))
        if self._lost_count:
            lost = f"{counted_clause(self._lost_count, f'{self.records} are lost')}"
            notes.append(damage_note(self.path.name, self._lost, lost))
        if self._others:
            kinds = listed(f"{kind} ({count})" for kind, count in self._others.most_common())
            count = self._others.total()
            said = note(
                "other_records", count, file=self.path.name, records=self.records, kinds=kinds
            )
            notes.append(said)
        return tuple(notes)

    def faults(self) -> list[LogError]:
        """Return the error for a file of which more than few records are damaged."""
        count = self._lost_count
        found = sum(channel.messages for channel in self.channels)
        if count <= max(1.0, _FEW * (found + count)):
            return super().faults()
        place, what = self._lost[0]
        text = f"{count} of {found + count} {self.records} are damaged, the first at byte {place}: {what}"
        return [*super().faults(), LogError(text, "", self.path)]

    def _nothing_error(self) -> UnusableFileError:
        """Return the error for a file without a record that can be used."""
        what = f"has no {self.records} that can be used"
        if self._lost:
            place, found = self._lost[0]
            lost = counted_clause(self._lost_count, f"{self.records} are damaged")
            what += f"; {lost}, the first at byte {place}: {found}"
        if self._others:
            what += f"; it has {listed(self._others)}"
        return UnusableFileError(what, self.nothing_hint, self.path)


def _split(text: bytes, boundary: re.Pattern[bytes], offset: int) -> list[Record]:
    """Split a text into records; the last of them may be empty or cut."""
    records: list[Record] = []
    start = 0
    for end in boundary.finditer(text):
        if end.start() > start:
            records.append(Record(offset + start, text[start : end.start()]))
        start = end.end()
    records.append(Record(offset + start, text[start:]))
    return records


def _numbers_of(table: InstrumentTable) -> int:
    """Return how many numbers a table has, with what its rows need beside them."""
    return sum(values.size for values in table.columns.values()) + 2 * len(table.time_ns)
