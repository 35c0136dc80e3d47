"""The asynchronous log of MOOS, `.alog`: a line for each value that an application published.

A line has the seconds since the start of the log, the name of the variable, the application, and the value, with blanks
between them; lines that begin with a percent sign are comments, of which one has the time of the start. A value is a
number, a matrix such as ``[3x1]{0.1,0.2,0.3}``, or a text; where types are marked, it has ``D:`` or ``S:`` in front.

Sources: the Alog Toolbox of MOOS-IvP, https://oceanai.mit.edu/ivpman/pmwiki/pmwiki.php?n=IvPTools.ALogCmdLine, for the
lines; pLogger of MOOS (themoos/essential-moos) for the comments above them and the marks of types.

The variables of one application whose names begin alike are one table, such as ``DVL`` of ``DVL_VEL_X`` and
``DVL_VEL_Y``. What it publishes within some milliseconds is one row, which is what sensors publish of one reading.
"""

import re
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Array, Floats, Integers
from insdvl_replay.logs.formats.instrument_file import (
    LATEST_S,
    InstrumentFile,
    InstrumentTable,
    Record,
)
from insdvl_replay.logs.formats.table_header import ColumnNames
from insdvl_replay.logs.formats.table_rows import clean_name

TYPE: Final = "table"  # as of tables that users made: settings or the search name the columns
_START: Final = re.compile(rb"%+\s*LOGSTART\s+(.*)", re.DOTALL)
_NUMBER: Final = re.compile(rb"(?:D:)?\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?)")
_MATRIX: Final = re.compile(rb"(?:[DS]:)?\s*\[\s*(\d{1,4})x(\d{1,4})\s*\]\s*\{([^{}]*)\}")
_MOST_VARIABLES: Final = 2_000
_SHOWN: Final = 30  # bytes of what is no time
_WIDEST: Final = 36  # numbers of a matrix
_ONE_ROW_NS: Final = 5_000_000  # within which an application publishes one reading
# Times are those of the clock, and not from the start, where they are later than this part of the start.
_SINCE_1970: Final = 0.5


@dataclass
class _Variable:
    """The values of one variable of one application."""

    name: str
    source: str
    width: int  # numbers of a value
    lines: "array[int]" = field(default_factory=lambda: array("q"))
    times_s: "array[float]" = field(default_factory=lambda: array("d"))
    values: "array[float]" = field(default_factory=lambda: array("d"))


class AlogFile(InstrumentFile):
    """A file of published values."""

    records = "lines"

    def tables(self) -> Iterator[InstrumentTable]:
        """Decode the lines, and gather their variables into tables."""
        # The starts of logs, and how many values are in front of each; before the first one it is not known.
        self._starts_s = [0.0]
        self._begins = [0]
        self._count = 0
        self._variables: dict[tuple[bytes, bytes, int], _Variable] = {}
        for records in self.text_records():
            for record in records:
                self._decode(record)
        groups: dict[tuple[str, str], list[_Variable]] = {}
        for variable in self._variables.values():
            prefix = variable.name.lstrip("_").partition("_")[0] or variable.name
            groups.setdefault((prefix, variable.source), []).append(variable)
        sources = Counter(prefix for prefix, _ in groups)
        for (prefix, source), variables in groups.items():
            topic = prefix
            if sources[prefix] > 1:
                topic = f"{prefix}/{source}"
            yield self._table(topic, variables)

    def _decode(self, record: Record) -> None:
        """Add a line to its variable."""
        text = record.content.strip()
        if not text:
            return
        if text.startswith(b"%"):
            start = _START.fullmatch(text)
            if start:
                self._set_start(record, start[1])
            return
        if record.offset + len(record.content) == len(self.file):
            self.lose(record.offset, "the file ends within a line")
            return
        words = text.split(None, 3)
        time_s = _number(words[0])
        if time_s is None or abs(time_s) >= LATEST_S or len(words) < 3:
            self.lose(record.offset, "a line is no time, variable, application and value")
            return
        if len(words) == 3:
            self.pass_over("empty texts")
            return
        numbers = _numbers_of(words[3])
        if not numbers:
            self.pass_over("texts")
            return
        self._add_value(words[1], words[2], time_s, numbers)

    def _set_start(self, record: Record, text: bytes) -> None:
        """Take the time of the start, since 1970; a file of logs in a row has one for each."""
        start_s = _number(text)
        if start_s is not None and 0.0 <= start_s < LATEST_S:
            self._starts_s.append(start_s)
            self._begins.append(self._count)
        else:
            shown = text[:_SHOWN].decode("utf-8", "replace")
            self.lose(record.offset, f"the start of the log is '{shown}', which is no time in s")

    def _add_value(
        self,
        name: bytes,
        source: bytes,
        time_s: float,
        numbers: Sequence[float],
    ) -> None:
        """Add the numbers of a value to the variable of the application."""
        key = (name, source, len(numbers))
        variable = self._variables.get(key)
        if variable is None:
            if len(self._variables) >= _MOST_VARIABLES:
                self.pass_over(f"variables beyond {_MOST_VARIABLES}")
                return
            variable = _Variable(
                name.decode("utf-8", "replace"), source.decode("utf-8", "replace"), len(numbers)
            )
            self._variables[key] = variable
        variable.lines.append(self._count)
        variable.times_s.append(time_s)
        variable.values.extend(numbers)
        self._count += 1

    def _table(
        self,
        topic: str,
        variables: Sequence[_Variable],
    ) -> InstrumentTable:
        """Make one table of the variables of an application."""
        counts = [len(variable.lines) for variable in variables]
        number = np.repeat(np.arange(len(variables)), counts)
        lines = np.concatenate([np.array(variable.lines, np.int64) for variable in variables])
        times_s = np.concatenate([np.array(variable.times_s) for variable in variables])
        order = np.argsort(lines)
        time_ns = self._since_1970_ns(times_s[order], lines[order])
        row_of = np.empty(len(order), np.int64)
        row_of[order] = _rows(time_ns, number[order])
        is_first = np.diff(row_of[order], prepend=-1) != 0
        width = sum(variable.width for variable in variables)
        self.require_room(width * int(is_first.sum()))
        names = ColumnNames()
        columns: dict[str, Array] = {}
        begin = 0
        for variable, count in zip(variables, counts, strict=True):
            rows = row_of[begin : begin + count]
            begin += count
            values = np.array(variable.values).reshape(count, variable.width)
            column: Floats = np.full((int(is_first.sum()), variable.width), np.nan)
            column[rows] = values
            columns[names.unique(clean_name(variable.name))] = column
        return InstrumentTable(topic, TYPE, time_ns[is_first], columns)

    def _since_1970_ns(self, times_s: Floats, lines: Integers) -> Integers:
        """Return times since 1970, of times from the start of their log or since 1970."""
        of_log = np.searchsorted(self._begins, lines, "right") - 1
        starts_s = np.array(self._starts_s)[of_log]
        if float(np.median(times_s)) > _SINCE_1970 * float(starts_s.max()):
            starts_s[:] = 0.0
        starts_ns = np.rint(starts_s * NS_PER_S).astype(np.int64)
        return np.asarray(starts_ns + np.rint(times_s * NS_PER_S).astype(np.int64))


def _rows(
    time_ns: Integers,
    number: Integers,
) -> Integers:
    """Return the row of each value, in the order of the lines: a new one where a variable comes again, or much later.

    What was published together may be logged in any order.
    """
    rows = np.empty(len(time_ns), np.int64)
    row = -1
    first_ns = 0
    seen: set[int] = set()
    for place, (time, variable) in enumerate(zip(time_ns.tolist(), number.tolist(), strict=True)):
        is_other = abs(time - first_ns) > _ONE_ROW_NS
        if not seen or is_other or variable in seen:
            row += 1
            first_ns = time
            seen.clear()
        seen.add(variable)
        rows[place] = row
    return rows


def _number(text: bytes) -> float | None:
    """Return a number; None for a text that is none."""
    found = _NUMBER.fullmatch(text)
    if found is None:
        return None
    return float(found[1])


def _numbers_of(text: bytes) -> list[float]:
    """Return the numbers of a value: one, or those of a matrix; none of a text."""
    number = _number(text)
    if number is not None:
        return [number]
    matrix = _MATRIX.fullmatch(text)
    if matrix is None or int(matrix[1]) * int(matrix[2]) > _WIDEST:
        return []
    numbers: list[float] = []
    for part in matrix[3].split(b","):
        element = _number(part.strip())
        if element is None:
            return []
        numbers.append(element)
    if len(numbers) != int(matrix[1]) * int(matrix[2]):
        return []
    return numbers
