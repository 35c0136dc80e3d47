"""A comparison on a screen, as a page and in files: the answers first, then what else changed."""

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from msgspec.structs import astuple

from insdvl_replay.changes.answer import Answer
from insdvl_replay.changes.cells import Change, change_text
from insdvl_replay.changes.comparison import (
    Aggregate,
    Comparison,
    cell_place,
    described,
)
from insdvl_replay.changes.differences import Difference
from insdvl_replay.core.errors import counted, listed, natural_key
from insdvl_replay.core.quantities import WITHOUT_VERDICT, label
from insdvl_replay.core.tables import CANDIDATES, RATIO, PooledRow, finite
from insdvl_replay.core.words import ChangeVerdict, Verdict
from insdvl_replay.document.parts import (
    PAGE,
    PRINTED,
    Block,
    Callout,
    DisplayTable,
    Only,
    Part,
    Result,
    Sentences,
    Title,
)
from insdvl_replay.document.tables import MISSING, ShownColumn, table_of
from insdvl_replay.evaluation.answers import Undecided
from insdvl_replay.evaluation.sentences import (
    grounds,
    interval_text,
    plan_line,
    ratio_text,
    word_of,
)
from insdvl_replay.show.answers import TONES, verdict_in_table
from insdvl_replay.show.first_screen import (
    ForestRow,
    by_dive_forest,
    change_of_value,
    evidence_forest,
    first_screen,
    section,
)

MOST_OTHERS: Final = 12  # most changed values outside the evidence on the brief screen
NONE: Final = "none"  # instead of a missing value
_MOST_DIFFERENCES: Final = 8
_MOST_DRAWN: Final = 8  # rows of the forest plot
_NAMED_DIVES: Final = 2
# The sentence for a changed word, by column of the candidates.
_CHANGED_WORDS: Final = {
    "verdict": "{} against the baseline is now {}, was {}",
    "prediction": "the predicted improvement of {} is now {}, was {}",
}
# Rows of the evidence that are better nearer to 1; their ratio is of the distance from 1.
_OFF_ONE: Final = ("nis", "nees")


def comparison_result(comparison: Comparison, document: Sequence[Part]) -> Result:
    """Return a comparison as tables and JSON, with its screen."""
    dives = [
        (
            *astuple(dive)[:4],
            *(dive.counts[word] if dive.counts else None for word in ChangeVerdict),
        )
        for dive in comparison.dives
    ]
    return Result(
        kind="comparison",
        title=_title(comparison),
        tables={
            "answer": Block.of(
                PooledRow, (row for answer in comparison.answers for row in answer.rows)
            ),
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


def comparison_document(
    comparison: Comparison,
    *,
    values: bool = False,  # the changed values instead of the evidence
    every_row: bool = False,  # all rows of the evidence
    command: str = "",  # the one that shows all values, if it is not the one that was typed
) -> list[Part]:
    """Return the screen: answers, changed verdicts, differences outside the tables, evidence or values, and counts."""
    several = len(comparison.matched) > 1
    most = len(comparison.differences) if values else _MOST_DIFFERENCES
    unmoved = (ChangeVerdict.SAME, ChangeVerdict.NEW, ChangeVerdict.GONE)
    moved = [change for change in comparison.changes if change.verdict not in unmoved]
    if values:
        tables = [
            _values_over_dives(comparison.aggregates) if several else _values(comparison.changes)
        ]
    elif several:
        tables = [*_answer_table(comparison.answers, every_row=every_row)]
    else:
        tables = [*_evidence_of_dive(moved, comparison.baseline)]
        tables = [_values(moved)] if not tables and 0 < len(moved) <= MOST_OTHERS else tables
    apart = [
        f"{ChangeVerdict.GONE if dive.new is None else ChangeVerdict.NEW}: {dive.log}"
        for dive in comparison.dives
        if dive.counts is None
    ]
    blocks = _changed_verdicts(comparison), _other_differences(comparison, most)
    return [
        Title(_title(comparison)),
        *_answer_screen(comparison.answers),
        *(Sentences(tuple(block)) for block in blocks if block),
        *tables,
        *([Sentences(tuple(apart))] if apart else []),
        Sentences(tuple(_closing_lines(comparison, values=values, command=command))),
    ]


def _closing_lines(comparison: Comparison, *, values: bool, command: str) -> Iterator[str]:
    """Count the values by verdict, and say where the others are."""
    counts = comparison.counts
    words = ", ".join(
        f"{counts[word]} {word}"
        for word in ChangeVerdict
        if counts[word] and word != ChangeVerdict.SAME
    )
    limit = (
        "the last printed digit"
        if comparison.tolerance_pct is None
        else f"{comparison.tolerance_pct:g} %"
    )
    same = (
        f"{counts[ChangeVerdict.SAME]} of {sum(counts.values())} values are the same up to {limit}"
    )
    yield f"{words or 'no value changed'}; {same}"
    for name, change in (("worst", comparison.worst), ("best", comparison.best)):
        if values and change is not None:
            yield f"{name}: {described(change)}"
    if not values:
        yield f"All values: {command}--all. One table: {command and '... '}--table NAME"
    elif len(comparison.matched) > 1:
        yield "values of one dive: --dive NAME. Values of all dives: --format csv or --format json"


# --- The answers.


def answer_lines(answers: Sequence[Answer]) -> list[Callout]:
    """Return a line for each filter: its verdict and the evidence that made it, or could have."""
    name_width, verdict_width = (
        max(map(len, texts))
        for texts in zip(*((answer.filter, word_of(answer)) for answer in answers), strict=True)
    )
    return [
        Callout(
            f"{answer.filter.ljust(name_width)}  {word_of(answer).ljust(verdict_width)}  {_said(answer)}",
            TONES.get(answer.verdict, ""),
        )
        for answer in answers
    ]


def _said(answer: Answer) -> str:
    """Write the primary quantity of an answer, with what these dives can find; or that nothing changed."""
    dives = counted(answer.dives, "dive")
    if answer.verdict in WITHOUT_VERDICT:
        return f"evaluated in only {answer.evaluated} of {dives}: {answer.reason}"
    said = answer.sameness if answer.is_same else grounds(answer)
    is_one_dive = answer.undecided == Undecided.ONE_DIVE
    found = [said, plan_line(answer).rstrip(".") if answer.undecided and not is_one_dive else ""]
    lost = (
        f"no longer evaluated in {answer.lost} of {dives}: {answer.reason}" if answer.lost else ""
    )
    return "; ".join(filter(None, (*found, lost)))


def _answer_table(answers: Sequence[Answer], *, every_row: bool) -> Iterator[DisplayTable]:
    """Return the evidence behind the answers: all rows, or those that decide and those that warn."""
    columns: tuple[ShownColumn, ...] = (
        ("filter", "l", "filter"),
        ("evidence", "l", "quantity:label"),
        ("", "l", "unit"),
        ("old", "r", "baseline:value"),
        ("new", "r", "value:value"),
        ("ratio", "r", lambda row: ratio_text(row.ratio)),
        ("interval", "r", interval_text),
        ("won", "r", lambda row: f"{row.dives_won}/{row.dives}"),
        ("", "l", verdict_in_table),
    )
    rows = [row for answer in answers for row in answer.known]
    chosen = [
        row
        for answer in answers
        if not answer.is_same
        for row in (answer.decisive, *answer.warnings)
    ]
    kept = [row for row in rows if every_row or row in chosen]
    left = len(rows) - len(kept)
    footnote = (
        "old, new: medians over the dives. ratio: new over old, geometric mean over the dives."
    )
    footnote += f" {left} more rows: -v" if left else ""
    if kept:
        yield table_of("Evidence, new against old", kept, columns, footnote, spare=(2, 7, 3, 4))


def _answer_screen(answers: Sequence[Answer]) -> list[Part]:
    """Return the answers: a line for each filter, on pages a section with forest plots."""
    sections = []
    for answer in answers:
        plots = [
            evidence_forest("This dive" if answer.dives == 1 else "All dives", answer, _MOST_DRAWN)
        ]
        if answer.dives > 1:
            rows = [
                ForestRow(
                    dive.log,
                    dive.ratio,
                    tone=Verdict.UNDECIDED,
                    text=change_of_value(dive.old, dive.new, dive.unit),
                )
                for dive in answer.by_dive
                if finite(dive.ratio) > 0.0
            ]
            plots.append(by_dive_forest(answer.primary, rows))
        sections.append(section(answer, [f"{_said(answer)}."], plots))
    caption = (
        "All dives: each is one sample." if any(answer.dives > 1 for answer in answers) else ""
    )
    page = first_screen(sections, caption, compared=("new result", "old one"))
    return [Only(PRINTED, tuple(answer_lines(answers))), Only(PAGE, (page,))]


# --- Settings, verdicts and other differences.


def _title(comparison: Comparison) -> str:
    """Name the setting that differs, count further ones, then name the dives and both sides."""
    matched = comparison.matched
    settings = _changed_settings(comparison)
    what = matched[0].log if len(matched) == 1 else f"{len(matched)} dives"
    more = f" and {counted(len(settings) - 1, 'more setting')}" if len(settings) > 1 else ""
    changed = f"{settings[0]}{more}" if settings else "same settings"
    return f"{changed}: {what}, new: {comparison.new}, old: {comparison.old}"


def _changed_settings(comparison: Comparison) -> list[str]:
    """Return the settings that differ, each once, with the number of its dives if it does not differ in all.

    The keys of a filter that only one side has say nothing more than its name.
    """
    found = [item for item in comparison.differences if item.block == "config"]
    added = re.compile(r"filters\.(.+)\.aiding")
    one_sided = {
        match[1]: "old" if item.new is None else "new"
        for item in found
        if (match := added.fullmatch(item.key)) and None in (item.old, item.new)
    }
    own_keys = tuple(f"filters.{name}." for name in one_sided)
    texts = [
        _difference_text(item, item.key, comparison)
        for item in found
        if not item.key.startswith(own_keys)
    ]
    return [
        *texts,
        *(f"filter {name} only in the {side} results" for name, side in one_sided.items()),
    ]


def _difference_text(item: Difference, name: str, comparison: Comparison) -> str:
    """Write a difference, with the number of its dives if it is not in all."""
    matched = len(comparison.matched)
    some = f" (in {len(item.logs)} of {matched})" if len(item.logs) < matched else ""
    return (
        change_text(name, *(NONE if side is None else side for side in (item.old, item.new))) + some
    )


def _other_differences(comparison: Comparison, most: int) -> list[str]:
    """Return the differences outside the tables, one line each: logs, settings that the title lacks, and the rest."""
    found = comparison.differences
    other = [
        item
        for item in found
        if (item.block, item.key) == ("log", "sha256") and item.old and item.new
    ]
    names = sorted({name for item in other for name in item.logs}, key=natural_key)
    whose = "the log differs" if len(names) == 1 else f"the logs of {listed(names)} differ"
    lines = [f"{whose} (SHA-256). Changed values may come from the log"] if names else []
    texts = _changed_settings(comparison)[1:]
    for item in found:
        if item not in other and item.block != "config":
            texts.append(_difference_text(item, f"{item.block} {item.key}", comparison))
    left = len(texts) - most
    return [*lines, *texts[:most], *([f"{left} more differ: --all"] if left > 0 else [])]


def _changed_verdicts(comparison: Comparison) -> list[str]:
    """Return the changed verdicts, then the changed predictions, each once with its dives."""
    dives: dict[tuple[str, str, str, str], list[str]] = {}
    for change in comparison.changes:
        is_word = change.table == CANDIDATES.name and change.column in _CHANGED_WORDS
        if is_word and change.old and change.new and change.old != change.new:
            key = change.column, change.filter, str(change.new), str(change.old)
            dives.setdefault(key, []).append(change.log)
    matched = len(comparison.matched)
    lines = []
    for (column, *names), logs in sorted(
        dives.items(), key=lambda found: list(_CHANGED_WORDS).index(found[0][0])
    ):
        where = (
            f" ({len(logs)} of {matched} dives: {listed(logs, _NAMED_DIVES)})"
            if len(logs) < matched
            else ""
        )
        lines.append(_CHANGED_WORDS[column].format(*names) + where)
    return lines


# --- Tables.

_OLD_AND_NEW: Final[tuple[ShownColumn, ...]] = (
    ("old", "r", "old:cell"),
    ("new", "r", "new:cell"),
    ("change", "r", lambda cell: MISSING if cell.change is None else cell.growth),
    ("", "l", "verdict"),
)


def _evidence_of_dive(changes: Iterable[Change], baseline: str) -> Iterator[DisplayTable]:
    """Return the table of the changed evidence of one dive; for NIS and NEES the distance from 1."""

    def owner(cell: Change) -> str:
        if cell.column == "baseline":
            return baseline
        return cell.filter

    def name(cell: Change) -> str:
        if cell.row in _OFF_ONE:
            return f"{cell.row.upper()} distance from 1"
        return label(cell.row)

    # The rows of every candidate repeat the baseline's values; show them once.
    rows: dict[tuple[str, str], Change] = {}
    for cell in changes:
        if cell.table == "evidence" and cell.column in (
            (RATIO,) if cell.row in _OFF_ONE else ("value", "baseline")
        ):
            rows.setdefault((owner(cell), cell.row), cell)
    if rows:
        named: tuple[ShownColumn, ...] = (
            ("filter", "l", owner),
            ("evidence", "l", name),
            ("", "l", "unit"),
        )
        columns = (*named, *_OLD_AND_NEW[:-1])
        yield table_of("Changed evidence", rows.values(), columns, spare=(2, 3, 4))


def _values(changes: Sequence[Change]) -> DisplayTable:
    footnote = "% is of the magnitude; for NIS, of the ratio to its degrees of freedom"
    return table_of(
        "Values, old and new", changes, (("value", "l", cell_place), *_OLD_AND_NEW), footnote
    )


def _values_over_dives(cells: Sequence[Aggregate]) -> DisplayTable:
    columns: tuple[ShownColumn, ...] = (
        ("value", "l", cell_place),
        *((key, "r", key) for key in ("dives", "better", "worse")),
        ("median\n[%]", "r", "median_change_pct:signed_percent"),
        ("worst\n[%]", "r", "worst_change_pct:signed_percent"),
        (
            "in",
            "l",
            lambda cell: MISSING if cell.worst_word == ChangeVerdict.SAME else cell.worst_log,
        ),
    )
    return table_of("Values over the dives", cells, columns)
