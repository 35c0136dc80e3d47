"""A comparison for people, what differs, where it moved, then row by row; and for scripts, as CSV."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, fields, replace
from typing import Final

from insdvl_replay.comparison.brief import (
    brief_aggregates,
    brief_changes,
    brief_differences,
    dot_plot,
    moved_elsewhere,
)
from insdvl_replay.comparison.display_tables import aggregate_tables, change_tables, described, growth, place
from insdvl_replay.core.changes import (
    Aggregate,
    Change,
    Comparison,
    Difference,
    DiveComparison,
    Limit,
    Tally,
    Violation,
)
from insdvl_replay.core.tables import CANDIDATES
from insdvl_replay.core.words import ChangeWord
from insdvl_replay.report.csv_tables import blocks_csv
from insdvl_replay.report.document import MISSING, Callout, DisplayTable, Heading, Only, Part, Sentences, Title, counted

_HASH_DIGITS: Final = 12
MOST_BESIDE: Final = 12
"""So many values that moved beside the evidence are shown in brief."""
ALIKE: Final = "tool, settings and log do not differ"
_NAMED_DIVES: Final = 2


def brief_document(comparison: Comparison) -> list[Part]:
    """Lay out what changed: verdicts, what differs beside the tables, and the evidence that moved."""
    matched = _matched(comparison)
    baseline = comparison.baseline
    apart = [dive for dive in comparison.dives if dive.tally is None]
    moved = (
        brief_aggregates(comparison.aggregates, baseline)
        if len(matched) > 1
        else brief_changes(comparison.changes, baseline)
    )
    shown = [*moved] or (_few(comparison) if len(matched) == 1 else [])
    unpaired = [f"{_only_side(dive)}: {dive.log}" for dive in apart]
    return [
        Title(_title(comparison)),
        *map(Callout, _changed_verdicts(comparison) if matched else ()),
        *([] if any(_changed_verdicts(comparison)) else ["no verdict changed"]),
        *(brief_differences(comparison.differences) if comparison.differences else [ALIKE]),
        *(replace(table, title_apart=True) for table in shown),
        *([Sentences(tuple(unpaired))] if unpaired else []),
        Sentences((moved_elsewhere(comparison),)),
    ]


def _few(comparison: Comparison) -> list[DisplayTable]:
    """Lay out what moved in tables other than the evidence, where it is little."""
    moved = [change for change in comparison.changes if change.word != ChangeWord.SAME]
    return change_tables(moved) if len(moved) <= MOST_BESIDE else []


def comparison_page(comparison: Comparison) -> list[Part]:
    """Lay out the page of a comparison: what is brief first, one picture of all dives, then every table."""
    _, *whole = comparison_document(comparison)
    return [*brief_document(comparison), *dot_plot(comparison, comparison.baseline), Heading("All that moved"), *whole]


def _title(comparison: Comparison) -> str:
    matched = _matched(comparison)
    what = matched[0].log if len(matched) == 1 else f"{len(matched)} dives"
    return f"{what}: {comparison.new} against {comparison.old}"


def comparison_document(comparison: Comparison) -> list[Part]:
    """Lay out all of a comparison."""
    matched = _matched(comparison)
    rest = "the values of one dive: --dive NAME; those of all: --format csv or --format json"
    return [
        Title(_title(comparison)),
        *map(Callout, opening_lines(comparison)),
        *(replace(table, title_apart=True) for table in comparison_tables(comparison)),
        *([Only(("terminal", "markdown", "html"), (Sentences((rest,)),))] if len(matched) > 1 else []),
    ]


def opening_lines(comparison: Comparison) -> list[str]:
    """State which verdicts changed, how many values moved, and which of them most."""
    counts = comparison.total.counts
    number = sum(counts.values())
    words = ", ".join(f"{counts[word]} {word}" for word in ChangeWord if counts[word] and word != ChangeWord.SAME)
    limit = "the last printed digit" if comparison.tolerance_pct is None else f"{comparison.tolerance_pct:g} %"
    lines = [f"{words or 'nothing moved'}; {counts[ChangeWord.SAME]} of {number} values are the same up to {limit}"]
    for name, change in (("worst", comparison.total.worst), ("best", comparison.total.best)):
        if change is not None:
            lines.append(f"{name}: {described(change)}")
    if not comparison.differences:
        lines.append(ALIKE)
    return [*_changed_verdicts(comparison), *lines]


_JUDGED: Final = {"improvement": "{} is now {}, was {}", "belief": "what {} believes is now {}, was {}"}
"""By column of the candidates what is said where its word changed."""


def _changed_verdicts(comparison: Comparison) -> Iterator[str]:
    """State which judgements and beliefs changed, the judgements first, each once with its dives."""
    dives: dict[tuple[str, str, str, str], list[str]] = {}
    for change in comparison.changes:
        of_word = change.table == CANDIDATES.name and change.column in _JUDGED
        if of_word and change.old and change.new and change.old != change.new:
            key = change.column, change.filter, str(change.new), str(change.old)
            dives.setdefault(key, []).append(change.log)
    matched = len(_matched(comparison))
    for (column, *named), of_change in sorted(dives.items(), key=lambda found: list(_JUDGED).index(found[0][0])):
        where = f" ({_where(of_change, matched)})" if matched > 1 else ""
        yield f"{_JUDGED[column].format(*named)}{where}"


def comparison_tables(comparison: Comparison) -> list[DisplayTable]:
    """Turn a comparison into tables for people."""
    matched = len(_matched(comparison))
    tables = list(_differences(comparison.differences, matched))
    if len(comparison.dives) > 1:
        tables.append(_dives(comparison.dives))
    tables.append(_by_table(comparison.by_table))
    return [*tables, *(aggregate_tables(comparison.aggregates) if matched > 1 else change_tables(comparison.changes))]


def comparison_csv(comparison: Comparison) -> str:
    """Write differences, dives, aggregates and changes one after the other."""
    parts: dict[str, tuple[tuple[str, ...], Iterable[tuple[object, ...]]]] = {
        "difference": (_header(Difference), map(_difference_row, comparison.differences)),
        "dive": (("log", "old", "new", "matched_by", *ChangeWord), map(_dive_row, comparison.dives)),
        "aggregate": (_header(Aggregate), map(astuple, comparison.aggregates)),
        "change": (_header(Change), map(astuple, comparison.changes)),
    }
    return blocks_csv("part", parts)


def _header(kind: type[Difference | Aggregate | Change]) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))


def _difference_row(difference: Difference) -> tuple[object, ...]:
    return difference.block, difference.key, difference.old, difference.new, "; ".join(difference.logs)


def _dive_row(dive: DiveComparison) -> tuple[object, ...]:
    counts = [dive.tally.counts[word] if dive.tally else None for word in ChangeWord]
    return dive.log, dive.old, dive.new, dive.matched_by, *counts


def violation_sentence(violation: Violation) -> str:
    """State how much is worse than allowed, and what most."""
    reasons = []
    if violation.worst is not None:
        verb = "are" if violation.count > 1 else "is"
        much = f"{counted(violation.count, 'value')} {_too_far(violation.limit, verb)}"
        reasons.append(f"{much}; worst: {described(violation.worst)}")
    if violation.dives:
        reasons.append(f"{counted(len(violation.dives), 'dive')} without counterpart: {', '.join(violation.dives)}")
    return "; ".join(reasons)


def _too_far(limit: Limit, verb: str) -> str:
    if limit.word == ChangeWord.CHANGED:
        return ChangeWord.CHANGED
    return f"{verb} worse by more than {limit.above_pct:g} %" if limit.above_pct else f"{verb} worse"


def _matched(comparison: Comparison) -> list[DiveComparison]:
    return [dive for dive in comparison.dives if dive.tally is not None]


def _differences(differences: Sequence[Difference], dives: int) -> Iterator[DisplayTable]:
    if not differences:
        return
    of_all = all(len(difference.logs) == dives for difference in differences)
    yield DisplayTable(
        "What differs beside the tables" + (" (in all dives)" if of_all and dives > 1 else ""),
        ("what", "old", "new") if of_all else ("what", "old", "new", "dives"),
        "lll" if of_all else "llll",
        tuple(
            (
                f"{difference.block} {difference.key}",
                _value_text(difference, difference.old),
                _value_text(difference, difference.new),
                *(() if of_all else (_where(difference.logs, dives),)),
            )
            for difference in differences
        ),
    )


def _value_text(difference: Difference, value: str | None) -> str:
    if value is None:
        return MISSING
    return value[:_HASH_DIGITS] if difference.key == "sha256" else value


def _where(logs: Sequence[str], dives: int) -> str:
    """State which dives it is: all, a few by name, or how many."""
    if len(logs) == dives:
        return "all"
    return ", ".join(logs) if len(logs) <= _NAMED_DIVES else f"{len(logs)} of {dives}"


def _dives(dives: Sequence[DiveComparison]) -> DisplayTable:
    """Show the dives in which something moved, and count the others."""
    moved = [dive for dive in dives if dive.tally is None or _has_moved(dive.tally)]
    table = _tallies("Dives", "dive", [(dive.log, dive.tally, _only_side(dive)) for dive in moved])
    still = len(dives) - len(moved)
    return replace(table, footnote=f"and {counted(still, 'dive')} in which nothing moved") if still else table


def _only_side(dive: DiveComparison) -> ChangeWord:
    return ChangeWord.GONE if dive.new is None else ChangeWord.NEW


def _has_moved(tally: Tally) -> bool:
    return tally.counts[ChangeWord.SAME] < sum(tally.counts.values())


def _by_table(tables: Mapping[str, Tally]) -> DisplayTable:
    return _tallies("Tables", "table", [(name, tally, "") for name, tally in tables.items()])


def _tallies(title: str, key: str, named: Sequence[tuple[str, Tally | None, str]]) -> DisplayTable:
    """Show counts by word, those that occur, and the largest loss; of what has no tally, a word instead."""
    words = [word for word in ChangeWord if any(tally is not None and tally.counts[word] for _, tally, _ in named)]
    rows = []
    for name, tally, otherwise in named:
        counts = [MISSING if tally is None else str(tally.counts[word]) for word in words]
        rows.append((name, *counts, otherwise if tally is None else _worst(tally)))
    return DisplayTable(title, (key, *words, "worst"), f"l{'r' * len(words)}l", tuple(rows))


def _worst(tally: Tally) -> str:
    return MISSING if tally.worst is None else f"{place(tally.worst)} {growth(tally.worst)}"
