"""The words of an answer: its verdict, the evidence that decided, and whether its prediction is confirmed."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, TypeVar

from msgspec.structs import replace

from insdvl_replay.core.quantities import (
    CONSISTENCY,
    DECIDING,
    DECIDING_TOGETHER,
    HELD_OUT_QUANTITIES,
    OUTAGE_WINDOWS_S,
    label,
)
from insdvl_replay.core.result import Report
from insdvl_replay.core.tables import CandidateVerdict, EvidenceRow, Number, PooledRow, finite
from insdvl_replay.core.words import Consistency, EvidenceVerdict, Prediction, ReferenceStatus, Verdict
from insdvl_replay.evaluation.answers import (
    DECIDED,
    NOTABLE_PCT,
    Answer,
    CandidateAnswer,
    P,
    Piece,
    may_decide,
    on_prediction,
    pooled_candidate,
    reason_in_words,
    shown_interval,
    would_settle,
)
from insdvl_replay.evaluation.outage_test import SHORTEST_S
from insdvl_replay.evaluation.verdicts import reason_not_evaluated
from insdvl_replay.show.document import MISSING, TENFOLD, decimal, percent, significant

AnyAnswer = Answer[EvidenceRow] | Answer[PooledRow]
AnyCandidate = CandidateAnswer[EvidenceRow] | CandidateAnswer[PooledRow]
LEAST_SHOWN_PCT: Final = 1.0  # of the convergence that a filter without any change gains
# By verdict: its colour.
TONES: Final[dict[str, str]] = {
    Verdict.BETTER: "good",
    Verdict.MIXED: "bad",
    Verdict.WORSE: "bad",
    Verdict.NOT_EVALUATED: "bad",
}


@dataclass(frozen=True)
class Failure:
    """A log that could not be replayed, and why, in one sentence."""

    log: str
    reason: str


Outcome = Report | Failure


def reports_of(outcomes: Sequence[Outcome]) -> list[Report]:
    """Return the dives that were replayed."""
    return [outcome for outcome in outcomes if isinstance(outcome, Report)]


class _FilterRow(Protocol):
    @property
    def filter(self) -> str: ...


Row = TypeVar("Row", bound=_FilterRow)


def of_filter(name: str, rows: Iterable[Row]) -> list[Row]:
    """Return the rows of a filter."""
    return [row for row in rows if row.filter == name]


def has_reference(report: Report) -> bool:
    """Return whether the dive has a reference; early reports lack one of the two tables that show it."""
    found = [row.verdict for row in report.tables.credibility] + [row.status for row in report.tables.reference_error]
    return any(word != ReferenceStatus.NO_REFERENCE for word in found)


# --- A row of evidence.


def ratio_text(value: Number) -> str:
    """Write a ratio with two decimals, a large one with three digits."""
    return decimal(value, 2) if abs(finite(value)) < TENFOLD else significant(value, 3)


def interval_text(row: Piece) -> str:
    """Write the interval of a row, where it is shown."""
    ends = shown_interval(row)
    return MISSING if ends is None else " .. ".join(map(ratio_text, ends))


def verdict_in_table(row: Piece) -> str:
    """Return the verdict of an evidence row, in brackets if it has no vote."""
    return row.verdict if may_decide(row) or not row.verdict else f"({row.verdict})"


def verdict_with_reason(row: Piece) -> str:
    """Write the verdict of a row, and why it is undecided."""
    why = reason_in_words(row) if row.verdict == EvidenceVerdict.UNDECIDED else ""
    text = f"{row.verdict}: {why}" if why else row.verdict
    return text if may_decide(row) or not text else f"({text})"


def as_shown(row: P) -> P:
    """Return an evidence row as tables show it: its interval if it is shown, verdict and reason in words."""
    low, high = shown_interval(row) or (None, None)
    why = {} if isinstance(row, PooledRow) else {"why": reason_in_words(row)}
    return replace(row, low=low, high=high, verdict=verdict_in_table(row), **why)


# Evidence rows that are shown as well as those that decided and the first of each kind.
_CHOSEN: Final = ("velocity_along", "convergence_level", "nis")


def chosen_rows(rows: Sequence[P], most: int) -> list[P]:
    """Choose evidence rows: those that decided, the first of each kind, held-out sensors, then others."""
    known = [row for row in rows if row.baseline is not None or row.value is not None]
    first = {row.evidence: row.quantity for row in reversed(known)}

    def importance(row: P) -> tuple[bool, bool, bool, bool]:
        return (
            not (row.quantity in DECIDING and row.verdict in DECIDED),
            row.quantity not in (first[row.evidence], *HELD_OUT_QUANTITIES),
            row.quantity not in _CHOSEN,
            row.quantity not in DECIDING_TOGETHER,
        )

    quantities = list(dict.fromkeys(row.quantity for row in sorted(known, key=importance)))[:most]
    return [row for row in known if row.quantity in quantities]


# --- An answer.


def shouted(verdict: str) -> str:
    """Write an important verdict in capitals."""
    return verdict.upper() if verdict in TONES else verdict


def spoken_rows(answer: AnyAnswer) -> list[Piece]:
    """Return the row that decided, or could have; two rows if the verdict is mixed."""
    if answer.verdict == Verdict.NOT_EVALUATED:
        return []
    return [*answer.spoken][: 2 if answer.verdict == Verdict.MIXED else 1]


def evidence_cells(answer: AnyAnswer) -> tuple[str, str, str]:
    """Write the row that decided, its ratio and its interval, for a table."""
    for row in spoken_rows(answer)[:1]:
        return label(row.quantity), ratio_text(row.ratio), interval_text(row)
    return MISSING, MISSING, MISSING


def evidence_text(answer: AnyAnswer) -> str:
    """Write what decided with ratio and interval, such as ``drift in 30 s 0.74 (0.69 .. 0.78)``."""
    texts = []
    for row in spoken_rows(answer):
        interval, word = interval_text(row), f" {row.verdict}" if answer.verdict == Verdict.MIXED else ""
        interval = "" if interval == MISSING else f" ({interval})"
        texts.append(f"{label(row.quantity)} {ratio_text(row.ratio)}{interval}{word}")
    why = f": {answer.reason}" if answer.reason else ""
    return "; ".join(texts) or f"no evidence{why}"


def reason_undecided(answer: AnyAnswer) -> str:
    """Say why an answer is undecided, if the interval does not show it."""
    is_undecided = answer.verdict == Verdict.UNDECIDED
    return next((why for row in spoken_rows(answer) if is_undecided and (why := reason_in_words(row))), "")


def would_decide(answer: AnyAnswer) -> str:
    """Say why an answer is undecided, and how many dives would decide; empty if it is decided."""
    return "; ".join(filter(None, (reason_undecided(answer), would_settle(answer.verdict, answer.known))))


def prediction_word(predicted_pct: Number, prediction: str) -> str:
    """Say in a word whether a predicted improvement is confirmed; empty if it is too small to be checked."""
    if not finite(predicted_pct) >= NOTABLE_PCT:
        return ""
    return Prediction.CONFIRMED if prediction == Prediction.CONFIRMED else Prediction.NOT_CONFIRMED


def predicted_change(answer: AnyCandidate) -> tuple[str, str]:
    """Write the predicted change of sigma, such as ``12.3 % smaller``, and whether it is confirmed."""
    pct = finite(answer.predicted_pct)
    if math.isnan(pct):
        return MISSING, ""
    return f"{percent(abs(pct))} {'larger' if pct < 0.0 else 'smaller'}", prediction_word(pct, answer.prediction)


def _predicted(candidate: CandidateVerdict, evidence: Sequence[EvidenceRow], *, known: bool) -> str:
    """State the predicted improvement of a candidate on one dive, and whether it is confirmed."""
    predicted_pct = candidate.mean_improvement_pct
    if predicted_pct is None and candidate.consistency == Consistency.NOT_AVAILABLE:
        return "predicted: unknown. The candidate reports the sigma of only some states, or of none."

    def gained(change: float | None, gain: str, loss: str) -> str:
        return f"{percent(-change)} {loss}" if change is not None and change < 0.0 else f"{percent(change)} {gain}"

    sigma = gained(predicted_pct, "smaller", "larger")
    convergence = gained(candidate.mean_convergence_improvement_pct, "faster", "slower")
    # The baseline's time is the end, so it gains some convergence on itself.
    unchanged_pct = finite(candidate.mean_convergence_unchanged_pct)
    unchanged = f" (unchanged filter: {percent(unchanged_pct)})" if unchanged_pct >= LEAST_SHOWN_PCT else ""
    found = ""
    if finite(predicted_pct) >= NOTABLE_PCT:
        found = f" {on_prediction(candidate.prediction or Prediction.UNDECIDED, evidence, has_reference=known)}."
    return f"predicted: {sigma} sigma, {convergence} convergence{unchanged}.{found}"


# --- The answers of reports.


def lacking_evidence(report: Report) -> str:
    """Say what a dive lacks for evidence, and how much."""
    lacking = []
    if not has_reference(report):
        lacking.append("no reference")
    elif not any(row.status == ReferenceStatus.COMPARED for row in report.tables.reference_error):
        lacking.append("the reference covers too little")
    duration_s = report.log.duration_s
    if duration_s < SHORTEST_S:
        lacking.append(f"too short for the outage test (needs {SHORTEST_S} s, has {duration_s:.0f} s)")
    elif not report.tables.outage:
        lacking.append(f"no {OUTAGE_WINDOWS_S[0]} s in which the DVL has no gap, for the outage test")
    return ", and ".join(lacking) or "too few effective samples"


def answer_on_dive(report: Report, name: str) -> CandidateAnswer[EvidenceRow]:
    """Return the answer for a candidate on one dive."""
    candidate, evidence = report.filters[name], of_filter(name, report.tables.evidence)
    rows = tuple(row for row in evidence if row.evidence != CONSISTENCY)
    has_evidence = any(math.isfinite(finite(row.ratio)) for row in rows)
    reason = "" if has_evidence else lacking_evidence(report)
    return CandidateAnswer(
        filter=name,
        baseline=report.baseline,
        verdict=Verdict(candidate.verdict),
        dives=1,
        evaluated=1,
        rows=rows,
        log=report.log.name,
        reason=reason_not_evaluated(candidate.sentence) or reason,
        predicted_pct=candidate.mean_improvement_pct,
        prediction=candidate.prediction,
        predicted=_predicted(candidate, evidence, known=has_reference(report)),
    )


def pooled_answers(reports: Sequence[Report]) -> list[CandidateAnswer[PooledRow]]:
    """Pool the evidence on each candidate that at least two dives have."""
    found = []
    for name in candidate_names(reports):
        having = [report for report in reports if name in report.filters]
        evaluated = [report for report in having if report.filters[name].verdict != Verdict.NOT_EVALUATED]
        if len(having) > 1:
            rows = [of_filter(name, report.tables.evidence) for report in evaluated]
            predicted_pct = [report.filters[name].mean_improvement_pct for report in evaluated]
            reasons = [reason_not_evaluated(report.filters[name].sentence) for report in having]
            answer = pooled_candidate(name, baseline_names(having), rows, len(having), predicted_pct, reasons)
            if evaluated and not answer.known and not answer.reason:
                (lacking, _), *_ = Counter(map(lacking_evidence, evaluated)).most_common(1)
                answer = replace(answer, reason=lacking)
            found.append(answer)
    return found


def answers_of(reports: Sequence[Report]) -> list[AnyCandidate]:
    """Return the answer for each candidate: over all dives, or on the only dive that has it."""
    pooled = {found.filter: found for found in pooled_answers(reports)}
    having = {name: report for report in reversed(reports) for name in report.filters}
    return [pooled.get(name) or answer_on_dive(having[name], name) for name in candidate_names(reports)]


def candidate_names(reports: Sequence[Report]) -> list[str]:
    """Return the candidates of all dives, each once."""
    return list(dict.fromkeys(name for report in reports for name in report.filters))


def baseline_names(reports: Sequence[Report]) -> str:
    """Return the baselines of all dives."""
    return " or ".join(sorted({report.baseline for report in reports}))


def verdict_counts(name: str, reports: Sequence[Report], together: str = "") -> str:
    """Count the dives with each verdict on a candidate, next to that of all together, which may decide alone."""
    words = Counter(report.filters[name].verdict for report in reports if name in report.filters)
    counts = ", ".join(f"{count} {shouted(word)}" for word, count in words.most_common())
    is_decided = together in (Verdict.BETTER, Verdict.WORSE, Verdict.EQUIVALENT)
    return f"{counts} (one dive may not tell, all together do)" if is_decided and words[Verdict.UNDECIDED] else counts
