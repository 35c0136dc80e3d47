"""What differs between two sets of results besides the cells of their tables, and which names one side lacks."""

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

from msgspec import Struct

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
    logs: dict[tuple[str, str, str | None, str | None], list[str]] = {}
    for old, new in pairs:
        before = _facts(old.report)
        after = _facts(new.report)
        for place in dict.fromkeys((*before, *after)):
            was = before.get(place)
            is_ = after.get(place)
            if was != is_:
                logs.setdefault((*place, was, is_), []).append(new.name)
    found = [Difference(*what, tuple(names)) for what, names in logs.items()]
    return tuple(sorted(found, key=lambda difference: BLOCKS.index(difference.block)))


def _facts(report: StoredReport) -> dict[tuple[str, str], str]:
    """Return all facts outside the tables as text, by block and key, without times of day and of computation."""
    blocks: dict[str, Mapping[str, Any]] = {
        "tool": {key: value for key, value in report.tool.items() if key in _OF_TOOL},
        "versions": report.versions,
        "config": dict(flattened(report.config)),
        "filters": {"names": ", ".join([report.baseline, *report.filters])},
        "log": _facts_of_log(report),
        "notes": {note.code: f"{note.count} ({note.severity})" for note in report.notes},
    }
    facts = dict[tuple[str, str], str]()
    for block, values in blocks.items():
        for key, value in values.items():
            if isinstance(value, str):
                facts[block, key] = value
            elif value is not None:
                facts[block, key] = json.dumps(value)
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
        role = channel.get("role") or "unused"
        kind = f"{channel.get('messages')} {channel.get('type_name')}"
        facts[f"channels {channel.get('topic')}"] = f"{kind} ({role})"
    return facts


# --- Names that one side lacks.


def notes_on_names(pairs: Sequence[Pair], frames: Iterable[Sequence[RowPair]]) -> Iterator[Note]:
    """Note the candidates and tables that are on one side only, or unknown; raise if no candidate is on both sides."""
    candidates = _Names()
    for old, new in pairs:
        candidates.add(old.report.filters.keys(), new.report.filters.keys())
    theirs = sorted(candidates.ever_old)
    ours = sorted(candidates.ever_new)
    if theirs and ours and not candidates.ever_both:
        raise ConfigError(
            f"no candidate of the old results ({', '.join(theirs)}) is in the new ones ({', '.join(ours)})",
            f"match them by name: --pair {theirs[0]}={ours[0]}",
        )
    code = "filter_on_one_side"
    if candidates.ever_old - candidates.ever_new and candidates.ever_new - candidates.ever_old:
        code = "filter_on_one_side renamed"
    yield from candidates.notes(code)
    tables = _Names()
    for frame in frames:
        tables.add(
            {row.layout.name for row in frame if row.old},
            {row.layout.name for row in frame if row.new},
        )
    yield from tables.notes("table_on_one_side")
    yield from _notes_on_unknown_tables(pairs)


class _Names:
    """Names of one kind: on how many dives one side alone has each."""

    def __init__(self) -> None:
        self.gone = Counter[str]()
        self.added = Counter[str]()
        self.ever_old = set[str]()
        self.ever_new = set[str]()
        self.ever_both = set[str]()

    def add(self, old: Iterable[str], new: Iterable[str]) -> None:
        """Count the names of a dive on both sides."""
        theirs = set(old)
        ours = set(new)
        self.gone.update(theirs - ours)
        self.added.update(ours - theirs)
        self.ever_old |= theirs
        self.ever_new |= ours
        self.ever_both |= theirs & ours

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
