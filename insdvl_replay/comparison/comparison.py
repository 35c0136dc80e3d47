"""Two sets of results laid beside each other, dive by dive and cell by cell."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from insdvl_replay.comparison.aggregation import aggregates, tally
from insdvl_replay.comparison.dive_matching import Matching, match_dives
from insdvl_replay.comparison.filter_pairs import require_common_candidate, with_new_names
from insdvl_replay.core.changes import Change, Comparison, Difference, DiveComparison
from insdvl_replay.core.errors import ConfigError, Note, require_known
from insdvl_replay.core.stored_report import StoredReport, StoredResult
from insdvl_replay.core.table import TableLayout
from insdvl_replay.core.tables import LAYOUTS
from insdvl_replay.core.words import MatchedBy, Severity
from insdvl_replay.evaluation.row_changes import compare_tables, named_rows
from insdvl_replay.results.stored_results import read_results

_Pair = tuple[StoredResult, StoredResult]
BLOCKS: Final = ("tool", "versions", "config", "filters", "log", "notes")
"""In the order of what a reader asks first."""


def differences(pairs: list[_Pair]) -> tuple[Difference, ...]:
    """Name everything beside the tables that differs, once, with the dives that it concerns."""
    logs: dict[tuple[str, str, str | None, str | None], list[str]] = {}
    for old, new in pairs:
        before, after = _facts(old.report), _facts(new.report)
        for block, key in dict.fromkeys((*before, *after)):
            was, is_ = before.get((block, key)), after.get((block, key))
            if was != is_:
                logs.setdefault((block, key, was, is_), []).append(new.name)
    found = [Difference(*what, tuple(names)) for what, names in logs.items()]
    return tuple(sorted(found, key=lambda difference: BLOCKS.index(difference.block)))


def flattened(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Return nested settings by their dotted keys; lists stay whole."""
    for key, value in settings.items():
        if isinstance(value, dict) and value:
            yield from flattened(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _facts(report: StoredReport) -> dict[tuple[str, str], str]:
    """Return all that may differ as text, by block and key. Times of day and of computation always differ."""
    log = report.log
    tool = {key: value for key, value in report.tool.items() if key in {"name", "version", "sources"}}
    filters = ", ".join([report.baseline, *report.filters])
    span = {"start_ns": log.start_ns, "end_ns": log.end_ns, "duration_s": log.duration_s}
    channels = {f"channels {channel.get('topic')}": _channel(channel) for channel in log.channels}
    blocks: dict[str, Mapping[str, Any]] = {
        "tool": tool,
        "versions": report.versions,
        "config": dict(flattened(report.config)),
        "filters": {"names": filters},
        "log": {"name": log.name, "sha256": log.sha256, **span, **channels},
        "notes": {note.code: f"{note.count} ({note.severity})" for note in report.notes},
    }
    return {
        (block, key): value if isinstance(value, str) else json.dumps(value)
        for block, facts in blocks.items()
        for key, value in facts.items()
        if value is not None
    }


def _channel(channel: Mapping[str, Any]) -> str:
    return f"{channel.get('messages')} {channel.get('type_name')} ({channel.get('role') or 'unused'})"


_Pairs = Sequence[tuple[StoredResult, StoredResult]]


@dataclass(frozen=True)
class Selection:
    """What of two sets of results is compared, and how closely.

    Attributes
    ----------
    tables, columns, logs : tuple of str
        Names; empty for all.
    filter_pairs : mapping of str to str
        New name of a filter by its old one, for those whose names differ.
    tolerance_pct : float or None
        Up to which a change counts as ``same``; None: up to the last printed digit.
    """

    tables: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    logs: tuple[str, ...] = ()
    filter_pairs: Mapping[str, str] = field(default_factory=dict)
    tolerance_pct: float | None = None


def compare_results(old: Path, new: Path, selection: Selection = Selection()) -> Comparison:
    """Compare two sets of results.

    Parameters
    ----------
    old, new : Path
        Each a report.json, a result folder, or a folder of result folders at any depth.

    Raises
    ------
    ConfigError
        There is no result, no dive or no candidate on both sides, or a name in the selection is not known.
    ResultError
        A report cannot be read.
    """
    layouts = _chosen_layouts(selection.tables)
    (before, notes_before), (after, notes_after) = read_results(old), read_results(new)
    matching = _chosen_dives(match_dives(before, after), selection.logs)
    as_stored = [(was, is_) for was, is_, _ in matching.pairs]
    renamed = with_new_names([was for was, _ in as_stored], selection.filter_pairs)
    pairs = [(was, is_) for was, (_, is_) in zip(renamed, as_stored, strict=True)]
    notes = [*notes_before, *notes_after, *require_common_candidate(pairs), *_table_notes(pairs, layouts)]
    _require_something(pairs, layouts, selection.columns)
    by_dive = [
        _chosen_columns(compare_tables(was, is_, layouts, selection.tolerance_pct), selection.columns)
        for was, is_ in pairs
    ]
    changes = [change for of_dive in by_dive for change in of_dive]
    return Comparison(
        old=str(old),
        new=str(new),
        tolerance_pct=selection.tolerance_pct,
        total=tally(changes),
        by_table={name: tally([change for change in changes if change.table == name]) for name in _tables_of(changes)},
        differences=differences(as_stored),
        dives=tuple(_dives(matching, by_dive)),
        aggregates=aggregates(changes),
        changes=tuple(changes),
        notes=tuple(notes),
        baseline=next((new.report.baseline for _, new in pairs), ""),
    )


def _chosen_layouts(names: Sequence[str]) -> list[TableLayout]:
    for name in names:
        require_known("table", name, [layout.name for layout in LAYOUTS], most=len(LAYOUTS))
    return [layout for layout in LAYOUTS if not names or layout.name in names]


def _chosen_dives(matching: Matching, names: Sequence[str]) -> Matching:
    """Keep the dives of these names; all if there are none."""
    if not names:
        return matching
    for name in names:
        require_known("dive", name, [new.name for _, new, _ in matching.pairs])
    return Matching(tuple(pair for pair in matching.pairs if pair[1].name in names), (), ())


def _chosen_columns(changes: Sequence[Change], names: Sequence[str]) -> list[Change]:
    return [change for change in changes if not names or change.column in names]


def _require_something(pairs: _Pairs, layouts: Sequence[TableLayout], wanted: Sequence[str]) -> None:
    """Raise if a column that was asked for is nowhere, or no table has rows: a comparison of nothing must not pass."""
    results = [result for pair in pairs for result in pair]
    rows = [row for result in results for layout in layouts for row in named_rows(result, layout).values()]
    if not rows:
        names = ", ".join(layout.name for layout in layouts)
        raise ConfigError(f"there is no row to compare in {names}", "leave out --table to see what there is")
    for name in wanted:
        require_known("column", name, list(dict.fromkeys(column for row in rows for column in row)))


def _table_notes(pairs: _Pairs, layouts: Sequence[TableLayout]) -> Iterator[Note]:
    """Count the dives in which a table is on one side only, or of no known kind."""
    for layout in layouts:
        have = [(bool(named_rows(old, layout)), bool(named_rows(new, layout))) for old, new in pairs]
        for side, word, missing in (("old", "new", (False, True)), ("new", "gone", (True, False))):
            if count := have.count(missing):
                dives = "1 dive" if count == 1 else f"{count} dives"
                text = f"table {layout.name}: the {side} results of {dives} have no rows; all its rows are {word}"
                yield Note("table_on_one_side", text, count, Severity.WARNING)
    known = {layout.name for layout in LAYOUTS}
    unknown = [table for pair in pairs for result in pair for table in result.report.tables if table not in known]
    for table in dict.fromkeys(unknown):
        text = f"table {table}: this version does not know it, and leaves it out"
        yield Note(
            "table_unknown", text, unknown.count(table), Severity.WARNING, "compare with the version that wrote it"
        )


def _tables_of(changes: Sequence[Change]) -> list[str]:
    return list(dict.fromkeys(change.table for change in changes))


def _dives(matching: Matching, by_dive: Sequence[Sequence[Change]]) -> Iterator[DiveComparison]:
    for (old, new, how), changes in zip(matching.pairs, by_dive, strict=True):
        yield DiveComparison(new.name, str(old.folder), str(new.folder), how, tally(changes))
    for result in matching.removed:
        yield DiveComparison(result.name, str(result.folder), None, MatchedBy.NOTHING, None)
    for result in matching.new:
        yield DiveComparison(result.name, None, str(result.folder), MatchedBy.NOTHING, None)
