"""What a log holds, for people: the file, roles, topics and clocks, what was noticed; and for scripts, as CSV."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any, Final

import msgspec

from insdvl_replay.core.errors import listed
from insdvl_replay.core.words import Reading
from insdvl_replay.inspection.inventory import Inventory, LogFacts, PingFacts, ReferenceFacts, TopicFacts
from insdvl_replay.report.csv_tables import blocks_csv
from insdvl_replay.report.document import (
    MISSING,
    CellText,
    Code,
    DisplayTable,
    Only,
    Part,
    Remark,
    Sentences,
    Title,
    number,
)

_PREFIXES: Final = ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"))
_FOLDED: Final = 16
"""Letters of a type's name that a narrow terminal folds before it leaves out a column."""
_MOST_TOPICS: Final = 100
"""More are folded: recorders that write each field of each message as a topic make thousands."""
_LEAST_FOLDED: Final = 4
_MOST_EMPTY: Final = 40
_SPAN: Final = ("start_s", "end_s")
_PROPOSAL: Final = "To start from, as a file for -c; the comments say what was seen and what is to decide:"


def inventory_document(inventory: Inventory) -> list[Part]:
    """Lay out an inventory; on a terminal, where the first sentence names the log, it needs no title."""
    return [
        Only(("markdown", "latex", "html"), (Title(inventory.log.name),)),
        *_opening(inventory),
        *inventory_tables(inventory),
        Sentences(tuple(_findings(inventory))),
        Only(("terminal", "markdown"), tuple(_proposal(inventory))),
    ]


def inventory_csv(inventory: Inventory) -> str:
    """Write what is known of a log as tables one after the other.

    Several logs can be laid together, by the column ``log``. Between several values in a cell stands ``; ``. Tables
    without rows are left out, and so are proposed settings, which are none.
    """
    records: dict[str, Sequence[Any]] = {
        "file": [inventory.log],
        "topics": inventory.topics,
        "roles": inventory.roles,
        "clocks": inventory.clocks,
        "pings": [inventory.pings] if inventory.pings else [],
        "reference": [inventory.reference] if inventory.reference else [],
        "notes": inventory.notes,
        "obstacles": inventory.obstacles,
    }
    tables = {name: _columns(rows) for name, rows in records.items() if rows}
    conventions = [(topic, key, value) for topic, keys in inventory.conventions.items() for key, value in keys.items()]
    if conventions:
        tables["conventions"] = ("topic", "key", "value"), conventions
    log = inventory.log.name
    blocks = {
        name: (("log", *header), [(log, *map(_cell, row)) for row in rows]) for name, (header, rows) in tables.items()
    }
    return blocks_csv("table", blocks)


def inventory_tables(inventory: Inventory) -> list[DisplayTable]:
    """Lay out roles, conventions, topics and clocks."""
    tables = (_roles(inventory), _conventions(inventory), _topics(inventory), _clocks(inventory))
    return [table for table in tables if table.rows]


def _roles(inventory: Inventory) -> DisplayTable:
    return DisplayTable(
        "Roles",
        ("role", "topic", "why"),
        "lll",
        tuple((role.role, role.topic or MISSING, role.reason) for role in inventory.roles),
    )


def _conventions(inventory: Inventory) -> DisplayTable:
    return DisplayTable(
        "Conventions: what the type of a topic says where the configuration does not",
        ("topic", "key and value"),
        "ll",
        tuple(
            (topic, tuple(f"{key} = {msgspec.json.encode(value).decode()}" for key, value in keys.items()))
            for topic, keys in inventory.conventions.items()
        ),
    )


def _topics(inventory: Inventory) -> DisplayTable:
    empty = [topic for topic in inventory.topics if not topic.messages]
    return DisplayTable(
        "Topics: rate, longest gap and span by the times of recording",
        ("topic\n  type, encoding", "role", "messages", "rate\n[Hz]", "gap\n[s]", "from\n[s]", "to\n[s]"),
        "llrrrrr",
        tuple(_folded([topic for topic in inventory.topics if topic.messages])),
        f"without messages: {listed([topic.topic for topic in empty], _MOST_EMPTY)}" if empty else "",
        spare=(5, 6, 4, 3, 1),
        folds=_FOLDED,
    )


def _folded(topics: Sequence[TopicFacts]) -> Iterator[tuple[CellText, ...]]:
    """Lay out the topics, of more than can be looked through those without a role under one parent in one row."""
    below = Counter(_parent(topic) for topic in topics if not topic.role)
    shown: set[str] = set()
    for topic in topics:
        parent = _parent(topic)
        if topic.role or len(topics) <= _MOST_TOPICS or not parent or below[parent] < _LEAST_FOLDED:
            yield _topic(topic)
        elif parent not in shown:
            shown.add(parent)
            yield _fold(parent, [other for other in topics if not other.role and _parent(other) == parent])


def _parent(topic: TopicFacts) -> str:
    return topic.topic.rpartition("/")[0]


def _fold(parent: str, topics: Sequence[TopicFacts]) -> tuple[CellText, ...]:
    encodings = ", ".join(sorted({topic.encoding or "no encoding" for topic in topics}))
    starts, ends = ([value for topic in topics if (value := getattr(topic, name)) is not None] for name in _SPAN)
    return (
        (f"{parent}/*", f"  {len(topics)} topics, {encodings}"),
        "",
        str(sum(topic.messages for topic in topics)),
        MISSING,
        MISSING,
        f"{min(starts):.0f}",
        f"{max(ends):.0f}",
    )


def _topic(topic: TopicFacts) -> tuple[CellText, ...]:
    # Some recorders name a topic after its type; once is enough.
    type_name = "" if topic.type_name == topic.topic else f"{topic.type_name or 'no type'}, "
    return (
        (topic.topic, f"  {type_name}{topic.encoding or 'no encoding'}"),
        topic.role,
        str(topic.messages),
        *(MISSING if value is None else f"{value:.3g}" for value in (topic.rate_hz, topic.longest_gap_s)),
        *(MISSING if value is None else f"{value:.0f}" for value in (topic.start_s, topic.end_s)),
    )


def _clocks(inventory: Inventory) -> DisplayTable:
    messages = {topic.topic: topic.messages for topic in inventory.topics}
    return DisplayTable(
        "Clocks: log time minus stamp, by the first messages",
        ("topic", "stamp", "first", "median\n[s]", "spread\n[s]", "back\nsteps", "repeats", "rate\n[Hz]"),
        "llrrrrrr",
        tuple(
            (
                clock.topic,
                clock.stamp,
                "all" if clock.messages == messages.get(clock.topic) else str(clock.messages),
                number(clock.log_minus_stamp_s),
                number(clock.spread_s),
                str(clock.back_steps),
                str(clock.repeats),
                number(clock.rate_hz),
            )
            for clock in inventory.clocks
        ),
        spare=(2, 6, 5, 7, 4),
        folds=4,
    )


def _findings(inventory: Inventory) -> Iterator[Remark]:
    """State what was seen of pings and reference, every note, every obstacle, and last whether it can be replayed."""
    if inventory.pings is not None:
        announced = sum(topic.messages for topic in inventory.topics if topic.role == "dvl")
        yield Remark(_pings(inventory.pings, announced))
    if inventory.reference is not None:
        yield Remark(_coverage(inventory.reference))
    for note in inventory.notes:
        yield Remark(f"{note.severity}: {note.text} [{note.code}]", note.hint)
    for obstacle in inventory.obstacles:
        yield Remark(f"stops a replay: {obstacle.message}", obstacle.hint)
    yield Remark(_verdict(inventory))


def _proposal(inventory: Inventory) -> Iterator[Part]:
    """Show the proposed settings, if there are any, and what they leave open."""
    if inventory.configuration:
        yield Sentences((_PROPOSAL,))
        yield Code(inventory.configuration, "toml")
        yield Sentences(tuple(_open_points(inventory)))


def _open_points(inventory: Inventory) -> Iterator[Remark]:
    if inventory.decisions:
        yield Remark(f"to decide in it: {', '.join(inventory.decisions)}")
    for obstacle in inventory.remaining:
        hint = "" if obstacle in inventory.obstacles else obstacle.hint
        yield Remark(f"stops a replay with it too: {obstacle.message}", hint)
    if not inventory.decisions and not inventory.remaining:
        yield Remark("nothing is left open in it")


def _opening(inventory: Inventory) -> Iterator[str]:
    log = inventory.log
    used = sum(1 for topic in inventory.topics if topic.messages)
    size = f"{_size(log.size_bytes)}{f' in {log.parts} parts' if log.parts > 1 else ''}"
    yield f"{log.name}: {size}, profile {log.profile or MISSING}, written by {log.library or MISSING}"
    yield f"{log.messages} messages on {used} of {len(inventory.topics)} topics, {_chunks(log)}"
    if log.start_utc is not None:
        yield f"{log.duration_s:.1f} s from {log.start_utc} by the recorder's clock"
    for kind, names in (("metadata", log.metadata), ("attachments", log.attachments)):
        if names:
            yield f"{kind}: {', '.join(names)}"


def _size(size_bytes: int) -> str:
    return next(
        (f"{size_bytes / unit:.3g} {name}" for unit, name in _PREFIXES if size_bytes >= unit), f"{size_bytes} B"
    )


def _chunks(log: LogFacts) -> str:
    summary = "" if log.has_summary else ", no summary"
    compression = f" ({', '.join(log.compression)})" if log.chunks else ""
    return f"chunks: {log.chunks}{compression}{summary}"


def _pings(pings: PingFacts, announced: int) -> str:
    rate = f" at {number(pings.rate_hz)} Hz" if pings.rate_hz is not None else ""
    repeated = f" ({100 * pings.repeats / pings.messages:.0f} % repeats)" if pings.repeats else ""
    beams = "no beams"
    if pings.four_or_more + pings.three + pings.fewer:
        beams = f"valid beams: four or more in {pings.four_or_more}, three in {pings.three}, fewer in {pings.fewer}"
    messages = f"{'the first ' if pings.messages < announced else ''}{pings.messages} messages"
    return f"dvl: {pings.pings} usable pings in {messages}{repeated}{rate}; {beams}"


def _coverage(reference: ReferenceFacts) -> str:
    return (
        f"reference: {reference.rows} rows; part of the IMU's time between first and last row: "
        f"position {reference.position_pct:.0f} %, velocity {reference.velocity_pct:.0f} %, "
        f"attitude {reference.attitude_pct:.0f} %"
    )


def _verdict(inventory: Inventory) -> str:
    count = len(inventory.obstacles)
    if count:
        return f"cannot be replayed as it is: {count} {'thing' if count == 1 else 'things'} to settle first"
    if inventory.reading == Reading.SAMPLE:
        return "nothing seen that would stop a replay; --deep reads the messages whole"
    return "can be replayed"


def _columns(records: Sequence[Any]) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    """Return the names of the fields of records of one kind, and their values."""
    names = tuple(field.name for field in fields(records[0]))
    return names, [tuple(getattr(record, name) for name in names) for record in records]


def _cell(value: Any) -> Any:
    match value:
        case dict():
            return "; ".join(f"{key}={part}" for key, part in value.items())
        case tuple() | list():
            return "; ".join(map(str, value))
    return value
