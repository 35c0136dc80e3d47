"""Files whose rows are decoded as they are opened: each table of them is a channel, whose messages are its rows.

Tables that users made are read so, and what instruments and autopilots write.
"""

import re
from abc import abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.core.dive_columns import (
    Floats,
    TimeNs,
)
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.units import title_without_unit
from insdvl_replay.logs.formats.fields import (
    NUMBER,
    ROW,
    TABLE,
    Columns,
    Kinds,
    check_path,
)
from insdvl_replay.logs.formats.log_file import (
    Block,
    FileBytes,
    LogChannel,
    LogFile,
)

_ROWS: Final = 1 << 16  # rows of a block
_LARGEST: Final = 1e100  # larger numbers are not finite, or their squares are not


class RowsFile(LogFile):
    """A file of decoded rows. All of them are in memory, as float64."""

    has_summary = True
    compression = ("none",)

    def __init__(self, file: FileBytes) -> None:
        super().__init__(file)
        # Of each channel, (k, 1 + n): number of the row, then the columns.
        self._rows: list[Floats] = []
        self._time_ns: list[TimeNs] = []
        # Of channels whose times are those of an unknown day or hour.
        self.periods_ns: dict[int, int] = {}

    def add_channel(
        self,
        topic: str,
        type_name: str,
        widths: Mapping[str, int],  # how many numbers a row has of each column
        rows: Floats,
        time_ns: TimeNs,
        *,
        metadata: Mapping[str, str] | None = None,
        time_column: str = "",
        untimed: str = "",
    ) -> LogChannel:
        """Make a channel of rows, (k, 1 + n): the number of each, then its columns."""
        channel = LogChannel(
            id=len(self.channels),
            topic=topic,
            type_name=type_name,
            encoding=TABLE,
            schema_encoding="columns",
            messages=len(rows),
            schema_data=msgspec.json.encode(list(widths.items())),
            metadata=metadata or {},
            time_column=time_column,
            untimed=untimed,
        )
        self._rows.append(rows)
        self._time_ns.append(time_ns)
        self.channels = (*self.channels, channel)
        return channel

    @abstractmethod
    def shift(self, channel_id: int, shift_ns: int) -> None:
        """Shift the times of a table, which had no date or no hour, so that it overlaps the others; report it."""

    def _shift(self, channel_id: int, shift_ns: int) -> None:
        self._time_ns[channel_id] = self._time_ns[channel_id] + shift_ns

    def change_times(self, change: Callable[[TimeNs], TimeNs]) -> None:
        """Change the times of all tables, which another file's clock tells better."""
        self._time_ns = [change(time_ns) for time_ns in self._time_ns]

    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the rows of some tables, thousands at a time."""
        for channel_id in sorted(channel_ids):
            rows = self._rows[channel_id]
            time_ns = self._time_ns[channel_id]
            size = rows.strides[0]
            for start in range(0, len(rows), _ROWS):
                part = np.ascontiguousarray(rows[start : start + _ROWS])
                offsets = size * np.arange(len(part))
                log_ns = time_ns[start : start + _ROWS]
                yield Block(
                    channel_id,
                    part.data.cast("B"),
                    offsets,
                    np.full_like(offsets, size),
                    log_ns,
                    log_ns,
                )

    def log_times(self) -> dict[int, TimeNs]:
        """Return the times of all rows by channel, (k,) ns."""
        return dict(enumerate(self._time_ns))


def clear_missing(rows: Floats) -> int:
    """Set cells that are no finite number to NaN; return how many there are in columns that have others."""
    some = 0
    for column in rows.T:
        missing = ~(np.abs(column) < _LARGEST)
        count = int(np.count_nonzero(missing))
        if count:
            column[missing] = np.nan
        if count < len(column):
            some += count
    return some


def clean_name(title: str) -> str:
    """Return the name by which a column is known."""
    return re.sub(r"[^\w.]+", "_", title_without_unit(title).lower()).strip("_.")


def widths_of(channel: LogChannel) -> dict[str, int]:
    """Return the columns of a table by their names, each with its numbers in a row."""
    return dict(msgspec.json.decode(channel.schema_data))


class RowReader:
    """Reads some columns of the rows of a table."""

    def __init__(self, channel: LogChannel, paths: Sequence[str]) -> None:
        widths = widths_of(channel)
        known: dict[str, str] = {}
        places = {ROW: [0]}
        self._size = 1
        for name, width in widths.items():
            known[name] = NUMBER
            places[name] = list(range(self._size, self._size + width))
            if width > 1:
                known[f"{name}[*]"] = NUMBER
                places[f"{name}[*]"] = places[name]
                for i, place in enumerate(places[name]):
                    places[f"{name}[{i}]"] = [place]
            self._size += width
        self.known: Kinds = known
        self._places: dict[str, list[int]] = {}
        self.names: dict[str, str] = {}  # of the columns, by path
        for path in paths:
            name = _name_of_column(path, list(widths))
            if name not in places:  # it may be the title of a column, with its unit
                name = _name_by_title(name)
            if name not in places:
                check_path(name, known, channel.topic)
                hint = f"'{name}' is behind the last number of its list"
                raise LogError(f"{channel.topic} has no '{path}'", hint)
            self._places[path] = places[name]
            self.names[path] = name.partition("[")[0]

    def columns(self, block: Block) -> Columns:
        """Return the columns of all rows of a block, (k, n)."""
        table = np.frombuffer(block.buffer, np.float64).reshape(-1, self._size)
        rows = table[block.offsets // (8 * self._size)]
        return {path: rows[:, places] for path, places in self._places.items()}


def _name_of_column(path: str, names: Sequence[str]) -> str:
    """Return the name of the column that a path counts from 1; a path that is no number as it is."""
    if path.isdecimal() and 0 < int(path) <= len(names):
        return names[int(path) - 1]
    return path


def _name_by_title(path: str) -> str:
    """Return the name of the column with a title, with the element of a list that is behind it."""
    element = re.search(r"\[(\d+|\*)\]$", path)
    if element:
        return clean_name(path.removesuffix(element[0])) + element[0]
    return clean_name(path)
