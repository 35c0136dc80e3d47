"""What is known of a log, and how it is shown.

Times count from the log's first message, on the recorder's clock.
"""

import shlex
from collections.abc import Iterator, Mapping, Sequence
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
    # log time of the first message, ISO 8601; None without messages, or before 1970
    start_utc: str | None
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
    # by topic: keys that its type settles
    conventions: dict[str, dict[str, Any]] = field(default_factory=dict)
    clocks: tuple[Clock, ...] = ()
    # This and the reference only where the messages were read whole.
    pings: PingFacts | None = None
    reference: ReferenceFacts | None = None
    blockers: tuple[Blocker, ...] = ()  # empty where nothing was found that would stop a replay
    notes: tuple[Note, ...] = field(default=())
    configuration: str = ""  # TOML to start from where something stops a replay
    decisions: tuple[str, ...] = ()  # its keys about which a person must decide
    # what stops a replay with it too, besides decisions without a value
    remaining: tuple[Blocker, ...] = ()


# --- For people, and for scripts.

_PREFIXES: Final = ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"))
# letters of a type's name that a narrow terminal folds before it leaves out a column
_FOLDED: Final = 16
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
    name = inventory.log.name
    parts: list[Part] = [
        Only(("markdown", "latex", "html"), (Title(name),)),
        *answer_lines(inventory, arguments),
        Sentences(tuple(_file_facts(inventory))),
        *inventory_tables(inventory),
    ]
    remarks = tuple(_remarks(inventory))
    if remarks:
        parts.append(Sentences(remarks))
    if inventory.configuration:
        proposal = (
            Sentences((_PROPOSAL,)),
            Code(inventory.configuration, "toml"),
            Sentences(tuple(_left_open(inventory))),
        )
        parts.append(Only(("terminal", "markdown", "html"), proposal))
    return Result("inspection", name, tables=_blocks(inventory), document=parts, data=inventory)


def _file_facts(inventory: Inventory) -> Iterator[str]:
    """State what the file is: its size and writer, its messages and chunks, its time, what else is in it."""
    log = inventory.log
    profile = log.profile or MISSING
    library = log.library or MISSING
    yield f"{log.name}: {_size(log)}, profile {profile}, written by {library}"
    used = sum(1 for topic in inventory.topics if topic.messages)
    yield f"{counted(log.messages, 'message')} on {used} of {len(inventory.topics)} topics, {_chunks(log)}"
    if log.start_utc is not None:
        yield f"{log.duration_s:.1f} s from {log.start_utc} (recorder's clock)"
    if log.metadata:
        yield f"metadata: {', '.join(log.metadata)}"
    if log.attachments:
        yield f"attachments: {', '.join(log.attachments)}"


def _size(log: LogFacts) -> str:
    size = _size_of_file(log.size_bytes)
    if log.parts > 1:
        return f"{size} in {log.parts} parts"
    return size


def _size_of_file(size_bytes: int) -> str:
    for unit, name in _PREFIXES:
        if size_bytes >= unit:
            return f"{size_bytes / unit:.3g} {name}"
    return f"{size_bytes} B"


def _chunks(log: LogFacts) -> str:
    text = f"chunks: {log.chunks}"
    if log.chunks:
        text += f" ({', '.join(log.compression)})"
    if not log.has_summary:
        text += ", no summary"
    return text


def _remarks(inventory: Inventory) -> Iterator[Remark]:
    """State what the pings and the reference give, every note and every blocker."""
    if inventory.pings is not None:
        announced = sum(topic.messages for topic in inventory.topics if topic.role == "dvl")
        yield Remark(_ping_sentence(inventory.pings, announced))
    reference = inventory.reference
    if reference is not None:
        yield Remark(
            f"reference: {counted(reference.rows, 'row')}; share of the IMU's time between first and last row: "
            f"position {reference.position_pct:.0f} %, velocity {reference.velocity_pct:.0f} %, "
            f"attitude {reference.attitude_pct:.0f} %"
        )
    for note in inventory.notes:
        yield Remark(f"{note.severity}: {note.text} [{note.code}]", note.hint)
    for blocker in inventory.blockers:
        yield Remark(f"blocker: {blocker.message}", blocker.hint)


def _ping_sentence(pings: PingFacts, announced: int) -> str:
    """State how many of the messages are pings; of those that the log announces, not all may have been read."""
    messages = counted(pings.messages, "message")
    if pings.messages < announced:
        messages = f"the first {messages}"
    if pings.repeats:
        messages += f" ({100 * pings.repeats / pings.messages:.0f} % repeats)"
    if pings.rate_hz is not None:
        messages += f" at {number(pings.rate_hz)} Hz"
    beams = "no beams"
    if pings.four_or_more or pings.three or pings.fewer:
        beams = f"valid beams: four or more in {pings.four_or_more}, three in {pings.three}, fewer in {pings.fewer}"
    return f"dvl: {pings.pings} usable pings in {messages}; {beams}"


def _left_open(inventory: Inventory) -> Iterator[Remark]:
    """State what the proposed settings leave open."""
    if inventory.decisions:
        yield Remark(f"to decide: {', '.join(inventory.decisions)}")
    for blocker in inventory.remaining:
        hint = blocker.hint
        if blocker in inventory.blockers:  # where the hint stands already
            hint = ""
        yield Remark(f"blocker with these settings too: {blocker.message}", hint)
    if not inventory.decisions and not inventory.remaining:
        yield Remark("nothing to decide")


def _blocks(inventory: Inventory) -> dict[str, Block]:
    """Return what is known of a log as tables; those without rows are left out, and so are the proposed settings.

    The column ``log`` allows to join the tables of several logs.
    """
    known = asdict(inventory)
    name = inventory.log.name
    conventions = []
    for topic, keys in inventory.conventions.items():
        for key, value in keys.items():
            conventions.append({"topic": topic, "key": key, "value": value})
    tables: dict[str, list[dict[str, Any]]] = {
        "file": [known["log"]],
        "topics": known["topics"],
        "roles": known["roles"],
        "clocks": known["clocks"],
        "pings": [known["pings"]] if known["pings"] else [],
        "reference": [known["reference"]] if known["reference"] else [],
        "notes": known["notes"],
        "blockers": known["blockers"],
        "conventions": conventions,
    }
    blocks = {}
    for title, rows in tables.items():
        if rows:
            blocks[title] = Block(("log", *rows[0]), [(name, *row.values()) for row in rows])
    return blocks


def inventory_tables(inventory: Inventory) -> list[DisplayTable]:
    """Lay out roles, conventions, topics and clocks; tables without rows are left out."""
    tables = (
        _roles_table(inventory.roles),
        _conventions_table(inventory.conventions),
        _topics_table(inventory.topics),
        _clocks_table(inventory.clocks, inventory.topics),
    )
    return [table for table in tables if table.rows]


def _roles_table(roles: Sequence[RoleFacts]) -> DisplayTable:
    return table_of(
        "Roles",
        roles,
        (
            ("role", "l", "role"),
            ("topic", "l", lambda role: role.topic or MISSING),
            ("why", "l", "reason"),
        ),
    )


def _conventions_table(conventions: Mapping[str, Mapping[str, Any]]) -> DisplayTable:
    rows = []
    for topic, keys in conventions.items():
        settings = []
        for key, value in keys.items():
            settings.append(f"{key} = {msgspec.json.encode(value).decode()}")
        rows.append((topic, tuple(settings)))
    title = "Conventions: defaults from the type of the topic"
    return DisplayTable(title, ("topic", "key and value"), "ll", tuple(rows))


def _topics_table(topics: Sequence[TopicFacts]) -> DisplayTable:
    used = []
    empty = []
    for topic in topics:
        if topic.messages:
            used.append(topic)
        else:
            empty.append(topic.topic)
    return DisplayTable(
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
        tuple(_topic_rows(used)),
        f"without messages: {listed(empty, _MOST_EMPTY)}" if empty else "",
        spare=(5, 6, 4, 3, 1),
        folds=_FOLDED,
    )


def _topic_rows(topics: Sequence[TopicFacts]) -> Iterator[tuple[CellText, ...]]:
    """Lay out the topics; those that are folded under one parent have one row, in the place of the first."""
    folded = _folded_topics(topics)
    shown: set[str] = set()
    for topic in topics:
        parent = _parent(topic)
        if topic.role or parent not in folded:
            yield _row_of_topic(topic)
        elif parent not in shown:
            shown.add(parent)
            yield _row_of_folded(parent, folded[parent])


def _folded_topics(topics: Sequence[TopicFacts]) -> dict[str, list[TopicFacts]]:
    """Return by parent the topics to fold: of more than can be looked through, those without a role."""
    if len(topics) <= _MOST_TOPICS:
        return {}
    below: dict[str, list[TopicFacts]] = {}
    for topic in topics:
        parent = _parent(topic)
        if parent and not topic.role:
            below.setdefault(parent, []).append(topic)
    return {parent: same for parent, same in below.items() if len(same) >= _LEAST_FOLDED}


def _parent(topic: TopicFacts) -> str:
    return topic.topic.rpartition("/")[0]


def _row_of_topic(topic: TopicFacts) -> tuple[CellText, ...]:
    kind = topic.encoding or "no encoding"
    # Some recorders name a topic after its type; once is enough.
    if topic.type_name != topic.topic:
        kind = f"{topic.type_name or 'no type'}, {kind}"
    return (
        (topic.topic, f"  {kind}"),
        topic.role,
        str(topic.messages),
        _cell(topic.rate_hz, ".3g"),
        _cell(topic.longest_gap_s, ".3g"),
        _cell(topic.start_s, ".0f"),
        _cell(topic.end_s, ".0f"),
    )


def _row_of_folded(parent: str, topics: Sequence[TopicFacts]) -> tuple[CellText, ...]:
    encodings = ", ".join(sorted({topic.encoding or "no encoding" for topic in topics}))
    return (
        (f"{parent}/*", f"  {len(topics)} topics, {encodings}"),
        "",
        str(sum(topic.messages for topic in topics)),
        MISSING,
        MISSING,
        _cell(min(topic.start_s or 0.0 for topic in topics), ".0f"),
        _cell(max(topic.end_s or 0.0 for topic in topics), ".0f"),
    )


def _cell(value: float | None, style: str) -> str:
    return MISSING if value is None else format(value, style)


def _clocks_table(clocks: Sequence[Clock], topics: Sequence[TopicFacts]) -> DisplayTable:
    announced = {topic.topic: topic.messages for topic in topics}

    def looked_at(clock: Clock) -> str:
        return "all" if clock.messages == announced.get(clock.topic) else str(clock.messages)

    table = table_of(
        "Clocks: log time minus stamp, in the first messages",
        clocks,
        (
            ("topic", "l", "topic"),
            ("stamp", "l", "stamp"),
            ("first", "r", looked_at),
            ("median\n[s]", "r", "log_minus_stamp_s"),
            ("spread\n[s]", "r", "spread_s"),
            ("back\nsteps", "r", "back_steps"),
            ("repeats", "r", "repeats"),
            ("rate\n[Hz]", "r", "rate_hz"),
        ),
        spare=(2, 6, 5, 7, 4),
    )
    return replace(table, folds=4)
