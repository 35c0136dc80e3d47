"""Compare two sets of results: match dives, list the changes of all cells, sum them up, and apply a limit."""

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Final

from msgspec import Struct
from msgspec.structs import replace

from insdvl_replay.changes.answer import Answer, compared_filters
from insdvl_replay.changes.cells import ROUNDING, Change, RowPair, changes_of, paired_rows, within
from insdvl_replay.changes.differences import Difference, differences, notes_on_names
from insdvl_replay.changes.matching import (
    Match,
    Matching,
    match_dives,
    require_new_names,
    with_new_names,
)
from insdvl_replay.core.errors import ConfigError, Note, counted, require_known
from insdvl_replay.core.quantities import WITHOUT_VERDICT, label
from insdvl_replay.core.report import StoredResult
from insdvl_replay.core.tables import LAYOUTS, Number, TableLayout, WhereRow
from insdvl_replay.core.words import ChangeVerdict, MatchedBy, Verdict
from insdvl_replay.document.tables import plain_text
from insdvl_replay.results.stored_results import read_results

WORSE: Final = "worse"  # instead of a percentage: fail on the answer
UNDECIDED: Final = "undecided"  # the same, and on answers that are not decided
_ORDER: Final = {layout.name: position for position, layout in enumerate(LAYOUTS)}


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
    # the drift of each filter by what the vehicle does, new over old, over several dives
    where: tuple[WhereRow, ...] = ()

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

    ConfigError if both sides share no dive or no candidate, a name is not known, or the tolerance is no percentage.
    """
    _require_percentage(tolerance_pct)
    layouts = _named_layouts(tables)
    before, notes_before = read_results(old)
    after, notes_after = read_results(new)
    renamed = with_new_names(before, filter_pairs)
    require_new_names(after, filter_pairs)
    matching = _only_dives(match_dives(renamed, after), dives)
    pairs = [match.pair for match in matching.both]
    frames = [list(paired_rows(pair.old.report, pair.new.report, layouts)) for pair in pairs]
    notes = [*notes_before, *notes_after, *notes_on_names(pairs, frames)]
    _require_columns(columns, frames, layouts)

    changes = list[Change]()
    compared = list[DiveComparison]()
    for match, frame in zip(matching.both, frames, strict=True):
        found = list(changes_of(frame, match.pair.new.name, columns, tolerance_pct))
        compared.append(_both_sides(match, found))
        changes += found
    compared += [_gone(result) for result in matching.gone]
    compared += [_added(result) for result in matching.added]
    filters = compared_filters(pairs)
    return Comparison(
        old=str(old),
        new=str(new),
        answers=filters.answers,
        tolerance_pct=tolerance_pct,
        counts=_counts(changes),
        worst=_largest(changes, 1.0),
        best=_largest(changes, -1.0),
        differences=differences(pairs),
        dives=tuple(compared),
        aggregates=aggregates(changes),
        changes=tuple(changes),
        notes=tuple(notes),
        baseline=pairs[0].new.report.baseline if pairs else "",
        where=filters.where,
    )


def _require_percentage(tolerance_pct: float | None) -> None:
    if tolerance_pct is not None and not 0.0 <= tolerance_pct < math.inf:
        raise ConfigError(f"tolerance {tolerance_pct:g}: is not a percentage", "for example 0.5")


def _named_layouts(tables: Sequence[str]) -> list[TableLayout]:
    """Return the layouts of the tables that were named; of all where none was."""
    for name in tables:
        require_known("table", name, [layout.name for layout in LAYOUTS], most=len(LAYOUTS))
    return [layout for layout in LAYOUTS if not tables or layout.name in tables]


def _only_dives(matching: Matching, dives: Sequence[str]) -> Matching:
    """Keep the matched dives with some names, all without any; a ConfigError for a name that no matched dive has."""
    if not dives:
        return matching
    for name in dives:
        require_known("dive", name, [match.pair.new.name for match in matching.both])
    both = [match for match in matching.both if match.pair.new.name in dives]
    return Matching(both, gone=[], added=[])


def _require_columns(
    columns: Sequence[str], frames: Sequence[Sequence[RowPair]], layouts: Sequence[TableLayout]
) -> None:
    """Raise a ConfigError if no table has one of some columns, or if there is no row at all."""
    known = dict[str, None]()
    for frame in frames:
        for row in frame:
            known.update(dict.fromkeys((*row.new, *row.old)))
    if not known:  # an empty comparison must not pass
        names = ", ".join(layout.name for layout in layouts)
        raise ConfigError(
            f"there is no row to compare in {names}", "leave out --table to see all tables"
        )
    for name in columns:
        require_known("column", name, list(known))


def _both_sides(match: Match, changes: Sequence[Change]) -> DiveComparison:
    old, new = match.pair
    counts = _counts(changes)
    return DiveComparison(new.name, str(old.folder), str(new.folder), match.by, counts)


def _gone(result: StoredResult) -> DiveComparison:
    return DiveComparison(result.name, str(result.folder), None, MatchedBy.NOTHING, None)


def _added(result: StoredResult) -> DiveComparison:
    return DiveComparison(result.name, None, str(result.folder), MatchedBy.NOTHING, None)


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
    if not found:
        return None
    return max(found, key=lambda change: (_is_primary(change), sign * _loss_pct(change)))


def _is_primary(change: Change) -> bool:
    """Return whether a cell is in the main column of its table, or is a word with a rank, which summarises numbers."""
    layout = LAYOUTS[_ORDER[change.table]]
    return change.column == layout.primary or change.column in layout.words


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
    found = [_aggregate(together) for together in cells.values()]
    return tuple(sorted(found, key=lambda cell: _ORDER[cell.table]))


def _aggregate(changes: Sequence[Change]) -> Aggregate:
    """Sum up the changes of one cell on several dives."""
    place = changes[0]
    counts = _counts(changes)
    worst = max(changes, key=_loss_pct)
    percentages = [change.change_pct for change in changes if change.change_pct is not None]
    return Aggregate(
        table=place.table,
        filter=place.filter,
        row=place.row,
        unit=place.unit,
        column=place.column,
        dives=len(changes),
        better=counts[ChangeVerdict.BETTER],
        worse=counts[ChangeVerdict.WORSE],
        same=counts[ChangeVerdict.SAME],
        share_better_pct=100.0 * counts[ChangeVerdict.BETTER] / len(changes),
        median_change_pct=median(percentages) if percentages else None,
        worst_log=worst.log,
        worst_change_pct=worst.change_pct,
        worst_word=worst.verdict,
    )


def only_changed(comparison: Comparison) -> Comparison:
    """Drop unchanged cells, and aggregates that are the same in all dives; the counts stay."""
    changes = [change for change in comparison.changes if change.verdict != ChangeVerdict.SAME]
    moved = [cell for cell in comparison.aggregates if cell.same < cell.dives]
    return replace(comparison, changes=tuple(changes), aggregates=tuple(moved))


# --- Options of a comparison.


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


def find_violation(comparison: Comparison, limit: float | str | None) -> str | None:
    """Return what is worse than allowed; None if nothing is.

    For ``worse`` these are the sentences of the filters whose answer is worse or partly worse, and missing dives. For
    ``undecided`` those of filters without a decision count, too. For a number they are the values that are worse by
    more, in percent or points. A worse verdict, a number that was lost or grew from zero, and a missing row or dive
    exceed every number.
    """
    if limit is None:
        return None
    lost = _lost_dives(comparison)
    if isinstance(limit, float):
        found = [*_worse_values(comparison.changes, limit), *lost]
        joint = "; "
    else:
        found = [*_harm(comparison.answers, is_open_harm=limit == UNDECIDED), *lost]
        joint = " "
    if found:
        return joint.join(found)
    return None


def _harm(answers: Iterable[Answer], *, is_open_harm: bool) -> Iterator[str]:
    """Yield the sentences of the filters that are worse, or, where that is harm as well, without a decision."""
    for answer in answers:
        is_open = answer.verdict in (Verdict.UNDECIDED, *WITHOUT_VERDICT)
        if answer.is_harm or (is_open_harm and is_open):
            yield answer.sentence


def _worse_values(changes: Iterable[Change], limit_pct: float) -> Iterator[str]:
    """Count the values that are worse by more than a limit, and name the worst; nothing without any."""
    beyond = list[Change]()
    for change in changes:
        if not within(_loss_pct(change), limit_pct, 100.0 * ROUNDING):
            beyond.append(change)
    worst = _largest(beyond, 1.0)
    if worst is None:
        return
    are_worse = f"{'are' if len(beyond) > 1 else 'is'} worse"
    if limit_pct:
        are_worse += f" by more than {limit_pct:g} %"
    yield f"{counted(len(beyond), 'value')} {are_worse}; worst: {described(worst)}"


def _lost_dives(comparison: Comparison) -> Iterator[str]:
    """Name the dives without new results; nothing if there are none."""
    gone = [dive.log for dive in comparison.dives if dive.new is None]
    if gone:
        yield f"{counted(len(gone), 'dive')} without new results: {', '.join(gone)}"


def described(change: Change) -> str:
    """Return the place and the change of a cell in one line."""
    old = plain_text(change.old)
    new = plain_text(change.new)
    return f"{change.log}, {cell_place(change)} from {old} to {new} ({change.growth})"


def cell_place(cell: Change | Aggregate) -> str:
    """Name a cell by its table and column, as options do, such as ``reference_error aided roll: rmse [deg]``."""
    row = "" if cell.row == cell.filter else f" {label(cell.row)}"
    unit = f" [{cell.unit}]" if cell.unit else ""
    return f"{cell.table} {cell.filter}{row}: {cell.column}{unit}"
