"""A comparison of trajectories on a screen, as a page, as tables and as JSON."""

import math
from collections.abc import Iterator, Sequence
from itertools import chain
from typing import Any, Final

from insdvl_replay.core.errors import counted
from insdvl_replay.core.quantities import WITHOUT_VERDICT, label
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
    header_and_rows,
    significant,
)
from insdvl_replay.evaluation.answers import largest_acts
from insdvl_replay.evaluation.interval import BAND
from insdvl_replay.evaluation.sentences import (
    acts_line,
    begun_with_capital,
    headline,
    plan_line,
    ratio_text,
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
_SHOWN_ERRORS: Final = {
    "ape_translation": "APE translation",
    "ape_angle": "APE angle",
    "rpe_translation": "RPE translation",
    "rpe_angle": "RPE angle",
}


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
    caption = "All dives: each is one sample. Dive by dive: a single dive has no interval."
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
        return f"{word_of(answer)}, equal wherever both are known"
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
    lines = list[str]()
    if answer.verdict != Verdict.NO_EFFECT:
        lines.append(acts_line(answer))
    factor = answer.run_factor
    if factor is not None:
        name = label(answer.primary)
        said = f"repeated runs: 95 % of their ratios of {name} are within a factor {factor:.3g}"
        lines.append(f"{said}, and no interval is narrower")
    if factor is None or factor < BAND:
        lines.append(plan_line(answer))
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


def _dives_table(comparison: TrajectoryComparison, *, every_row: bool) -> Iterator[Part]:
    """Yield the ratio of each dive in the quantity that decides, if the dives are few."""
    answers = comparison.answers
    by_dive: dict[str, dict[str, TrajectoryDive]] = {}
    for dive in comparison.dives:
        by_dive.setdefault(dive.log, {})[dive.filter] = dive
    primaries = {answer.primary for answer in answers if answer.primary}
    is_short = every_row or len(by_dive) <= _MOST_DIVES
    if len(by_dive) < 2 or not is_short or not primaries:
        return
    names = [answer.filter for answer in answers]
    rows = list[tuple[str, ...]]()
    for log, found in by_dive.items():
        cells = [log]
        for name in names:
            cells.append(_ratio_cell(found.get(name)))
        times = max(each.times for each in found.values())
        rows.append((*cells, str(times)))
    decides = " or ".join(label(primary) for primary in primaries)
    header = (f"{decides}: ratio", *names, "times")
    yield Sentences(())
    yield DisplayTable("", header, f"l{'r' * len(names)}r", tuple(rows), spare=(len(names) + 1,))


def _ratio_cell(dive: TrajectoryDive | None) -> str:
    """Write the ratio of a dive, or why there is none."""
    if dive is None:
        return MISSING
    if dive.ratio is None:
        return dive.reason or MISSING
    return ratio_text(dive.ratio)


def _pose_errors_table(comparison: TrajectoryComparison) -> Iterator[Part]:
    """Yield the pose errors of all filters: the mean over dives and runs of their root mean squares."""
    names = (comparison.baseline, *(answer.filter for answer in comparison.answers))
    values: dict[tuple[str, str, str], dict[str, list[float]]] = {}
    for row in comparison.trajectory_errors:
        if row.quantity in _SHOWN_ERRORS:
            key = (_SHOWN_ERRORS[row.quantity], row.delta, row.unit)
            values.setdefault(key, {}).setdefault(row.filter, []).append(finite(row.rmse))
    rows = list[tuple[str, ...]]()
    for (quantity, delta, unit), by_filter in values.items():
        cells = [f"{quantity} {delta}".rstrip(), unit]
        for name in names:
            own = by_filter.get(name, [math.nan])
            cells.append(significant(sum(own) / len(own), 4))
        rows.append(tuple(cells))
    if rows:
        header = ("pose errors, rmse", "", *names)
        alignment = f"ll{'r' * len(names)}"
        footnote = "These are the numbers of evo, as means over the dives. All numbers: --table trajectory_errors"
        yield Sentences(())
        yield DisplayTable("", header, alignment, tuple(rows), footnote)


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
