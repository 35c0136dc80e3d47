"""A comparison on a screen, as a page and in files: the answers first, then what else changed."""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import Final, NamedTuple

from insdvl_replay.changes.answer import Answer
from insdvl_replay.changes.cells import Change, change_text, cut_value
from insdvl_replay.changes.comparison import (
    Aggregate,
    Comparison,
    DiveComparison,
    cell_place,
    described,
)
from insdvl_replay.changes.differences import Difference
from insdvl_replay.core.errors import counted, listed, natural_key
from insdvl_replay.core.quantities import WITHOUT_VERDICT, label
from insdvl_replay.core.tables import CANDIDATES, RATIO, PooledRow, WhereRow, finite
from insdvl_replay.core.words import ChangeVerdict, ReasonCode, Verdict
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
from insdvl_replay.evaluation.sentences import (
    grounds,
    interval_text,
    plan_line,
    ratio_text,
    where_line,
    word_of,
)
from insdvl_replay.evaluation.where import notable
from insdvl_replay.show.answers import TONES, verdict_in_table
from insdvl_replay.show.first_screen import (
    OLD_TO_NEW,
    ForestRow,
    by_dive_forest,
    change_of_value,
    evidence_forest,
    first_screen,
    is_where_drawn,
    section,
)

MOST_OTHERS: Final = 12  # most changed values outside the evidence on the brief screen
NEW_AGAINST_OLD: Final = ": new result against old result"  # after the name of a filter
NONE: Final = "none"  # instead of a missing value
_MOST_DIFFERENCES: Final = 8
_MOST_DRAWN: Final = 8  # rows of the forest plot
_MOST_UNFOLDED: Final = 40  # Longer tables are folded on pages.
_NAMED_DIVES: Final = 2
# The sentence for a changed word, by column of the candidates.
_CHANGED_WORDS: Final = {
    "verdict": "{} against the baseline is now {}, was {}",
    "prediction": "the predicted improvement of {} is now {}, was {}",
}
_ADDED_FILTER: Final = re.compile(r"filters\.(.+)\.aiding")
# Rows of the evidence that are better nearer to 1; their ratio is of the distance from 1.
_OFF_ONE: Final = ("nis", "nees")


def comparison_result(comparison: Comparison, document: Sequence[Part]) -> Result:
    """Return a comparison as tables and JSON, with its screen."""
    answer_rows = chain.from_iterable(answer.rows for answer in comparison.answers)
    head = ("log", "old", "new", "matched_by", *ChangeVerdict)
    return Result(
        kind="comparison",
        title=_title(comparison),
        tables={
            "answer": Block.of(PooledRow, answer_rows),
            "where": Block.of(WhereRow, comparison.where),
            "difference": Block.of(Difference, comparison.differences),
            "dive": Block(head, [_dive_cells(dive) for dive in comparison.dives]),
            "aggregate": Block.of(Aggregate, comparison.aggregates),
            "change": Block.of(Change, comparison.changes),
        },
        block="part",
        notes=comparison.notes,
        document=document,
        data=comparison,
    )


def _dive_cells(dive: DiveComparison) -> tuple[str | int | None, ...]:
    """Return a dive, its folders, and its counts by verdict, which a dive without a counterpart has not."""
    counts: list[int | None] = [None] * len(ChangeVerdict)
    if dive.counts is not None:
        counts = [dive.counts[word] for word in ChangeVerdict]
    return (dive.log, dive.old, dive.new, dive.matched_by, *counts)


def comparison_document(
    comparison: Comparison,
    *,
    values: bool = False,  # the changed values instead of the evidence
    every_row: bool = False,  # all rows of the evidence
    command: str = "",  # the one that shows all values, if it is not the one that was typed
) -> list[Part]:
    """Return the screen: the question, its answers, changed verdicts, the evidence or values, and what else changed."""
    parts: list[Part] = [Title(_title(comparison)), _facts(comparison)]
    parts += _answer_screen(comparison)
    changed = _changed_verdicts(comparison)
    if other_logs := other_logs_text(comparison):
        changed.append(other_logs)
    if changed:
        parts.append(Sentences(tuple(changed)))
    if values:
        parts.append(_values_table(comparison))
        parts += _what_else_changed(comparison, every_row=True)
    else:
        # A page has room for what a screen leaves out, and its reader has no command line.
        for formats, is_page in ((PRINTED, False), (PAGE, True)):
            evidence = _evidence_tables(comparison, every_row=every_row or is_page)
            others = _what_else_changed(comparison, every_row=is_page)
            parts.append(Only(formats, (*evidence, *others)))
    alone = tuple(_dives_alone(comparison.dives))
    if alone:
        parts.append(Sentences(alone))
    closing = Sentences(tuple(_closing_lines(comparison, values=values, command=command)))
    parts.append(closing if values else Only(PRINTED, (closing,)))
    return parts


def _has_several(comparison: Comparison) -> bool:
    """Return whether both sides have more than one dive."""
    return len(comparison.matched) > 1


def _values_table(comparison: Comparison) -> DisplayTable:
    """Return all values of one dive, or their sums over several."""
    if _has_several(comparison):
        return _values_over_dives(comparison.aggregates)
    return _values(comparison.changes)


def _evidence_tables(comparison: Comparison, *, every_row: bool) -> Iterator[DisplayTable]:
    """Yield the evidence; of one dive without any the values that moved, if they are few."""
    if _has_several(comparison):
        yield from _answer_table(comparison.answers, every_row=every_row)
        return
    unmoved = (ChangeVerdict.SAME, ChangeVerdict.NEW, ChangeVerdict.GONE)
    moved = [change for change in comparison.changes if change.verdict not in unmoved]
    evidence = list(_evidence_of_dive(moved, comparison.baseline))
    yield from evidence
    if not evidence and 0 < len(moved) <= MOST_OTHERS:
        yield _values(moved)


def _dives_alone(dives: Iterable[DiveComparison]) -> Iterator[str]:
    """Name the dives that only one side has."""
    for dive in dives:
        if dive.new is None:
            yield f"{ChangeVerdict.GONE}: {dive.log}"
        elif dive.old is None:
            yield f"{ChangeVerdict.NEW}: {dive.log}"


def _closing_lines(comparison: Comparison, *, values: bool, command: str) -> Iterator[str]:
    """Say where all values are; below all values their counts by verdict, and the worst and the best of them."""
    if not values:
        table = "... --table NAME" if command else "--table NAME"
        yield f"All values: {command}--all. One table: {table}"
        return
    yield f"{_moved_counts(comparison)}; {_same_count(comparison)}"
    for name, change in (("worst", comparison.worst), ("best", comparison.best)):
        if change is not None:
            yield f"{name}: {described(change)}"
    if _has_several(comparison):
        yield "values of one dive: --dive NAME. Values of all dives: --format csv or --format json"


def _moved_counts(comparison: Comparison) -> str:
    """Count the values that are not the same, by verdict."""
    words = list[str]()
    for word, count in comparison.counts.items():
        if count and word != ChangeVerdict.SAME:
            words.append(f"{count} {word}")
    return ", ".join(words) or "no value changed"


def _same_count(comparison: Comparison) -> str:
    """Count the values that are the same, and say up to what."""
    limit = "the last printed digit"
    if comparison.tolerance_pct is not None:
        limit = f"{comparison.tolerance_pct:g} %"
    same = comparison.counts[ChangeVerdict.SAME]
    return f"{same} of {sum(comparison.counts.values())} values are the same up to {limit}"


# --- The answers.


def answer_lines(answers: Sequence[Answer]) -> list[Callout]:
    """Return a line for each filter: its verdict and the evidence that made it, or could have."""
    name_width = max(len(answer.filter) for answer in answers)
    word_width = max(len(word_of(answer)) for answer in answers)
    lines = list[Callout]()
    for answer in answers:
        name = answer.filter.ljust(name_width)
        word = word_of(answer).ljust(word_width)
        tone = TONES.get(answer.verdict, "")
        lines.append(Callout(f"{name}  {word}  {_said(answer)}", tone))
    return lines


def _said(answer: Answer) -> str:
    """Write the primary quantity of an answer, and on how many dives the filter is no longer evaluated."""
    return "; ".join(text for text in (_grounds(answer), _evaluated(answer)) if text)


def _grounds(answer: Answer) -> str:
    """Write the primary quantity of an answer, or that nothing changed; empty if it is not evaluated."""
    if answer.is_same and answer.verdict not in WITHOUT_VERDICT:
        return answer.sameness
    return grounds(answer)


def _evaluated(answer: Answer) -> str:
    """Say on how many dives a filter is not evaluated, if that decides or is new; else empty."""
    dives = counted(answer.dives, "dive")
    if answer.verdict in WITHOUT_VERDICT:
        return f"evaluated in only {answer.evaluated} of {dives}"
    if answer.lost:
        return f"no longer evaluated in {answer.lost} of {dives}"
    return ""


def _plan(answer: Answer) -> str:
    """Say what these dives can find; empty where they decided, or are one."""
    if answer.undecided in (ReasonCode.NONE, ReasonCode.ONE_DIVE) or answer.is_same:
        return ""
    return plan_line(answer)


def _why_not_evaluated(answer: Answer) -> str:
    """Say why a filter is not evaluated on some dives, or on any; empty if it is on all of them."""
    if answer.lost or answer.verdict in WITHOUT_VERDICT:
        return answer.reason
    return ""


def lines_below(answers: Sequence[Answer]) -> list[str]:
    """Return what these dives can find, and why filters are not evaluated, each once with the filters it is about."""
    filters: dict[str, list[str]] = {}
    for answer in answers:
        if plan := _plan(answer):
            filters.setdefault(plan, []).append(answer.filter)
    for answer in answers:
        if why := _why_not_evaluated(answer):
            filters.setdefault(f"not evaluated: {why}", []).append(answer.filter)
    return [f"{', '.join(names)}: {text}" for text, names in filters.items()]


_ANSWER_COLUMNS: Final[tuple[ShownColumn, ...]] = (
    ("filter", "l", "filter"),
    ("evidence", "l", "quantity:label"),
    ("", "l", "unit"),
    ("old", "r", "baseline:value"),
    ("new", "r", "value:value"),
    ("ratio", "r", lambda row: ratio_text(row.ratio)),
    ("interval", "r", interval_text),
    ("won", "r", lambda row: f"{row.dives_won}/{row.dives}"),
    ("verdict", "l", verdict_in_table),
)


def _answer_table(answers: Sequence[Answer], *, every_row: bool) -> Iterator[DisplayTable]:
    """Return the evidence behind the answers: all rows, or those that decide and those that warn."""
    rows = list[PooledRow]()
    chosen = list[PooledRow | None]()
    for answer in answers:
        rows += answer.known
        if not answer.is_same:
            chosen += [answer.decisive, *answer.warnings]
    kept = [row for row in rows if every_row or row in chosen]
    footnote = (
        "old, new: medians over the dives. ratio: new over old, geometric mean over the dives."
    )
    left = len(rows) - len(kept)
    if left:
        footnote += f" {left} more rows: -v"
    if kept:
        title = "Evidence, new against old"
        table = table_of(title, kept, _ANSWER_COLUMNS, footnote, spare=(7, 2, (3, 4)))
        yield replace(table, folded=len(kept) > _MOST_UNFOLDED)


def _answer_screen(comparison: Comparison) -> list[Part]:
    """Return the answers: a line for each filter, on pages a section with forest plots."""
    answers = comparison.answers
    sections = []
    lines = answer_lines(answers)
    for answer in answers:
        where = [row for row in comparison.where if row.filter == answer.filter]
        line = where_line(notable(where))
        if not is_where_drawn(where, len(answers)):
            where = []
        sections.append(_answer_section(answer, where))
        if line:
            lines.append(Callout(f"{answer.filter}: {line}"))
    caption = ""
    if any(answer.dives > 1 for answer in answers):
        caption = "All dives: each is one sample."
    page = first_screen(sections, caption, compared=("new result", "old one"))
    printed: list[Part] = [Sentences(tuple(lines))]
    below = lines_below(answers)
    if below:
        printed.append(Sentences(tuple(below)))
    return [Only(PRINTED, tuple(printed)), Only(PAGE, (page,))]


def _answer_section(answer: Answer, where: Sequence[WhereRow]) -> str:
    """Return the section of a filter on a page, with its forest plots."""
    said = list[str]()
    for text in (_grounds(answer), _plan(answer), _evaluated(answer)):
        if text:
            said.append(f"{text.removesuffix('.')}.")
    why = _why_not_evaluated(answer)
    if answer.dives == 1:
        plots = [evidence_forest("This dive", answer, _MOST_DRAWN)]
        return section(answer, said, plots, why, NEW_AGAINST_OLD)
    line = where_line(notable(where))
    if line:
        said.insert(1, f"{line}.")
    rows = list[ForestRow]()
    for dive in answer.by_dive:
        if finite(dive.ratio) > 0.0:
            text = change_of_value(dive.old, dive.new, dive.unit)
            rows.append(ForestRow(dive.log, dive.ratio, tone=Verdict.UNDECIDED, text=text))
    plots = [
        evidence_forest("All dives", answer, _MOST_DRAWN, where),
        by_dive_forest(answer.primary, rows, OLD_TO_NEW),
    ]
    return section(answer, said, plots, why, NEW_AGAINST_OLD)


# --- Settings, verdicts and other differences.


def _title(comparison: Comparison) -> str:
    """Ask whether the setting that differs did help; further ones are counted."""
    changes = list(_changed_settings(comparison))
    if not changes:
        return "same settings: did anything change?"
    text = changes[0].text
    others = len(changes) - 1
    if others:
        return f"{text} and {counted(others, 'more setting')}: did they help?"
    return f"{text}: did it help?"


def _facts(comparison: Comparison) -> str:
    """Name the dives, and both sides."""
    matched = comparison.matched
    dives = f"{len(matched)} dives"
    if len(matched) == 1:
        dives = matched[0].log
    return f"{dives}, new: {comparison.new}, old: {comparison.old}"


class _Changed(NamedTuple):
    """What else changed than values, on some dives or all."""

    what: str
    old: str  # empty where a side has none
    new: str
    dives: str  # empty for all

    @property
    def text(self) -> str:
        """It in a line."""
        text = self.what
        if self.old or self.new:
            text = change_text(self.what, self.old or NONE, self.new or NONE)
        if self.dives:
            text += f" (in {self.dives})"
        return text


def _changed_settings(comparison: Comparison) -> Iterator[_Changed]:
    """Yield the settings that differ, each once; of a filter that only one side has its name alone."""
    found = [item for item in comparison.differences if item.block == "config"]
    one_sided = dict[str, str]()  # by filter, the side that has it
    for item in found:
        match = _ADDED_FILTER.fullmatch(item.key)
        if match is not None and item.new is None:
            one_sided[match[1]] = "old"
        elif match is not None and item.old is None:
            one_sided[match[1]] = "new"
    own_keys = tuple(f"filters.{name}." for name in one_sided)
    for item in found:
        if not item.key.startswith(own_keys):
            yield _changed(item, item.key, comparison)
    for name, side in one_sided.items():
        yield _Changed(f"filter {name} only in the {side} results", "", "", "")


def _changed(item: Difference, what: str, comparison: Comparison) -> _Changed:
    """Return a difference, with the number of its dives if it is not in all."""
    return _Changed(what, item.old or "", item.new or "", _dives_of(item.logs, comparison))


def _dives_of(logs: Iterable[str], comparison: Comparison) -> str:
    count = len(set(logs))
    matched = len(comparison.matched)
    if count == matched:
        return ""
    return f"{count} of {matched}"


def _changed_notes(comparison: Comparison) -> Iterator[_Changed]:
    """Yield the notes that came, went or have another count, each once whatever its counts on the dives."""
    groups: dict[tuple[str, bool, bool], list[Difference]] = {}
    for item in comparison.differences:
        if item.block == "notes":
            group = (item.key, item.old is None, item.new is None)
            groups.setdefault(group, []).append(item)
    for (code, _, _), items in groups.items():
        old = _common([item.old for item in items])
        new = _common([item.new for item in items])
        logs = chain.from_iterable(item.logs for item in items)
        yield _Changed(f"note {code}", old, new, _dives_of(logs, comparison))


def _common(texts: Iterable[str | None]) -> str:
    """Return the text that all dives have, empty for none of them, else that they differ."""
    first, *others = dict.fromkeys(texts)
    if others:
        return "differs"
    return first or ""


def _what_else_changed(comparison: Comparison, *, every_row: bool) -> Iterator[Part]:
    """Yield a table of the settings that the title lacks, of other differences and of notes, if there are any."""
    rows = list(_changed_settings(comparison))[1:]
    for item in comparison.differences:
        if item.block not in ("config", "notes") and not _is_of_other_logs(item):
            rows.append(_changed(item, f"{item.block} {item.key}", comparison))
    rows += _changed_notes(comparison)
    shown_rows = rows
    footnote = ""
    if not every_row and len(rows) > _MOST_DIFFERENCES:
        shown_rows = rows[:_MOST_DIFFERENCES]
        footnote = f"{len(rows) - _MOST_DIFFERENCES} more: --all"
    if shown_rows:
        columns = _ELSE_COLUMNS
        if not any(row.dives for row in shown_rows):
            columns = columns[:-1]
        yield table_of("What else changed", shown_rows, columns, footnote)


_ELSE_COLUMNS: Final[tuple[ShownColumn, ...]] = (
    ("", "l", "what"),
    ("old", "l", lambda row: cut_value(row.old or MISSING)),
    ("new", "l", lambda row: cut_value(row.new or MISSING)),
    ("dives", "l", lambda row: row.dives or "all"),
)


def _is_of_other_logs(item: Difference) -> bool:
    """Return whether a difference is that logs of the same name are not the same."""
    return bool((item.block, item.key) == ("log", "sha256") and item.old and item.new)


def other_logs_text(comparison: Comparison) -> str:
    """Say whose logs differ; empty where each dive is the same log on both sides."""
    names = set[str]()
    for item in comparison.differences:
        if _is_of_other_logs(item):
            names.update(item.logs)
    if not names:
        return ""
    whose = "the log differs"
    if len(names) > 1:
        whose = f"the logs of {listed(sorted(names, key=natural_key))} differ"
    return f"{whose} (SHA-256). Changed values may come from the log"


def _changed_verdicts(comparison: Comparison) -> list[str]:
    """Return the changed verdicts, then the changed predictions, each once with its dives."""
    lines = list[str]()
    for column, sentence in _CHANGED_WORDS.items():
        dives: dict[tuple[str, str, str], list[str]] = {}
        for change in comparison.changes:
            is_word = change.table == CANDIDATES.name and change.column == column
            if is_word and change.old and change.new and change.old != change.new:
                key = change.filter, str(change.new), str(change.old)
                dives.setdefault(key, []).append(change.log)
        for names, logs in dives.items():
            lines.append(sentence.format(*names) + _share_of_dives(logs, comparison))
    return lines


def _share_of_dives(logs: Sequence[str], comparison: Comparison) -> str:
    """Name the dives behind a sentence; empty if they are all."""
    matched = len(comparison.matched)
    if len(logs) == matched:
        return ""
    return f" ({len(logs)} of {matched} dives: {listed(logs, _NAMED_DIVES)})"


# --- Tables.


def _growth_text(cell: Change) -> str:
    if cell.change is None:
        return MISSING
    return cell.growth


_OLD_AND_NEW: Final[tuple[ShownColumn, ...]] = (
    ("old", "r", "old"),
    ("new", "r", "new"),
    ("change", "r", _growth_text),
    ("", "l", "verdict"),
)


def _evidence_of_dive(changes: Iterable[Change], baseline: str) -> Iterator[DisplayTable]:
    """Return the table of the changed evidence of one dive; for NIS and NEES the distance from 1."""

    def owner(cell: Change) -> str:
        if cell.column == "baseline":
            return baseline
        return cell.filter

    # The rows of every candidate repeat the baseline's values; show them once.
    rows: dict[tuple[str, str], Change] = {}
    for cell in changes:
        shown = (RATIO,) if cell.row in _OFF_ONE else ("value", "baseline")
        if cell.table == "evidence" and cell.column in shown:
            rows.setdefault((owner(cell), cell.row), cell)
    if rows:
        columns: tuple[ShownColumn, ...] = (
            ("filter", "l", owner),
            ("evidence", "l", _evidence_name),
            ("", "l", "unit"),
            *_OLD_AND_NEW[:-1],
        )
        yield table_of("Changed evidence", rows.values(), columns, spare=(2, 3, 4))


def _evidence_name(cell: Change) -> str:
    if cell.row in _OFF_ONE:
        return f"{cell.row.upper()} distance from 1"
    return label(cell.row)


def _values(changes: Sequence[Change]) -> DisplayTable:
    footnote = "% is of the magnitude; for NIS, of the ratio to its degrees of freedom"
    columns = (("value", "l", cell_place), *_OLD_AND_NEW)
    return replace(table_of("Values, old and new", changes, columns, footnote), whole=True)


def _worst_dive(cell: Aggregate) -> str:
    if cell.worst_word == ChangeVerdict.SAME:
        return MISSING
    return cell.worst_log


def _values_over_dives(cells: Sequence[Aggregate]) -> DisplayTable:
    columns: tuple[ShownColumn, ...] = (
        ("value", "l", cell_place),
        ("dives", "r", "dives"),
        ("better", "r", "better"),
        ("worse", "r", "worse"),
        ("median\n[%]", "r", "median_change_pct:signed_percent"),
        ("worst\n[%]", "r", "worst_change_pct:signed_percent"),
        ("in", "l", _worst_dive),
    )
    return replace(table_of("Values over the dives", cells, columns), whole=True)
