"""Compare two sets of results: match dives, list the changes of all cells, sum them up, and apply a limit."""

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace as with_fields
from pathlib import Path
from statistics import median
from typing import Any, Final

from msgspec import Struct
from msgspec.structs import replace

from insdvl_replay.changes.answer import Answer, answers_of
from insdvl_replay.changes.cells import ROUNDING, Change, RowPair, changes_of, paired_rows, within
from insdvl_replay.core.config import flattened
from insdvl_replay.core.errors import ConfigError, Note, counted, listed, require_known
from insdvl_replay.core.quantities import WITHOUT_VERDICT, label
from insdvl_replay.core.report import StoredReport, StoredResult
from insdvl_replay.core.tables import LAYOUTS, Number
from insdvl_replay.core.words import ChangeVerdict, MatchedBy, Severity, Verdict
from insdvl_replay.document.tables import FORMS
from insdvl_replay.results.stored_results import read_results

# What may differ outside the tables, in the order of interest.
BLOCKS: Final = ("tool", "versions", "config", "filters", "log", "notes")
WORSE: Final = "worse"  # instead of a percentage: fail on the answer
UNDECIDED: Final = "undecided"  # the same, and on answers that are not decided
# The main columns, and words with a rank, which summarise numbers.
_PRIMARY: Final = {
    (layout.name, column) for layout in LAYOUTS for column in (layout.primary, *layout.words)
}
_ORDER: Final = {layout.name: position for position, layout in enumerate(LAYOUTS)}


class Difference(Struct, frozen=True):
    """One difference outside the tables, which may explain a changed number."""

    block: str  # one of `BLOCKS`
    key: str  # dotted, as on the command line
    old: str | None  # as in TOML; None if a side does not have it
    new: str | None
    logs: tuple[str, ...]  # the dives it concerns


Counts = dict[ChangeVerdict, int]  # number of cells by verdict


class DiveComparison(Struct, frozen=True):
    """One dive and its counterpart; without a counterpart there is no folder on that side, and nothing to count."""

    log: str
    old: str | None
    new: str | None
    matched_by: MatchedBy
    counts: Counts | None


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
    counts: Counts
    worst: Change | None  # the largest loss and gain, primary columns first
    best: Change | None
    differences: tuple[Difference, ...]
    dives: tuple[DiveComparison, ...]
    aggregates: tuple[Aggregate, ...]
    changes: tuple[Change, ...]
    notes: tuple[Note, ...] = ()
    baseline: str = ""

    @property
    def matched(self) -> list[DiveComparison]:
        """The dives that both sides have."""
        return [dive for dive in self.dives if dive.counts is not None]


def compare_results(
    old: Path,
    new: Path,
    *,
    tables: Sequence[str] = (),  # only these; empty for all
    columns: Sequence[str] = (),
    dives: Sequence[str] = (),
    filter_pairs: Mapping[str, str] = {},  # new name of a filter by its old one, where they differ
    tolerance_pct: float | None = None,
) -> Comparison:
    """Compare two sets of results, each a report.json, a result folder or a folder of such at any depth.

    ConfigError if both sides share no dive or no candidate, or a name is not known.
    """
    for name in tables:
        require_known("table", name, [layout.name for layout in LAYOUTS], most=len(LAYOUTS))
    layouts = [layout for layout in LAYOUTS if not tables or layout.name in tables]
    (before, notes_before), (after, notes_after) = read_results(old), read_results(new)
    matching = match_dives(_with_new_names(before, filter_pairs), after)
    both = [(was, is_, how) for was, is_, how in matching if was and is_]
    for name in dives:
        require_known("dive", name, [is_.name for _, is_, _ in both])
    if dives:
        matching = []
        both = [match for match in both if match[1].name in dives]
    pairs = [(was, is_) for was, is_, _ in both]
    frames = [[*paired_rows(was.report, is_.report, layouts)] for was, is_ in pairs]
    notes = [*notes_before, *notes_after, *_notes_on_names(pairs, frames)]
    known = dict.fromkeys(
        column for frame in frames for row in frame for column in (*row.new, *row.old)
    )
    if not known:  # an empty comparison must not pass
        names = ", ".join(layout.name for layout in layouts)
        raise ConfigError(
            f"there is no row to compare in {names}", "leave out --table to see all tables"
        )
    for name in columns:
        require_known("column", name, [*known])

    changes = list[Change]()
    compared = list[DiveComparison]()
    for (was, is_, how), frame in zip(both, frames, strict=True):
        found = [*changes_of(frame, is_.name, columns, tolerance_pct)]
        compared.append(
            DiveComparison(is_.name, str(was.folder), str(is_.folder), how, _counts(found))
        )
        changes += found
    for lost, added, how in matching:
        if lost and not added:
            compared.append(DiveComparison(lost.name, str(lost.folder), None, how, None))
        elif added and not lost:
            compared.append(DiveComparison(added.name, None, str(added.folder), how, None))
    return Comparison(
        old=str(old),
        new=str(new),
        answers=answers_of(pairs),
        tolerance_pct=tolerance_pct,
        counts=_counts(changes),
        worst=_largest(changes, 1.0),
        best=_largest(changes, -1.0),
        differences=_differences(pairs),
        dives=tuple(compared),
        aggregates=aggregates(changes),
        changes=tuple(changes),
        notes=tuple(notes),
        baseline=next((is_.report.baseline for _, is_ in pairs), ""),
    )


# --- Dives and filters that belong together.

# Results of one log in several folders are matched by their place, then by their name. Without a file there is no hash.
_MATCHES: Final[tuple[tuple[MatchedBy, Callable[[StoredResult], Hashable]], ...]] = (
    (
        MatchedBy.HASH,
        lambda result: result.report.log.sha256 and (result.report.log.sha256, result.below),
    ),
    (
        MatchedBy.HASH,
        lambda result: result.report.log.sha256 and (result.report.log.sha256, result.name),
    ),
    (MatchedBy.HASH, lambda result: result.report.log.sha256),
    (MatchedBy.NAME, lambda result: (result.name, result.below)),
    (MatchedBy.NAME, lambda result: result.name),
)


def match_dives(
    old: Sequence[StoredResult], new: Sequence[StoredResult]
) -> list[tuple[StoredResult | None, StoredResult | None, MatchedBy]]:
    """Match results of the same dive, by the hash of the log, else by name; those without counterpart come last.

    Two single results are always matched.
    """
    found = dict[Path, tuple[StoredResult, MatchedBy]]()  # by the folder of the new result
    before = list(old)
    after = list(new)
    for how, key in _MATCHES:
        sides = []
        for results in (before, after):
            times = Counter(map(key, results))
            sides.append(
                {
                    key(result): result
                    for result in results
                    if key(result) and times[key(result)] == 1
                }
            )
        theirs, ours = sides
        found |= {ours[value].folder: (theirs[value], how) for value in theirs.keys() & ours.keys()}
        taken = {was.folder for was, _ in found.values()}
        before = [result for result in before if result.folder not in taken]
        after = [result for result in after if result.folder not in found]
    if len(old) == len(new) == 1 and not found:
        return [(old[0], new[0], MatchedBy.CHOICE)]
    # A dive that is left on both sides has several results, and the matching ones are not known.
    for result in after:
        digest = result.report.log.sha256
        if any(
            other.name == result.name or (digest and other.report.log.sha256 == digest)
            for other in before
        ):
            folders = [
                str(other.folder) for other in (*before, *after) if other.name == result.name
            ]
            text = f"{result.name}: several results could match: {', '.join(folders)}"
            raise ConfigError(text, "name the two folders to compare")
    if not found:
        old_names, new_names = (listed(result.name for result in results) for results in (old, new))
        raise ConfigError(
            f"no dive of the old results ({old_names}) is in the new ones ({new_names})",
            "name two folders that hold results of the same logs, or two single results",
        )
    return [
        *(
            (found[result.folder][0], result, found[result.folder][1])
            for result in new
            if result.folder in found
        ),
        *((result, None, MatchedBy.NOTHING) for result in before),
        *((None, result, MatchedBy.NOTHING) for result in after),
    ]


def parse_pairs(texts: Iterable[str]) -> dict[str, str]:
    """Read pairs such as ``aided=windowed``, the new name by the old one."""
    pairs = {}
    for text in texts:
        old, _, new = text.partition("=")
        if not (old and new):
            raise ConfigError(
                f"--pair {text}: is not of the form OLD=NEW", "write --pair aided=windowed"
            )
        pairs[old] = new
    return pairs


def _with_new_names(
    results: Sequence[StoredResult], pairs: Mapping[str, str]
) -> list[StoredResult]:
    """Return old results with the new names of their filters."""
    names = list(
        dict.fromkeys(
            name for result in results for name in (result.report.baseline, *result.report.filters)
        )
    )
    for old, new in pairs.items():
        require_known("filter", old, names)
        if new in names and new not in pairs:
            text = f"--pair {old}={new}: the old results also have a filter {new}"
            raise ConfigError(text, f"add --pair {new}={new}_before")
    renamed = []
    for result in results:
        report = result.report
        tables = {
            table: [
                {**row, "filter": pairs.get(str(row.get("filter")), row.get("filter"))}
                for row in rows
            ]
            for table, rows in report.tables.items()
        }
        filters = {pairs.get(name, name): candidate for name, candidate in report.filters.items()}
        baseline = pairs.get(report.baseline, report.baseline)
        report = replace(report, tables=tables, filters=filters, baseline=baseline)
        renamed.append(with_fields(result, report=report))
    return renamed


# --- What else differs.


def _notes_on_names(
    pairs: Sequence[tuple[StoredResult, StoredResult]], frames: Iterable[Iterable[RowPair]]
) -> Iterator[Note]:
    """Note the candidates and tables that are on one side only, or unknown; raise if no candidate is on both sides."""
    candidates = [(set(old.report.filters), set(new.report.filters)) for old, new in pairs]
    theirs, ours = (sorted(set[str]().union(*side)) for side in zip(*candidates, strict=True))
    if theirs and ours and not any(old & new for old, new in candidates):
        raise ConfigError(
            f"no candidate of the old results ({', '.join(theirs)}) is in the new ones ({', '.join(ours)})",
            f"match them by name: --pair {theirs[0]}={ours[0]}",
        )
    tables = [({row.layout.name for row in rows if row.old}, {row.layout.name for row in rows if row.new})
              for rows in map(list, frames)]  # fmt: skip
    gone = set(theirs) - set(ours)
    added = set(ours) - set(theirs)
    hints = {
        "filter": "its verdict against the baseline is in the results that have it",
        "table": "",
    }
    if gone and added:
        hints["filter"] = "--pair OLD=NEW compares filters with different names"
    for kind, names in (("filter", candidates), ("table", tables)):
        for place, side, word in ((0, "old", ChangeVerdict.GONE), (1, "new", ChangeVerdict.NEW)):
            counts = Counter(name for pair in names for name in pair[place] - pair[1 - place])
            for name, count in sorted(counts.items()):
                text = f"{kind} {name} is only in the {side} results ({counted(count, 'dive')}); its rows are {word}"
                yield Note(f"{kind}_on_one_side", text, count, Severity.WARNING, hints[kind])
    unknown = Counter(
        table for pair in pairs for side in pair for table in {*side.report.tables} - _ORDER.keys()
    )
    for table, count in unknown.items():
        text = f"table {table}: unknown to this version, and ignored"
        yield Note(
            "table_unknown", text, count, Severity.WARNING, "compare with the version that wrote it"
        )


def _differences(pairs: Iterable[tuple[StoredResult, StoredResult]]) -> tuple[Difference, ...]:
    """Return all differences outside the tables, each once with its dives."""
    logs: dict[tuple[str, str, str | None, str | None], list[str]] = {}
    for old, new in pairs:
        before = _facts(old.report)
        after = _facts(new.report)
        for block, key in dict.fromkeys((*before, *after)):
            was = before.get((block, key))
            is_ = after.get((block, key))
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
        "tool": {
            key: value
            for key, value in report.tool.items()
            if key in {"name", "version", "sources"}
        },
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


# --- Sums and limits.


def _loss_pct(change: Change) -> float:
    """Return the loss of a cell in percent or points; infinite for a number that was lost."""
    if change.verdict not in {ChangeVerdict.BETTER, ChangeVerdict.WORSE, ChangeVerdict.GONE}:
        return 0.0
    amount = math.inf if change.change_pct is None else abs(change.change_pct)
    if change.verdict == ChangeVerdict.BETTER:
        return -amount
    return amount


def _largest(changes: Iterable[Change], sign: float) -> Change | None:
    """Return the largest loss, or with a sign of -1 gain; primary columns come first, and the first of equals."""
    found = [change for change in changes if sign * _loss_pct(change) > 0.0]

    def importance(change: Change) -> tuple[bool, float]:
        return (change.table, change.column) in _PRIMARY, sign * _loss_pct(change)

    return max(found, key=importance, default=None)


def _counts(changes: Iterable[Change]) -> Counts:
    """Count cells by verdict."""
    counts = Counter(change.verdict for change in changes)
    return {word: counts[word] for word in ChangeVerdict}


def aggregates(changes: Iterable[Change]) -> tuple[Aggregate, ...]:
    """Return each cell over the dives that have it on both sides: counts, median and worst change."""
    cells: dict[tuple[str, str, str, str, str], list[Change]] = {}
    for change in changes:
        if change.verdict in {ChangeVerdict.BETTER, ChangeVerdict.WORSE, ChangeVerdict.SAME}:
            key = change.table, change.filter, change.row, change.unit, change.column
            cells.setdefault(key, []).append(change)
    found = []
    for key, together in cells.items():
        counts = Counter(change.verdict for change in together)
        worst = max(together, key=_loss_pct)
        percentages = [change.change_pct for change in together if change.change_pct is not None]
        aggregate = Aggregate(
            *key,
            dives=len(together),
            better=counts[ChangeVerdict.BETTER],
            worse=counts[ChangeVerdict.WORSE],
            same=counts[ChangeVerdict.SAME],
            share_better_pct=100.0 * counts[ChangeVerdict.BETTER] / len(together),
            median_change_pct=median(percentages) if percentages else None,
            worst_log=worst.log,
            worst_change_pct=worst.change_pct,
            worst_word=worst.verdict,
        )
        found.append(aggregate)
    return tuple(sorted(found, key=lambda cell: _ORDER[cell.table]))


def only_changed(comparison: Comparison) -> Comparison:
    """Drop unchanged cells, and aggregates that are the same in all dives; the counts stay."""
    return replace(
        comparison,
        changes=tuple(
            change for change in comparison.changes if change.verdict != ChangeVerdict.SAME
        ),
        aggregates=tuple(cell for cell in comparison.aggregates if cell.same < cell.dives),
    )


def parse_percentage(text: str, option: str, otherwise: str = "") -> float:
    """Read a percentage such as ``0.1%``; the option, and what else it takes, are for the message."""
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+) ?%", text.strip())
    if match is None:
        raise ConfigError(
            f"{option} {text}: is not a percentage", f"write {option} 0.5%{otherwise}"
        )
    return float(match[1])


def parse_limit(text: str | None) -> float | str | None:
    """Read the value of ``--fail-on``: a percentage, or one of the words worse and undecided."""
    if text in (None, WORSE, UNDECIDED):
        return text
    return parse_percentage(
        str(text), "--fail-on", f", or --fail-on {WORSE} or --fail-on {UNDECIDED}"
    )


def find_violation(comparison: Comparison, limit: float | str | None) -> str:
    """Return what is worse than allowed; empty if nothing is.

    For ``worse`` these are the sentences of the filters whose answer is worse or partly worse, and missing dives. For
    ``undecided`` those of filters without a decision count, too. For a
    number they are the values that are worse by more, in percent or points. A worse verdict, a number that was lost or
    grew from zero, and a missing row or dive exceed every number.
    """
    if limit is None:
        return ""
    gone = [dive.log for dive in comparison.dives if dive.new is None]
    lost = [f"{counted(len(gone), 'dive')} without new results: {', '.join(gone)}"] if gone else []
    if not isinstance(limit, float):
        is_open = limit == UNDECIDED
        sentences = [
            answer.sentence
            for answer in comparison.answers
            if answer.is_harm
            or (is_open and answer.verdict in (Verdict.UNDECIDED, *WITHOUT_VERDICT))
        ]
        return " ".join([*sentences, *lost])
    above_pct = limit
    changes = [
        change
        for change in comparison.changes
        if not within(_loss_pct(change), above_pct, 100.0 * ROUNDING)
    ]
    reasons = []
    if worst := _largest(changes, 1.0):
        more = f" by more than {above_pct:g} %" if above_pct else ""
        worse = f"{'are' if len(changes) > 1 else 'is'} worse{more}"
        reasons.append(f"{counted(len(changes), 'value')} {worse}; worst: {described(worst)}")
    return "; ".join([*reasons, *lost])


def described(change: Change) -> str:
    """Return the place and the change of a cell in one line."""
    old = FORMS["cell"](change.old)
    new = FORMS["cell"](change.new)
    return f"{change.log}, {cell_place(change)} from {old} to {new} ({change.growth})"


def cell_place(cell: Change | Aggregate) -> str:
    """Name a cell by its table and column, as options do, such as ``reference_error aided roll: rmse [deg]``."""
    row = "" if cell.row == cell.filter else f" {label(cell.row)}"
    unit = f" [{cell.unit}]" if cell.unit else ""
    return f"{cell.table} {cell.filter}{row}: {cell.column}{unit}"
