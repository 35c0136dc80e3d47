"""What a log holds of one topic that plays a role, as columns, and what is said of the log by them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.channel import Clock
from insdvl_replay.core.columns import NS_PER_S, Floats, TimeNs, nanoseconds
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.columns.clocks import measure_clock, stamp_unit
from insdvl_replay.logs.columns.topic_requirements import Source
from insdvl_replay.logs.container.damage import COPY_AGAIN, damaged_file_error
from insdvl_replay.logs.encoding.field_paths import Columns, Kinds, fields_hint, split_paths

RECORDER_STAMPS: Final = ("log_time", "publish_time")
"""Stamps that stand in no message."""


@dataclass(frozen=True)
class Table:
    """The messages of one topic, as the log has them: not sorted, not checked, in the log's units and axes.

    Attributes
    ----------
    where : (str, str)
        File and topic, for messages to the user.
    columns : dict of str to ndarray, shape (k, n)
        By field path; ``log_time`` and ``publish_time`` are the recorder's.
    unreadable_ns : tuple of int
        Log times of messages that are left out because they do not fit their schema.
    fault : LogError or None
        What is wrong with the first of these.
    duplicates : int
        Messages that are left out because another channel or file holds them too.
    known : mapping of str to str
        Every path that the messages have, with the type of what is there.
    files : ndarray of int64, shape (k,), or None
        Number of the file from which each message is, where they are from several.
    has_whole_times : bool
        Whether the stamps were seconds and nanoseconds. Their column is nanoseconds, which takes half the memory.
    """

    where: tuple[str, str]
    source: Source
    columns: Columns
    unreadable_ns: tuple[int, ...] = ()
    fault: LogError | None = None
    duplicates: int = 0
    known: Kinds = field(default_factory=dict)
    files: NDArray[np.int64] | None = None
    has_whole_times: bool = False

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(next(iter(self.columns.values())))

    def __contains__(self, quantity: str) -> bool:
        """Return whether the topic holds a quantity."""
        return quantity in self.source.fields

    def values(self, quantity: str, width: int | None = None) -> Floats:
        """Return a quantity as numbers.

        Parameters
        ----------
        quantity : str
            As `known_types` and the configuration name it.
        width : int, optional
            How many numbers each message must hold.

        Returns
        -------
        ndarray, shape (k, n)

        Raises
        ------
        LogError
            The field does not hold that many numbers.
        """
        path = self.source.fields[quantity]
        parts = [self.columns[part].astype(np.float64, copy=False) for part in split_paths(path)]
        values = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        if width is not None and values.shape[1] != width:
            raise LogError(
                f"field '{path}' holds {values.shape[1]} numbers where {width} are needed",
                f"{self.source.role}.{quantity} must name {width} numbers; {fields_hint(self.known, path)}",
                *self.where,
            )
        return values

    def column(self, quantity: str) -> Floats:
        """Return a quantity that is one number in each message.

        Returns
        -------
        ndarray, shape (k,)

        Raises
        ------
        LogError
            The field holds more than one number.
        """
        single: Floats = self.values(quantity, 1)[:, 0]
        return single

    def time_ns(self) -> TimeNs:
        """Return the times of validity.

        Returns
        -------
        ndarray, shape (k,)

        Raises
        ------
        LogError
            The stamp's field is no time, or the same in every message.
        """
        stamp = self.source.stamp
        time_ns = self.columns[stamp][:, 0] if stamp in RECORDER_STAMPS else self._stamped(stamp_path(stamp))
        if time_ns.size > 1 and time_ns.min() == time_ns.max():
            raise LogError(
                f"stamp '{stamp}' is {time_ns[0] / NS_PER_S:.9f} s in each of {time_ns.size} messages",
                f'{self.source.role}.stamp = "log_time"',
                *self.where,
            )
        latency_ns = nanoseconds(self.source.latency_s)
        return time_ns - latency_ns if latency_ns else time_ns

    @property
    def stamp_numbers(self) -> NDArray[Any] | None:
        """Stamps that are mere numbers, shape (k,); None where they are times."""
        values = self.columns[stamp_path(self.source.stamp)]
        is_time = self.source.stamp in RECORDER_STAMPS or self.has_whole_times or values.shape[1] != 1
        return None if is_time else values[:, 0]

    def clock(self) -> Clock:
        """Compare the times of validity with the times of recording.

        Raises
        ------
        LogError
            As of `time_ns`.
        """
        source = self.source
        return measure_clock(source.role, source.topic, source.stamp, self.time_ns(), self.columns["log_time"][:, 0])

    def damage_error(self) -> LogError:
        """Return the error with which a log is refused of which messages cannot be read."""
        faults = [self.fault] * len(self.unreadable_ns) if self.fault else []
        return damaged_file_error(faults, [self.columns["log_time"][:, 0]], "messages")

    def _stamped(self, path: str) -> TimeNs:
        values = self.columns[path]
        if self.has_whole_times:
            return values[:, 0]
        if values.shape[1] != 1:
            raise LogError(
                f"field '{path}' holds {values.shape[1]} numbers and is no time",
                f"{self.source.role}.stamp names a builtin_interfaces/Time or one number",
                *self.where,
            )
        if not np.isfinite(values).all():
            raise LogError(
                f"stamp '{path}' is no number in {np.count_nonzero(~np.isfinite(values))} messages",
                f'{self.source.role}.stamp = "log_time"',
                *self.where,
            )
        counted = values[:, 0] * stamp_unit(values[:, 0], self.columns["log_time"][:, 0])[0]
        return counted if counted.dtype == np.int64 else np.rint(counted).astype(np.int64)


def stamp_path(stamp: str) -> str:
    """Return the field of a stamp; ``header`` is short for that of a ROS message."""
    return "header.stamp" if stamp == "header" else stamp


def schema_notes(sources: Iterable[Source]) -> list[Note]:
    """State for which topics the log has no schema, so that a definition that comes with the tool was used."""
    return [
        Note("builtin_definition", f"{source.topic}: the log has no schema; that of {source.type_name} was assumed")
        for source in sources
        if source.channels[0].encoding == "cdr" and not all(channel.schema_text.strip() for channel in source.channels)
    ]


def loss_notes(tables: Sequence[Table]) -> list[Note]:
    """State where messages are missing, do not fit their schema, or are in more than one channel or file."""
    left_out = (note for table in tables for note in (_unreadable_note(table), _duplicates_note(table)))
    return [note for note in (*map(_missing_note, tables), *left_out) if note]


def stamp_notes(tables: Iterable[Table]) -> list[Note]:
    """State how stamps that are mere numbers were understood."""
    notes = []
    for table in tables:
        source, numbers = table.source, table.stamp_numbers
        if numbers is not None:
            unit = stamp_unit(numbers, table.columns["log_time"][:, 0])[1]
            text = f"{source.topic}: stamp '{source.stamp}' was read as {unit}"
            notes.append(Note(f"{source.role}_stamp_unit", text))
    return notes


def _missing_note(table: Table) -> Note | None:
    announced = sum(channel.messages for channel in table.source.channels)
    found = len(table) + table.duplicates + len(table.unreadable_ns)
    if announced == found:
        return None
    text = f"{table.source.topic}: the log announces {announced} messages, and {found} are found"
    return Note("messages_missing", text, abs(announced - found), Severity.WARNING, COPY_AGAIN)


def _unreadable_note(table: Table) -> Note | None:
    count = len(table.unreadable_ns)
    if not count or table.fault is None:
        return None
    behind_s = (np.array(table.unreadable_ns) - table.columns["log_time"].min()) * 1e-9
    text = (
        f"{table.source.topic}: {count} messages cannot be read and are left out, the first {behind_s.min():.3f} s and "
        f"the last {behind_s.max():.3f} s behind the first that can: {table.fault.message}"
    )
    return Note("messages_unreadable", text, count, Severity.WARNING, COPY_AGAIN)


def _duplicates_note(table: Table) -> Note | None:
    text = f"{table.source.topic}: {table.duplicates} messages are in two channels or files; each is used once"
    return Note("messages_repeated", text, table.duplicates) if table.duplicates else None
