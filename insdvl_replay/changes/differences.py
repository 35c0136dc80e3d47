"""What differs between two sets of results besides the cells of their tables, and which names one side lacks."""

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

from msgspec import Struct
from msgspec.structs import replace

from insdvl_replay.changes.cells import RowPair
from insdvl_replay.changes.matching import Pair
from insdvl_replay.core.config import flattened
from insdvl_replay.core.errors import ConfigError, Note
from insdvl_replay.core.notes import note
from insdvl_replay.core.report import StoredReport
from insdvl_replay.core.tables import LAYOUTS
from insdvl_replay.core.words import ChangeVerdict

# What may differ outside the tables, in the order of interest.
BLOCKS: Final = ("tool", "versions", "config", "filters", "log", "notes")
_OF_TOOL: Final = ("name", "version", "sources")  # not the times of day and of computation
_KNOWN_TABLES: Final = frozenset(layout.name for layout in LAYOUTS)


class Difference(Struct, frozen=True):
    """One difference outside the tables, which may explain a changed number."""

    block: str  # one of `BLOCKS`
    key: str  # dotted, as on the command line
    old: str | None  # as in TOML; None if a side does not have it
    new: str | None
    logs: tuple[str, ...]  # the dives it concerns


def differences(pairs: Iterable[Pair]) -> tuple[Difference, ...]:
    """Return all differences outside the tables, each once with its dives."""
    logs: dict[Difference, list[str]] = {}
    for old, new in pairs:
        before = _facts(old.report)
        after = _facts(new.report)
        for block, key in dict.fromkeys((*before, *after)):
            value_before = before.get((block, key))
            value_now = after.get((block, key))
            if value_before != value_now:
                difference = Difference(block, key, value_before, value_now, logs=())
                logs.setdefault(difference, []).append(new.name)
    found = [replace(difference, logs=tuple(names)) for difference, names in logs.items()]
    return tuple(sorted(found, key=lambda difference: BLOCKS.index(difference.block)))


def _facts(report: StoredReport) -> dict[tuple[str, str], str]:
    """Return the facts outside the tables as text, by block and key; a fact without a value is left out.

    Times of day and of computation are no facts, since they differ between any two replays.
    """
    blocks: dict[str, Mapping[str, Any]] = {
        "tool": {key: value for key, value in report.tool.items() if key in _OF_TOOL},
        "versions": report.versions,
        "config": dict(flattened(report.config)),
        "filters": {"names": ", ".join([report.baseline, *report.filters])},
        "log": _facts_of_log(report),
        "notes": _facts_of_notes(report),
    }
    facts = dict[tuple[str, str], str]()
    for block, values in blocks.items():
        for key, value in values.items():
            if isinstance(value, str):
                facts[block, key] = value
            elif value is not None:
                facts[block, key] = json.dumps(value)
    return facts


def _facts_of_notes(report: StoredReport) -> dict[str, str]:
    """Return counts and severities of the notes by their codes; several notes may share a code."""
    facts = dict[str, str]()
    for found in report.notes:
        text = f"{found.count} ({found.severity})"
        if found.code in facts:
            text = f"{facts[found.code]}, {text}"
        facts[found.code] = text
    return facts


def _facts_of_log(report: StoredReport) -> dict[str, Any]:
    """Return name, hash, span and channels of a log."""
    log = report.log
    facts: dict[str, Any] = {
        "name": log.name,
        "sha256": log.sha256,
        "start_ns": log.start_ns,
        "end_ns": log.end_ns,
        "duration_s": log.duration_s,
    }
    for channel in log.channels:
        count = channel.get("messages")
        type_name = channel.get("type_name")
        role = channel.get("role") or "unused"
        facts[f"channels {channel.get('topic')}"] = f"{count} {type_name} ({role})"
    return facts


# --- Names that one side lacks.


def notes_on_names(pairs: Sequence[Pair], frames: Iterable[Sequence[RowPair]]) -> Iterator[Note]:
    """Note the candidates and tables that are on one side only, and the tables that this version does not know.

    The frames are the rows that are compared, a frame for each pair. A ConfigError says that no candidate is on both
    sides.
    """
    yield from _notes_on_candidates(pairs)
    yield from _notes_on_tables(frames)
    yield from _notes_on_unknown_tables(pairs)


def _notes_on_candidates(pairs: Sequence[Pair]) -> Iterator[Note]:
    candidates = _Names()
    for old, new in pairs:
        candidates.add(old.report.filters.keys(), new.report.filters.keys())
    names_before = sorted(candidates.ever_old)
    names_now = sorted(candidates.ever_new)
    if names_before and names_now and not candidates.ever_both:
        raise ConfigError(
            f"no candidate of the old results ({', '.join(names_before)}) "
            f"is in the new ones ({', '.join(names_now)})",
            f"match them by name: --pair {names_before[0]}={names_now[0]}",
        )
    if candidates.may_be_renamed:
        # The sentence of this code whose hint is --pair.
        yield from candidates.notes("filter_on_one_side renamed")
    else:
        yield from candidates.notes("filter_on_one_side")


def _notes_on_tables(frames: Iterable[Sequence[RowPair]]) -> Iterator[Note]:
    tables = _Names()
    for frame in frames:
        tables.add(
            {row.layout.name for row in frame if row.old},
            {row.layout.name for row in frame if row.new},
        )
    yield from tables.notes("table_on_one_side")


class _Names:
    """The names of candidates, or those of tables, on both sides of all dives."""

    def __init__(self) -> None:
        self.gone = Counter[str]()  # by name: dives on which only the old side has it
        self.added = Counter[str]()  # likewise the new side
        # Names that the old side, the new one, and both have on any dive.
        self.ever_old = set[str]()
        self.ever_new = set[str]()
        self.ever_both = set[str]()

    def add(self, old: Iterable[str], new: Iterable[str]) -> None:
        """Count the names of a dive on both sides."""
        before = set(old)
        now = set(new)
        self.gone.update(before - now)
        self.added.update(now - before)
        self.ever_old |= before
        self.ever_new |= now
        self.ever_both |= before & now

    @property
    def may_be_renamed(self) -> bool:
        """Whether each side has a name that the other never has: one may be the other's new name."""
        return bool(self.ever_old - self.ever_new) and bool(self.ever_new - self.ever_old)

    def notes(self, code: str) -> Iterator[Note]:
        """Yield a note of a code for each name that one side lacks on some dive."""
        for name, count in sorted(self.gone.items()):
            yield note(
                code,
                count,
                name=name,
                side="old",
                word=ChangeVerdict.GONE,
            )
        for name, count in sorted(self.added.items()):
            yield note(
                code,
                count,
                name=name,
                side="new",
                word=ChangeVerdict.NEW,
            )


def _notes_on_unknown_tables(pairs: Sequence[Pair]) -> Iterator[Note]:
    unknown = Counter[str]()
    for old, new in pairs:
        for side in (old, new):
            unknown.update(sorted(side.report.tables.keys() - _KNOWN_TABLES))
    for table, count in unknown.items():
        yield note(
            "table_unknown",
            count,
            name=table,
        )
