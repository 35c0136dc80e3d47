"""The evidence on each candidate next to the baseline: what was measured, its interval, and a word (`series.word_of`).

Both filters ran on the same dive, so that everything is paired. *Accuracy* is against the reference, from the same
drawn starts; *outage* while the DVL is withheld; *held_out* by other sensors that no filter is given;
*convergence* from starts that err as much as the filters allow for; the *track* is the error of the whole dive;
*consistency* is whether innovations and errors are as large as a filter says, which says nothing of gain or loss.
Positions are judged by how far they drift: their error as such is one number that a heading wrong at the start
decides.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.quantities import (
    ALL_CREDIBILITY_GROUPS,
    CONSISTENT,
    CONVERGED,
    HELD_OUT,
    TRACK,
    VERDICTS_BEST_FIRST,
    is_used,
)
from insdvl_replay.core.states import DEG, PHI
from insdvl_replay.core.tables import ConsistencyRow, CredibilityRow, EvidenceRow, finite
from insdvl_replay.core.words import Consistency, EvidenceWord
from insdvl_replay.evaluation.convergence import MeasuredConvergence
from insdvl_replay.evaluation.drift import (
    STEP_S,
    Segments,
    course_errors,
    distance_segments,
    segment_drift,
    time_segments,
)
from insdvl_replay.evaluation.errors import WELL_COVERED, DrawnErrors, covered_share, reference_distance_m, where_known
from insdvl_replay.evaluation.series import (
    FEWEST_EFFECTIVE,
    STRETCHES,
    RatioInterval,
    paired_ratio,
    thinned,
    windows_ratio,
    word_of,
)
from insdvl_replay.geometry.frames import north_east_down_m

SEGMENTS_S: Final = (30.0, 60.0)
HEADING_FREE: Final = ("velocity_along", "depth_60s")
"""Quantities in which a heading that is off shows in the second order alone."""
OF_STARTS: Final = ("level", "heading")  # Quantities that are judged from drawn starts alone.
FEWEST_STARTS: Final = 8  # With fewer, levels and headings are no evidence: each start is one sample of them.
SOONER: Final = 0.25
"""A smaller difference of convergence decides nothing: its interval is over starts, and the sensors err once a dive."""
NOISE_OF_REFERENCE: Final = "mostly noise of the reference"
NOISY: Final = 0.4
"""Share of a root mean square that is the noise of what it is taken against, above which likeness says nothing."""
NOTABLY: Final = 1.1  # A mean NIS or NEES nearer to its degrees of freedom by less is as consistent.
ALONG: Final = {"depth": [2], "position": [0, 1]}  # Sensors that tell of the track, and along which axes of n.


# --- Squared errors against the reference, and against held-out sensors.


class ReferenceNoise(NamedTuple):
    """How far the reference itself may be off, each axis."""

    position_m: float
    velocity_mps: float
    attitude_deg: float


class SquaredErrors(NamedTuple):
    """Squared errors of one filter in one quantity."""

    unit: str
    squared: Floats  # (s, k), of s starts at k times or segments, in the unit squared
    least_block: int  # so many neighbours share what they are made of
    floor: float  # root mean square up to which the reference itself may err
    own: Floats | None = None  # (k,), from the dive's own start; None where that is the first of the s
    span_s: tuple[float, float] = (0.0, 0.0)  # first and last time, seconds from the start


def accuracy_errors(
    drawn: DrawnErrors,
    reference: ReferenceColumns,
    noise: ReferenceNoise,
    *,
    bridged_gaps: bool,  # positions after long gaps of the IMU, in which nothing tells where the vehicle went
    covered: DrawnErrors | None = None,  # the runs that the reference has to cover, if not these
) -> dict[str, SquaredErrors]:
    """Square the errors of one filter, by quantity of `quantities.ACCURACY`, in its order.

    What the reference knows for less than `errors.WELL_COVERED` of the runs is left out.
    """
    time_ns, whole = drawn.time_ns, covered or drawn
    start_ns = int(whole.time_ns[0] - round(whole.time_s[0] * 1e9)) if len(whole.time_ns) else 0

    def is_covered(columns: Floats) -> bool:
        known = np.asarray(np.isfinite(columns).all(axis=1))
        if not known.any():
            return False
        return covered_share(whole.time_ns, known, start_ns, int(whole.time_ns[-1])) >= WELL_COVERED

    def drift(segments: Segments) -> SquaredErrors:
        # Both ends are the reference's.
        drift_m = segment_drift(drawn, segments).horizontal_m
        return SquaredErrors("m", drift_m**2, segments.steps, 2.0 * noise.position_m)

    found = {}
    if is_covered(whole.position_error_ned_m[0, :, :2]) and not bridged_gaps:
        for length_s in SEGMENTS_S:
            found[f"drift_{length_s:.0f}s"] = drift(time_segments(time_ns, length_s))
        found["drift_100m"] = drift(distance_segments(time_ns, reference_distance_m(reference, time_ns)))
    if is_covered(whole.velocity_error_n[0, :, :2]):
        along_mps, across_mps = course_errors(drawn, reference)
        found["velocity_along"] = SquaredErrors("m/s", along_mps**2, 1, noise.velocity_mps)
        found["velocity_across"] = SquaredErrors("m/s", across_mps**2, 1, noise.velocity_mps)
    if is_covered(whole.position_error_ned_m[0, :, 2:]) and not bridged_gaps:
        segments = time_segments(time_ns)
        down_m, floor_m = segment_drift(drawn, segments).down_m, math.sqrt(2.0) * noise.position_m
        found["depth_60s"] = SquaredErrors("m", down_m**2, segments.steps, floor_m)
    if len(drawn.error) >= FEWEST_STARTS and is_covered(whole.error[0, :, PHI]):
        squared = (drawn.error[:, :, PHI] / DEG) ** 2
        for quantity, square in zip(OF_STARTS, (squared[..., :2].mean(axis=-1), squared[..., 2]), strict=True):
            found[quantity] = SquaredErrors("deg", square[1:], 1, noise.attitude_deg, square[0])
    span_s = (float(drawn.time_s[0]), float(drawn.time_s[-1])) if len(drawn.time_s) else (0.0, 0.0)
    return {name: errors._replace(span_s=span_s) for name, errors in found.items() if errors.squared.shape[1] > 1}


Rows = NDArray[np.int64]
Pair = tuple[Mapping[str, SquaredErrors], Mapping[str, SquaredErrors]]
"""Those of the baseline and of a candidate, by quantity."""


def accuracy_beside(
    drawn: DrawnErrors,
    single: DrawnErrors,
    reference: ReferenceColumns,
    noise: ReferenceNoise,
    *,
    bridged_gaps: bool,
    given_heading: bool,  # the single run was given the heading, so that it does not err at first
) -> Pair:
    """Square the errors of a filter, and of a run that has a start of its own, where and when both have any.

    The reference has to cover the filter's runs; the single run may be as short as it is. Levels and headings are left
    out: those of the filter are what is left of the errors that it was started with, and the single run has none.
    """
    before, after = (
        accuracy_errors(errors, reference, noise, bridged_gaps=bridged_gaps, covered=drawn)
        for errors in (where_known(drawn, single), single)
    )
    known = [
        quantity
        for quantity in before
        if (quantity in HEADING_FREE if given_heading else quantity not in OF_STARTS)
        and np.count_nonzero(np.isfinite(before[quantity].squared[0] + after[quantity].squared[0])) > 1
    ]
    return {name: before[name] for name in known}, {name: after[name] for name in known}


def held_out_errors(history: History, noise_sd: Mapping[str, Floats]) -> dict[str, SquaredErrors]:
    """Square what a filter and the held-out sensors differ by, by quantity of `quantities.HELD_OUT_QUANTITIES`.

    Positions and depths are judged by their drift over a minute, between corrections; a heading by itself. The sensor's
    noise is in both filters and makes them look equal: readings of a few seconds, in which no filter drifts, are
    averaged. The noise is that of one reading, by the sensor's name, SI; the first component stands for all.
    """
    found = {}
    for innovations in (met for met in history.innovations if met.is_held_out):
        sensor = innovations.measurement.removeprefix(HELD_OUT)
        if sensor == "heading":
            squared, sd_deg = (innovations.innovation.T / DEG) ** 2, float(noise_sd[sensor][0]) / DEG
            found[innovations.measurement] = SquaredErrors("deg", squared, 1, sd_deg)
        elif along := ALONG.get(sensor):
            apart_m = innovations.innovation[:, : len(along)]
            if len(history.corrected):
                rows = np.searchsorted(history.time_ns, innovations.time_ns, side="right") - 1
                corrected_m = north_east_down_m(history.position[rows], history.dead_reckoned[rows])
                apart_m = apart_m - corrected_m[:, along]
            first, counts, apart_m = _averaged(innovations, apart_m)
            since_ns = innovations.time_ns - innovations.time_ns[first].repeat(counts)
            mean_ns = innovations.time_ns[first] + np.asarray(np.add.reduceat(since_ns, first), np.int64) // counts
            segments = time_segments(mean_ns)
            change_m = apart_m[segments.last] - apart_m[segments.first]
            floor_m = math.sqrt(2.0 * len(along) / float(np.median(counts))) * float(noise_sd[sensor][0])
            squared = np.sum(change_m**2, axis=1)[None]
            found[innovations.measurement] = SquaredErrors("m", squared, segments.steps, floor_m)
    return {quantity: errors for quantity, errors in found.items() if errors.squared.shape[1] > 1}


def _averaged(innovations: Innovations, values: Floats) -> tuple[Rows, Rows, Floats]:
    """Average values, shape (k, s), of every few seconds; return the first rows, the counts, and the averages."""
    first = thinned(innovations.time_ns, STEP_S)
    counts = np.diff(first, append=len(values))
    return first, counts, np.add.reduceat(values, first) / counts[:, None]


def held_out_track(history: History) -> dict[str, float]:
    """Return by how much a filter's track differs from held-out fixes and depths: the rms and the last, m."""
    found: dict[str, float] = {}
    for innovations in (met for met in history.innovations if met.is_held_out and len(met.time_ns)):
        sensor = innovations.measurement.removeprefix(HELD_OUT)
        if along := ALONG.get(sensor):
            _, _, apart_m = _averaged(innovations, innovations.innovation[:, : len(along)])
            off_m = np.linalg.norm(apart_m, axis=1)
            found |= {sensor: float(np.sqrt(np.mean(off_m**2))), f"{sensor}_end": float(off_m[-1])}
    return found


# --- The table.


@dataclass(frozen=True)
class Measured:
    """What was measured of the filters of a dive."""

    accuracy: Mapping[str, Pair] = field(default_factory=dict)  # by candidate, against the reference
    outage: Mapping[str, Mapping[str, Floats]] = field(default_factory=dict)  # by filter and window: drifts, m
    convergence: Mapping[str, Mapping[str, MeasuredConvergence]] = field(default_factory=dict)  # by candidate, quantity
    held_out: Mapping[str, Pair] = field(default_factory=dict)  # by candidate, against held-out sensors
    track: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)  # by candidate, quantity
    partial: Collection[str] = ()  # candidates that are compared in what they tell alone


def evidence_table(
    log: str,
    baseline: str,
    candidates: Sequence[str],
    measured: Measured,
    consistency: Sequence[ConsistencyRow],
    credibility: Sequence[CredibilityRow],
) -> list[EvidenceRow]:
    """Compare each candidate with the baseline, piece by piece; the piece that decides first is in front."""
    rows: list[EvidenceRow] = []
    for candidate in candidates:
        named = log, candidate
        rows += _rows_of_squares((*named, "accuracy"), measured.accuracy.get(candidate, ({}, {})))
        for window, before in measured.outage.get(baseline, {}).items():
            after = measured.outage.get(candidate, {}).get(window)
            if after is not None and len(before):
                interval = windows_ratio(before, after)
                numbers = _rms(before**2), _rms(after**2), *_ends(interval)
                word, why, about = word_of(interval), _why(interval), (*named, "outage", f"outage_{window}", "m")
                rows.append(EvidenceRow(*about, *numbers, 1, len(before), word, interval.p, why))
        rows += _rows_of_squares((*named, "held_out"), measured.held_out.get(candidate, ({}, {})))
        for quantity, name in CONVERGED.items():
            found = measured.convergence.get(candidate, {}).get(name)
            if found is not None:
                ends = found.ratio, found.low, found.high, found.low90, found.high90
                interval = RatioInterval(*ends, float(found.starts), drawn_p=found.p)
                numbers, word = (found.baseline_s, found.candidate_s, *_ends(interval)), _word_of_convergence(interval)
                about = *named, "convergence", f"convergence_{quantity}", "s"
                rows.append(EvidenceRow(*about, *numbers, found.starts, 0, word, interval.p))
        for quantity, (off, now_off) in measured.track.get(candidate, {}).items():
            # One sample, which decides nothing alone.
            numbers = off, now_off, now_off / off if off > 0.0 else math.nan, math.nan, math.nan, 1.0
            about = *named, "track", quantity, TRACK[quantity][0]
            rows.append(EvidenceRow(*about, *numbers, 1, 0, EvidenceWord.UNDECIDED))
        rows += _consistency_rows(named, baseline, consistency, credibility, candidate in measured.partial)
    return rows


def without_words(rows: Sequence[EvidenceRow], not_evaluated: Collection[str]) -> list[EvidenceRow]:
    """Take the words from the evidence on candidates that are not evaluated: no gate on them may pass."""
    return [replace(row, word="") if row.filter in not_evaluated else row for row in rows]


def nothing_better(rows: Iterable[EvidenceRow]) -> list[EvidenceRow]:
    """Take the word *better* from evidence on a filter that a sensor surprises."""
    return [replace(row, word=EvidenceWord.UNDECIDED) if row.word == EvidenceWord.BETTER else row for row in rows]


def _rows_of_squares(named: tuple[str, str, str], pair: Pair) -> Iterator[EvidenceRow]:
    """Compare squared errors; a run with a start of its own is compared with the baseline's drawn starts."""
    shortest: RatioInterval | None = None
    for quantity, before in pair[0].items():
        if (after := pair[1].get(quantity)) is None:
            continue
        starts, windows = before.squared.shape
        largest = max(_rms(before.squared), _rms(after.squared))
        interval = paired_ratio(before.squared, after.squared, least_block=before.least_block)
        if quantity.startswith("drift"):
            # Longer segments smear one stretch over its neighbours: the shortest ones tell for all.
            shortest = shortest or interval
            if shortest.stretch is not None:
                samples = min(interval.effective_samples, shortest.effective_samples)
                interval = interval._replace(effective_samples=samples, stretch=shortest.stretch)
        # A word is kept where not all is the noise of the reference, and equivalence where hardly anything is.
        word, share = word_of(interval), before.floor / largest if largest else math.inf
        why = _why(interval, before.span_s)
        share = share if interval.low < interval.high else 0.0
        if share >= 1.0 or (share > NOISY and word == EvidenceWord.EQUIVALENT):
            why = why or (NOISE_OF_REFERENCE if word != EvidenceWord.UNDECIDED else "")
            word = EvidenceWord.UNDECIDED
        own = [errors.squared[0] if errors.own is None else errors.own for errors in (before, after)]
        known = np.isfinite(own[0]) & np.isfinite(own[1])
        numbers = _rms(own[0][known]), _rms(own[1][known]), *_ends(interval)
        yield EvidenceRow(*named, quantity, before.unit, *numbers, starts, windows, word, interval.p, why)


def _why(interval: RatioInterval, span_s: tuple[float, float] = (0.0, 0.0)) -> str:
    """Say why a row cannot decide: one stretch of the dive holds nearly all of the errors, or the samples are few."""
    if interval.effective_samples >= FEWEST_EFFECTIVE:
        return ""
    if interval.stretch is None:
        return f"fewer than {FEWEST_EFFECTIVE:.0f} effective samples"
    stretch_s = (span_s[1] - span_s[0]) / STRETCHES
    begun_s = span_s[0] + interval.stretch * stretch_s
    return f"nearly all of it from {begun_s:.0f} to {begun_s + stretch_s:.0f} s, which is one sample"


def _word_of_convergence(interval: RatioInterval) -> EvidenceWord:
    """Return the word on times of which a few of the drawn starts may make others: such are no equal ones, either."""
    word = word_of(interval)
    decisive = (interval.low, interval.high) if word == EvidenceWord.EQUIVALENT else (interval.ratio,)
    near = all(1.0 / (1.0 + SOONER) < ratio < 1.0 + SOONER for ratio in decisive)
    return word if near == (word == EvidenceWord.EQUIVALENT) else EvidenceWord.UNDECIDED


def _ends(interval: RatioInterval) -> tuple[float, float, float, float]:
    return interval.ratio, interval.low, interval.high, interval.independent


def _rms(squared: Floats) -> float:
    known = squared[np.isfinite(squared)]
    return math.sqrt(float(known.mean())) if known.size else math.nan


# --- Consistency as evidence; it has no weight for gain.


def _consistency_rows(
    named: tuple[str, str],
    baseline: str,
    consistency: Sequence[ConsistencyRow],
    credibility: Sequence[CredibilityRow],
    is_partial: bool,
) -> Iterator[EvidenceRow]:
    """Compare how far the mean NIS, and the mean NEES, is from what each filter expects.

    The worst measurement, and group of states, represents a filter; next to a partial solution, of the groups that it
    tells. Of the candidate's further sensors those count in which it is overconfident.
    """
    shared = {row.measurement for row in consistency if row.filter == baseline}
    told = {row.quantity for row in credibility if row.filter == named[1]}
    groups = told & set(ALL_CREDIBILITY_GROUPS) if is_partial else ALL_CREDIBILITY_GROUPS
    sizes = {
        "nis": [
            (row.filter, row.mean_nis, row.dof, row.verdict)
            for row in consistency
            if is_used(row.measurement) and (row.measurement in shared or row.verdict == Consistency.OVERCONFIDENT)
        ],
        "nees": [(row.filter, row.mean_nees, row.dof, row.verdict) for row in credibility if row.quantity in groups],
    }
    for quantity, found in sizes.items():
        worst = []
        for name in (baseline, named[1]):
            # Of the worst verdicts the largest mean over its degrees of freedom, of which 1 is expected. Small ones say
            # less: a filter starts on the reference, and what it keeps of that is as small as it happens to be.
            ranked = [(-1, -1.0, math.nan, "")]
            for owner, mean, dof, verdict in found:
                size, rank = finite(mean) / dof if dof else math.nan, -1
                if verdict in VERDICTS_BEST_FIRST:
                    rank = VERDICTS_BEST_FIRST.index(Consistency(verdict))
                if owner == name:
                    ranked.append((rank, -1.0 if math.isnan(size) else size, size, verdict))
            worst.append(max(ranked, key=lambda row: row[:2]))
        (rank, _, before, was), (new_rank, _, after, now) = worst
        if not (math.isfinite(before) and math.isfinite(after)):
            continue
        off, new_off = (abs(math.log(size)) if size > 0.0 else math.inf for size in (before, after))
        # A candidate is not more consistent for being overconfident instead.
        ratio, word, becomes_worse = math.exp(new_off - off), EvidenceWord.EQUIVALENT, new_rank > rank
        if Consistency.INSUFFICIENT in (was, now):
            word = EvidenceWord.UNDECIDED
        elif was == now == Consistency.CONSERVATIVE:
            word = EvidenceWord.EQUIVALENT  # both promise less than they keep
        elif ratio < 1.0 / NOTABLY and was != Consistency.CONSISTENT and not becomes_worse:
            word = EvidenceWord.BETTER
        elif now != Consistency.CONSISTENT and (ratio > NOTABLY or becomes_worse):
            word = EvidenceWord.WORSE
        numbers = before, after, ratio, math.nan, math.nan, math.nan
        yield EvidenceRow(*named, CONSISTENT, quantity, "", *numbers, 1, 0, word)
