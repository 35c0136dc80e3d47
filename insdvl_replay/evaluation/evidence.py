"""The evidence on each candidate: measured values, the ratio with its interval, and a verdict
(`series.verdict_of_interval`).

Both filters run on the same dive, so all errors are paired. *Accuracy* is against the reference, from the same drawn
starts. *Outage* is the drift without the DVL. *Held_out* is the difference from sensors that no filter gets.
*Convergence* is from random starts. *Track* is the error of the whole dive. *Consistency* compares NIS and NEES, and
never counts for better or worse. Positions are compared by their drift: the error itself is one number, which the
heading at the start determines.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.quantities import (
    ALL_CREDIBILITY_GROUPS,
    CONSISTENCY,
    CONVERGED,
    HELD_OUT,
    TRACK,
    VERDICTS_BEST_FIRST,
    is_used,
)
from insdvl_replay.core.states import DEG, PHI
from insdvl_replay.core.tables import ConsistencyRow, CredibilityRow, EvidenceRow, Number, finite
from insdvl_replay.core.words import Consistency, EvidenceVerdict
from insdvl_replay.evaluation.convergence import MeasuredConvergence
from insdvl_replay.evaluation.drift import (
    STEP_S,
    course_errors,
    distance_segments,
    segment_drift,
    time_segments,
)
from insdvl_replay.evaluation.reference_errors import (
    WELL_COVERED,
    DrawnErrors,
    covered_share,
    reference_distance_m,
    where_known,
)
from insdvl_replay.evaluation.series import (
    FEWEST_EFFECTIVE,
    NO_INTERVAL,
    STRETCHES,
    RatioInterval,
    paired_ratio,
    thinned,
    verdict_of_interval,
    windows_ratio,
)
from insdvl_replay.geometry.frames import north_east_down_m

SEGMENTS_S: Final = (30.0, 60.0)
DRIFTS: Final = ("drift_30s", "drift_60s", "drift_100m")
# Quantities that a wrong heading changes only to second order.
HEADING_FREE: Final = ("velocity_along", "depth_60s")
OF_STARTS: Final = ("level", "heading")  # Quantities that need random starts.
# With fewer, level and heading are no evidence, since each start is one sample. Nor is a prediction confirmed: most of
# it is the decay of errors of the start.
FEWEST_STARTS: Final = 8
# A smaller difference of convergence does not decide: its interval is over starts, and a dive has one sensor error.
SOONER: Final = 0.25
NOISE_OF_REFERENCE: Final = "mostly noise of the reference"
# Share of the reference's noise in a root mean square, above which equivalence is not decided.
NOISY: Final = 0.4
NOTABLY: Final = 1.1  # A mean NIS or NEES nearer to its degrees of freedom by less is as consistent.
ALONG: Final = {"depth": [2], "position": [0, 1]}  # Sensors that measure the position, with their axes of n.


# --- Squared errors against the reference, and against held-out sensors.


class ReferenceNoise(NamedTuple):
    """Standard errors of the reference, each axis."""

    position_m: float
    velocity_mps: float
    attitude_deg: float


class SquaredErrors(NamedTuple):
    """Squared errors of one filter in one quantity."""

    unit: str
    squared: Floats  # (s, k), of s starts at k times or segments, in the unit squared
    least_block: int  # number of neighbours with common data
    floor: float  # root mean square of the reference's own error
    own: Floats | None = None  # (k,), from the dive's own start; None where that is the first of the s
    span_s: tuple[float, float] = (0.0, 0.0)  # first and last time, seconds from the start


def accuracy_errors(
    drawn: DrawnErrors,
    reference: ReferenceColumns,
    noise: ReferenceNoise,
    *,
    bridged_gaps: bool,  # there were long IMU gaps, in which the position is lost
    covered: DrawnErrors | None = None,  # the runs that the reference must cover, if not these
) -> dict[str, SquaredErrors]:
    """Square the errors of one filter, by quantity of `quantities.ACCURACY`, in its order.

    Quantities that the reference covers for less than `reference_errors.WELL_COVERED` of the runs are left out.
    """
    time_ns, whole = drawn.time_ns, covered or drawn
    start_ns = int(whole.time_ns[0] - round(whole.time_s[0] * 1e9)) if len(whole.time_ns) else 0
    span_s = (float(drawn.time_s[0]), float(drawn.time_s[-1])) if len(drawn.time_s) else (0.0, 0.0)

    def is_covered(columns: Floats) -> bool:
        known = np.asarray(np.isfinite(columns).all(axis=1))
        share = covered_share(whole.time_ns, known, start_ns, int(whole.time_ns[-1])) if known.any() else 0.0
        return share >= WELL_COVERED

    found = {}
    segments_of = {length_s: time_segments(time_ns, length_s) for length_s in SEGMENTS_S}
    if is_covered(whole.position_error_ned_m[0, :, :2]) and not bridged_gaps:
        along = distance_segments(time_ns, reference_distance_m(reference, time_ns))
        for name, segments in zip(DRIFTS, (*segments_of.values(), along), strict=True):
            drift_m, floor_m = segment_drift(drawn, segments).horizontal_m, 2.0 * noise.position_m  # of both ends
            found[name] = SquaredErrors("m", drift_m**2, segments.steps, floor_m)
    if is_covered(whole.velocity_error_n[0, :, :2]):
        for name, error_mps in course_errors(drawn, reference)._asdict().items():
            found[f"velocity_{name.removesuffix('_mps')}"] = SquaredErrors("m/s", error_mps**2, 1, noise.velocity_mps)
    if is_covered(whole.position_error_ned_m[0, :, 2:]) and not bridged_gaps:
        down_m, floor_m = segment_drift(drawn, segments_of[60.0]).down_m, math.sqrt(2.0) * noise.position_m
        found["depth_60s"] = SquaredErrors("m", down_m**2, segments_of[60.0].steps, floor_m)
    if len(drawn.error) >= FEWEST_STARTS and is_covered(whole.error[0, :, PHI]):
        squared = (drawn.error[:, :, PHI] / DEG) ** 2
        for quantity, square in zip(OF_STARTS, (squared[..., :2].mean(axis=-1), squared[..., 2]), strict=True):
            found[quantity] = SquaredErrors("deg", square[1:], 1, noise.attitude_deg, square[0])
    return {name: errors._replace(span_s=span_s) for name, errors in found.items() if errors.squared.shape[1] > 1}


Rows = NDArray[np.int64]
# Those of the baseline and of a candidate, by quantity.
Pair = tuple[Mapping[str, SquaredErrors], Mapping[str, SquaredErrors]]


def accuracy_pair(
    drawn: DrawnErrors,
    single: DrawnErrors,
    reference: ReferenceColumns,
    noise: ReferenceNoise,
    *,
    bridged_gaps: bool,
    given_heading: bool,  # the single run starts with the heading of the reference
) -> Pair:
    """Square the errors of a filter, and of a run with its own start, at the times that both have.

    The reference must cover the filter's runs; the single run may be shorter. Level and heading are left out: the
    filter's errors are from its random starts, and the single run has none.
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
    """Square the differences of a filter and the held-out sensors, by quantity of `quantities.HELD_OUT_QUANTITIES`.

    Position and depth: drift over a minute, between corrections. Heading: the difference itself. The sensor's noise is
    in both differences and makes filters look equal, so readings of a few seconds are averaged. ``noise_sd`` is that of
    one reading, by the sensor's name, SI; the first component is used for all.
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
    """Average values, shape (k, s), over a few seconds; return the first rows, the counts, and the averages."""
    first = thinned(innovations.time_ns, STEP_S)
    counts = np.diff(first, append=len(values))
    return first, counts, np.add.reduceat(values, first) / counts[:, None]


def held_out_track(history: History) -> dict[str, float]:
    """Return the difference of a filter's track from held-out fixes and depths: the rms and the last, m."""
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
    """All measured errors of the filters of a dive."""

    accuracy: Mapping[str, Pair] = field(default_factory=dict)  # by candidate, against the reference
    # by candidate, of the baseline and its own: drifts by window, m
    outage: Mapping[str, tuple[Mapping[str, Floats], Mapping[str, Floats]]] = field(default_factory=dict)
    convergence: Mapping[str, Mapping[str, MeasuredConvergence]] = field(default_factory=dict)  # by candidate, quantity
    held_out: Mapping[str, Pair] = field(default_factory=dict)  # by candidate, against held-out sensors
    track: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)  # by candidate, quantity
    partial: Collection[str] = ()  # candidates that are compared only in the quantities that they have


def evidence_table(
    log: str,
    baseline: str,
    candidates: Sequence[str],
    measured: Measured,
    consistency: Sequence[ConsistencyRow],
    credibility: Sequence[CredibilityRow],
) -> list[EvidenceRow]:
    """Return the evidence rows of each candidate; the row that decides first is in front."""
    rows: list[EvidenceRow] = []
    for candidate in candidates:
        new = partial(_row, log, candidate)
        rows += _rows_of_squares(partial(new, "accuracy"), measured.accuracy.get(candidate, ({}, {})))
        baseline_drifts, drifts = measured.outage.get(candidate, ({}, {}))
        for window, before in baseline_drifts.items():
            if window in drifts and len(before):
                interval, values = windows_ratio(before, drifts[window]), (_rms(before**2), _rms(drifts[window] ** 2))
                why = _why(interval)
                rows.append(new("outage", f"outage_{window}", "m", values, interval, windows=len(before), why=why))
        rows += _rows_of_squares(partial(new, "held_out"), measured.held_out.get(candidate, ({}, {})))
        converged = measured.convergence.get(candidate, {})
        for quantity, name in CONVERGED.items():
            if (found := converged.get(name)) is not None:
                # With other random starts the times may differ, so they are not equivalent either.
                interval, word = found.interval, verdict_of_interval(found.interval)
                decisive = (interval.low, interval.high) if word == EvidenceVerdict.EQUIVALENT else (interval.ratio,)
                near = all(1.0 / (1.0 + SOONER) < ratio < 1.0 + SOONER for ratio in decisive)
                word = word if near == (word == EvidenceVerdict.EQUIVALENT) else EvidenceVerdict.UNDECIDED
                values, starts = (found.baseline_s, found.candidate_s), int(interval.effective_samples)
                rows.append(
                    new("convergence", f"convergence_{quantity}", "s", values, interval, verdict=word, starts=starts)
                )
        for quantity, values in measured.track.get(candidate, {}).items():
            # One sample, which does not decide alone.
            ratio = values[1] / values[0] if values[0] > 0.0 else math.nan
            interval = NO_INTERVAL._replace(ratio=ratio, effective_samples=1.0)
            rows.append(new("track", quantity, TRACK[quantity][0], values, interval))
        is_partial = candidate in measured.partial
        sizes_of = _consistency_sizes(baseline, candidate, consistency, credibility, is_partial)
        for quantity, sizes in sizes_of.items():
            off, now = (
                max((found for found in sizes if found.filter == name), key=lambda found: found.order, default=None)
                for name in (baseline, candidate)
            )
            if off and now and math.isfinite(off.size) and math.isfinite(now.size):
                ratio, word = _more_consistent(off, now)
                interval = NO_INTERVAL._replace(ratio=ratio, effective_samples=math.nan)
                rows.append(new(CONSISTENCY, quantity, "", (off.size, now.size), interval, verdict=word))
    return rows


def _row(
    log: str,
    candidate: str,
    evidence: str,
    quantity: str,
    unit: str,
    values: tuple[float, float],  # of the baseline and of the candidate
    interval: RatioInterval,
    *,
    verdict: EvidenceVerdict | None = None,  # if not that of the interval
    starts: int = 1,
    windows: int = 0,
    why: str = "",
) -> EvidenceRow:
    return EvidenceRow(
        log=log,
        filter=candidate,
        evidence=evidence,
        quantity=quantity,
        unit=unit,
        baseline=values[0],
        value=values[1],
        ratio=interval.ratio,
        low=interval.low,
        high=interval.high,
        effective_samples=interval.independent,
        starts=starts,
        windows=windows,
        verdict=verdict or verdict_of_interval(interval),
        p=None if math.isnan(interval.low) else interval.p,
        why=why,
    )


def _rows_of_squares(new: Callable[..., EvidenceRow], pair: Pair) -> Iterator[EvidenceRow]:
    """Compare squared errors; a run with its own start is compared with the baseline's random starts."""
    shortest: RatioInterval | None = None
    for quantity in (name for name in pair[0] if name in pair[1]):
        before, after = (errors[quantity] for errors in pair)
        interval = paired_ratio(before.squared, after.squared, least_block=before.least_block)
        if quantity.startswith("drift"):
            # Longer segments spread one stretch over its neighbours, so the shortest segments decide for all.
            shortest = shortest or interval
            if shortest.stretch is not None:
                samples = min(interval.effective_samples, shortest.effective_samples)
                interval = interval._replace(effective_samples=samples, stretch=shortest.stretch)
        # A verdict needs errors above the reference's noise; equivalence needs little noise.
        word, why = verdict_of_interval(interval), _why(interval, before.span_s)
        noise, largest = before.floor, max(_rms(before.squared), _rms(after.squared))
        noisy = noise >= largest or (noise > NOISY * largest and word == EvidenceVerdict.EQUIVALENT)
        if noisy and interval.low < interval.high:
            why = why or (NOISE_OF_REFERENCE if word != EvidenceVerdict.UNDECIDED else "")
            word = EvidenceVerdict.UNDECIDED
        start_sq = [errors.squared[0] if errors.own is None else errors.own for errors in (before, after)]
        known = np.isfinite(start_sq[0]) & np.isfinite(start_sq[1])
        values, (starts, windows) = (_rms(start_sq[0][known]), _rms(start_sq[1][known])), before.squared.shape
        yield new(quantity, before.unit, values, interval, verdict=word, starts=starts, windows=windows, why=why)


def _why(interval: RatioInterval, span_s: tuple[float, float] = (0.0, 0.0)) -> str:
    """Say why a row does not decide: one stretch holds nearly all errors, or there are too few samples."""
    if interval.effective_samples >= FEWEST_EFFECTIVE:
        return ""
    if interval.stretch is None:
        return f"fewer than {FEWEST_EFFECTIVE:.0f} effective samples"
    if span_s[1] <= span_s[0]:
        return "nearly all error in one stretch"
    stretch_s = (span_s[1] - span_s[0]) / STRETCHES
    begun_s = span_s[0] + interval.stretch * stretch_s
    return f"nearly all error in {begun_s:.0f} to {begun_s + stretch_s:.0f} s"


def _rms(squared: Floats) -> float:
    known = squared[np.isfinite(squared)]
    return math.sqrt(float(known.mean())) if known.size else math.nan


# --- Consistency as evidence; it has no vote.


_RANK: Final[Mapping[str, int]] = {word: rank for rank, word in enumerate(VERDICTS_BEST_FIRST)}


class _Size(NamedTuple):
    """A mean NIS or NEES over its degrees of freedom, of which 1 is expected, and its verdict."""

    filter: str
    size: float
    verdict: str

    @staticmethod
    def of_mean(row: ConsistencyRow | CredibilityRow, mean: Number) -> "_Size":
        return _Size(row.filter, finite(mean) / row.dof if row.dof else math.nan, row.verdict)

    @property
    def order(self) -> tuple[int, float]:
        """Sort key: the worst verdict is last, then the largest size.

        Small sizes are less certain, since a filter that starts on the reference has small errors for a while.
        """
        return _RANK.get(self.verdict, -1), -1.0 if math.isnan(self.size) else self.size


def _consistency_sizes(
    baseline: str,
    candidate: str,
    consistency: Sequence[ConsistencyRow],
    credibility: Sequence[CredibilityRow],
    is_partial: bool,
) -> dict[str, list[_Size]]:
    """Return the sizes of all measurements and of all groups of states.

    Further sensors of the candidate count only if it is overconfident in them. A partial solution has only some groups.
    """
    shared = {row.measurement for row in consistency if row.filter == baseline}
    given = {row.quantity for row in credibility if row.filter == candidate}
    groups = given & set(ALL_CREDIBILITY_GROUPS) if is_partial else ALL_CREDIBILITY_GROUPS
    return {
        "nis": [
            _Size.of_mean(row, row.mean_nis)
            for row in consistency
            if is_used(row.measurement) and (row.measurement in shared or row.verdict == Consistency.OVERCONFIDENT)
        ],
        "nees": [_Size.of_mean(row, row.mean_nees) for row in credibility if row.quantity in groups],
    }


def _more_consistent(before: _Size, after: _Size) -> tuple[float, EvidenceVerdict]:
    """Compare the distances of the sizes from 1; an overconfident candidate is never more consistent."""
    off, new_off = (abs(math.log(found.size)) if found.size > 0.0 else math.inf for found in (before, after))
    ratio, becomes_worse = math.exp(new_off - off), after.order[0] > before.order[0]
    if Consistency.INSUFFICIENT in (before.verdict, after.verdict):
        return ratio, EvidenceVerdict.UNDECIDED
    if before.verdict == after.verdict == Consistency.CONSERVATIVE:
        return ratio, EvidenceVerdict.EQUIVALENT  # both are better than they predict
    if ratio < 1.0 / NOTABLY and before.verdict != Consistency.CONSISTENT and not becomes_worse:
        return ratio, EvidenceVerdict.BETTER
    if after.verdict != Consistency.CONSISTENT and (ratio > NOTABLY or becomes_worse):
        return ratio, EvidenceVerdict.WORSE
    return ratio, EvidenceVerdict.EQUIVALENT
