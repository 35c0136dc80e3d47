"""What a log holds, for people and for scripts: an `Inventory` as tables, sentences and JSON."""

from collections.abc import Iterator, Sequence
from typing import Final

import msgspec
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from insdvl_replay.inventory import Inventory, LogFacts, PingFacts, ReferenceFacts, TopicFacts
from insdvl_replay.report.shown import MISSING, ShownTable, number
from insdvl_replay.report.terminal import dressed

_PREFIXES: Final = ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"))


def encode_inventory(inventory: Inventory | Sequence[Inventory]) -> bytes:
    """Write an inventory, or several as a list, as JSON, every number with its unit in the key.

    Parameters
    ----------
    inventory : Inventory or sequence of Inventory

    Returns
    -------
    bytes
    """
    return msgspec.json.format(msgspec.json.encode(inventory)) + b"\n"


def terminal_inventory(inventory: Inventory) -> Group:
    """Dress an inventory for a terminal.

    Parameters
    ----------
    inventory : Inventory

    Returns
    -------
    rich.console.Group
        To be printed by a rich console, which decides about width and colour; only settings that can be copied into a
        file are lines of their own, however long.
    """
    tables = (_roles(inventory), _conventions(inventory), _topics(inventory), _clocks(inventory))
    parts: list[RenderableType] = [Text(line) for line in _heading(inventory)]
    for table in tables:
        if table.rows:
            parts += [Text(), dressed(table)]
    return Group(*parts, Text(), *_sentences(inventory), *_proposal(inventory))


def _heading(inventory: Inventory) -> Iterator[str]:
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


def _sentences(inventory: Inventory) -> Iterator[RenderableType]:
    if inventory.pings is not None:
        announced = sum(topic.messages for topic in inventory.topics if topic.role == "dvl")
        yield Text(_pings(inventory.pings, announced))
    if inventory.reference is not None:
        yield Text(_coverage(inventory.reference))
    for note in inventory.notes:
        yield from _hinted(f"{note.severity}: {note.text} [{note.code}]", note.hint)
    for obstacle in inventory.obstacles:
        yield from _hinted(f"stops a replay: {obstacle.message}", obstacle.hint)
    yield Text(_verdict(inventory))


def _proposal(inventory: Inventory) -> Iterator[RenderableType]:
    """Print the proposed settings, and what they leave open."""
    if not inventory.configuration:
        return
    yield Text("\nTo start from, as a file for -c; the comments say what was seen and what is to decide:\n")
    for line in inventory.configuration.splitlines():
        yield Text(line, no_wrap=True, overflow="ignore")
    yield Text()
    if inventory.decisions:
        yield Text(f"to decide in it: {', '.join(inventory.decisions)}")
    for obstacle in inventory.remaining:
        hint = "" if obstacle in inventory.obstacles else obstacle.hint
        yield from _hinted(f"stops a replay with it too: {obstacle.message}", hint)
    if not inventory.decisions and not inventory.remaining:
        yield Text("nothing is left open in it")


def _hinted(sentence: str, hint: str) -> Iterator[RenderableType]:
    yield Text(sentence)
    if hint:
        yield Padding(Text(f"hint: {hint}"), (0, 0, 0, 2))


def _size(size_bytes: int) -> str:
    return next(
        (f"{size_bytes / unit:.3g} {name}" for unit, name in _PREFIXES if size_bytes >= unit), f"{size_bytes} B"
    )


def _chunks(log: LogFacts) -> str:
    summary = "" if log.has_summary else ", no summary"
    compression = f" ({', '.join(log.compression)})" if log.chunks else ""
    return f"chunks: {log.chunks}{compression}{summary}"


def _roles(inventory: Inventory) -> ShownTable:
    return ShownTable(
        "Roles",
        ("role", "topic", "why"),
        "lll",
        tuple((role.role, role.topic or MISSING, role.reason) for role in inventory.roles),
    )


def _conventions(inventory: Inventory) -> ShownTable:
    return ShownTable(
        "Conventions: what the type of a topic says where the configuration does not",
        ("topic", "key and value"),
        "ll",
        tuple(
            (topic, "\n".join(f"{key} = {msgspec.json.encode(value).decode()}" for key, value in keys.items()))
            for topic, keys in inventory.conventions.items()
        ),
    )


def _topics(inventory: Inventory) -> ShownTable:
    empty = [topic for topic in inventory.topics if not topic.messages]
    return ShownTable(
        "Topics: rate, longest gap and span by the times of recording",
        ("topic\n  type, encoding", "role", "messages", "rate\n[Hz]", "gap\n[s]", "from\n[s]", "to\n[s]"),
        "llrrrrr",
        tuple(_topic(topic) for topic in inventory.topics if topic.messages),
        f"without messages: {', '.join(topic.topic for topic in empty)}" if empty else "",
    )


def _topic(topic: TopicFacts) -> tuple[str, ...]:
    # Some recorders name a topic after its type; once is enough.
    type_name = "" if topic.type_name == topic.topic else f"{topic.type_name or 'no type'}, "
    return (
        f"{topic.topic}\n  {type_name}{topic.encoding or 'no encoding'}",
        topic.role,
        str(topic.messages),
        *(MISSING if value is None else f"{value:.3g}" for value in (topic.rate_hz, topic.longest_gap_s)),
        *(MISSING if value is None else f"{value:.0f}" for value in (topic.start_s, topic.end_s)),
    )


def _clocks(inventory: Inventory) -> ShownTable:
    messages = {topic.topic: topic.messages for topic in inventory.topics}
    return ShownTable(
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
    )


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
    if inventory.reading == "sample":
        return "nothing seen that would stop a replay; --deep reads the messages whole"
    return "can be replayed"
