"""What the tables of a log say about the log itself: schemas and messages that are missing, stamps that are numbers."""

from collections.abc import Iterable
from typing import Final

import numpy as np

from insdvl_replay.core.errors import Note
from insdvl_replay.logs.columns.clocks import stamp_unit
from insdvl_replay.logs.columns.tables import Table
from insdvl_replay.logs.columns.topic_requirements import Source

_COPY_AGAIN: Final = "copy the log again from the recorder if it still has it"


def schema_notes(sources: Iterable[Source]) -> tuple[Note, ...]:
    """Say for which topics the log has no schema, so that a definition that comes with the tool was used.

    Parameters
    ----------
    sources : iterable of Source

    Returns
    -------
    tuple of Note
    """
    return tuple(
        Note("builtin_definition", f"{source.topic}: the log has no schema; that of {source.type_name} was assumed")
        for source in sources
        if source.channels[0].encoding == "cdr" and not all(channel.schema_text.strip() for channel in source.channels)
    )


def count_notes(tables: Iterable[Table]) -> tuple[Note, ...]:
    """Say where a log holds fewer or more messages than its summary announces.

    Parameters
    ----------
    tables : iterable of Table

    Returns
    -------
    tuple of Note
    """
    notes = []
    for table in tables:
        announced = sum(channel.messages for channel in table.source.channels)
        found = len(table) + table.repeats + len(table.unreadable_ns)
        if announced != found:
            text = f"{table.source.topic}: the log announces {announced} messages, and {found} are found"
            notes.append(Note("messages_missing", text, abs(announced - found), "warning", _COPY_AGAIN))
    return tuple(notes)


def left_out_notes(tables: Iterable[Table]) -> tuple[Note, ...]:
    """Say which messages do not fit their schema, and which are in more than one channel or file.

    Parameters
    ----------
    tables : iterable of Table

    Returns
    -------
    tuple of Note
    """
    notes = []
    for table in tables:
        topic = table.source.topic
        if count := len(table.unreadable_ns):
            behind_s = (np.array(table.unreadable_ns) - table.columns["log_time"].min()) * 1e-9
            text = (
                f"{topic}: {count} messages cannot be read and are left out, the first {behind_s.min():.3f} s and the "
                f"last {behind_s.max():.3f} s behind the first that can: {table.fault}"
            )
            notes.append(Note("messages_unreadable", text, count, "warning", _COPY_AGAIN))
        if table.repeats:
            text = f"{topic}: {table.repeats} messages are in two channels or files; each is used once"
            notes.append(Note("messages_repeated", text, table.repeats))
    return tuple(notes)


def stamp_notes(tables: Iterable[Table]) -> tuple[Note, ...]:
    """Say how stamps that are mere numbers were understood.

    Parameters
    ----------
    tables : iterable of Table

    Returns
    -------
    tuple of Note
    """
    notes = []
    for table in tables:
        source = table.source
        numbers = table.stamp_numbers
        if numbers is not None:
            unit = stamp_unit(numbers, table.columns["log_time"][:, 0])[1]
            text = f"{source.topic}: stamp '{source.stamp}' was read as {unit}"
            notes.append(Note(f"{source.role}_stamp_unit", text))
    return tuple(notes)
