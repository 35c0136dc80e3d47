"""What is in a log: its topics by their log times, who plays which role and why, and what the messages show.

Built on the functions that read a dive, so that what is said here is what a replay would meet. Times count from the
log's first message, on the recorder's clock.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import TimeNs, seconds
from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import Note, UserError, listed
from insdvl_replay.core.words import Reading
from insdvl_replay.inspection.dry_run import DryRun, Obstacle, PingFacts, ReferenceFacts
from insdvl_replay.inspection.proposal import propose
from insdvl_replay.logs.formats.log_file import by_topic
from insdvl_replay.logs.formats.recording import Recording, open_recording
from insdvl_replay.logs.read import Finding, find_roles, idle_sensors
from insdvl_replay.preparation.alignment import check_start
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
    table_of,
)

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_IDLE: Final = "sensors_idle"


@dataclass(frozen=True)
class LogFacts:
    """The file itself."""

    name: str
    parts: int  # files of which it consists; more than one for a bag
    size_bytes: int
    profile: str  # as the recorder signed it
    library: str
    compression: tuple[str, ...]  # of chunks; ``none`` for those without. Empty without chunks
    chunks: int
    messages: int
    has_summary: bool  # whether the file closes with a summary
    start_utc: str | None  # log time of the first message, ISO 8601; None without messages, or before 1970
    duration_s: float  # from the first to the last message
    metadata: tuple[str, ...]  # their names
    attachments: tuple[str, ...]


@dataclass(frozen=True)
class TopicFacts:
    """One topic, by the log times of its messages."""

    topic: str
    type_name: str
    encoding: str
    schema_encoding: str
    role: str  # what a replay takes from it; empty for nothing
    channels: int  # how many channels of the log carry the topic
    messages: int
    start_s: float | None  # None without messages
    end_s: float | None
    rate_hz: float | None  # between the first and the last message; None for fewer than two
    longest_gap_s: float | None


@dataclass(frozen=True)
class RoleFacts:
    """Who plays a role, and why."""

    role: str
    topic: str | None  # None where nobody does
    reason: str
    candidates: tuple[str, ...]  # topics between which the configuration has to choose
    fields: dict[str, str]  # path of the field by the quantity that is read from it


@dataclass(frozen=True)
class Inventory:
    """All that is known of a log."""

    log: LogFacts
    reading: Reading  # how much of the messages was read to know it
    topics: tuple[TopicFacts, ...]
    roles: tuple[RoleFacts, ...]
    conventions: dict[str, dict[str, Any]] = field(default_factory=dict)  # by topic: keys that its type settles
    clocks: tuple[Clock, ...] = ()
    pings: PingFacts | None = None  # this and the reference only where the messages were read whole
    reference: ReferenceFacts | None = None
    obstacles: tuple[Obstacle, ...] = ()  # empty where nothing was found that would stop a replay
    notes: tuple[Note, ...] = field(default=())
    configuration: str = ""  # TOML to start from where something stops a replay
    decisions: tuple[str, ...] = ()  # its keys about which a person must decide
    remaining: tuple[Obstacle, ...] = ()  # what stops a replay with it too, besides decisions without a value


def inspect_log(
    path: Path | Sequence[Path], config: Config, *, deep: bool = False, allow_damaged: bool = False
) -> Inventory:
    """State what a log holds and whether it can be replayed.

    Deep reads the messages of all roles whole, and goes as far as a replay would before its filters run; else the first
    messages of each role show of its clock and units. Damage that is allowed is reported, and is no obstacle.

    Raises
    ------
    LogError
        The file cannot be read at all.
    """
    log = open_recording(path, allow_damaged=True)
    with log.watched():
        inventory = _surveyed(log, config, deep=deep, allow_damaged=allow_damaged)
    try:
        if inventory.obstacles or not deep:
            # By what the types of the reference can give; of several, which is chosen decides what it gives.
            fields = {role.role: role.fields for role in inventory.roles}
            if not next(role.candidates for role in inventory.roles if role.role == "reference"):
                reference = fields["reference"]
                check_start(
                    config.initial,
                    has_reference=bool(reference),
                    has_position="latitude" in reference or "latitude" in fields.get("position", ()),
                    has_attitude="quaternion" in reference or "roll" in reference,
                    has_heading=bool(fields.get("heading")),
                )
            return inventory
        # Not imported before it is needed: a look at the file alone takes less than the filters' import.
        from insdvl_replay.preparation.prepared import read_checked_dive, with_reference_at_imu
        from insdvl_replay.preparation.run import prepare_with_heading

        dive = read_checked_dive(path, config, allow_damaged=allow_damaged)
        idle = (note for note in inventory.notes if note.code == _IDLE)
        notes = (*prepare_with_heading(with_reference_at_imu(dive, config), config).notes, *idle)
        return replace(inventory, notes=dive.notes + notes)
    except UserError as error:
        return replace(inventory, obstacles=(*inventory.obstacles, Obstacle(error.message, error.hint)))


def _surveyed(log: Recording, config: Config, *, deep: bool, allow_damaged: bool) -> Inventory:
    findings = find_roles(str(log.path), log.channels, config)
    seen = DryRun(log, config, deep)
    seen.examine(findings)
    sources = [source for finding in findings for source in (*finding.sources, *finding.candidates)]
    looked_at = {source.topic for source in sources}
    seen.examine_others(channel for channel in log.channels if channel.topic not in looked_at)
    log_times = log.log_times()
    proposal = propose(log, findings, seen, config)
    roles = []
    for finding in findings:
        topics = ", ".join(source.topic for source in finding.sources)
        fields = {quantity: path for source in finding.sources for quantity, path in source.fields.items()}
        candidates = tuple(source.topic for source in finding.candidates)
        roles.append(RoleFacts(finding.role, topics or None, finding.reason, candidates, fields))
    notes = [*log.notes, *seen.notes, *proposal.notes]
    if idle := idle_sensors(str(log.path), log.channels, findings, config):
        said = "; ".join(f"{name} by {' or '.join(topics)}" for name, topics in idle.items())
        aiding = ", ".join(f'"{word}"' for word in ("velocity", *idle))
        hint = f"--set 'filters.told.aiding=[{aiding}]'; evaluation.withheld judges by them"
        notes.append(Note(_IDLE, f"could aid a filter: {said}", len(idle), hint=hint))
    # Last of all, since damage inside the chunks is found as they are opened.
    damage = None if allow_damaged else log.damage_error()
    refused = [] if damage is None else [Obstacle(damage.message, damage.hint)]
    return Inventory(
        log=_log_facts(log, log_times),
        reading=Reading.WHOLE if deep else Reading.SAMPLE,
        topics=tuple(_topic_facts(log, log_times, findings)),
        roles=tuple(roles),
        conventions={source.topic: dict(source.conventions) for source in sources if source.conventions},
        clocks=tuple(seen.clocks),
        pings=seen.pings,
        reference=seen.reference,
        obstacles=(*refused, *seen.obstacles),
        notes=tuple(notes),
        configuration=proposal.configuration,
        decisions=proposal.decisions,
        remaining=proposal.obstacles,
    )


def _log_facts(log: Recording, log_times: Mapping[int, TimeNs]) -> LogFacts:
    parts, times = log.parts, [times for times in log_times.values() if times.size]
    first_ns = min((int(part.min()) for part in times), default=0)
    last_ns = max((int(part.max()) for part in times), default=0)
    start = _EPOCH + timedelta(microseconds=first_ns // 1000) if times and first_ns >= 0 else None
    return LogFacts(
        name=log.path.name,
        parts=len(parts),
        size_bytes=sum(part.size_bytes for part in parts),
        profile=", ".join(sorted({part.profile for part in parts})),
        library=", ".join(sorted({part.library for part in parts})),
        compression=tuple(sorted({name for part in parts for name in part.compression})),
        chunks=sum(part.chunk_count for part in parts),
        messages=sum(part.size for part in times),
        has_summary=all(part.has_summary for part in parts),
        start_utc=start.isoformat(timespec="seconds") if start else None,
        duration_s=(last_ns - first_ns) * 1e-9,
        metadata=tuple(record.name for part in parts for record in part.metadata),
        attachments=tuple(attachment.name for part in parts for attachment in part.attachments),
    )


def _topic_facts(log: Recording, log_times: Mapping[int, TimeNs], findings: Sequence[Finding]) -> Iterator[TopicFacts]:
    role_of = {source.topic: source.role for finding in reversed(findings) for source in finding.sources}
    start_ns = min((int(times.min()) for times in log_times.values() if times.size), default=0)
    for topic, same in sorted(by_topic(log.channels).items()):
        # The channel that has messages is the one to describe: some recorders register every topic twice.
        channel = max(same, key=lambda channel: channel.messages)
        time_ns = np.concatenate([log_times[channel.id] for channel in same])
        # A stable sort takes next to no time for what is in order already.
        time_s = np.sort(seconds(time_ns, start_ns), kind="stable")
        count = time_s.size
        span_s = float(time_s[-1] - time_s[0]) if count else 0.0
        yield TopicFacts(
            topic=channel.topic,
            type_name=channel.type_name,
            encoding=channel.encoding,
            schema_encoding=channel.schema_encoding,
            role=role_of.get(topic, ""),
            channels=len(same),
            messages=count,
            start_s=float(time_s[0]) if count else None,
            end_s=float(time_s[-1]) if count else None,
            rate_hz=(count - 1) / span_s if span_s > 0.0 else None,
            longest_gap_s=float(np.diff(time_s).max()) if count > 1 else None,
        )


# --- For people, and for scripts.

_PREFIXES: Final = ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"), (1, "B"))
_FOLDED: Final = 16
"""Letters of a type's name that a narrow terminal folds before it leaves out a column."""
_MOST_TOPICS: Final = 100
"""More are folded: recorders that write each field of each message as a topic make thousands."""
_LEAST_FOLDED: Final = 4
_MOST_EMPTY: Final = 40
_PROPOSAL: Final = "To start from, as a file for -c; the comments say what was seen and what is to decide:"


def inventory_document(inventory: Inventory) -> list[Part]:
    """Lay out an inventory; on a terminal, where the first sentence names the log, it needs no title."""
    proposal: list[Part] = []
    if inventory.configuration:
        open_points = Sentences(tuple(_open_points(inventory)))
        proposal = [Sentences((_PROPOSAL,)), Code(inventory.configuration, "toml"), open_points]
    return [
        Only(("markdown", "latex", "html"), (Title(inventory.log.name),)),
        *_opening(inventory),
        *inventory_tables(inventory),
        Sentences(tuple(_findings(inventory))),
        Only(("terminal", "markdown"), tuple(proposal)),
    ]


def inventory_csv(inventory: Inventory) -> str:
    """Write what is known of a log as tables one after the other.

    Several logs can be laid together, by the column ``log``. Between several values in a cell stands ``; ``. Tables
    without rows are left out, and so are proposed settings, which are none.
    """
    known = inventory
    conventions = [
        {"topic": topic, "key": key, "value": value}
        for topic, keys in known.conventions.items()
        for key, value in keys.items()
    ]
    tables: dict[str, Sequence[Any]] = {
        "file": [known.log],
        "topics": known.topics,
        "roles": known.roles,
        "clocks": known.clocks,
        "pings": [known.pings] if known.pings else [],
        "reference": [known.reference] if known.reference else [],
        "notes": known.notes,
        "obstacles": known.obstacles,
        "conventions": conventions,
    }

    def cell(value: Any) -> Any:
        if isinstance(value, dict):
            value = [f"{key}={part}" for key, part in value.items()]
        return "; ".join(map(str, value)) if isinstance(value, tuple | list) else value

    blocks = {}
    for name, rows in tables.items():
        records = [row if isinstance(row, dict) else asdict(row) for row in rows]
        if records:
            values = [(known.log.name, *map(cell, record.values())) for record in records]
            blocks[name] = (("log", *records[0]), values)
    return blocks_csv("table", blocks)


def inventory_tables(inventory: Inventory) -> list[DisplayTable]:
    """Lay out roles, conventions, topics and clocks."""
    roles = table_of(
        "Roles",
        inventory.roles,
        (
            ("role", "l", lambda role: role.role),
            ("topic", "l", lambda role: role.topic or MISSING),
            ("why", "l", lambda role: role.reason),
        ),
    )
    conventions = DisplayTable(
        "Conventions: what the type of a topic says where the configuration does not",
        ("topic", "key and value"),
        "ll",
        tuple(
            (topic, tuple(f"{key} = {msgspec.json.encode(value).decode()}" for key, value in keys.items()))
            for topic, keys in inventory.conventions.items()
        ),
    )
    empty = [topic.topic for topic in inventory.topics if not topic.messages]
    topics = DisplayTable(
        "Topics: rate, longest gap and span by the times of recording",
        ("topic\n  type, encoding", "role", "messages", "rate\n[Hz]", "gap\n[s]", "from\n[s]", "to\n[s]"),
        "llrrrrr",
        tuple(_topic_rows([topic for topic in inventory.topics if topic.messages])),
        f"without messages: {listed(empty, _MOST_EMPTY)}" if empty else "",
        spare=(5, 6, 4, 3, 1),
        folds=_FOLDED,
    )
    messages = {topic.topic: topic.messages for topic in inventory.topics}
    clocks = table_of(
        "Clocks: log time minus stamp, by the first messages",
        inventory.clocks,
        (
            ("topic", "l", lambda clock: clock.topic),
            ("stamp", "l", lambda clock: clock.stamp),
            ("first", "r", lambda clock: "all" if clock.messages == messages.get(clock.topic) else str(clock.messages)),
            ("median\n[s]", "r", lambda clock: number(clock.log_minus_stamp_s)),
            ("spread\n[s]", "r", lambda clock: number(clock.spread_s)),
            ("back\nsteps", "r", lambda clock: str(clock.back_steps)),
            ("repeats", "r", lambda clock: str(clock.repeats)),
            ("rate\n[Hz]", "r", lambda clock: number(clock.rate_hz)),
        ),
        spare=(2, 6, 5, 7, 4),
    )
    return [table for table in (roles, conventions, topics, replace(clocks, folds=4)) if table.rows]


def _topic_rows(topics: Sequence[TopicFacts]) -> Iterator[tuple[CellText, ...]]:
    """Lay out the topics, of more than can be looked through those without a role under one parent in one row."""
    parent = {topic.topic: topic.topic.rpartition("/")[0] for topic in topics}
    below = Counter(parent[topic.topic] for topic in topics if not topic.role)
    shown: set[str] = set()
    for topic in topics:
        above = parent[topic.topic]
        if topic.role or len(topics) <= _MOST_TOPICS or not above or below[above] < _LEAST_FOLDED:
            # Some recorders name a topic after its type; once is enough.
            type_name = "" if topic.type_name == topic.topic else f"{topic.type_name or 'no type'}, "
            yield (
                (topic.topic, f"  {type_name}{topic.encoding or 'no encoding'}"),
                topic.role,
                str(topic.messages),
                *(MISSING if value is None else f"{value:.3g}" for value in (topic.rate_hz, topic.longest_gap_s)),
                *(MISSING if value is None else f"{value:.0f}" for value in (topic.start_s, topic.end_s)),
            )
        elif above not in shown:
            shown.add(above)
            same = [other for other in topics if not other.role and parent[other.topic] == above]
            encodings = ", ".join(sorted({other.encoding or "no encoding" for other in same}))
            yield (
                (f"{above}/*", f"  {len(same)} topics, {encodings}"),
                "",
                str(sum(other.messages for other in same)),
                MISSING,
                MISSING,
                f"{min(other.start_s or 0.0 for other in same):.0f}",
                f"{max(other.end_s or 0.0 for other in same):.0f}",
            )


def _opening(inventory: Inventory) -> Iterator[str]:
    log = inventory.log
    used = sum(1 for topic in inventory.topics if topic.messages)
    unit, name = next((unit, name) for unit, name in _PREFIXES if log.size_bytes >= unit or unit == 1)
    size = f"{log.size_bytes / unit:.3g} {name}{f' in {log.parts} parts' if log.parts > 1 else ''}"
    summary = "" if log.has_summary else ", no summary"
    compression = f" ({', '.join(log.compression)})" if log.chunks else ""
    yield f"{log.name}: {size}, profile {log.profile or MISSING}, written by {log.library or MISSING}"
    chunks = f"chunks: {log.chunks}{compression}{summary}"
    yield f"{log.messages} messages on {used} of {len(inventory.topics)} topics, {chunks}"
    if log.start_utc is not None:
        yield f"{log.duration_s:.1f} s from {log.start_utc} by the recorder's clock"
    for kind, names in (("metadata", log.metadata), ("attachments", log.attachments)):
        if names:
            yield f"{kind}: {', '.join(names)}"


def _findings(inventory: Inventory) -> Iterator[Remark]:
    """State what was seen of pings and reference, every note, every obstacle, and last whether it can be replayed."""
    if (pings := inventory.pings) is not None:
        announced = sum(topic.messages for topic in inventory.topics if topic.role == "dvl")
        messages = f"{'the first ' if pings.messages < announced else ''}{pings.messages} messages"
        repeated = f" ({100 * pings.repeats / pings.messages:.0f} % repeats)" if pings.repeats else ""
        rate = f" at {number(pings.rate_hz)} Hz" if pings.rate_hz is not None else ""
        beams = f"valid beams: four or more in {pings.four_or_more}, three in {pings.three}, fewer in {pings.fewer}"
        if not pings.four_or_more + pings.three + pings.fewer:
            beams = "no beams"
        yield Remark(f"dvl: {pings.pings} usable pings in {messages}{repeated}{rate}; {beams}")
    if (reference := inventory.reference) is not None:
        yield Remark(
            f"reference: {reference.rows} rows; part of the IMU's time between first and last row: "
            f"position {reference.position_pct:.0f} %, velocity {reference.velocity_pct:.0f} %, "
            f"attitude {reference.attitude_pct:.0f} %"
        )
    for note in inventory.notes:
        yield Remark(f"{note.severity}: {note.text} [{note.code}]", note.hint)
    for obstacle in inventory.obstacles:
        yield Remark(f"stops a replay: {obstacle.message}", obstacle.hint)
    if count := len(inventory.obstacles):
        yield Remark(f"cannot be replayed as it is: {count} {'thing' if count == 1 else 'things'} to settle first")
    elif inventory.reading == Reading.SAMPLE:
        yield Remark("nothing seen that would stop a replay; --deep reads the messages whole")
    else:
        yield Remark("can be replayed")


def _open_points(inventory: Inventory) -> Iterator[Remark]:
    """State what the proposed settings leave open."""
    if inventory.decisions:
        yield Remark(f"to decide in it: {', '.join(inventory.decisions)}")
    for obstacle in inventory.remaining:
        hint = "" if obstacle in inventory.obstacles else obstacle.hint
        yield Remark(f"stops a replay with it too: {obstacle.message}", hint)
    if not inventory.decisions and not inventory.remaining:
        yield Remark("nothing is left open in it")
