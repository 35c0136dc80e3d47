"""What a terminal shows of one replay: the word on each candidate, the evidence for it, and where the rest is.

One dive, of up to two candidates, fits 24 lines of 80 columns; of more candidates each has a row.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Final

from insdvl_replay.core.quantities import DECIDING, DECIDING_TOGETHER, HONESTY, WITHHELD_QUANTITIES, is_beam, label
from insdvl_replay.core.table import Number, finite
from insdvl_replay.core.tables import Candidate, ConsistencyRow, EvidenceRow
from insdvl_replay.core.words import Belief, Consistency, EvidenceWord, Judgement
from insdvl_replay.evaluation.consistency import is_noise_far_off
from insdvl_replay.evaluation.verdicts import spoken_of, trust_sentence
from insdvl_replay.report.document import (
    MISSING,
    TENFOLD,
    Callout,
    Code,
    Column,
    DisplayTable,
    Part,
    Sentences,
    Title,
    counted,
    decimal,
    percent,
    table_of,
)
from insdvl_replay.results.dive_tables import (
    NO_REFERENCE,
    TONES,
    has_reference,
    headline_table,
    track_fit_line,
    word_in_table,
)
from insdvl_replay.results.json_report import Report

LOUD: Final = (Judgement.BETTER, Judgement.WORSE, Judgement.MIXED, Judgement.NOT_JUDGED)
MOST_ROWS: Final = {1: 7, 2: 1}
"""Pieces of evidence that are shown of each candidate, by how many there are."""
_CHOSEN: Final = ("velocity_along", "convergence_level", "nis")
"""Pieces that are shown beside the first of each kind, and those that decided."""


def dive_screen(report: Report, page: str) -> list[Part]:
    """Lay out the screen of one dive.

    Parameters
    ----------
    page : str
        Where the page of the dive lies, which is named last.
    """
    few = len(report.filters) in MOST_ROWS
    words = [part for name in report.filters for part in _of_candidate(report, name)] if few else _many(report)
    return [
        Title(facts(report)),
        *headline_table(report),
        *words,
        *track_fit_line(report),
        *(() if has_reference(report) else (NO_REFERENCE,)),
        Code(f"all tables{_and_notes(report)}: -v   page: {page}", ""),
    ]


def _and_notes(report: Report) -> str:
    return f", {counted(len(report.notes), 'note')}" if report.notes else ""


def facts(report: Report) -> str:
    """State in one line what was replayed."""
    starts = max((row.starts for row in report.tables.evidence), default=0)
    # A solution that was read may speak of a part of the dive, or of nothing: of the baseline all is compared.
    of_baseline = [row.samples for row in report.tables.drift if row.filter == report.baseline]
    compared = max([row.samples for row in report.tables.reference_error] + of_baseline, default=0)
    said = [
        f"{report.log.duration_s:.0f} s",
        _readings_of_dvl(report.tables.consistency),
        f"reference {compared / report.log.duration_s:.2g} Hz" if has_reference(report) else "no reference",
        *([counted(starts, "start")] if starts and has_reference(report) else []),
    ]
    return f"{report.log.name}: {', '.join(said)}"


def _readings_of_dvl(rows: Sequence[ConsistencyRow]) -> str:
    """Count what the first filter met that takes velocities, or beams where none does."""
    velocity = next((row for row in rows if row.measurement == "velocity"), None)
    if velocity is not None:
        return f"{velocity.used + velocity.rejected} velocities, {velocity.rejected} rejected"
    of_beams = [row for row in rows if is_beam(row.measurement)]
    of_one = [row for row in of_beams if row.filter == of_beams[0].filter]
    rejected = sum(row.rejected for row in of_one)
    return f"{sum(row.used for row in of_one) + rejected} beams, {rejected} rejected" if of_one else "no velocities"


def shouted(judgement: str) -> str:
    """Write a judgement that nobody may overlook in capitals."""
    return judgement.upper() if judgement in LOUD else judgement


def ratio_text(value: Number) -> str:
    """Write a ratio with two decimals, a large one with three digits."""
    return decimal(value, 2) if abs(finite(value)) < TENFOLD else MISSING if value is None else f"{value:.3g}"


def interval_text(low: Number, high: Number) -> str:
    """Write where a ratio lies."""
    return MISSING if low is None or high is None else f"{ratio_text(low)} .. {ratio_text(high)}"


def value_text(value: Number) -> str:
    """Write a value with three significant digits."""
    return MISSING if value is None else f"{value:.3g}"


def _of_candidate(report: Report, name: str) -> Iterator[Part]:
    candidate = report.filters[name]
    if candidate.improvement == Judgement.NOT_JUDGED:
        yield Sentences((_word_on(report, name), candidate.verdict))
        return
    yield Sentences((_word_on(report, name), _believed(candidate)))
    of_candidate = [row for row in report.tables.evidence if row.filter == name]
    rows = _chosen([row for row in of_candidate if row.evidence != HONESTY], MOST_ROWS[len(report.filters)])
    if rows:
        yield _evidence(report.baseline, name, rows)
    yield f"{trust_sentence(report.tables, name, report.baseline)}{_sizes(report, of_candidate)}"


def _sizes(report: Report, rows: Sequence[EvidenceRow]) -> str:
    """State how large the innovations are beside what is expected of them, behind the sentence on trust."""
    nis = next((row for row in rows if row.quantity == "nis"), None)
    if nis is None:
        return ""
    sizes = (
        f" {label(nis.quantity)}: {report.baseline} {value_text(nis.baseline)}, {nis.filter} {value_text(nis.value)}"
    )
    return f"{sizes}{': --control fits the noise.' if is_noise_far_off(report.tables, report.baseline) else '.'}"


def _word_on(report: Report, name: str) -> Callout:
    judgement = report.filters[name].improvement
    return Callout(f"{name} against {report.baseline}: {shouted(judgement)}", TONES.get(judgement, ""))


def _believed(candidate: Candidate) -> str:
    """State what a candidate believes to gain, and what has become of that."""
    if candidate.mean_improvement_pct is None and candidate.consistency == Consistency.NOT_TOLD:
        return "it was read, not run: what it believes is told of some states, or of none"
    smaller, sooner = candidate.mean_improvement_pct, candidate.mean_convergence_improvement_pct
    word = candidate.belief or Belief.UNDECIDED
    unchanged = candidate.mean_convergence_unchanged_pct
    zero = "" if unchanged is None or not math.isfinite(unchanged) else f" ({percent(unchanged)} without any change)"
    errors, convergence = _gained(smaller, "smaller", "larger"), _gained(sooner, "faster", "slower")
    return f"it believes in {errors} errors, {convergence} convergence{zero}: {word}"


def _gained(change: float | None, gain: str, loss: str) -> str:
    """Say a change in percent by the word that makes it a positive number."""
    if change is not None and change < 0.0:
        return f"{percent(-change)} {loss}"
    return f"{percent(change)} {gain}"


def _chosen(rows: Sequence[EvidenceRow], most: int) -> list[EvidenceRow]:
    """Choose pieces of evidence: what decided, the first of each kind and what was withheld, and what has room."""
    known = [row for row in rows if row.baseline is not None or row.value is not None]
    decided = (EvidenceWord.BETTER, EvidenceWord.WORSE)
    first = {row.evidence: row.quantity for row in reversed(known)}

    def importance(row: EvidenceRow) -> tuple[bool, bool, bool, bool]:
        return (
            not (row.quantity in DECIDING and row.word in decided),
            row.quantity not in (first[row.evidence], *WITHHELD_QUANTITIES),
            row.quantity not in _CHOSEN,
            row.quantity not in DECIDING_TOGETHER,
        )

    shown = {row.quantity for row in sorted(known, key=importance)[:most]}
    return [row for row in known if row.quantity in shown]


def _evidence(baseline: str, name: str, rows: Sequence[EvidenceRow]) -> DisplayTable:
    columns: list[Column[EvidenceRow]] = [
        ("evidence", "l", lambda row: label(row.quantity)),
        ("", "l", lambda row: row.unit),
        (baseline, "r", lambda row: value_text(row.baseline)),
        (name, "r", lambda row: value_text(row.value)),
        ("ratio", "r", lambda row: ratio_text(row.ratio)),
        ("on this dive", "r", lambda row: MISSING if row.ratio is None else interval_text(row.low, row.high)),
        ("n", "r", lambda row: decimal(row.effective_samples, 0)),
        ("p", "r", lambda row: decimal(row.p, 3).removeprefix("0")),
        ("", "l", word_in_table),
    ]
    return table_of("", rows, columns, spare=(6, 2, 3, 1, 5, 7))


def _many(report: Report) -> list[Part]:
    """Lay out many candidates, a row each: the piece of evidence that decided, or could have."""
    columns: list[Column[tuple[str, Candidate, EvidenceRow | None]]] = [
        ("filter", "l", lambda one: one[0]),
        (f"against {report.baseline}", "l", lambda one: shouted(one[1].improvement)),
        ("by", "l", lambda one: MISSING if one[2] is None else label(one[2].quantity)),
        ("ratio", "r", lambda one: MISSING if one[2] is None else ratio_text(one[2].ratio)),
        ("on this dive", "r", lambda one: MISSING if one[2] is None else interval_text(one[2].low, one[2].high)),
        ("believed", "r", lambda one: percent(_believed_pct(one[1]))),
        ("", "l", lambda one: "" if one[1].improvement == Judgement.NOT_JUDGED else one[1].belief),
    ]
    rows = [(name, candidate, _speaking(report, name)) for name, candidate in report.filters.items()]
    return [Sentences(()), table_of("", rows, columns, spare=(4, 5, 6, 2))]


def _believed_pct(candidate: Candidate) -> Number:
    return None if candidate.improvement == Judgement.NOT_JUDGED else candidate.mean_improvement_pct


def _speaking(report: Report, name: str) -> EvidenceRow | None:
    judgement = Judgement(report.filters[name].improvement)
    rows = [row for row in report.tables.evidence if row.filter == name]
    return None if judgement == Judgement.NOT_JUDGED else next(iter(spoken_of(judgement, rows)), None)
