"""Compare two sets of results: match dives, find differences and changed values, and show them.

`compare_results` returns a `Comparison`, `comparison_result` its tables and screen; `find_violation` applies a limit.
"""

import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace as with_fields
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

from msgspec import Struct
from msgspec.structs import astuple, replace

from insdvl_replay.changes.answer import Answer, answer_screen, answer_table, answers_of
from insdvl_replay.changes.cells import ROUNDING, Change, change_text, changes_of, named_rows, within
from insdvl_replay.changes.matching import match_dives, with_new_names
from insdvl_replay.core.errors import ConfigError, Note, counted, listed, natural_key, require_known
from insdvl_replay.core.quantities import label
from insdvl_replay.core.result import (
    Block,
    DisplayTable,
    Only,
    Part,
    Result,
    Sentences,
    StoredReport,
    StoredResult,
    Title,
    flattened,
)
from insdvl_replay.core.tables import CANDIDATES, LAYOUTS, RATIO, Number, PooledRow, TableLayout
from insdvl_replay.core.words import ChangeVerdict, MatchedBy, Severity
from insdvl_replay.results.stored_results import read_results
from insdvl_replay.show.document import FORMS, MISSING, ShownColumn, table_of

BLOCKS: Final = ("tool", "versions", "config", "filters", "log", "notes")
"""What may differ outside the tables, in the order of interest."""
SAME_INPUTS: Final = "tool, settings and log are the same"
WORSE: Final = "worse"  # instead of a percentage: fail on the answer
MOST_OTHERS: Final = 12  # most changed values outside the evidence on the brief screen
_MOST_DIFFERENCES: Final = 8
NONE: Final = "none"  # instead of a missing value
_LINE: Final = 60  # letters of settings in the title
_NAMED_DIVES: Final = 2
_PRIMARY: Final = {(layout.name, column) for layout in LAYOUTS for column in (layout.primary, *layout.words)}
"""The main columns, and words with a rank, which summarise numbers."""
_ORDER: Final = {layout.name: position for position, layout in enumerate(LAYOUTS)}
_CHANGED_WORDS: Final = {
    "verdict": "{} against the baseline is now {}, was {}",
    "prediction": "the predicted improvement of {} is now {}, was {}",
}
"""The sentence for a changed word, by column of the candidates."""
_OFF_ONE: Final = ("nis", "nees")
"""Rows of the evidence that are better nearer to 1; their ratio is of the distance from 1."""
_Pairs = Sequence[tuple[StoredResult, StoredResult]]


_SIDES: Final = (ChangeVerdict.NEW, ChangeVerdict.GONE)


class Difference(Struct, frozen=True):
    """One difference outside the tables, which may explain a changed number."""

    block: str  # one of `BLOCKS`
    key: str  # dotted, as on the command line
    old: str | None  # as in TOML; None if a side does not have it
    new: str | None
    logs: tuple[str, ...]  # the dives it concerns


class Tally(Struct, frozen=True):
    """Number of cells by verdict, and the largest loss and gain, primary columns first."""

    counts: dict[ChangeVerdict, int]
    worst: Change | None
    best: Change | None

    @property
    def moved(self) -> int:
        """How many are not the same."""
        return sum(self.counts.values()) - self.counts[ChangeVerdict.SAME]


class DiveComparison(Struct, frozen=True):
    """One dive and its counterpart; without a counterpart there is no folder on that side and no tally."""

    log: str
    old: str | None
    new: str | None
    matched_by: MatchedBy
    tally: Tally | None

    @property
    def only_side(self) -> ChangeVerdict:
        """Gone or new, for a dive without counterpart."""
        return ChangeVerdict.GONE if self.new is None else ChangeVerdict.NEW


class Aggregate(Struct, frozen=True):
    """One cell over all dives that have it on both sides."""

    table: str
    filter: str
    row: str
    unit: str
    column: str
    dives: int
    better: int
    worse: int
    same: int
    share_better_pct: float
    median_change_pct: Number  # None if no dive has one
    worst_log: str
    worst_change_pct: Number  # None if the number was lost, or grew from zero
    worst_word: ChangeVerdict


class Comparison(Struct, frozen=True):
    """Two sets of results and their differences; a tolerance of None is the last printed digit."""

    old: str
    new: str
    answers: tuple[Answer, ...]
    tolerance_pct: float | None
    total: Tally
    by_table: dict[str, Tally]
    differences: tuple[Difference, ...]
    dives: tuple[DiveComparison, ...]
    aggregates: tuple[Aggregate, ...]
    changes: tuple[Change, ...]
    notes: tuple[Note, ...] = ()
    baseline: str = ""

    @property
    def matched(self) -> list[DiveComparison]:
        """The dives that both sides have."""
        return [dive for dive in self.dives if dive.tally is not None]


class Selection(NamedTuple):
    """The part of two sets of results that is compared, and the tolerance; empty for all."""

    tables: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    logs: tuple[str, ...] = ()
    filter_pairs: Mapping[str, str] = {}
    """New name of a filter by its old one, where they differ."""
    tolerance_pct: float | None = None


# --- Compare.


def compare_results(old: Path, new: Path, selection: Selection = Selection()) -> Comparison:
    """Compare two sets of results, each a report.json, a result folder or a folder of such at any depth.

    ConfigError if both sides share no dive or no candidate, or a name in the selection is not known.
    """
    for name in selection.tables:
        require_known("table", name, [layout.name for layout in LAYOUTS], most=len(LAYOUTS))
    layouts = [layout for layout in LAYOUTS if not selection.tables or layout.name in selection.tables]
    (before, notes_before), (after, notes_after) = read_results(old), read_results(new)
    matching = match_dives(before, after)
    both = [(was, is_, how) for was, is_, how in matching if was and is_]
    for name in selection.logs:
        require_known("dive", name, [is_.name for _, is_, _ in both])
    if selection.logs:
        both = [found for found in both if found[1].name in selection.logs]
        matching = []
    renamed = with_new_names([was for was, _, _ in both], selection.filter_pairs)
    pairs = [(was, is_) for was, (_, is_, _) in zip(renamed, both, strict=True)]
    notes = (*notes_before, *notes_after, *_notes_on_filters(pairs), *_notes_on_tables(pairs, layouts))
    # An empty comparison must not pass.
    rows = [
        row
        for pair in pairs
        for result in pair
        for layout in layouts
        for row in named_rows(result.report, layout, result.folder).values()
    ]
    if not rows:
        names = ", ".join(layout.name for layout in layouts)
        raise ConfigError(f"there is no row to compare in {names}", "leave out --table to see all tables")
    for name in selection.columns:
        require_known("column", name, list(dict.fromkeys(column for row in rows for column in row)))

    changes, dives = list[Change](), list[DiveComparison]()
    for (was, is_), (_, _, how) in zip(pairs, both, strict=True):
        cells = changes_of(was, is_, layouts, selection.tolerance_pct)
        found = [cell for cell in cells if not selection.columns or cell.column in selection.columns]
        dives.append(DiveComparison(is_.name, str(was.folder), str(is_.folder), how, tally(found)))
        changes += found
    for lost, added, how in matching:
        if lost is not None and added is None:
            dives.append(DiveComparison(lost.name, str(lost.folder), None, how, None))
        elif added is not None and lost is None:
            dives.append(DiveComparison(added.name, None, str(added.folder), how, None))
    tables = dict.fromkeys(change.table for change in changes)
    return Comparison(
        old=str(old),
        new=str(new),
        tolerance_pct=selection.tolerance_pct,
        total=tally(changes),
        by_table={name: tally([change for change in changes if change.table == name]) for name in tables},
        differences=_differences([(was, is_) for was, is_, _ in both]),
        dives=tuple(dives),
        aggregates=aggregates(changes),
        changes=tuple(changes),
        notes=notes,
        baseline=next((is_.report.baseline for _, is_ in pairs), ""),
        answers=answers_of(pairs),
    )


def _notes_on_filters(pairs: _Pairs) -> Iterator[Note]:
    """Note the candidates that are on one side only; raise if none is on both sides of any dive."""
    names = [tuple(set(side.report.filters) for side in pair) for pair in pairs]
    theirs, ours = (sorted(set[str]().union(*side)) for side in zip(*names, strict=True))
    if theirs and ours and not any(old & new for old, new in names):
        raise ConfigError(
            f"no candidate of the old results ({', '.join(theirs)}) is in the new ones ({', '.join(ours)})",
            f"match them by name: --pair {theirs[0]}={ours[0]}",
        )
    gone = Counter(name for old, new in names for name in old - new)
    added = Counter(name for old, new in names for name in new - old)
    for side, word, counts in (("old", ChangeVerdict.GONE, gone), ("new", ChangeVerdict.NEW, added)):
        for name, count in sorted(counts.items()):
            text = f"filter {name} is only in the {side} results ({counted(count, 'dive')}); its rows are {word}"
            hint = "--pair OLD=NEW compares filters with different names"
            yield Note("filter_on_one_side", text, count, Severity.WARNING, hint)


def _notes_on_tables(pairs: _Pairs, layouts: Sequence[TableLayout]) -> Iterator[Note]:
    """Note the tables that are on one side only, or unknown."""
    for layout in layouts:
        have = [tuple(bool(named_rows(side.report, layout, side.folder)) for side in pair) for pair in pairs]
        for side, word, missing in (("old", "new", (False, True)), ("new", "gone", (True, False))):
            if count := have.count(missing):
                whose = f"the {side} results of {counted(count, 'dive')}"
                text = f"table {layout.name}: {whose} have no rows; all its rows are {word}"
                yield Note("table_on_one_side", text, count, Severity.WARNING)
    unknown = Counter(table for pair in pairs for side in pair for table in {*side.report.tables} - _ORDER.keys())
    for table, count in unknown.items():
        text = f"table {table}: unknown to this version, and ignored"
        yield Note("table_unknown", text, count, Severity.WARNING, "compare with the version that wrote it")


def _differences(pairs: _Pairs) -> tuple[Difference, ...]:
    """Return all differences outside the tables, each once with its dives."""
    logs: dict[tuple[str, str, str | None, str | None], list[str]] = {}
    for old, new in pairs:
        before, after = _facts(old.report), _facts(new.report)
        for block, key in dict.fromkeys((*before, *after)):
            was, is_ = before.get((block, key)), after.get((block, key))
            if was != is_:
                logs.setdefault((block, key, was, is_), []).append(new.name)
    found = [Difference(*what, tuple(names)) for what, names in logs.items()]
    return tuple(sorted(found, key=lambda difference: BLOCKS.index(difference.block)))


def _facts(report: StoredReport) -> dict[tuple[str, str], str]:
    """Return all facts outside the tables as text, by block and key, without times of day and of computation."""
    log = report.log
    channels = {
        f"channels {channel.get('topic')}": (
            f"{channel.get('messages')} {channel.get('type_name')} ({channel.get('role') or 'unused'})"
        )
        for channel in log.channels
    }
    span = {"start_ns": log.start_ns, "end_ns": log.end_ns, "duration_s": log.duration_s}
    blocks: dict[str, Mapping[str, Any]] = {
        "tool": {key: value for key, value in report.tool.items() if key in {"name", "version", "sources"}},
        "versions": report.versions,
        "config": dict(flattened(report.config)),
        "filters": {"names": ", ".join([report.baseline, *report.filters])},
        "log": {"name": log.name, "sha256": log.sha256, **span, **channels},
        "notes": {note.code: f"{note.count} ({note.severity})" for note in report.notes},
    }
    return {
        (block, key): value if isinstance(value, str) else json.dumps(value)
        for block, facts in blocks.items()
        for key, value in facts.items()
        if value is not None
    }


# --- Sum up.


def loss_of(change: Change) -> float:
    """Return the loss of a cell in percent; infinite for a number that was lost."""
    if change.verdict not in {ChangeVerdict.BETTER, ChangeVerdict.WORSE, ChangeVerdict.GONE}:
        return 0.0
    amount = math.inf if change.change_pct is None else abs(change.change_pct)
    return -amount if change.verdict == ChangeVerdict.BETTER else amount


def _most(changes: Iterable[Change], sign: float) -> Change | None:
    """Return the largest loss or gain; primary columns come before others, and the first of equals."""
    found = [change for change in changes if sign * loss_of(change) > 0.0]
    return max(
        found, key=lambda change: ((change.table, change.column) in _PRIMARY, sign * loss_of(change)), default=None
    )


def tally(changes: Sequence[Change]) -> Tally:
    """Count cells by verdict, with the largest loss and gain."""
    counts = Counter(change.verdict for change in changes)
    return Tally({word: counts[word] for word in ChangeVerdict}, _most(changes, 1.0), _most(changes, -1.0))


def aggregates(changes: Iterable[Change]) -> tuple[Aggregate, ...]:
    """Return each cell over the dives that have it on both sides: counts, median and worst change."""
    cells: dict[tuple[str, str, str, str, str], list[Change]] = {}
    for change in changes:
        if change.verdict in {ChangeVerdict.BETTER, ChangeVerdict.WORSE, ChangeVerdict.SAME}:
            key = change.table, change.filter, change.row, change.unit, change.column
            cells.setdefault(key, []).append(change)
    found = []
    for key, together in cells.items():
        counts, worst = Counter(change.verdict for change in together), max(together, key=loss_of)
        percentages = [change.change_pct for change in together if change.change_pct is not None]
        better, worse, same = (counts[word] for word in (ChangeVerdict.BETTER, ChangeVerdict.WORSE, ChangeVerdict.SAME))
        found.append(
            Aggregate(
                *key,
                len(together),
                *(better, worse, same, 100.0 * better / len(together)),
                median(percentages) if percentages else None,
                *(worst.log, worst.change_pct, worst.verdict),
            )
        )
    return tuple(sorted(found, key=lambda cell: _ORDER[cell.table]))


def only_changed(comparison: Comparison) -> Comparison:
    """Drop unchanged cells, and aggregates that are the same in all dives; the counts stay."""
    return replace(
        comparison,
        changes=tuple(change for change in comparison.changes if change.verdict != ChangeVerdict.SAME),
        aggregates=tuple(cell for cell in comparison.aggregates if cell.same < cell.dives),
    )


def parse_percentage(text: str, option: str) -> float:
    """Read a percentage such as ``0.1%``; the option is for the message."""
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+) ?%", text.strip())
    if match is None:
        raise ConfigError(f"{option} {text}: is not a percentage", f"write {option} 0.5%")
    return float(match[1])


def parse_limit(text: str | None) -> float | str | None:
    """Read the value of ``--fail-on``: a percentage, or the word worse."""
    return text if text in (None, WORSE) else parse_percentage(str(text), "--fail-on")


def find_violation(comparison: Comparison, limit: float | str | None) -> str:
    """Return what is worse than allowed; empty if nothing is.

    For ``worse`` these are the sentences of the filters whose answer is worse or partly worse. For a number they are
    the values that are worse by more, in percent or points. A worse verdict, a number that was lost or grew from zero,
    and a missing row or dive exceed every number.
    """
    if not isinstance(limit, float):
        return " ".join(answer.sentence for answer in comparison.answers if answer.is_harm and limit)
    above_pct = limit
    changes = [change for change in comparison.changes if not within(loss_of(change), above_pct, 100.0 * ROUNDING)]
    reasons = []
    if worst := _most(changes, 1.0):
        more = f" by more than {above_pct:g} %" if above_pct else ""
        worse = f"{'are' if len(changes) > 1 else 'is'} worse{more}"
        reasons.append(f"{counted(len(changes), 'value')} {worse}; worst: {described(worst)}")
    if gone := [dive.log for dive in comparison.dives if dive.new is None]:
        reasons.append(f"{counted(len(gone), 'dive')} without new results: {', '.join(gone)}")
    return "; ".join(reasons)


# --- Show.


def comparison_result(comparison: Comparison, document: Sequence[Part]) -> Result:
    """Return a comparison as tables and JSON, with its screen."""
    dives = [
        (*astuple(dive)[:4], *(dive.tally.counts[word] if dive.tally else None for word in ChangeVerdict))
        for dive in comparison.dives
    ]
    return Result(
        kind="comparison",
        title=_title(comparison),
        tables={
            "answer": Block.of(PooledRow, (row for answer in comparison.answers for row in answer.rows)),
            "difference": Block.of(Difference, comparison.differences),
            "dive": Block(("log", "old", "new", "matched_by", *ChangeVerdict), dives),
            "aggregate": Block.of(Aggregate, comparison.aggregates),
            "change": Block.of(Change, comparison.changes),
        },
        block="part",
        notes=comparison.notes,
        document=document,
        data=comparison,
    )


def brief_document(comparison: Comparison, *, everything: bool = False, command: str = "") -> list[Part]:
    """Return the brief screen: the answers, changed verdicts, differences outside the tables, and the evidence.

    The command is the one that shows all values, if it is not the one that was typed.
    """
    several, one_sided = len(comparison.matched) > 1, _one_sided(comparison)
    comparison = replace(comparison, changes=tuple(cell for cell in comparison.changes if cell.verdict not in _SIDES))
    tables = list(answer_table(comparison.answers, everything=everything) if several else _evidence_of_dive(comparison))
    if not (tables or several) and 0 < len(moved := only_changed(comparison).changes) <= MOST_OTHERS:
        tables = [_values(moved)]
    elsewhere = [f"{name} {counts.moved}" for name, counts in comparison.by_table.items() if counts.moved]
    found = f"changed values by table: {', '.join(elsewhere)}" if elsewhere else "no value changed"
    same = counted(comparison.total.counts[ChangeVerdict.SAME], "value")
    last = f"{found}; {same} the same. All values: {command}--all. One table: {command and '... '}--table NAME"
    closing = Sentences((*one_sided, last))
    return _document(comparison, _changed_verdicts(comparison), tables, _MOST_DIFFERENCES, [closing])


def _one_sided(comparison: Comparison) -> list[str]:
    """Count the values that only one side has."""
    counts = [(comparison.total.counts[word], side) for word, side in zip(_SIDES, ("new", "old"), strict=True)]
    return [f"only in the {side} results: {counted(count, 'value')}" for count, side in counts if count]


def comparison_document(comparison: Comparison) -> list[Part]:
    """Return the full screen of a comparison: the answers, counts, all differences and values."""
    several = len(comparison.matched) > 1
    table = _values_over_dives(comparison.aggregates) if several else _values(comparison.changes)
    rest = "values of one dive: --dive NAME. Values of all dives: --format csv or --format json"
    last = [Only(("terminal", "markdown", "html"), (Sentences((rest,)),))] if several else []
    return _document(comparison, opening_lines(comparison), [table], len(comparison.differences), last)


def _document(
    comparison: Comparison, lines: Sequence[str], tables: Iterable[DisplayTable], most: int, last: Sequence[Part]
) -> list[Part]:
    apart = [f"{dive.only_side}: {dive.log}" for dive in comparison.dives if dive.tally is None]
    return [
        Title(_title(comparison)),
        *answer_screen(comparison.answers),
        *(Sentences(tuple(block)) for block in (lines, _brief_differences(comparison, most)) if block),
        *(with_fields(table, title_apart=True) for table in tables),
        *([Sentences(tuple(apart))] if apart else []),
        *last,
    ]


def opening_lines(comparison: Comparison) -> list[str]:
    """Return the changed verdicts, the number of changed values, and the largest changes."""
    counts = comparison.total.counts
    words = ", ".join(f"{counts[word]} {word}" for word in ChangeVerdict if counts[word] and word != ChangeVerdict.SAME)
    limit = "the last printed digit" if comparison.tolerance_pct is None else f"{comparison.tolerance_pct:g} %"
    same = f"{counts[ChangeVerdict.SAME]} of {sum(counts.values())} values are the same up to {limit}"
    extremes = (("worst", comparison.total.worst), ("best", comparison.total.best))
    return [
        *_changed_verdicts(comparison),
        f"{words or 'no value changed'}; {same}",
        *(f"{name}: {described(change)}" for name, change in extremes if change is not None),
        *([] if comparison.differences else [SAME_INPUTS]),
    ]


def described(change: Change) -> str:
    """Return the place and the change of a cell in one line."""
    old, new = FORMS["cell"](change.old), FORMS["cell"](change.new)
    unit = f" {change.unit}" if change.unit else ""
    return f"{change.log}, {change.table}: {_named(change)} from {old} to {new}{unit} ({change.growth})"


def _named(change: Change) -> str:
    return " ".join((*dict.fromkeys((change.filter, change.row)), change.column))


def _title(comparison: Comparison) -> str:
    """Name the settings that differ, as far as a line can hold them, then the dives and both sides."""
    matched, texts = comparison.matched, _changed_settings(comparison)
    what = matched[0].log if len(matched) == 1 else f"{len(matched)} dives"
    named = texts[:1] + [
        text for place, text in enumerate(texts) if place and len(", ".join(texts[: place + 1])) < _LINE
    ]
    more = f" and {len(texts) - len(named)} more settings" if len(texts) > len(named) else ""
    return f"{', '.join(named) or 'same settings'}{more}: {what}, new: {comparison.new}, old: {comparison.old}"


def _changed_settings(comparison: Comparison) -> list[str]:
    """Return the settings that differ, each once, with the number of its dives if it does not differ in all."""
    return [_difference_text(item, item.key, comparison) for item in comparison.differences if item.block == "config"]


def _difference_text(item: Difference, name: str, comparison: Comparison) -> str:
    """Write a difference, with the number of its dives if it is not in all."""
    matched = len(comparison.matched)
    some = f" (in {len(item.logs)} of {matched})" if len(item.logs) < matched else ""
    return change_text(name, *(NONE if side is None else side for side in (item.old, item.new))) + some


def _changed_verdicts(comparison: Comparison) -> list[str]:
    """Return the changed verdicts, then the changed predictions, each once with its dives."""
    dives: dict[tuple[str, str, str, str], list[str]] = {}
    for change in comparison.changes:
        is_word = change.table == CANDIDATES.name and change.column in _CHANGED_WORDS
        if is_word and change.old and change.new and change.old != change.new:
            key = change.column, change.filter, str(change.new), str(change.old)
            dives.setdefault(key, []).append(change.log)
    matched = len(comparison.matched)
    in_order = sorted(dives.items(), key=lambda found: list(_CHANGED_WORDS).index(found[0][0]))
    return [
        _CHANGED_WORDS[column].format(*named) + (f" ({_where(logs, matched)})" if matched > 1 else "")
        for (column, *named), logs in in_order
    ]


def _where(logs: Sequence[str], dives: int) -> str:
    """Return the dives: all, a few names, or a count."""
    return "all" if len(logs) == dives else ", ".join(logs) if len(logs) <= _NAMED_DIVES else f"{len(logs)} of {dives}"


def _brief_differences(comparison: Comparison, most: int) -> list[str]:
    """Return the differences outside the tables, one line each: logs, settings that the title lacks, and the rest."""
    found = comparison.differences
    other = [item for item in found if (item.block, item.key) == ("log", "sha256") and item.old and item.new]
    names = sorted({name for item in other for name in item.logs}, key=natural_key)
    whose = "the log differs" if len(names) == 1 else f"the logs of {listed(names)} differ"
    lines = [f"{whose} (SHA-256). Changed values may come from the log"] if names else []
    title, settings = _title(comparison), _changed_settings(comparison)
    texts = [text for text in settings if text not in title]
    for item in found:
        if item not in other and item.block != "config":
            texts.append(_difference_text(item, f"{item.block} {item.key}", comparison))
    left = len(texts) - most
    return [*lines, *texts[:most], *([f"{left} more differ: --all"] if left > 0 else [])]


# --- Tables.

_OLD_AND_NEW: Final[tuple[ShownColumn, ...]] = (
    ("old", "r", "old:cell"),
    ("new", "r", "new:cell"),
    ("change", "r", "grown"),
    ("", "l", "verdict"),
)


def _evidence_of_dive(comparison: Comparison) -> Iterator[DisplayTable]:
    """Return the table of the changed evidence of one dive; for NIS and NEES the distance from 1."""

    def owner(cell: Change) -> str:
        return comparison.baseline if cell.column == "baseline" else cell.filter

    def name(cell: Change) -> str:
        return f"{cell.row.upper()} distance from 1" if cell.row in _OFF_ONE else label(cell.row)

    # The rows of every candidate repeat the baseline's values; show them once.
    rows: dict[tuple[str, str], Change] = {}
    for cell in only_changed(comparison).changes:
        if cell.table == "evidence" and cell.column in ((RATIO,) if cell.row in _OFF_ONE else ("value", "baseline")):
            rows.setdefault((owner(cell), cell.row), cell)
    if rows:
        named: tuple[ShownColumn, ...] = (("filter", "l", owner), ("evidence", "l", name), ("", "l", "unit"))
        columns = (*named, *_OLD_AND_NEW[:-1])
        yield table_of("Changed evidence", rows.values(), columns, spare=(2, 3, 4))


def _cell_name(cell: Change | Aggregate) -> str:
    row = "" if cell.row == cell.filter else f" {label(cell.row)}"
    unit = f" [{cell.unit}]" if cell.unit else ""
    return f"{cell.table} {cell.filter}{row}: {cell.column}{unit}"


def _values(changes: Sequence[Change]) -> DisplayTable:
    footnote = "% is of the magnitude; for NIS, of the ratio to its degrees of freedom"
    return table_of("Values, old and new", changes, (("value", "l", _cell_name), *_OLD_AND_NEW), footnote)


def _values_over_dives(cells: Sequence[Aggregate]) -> DisplayTable:
    columns: tuple[ShownColumn, ...] = (
        ("value", "l", _cell_name),
        *((key, "r", key) for key in ("dives", "better", "worse")),
        ("median\n[%]", "r", "median_change_pct:signed_percent"),
        ("worst\n[%]", "r", "worst_change_pct:signed_percent"),
        ("in", "l", lambda cell: MISSING if cell.worst_word == ChangeVerdict.SAME else cell.worst_log),
    )
    return table_of("Values over the dives", cells, columns)
