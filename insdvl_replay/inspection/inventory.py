"""What is known of a log, and how it is shown.

Times count from the log's first message, on the recorder's clock.
"""

import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final

import msgspec

from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import Note, counted, listed
from insdvl_replay.core.words import Reading
from insdvl_replay.document.parts import (
    Block,
    Callout,
    CellText,
    Code,
    DisplayTable,
    Only,
    Part,
    Remark,
    Result,
    Sentences,
    Title,
)
from insdvl_replay.document.tables import MISSING, number, table_of


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
    start_utc: (
        str | None
    )  # log time of the first message, ISO 8601; None without messages, or before 1970
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
class PingFacts:
    """How many messages of the DVL are pings of their own, and how many beams these have."""

    messages: int  # all that were read
    repeats: int  # those that repeat the one before
    pings: int  # those that can be used
    four_or_more: int  # pings by their beams; all 0 where the DVL reports velocities only
    three: int
    fewer: int
    rate_hz: float | None  # one over the median time between pings


@dataclass(frozen=True)
class ReferenceFacts:
    """What the reference gives, and over which part of the IMU's span, from the first to the last row that has it."""

    rows: int
    position_pct: float
    velocity_pct: float
    attitude_pct: float


@dataclass(frozen=True)
class Blocker:
    """What would stop a replay: the error that ``run`` would end with."""

    message: str
    hint: str


@dataclass(frozen=True)
class Inventory:
    """All that is known of a log."""

    log: LogFacts
    reading: Reading  # how much of the messages was read to know it
    topics: tuple[TopicFacts, ...]
    roles: tuple[RoleFacts, ...]
    conventions: dict[str, dict[str, Any]] = field(
        default_factory=dict
    )  # by topic: keys that its type settles
    clocks: tuple[Clock, ...] = ()
    pings: PingFacts | None = None  # this and the reference only where the messages were read whole
    reference: ReferenceFacts | None = None
    blockers: tuple[Blocker, ...] = ()  # empty where nothing was found that would stop a replay
    notes: tuple[Note, ...] = field(default=())
    configuration: str = ""  # TOML to start from where something stops a replay
    decisions: tuple[str, ...] = ()  # its keys about which a person must decide
    remaining: tuple[
        Blocker, ...
    ] = ()  # what stops a replay with it too, besides decisions without a value


# --- For people, and for scripts.

_PREFIXES: Final = ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"), (1, "B"))
_FOLDED: Final = (
    16  # letters of a type's name that a narrow terminal folds before it leaves out a column
)
_MOST_TOPICS: Final = 100  # more are folded: recorders that write each field of each message as a topic make thousands
_LEAST_FOLDED: Final = 4
_MOST_EMPTY: Final = 40
_LONGEST_CLAUSE: Final = 120  # letters of a blocker in the answer
_PROPOSAL: Final = (
    "Proposed settings, a file for -c. The comments give the reasons and what to decide:"
)


def answer_lines(inventory: Inventory, arguments: str = "") -> list[Callout | Code]:
    """Say whether a log can be replayed, and with which command; ``arguments`` name it and its settings."""
    arguments = arguments or shlex.quote(inventory.log.name)
    run = f"insdvl-replay run {arguments}"
    name = inventory.log.name
    if not inventory.blockers:
        found = {
            Reading.SUMMARY: "has what a replay needs by its summary; `run` fetches and reads it",
            Reading.SAMPLE: "can be replayed by its first messages; --deep reads all",
            Reading.WHOLE: "can be replayed",
        }[inventory.reading]
        return [Callout(f"{name} {found}:", "good"), Code(run, "")]
    # The first clause of the first blocker; all are below in full.
    first = inventory.blockers[0]
    count = len(inventory.blockers)
    why = (first.message.partition(f"{name}: ")[2] or first.message).partition("; ")[0]
    why = why if len(why) < _LONGEST_CLAUSE else why.partition(": ")[0]
    refused = Callout(
        f"{name} cannot be replayed as it is ({counted(count, 'blocker')}): {why}", "bad"
    )
    if inventory.configuration and not inventory.remaining:
        return [
            refused,
            Code(
                f"insdvl-replay inspect {arguments} --propose vehicle.toml\n{run} -c vehicle.toml",
                "",
            ),
        ]
    return [refused, Callout(f"To do: {[*inventory.remaining, first][0].hint}")]


def inspection_result(inventory: Inventory, arguments: str = "") -> Result:
    """Lay out an inventory; on a terminal, where the first sentence names the log, it needs no title."""
    log = inventory.log
    used = sum(1 for topic in inventory.topics if topic.messages)
    unit, name = next(
        (unit, name) for unit, name in _PREFIXES if log.size_bytes >= unit or unit == 1
    )
    size = f"{log.size_bytes / unit:.3g} {name}{f' in {log.parts} parts' if log.parts > 1 else ''}"
    summary = "" if log.has_summary else ", no summary"
    compression = f" ({', '.join(log.compression)})" if log.chunks else ""
    chunks = f"chunks: {log.chunks}{compression}{summary}"
    parts: list[Part] = [
        Only(("markdown", "latex", "html"), (Title(log.name),)),
        *answer_lines(inventory, arguments),
    ]
    facts = [
        f"{log.name}: {size}, profile {log.profile or MISSING}, written by {log.library or MISSING}",
        f"{log.messages} messages on {used} of {len(inventory.topics)} topics, {chunks}",
    ]
    if log.start_utc is not None:
        facts.append(f"{log.duration_s:.1f} s from {log.start_utc} (recorder's clock)")
    for kind, names in (("metadata", log.metadata), ("attachments", log.attachments)):
        facts += [f"{kind}: {', '.join(names)}"] if names else []
    parts.append(Sentences(tuple(facts)))
    parts += inventory_tables(inventory)

    # Pings and reference, every note, every blocker.
    found: list[Remark] = []
    if (pings := inventory.pings) is not None:
        announced = sum(topic.messages for topic in inventory.topics if topic.role == "dvl")
        messages = f"{'the first ' if pings.messages < announced else ''}{pings.messages} messages"
        repeated = (
            f" ({100 * pings.repeats / pings.messages:.0f} % repeats)" if pings.repeats else ""
        )
        rate = f" at {number(pings.rate_hz)} Hz" if pings.rate_hz is not None else ""
        beams = f"valid beams: four or more in {pings.four_or_more}, three in {pings.three}, fewer in {pings.fewer}"
        if not pings.four_or_more + pings.three + pings.fewer:
            beams = "no beams"
        found.append(
            Remark(f"dvl: {pings.pings} usable pings in {messages}{repeated}{rate}; {beams}")
        )
    if (reference := inventory.reference) is not None:
        text = (
            f"reference: {reference.rows} rows; share of the IMU's time between first and last row: "
            f"position {reference.position_pct:.0f} %, velocity {reference.velocity_pct:.0f} %, "
            f"attitude {reference.attitude_pct:.0f} %"
        )
        found.append(Remark(text))
    found += [
        Remark(f"{note.severity}: {note.text} [{note.code}]", note.hint) for note in inventory.notes
    ]
    found += [Remark(f"blocker: {blocker.message}", blocker.hint) for blocker in inventory.blockers]
    parts += [Sentences(tuple(found))] if found else []

    # What the proposed settings leave open.
    if inventory.configuration:
        left = (
            [Remark(f"to decide: {', '.join(inventory.decisions)}")] if inventory.decisions else []
        )
        for blocker in inventory.remaining:
            hint = "" if blocker in inventory.blockers else blocker.hint
            left.append(Remark(f"blocker with these settings too: {blocker.message}", hint))
        left = left or [Remark("nothing to decide")]
        proposal = (
            Sentences((_PROPOSAL,)),
            Code(inventory.configuration, "toml"),
            Sentences(tuple(left)),
        )
        parts.append(Only(("terminal", "markdown", "html"), proposal))
    return Result("inspection", log.name, tables=_blocks(inventory), document=parts, data=inventory)


def _blocks(inventory: Inventory) -> dict[str, Block]:
    """Return what is known of a log as tables; those without rows are left out, and so are the proposed settings.

    The column ``log`` allows to join the tables of several logs.
    """
    known = asdict(inventory)
    name = inventory.log.name
    tables: dict[str, list[dict[str, Any]]] = {
        "file": [known["log"]],
        "topics": known["topics"],
        "roles": known["roles"],
        "clocks": known["clocks"],
        "pings": [known["pings"]] if known["pings"] else [],
        "reference": [known["reference"]] if known["reference"] else [],
        "notes": known["notes"],
        "blockers": known["blockers"],
        "conventions": [
            {"topic": topic, "key": key, "value": value}
            for topic, keys in inventory.conventions.items()
            for key, value in keys.items()
        ],
    }
    return {
        table: Block(("log", *rows[0]), [(name, *row.values()) for row in rows])
        for table, rows in tables.items()
        if rows
    }


def inventory_tables(inventory: Inventory) -> list[DisplayTable]:
    """Lay out roles, conventions, topics and clocks."""
    roles = table_of(
        "Roles",
        inventory.roles,
        (
            ("role", "l", "role"),
            ("topic", "l", lambda role: role.topic or MISSING),
            ("why", "l", "reason"),
        ),
    )
    conventions = DisplayTable(
        "Conventions: defaults from the type of the topic",
        ("topic", "key and value"),
        "ll",
        tuple(
            (
                topic,
                tuple(
                    f"{key} = {msgspec.json.encode(value).decode()}" for key, value in keys.items()
                ),
            )
            for topic, keys in inventory.conventions.items()
        ),
    )
    empty = [topic.topic for topic in inventory.topics if not topic.messages]
    topics = DisplayTable(
        "Topics: rate, longest gap and span by log time",
        (
            "topic\n  type, encoding",
            "role",
            "messages",
            "rate\n[Hz]",
            "gap\n[s]",
            "from\n[s]",
            "to\n[s]",
        ),
        "llrrrrr",
        tuple(_topic_rows([topic for topic in inventory.topics if topic.messages])),
        f"without messages: {listed(empty, _MOST_EMPTY)}" if empty else "",
        spare=(5, 6, 4, 3, 1),
        folds=_FOLDED,
    )
    messages = {topic.topic: topic.messages for topic in inventory.topics}
    clocks = table_of(
        "Clocks: log time minus stamp, in the first messages",
        inventory.clocks,
        (
            ("topic", "l", "topic"),
            ("stamp", "l", "stamp"),
            (
                "first",
                "r",
                lambda clock: (
                    "all" if clock.messages == messages.get(clock.topic) else str(clock.messages)
                ),
            ),
            ("median\n[s]", "r", "log_minus_stamp_s"),
            ("spread\n[s]", "r", "spread_s"),
            ("back\nsteps", "r", "back_steps"),
            ("repeats", "r", "repeats"),
            ("rate\n[Hz]", "r", "rate_hz"),
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
            type_name = (
                "" if topic.type_name == topic.topic else f"{topic.type_name or 'no type'}, "
            )
            yield (
                (topic.topic, f"  {type_name}{topic.encoding or 'no encoding'}"),
                topic.role,
                str(topic.messages),
                *(
                    MISSING if value is None else f"{value:.3g}"
                    for value in (topic.rate_hz, topic.longest_gap_s)
                ),
                *(
                    MISSING if value is None else f"{value:.0f}"
                    for value in (topic.start_s, topic.end_s)
                ),
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
