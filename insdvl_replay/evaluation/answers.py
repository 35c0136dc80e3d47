"""The answer for a candidate, by one dive or by several: the evidence rows that decided, and their words.

Of several dives, each dive is one pair, however long it is. The rules are the same as for one dive.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Annotated, Final, Generic, TypeVar

import numpy as np
from msgspec import Meta, Struct

from insdvl_replay.core.errors import counted
from insdvl_replay.core.quantities import (
    CONSISTENCY,
    DECIDING,
    DECIDING_TOGETHER,
    EVIDENCE_QUANTITIES,
    FEWEST_DIVES,
    label,
)
from insdvl_replay.core.tables import EvidenceRow, Number, PooledRow, finite
from insdvl_replay.core.words import EvidenceVerdict, Prediction, Verdict
from insdvl_replay.evaluation.evidence import FEWEST_STARTS, SOONER
from insdvl_replay.evaluation.series import (
    FEWEST_EFFECTIVE,
    LARGEST_P,
    MARGIN,
    RatioInterval,
    dives_ratio,
    verdict_of_interval,
    what_settles,
)

NOTABLE_PCT: Final = 5.0  # A smaller predicted gain is not checked.
CONFIRMED: Final = 0.5  # Share of the predicted improvement that has to be measured.
MANY_TIMES: Final = 3.0  # A larger ratio is written in times instead of percent.
MOST_NAMED: Final = 2  # Evidence rows in the sentence; the table has all.
AGAINST: Final = {
    Verdict.BETTER: "is BETTER than",
    Verdict.WORSE: "is WORSE than",
    Verdict.MIXED: "is MIXED (better in some quantities, worse in others) against",
    Verdict.EQUIVALENT: "is equivalent to",
    Verdict.UNDECIDED: "is undecided against",
    Verdict.NOT_EVALUATED: "is NOT EVALUATED against",
}
EVERY_DIVE: Final = "*"  # Instead of a dive's name.
FEWEST_SHOWN: Final = 3  # The interval of fewer effective samples, or dives, is stored but not shown.
DECIDED: Final = (EvidenceVerdict.BETTER, EvidenceVerdict.WORSE)

Piece = EvidenceRow | PooledRow  # one evidence row, of one dive or of several
P = TypeVar("P", bound=Piece)


class Answer(Struct, Generic[P], frozen=True, kw_only=True):
    """The verdict on a filter against another, by one dive or by several together."""

    filter: str
    baseline: str
    verdict: Verdict
    dives: Annotated[int, Meta(description="dives that have the filter; of a comparison, on both sides")]
    evaluated: Annotated[int, Meta(description="of them, those in which it is evaluated; of a comparison, on a side")]
    rows: tuple[P, ...]  # evidence; of several dives, the row that decides first in front
    reason: Annotated[
        str, Meta(description="why it is not evaluated, or has no evidence, on a dive: the most common reason")
    ] = ""

    @property
    def known(self) -> list[P]:
        """The rows that have a ratio."""
        return [row for row in self.rows if np.isfinite(finite(row.ratio))]

    @property
    def spoken(self) -> list[P]:
        """The rows that made the verdict, or could have."""
        return spoken_of(self.verdict, self.known)

    @property
    def measured(self) -> str:
        """What decided, or could have: each change, the interval or why it has none; then what would decide."""
        pieces = list[str]()
        for row in self.spoken:
            piece = changed(row)
            if isinstance(row, PooledRow) and row.dives > 1 and row.verdict != EvidenceVerdict.EQUIVALENT:
                alike = row.dives_won if finite(row.ratio) <= 1.0 else row.dives - row.dives_won
                piece += f" on {alike} of {counted(row.dives, 'dive')}"
            if not pieces:
                reason = "" if row.verdict == EvidenceVerdict.EQUIVALENT else reason_in_words(row)
                found = "; ".join(filter(None, (interval_in_words(row), reason)))
                piece += f" ({found})" if found else ""
            pieces.append(piece)
        needed = would_settle(self.verdict, self.known)
        settled = f" {needed[:1].upper()}{needed[1:]}." if needed else ""
        return f"{'; '.join(pieces) or 'there is no evidence'}{left_undecided(self.verdict, self.rows)}.{settled}"


class CandidateAnswer(Answer[P], frozen=True, kw_only=True):
    """The verdict on a candidate of a replay, or of several, and what it predicts by its own covariance."""

    log: str = EVERY_DIVE
    predicted_pct: Number  # how much smaller its predicted sigma is; of several dives the median
    prediction: str  # whether it is confirmed; empty if it is too small to be checked
    predicted: str  # both as sentences

    @property
    def where(self) -> str:
        """The dive, or the number of dives."""
        dives = counted(self.dives, "dive")
        some = f"{self.evaluated} of " if self.evaluated < self.dives else ""
        return f"{some}{dives}" if self.log == EVERY_DIVE else self.log


# --- Verdicts over several rows.


def may_decide(row: Piece) -> bool:
    """Return whether a row has a vote, on one dive or over several."""
    return row.quantity in (DECIDING_TOGETHER if isinstance(row, PooledRow) else DECIDING)


def verdict_of(rows: Iterable[Piece]) -> Verdict:
    """Return what the evidence on one candidate says together.

    Better in something and worse in nothing; mixed if both; else what the first row says.
    """
    words = [row.verdict for row in rows if may_decide(row)]
    better, worse = EvidenceVerdict.BETTER in words, EvidenceVerdict.WORSE in words
    if better or worse:
        return Verdict.MIXED if better and worse else Verdict.BETTER if better else Verdict.WORSE
    return Verdict.EQUIVALENT if words and words[0] == EvidenceVerdict.EQUIVALENT else Verdict.UNDECIDED


def spoken_of(verdict: Verdict, rows: Iterable[P]) -> list[P]:
    """Choose the evidence rows that made the verdict, or could have: the first of each kind."""
    words = {verdict.value} & set(EvidenceVerdict) or {EvidenceVerdict.UNDECIDED}
    if verdict == Verdict.MIXED:
        words = {*DECIDED}
    known, spoken = [row for row in rows if may_decide(row)], list[P]()
    for word in sorted(words):
        kinds: dict[str, P] = {row.evidence: row for row in reversed(known) if row.verdict == word}
        spoken += [*reversed(kinds.values())][: MOST_NAMED // len(words)]
    return spoken


# --- The words of a row.


def changed(row: Piece) -> str:
    """Say how much smaller or larger, or sooner or later, a quantity is."""
    name, ratio, is_time = label(row.quantity), finite(row.ratio), row.evidence == "convergence"
    if not np.isfinite(ratio):
        return f"{name} unknown"
    if ratio >= MANY_TIMES:
        return f"{name} {ratio:.3g} times as {'late' if is_time else 'large'}"
    smaller, larger = ("sooner", "later") if is_time else ("smaller", "larger")
    return f"{name} {abs(100.0 * (ratio - 1.0)):.1f} % {smaller if ratio <= 1.0 else larger}"


def shown_interval(row: Piece) -> tuple[float, float] | None:
    """Return the ends of the interval of a row; None with fewer than three effective samples, or with two dives."""
    is_enough = row.dives != 2 if isinstance(row, PooledRow) else finite(row.effective_samples) >= FEWEST_SHOWN
    low, high = finite(row.low), finite(row.high)
    return (low, high) if is_enough and row.ratio is not None and np.isfinite(high - low) else None


def interval_in_words(row: Piece) -> str:
    """Write the interval of a row, if it is shown, in percent or, as the ratio itself, in times."""
    if (ends := shown_interval(row)) is None:
        return ""
    low, high = ends
    text = f"{100.0 * (low - 1.0):+z.1f} to {100.0 * (high - 1.0):+z.1f} %"
    if finite(row.ratio) >= MANY_TIMES:
        text = f"{low:.3g} to {high:.3g} times"
    return f"95 % interval {'over dives' if isinstance(row, PooledRow) and row.dives > 1 else 'on this dive'}: {text}"


def reason_in_words(row: Piece) -> str:
    """Say why a row has no interval, or is neither better nor worse although its interval excludes 1; else empty."""
    if row.ratio is None or row.evidence == CONSISTENCY or row.verdict in ("", *DECIDED):
        return ""
    is_pooled, is_time, interval = isinstance(row, PooledRow), row.evidence == "convergence", shown_interval(row)
    if isinstance(row, EvidenceRow) and row.why:
        return row.why
    if row.evidence == "track" and not is_pooled:
        return "one dive is one sample"
    if interval is None:
        return f"fewer than {FEWEST_SHOWN} {'dives' if is_pooled else 'effective samples'}"
    if interval[0] <= 1.0 <= interval[1]:
        return ""
    change = ("sooner" if is_time else "smaller") if row.ratio < 1.0 else "later" if is_time else "larger"
    margin = SOONER if is_time and not is_pooled else MARGIN
    if 1.0 / (1.0 + margin) < row.ratio < 1.0 + margin:
        return f"{change}, but less than {100.0 * margin:.0f} %"
    if not finite(row.p) < LARGEST_P:
        return f"{change}, but maybe less than {100.0 * MARGIN:.0f} %"
    return "never settled on some dive" if is_pooled else f"fewer than {FEWEST_EFFECTIVE:.0f} effective samples"


def would_settle(verdict: Verdict, rows: Iterable[Piece]) -> str:
    """Say how many dives would decide an undecided candidate; empty if these dives should be enough.

    This is by the first undecided row that does not depend on a single stretch of a dive.
    """
    undecided = (row for row in rows if may_decide(row) and row.verdict == EvidenceVerdict.UNDECIDED)
    row = next((row for row in undecided if isinstance(row, PooledRow) or not row.why), None)
    if row is None or verdict != Verdict.UNDECIDED:
        return ""
    if isinstance(row, PooledRow) and row.dives < FEWEST_DIVES:
        return "replay more dives"
    samples, dives = (float(row.dives), row.dives) if isinstance(row, PooledRow) else (finite(row.effective_samples), 1)
    ends = finite(row.ratio), finite(row.low), finite(row.high)
    return what_settles(RatioInterval(*ends, *ends[1:], samples, max(samples - 1.0, 1.0)), dives)


def left_undecided(verdict: Verdict, rows: Iterable[Piece]) -> str:
    """Name the undecided rows of an equivalent candidate, as the end of a sentence."""
    undecided = (row.quantity for row in rows if may_decide(row) and row.verdict == EvidenceVerdict.UNDECIDED)
    names = ", ".join(map(label, undecided)) if verdict == Verdict.EQUIVALENT else ""
    return f"; undecided: {names}" if names else ""


# --- Predictions.


def most_starts(evidence: Iterable[EvidenceRow]) -> int:
    """Return the number of random starts behind the accuracy."""
    return max((row.starts for row in evidence if row.evidence == "accuracy" and row.ratio is not None), default=0)


def prediction_of(predicted_pct: float, evidence: Iterable[Piece], starts: int) -> Prediction:
    """Return whether at least half of a predicted improvement was measured, by the medians of the intervals' ends."""
    measured = [row for row in evidence if row.evidence == "accuracy" and row.ratio is not None]
    if measured and starts >= FEWEST_STARTS and predicted_pct >= NOTABLE_PCT:
        least_pct, most_pct = (
            100.0 * (1.0 - float(np.median([finite(end) for end in ends])))
            for ends in ([row.high for row in measured], [row.low for row in measured])
        )
        if least_pct >= CONFIRMED * predicted_pct:
            return Prediction.CONFIRMED
        if most_pct < CONFIRMED * predicted_pct:
            return Prediction.NOT_CONFIRMED
    return Prediction.UNDECIDED


def on_prediction(prediction: str, evidence: Iterable[EvidenceRow], *, has_reference: bool, dives: int = 1) -> str:
    """Say whether a predicted improvement is confirmed, and why not."""
    if prediction == Prediction.CONFIRMED:
        return "Confirmed"
    starts = [row.starts for row in evidence if row.evidence == "accuracy"]
    reason = "one dive is too short" if dives == 1 else "the measured interval is too wide to tell"
    if prediction == Prediction.NOT_CONFIRMED:
        reason = "all accuracy evidence together shows less than half of it"
    elif not has_reference:
        reason = "there is no reference"
    elif not starts:
        reason = "no accuracy was measured"
    elif max(starts) < FEWEST_STARTS:
        reason = f"this takes {FEWEST_STARTS} random starts (--starts 16)"
    elif 1 < dives < FEWEST_DIVES:
        reason = f"this takes {FEWEST_DIVES} dives"
    return f"Not confirmed: {reason}"


# --- Several dives.


def median_of(numbers: Iterable[float]) -> float:
    """Return the median of the finite numbers, NaN for none."""
    known = [number for number in numbers if np.isfinite(number)]
    return float(np.median(known)) if known else float("nan")


def pooled_evidence(
    candidate: str,
    dives: Sequence[Sequence[EvidenceRow]],  # the candidate's rows of each dive in which it is evaluated
) -> list[PooledRow]:
    """Pool the evidence of several dives on one candidate; the row that decides first is in front."""
    pooled = []
    for quantity in EVIDENCE_QUANTITIES:
        rows = [row for dive in dives for row in dive if row.quantity == quantity and row.evidence != CONSISTENCY]
        if not rows:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.asarray(np.log([finite(row.ratio) for row in rows]))
        interval, known = dives_ratio(logs), np.isfinite(logs)
        # On some dive one of the filters never settled. Only dives on which both settled have a ratio.
        unsettled = any((row.baseline is None) != (row.value is None) for row in rows)
        pooled.append(
            PooledRow(
                log=EVERY_DIVE,
                filter=candidate,
                evidence=rows[0].evidence,
                quantity=quantity,
                unit=rows[0].unit,
                baseline=median_of(finite(row.baseline) for row in rows),
                value=median_of(finite(row.value) for row in rows),
                ratio=interval.ratio,
                low=interval.low,
                high=interval.high,
                dives=int(known.sum()),
                dives_won=int((logs < 0.0).sum()),
                p=interval.p,
                verdict=EvidenceVerdict.UNDECIDED if unsettled else verdict_of_interval(interval, FEWEST_DIVES),
            )
        )
    return pooled


def pooled_candidate(
    name: str,
    baseline: str,
    evidence: Sequence[Sequence[EvidenceRow]],  # of each dive in which it is evaluated
    dives: int,
    predicted_pct: Iterable[Number] = (),  # of each of these dives
    reasons: Iterable[str] = (),  # why it is not evaluated in the other dives
) -> CandidateAnswer[PooledRow]:
    """Pool the evidence on one candidate; its prediction is checked by the rule for one dive, with the pooled rows.

    It is not evaluated if at least half of the dives are not.
    """
    rows, pct = tuple(pooled_evidence(name, evidence)), median_of(map(finite, predicted_pct))
    every_row = [row for dive in evidence for row in dive]
    prediction = prediction_of(pct, [row for row in rows if row.dives >= FEWEST_DIVES], most_starts(every_row))
    predicted = "predicted: unknown."
    if np.isfinite(pct):
        size = f"{abs(pct):.1f} % {'smaller' if pct >= 0.0 else 'larger'} sigma"
        predicted = f"predicted: {size}, median of {counted(len(evidence), 'dive')}."
    if pct >= NOTABLE_PCT:
        predicted += f" {on_prediction(prediction, every_row, has_reference=True, dives=len(evidence))}."
    verdict, reason = verdict_of(rows), next((why for why, _ in Counter(filter(None, reasons)).most_common(1)), "")
    if 2 * len(evidence) <= dives:
        verdict, reason = Verdict.NOT_EVALUATED, reason or "too few dives are evaluated"
    return CandidateAnswer(
        filter=name,
        baseline=baseline,
        verdict=verdict,
        dives=dives,
        evaluated=len(evidence),
        rows=rows,
        reason=reason,
        predicted_pct=pct,
        prediction=prediction,
        predicted=predicted,
    )


def pooled_sentence(answer: Answer[PooledRow]) -> str:
    """Return the verdict by several dives as one sentence."""
    start = f"{answer.filter} {AGAINST[answer.verdict]} {answer.baseline}"
    dives = f"{answer.evaluated} of {counted(answer.dives, 'dive')}"
    if answer.verdict == Verdict.NOT_EVALUATED:
        return f"{start}, evaluated in only {dives}: {answer.reason}. Settle this first."
    return f"{start} over {dives}: {answer.measured}"
