"""The verdict on a candidate: its evidence, whether its predicted improvement is confirmed, and the sentences.

A sentence has three parts: what was measured, the predicted improvement, and the consistency of both filters.
Filters that diverged or are misconfigured are not evaluated. No candidate of such a baseline is evaluated either.
Of several dives, each dive is one pair, however long it is. The rules are the same as for one dive.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
from msgspec.structs import replace
from scipy.special import chdtrc

from insdvl_replay.core.dive_columns import NS_PER_S
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import (
    ALL_CREDIBILITY_GROUPS,
    CONSISTENCY,
    DECIDING,
    DECIDING_TOGETHER,
    EVIDENCE_QUANTITIES,
    FEWEST_DIVES,
    IS_REFERENCE,
    VERDICTS_BEST_FIRST,
    is_beam,
    is_used,
    label,
)
from insdvl_replay.core.states import DVL_AIDING, NINE
from insdvl_replay.core.tables import (
    CandidateVerdict,
    ConsistencyRow,
    CredibilityRow,
    EvidenceRow,
    Number,
    PooledRow,
    Tables,
    finite,
)
from insdvl_replay.core.words import Consistency, EvidenceVerdict, Prediction, ReferenceStatus, Verdict
from insdvl_replay.evaluation.consistency import MANY_REJECTED, rejected
from insdvl_replay.evaluation.convergence import mean_over_nine, nearest_over_nine, unchanged_over_nine
from insdvl_replay.evaluation.evidence import FEWEST_STARTS
from insdvl_replay.evaluation.outage_test import OUTAGE, outage_alarm
from insdvl_replay.evaluation.reference_errors import ReferenceErrors
from insdvl_replay.evaluation.series import RatioInterval, dives_ratio, verdict_of_interval, what_settles

NOTABLE_PCT: Final = 5.0  # A smaller predicted gain is not checked.
CONFIRMED: Final = 0.5  # Share of the predicted improvement that has to be measured.
# Quantities whose median change summarises the error against the reference.
COMPARED: Final = ("velocity_n", "velocity_e", "velocity_d", "roll", "pitch", "heading", "position_h")
WORST_FIRST: Final = (*reversed(VERDICTS_BEST_FIRST), Consistency.INSUFFICIENT)
MANY_TIMES: Final = 3.0  # A larger ratio is written in times instead of percent.
MOST_NAMED: Final = 2  # Evidence rows in the sentence; the table has all.
MANY_REOPENED: Final = 0.01  # Share of the pings; each comes after several that were rejected.
FEW: Final = 2  # Up to this number of rejections prove nothing, even in a short dive.
# Innovations three times as large as predicted come from wrong axes, units or clocks.
LARGEST_NIS_PER_DOF: Final = 10.0
# Percent of the distance, with the DVL available. Dead reckoning by a DVL without an INS drifts less.
FARTHEST_PCT: Final = 20.0
# Notes on columns of a dive that contradict each other.
CONTRADICTIONS: Final = (
    "dvl_beam_contradiction", "dvl_contradiction", "dvl_direction", "imu_gyro_contradiction", "imu_gyro_sign",
    "imu_upside_down", "reference_contradiction", "start_heading_contradiction", "track_contradiction",
)  # fmt: skip
SHARED: Final = "The reference shares sensors with the filters, so common errors cannot be seen."
AGAINST: Final = {
    Verdict.BETTER: "is BETTER than",
    Verdict.WORSE: "is WORSE than",
    Verdict.MIXED: "is MIXED (better in some quantities, worse in others) against",
    Verdict.EQUIVALENT: "is equivalent to",
    Verdict.UNDECIDED: "is undecided against",
}
NOT_EVALUATED: Final = "is NOT EVALUATED against"
SETTLE: Final = ". Settle this first"
TOO_LARGE: Final = "innovations far too large"
EVERY_DIVE: Final = "*"  # Instead of a dive's name.
FEWEST_SHOWN: Final = 3  # The interval of fewer effective samples, or dives, is stored but not shown.

Piece = EvidenceRow | PooledRow  # one evidence row, of one dive or of several
P = TypeVar("P", bound=Piece)


# --- Verdicts over several rows.


def verdict_of(rows: Iterable[Piece], deciding: Collection[str] = DECIDING) -> Verdict:
    """Return what the evidence on one candidate says together.

    Better in something and worse in nothing; mixed if both; else what the first row says.
    """
    words = [row.verdict for row in rows if row.quantity in deciding]
    better, worse = EvidenceVerdict.BETTER in words, EvidenceVerdict.WORSE in words
    if better or worse:
        return Verdict.MIXED if better and worse else Verdict.BETTER if better else Verdict.WORSE
    return Verdict.EQUIVALENT if words and words[0] == EvidenceVerdict.EQUIVALENT else Verdict.UNDECIDED


def consistency_of(table: Sequence[ConsistencyRow], filter_name: str) -> str:
    """Return the worst verdict among a filter's measurements.

    Axes do not count: with eight tests, every third consistent filter fails one by chance.
    """
    words = {row.verdict for row in table if row.filter == filter_name and is_used(row.measurement)}
    otherwise = Consistency.INSUFFICIENT if words else Consistency.NOT_AVAILABLE
    return next((word for word in WORST_FIRST if word in words), otherwise)


def credibility_of(table: Sequence[CredibilityRow], filter_name: str) -> str:
    """Return the worst verdict among the groups of states, for errors against the reference.

    All states together may be consistent although roll and pitch are far off, if the velocity errors are small. If no
    group could be compared, the reason of the first is returned.
    """
    own = [row for row in table if row.filter == filter_name]
    words = [row.verdict for row in own if row.quantity in ALL_CREDIBILITY_GROUPS]
    otherwise = next(iter(words), Consistency.NO_REFERENCE if own or not table else Consistency.NOT_AVAILABLE)
    return next((word for word in WORST_FIRST if word in words), otherwise)


# --- Filters that are not evaluated.


def not_evaluated(
    histories: tuple[History, ...],  # the first is the baseline
    errors: Mapping[str, ReferenceErrors],  # by filter; empty without a reference
    tables: Tables,
    notes: Sequence[Note],  # of the dive: where its columns contradict each other, no filter is evaluated
) -> dict[str, str]:
    """Return, by candidate, why it is not evaluated; candidates without a problem are left out.

    If only one of the two filters is far off, the evidence shows it. The same holds for a baseline whose innovations
    are far too large. A candidate whose own innovations are far too large is worse or not evaluated.
    """
    # Errors against the reference mean nothing for filters that are aided by the reference's own readings. Depth is an
    # exception: it has no vote, and the rest of the reference is still valid.
    shared = {note.code.removesuffix(IS_REFERENCE) for note in notes if note.code.endswith(IS_REFERENCE)}
    invalid, suspect = dict[str, str](), dict[str, str]()
    for history in histories:
        name = history.filter
        if f"solution_{name}" in shared:
            invalid[name] = f"{name} is the reference, or may have used it"
        for sensor in (met.measurement for met in history.innovations if met.measurement in shared - {"depth"}):
            invalid[name] = f"{name} is aided by the {sensor} of the reference"
        if found := surprised(name, tables.consistency) or far_off(history, histories[0], errors, tables):
            suspect[name] = found
    invalid |= diverged_filters(histories)
    contradicted = "; ".join(note.text for note in notes if note.code in CONTRADICTIONS and note.severity == "warning")
    baseline, *candidates = (history.filter for history in histories)
    unsound = {}
    for candidate in candidates:
        pair = baseline, candidate
        wrong = [invalid[name] for name in pair if name in invalid]
        wrong += [suspect[name] for name in pair] if suspect.keys() >= set(pair) else []
        left = nothing_better(row for row in tables.evidence if row.filter == candidate)
        too_large = "" if verdict_of(left) == Verdict.WORSE else surprised(candidate, tables.consistency)
        if reason := contradicted or " and ".join(wrong) or too_large:
            unsound[candidate] = reason
    return unsound


def nothing_better(rows: Iterable[EvidenceRow]) -> list[EvidenceRow]:
    """Replace the verdict *better* by *undecided*, for a filter whose innovations are far too large."""
    return [
        replace(row, verdict=EvidenceVerdict.UNDECIDED, why=TOO_LARGE) if row.verdict == EvidenceVerdict.BETTER else row
        for row in rows
    ]


def diverged_filters(histories: tuple[History, ...]) -> dict[str, str]:
    """Return, by filter, why it diverged; filters that did not are left out.

    A filter diverged if its state is not finite, if its gate rejected more than `MANY_REJECTED` of its main aiding, or
    if it was set to the DVL again more than once and at more than `MANY_REOPENED` of its pings. Chance is allowed for.
    Partial solutions are not checked.
    """
    found = {}
    for history in (history for history in histories if not history.is_partial):
        name, states = history.filter, ("sd", "position", "velocity_n", "mat_nb", "accel_bias_b", "gyro_bias_b")
        columns = [getattr(history, state).reshape(len(history.time_ns), -1) for state in states]
        known = np.isfinite(np.hstack(columns)).all(axis=1)
        used = [met for met in history.innovations if is_used(met.measurement)]
        if not known.all():
            first_s = (history.time_ns[np.argmin(known)] - history.time_ns[0]) / NS_PER_S
            found[name] = f"the state of {name} is not finite from {first_s:.1f} s on"
        elif used:
            # Its main aiding is the pings of the beams, else the velocities, else its first aiding. A ping is rejected
            # if all its valid beams are; by chance, at most as often as one beam.
            beams = [met for met in used if is_beam(met.measurement)]
            lead = next((met for met in (*beams, *used) if beams or met.measurement == "velocity"), used[0])
            by_chance = float(chdtrc(lead.dof, lead.gate))
            lost, measurement = rejected(lead), f"{lead.measurement} innovations"
            if beams:
                times, ping = np.unique(np.concatenate([beam.time_ns for beam in beams]), return_inverse=True)
                lost, measurement = np.ones(len(times), np.bool_), "pings"
                lost[ping[~np.concatenate([rejected(beam) for beam in beams])]] = False
            count, total, reopened = int(lost.sum()), len(lost), len(history.reopened_ns)
            if count > max(FEW, (MANY_REJECTED + by_chance) * total):
                found[name] = f"{name} rejected {count} of {total} {measurement}"
            elif reopened > max(1.0, (MANY_REOPENED + by_chance**lead.reopen_after) * total):
                # The filter diverges again and again, and is reset each time.
                found[name] = f"{name} diverged and was set to the DVL again {reopened} times in {total} {measurement}"
    return found


def surprised(name: str, rows: Sequence[ConsistencyRow]) -> str:
    """Name a sensor whose innovations are far larger than its filter expects; empty if there is none."""
    far = (row for row in rows if finite(row.mean_nis) > LARGEST_NIS_PER_DOF * row.dof and is_used(row.measurement))
    row = next((row for row in far if row.filter == name), None)
    if row is None:
        return ""
    return f"the {row.measurement} innovations of {name} are far too large (NIS {row.mean_nis:.3g}, expected {row.dof})"


def far_off(history: History, baseline: History, errors: Mapping[str, ReferenceErrors], tables: Tables) -> str:
    """Say that a filter is far off with the DVL available; empty if it is not.

    Errors from DVL outages do not count, unless the DVL is silent for more than half of the time.
    """
    statuses = [row.status for row in tables.reference_error if row.quantity == "position_h_pct"]
    if history.filter not in errors or ReferenceStatus.COMPARED not in statuses:
        return ""
    found = errors[history.filter]
    pings = [met.time_ns for met in baseline.innovations if met.measurement == "velocity" or is_beam(met.measurement)]
    ping_ns = np.unique(np.concatenate(pings)) if pings else np.empty(0, np.int64)
    known = np.isfinite(found.position_error_ned_m[:, :2]).all(axis=1)
    time_ns = np.append(baseline.time_ns[0], found.time_ns[known])
    steps_m = np.diff(found.position_error_ned_m[known, :2], axis=0, prepend=[[0.0, 0.0]])
    if len(ping_ns) > 1:
        seen_ns = np.unique(np.concatenate([time_ns[:1], ping_ns, time_ns[-1:]]))
        begins = np.flatnonzero(np.diff(seen_ns) > OUTAGE * np.median(np.diff(ping_ns)))
        # A step of the reference is in an outage that ends after it begins and begins before it ends.
        ended = np.searchsorted(seen_ns[begins + 1], time_ns[:-1], "right")
        silent = ended < np.searchsorted(seen_ns[begins], time_ns[1:], "left")
        if 2 * np.diff(time_ns)[silent].sum() <= time_ns[-1] - time_ns[0]:
            steps_m[silent] = 0.0
    square_m2 = np.sum(np.cumsum(steps_m, axis=0) ** 2) / max(len(steps_m), 1)
    error_pct = 100.0 * np.sqrt(square_m2) / found.distance_m if found.distance_m > 0.0 else 0.0
    return (
        f"the position error of {history.filter} is {error_pct:.3g} % of the distance"
        if error_pct > FARTHEST_PCT
        else ""
    )


# --- The verdict on one dive.


def evaluated_candidates(
    histories: tuple[History, ...],  # the first is the baseline
    errors: Mapping[str, ReferenceErrors],  # by filter; empty without a reference
    tables: Tables,
    notes: Sequence[Note],  # of the dive
    *,
    independent: bool,  # whether the reference shares no sensors with the filters
) -> tuple[Tables, dict[str, CandidateVerdict]]:
    """Return the verdict on each candidate; evidence rows of those that are not evaluated lose their verdicts."""
    baseline, *candidates = (history.filter for history in histories)
    unsound = not_evaluated(histories, errors, tables, notes)
    by_depth = {
        history.filter
        for history in histories
        if any(note.code == f"depth{IS_REFERENCE}" for note in notes)
        and any(met.measurement == "depth" for met in history.innovations)
    }
    evidence = []
    for name in candidates:
        # Depth is no evidence where a filter is aided by the depth that the reference is made of.
        left_out = "depth" if by_depth & {baseline, name} else ""
        rows = [row for row in tables.evidence if row.filter == name and row.quantity != left_out]
        rows = nothing_better(rows) if surprised(name, tables.consistency) else rows
        evidence += [replace(row, verdict="") for row in rows] if name in unsound else rows  # no gate on them may pass
    tables = replace(tables, evidence=evidence)
    return tables, verdicts(tables, baseline, candidates, unsound, independent=independent)


def verdicts(
    tables: Tables,
    baseline: str,
    candidates: Sequence[str],
    unsound: Mapping[str, str],  # by candidate what keeps it from being evaluated, from `not_evaluated`
    *,
    independent: bool,  # whether the reference shares no sensors with the filters
) -> dict[str, CandidateVerdict]:
    """Return the verdict on each candidate, by name."""
    found, has_reference = {}, any(row.samples for row in tables.reference_error)
    for candidate in candidates:
        predicted_pct = mean_over_nine(tables.improvement, candidate)
        evidence = [row for row in tables.evidence if row.filter == candidate]
        verdict, prediction = Verdict.NOT_EVALUATED, Prediction.UNDECIDED
        measured = f"{candidate} {NOT_EVALUATED} {baseline}: {unsound.get(candidate)}{SETTLE}"
        if candidate not in unsound:
            verdict = verdict_of(evidence)
            prediction, predicted = _prediction(predicted_pct, baseline, candidate, tables, evidence, has_reference)
            measured = f"{candidate} {AGAINST[verdict]} {baseline}: {_measured(verdict, evidence)}{predicted}"
        changes = [
            finite(row.improvement_pct)
            for row in tables.reference_error
            if row.filter == candidate and row.status == ReferenceStatus.COMPARED and row.quantity in COMPARED
        ]
        shared = "" if independent or not has_reference else f" {SHARED}"
        found[candidate] = CandidateVerdict(
            sentence=f"{measured}. {trust_sentence(tables, candidate, baseline)}{shared}",
            verdict=verdict,
            consistency=consistency_of(tables.consistency, candidate),
            mean_improvement_pct=predicted_pct,
            mean_convergence_improvement_pct=mean_over_nine(tables.convergence, candidate),
            reference_improvement_pct=_median(changes),
            credibility=credibility_of(tables.credibility, candidate),
            prediction=prediction,
            mean_convergence_unchanged_pct=unchanged_over_nine(tables.convergence, candidate),
            mean_nearest_approach_improvement_pct=nearest_over_nine(tables.convergence, candidate),
        )
    return found


def reason_not_evaluated(sentence: str) -> str:
    """Return the reason in the sentence on a candidate that is not evaluated."""
    return sentence.partition(NOT_EVALUATED)[2].partition(": ")[2].rpartition(SETTLE)[0]


def _median(numbers: Iterable[float]) -> float:
    known = [number for number in numbers if np.isfinite(number)]
    return float(np.median(known)) if known else float("nan")


def _prediction(
    predicted_pct: float,
    baseline: str,
    candidate: str,
    tables: Tables,
    evidence: Sequence[EvidenceRow],
    has_reference: bool,
) -> tuple[Prediction, str]:
    """Return whether the predicted improvement is confirmed, and the sentences on it."""
    given = {row.state for row in tables.improvement if row.filter == candidate}
    if not given >= {state.id for state in NINE}:
        return Prediction.UNDECIDED, ". It reports the sigma of only some states" if given else ""
    if not np.isfinite(predicted_pct):
        return Prediction.UNDECIDED, ". Predicted: a sigma that is not finite"
    size = "smaller" if predicted_pct >= 0.0 else "larger"
    if abs(predicted_pct) < NOTABLE_PCT:
        same = f"about the same sigma as {baseline} ({abs(predicted_pct):.1f} % {size})"
        return Prediction.UNDECIDED, f". Predicted: {same}"
    predicted = f". Predicted: {abs(predicted_pct):.1f} % {size} sigma"
    if predicted_pct < 0.0:
        return Prediction.UNDECIDED, predicted
    prediction = prediction_of(predicted_pct, evidence, _most_starts(evidence))
    return prediction, f"{predicted}. {on_prediction(prediction, evidence, has_reference=has_reference)}"


def _most_starts(evidence: Iterable[EvidenceRow]) -> int:
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


def _measured(verdict: Verdict, evidence: Sequence[EvidenceRow]) -> str:
    """Say what was measured, by the evidence rows that decided, or could have decided."""
    pieces = []
    for row in spoken_of(verdict, evidence):
        piece = changed(row.quantity, finite(row.ratio))
        if np.isfinite(finite(row.ratio)):
            values = f"{finite(row.value):.3g} {row.unit} against {finite(row.baseline):.3g} {row.unit}"
            why = f"; {row.why}" if row.why else ""
            drawn = f" over {row.starts} random starts" if row.evidence == "accuracy" and row.starts > 1 else ""
            piece = f"{piece}{drawn} (this dive: {values}{interval_in_words(row, 'on this dive')}{why})"
        pieces.append(piece)
    left, needed = left_undecided(verdict, evidence), would_settle(verdict, evidence)
    left += f"; {needed}" if needed else ""
    words = {row.verdict for row in evidence if row.evidence == CONSISTENCY} & {
        EvidenceVerdict.BETTER,
        EvidenceVerdict.WORSE,
    }
    if len(words) == 1:
        is_more = EvidenceVerdict.BETTER in words
        joined = "but" if is_more == (verdict == Verdict.WORSE) else "and"
        left += f"; {joined} it is {'more' if is_more else 'less'} consistent"
    return f"{'; '.join(pieces) or 'there is no evidence'}{left}"


def would_settle(verdict: Verdict, rows: Iterable[Piece], deciding: Collection[str] = DECIDING) -> str:
    """Say how many dives like these would decide an undecided candidate; empty if these dives should be enough.

    This is by the first undecided row that does not depend on a single stretch of a dive.
    """
    undecided = (row for row in rows if row.quantity in deciding and row.verdict == EvidenceVerdict.UNDECIDED)
    row = next((row for row in undecided if isinstance(row, PooledRow) or not row.why), None)
    if row is None or verdict != Verdict.UNDECIDED:
        return ""
    samples, dives = (float(row.dives), row.dives) if isinstance(row, PooledRow) else (finite(row.effective_samples), 1)
    ends = finite(row.ratio), finite(row.low), finite(row.high)
    return what_settles(RatioInterval(*ends, *ends[1:], samples, max(samples - 1.0, 1.0)), dives)


def left_undecided(verdict: Verdict, rows: Iterable[Piece], deciding: Collection[str] = DECIDING) -> str:
    """Name the undecided rows of an equivalent candidate, as the end of a sentence."""
    undecided = (row.quantity for row in rows if row.quantity in deciding and row.verdict == EvidenceVerdict.UNDECIDED)
    names = ", ".join(map(label, undecided)) if verdict == Verdict.EQUIVALENT else ""
    return f"; undecided: {names}" if names else ""


def spoken_of(verdict: Verdict, rows: Iterable[P], deciding: Collection[str] = DECIDING) -> list[P]:
    """Choose the evidence rows that made the verdict, or could have: the first of each kind."""
    words = {verdict.value} & set(EvidenceVerdict) or {EvidenceVerdict.UNDECIDED}
    if verdict == Verdict.MIXED:
        words = {EvidenceVerdict.BETTER, EvidenceVerdict.WORSE}
    known, spoken = [row for row in rows if row.quantity in deciding], list[P]()
    for word in sorted(words):
        kinds: dict[str, P] = {row.evidence: row for row in reversed(known) if row.verdict == word}
        spoken += [*reversed(kinds.values())][: MOST_NAMED // len(words)]
    return spoken


def changed(quantity: str, ratio: float) -> str:
    """Say how much smaller or larger, or sooner or later, a quantity is."""
    if not np.isfinite(ratio):
        return f"{label(quantity)} unknown"
    is_time = quantity.startswith("convergence")
    if ratio >= MANY_TIMES:
        return f"{label(quantity)} {ratio:.3g} times as {'late' if is_time else 'large'}"
    smaller, larger = ("sooner", "later") if is_time else ("smaller", "larger")
    return f"{label(quantity)} {abs(100.0 * (ratio - 1.0)):.1f} % {smaller if ratio <= 1.0 else larger}"


def shown_interval(row: Piece) -> tuple[Number, Number]:
    """Return the ends of the interval of a row; None with fewer than three effective samples, or dives."""
    samples = row.dives if isinstance(row, PooledRow) else finite(row.effective_samples)
    return (None, None) if row.ratio is None or samples < FEWEST_SHOWN else (row.low, row.high)


def interval_in_words(row: Piece, where: str) -> str:
    """Write the interval of a row, if it is shown, in percent or, as the ratio itself, in times."""
    low, high = map(finite, shown_interval(row))
    if not np.isfinite(high - low):
        return ""
    ends = f"{100.0 * (low - 1.0):+z.1f} to {100.0 * (high - 1.0):+z.1f} %"
    if finite(row.ratio) >= MANY_TIMES:
        ends = f"{low:.3g} to {high:.3g} times"
    return f"; 95 % interval {where}: {ends}"


def trust_sentence(tables: Tables, candidate: str, baseline: str) -> str:
    """Say whether candidate and baseline are consistent, by innovations, errors and the outage test.

    If the candidate is aided by a sensor other than the DVL, the sentence has the NIS/dof of each of its sensors.
    """
    alarm = outage_alarm(tables.outage, (baseline, candidate))
    consistency_words, baseline_trust = _trust(tables, candidate), _trust(tables, baseline)
    if consistency_words == Consistency.NOT_AVAILABLE:
        return f"{candidate} reports no sigma, {baseline} is {baseline_trust}.{alarm}"
    sentence = f"Both filters are {consistency_words}."
    if consistency_words != baseline_trust:
        sentence = f"{candidate} is {consistency_words}, {baseline} {baseline_trust}."
    elif consistency_words == Consistency.INSUFFICIENT:
        sentence = "Both filters have insufficient data for a consistency test."
    used = [row for row in tables.consistency if row.filter == candidate and is_used(row.measurement)]
    if not all(row.measurement in DVL_AIDING or is_beam(row.measurement) for row in used):
        sizes = ", ".join(f"{row.measurement} {finite(row.mean_nis) / row.dof:.3g}" for row in used)
        sentence = f"{sentence} NIS / dof of {candidate}: {sizes}."
    return f"{sentence}{alarm}"


def _trust(tables: Tables, name: str) -> str:
    """Join the consistency of innovations and of errors: one word if they agree or only one is known."""
    consistency, credibility = consistency_of(tables.consistency, name), credibility_of(tables.credibility, name)
    if credibility == Consistency.INSUFFICIENT or credibility not in WORST_FIRST:
        return consistency
    # Name the groups of states that have the worst verdict, where others have a better one.
    groups = [row for row in tables.credibility if row.filter == name and row.quantity in ALL_CREDIBILITY_GROUPS]
    groups = [row for row in groups if row.verdict in VERDICTS_BEST_FIRST]
    worst = [row.quantity.replace("_", " ") for row in groups if row.verdict == credibility]
    where = f" in {' and '.join(worst)}" if len(worst) < len(groups) else ""
    if consistency in (Consistency.NOT_AVAILABLE, Consistency.INSUFFICIENT):
        return f"{credibility}{where} against the reference"
    if consistency == credibility:
        return f"{consistency} by the innovations, and{where} against the reference" if where else consistency
    return f"{consistency} by the innovations and {credibility}{where} against the reference"


# --- The verdict on several dives.


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
                baseline=_median(finite(row.baseline) for row in rows),
                value=_median(finite(row.value) for row in rows),
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


@dataclass(frozen=True)
class PooledCandidate:
    """The pooled evidence of several dives on a candidate."""

    name: str
    baseline: str
    rows: tuple[PooledRow, ...]  # the row that decides first in front
    dives: int  # that have the candidate
    evaluated: int  # in which it is evaluated
    predicted_pct: float  # how much smaller its predicted sigma is, median over the dives; NaN if unknown
    prediction: Prediction
    confirmation: str  # whether the prediction is confirmed, and why not; empty if it is too small to be checked

    @property
    def verdict(self) -> Verdict:
        """The pooled verdict; not evaluated if at least half of the dives are not."""
        if 2 * self.evaluated <= self.dives:
            return Verdict.NOT_EVALUATED
        return verdict_of(self.rows, DECIDING_TOGETHER)


def pooled_candidate(
    name: str,
    baseline: str,
    evidence: Sequence[Sequence[EvidenceRow]],  # of each dive in which it is evaluated
    dives: int,
    predicted_pct: Iterable[Number] = (),  # of each of these dives
) -> PooledCandidate:
    """Pool the evidence on one candidate; its prediction is checked by the rule for one dive, with the pooled rows."""
    rows, pct = tuple(pooled_evidence(name, evidence)), _median(map(finite, predicted_pct))
    every_row = [row for dive in evidence for row in dive]
    enough = [row for row in rows if row.dives >= FEWEST_DIVES]
    prediction = prediction_of(pct, enough, _most_starts(every_row))
    confirmation = ""
    if pct >= NOTABLE_PCT:
        confirmation = on_prediction(prediction, every_row, has_reference=True, dives=len(evidence))
    return PooledCandidate(name, baseline, rows, dives, len(evidence), pct, prediction, confirmation)


def pooled_sentence(pooled: PooledCandidate) -> str:
    """Return the pooled verdict on a candidate as one sentence."""
    verdict, dives = pooled.verdict, f"{pooled.evaluated} of {pooled.dives} dives"
    if verdict == Verdict.NOT_EVALUATED:
        found = f"it is evaluated in only {dives}. Settle the others first"
        return f"{pooled.name} is NOT EVALUATED against {pooled.baseline}: {found}."
    spoken = [row for row in spoken_of(verdict, pooled.rows, DECIDING_TOGETHER) if row.dives]
    pieces = [
        f"{changed(row.quantity, finite(row.ratio))} "
        f"({'sooner' if row.evidence == 'convergence' else 'smaller'} in {row.dives_won} of {row.dives} dives, "
        f"p = {finite(row.p):.2g}{interval_in_words(row, 'over dives')})"
        for row in spoken
    ]
    pieces.append(would_settle(verdict, pooled.rows, DECIDING_TOGETHER))
    found = "; ".join(filter(None, pieces)) or "there is no evidence"
    left = left_undecided(verdict, pooled.rows, DECIDING_TOGETHER)
    return f"{pooled.name} {AGAINST[verdict]} {pooled.baseline} over {dives}: {found}{left}."
