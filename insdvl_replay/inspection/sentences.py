"""What a log holds, in words: the file, what was noticed, what would stop a replay, and what to settle."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from insdvl_replay.inspection.inventory import Inventory, LogFacts, PingFacts, ReferenceFacts
from insdvl_replay.report.display_table import MISSING, number

_PREFIXES: Final = ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"))
PROPOSAL: Final = "To start from, as a file for -c; the comments say what was seen and what is to decide:"


@dataclass(frozen=True)
class Finding:
    """A sentence on a log, and what helps; the hint is empty where nothing does."""

    sentence: str
    hint: str = ""


def opening_lines(inventory: Inventory) -> list[str]:
    """Say what file it is, how much it holds and when it was recorded."""
    return list(_opening(inventory))


def findings(inventory: Inventory) -> Iterator[Finding]:
    """Say what was seen of pings and reference, every note, every obstacle, and last whether it can be replayed."""
    if inventory.pings is not None:
        announced = sum(topic.messages for topic in inventory.topics if topic.role == "dvl")
        yield Finding(_pings(inventory.pings, announced))
    if inventory.reference is not None:
        yield Finding(_coverage(inventory.reference))
    for note in inventory.notes:
        yield Finding(f"{note.severity}: {note.text} [{note.code}]", note.hint)
    for obstacle in inventory.obstacles:
        yield Finding(f"stops a replay: {obstacle.message}", obstacle.hint)
    yield Finding(_verdict(inventory))


def open_points(inventory: Inventory) -> Iterator[Finding]:
    """Say what the proposed settings leave open; nothing where none are proposed."""
    if not inventory.configuration:
        return
    if inventory.decisions:
        yield Finding(f"to decide in it: {', '.join(inventory.decisions)}")
    for obstacle in inventory.remaining:
        hint = "" if obstacle in inventory.obstacles else obstacle.hint
        yield Finding(f"stops a replay with it too: {obstacle.message}", hint)
    if not inventory.decisions and not inventory.remaining:
        yield Finding("nothing is left open in it")


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
    if inventory.reading == "sample":
        return "nothing seen that would stop a replay; --deep reads the messages whole"
    return "can be replayed"
