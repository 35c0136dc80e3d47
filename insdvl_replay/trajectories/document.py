"""A comparison of trajectories on a screen, as a page, as tables and as JSON."""

import math
from collections.abc import Iterator, Sequence
from itertools import chain
from typing import Any, Final

from insdvl_replay.core.errors import counted
from insdvl_replay.core.quantities import WITHOUT_VERDICT
from insdvl_replay.core.tables import CredibilityRow, EvidenceRow, PooledRow, finite
from insdvl_replay.core.words import Verdict
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
from insdvl_replay.document.tables import (
    MISSING,
    ShownColumn,
    header_and_rows,
    significant,
    table_of,
)
from insdvl_replay.evaluation.answers import largest_acts
from insdvl_replay.evaluation.sentences import (
    acts_line,
    begun_with_capital,
    headline,
    plan_line,
    word_of,
)
from insdvl_replay.evaluation.track_alignment import Align
from insdvl_replay.show.answers import TONES
from insdvl_replay.show.first_screen import (
    ForestRow,
    by_dive_forest,
    evidence_forest,
    first_screen,
    section,
)
from insdvl_replay.show.screens import evidence_tables
from insdvl_replay.trajectories.comparison import (
    TrajectoryAnswer,
    TrajectoryComparison,
    TrajectoryDive,
    TrajectoryErrorRow,
)

VALUES_ARE: Final = "values: medians over the dives. ratio: geometric mean over the dives"
_ALIGNED: Final = {
    Align.NONE: "not aligned",
    Align.YAW: "aligned by shift and heading",
    Align.SE3: "aligned by shift and rotation",
    Align.SIM3: "aligned by shift, rotation and scale",
}
_MOST_DRAWN: Final = 8
_MOST_DIVES: Final = 12  # with more, the dives are in the tables alone
_SHOWN_ERRORS: Final = ("ape_translation", "ape_angle", "rpe_translation", "rpe_angle")


def trajectories_result(comparison: TrajectoryComparison, *, every_row: bool = False) -> Result:
    """Return a comparison of trajectories as tables and JSON, with its screen."""
    answer_rows = chain.from_iterable(answer.rows for answer in comparison.answers)
    return Result(
        kind="trajectories",
        title=_title(comparison),
        tables={
            "answer": Block.of(PooledRow, answer_rows),
            "dive": Block.of(TrajectoryDive, comparison.dives),
            "evidence": Block.of(EvidenceRow, comparison.evidence),
            "trajectory_errors": Block.of(TrajectoryErrorRow, comparison.trajectory_errors),
            "credibility": Block.of(CredibilityRow, comparison.credibility),
        },
        block="part",
        notes=comparison.notes,
        document=trajectories_document(comparison, every_row=every_row),
        data=comparison,
    )


def _title(comparison: TrajectoryComparison) -> str:
    """Count the dives, and name the reference and the alignment."""
    dives = counted(len({dive.log for dive in comparison.dives}), "dive")
    aligned = _ALIGNED[Align(comparison.align)]
    return f"{dives}, reference: {comparison.reference}, {aligned}"


def trajectories_document(
    comparison: TrajectoryComparison, *, every_row: bool = False
) -> list[Part]:
    """Return the screen: verdicts, evidence, the dives one by one, pose errors."""
    answers = comparison.answers
    parts: list[Part] = [Title(_title(comparison))]
    parts.append(Only(PRINTED, tuple(_verdicts(answers))))
    sections = [_section(answer, comparison) for answer in answers]
    caption = "All dives: each is one sample. Dive by dive: one dive has no interval."
    parts.append(Only(PAGE, (first_screen(sections, caption, compared=("new track", "old one")),)))
    title = "all dives"
    if all(answer.dives == 1 for answer in answers):
        title = "this dive"
    most = _every_quantity(answers) if every_row else 0
    parts += evidence_tables(answers, title, VALUES_ARE, most=most)
    parts += _dives_table(comparison, every_row=every_row)
    parts += _pose_errors_table(comparison)
    return parts


def _every_quantity(answers: Sequence[TrajectoryAnswer]) -> int:
    return max((len(answer.rows) for answer in answers), default=0)


def said_of(answer: TrajectoryAnswer) -> str:
    """Return the headline; of equal tracks it says no more."""
    if answer.verdict == Verdict.NO_EFFECT and largest_acts(answer.rows) == 0.0:
        return f"{word_of(answer)}, the trajectories are identical"
    return headline(answer)


def quiet_lines(comparison: TrajectoryComparison) -> list[str]:
    """Return one line for each NEW."""
    lines = list[str]()
    for answer in comparison.answers:
        line = f"{answer.filter} {said_of(answer)}"
        if answer.verdict in WITHOUT_VERDICT:
            line += f": {answer.reason}"
        lines.append(line)
    return lines


def _verdicts(answers: Sequence[TrajectoryAnswer]) -> Iterator[Part]:
    """Yield the verdict on each NEW, how far it acts, and what the dives can find."""
    for answer in answers:
        said = f"{answer.filter} against {answer.baseline}: {said_of(answer)}"
        tone = TONES.get(answer.verdict, "")
        yield Sentences((Callout(said, tone), *_lines_below(answer)))


def _lines_below(answer: TrajectoryAnswer) -> list[str]:
    if answer.verdict in WITHOUT_VERDICT:
        return [f"{begun_with_capital(answer.reason, answer)}. Settle this first."]
    lines = [plan_line(answer)]
    if answer.verdict != Verdict.NO_EFFECT:
        lines.insert(0, acts_line(answer))
    return [line for line in lines if line]


def _section(answer: TrajectoryAnswer, comparison: TrajectoryComparison) -> str:
    """Return the section of a NEW on a page, with its forest plots."""
    said = [said_of(answer).removeprefix(f"{word_of(answer)}, "), *_lines_below(answer)]
    if answer.dives == 1:
        return section(answer, said, [evidence_forest("This dive", answer, _MOST_DRAWN)])
    rows = list[ForestRow]()
    for dive in comparison.dives:
        if dive.filter != answer.filter:
            continue
        ratio = finite(dive.ratio)
        text = dive.reason or f"{ratio:.3g}"
        shown = None if math.isnan(ratio) else ratio
        rows.append(ForestRow(dive.log, shown, tone=Verdict.UNDECIDED, text=text))
    plots = [
        evidence_forest("All dives", answer, _MOST_DRAWN),
        by_dive_forest(answer.primary, rows),
    ]
    return section(answer, said, plots)


def _ratio_cell(row: TrajectoryDive) -> str:
    if row.ratio is None:
        return MISSING
    return f"{row.ratio:.3g}"


_DIVE_COLUMNS: Final[tuple[ShownColumn, ...]] = (
    ("dive", "l", "log"),
    ("filter", "l", "filter"),
    ("ratio", "r", _ratio_cell),
    ("times", "r", "times"),
    ("", "l", "reason"),
)


def _dives_table(comparison: TrajectoryComparison, *, every_row: bool) -> Iterator[DisplayTable]:
    """Yield the dives one by one, if they are few."""
    dives = comparison.dives
    if len(dives) < 2 or (len(dives) > _MOST_DIVES and not every_row):
        return
    primaries = {answer.primary for answer in comparison.answers}
    footnote = "ratio: of the quantity that decides. times: at which both are compared"
    if primaries == {""}:
        footnote = "times: at which both are compared"
    yield table_of("Dive by dive", dives, _DIVE_COLUMNS, footnote, spare=(3, 1))


def _pose_errors_table(comparison: TrajectoryComparison) -> Iterator[DisplayTable]:
    """Yield the pose errors of each filter: the mean over runs and dives of rmse, median and the largest error."""
    names = (comparison.baseline, *(answer.filter for answer in comparison.answers))
    rows = list[tuple[str, ...]]()
    for name in names:
        own = [row for row in comparison.trajectory_errors if row.filter == name]
        keys = dict.fromkeys((row.quantity, row.delta, row.unit) for row in own)
        for quantity, delta, unit in keys:
            if quantity not in _SHOWN_ERRORS:
                continue
            same = [row for row in own if (row.quantity, row.delta) == (quantity, delta)]
            shown = quantity.replace("ape_", "APE ").replace("rpe_", "RPE ")
            rmse = sum(finite(row.rmse) for row in same) / len(same)
            median = sum(finite(row.median) for row in same) / len(same)
            most = max(finite(row.max) for row in same)
            cells = (significant(rmse, 4), significant(median, 4), significant(most, 4))
            rows.append((name, f"{shown} {delta}".strip(), unit, *cells, str(len(same))))
    if rows:
        header = ("filter", "as in evo", "", "rmse", "median", "largest", "runs")
        footnote = "rmse, median: means over the runs. All numbers: --table trajectory_errors"
        yield DisplayTable(
            "Pose errors", header, "lllrrrr", tuple(rows), footnote, spare=(5, 4, 6)
        )


def named_tables(comparison: TrajectoryComparison, names: Sequence[str]) -> Result:
    """Return named tables alone."""
    whole = trajectories_result(comparison)
    kept = {name: whole.tables[name] for name in names}
    block = "table" if len(kept) > 1 else ""
    display = [_as_table(name, table) for name, table in kept.items()]
    return Result(
        kind=whole.kind,
        title=whole.title,
        tables=kept,
        notes=whole.notes,
        block=block,
        display=display,
    )


def _as_table(name: str, table: Any) -> DisplayTable:
    """Return all columns of a table."""
    header, rows = header_and_rows(table)
    cells = list[tuple[str, ...]]()
    for row in rows:
        cells.append(tuple(_cell(value) for value in row))
    return DisplayTable(name, tuple(header), "l" * len(header), tuple(cells))


def _cell(value: object) -> str:
    if isinstance(value, float):
        return significant(value, 4)
    if value is None:
        return MISSING
    return str(value)


TABLES: Final = ("answer", "dive", "evidence", "trajectory_errors", "credibility")
