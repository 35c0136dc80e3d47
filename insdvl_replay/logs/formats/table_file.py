"""Tables as logs: files of CSV, TSV, numpy, Parquet and MATLAB, whose rows are messages with decoded columns.

Libraries read the formats. Each table is a topic, named after its file. Its fields are its columns, whose names are in
lower case, without unit, with ``_`` for other signs: ``ACC X [m/s^2]`` is ``acc_x``. A number counts columns from 1. A
table has no recorder's clock, so its own time column is the log time. Nothing that is wrong in a table is guessed:
what is not a number is missing, rows that do not fit are left out, and each loss is a note.
"""

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, Final

import numpy as np
import pandas as pd

from insdvl_replay.core.dive_columns import NS_PER_S, Array, Floats, Mask, TimeNs
from insdvl_replay.core.errors import LogError, Note, counted, listed
from insdvl_replay.core.extras import install_hint
from insdvl_replay.core.notes import note
from insdvl_replay.core.units import TIME_UNITS_NS, spelled, unit_of
from insdvl_replay.logs.formats.array_files import (
    MOST_COLUMNS,
    Arrays,
    Found,
    SpreadsheetError,
    read_matlab,
    read_numpy,
    require_room,
)
from insdvl_replay.logs.formats.log_file import (
    FileBytes,
    UnusableFileError,
)
from insdvl_replay.logs.formats.table_header import ColumnNames, Header, find_header
from insdvl_replay.logs.formats.table_rows import RowsFile, clean_name, clear_missing
from insdvl_replay.logs.formats.table_text import (
    TextLines,
    as_utf8,
    counts_of_cells,
    first_row,
    is_row,
    last_words,
    separator_of,
    usual,
)
from insdvl_replay.logs.formats.table_times import (
    DATE_NAME,
    DAY_NS,
    DAY_S,
    TIME_NAME,
    Calendar,
    calendar_of,
    dates_ns,
    exact_to_s,
    guessed_units,
    in_ns,
    is_coarse,
    likely_unit,
    text_times,
    unwrapped,
    usual_step,
    zero_of,
)

_ENDS_WITH_UNIT: Final = re.compile(r"_(s|sec|ms|us|ns|nsec|usec|msec)$")
_ISO_DATE: Final = re.compile(r"\d{4}-\d\d-\d\d")
_YMD: Final = re.compile(r"(\d{4})(\d\d)(\d\d)")
_DECIMAL_COMMA: Final = re.compile(r"\s*[+-]?\d+,\d+([eE][+-]?\d+)?\s*")
# What cells say of a flag; A and V are those of NMEA.
_FLAG_WORDS: Final = {
    **dict.fromkeys(
        ("true", "yes", "y", "t", "valid", "ok", "good", "lock", "locked", "on", "a"), 1.0
    ),
    **dict.fromkeys(
        ("false", "no", "n", "f", "invalid", "bad", "lost", "unlocked", "off", "v"), 0.0
    ),
}
_FEW: Final = 0.05  # share of the rows or cells that may be wrong; more of them are another format
_LATEST_NS: Final = 4e18  # differences of times must be whole numbers of 64 bits, too
_LARGEST: Final = 1e100  # larger numbers are not finite, or their squares are not
_LONGEST_TITLE: Final = 200  # letters
_WORK_NUMBERS: Final = 8  # for each row: its times, and what they are made of
_WIDEST: Final = 64  # numbers in a row of an array that is one quantity
_ROWS: Final = 1 << 16  # rows of a block
_SAVE_AGAIN: Final = "save it again; for arrays: numpy.savez(path, time=..., acc=..., gyro=...)"


_Label = tuple[str, int]  # of a table of arrays: its structure or a word, and its number of rows


@dataclass
class _Table:
    """One table of a file."""

    topic: str
    columns: dict[str, Array]  # by name, (k,), or (k, n) for a quantity of several numbers
    units: dict[str, str]  # by column, as far as the file has them
    # Of times of day, by column: an hour or a day.
    periods_ns: dict[str, int] = field(default_factory=dict)
    # Of columns named as times that are not read: the first cell.
    unread: dict[str, str] = field(default_factory=dict)

    @property
    def row_count(self) -> int:
        """How many rows it has."""
        return len(next(iter(self.columns.values())))

    def widths(self) -> dict[str, int]:
        """Return how many numbers a row has of each column."""
        widths = {}
        for name, values in self.columns.items():
            widths[name] = 1 if values.ndim == 1 else values.shape[1]
        return widths


@dataclass(frozen=True)
class _Times:
    """The times of a table's rows."""

    time_ns: TimeNs  # (k,)
    known: Mask  # (k,) which rows have one
    column: str = ""
    period_ns: int = 0  # after which times of day repeat
    unread: str = ""  # why the rows are only counted


class TableFile(RowsFile):
    """A file of tables. All of it is in memory, as float64."""

    def __init__(self, file: FileBytes) -> None:
        super().__init__(file)
        self._notes: list[Note] = []
        self._reasons: list[str] = []  # the sentences of the notes, without the name of the file
        self._is_text = True
        self._commas = 0  # numbers with a decimal comma in the table that is read
        with self.watched():
            needed = 0
            for table in self._tables():
                needed += _memory_of(table)
                self._require_room(needed)
                self._add(table)
        if not self.channels:
            what = "has no table of numbers"
            raise UnusableFileError("; ".join([what, *self._reasons]), _SAVE_AGAIN, self.path)

    def _add(self, table: _Table) -> None:
        """Make a channel of a table, whose columns are let go of."""
        times = self._times(table)
        kept = times.known
        widths = table.widths()
        rows = _rows_of(table, kept)
        missing = clear_missing(rows)
        if missing:
            self._note("table_missing", table.topic, missing)
        channel = self.add_channel(
            table.topic,
            "table",
            widths,
            rows,
            times.time_ns[kept],
            metadata=table.units,
            time_column=times.column,
            untimed=times.unread,
        )
        if times.period_ns:
            self.periods_ns[channel.id] = times.period_ns

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was found wrong, and what was assumed."""
        return tuple(self._notes)

    def shift(self, channel_id: int, shift_ns: int) -> None:
        """Shift the times of a table, which had no date or no hour; it overlaps the others then."""
        self._shift(channel_id, shift_ns)
        lacking = "date"
        if self.periods_ns[channel_id] < DAY_NS:
            lacking = "hour"
        topic = self.channels[channel_id].topic
        shift_h = shift_ns / TIME_UNITS_NS["h"]
        self._note("table_time_of_day", topic, lacking=lacking, shift_h=shift_h)

    def _note(self, code: str, topic: str, count: int = 1, **fields: Any) -> None:
        """Note something about a table. It is also a reason why the file has none."""
        said = note(code, count, **fields)
        whole = said.about(topic)
        self._notes.append(whole)
        if topic == self.path.name:
            self._reasons.append(said.text)
        else:
            self._reasons.append(whole.text)

    def _unreadable(self, error: Exception) -> UnusableFileError:
        """Return the error for a file that is damaged, or asks for too much memory."""
        reason = " ".join(str(error).split())[:200]
        kind = self.path.suffix.lower() or "a table"
        return UnusableFileError(
            f"cannot be read as {kind}: {reason}", f"copy it again, or {_SAVE_AGAIN}", self.path
        )

    def _tables(self) -> Iterator[_Table]:
        """Read the tables of the file by its first bytes, else as text."""
        content = self.file.read(0, len(self.file))
        start = bytes(content[:20])
        if not start.startswith((b"\x93NUMPY", b"PK", b"PAR1", b"MATLAB")):
            yield self._text(bytes(content))
            return
        found = self._found(content, start)
        del content
        self._is_text = False
        if found.ignored:
            kinds = listed(f"'{name}' is {kind}" for name, kind in found.ignored.items())
            self._note("table_columns", self.path.name, len(found.ignored), kinds=kinds)
        if start.startswith(b"PAR1"):
            yield self._named(self.path.name, _popped(found.arrays))
        else:
            yield from self._of_arrays(found.arrays)

    def _found(self, content: memoryview, start: bytes) -> Found:
        """Let a library read the arrays or columns of a file that is no text."""
        try:
            if start.startswith(b"PAR1"):
                from insdvl_replay.logs.formats.parquet_file import read_parquet

                return read_parquet(content)
            if start.startswith(b"MATLAB"):
                return read_matlab(content)
            return read_numpy(content)
        except SpreadsheetError as error:
            hint = "save each of its sheets as CSV, with a point in decimal numbers"
            raise UnusableFileError("is a spreadsheet", hint, self.path) from error
        except ImportError as error:
            what = f"needs the package {error.name or 'pyarrow'} to be read"
            raise LogError(what, install_hint("tables"), self.path) from error
        except Exception as error:  # whatever a library makes of a damaged file
            # Its frames hold what was read, which several errors of one file would hold several times.
            raise self._unreadable(error) from error.with_traceback(None)

    # --- Text.

    def _text(self, content: bytes) -> _Table:
        """Read a table that is text: its separator, header and rows must agree."""
        name = self.path.name
        content = as_utf8(content)
        text = TextLines.of(content)
        if text.is_cut:
            self._note("table_cut", name)
        separator = separator_of(text.lines)
        counts = counts_of_cells(text.lines, separator)
        names = find_header(text.lines, separator, usual(counts))
        head = names.rows_at if names else first_row(text.lines, separator)
        counts = counts[head:]
        width = usual(counts)
        self._require_few(width)
        if width < 2:
            what = f"is no table: {counted(len(counts), 'line')} with numbers, {counted(width, 'column')}"
            hint = "give a table of numbers whose first line names the columns"
            raise UnusableFileError(what, hint, self.path)
        titles = self._titles(names, text.lines[:head], text.above, separator, width)
        self._note_header(name, names, head, titles)
        self._note_commented_rows(name, text.comments, separator, width)
        fits = np.array(counts) == width
        self._require_rows(name, fits, width)
        # A row that does not fit becomes an empty one, so that the others keep their numbers.
        empty = (separator or b" ") * (width - 1)
        rows = zip(text.lines[head:], fits, strict=True)
        joined = b"\n".join(line if is_whole else empty for line, is_whole in rows)
        del text, rows, content  # of a long dive they are large
        frame = pd.read_csv(
            BytesIO(joined), sep=separator.decode() if separator else r"\s+", header=None, names=range(width),
            index_col=False, skip_blank_lines=False, skipinitialspace=True, quoting=csv.QUOTE_NONE, low_memory=False,
            encoding_errors="replace",
        )  # fmt: skip
        if not titles:
            titles = [f"column_{number}" for number in range(1, width + 1)]
        bare = [title.strip().strip("\"'") for title in titles]
        return self._named(name, [(bare[i], frame[i].to_numpy()) for i in range(width)])

    def _titles(
        self,
        names: Header | None,
        head: Sequence[bytes],
        above: Sequence[bytes],
        separator: bytes | None,
        width: int,
    ) -> list[str]:
        """Return the names of the columns as they are written; none where no line names them.

        They are in the lines of the header, or in the last comment above the rows.
        """
        if names and width == len(names.titles):
            return list(names.titles)
        line = head[0] if head else last_words(above, separator, width)
        titles = line.decode("utf-8", "replace").split(separator.decode() if separator else None)
        if len(titles) == width or not titles:
            return titles
        if not head:
            return []
        what = f"has {counted(len(titles), 'name')} in its first line, but {counted(width, 'cell')} in its rows"
        raise LogError(what, "one separator for names and rows, and a decimal point", self.path)

    def _note_header(
        self,
        name: str,
        names: Header | None,
        head: int,
        titles: Sequence[str],
    ) -> None:
        """Report lines above the names, and columns without names."""
        if names and names.names_at:
            self._note("table_header", name, names.names_at)
        elif head > 1 and not names:
            self._note("table_header first", name, head)
        if not titles:
            self._note("table_header none", name)

    def _note_commented_rows(
        self,
        name: str,
        comments: Sequence[bytes],
        separator: bytes | None,
        width: int,
    ) -> None:
        """Report rows of numbers that are left out since they begin as comments do."""
        rows = [
            line for line in comments if is_row(line.lstrip().lstrip(b"#% "), separator, width)
        ]
        if rows:
            self._note("table_comments", name, len(rows))

    def _require_rows(
        self,
        name: str,
        fits: Mask,
        width: int,
    ) -> None:
        """Refuse a table with many rows of another width, and report a few."""
        wrong = int(np.count_nonzero(~fits))
        if wrong > max(1.0, _FEW * len(fits)):
            raise LogError(
                f"{wrong} of {len(fits)} rows have other than {width} cells",
                "one row a line",
                self.path,
            )
        if wrong:
            first = int(np.argmin(fits)) + 1
            self._note("table_rows", name, wrong, width=width, row=first)

    def _named(self, topic: str, columns: Iterable[tuple[str, Array]]) -> _Table:
        """Make a table of columns by their titles; what is not a number in a column of numbers is missing."""
        table = _Table(topic, {}, {})
        names = ColumnNames()
        for title, given in columns:
            if len(title) > _LONGEST_TITLE:
                what = f"the title of column {len(table.columns) + 1} has {len(title)} letters: '{title[:20]}...'"
                raise LogError(what, f"shorten it to {_LONGEST_TITLE} letters", self.path)
            name = names.unique(clean_name(title) or "column")
            values = given
            if values.dtype.kind not in "biufM":
                values = self._read_text(table, name, title, values)
            if values.dtype.kind == "M":
                is_date = ~np.isnat(values)
                whole = values.astype("M8[ns]").astype(np.int64)
                values = whole if is_date.all() else np.where(is_date, whole, np.nan)
                table.units[name] = "ns"
            table.columns[name] = values
            unit = unit_of(title)
            if unit and name not in table.units:
                table.units[name] = unit
        if self._commas:
            self._note("table_decimal_comma", topic, self._commas)
            self._commas = 0
        return table

    def _require_room(self, needed: int) -> None:
        """Refuse a file whose tables need much more memory than it has bytes. A text has bytes for each cell."""
        if not self._is_text:
            try:
                require_room(needed, len(self.file))
            except ValueError as error:
                raise self._unreadable(error) from error

    def _require_few(self, count: int) -> None:
        """Refuse a file with more columns than a log of sensors can have."""
        if count > MOST_COLUMNS:
            what = f"has {count} columns; {MOST_COLUMNS} are read"
            raise LogError(
                what,
                "write the columns of the IMU, the DVL and the reference to tables",
                self.path,
            )

    def _read_text(
        self,
        table: _Table,
        name: str,
        title: str,
        cells: Array,
    ) -> Array:
        """Read cells that are not all numbers: dates and times, else numbers; text alone has none."""
        if not (TIME_NAME.search(name) or DATE_NAME.search(name)):
            return self._numbers(table.topic, title, cells)
        series = pd.Series(cells).map(
            lambda cell: cell.strip(" \"'") if isinstance(cell, str) else cell
        )
        series = series.where(series != "")
        texts = series.dropna().astype(str)
        times = _read_times(table, name, series, texts)
        if times is not None:
            return times
        values = self._numbers(table.topic, title, cells)
        if len(texts) and values.dtype.kind == "f" and not np.isfinite(values).any():
            table.unread[name] = str(texts.iloc[0])[:40]
        return values

    def _numbers(
        self,
        topic: str,
        title: str,
        cells: Array,
    ) -> Array:
        """Read cells that are not all numbers; a column of text has none."""
        series = _unquoted(cells)
        numbers = pd.to_numeric(series, errors="coerce")
        is_text = (series.notna() & numbers.isna()).to_numpy()
        texts = series[is_text].astype(str)
        words = texts.str.strip().str.lower().map(_FLAG_WORDS)
        if len(words) and words.notna().all():
            flags = numbers.where(~is_text, words.reindex(series.index))
            return np.asarray(flags.to_numpy(np.float64))
        if len(texts) and texts.str.fullmatch(_DECIMAL_COMMA.pattern).mean() > 1.0 - _FEW:
            numbers = pd.to_numeric(series.astype(str).str.replace(",", "."), errors="coerce")
            self._commas += len(texts)
            is_text = (series.notna() & numbers.isna()).to_numpy()
        known = int(series.notna().sum())
        if known and np.count_nonzero(is_text) == known:
            return np.full(len(cells), np.nan)
        self._require_few_texts(topic, title, is_text, known)
        return np.asarray(numbers.to_numpy())

    def _require_few_texts(
        self,
        topic: str,
        title: str,
        is_text: Mask,
        known: int,
    ) -> None:
        """Refuse a column of numbers with text in many of its known cells, and report a few."""
        count = int(np.count_nonzero(is_text))
        if count > max(1.0, _FEW * known):
            text = f"column '{title}' has text in {count} of {known} cells"
            hint = "numbers with a decimal point; leave the cell empty where there is none"
            raise LogError(text, hint, self.path)
        if count:
            first = int(np.argmax(is_text)) + 1
            self._note("table_cells", topic, count, title=title, row=first)

    # --- Arrays.

    def _of_arrays(self, arrays: Mapping[str, Array]) -> Iterator[_Table]:
        """Make tables of arrays: those with the same number of rows and one time are one table."""
        self._require_few(len(arrays))
        tables = _tables_of(arrays)
        labels = [label for label, _ in tables]
        for (label, count), columns in tables.items():
            topic = self.path.name
            if labels.count(label) > 1:
                topic = f"{self.path.name}/{label}_{count}"
            elif len(tables) > 1:
                topic = f"{self.path.name}/{label}"
            yield self._named(topic, _columns_by_title(label, columns).items())

    # --- Times.

    def _times(self, table: _Table) -> _Times:
        """Return the times of a table's rows, by the first column that is named as a time and is read."""
        name = _column_of_times(table)
        if not name:
            return self._counted_rows(table)
        values = table.columns[name]
        known = np.isfinite(values)
        unit = self._time_unit(table, name, values[known])
        if not unit:
            step = usual_step(values[known])
            text = f"the times '{name}' of {table.topic} step by {step:.3g}, which no sensor does in s, ms, us or ns"
            return _one_second_apart(table, text + guessed_units(step))
        table.units[name] = unit
        zero = zero_of(values[known], unit)
        known &= np.abs(np.where(known, values, zero) - zero) < _LATEST_NS / TIME_UNITS_NS[unit]
        missing = len(values) - int(np.count_nonzero(known))
        if missing:
            self._note("table_no_time", table.topic, missing)
        time_ns = np.zeros(len(values), np.int64)
        time_ns[known] = in_ns(values[known], unit)
        period_ns = table.periods_ns.get(name, 0)
        if not period_ns:
            return _Times(time_ns, known, name)
        days = _days_of(table, name) if period_ns == DAY_NS else None
        if days is not None:
            return _Times(time_ns + days, known, name)
        return _Times(unwrapped(time_ns, known, period_ns), known, name, period_ns)

    def _counted_rows(self, table: _Table) -> _Times:
        """Return the times of rows that are only counted, since no column has their times."""
        if table.unread:
            name, cell = next(iter(table.unread.items()))
            text = f"the times '{name}' of {table.topic} are not read: '{cell}' is no number, date or time of day"
            return _one_second_apart(table, text)
        self._note("table_without_times", table.topic)
        return _one_second_apart(table)

    def _time_unit(
        self,
        table: _Table,
        name: str,
        values: Array,
    ) -> str:
        """Return the unit of a column of times: that of its title, else by the rate of a sensor; empty for none."""
        stated = table.units.get(name, "")
        if stated and stated not in TIME_UNITS_NS:
            hint = f"its unit may be {', '.join(TIME_UNITS_NS)}"
            raise LogError(
                f"the times '{name}' are in {stated}, which is no unit that is known",
                hint,
                self.path,
            )
        ending = _ENDS_WITH_UNIT.search(name)
        if ending and not stated:
            stated = spelled(ending[1])
        unit = stated or likely_unit(values)
        calendar = calendar_of(values) if unit == "d" and len(values) else None
        if calendar is not None:
            self._note_days(table, name, values, calendar)
        elif unit and not stated:
            self._note("table_time_unit", table.topic, name=name, unit=unit)
        return unit

    def _note_days(
        self,
        table: _Table,
        name: str,
        values: Array,
        calendar: Calendar,
    ) -> None:
        """Report how exact times are that are days of a calendar; rounded ones concern every row."""
        code = "table_days"
        count = 1
        if is_coarse(values):
            code = "table_days coarse"
            count = len(values)
        self._note(
            code,
            table.topic,
            count,
            name=name,
            calendar=calendar.name,
            exact_s=exact_to_s(values),
            apart_s=usual_step(values) * DAY_S,
        )


def _column_of_times(table: _Table) -> str:
    """Return the first column with times that is named as a time, else as a date; empty without one."""
    named = [name for name in table.columns if TIME_NAME.search(name)]
    for name in table.columns:
        if DATE_NAME.search(name) and table.units.get(name) == "ns":
            named.append(name)
    for name in named:
        values = table.columns[name]
        if values.ndim == 1 and np.isfinite(values).any():
            return name
    return ""


def _one_second_apart(table: _Table, unread: str = "") -> _Times:
    """Return the times of rows that are only counted, and why."""
    count = table.row_count
    return _Times(np.arange(count) * NS_PER_S, np.ones(count, np.bool_), unread=unread)


def _days_of(table: _Table, name: str) -> TimeNs | None:
    """Return the dates beside times of day, ns since 1970, (k,), of a column named as a date; None without one."""
    for other, values in table.columns.items():
        if other == name or values.ndim > 1 or not DATE_NAME.search(other):
            continue
        if not np.isfinite(values).all():
            continue
        if table.units.get(other) == "ns":
            return np.asarray(values.astype(np.int64) // DAY_NS * DAY_NS)
        if np.all((values >= 19_700_101) & (values < 21_000_101)):
            digits = pd.Series(values.astype(np.int64).astype(str))
            return dates_ns(digits.str.replace(_YMD, r"\1-\2-\3", regex=True))
    return None


# --- Which arrays are one table.


def _as_columns(array: Array) -> Array | None:
    """Return an array with a row for each sample, (k,) or (k, n); None where it has none or is too wide."""
    values = array.squeeze()
    if values.ndim not in (1, 2):
        return None
    if values.ndim == 2 and values.shape[0] < min(values.shape[1], _WIDEST):
        values = values.T  # MATLAB has often one column a sample
    if len(values) < 2 or (values.ndim == 2 and values.shape[1] > _WIDEST):
        return None
    return values


def _tables_of(arrays: Mapping[str, Array]) -> dict[_Label, Arrays]:
    """Sort arrays into tables: those of one structure with the same number of rows and one time.

    Arrays outside structures are labelled by the first word of the first of them. Where several times have words of
    their own, each array belongs to the time with its word.
    """
    groups: dict[_Label, Arrays] = {}  # by the name of the structure
    for path, array in arrays.items():
        values = _as_columns(array)
        if values is not None:
            structure, _, name = path.rpartition(".")
            groups.setdefault((structure, len(values)), {})[name] = values
    tables: dict[_Label, Arrays] = {}
    for (structure, count), columns in groups.items():
        times = [name for name in columns if TIME_NAME.search(clean_name(name))]
        words = {_first_word(name) for name in times}
        is_by_word = len(times) > 1 and len(words) == len(times)
        first = _first_word(next(iter(columns)))
        for name, values in columns.items():
            word = _first_word(name) if is_by_word else first
            tables.setdefault((structure or word, count), {})[name] = values
    return tables


def _columns_by_title(label: str, columns: Arrays) -> Arrays:
    """Return the columns of a table by their titles, without its label; those of a lone matrix are numbered."""
    first = next(iter(columns.values()))
    if len(columns) == 1 and first.ndim == 2:
        return {f"column_{i + 1}": values for i, values in enumerate(first.T)}
    if all(name.lower().startswith(f"{label}_") for name in columns):
        return {name[len(label) + 1 :]: values for name, values in columns.items()}
    return columns


def _first_word(name: str) -> str:
    return re.split(r"[_.\s]", name)[0].lower()


# --- The rows of a table.


def _popped(arrays: dict[str, Array]) -> Iterator[tuple[str, Array]]:
    """Give arrays away one by one, as of a long dive they are large."""
    while arrays:
        name = next(iter(arrays))
        yield name, arrays.pop(name)


def _memory_of(table: _Table) -> int:
    """Return the bytes that a table needs while its times and rows are made."""
    numbers = (
        sum(values.size for values in table.columns.values()) + _WORK_NUMBERS * table.row_count
    )
    return np.dtype(np.float64).itemsize * numbers


def _rows_of(table: _Table, kept: Mask) -> Floats:
    """Return the numbers of the rows and their cells, (k, 1 + n), and let go of the columns."""
    rows = np.empty((int(np.count_nonzero(kept)), 1 + sum(table.widths().values())))
    rows[:, 0] = np.flatnonzero(kept)
    place = 1
    for _, values in _popped(table.columns):
        columns = values.reshape(len(kept), -1)
        if len(rows) < len(kept):
            columns = columns[kept]
        rows[:, place : place + columns.shape[1]] = columns
        place += columns.shape[1]
    return rows


def _unquoted(cells: Array) -> Any:
    """Return cells as a series, those in quotation marks without them, and missing where nothing is between them."""
    series: Any = pd.Series(cells)
    quoted = series.astype(str).str.fullmatch(r'\s*"[^"]*"\s*')
    if quoted.any():
        inside = series[quoted].astype(str).str.strip().str.strip('"')
        series[quoted] = inside.where(inside != "", None)
    return series


def _read_times(
    table: _Table,
    name: str,
    series: Any,
    texts: Any,
) -> Array | None:
    """Read cells as times of day, dates and times, or dates; None if they are none of these."""
    times = None if len(texts) and _ISO_DATE.match(texts.iloc[0]) else text_times(series)
    if times is not None:
        table.units[name] = "ns"
        if times.period_ns:
            table.periods_ns[name] = times.period_ns
        if times.known.all():
            return times.time_ns
        return np.where(times.known, times.time_ns, np.nan)
    if not len(texts) or pd.to_numeric(texts, errors="coerce").notna().mean() > _FEW:
        return None
    dates = pd.to_datetime(series, errors="coerce", utc=True, format="ISO8601")
    if dates.notna().mean() > 1.0 - _FEW:
        return np.asarray(dates.dt.tz_localize(None).to_numpy())
    days = dates_ns(texts) if len(texts) == len(series) else None
    if days is not None:
        table.units[name] = "ns"
    return days
