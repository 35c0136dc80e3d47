"""Tables as logs: files of CSV, TSV, numpy, Parquet and MATLAB, whose rows are messages with decoded columns.

Libraries read the formats. Each table is a topic, named after its file. Its fields are its columns, whose names are in
lower case, without unit, with ``_`` for other signs: ``ACC X [m/s^2]`` is ``acc_x``. A number counts columns from 1. A
table has no recorder's clock, so its own time column is the log time. Nothing that is wrong in a table is guessed:
what is not a number is missing, rows that do not fit are left out, and each loss is a note.
"""

import csv
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Final

import msgspec
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import NS_PER_S, TimeNs
from insdvl_replay.core.errors import LogError, Note, counted, counted_clause, listed
from insdvl_replay.core.extras import install_hint
from insdvl_replay.core.units import TIME_UNITS_NS, spelled, title_without_unit, unit_of
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.formats.array_files import (
    MOST_COLUMNS,
    SpreadsheetError,
    read_matlab,
    read_numpy,
    require_room,
)
from insdvl_replay.logs.formats.fields import NUMBER, ROW, TABLE, Columns, Kinds, check_path
from insdvl_replay.logs.formats.log_file import Block, FileBytes, LogChannel, LogFile, UnusableFileError

_TIME: Final = re.compile(r"(^|[_.])(time|times|timestamp|stamp|t|utc|epoch|clock|tow)([_.]?(s|sec|ms|us|ns))?$")
_ENDS_WITH_UNIT: Final = re.compile(r"_(s|sec|ms|us|ns|nsec|usec|msec)$")
_SEPARATORS: Final = (b"\t", b";", b"|", b",")  # in text with several of them the first one separates
_COMMENTS: Final = (b"#", b"%")
_DECIMAL_COMMA: Final = re.compile(r"\s*[+-]?\d+,\d+([eE][+-]?\d+)?\s*")
# What cells say of a flag; A and V are those of NMEA.
_FLAG_WORDS: Final = {
    **dict.fromkeys(("true", "yes", "y", "t", "valid", "ok", "good", "lock", "locked", "on", "a"), 1.0),
    **dict.fromkeys(("false", "no", "n", "f", "invalid", "bad", "lost", "unlocked", "off", "v"), 0.0),
}
_FEW: Final = 0.05  # share of the rows or cells that may be wrong; more of them are another format
_RATES_HZ: Final = (0.2, 4000.0)  # of a sensor: they tell the unit of times that has no name
_SINCE_1970_S: Final = (1e9, 4e9)  # times of a clock that counts from then, from 2001 to 2096
_LATEST_NS: Final = 4e18  # differences of times must be whole numbers of 64 bits, too
_LARGEST: Final = 1e100  # larger numbers are not finite, or their squares are not
_LONGEST_TITLE: Final = 200  # letters
_WORK_NUMBERS: Final = 8  # for each row: its times, and what they are made of
_WIDEST: Final = 64  # numbers in a row of an array that is one quantity
_ROWS: Final = 1 << 16  # rows of a block
_SAVE_AGAIN: Final = "save it again; for arrays: numpy.savez(path, time=..., acc=..., gyro=...)"


@dataclass
class _Table:
    """One table of a file."""

    topic: str
    columns: dict[str, NDArray[Any]]  # by name, (k,), or (k, n) for a quantity of several numbers
    units: dict[str, str]  # by column, as far as the file has them


def clean_name(title: str) -> str:
    """Return the name by which a column is known."""
    return re.sub(r"[^\w.]+", "_", title_without_unit(title).lower()).strip("_.")


class TableFile(LogFile):
    """A file of tables. All of it is in memory, as float64."""

    has_summary = True
    compression = ("none",)

    def __init__(self, file: FileBytes) -> None:
        super().__init__(file)
        self._notes: list[Note] = []
        self._is_text = True
        self._commas = 0  # numbers with a decimal comma in the table that is read
        self._rows: list[NDArray[np.float64]] = []  # of each channel, (k, 1 + n): number of the row, then the columns
        self._time_ns: list[TimeNs] = []
        channels = list[LogChannel]()
        with self.watched():
            needed = 0
            for table in self._tables():
                needed += _memory_of(table)
                self._require_room(needed)
                time_ns, kept = self._times(table)
                names = [(name, 1 if values.ndim == 1 else values.shape[1]) for name, values in table.columns.items()]
                rows = _rows_of(table, kept)
                if some := _clear_missing(rows):
                    clause = counted_clause(some, "cells are empty, NaN or too large and count as missing")
                    self._note("table_missing", table.topic, clause, some, warn=False)
                self._rows.append(rows)
                self._time_ns.append(time_ns[kept])
                channels.append(
                    LogChannel(
                        id=len(channels),
                        topic=table.topic,
                        type_name="table",
                        encoding=TABLE,
                        schema_encoding="columns",
                        messages=int(np.count_nonzero(kept)),
                        schema_data=msgspec.json.encode(names),
                        metadata=table.units,
                    )
                )
        if not channels:
            what = "has no table of numbers"
            reasons = [note.text.removeprefix(f"{self.path.name}: ") for note in self._notes]
            raise UnusableFileError("; ".join([what, *reasons]), _SAVE_AGAIN, self.path)
        self.channels = tuple(channels)

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was found wrong, and what was assumed."""
        return tuple(self._notes)

    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the rows of some tables, thousands at a time."""
        for channel_id in sorted(channel_ids):
            rows, time_ns = self._rows[channel_id], self._time_ns[channel_id]
            size = rows.strides[0]
            for start in range(0, len(rows), _ROWS):
                part = np.ascontiguousarray(rows[start : start + _ROWS])
                offsets, log_ns = size * np.arange(len(part)), time_ns[start : start + _ROWS]
                yield Block(channel_id, part.data.cast("B"), offsets, np.full_like(offsets, size), log_ns, log_ns)

    def log_times(self) -> dict[int, TimeNs]:
        """Return the times of all rows by channel, (k,) ns."""
        return dict(enumerate(self._time_ns))

    def _note(self, code: str, topic: str, text: str, count: int = 1, hint: str = "", *, warn: bool = True) -> None:
        severity = Severity.WARNING if warn else Severity.INFO
        self._notes.append(Note(code, f"{topic}: {text}", count, severity, hint))

    def _unreadable(self, error: Exception) -> UnusableFileError:
        """Return the error for a file that is damaged, or asks for too much memory."""
        reason = " ".join(str(error).split())[:200]
        kind = self.path.suffix.lower() or "a table"
        return UnusableFileError(f"cannot be read as {kind}: {reason}", f"copy it again, or {_SAVE_AGAIN}", self.path)

    def _tables(self) -> Iterator[_Table]:
        """Read the tables of the file by its first bytes, else as text."""
        content = self.file.read(0, len(self.file))
        start = bytes(content[:20])
        if not start.startswith((b"\x93NUMPY", b"PK", b"PAR1", b"MATLAB")):
            yield self._text(bytes(content))
            return
        is_parquet = start.startswith(b"PAR1")
        try:
            if is_parquet:
                from insdvl_replay.logs.formats.parquet_file import read_parquet

                found = read_parquet(content)
            else:
                found = read_matlab(content) if start.startswith(b"MATLAB") else read_numpy(content)
        except SpreadsheetError as error:
            hint = "save each of its sheets as CSV, with a point in decimal numbers"
            raise UnusableFileError("is a spreadsheet", hint, self.path) from error
        except ImportError as error:
            hint = install_hint("tables")
            raise LogError(f"needs the package {error.name or 'pyarrow'} to be read", hint, self.path) from error
        except Exception as error:  # whatever a library makes of a damaged file
            raise self._unreadable(error) from error
        del content
        self._is_text = False
        if found.ignored:
            kinds = listed(f"'{name}' is {kind}" for name, kind in found.ignored.items())
            clause = counted_clause(len(found.ignored), f"columns are ignored because they are no numbers: {kinds}")
            hint = "write each number as a column of its own"
            self._note("table_columns", self.path.name, clause, len(found.ignored), hint)
        if is_parquet:
            yield self._named(self.path.name, _popped(found.arrays))
        else:
            yield from self._of_arrays(found.arrays)

    # --- Text.

    def _text(self, content: bytes) -> _Table:
        """Read a table that is text: its separator, header and rows must agree."""
        name = self.path.name
        if content.startswith((b"\xff\xfe", b"\xfe\xff")):
            content = content.decode("utf-16", "replace").encode()
        content = content.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        lines = [line for line in content.split(b"\n") if line.strip()]
        comments = [line for line in lines if line.lstrip().startswith(_COMMENTS)]
        lines = [line for line in lines if not line.lstrip().startswith(_COMMENTS)]
        if lines and not content.endswith(b"\n"):
            lines.pop()
            self._note(
                "table_cut", name, "the last line does not end, so it may be cut; left out", hint="copy it again"
            )
        sample = lines[1:200] or lines or [b""]
        usual = {mark: Counter(line.count(mark) for line in sample).most_common(1)[0][0] for mark in _SEPARATORS}
        separator = next((mark for mark, count in usual.items() if count), None)
        head = 0
        while head < len(lines) and not any(map(_is_number, lines[head].split(separator))):
            head += 1
        cells = [len(line.split()) if separator is None else line.count(separator) + 1 for line in lines[head:]]
        width = Counter(cells).most_common(1)[0][0] if cells else 0
        self._require_few(width)
        if width < 2:
            what = f"is no table: {counted(len(cells), 'line')} with numbers, {counted(width, 'column')}"
            raise UnusableFileError(what, "give a table of numbers whose first line names the columns", self.path)
        header = lines[0] if head else comments[-1].strip(b" #%") if comments else b""
        titles = header.decode("utf-8", "replace").split(separator.decode() if separator else None)
        if not head and len(titles) != width:
            titles = []
        if titles and len(titles) != width:
            what = f"has {counted(len(titles), 'name')} in its first line, but {counted(width, 'cell')} in its rows"
            raise LogError(what, "one separator for names and rows, and a decimal point", self.path)
        if head > 1:
            self._note(
                "table_header", name, f"the first {head} lines have no numbers; the first names the columns", head
            )
        if not titles:
            self._note("table_header", name, "no line names the columns; they are column_1, column_2 ...", warn=False)
        fits = np.array(cells) == width
        if (wrong := int(np.count_nonzero(~fits))) > max(1.0, _FEW * len(cells)):
            raise LogError(f"{wrong} of {len(cells)} rows have other than {width} cells", "one row a line", self.path)
        if wrong:
            clause = counted_clause(wrong, f"rows have other than {width} cells")
            where = int(np.argmin(fits)) + 1
            self._note("table_rows", name, f"{clause}; left out, the first is row {where}", wrong, "copy it again")
        empty = (separator or b" ") * (width - 1)
        joined = b"\n".join(line if is_row else empty for line, is_row in zip(lines[head:], fits, strict=True))
        del lines, content  # of a long dive they are large
        frame = pd.read_csv(
            BytesIO(joined), sep=separator.decode() if separator else r"\s+", header=None, names=range(width),
            index_col=False, skip_blank_lines=False, skipinitialspace=True, quoting=csv.QUOTE_NONE, low_memory=False,
            encoding_errors="replace",
        )  # fmt: skip
        titles = [title.strip().strip("\"'") for title in titles] or [f"column_{i + 1}" for i in range(width)]
        return self._named(name, [(title, frame[i].to_numpy()) for i, title in zip(frame, titles, strict=True)])

    def _named(self, topic: str, columns: Iterable[tuple[str, NDArray[Any]]]) -> _Table:
        """Make a table of columns by their titles; what is not a number in a column of numbers is missing."""
        table = _Table(topic, {}, {})
        names = _Names()
        for title, given in columns:
            if len(title) > _LONGEST_TITLE:
                what = f"the title of column {len(table.columns) + 1} has {len(title)} letters: '{title[:20]}...'"
                raise LogError(what, f"shorten it to {_LONGEST_TITLE} letters", self.path)
            name = names.unique(clean_name(title) or "column")
            values = given
            if values.dtype.kind not in "biufM":
                values = self._numbers(topic, title, values)
            if values.dtype.kind == "M":
                is_date, whole = ~np.isnat(values), values.astype("M8[ns]").astype(np.int64)
                values = whole if is_date.all() else np.where(is_date, whole, np.nan)
                table.units[name] = "ns"
            table.columns[name] = values
            table.units |= {name: unit} if (unit := unit_of(title)) else {}
        if self._commas:
            clause = counted_clause(self._commas, "numbers have a decimal comma and are read so")
            self._note("table_decimal_comma", topic, clause, self._commas)
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
            raise LogError(what, "write the columns of the IMU, the DVL and the reference to tables", self.path)

    def _numbers(self, topic: str, title: str, cells: NDArray[Any]) -> NDArray[Any]:
        """Read cells that are not all numbers; dates become nanoseconds, a column of text has no numbers."""
        series = pd.Series(cells)
        quoted = series.astype(str).str.fullmatch(r'\s*"[^"]*"\s*')
        if quoted.any():
            inside = series[quoted].astype(str).str.strip().str.strip('"')
            series[quoted] = inside.where(inside != "", None)
        numbers = pd.to_numeric(series, errors="coerce")
        is_text = (series.notna() & numbers.isna()).to_numpy()
        texts = series[is_text].astype(str)
        words = texts.str.strip().str.lower().map(_FLAG_WORDS)
        if len(words) and words.notna().all():
            return numbers.where(~is_text, words.reindex(series.index)).to_numpy(np.float64)
        if len(texts) and texts.str.fullmatch(_DECIMAL_COMMA.pattern).mean() > 1.0 - _FEW:
            numbers = pd.to_numeric(series.astype(str).str.replace(",", "."), errors="coerce")
            self._commas += len(texts)
            is_text = (series.notna() & numbers.isna()).to_numpy()
        count, known = int(np.count_nonzero(is_text)), int(series.notna().sum())
        if count and count == known:
            if _TIME.search(clean_name(title)):
                dates = pd.to_datetime(series, errors="coerce", utc=True, format="ISO8601")
                if dates.notna().mean() > 1.0 - _FEW:
                    return dates.dt.tz_localize(None).to_numpy()
            return np.full(len(cells), np.nan)
        if count > max(1.0, _FEW * known):
            text = f"column '{title}' has text in {count} of {known} cells"
            raise LogError(text, "numbers with a decimal point; leave the cell empty where there is none", self.path)
        if count:
            clause = counted_clause(count, "cells are text and count as missing")
            where = int(np.argmax(is_text)) + 1
            self._note(
                "table_cells", topic, f"column '{title}': {clause}, the first in row {where}", count, "copy it again"
            )
        return numbers.to_numpy()

    # --- Arrays.

    def _of_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> Iterator[_Table]:
        """Make tables of arrays: those with the same number of rows and one time are one table."""
        self._require_few(len(arrays))
        groups: dict[tuple[str, int], dict[str, NDArray[Any]]] = {}
        for name, array in arrays.items():
            values = array.squeeze()
            if values.ndim == 2 and values.shape[0] < min(values.shape[1], _WIDEST):
                values = values.T  # MATLAB has often one column a sample
            if values.ndim in (1, 2) and len(values) > 1 and (values.ndim == 1 or values.shape[1] <= _WIDEST):
                groups.setdefault((name.rpartition(".")[0], len(values)), {})[name.rpartition(".")[2]] = values
        tables: dict[tuple[str, int], dict[str, NDArray[Any]]] = {}
        for (above, count), columns in groups.items():
            times = [name for name in columns if _TIME.search(clean_name(name))]
            by_word = len(times) > 1 and len({_first_word(name) for name in times}) == len(times)
            for name, values in columns.items():
                word = _first_word(name) if by_word else _first_word(next(iter(columns)))
                tables.setdefault((above or word, count), {})[name] = values
        labels = [label for label, _ in tables]
        for (label, count), columns in tables.items():
            name = label if labels.count(label) == 1 else f"{label}_{count}"
            topic = self.path.name if len(tables) == 1 else f"{self.path.name}/{name}"
            (first, *others), named = columns.values(), columns
            if not others and first.ndim == 2:
                named = {f"column_{i + 1}": values for i, values in enumerate(first.T)}
            elif all(name.lower().startswith(f"{label}_") for name in columns):
                named = {name[len(label) + 1 :]: values for name, values in columns.items()}
            yield self._named(topic, named.items())

    # --- Times.

    def _times(self, table: _Table) -> tuple[TimeNs, NDArray[np.bool_]]:
        """Return the times of a table's rows, ns, (k,), and which rows have one."""
        count = len(next(iter(table.columns.values())))
        for name, values in table.columns.items():
            if values.ndim > 1 or not _TIME.search(name) or not np.isfinite(values).any():
                continue
            known = np.isfinite(values)
            ending = _ENDS_WITH_UNIT.search(name)
            unit = table.units.get(name) or (ending and spelled(ending[1])) or ""
            if table.units.get(name) and unit not in TIME_UNITS_NS:
                hint = f"its unit may be {', '.join(TIME_UNITS_NS)}"
                raise LogError(f"the times '{name}' are in {unit}, which is no unit that is known", hint, self.path)
            if unit not in TIME_UNITS_NS:
                unit = _likely_unit(values[known])
                self._note("table_time_unit", table.topic, f"the times '{name}' were read as {unit}", warn=False)
            table.units[name] = unit
            known &= np.abs(np.where(known, values, 0.0)) < _LATEST_NS / TIME_UNITS_NS[unit]
            usable = np.where(known, values, 0)
            time_ns = usable.astype(np.int64) * TIME_UNITS_NS[unit]
            if values.dtype.kind == "f":
                time_ns = np.rint(usable * TIME_UNITS_NS[unit]).astype(np.int64)
            if missing := count - int(np.count_nonzero(known)):
                clause = counted_clause(missing, "rows have no time and are left out")
                self._note("table_no_time", table.topic, clause, missing)
            return time_ns, known
        text = "no column is named as a time; its rows are taken to be 1 s apart"
        self._note(
            "table_without_times", table.topic, text, hint='for a rate: imu.stamp = "100 Hz"; for a column: imu.stamp'
        )
        return np.arange(count) * NS_PER_S, np.ones(count, np.bool_)


class _Names:
    """Names of columns, each once: of equal ones, the second is ``name_2``."""

    def __init__(self) -> None:
        self._taken: set[str] = set()
        self._counts: Counter[str] = Counter()

    def unique(self, name: str) -> str:
        """Return the name, or the next with a number that no column has."""
        unique = name
        self._counts[name] += 1
        while unique in self._taken:
            unique = f"{name}_{self._counts[name]}"
            self._counts[name] += 1
        self._taken.add(unique)
        return unique


def _popped(arrays: dict[str, NDArray[Any]]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Give arrays away one by one, as of a long dive they are large."""
    while arrays:
        name = next(iter(arrays))
        yield name, arrays.pop(name)


def _memory_of(table: _Table) -> int:
    """Return the bytes that a table needs while its times and rows are made."""
    columns = table.columns.values()
    count = len(next(iter(columns)))
    return np.dtype(np.float64).itemsize * (sum(values.size for values in columns) + _WORK_NUMBERS * count)


def _rows_of(table: _Table, kept: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the numbers of the rows and their cells, (k, 1 + n), and let go of the columns."""
    width = 1 + sum(1 if values.ndim == 1 else values.shape[1] for values in table.columns.values())
    rows = np.empty((int(np.count_nonzero(kept)), width))
    rows[:, 0] = np.flatnonzero(kept)
    place = 1
    for _, values in _popped(table.columns):
        columns = values.reshape(len(kept), -1)
        rows[:, place : place + columns.shape[1]] = columns if len(rows) == len(kept) else columns[kept]
        place += columns.shape[1]
    return rows


def _clear_missing(rows: NDArray[np.float64]) -> int:
    """Set cells that are no finite number to NaN; return how many there are in columns that have others."""
    some = 0
    for column in rows.T:
        missing = ~(np.abs(column) < _LARGEST)
        count = int(np.count_nonzero(missing))
        if count:
            column[missing] = np.nan
            some += count if count < len(column) else 0
    return some


def _first_word(name: str) -> str:
    return re.split(r"[_.\s]", name)[0].lower()


def _is_number(cell: bytes) -> bool:
    try:
        float(cell.strip().strip(b'"').replace(b",", b"."))
    except ValueError:
        return False
    return True


def _likely_unit(values: NDArray[Any]) -> str:
    """Return the unit of times by the rate that a sensor can have, and best by a size that counts from 1970."""
    size, steps = float(np.median(np.abs(values))), np.diff(values.astype(np.float64))
    step = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0
    seconds = {unit: factor / NS_PER_S for unit, factor in TIME_UNITS_NS.items()}
    possible = [unit for unit, factor in seconds.items() if _RATES_HZ[0] < 1.0 / (step * factor) < _RATES_HZ[1]]
    by_size = [unit for unit in possible if _SINCE_1970_S[0] < size * seconds[unit] < _SINCE_1970_S[1]]
    return (by_size or possible or ["s"])[0]


class RowReader:
    """Reads some columns of the rows of a table."""

    def __init__(self, channel: LogChannel, paths: Sequence[str]) -> None:
        widths: dict[str, int] = dict(msgspec.json.decode(channel.schema_data))
        known, places, self._size = dict[str, str](), {ROW: [0]}, 1
        for name, width in widths.items():
            known[name], places[name] = NUMBER, list(range(self._size, self._size + width))
            if width > 1:
                known[f"{name}[*]"] = NUMBER
                places |= {f"{name}[{i}]": [self._size + i] for i in range(width)}
                places[f"{name}[*]"] = places[name]
            self._size += width
        self.known: Kinds = known
        self._places: dict[str, list[int]] = {}
        self.names: dict[str, str] = {}  # of the columns, by path
        for path in paths:
            name = list(widths)[int(path) - 1] if path.isdecimal() and 0 < int(path) <= len(widths) else path
            if name not in places:  # it may be the title of a column, with its unit
                element = re.search(r"\[(\d+|\*)\]$", name)
                name = clean_name(name.removesuffix(element[0])) + element[0] if element else clean_name(name)
            if name not in places:
                check_path(name, known, channel.topic)
                raise LogError(f"{channel.topic} has no '{path}'", f"'{name}' is behind the last number of its list")
            self._places[path] = places[name]
            self.names[path] = name.partition("[")[0]

    def columns(self, block: Block) -> Columns:
        """Return the columns of all rows of a block, (k, n)."""
        rows = np.frombuffer(block.buffer, np.float64).reshape(-1, self._size)[block.offsets // (8 * self._size)]
        return {path: rows[:, places] for path, places in self._places.items()}
