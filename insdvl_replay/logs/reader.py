"""A log becomes a dive."""

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import cast

import numpy as np

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive, ImuColumns
from insdvl_replay.core.dive_record import Channel, dive_name
from insdvl_replay.core.errors import Note
from insdvl_replay.core.quantities import IS_REFERENCE
from insdvl_replay.core.runtime import report_stage
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.columns.roles import RoleColumns, find_roles
from insdvl_replay.logs.columns.solutions import solution_name
from insdvl_replay.logs.columns.table_reading import read_tables
from insdvl_replay.logs.columns.tables import Table, stamp_unit
from insdvl_replay.logs.columns.topic_requirements import Source
from insdvl_replay.logs.container.loss import COPY_AGAIN
from insdvl_replay.logs.container.recording import open_recording
from insdvl_replay.logs.container.records import LogChannel, by_topic
from insdvl_replay.logs.encoding.ros2msg import missing_types


def read_dive(path: Path | Sequence[Path], config: Config, *, allow_damaged: bool = False) -> Dive:
    """Read everything that is needed to replay a dive.

    Parameters
    ----------
    path : Path or sequence of Path
        A log, MCAP, .db3 or .bag, a folder with the parts of one recording, or several of them that are one dive.
    config : Config
        Names topics, fields, units and axes where the types do not tell them.
    allow_damaged : bool
        Read what can be believed of a damaged log; what is lost is a note.

    Returns
    -------
    Dive
        Clean columns; every loss is a note. Whether they can be so is not asked, and the span of the configuration is
        not applied.

    Raises
    ------
    LogError
        The file cannot be read, changes meanwhile or is damaged, has no IMU or DVL, is not clear about which topic is
        which, or mixes clocks.
    ConfigError
        The axes or the beam geometry of the configuration cannot be.
    """
    report_stage("reading the log")
    import insdvl_replay.logs.container.record_loops  # noqa: F401  all records are walked here: with the compiled loops

    log = open_recording(path, allow_damaged=allow_damaged)
    place, name = str(log.path), dive_name(log.path)
    config = config.of_dive(name)
    findings = find_roles(place, log.channels, config)
    for error in filter(None, (finding.error for finding in findings)):
        raise error
    sources = [source for finding in findings for source in finding.sources]
    with log.watched(), ThreadPoolExecutor(1) as checker:
        digests = checker.submit(log.digests)
        tables = read_tables(log, sources)
        log.check_unopened()
        sha256 = log.sha256(digests.result())
    notes = [
        *log.notes,
        *schema_notes(sources),
        *shared_topic_notes(sources),
        *loss_notes(tables),
        *stamp_notes(tables),
    ]
    channels = _channels(log.channels, sources)
    del log  # its file was mapped, and decoding needs the room
    columns = RoleColumns(place, config)
    notes += columns.clock_notes([table.clock() for table in tables])
    for finding in filter(lambda finding: finding.sources, findings):
        notes += columns.decode(finding.role, [tables.pop(0) for _ in finding.sources])
    notes += columns.read_files()
    return Dive(
        name=name,
        imu=cast(ImuColumns, columns.imu),  # else there was an error
        dvl=columns.dvl,
        reference=columns.reference,
        truth=columns.truth,
        sensors=columns.sensors,
        solutions=columns.solutions,
        topics=columns.topics,
        sha256=sha256,
        channels=channels,
        notes=tuple(notes),
    )


def _channels(channels: Sequence[LogChannel], sources: Sequence[Source]) -> tuple[Channel, ...]:
    """List the topics, each once, with their roles."""
    role_of = {source.topic: source.role for source in reversed(sources)}
    return tuple(
        Channel(
            topic=topic,
            type_name=same[0].type_name,
            encoding=same[0].encoding,
            role=role_of.get(topic, ""),
            messages=sum(channel.messages for channel in same),
        )
        for topic, same in sorted(by_topic(channels).items())
    )


def schema_notes(sources: Iterable[Source]) -> list[Note]:
    """State for which topics the log has no schema, or a part of one, so that definitions of the tool were used."""
    return [
        Note("builtin_definition", f"{source.topic}: the log has no schema{lacking} was assumed")
        for source in sources
        if source.channels[0].encoding == "cdr" and (lacking := _lacking(source))
    ]


def _lacking(source: Source) -> str:
    if not all(channel.schema_text.strip() for channel in source.channels):
        return f"; that of {source.type_name}"
    texts = {(one.type_name, one.schema_text) for one in source.channels if one.schema_encoding != "ros2idl"}
    missing = {name for text in texts for name in missing_types(*text)}
    return f" of {', '.join(sorted(missing))}; what comes with the tool" if missing else ""


def shared_topic_notes(sources: Sequence[Source]) -> Iterator[Note]:
    """State which solutions come in the messages of the reference: what they were made of may be what it is."""
    of_reference = {source.topic for source in sources if source.role == "reference"}
    for source in sources:
        name = solution_name(source.role)
        if name is not None and source.topic in of_reference:
            text = f"{source.role} is read from messages of {source.topic}, as the reference is, and may know of it"
            hint = "reference.topic and reference.fix name what it is to be judged by"
            yield Note(f"solution_{name}{IS_REFERENCE}", text, 1, Severity.WARNING, hint)


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
            notes.append(Note(f"{source.code}_stamp_unit", text))
    return notes


def _missing_note(table: Table) -> Note | None:
    announced = sum(channel.messages for channel in table.source.channels)
    found = len(table) + table.others + table.duplicates + len(table.unreadable_ns)
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
