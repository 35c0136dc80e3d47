"""The evidence on each candidate on one dive: two values of the same run, their ratio, and how far the candidate acts.

Both filters run on the same dive from the same start, so all errors are paired. *Accuracy* is against the reference,
after the filters have settled. *Track* is the error of the whole dive, once more from a drawn heading where only the
reference gave the heading at the start. *Outage* is the drift without the DVL.
*Held_out* is the difference from sensors that no filter gets. *Prediction* is how well a filter predicts the DVL.
*Convergence* is from drawn starts. *Consistency*
compares NIS and NEES, and never counts for better or worse. A ratio of one dive has no verdict: `answers` gives it
over dives.

How far a candidate acts is a proof: the error of the candidate is that of the baseline plus the difference of the two
runs, so by the triangle inequality the ratio of their root mean squares differs from 1 by at most the root mean square
of the difference over that of the baseline's error.
"""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final, NamedTuple

import msgspec
import numpy as np

from insdvl_replay.core.dive_columns import Floats, Integers, ReferenceColumns, TimeNs, seconds
from insdvl_replay.core.dive_record import ReferenceDelay
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.quantities import (
    ALL_CREDIBILITY_GROUPS,
    CONSISTENCY,
    CONVERGED,
    DRAWN_HEADING,
    DRIFT_STRETCHES,
    PREDICTION,
    PRIMARIES,
    SECONDARIES,
    TRACK,
    VERDICTS_BEST_FIRST,
    is_used,
)
from insdvl_replay.core.states import DEG, DV, PHI
from insdvl_replay.core.tables import ConsistencyRow, CredibilityRow, EvidenceRow, Number, finite
from insdvl_replay.core.words import Consistency, Role
from insdvl_replay.evaluation.convergence import MeasuredConvergence
from insdvl_replay.evaluation.drift import (
    STEP_S,
    course_errors,
    drift_segments,
    segment_change,
    time_segments,
)
from insdvl_replay.evaluation.prediction import Score
from insdvl_replay.evaluation.reference_errors import (
    WELL_COVERED,
    ReferenceErrors,
    covered_share,
    reference_distance_m,
)
from insdvl_replay.evaluation.series import thinned
from insdvl_replay.geometry.frames import north_east_down_m

# Quantities that a wrong heading changes only to second order.
HEADING_FREE: Final = ("velocity_along", "depth_60s")
SETTLED: Final = 1.2  # A sigma has settled once it stays below this many times the last one.
# Share of a dive, at most, that is left out until the sigma has settled.
MOST_LEFT_OUT: Final = 0.5
# Squared errors of the baseline beyond the noise of the reference count for at least this share of all.
LEAST_OWN_SHARE: Final = 0.1
FEWEST_WINDOWS: Final = 2  # of an outage row that may decide
# Sensors that measure the position, with their axes of n.
ALONG: Final = {
    "depth": [2],
    "position": [0, 1],
}


# --- Errors against the reference, and against held-out sensors.


class ReferenceNoise(NamedTuple):
    """Standard errors of the reference, each axis."""

    position_m: float
    velocity_mps: float
    attitude_deg: float


class ErrorSeries(NamedTuple):
    """Errors of one filter in one quantity."""

    unit: str
    errors: Floats  # (k, d), d components at k times or of k segments or windows, in the unit; NaN where unknown
    noise: float = 0.0  # root mean square of the reference's own error, over all components
    from_s: float = 0.0  # time after the start up to which errors are left out


Series = Mapping[str, ErrorSeries]  # by quantity
Pair = tuple[Series, Series]  # of the baseline and of a candidate


def accuracy_errors(
    errors: ReferenceErrors,
    reference: ReferenceColumns,
    noise: ReferenceNoise,
    # by quantity, time after the start up to which the baseline settles
    settled_s: Mapping[str, float],
    *,
    start_ns: int,
    bridged_gaps: bool,  # there were long IMU gaps, in which the position is lost
    stretches: Iterable[str] = DRIFT_STRETCHES,  # over which a drift is measured
) -> dict[str, ErrorSeries]:
    """Return the errors of one filter against the reference, by quantity of `quantities.ACCURACY`."""
    found = {}
    time_ns = errors.time_ns
    if not bridged_gaps and len(time_ns):
        travelled_m = reference_distance_m(reference, time_ns)
        for name in stretches:
            segments = drift_segments(name, time_ns, travelled_m)
            change_m = segment_change(errors, segments)[:, :2]
            # of both ends, two axes
            found[name] = ErrorSeries("m", change_m, 2.0 * noise.position_m)
        down_m = segment_change(errors, time_segments(time_ns))[:, 2:]
        found["depth_60s"] = ErrorSeries("m", down_m, math.sqrt(2.0) * noise.position_m)
    course = course_errors(errors, reference)
    attitude_deg = errors.attitude_error_rad / DEG
    sqrt_half = math.sqrt(0.5)  # level is the root mean square of roll and pitch
    of_times = {
        "velocity_along": ("m/s", course.along_mps[:, None], noise.velocity_mps),
        "velocity_across": ("m/s", course.across_mps[:, None], noise.velocity_mps),
        "level": ("deg", attitude_deg[:, :2] * sqrt_half, noise.attitude_deg),
        "heading": ("deg", attitude_deg[:, 2:], noise.attitude_deg),
    }
    for name, (unit, values, sd) in of_times.items():
        from_s = settled_s.get(name, 0.0)
        kept = seconds(time_ns, start_ns) >= from_s
        found[name] = ErrorSeries(unit, values[kept], sd, from_s)
    return {name: series for name, series in found.items() if len(series.errors) > 1}


def covered_errors(errors: ReferenceErrors, start_ns: int, end_ns: int) -> ReferenceErrors:
    """Return errors of which those are NaN that the reference covers for too little of the replay to stand for it."""

    def kept(columns: Floats) -> Floats:
        known = np.asarray(np.isfinite(columns).all(axis=1))
        if known.any() and covered_share(errors.time_ns, known, start_ns, end_ns) >= WELL_COVERED:
            return columns
        return np.full_like(columns, np.nan)

    horizontal_m = kept(errors.drifting_ned_m[:, :2])
    down_m = kept(errors.drifting_ned_m[:, 2:])
    return replace(
        errors,
        drifting_ned_m=np.hstack([horizontal_m, down_m]),
        velocity_error_n=kept(errors.velocity_error_n),
        attitude_error_rad=kept(errors.attitude_error_rad),
    )


def settling_times(baseline: History, time_ns: TimeNs) -> dict[str, float]:
    """Return how long the baseline's predicted sigma takes to settle, seconds after the start, by quantity.

    It has settled once it stays below `SETTLED` times its last value; `MOST_LEFT_OUT` of the dive at most is given.
    """
    if not len(time_ns):
        return {}
    rows = np.searchsorted(baseline.time_ns, time_ns)
    variance = baseline.sd[rows] ** 2
    time_s = seconds(time_ns, int(baseline.time_ns[0]))
    horizontal_mps = np.sqrt(variance[:, DV][:, :2].sum(axis=1))
    level = np.sqrt(variance[:, PHI][:, :2].sum(axis=1))
    heading = np.sqrt(variance[:, PHI][:, 2])
    velocity_s = _settled_s(time_s, horizontal_mps)
    return {
        "velocity_along": velocity_s,
        "velocity_across": velocity_s,
        "level": _settled_s(time_s, level),
        "heading": _settled_s(time_s, heading),
    }


def _settled_s(time_s: Floats, sigma: Floats) -> float:
    above = ~(sigma <= SETTLED * sigma[-1])
    if not above.any() or not np.isfinite(sigma[-1]):
        return 0.0
    last = int(np.flatnonzero(above)[-1])
    return float(min(time_s[min(last + 1, len(time_s) - 1)], MOST_LEFT_OUT * time_s[-1]))


def held_out_errors(history: History, noise_sd: Mapping[str, Floats]) -> dict[str, ErrorSeries]:
    """Return the differences of a filter and the held-out sensors, by quantity of `quantities.HELD_OUT_QUANTITIES`.

    Position and depth: drift over a minute, between corrections. Heading: the difference itself. The sensor's noise is
    in both differences and makes filters look equal, so readings of a few seconds are averaged. ``noise_sd`` is that of
    one reading, by the sensor's name, SI; the first component is used for all.
    """
    found = {}
    for met in history.innovations:
        sensor = met.held_out_sensor
        if sensor == "heading":
            sd_deg = float(noise_sd[sensor][0]) / DEG
            found[met.measurement] = ErrorSeries("deg", met.innovation / DEG, sd_deg)
        elif sensor in ALONG:
            found[met.measurement] = _held_out_drift(
                history, met, ALONG[sensor], float(noise_sd[sensor][0])
            )
    return {quantity: errors for quantity, errors in found.items() if len(errors.errors) > 1}


def _held_out_drift(
    history: History,
    met: Innovations,
    along: list[int],  # the axes of n that the sensor measures
    sd_m: float,  # of one reading
) -> ErrorSeries:
    """Return how far a filter drifts from a sensor of its position in a minute, without its corrections."""
    apart_m = met.innovation[:, : len(along)]
    if len(history.corrected):
        rows = np.searchsorted(history.time_ns, met.time_ns, side="right") - 1
        corrected_m = north_east_down_m(history.position[rows], history.dead_reckoned[rows])
        apart_m = apart_m - corrected_m[:, along]
    averages = _averaged(met.time_ns, apart_m)
    since_ns = met.time_ns - met.time_ns[averages.first].repeat(averages.counts)
    mean_since_ns = np.add.reduceat(since_ns, averages.first).astype(np.int64) // averages.counts
    segments = time_segments(met.time_ns[averages.first] + mean_since_ns)
    change_m = averages.values[segments.last] - averages.values[segments.first]
    noise_m = math.sqrt(2.0 * len(along) / averages.usual_count) * sd_m
    return ErrorSeries("m", change_m, noise_m)


Rows = Integers


class _Averages(NamedTuple):
    """Readings in groups of a few seconds."""

    first: Rows  # (g,), the first reading of each group
    counts: Rows  # (g,), readings of each
    values: Floats  # (g, s), their averages

    @property
    def usual_count(self) -> float:
        """The median number of readings of a group."""
        return float(np.median(self.counts))


def _averaged(time_ns: TimeNs, values: Floats) -> _Averages:
    """Average values, shape (k, s), over a few seconds."""
    first = thinned(time_ns, STEP_S)
    counts = np.diff(first, append=len(values))
    return _Averages(first, counts, np.add.reduceat(values, first) / counts[:, None])


def held_out_track(history: History, noise_sd: Mapping[str, Floats]) -> dict[str, ErrorSeries]:
    """Return the difference of a filter's track from held-out fixes and depths, by quantity of `quantities.TRACK`."""
    found = {}
    start_ns = int(history.time_ns[0])
    end_ns = int(history.time_ns[-1])
    for met in history.innovations:
        sensor = met.held_out_sensor
        if sensor not in ALONG or len(met.time_ns) < 2:
            continue
        known = np.asarray(np.isfinite(met.innovation).all(axis=1))
        if covered_share(met.time_ns, known, start_ns, end_ns) < WELL_COVERED:
            continue
        axes = len(ALONG[sensor])
        averages = _averaged(met.time_ns, met.innovation[:, :axes])
        noise_m = math.sqrt(axes / averages.usual_count) * float(noise_sd[sensor][0])
        found[sensor] = ErrorSeries("m", averages.values, noise_m)
    return found


# --- Two series of errors.


class Compared(NamedTuple):
    """Two filters in one quantity; NaN where it is not known."""

    baseline: float  # root mean squares, in the unit
    value: float
    moves: float  # root mean square of the difference
    acts: float  # the same over the error of the baseline
    noise_share: float  # of the reference, in the squared error of the baseline
    samples: int


def compared(before: ErrorSeries, after: ErrorSeries) -> Compared:
    """Compare two filters at the times at which both have an error."""
    known = ~(np.isnan(before.errors).any(axis=1) | np.isnan(after.errors).any(axis=1))
    errors = before.errors[known]
    new_errors = after.errors[known]
    # The errors of a filter that diverged may overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        baseline = _rms(errors)
        value = _rms(new_errors)
        moves = _rms(new_errors - errors)
    square = baseline**2
    noise_square = before.noise**2
    noise_share = math.nan
    if square > 0.0:
        noise_share = min(noise_square / square, 1.0)
    own_error = math.sqrt(max(square - noise_square, LEAST_OWN_SHARE * square))
    acts = math.nan
    if moves == 0.0:
        acts = 0.0
    elif own_error > 0.0:
        acts = moves / own_error
    return Compared(baseline, value, moves, acts, noise_share, int(known.sum()))


def _rms(errors: Floats) -> float:
    """Return the root mean square length of vectors, shape (k, d)."""
    if not len(errors):
        return math.nan
    return math.sqrt(float(np.mean(np.sum(errors**2, axis=1))))


# --- The table.


@dataclass(frozen=True)
class Measured:
    """All measured errors of the filters of a dive, as pairs of the baseline and of each candidate."""

    # by candidate, against the reference
    accuracy: Mapping[str, Pair] = field(default_factory=dict)
    # by candidate and window: horizontal drifts
    outage: Mapping[str, Pair] = field(default_factory=dict)
    # by candidate, against held-out sensors
    held_out: Mapping[str, Pair] = field(default_factory=dict)
    # by candidate: errors of position and depth
    track: Mapping[str, Pair] = field(default_factory=dict)
    # by candidate and quantity: rows of the track that are not a root mean square of these errors
    ends: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)
    # by candidate, quantity
    convergence: Mapping[str, Mapping[str, MeasuredConvergence]] = field(default_factory=dict)
    prediction: Mapping[str, Score] = field(default_factory=dict)  # by candidate
    # by candidate: of the position, m
    crps: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    drawn: int = 0  # starts behind the convergence
    # candidates that are compared only in the quantities that they have
    partial: Collection[str] = ()
    # Differences of velocities below it are those of a late reference, m/s; None where its delay is not known.
    late_mps: float | None = 0.0
    # whether the reference, or the held-out fixes, share no sensors with the filters
    independent: bool = True


def evidence_table(
    log: str,
    baseline: str,
    candidates: Sequence[str],
    measured: Measured,
    consistency: Sequence[ConsistencyRow],
    credibility: Sequence[CredibilityRow],
) -> list[EvidenceRow]:
    """Return the evidence rows of each candidate, those that may decide in front."""
    rows: list[EvidenceRow] = []
    for candidate in candidates:
        new = partial(EvidenceRow, log, candidate)
        rows += _track_rows(new, measured, candidate)
        rows += _rows_of_pair(new, "outage", measured.outage.get(candidate, ({}, {})))
        accuracy = _rows_of_pair(new, "accuracy", measured.accuracy.get(candidate, ({}, {})))
        rows += [_without_late_vote(row, measured.late_mps) for row in accuracy]
        rows += _rows_of_pair(new, "held_out", measured.held_out.get(candidate, ({}, {})))
        rows += _prediction_rows(new, measured, candidate)
        rows += _convergence_rows(new, measured.convergence.get(candidate, {}), measured.drawn)
        is_partial = candidate in measured.partial
        rows += _consistency_rows(new, baseline, candidate, consistency, credibility, is_partial)
    return rows


def _without_late_vote(row: EvidenceRow, late_mps: float | None) -> EvidenceRow:
    """Take the vote of a velocity where the reference may be late: it is then off by acceleration times delay.

    A filter that trusts late pings lags as the reference does, and would agree more with it.
    """
    if not row.quantity.startswith("velocity"):
        return row
    if late_mps is not None and finite(row.moves) >= late_mps:
        return row
    return msgspec.structs.replace(row, role=Role.SHOWN)


def _ratio(baseline: float, value: float) -> float:
    if baseline == value and math.isfinite(value):
        return 1.0
    if baseline > 0.0:
        return value / baseline
    return math.nan


def _rows_of_pair(new: Callable[..., EvidenceRow], kind: str, pair: Pair) -> Iterator[EvidenceRow]:
    """Compare two filters in the quantities that both have."""
    of_baseline, of_candidate = pair
    for quantity, before in of_baseline.items():
        if quantity not in of_candidate:
            continue
        found = compared(before, of_candidate[quantity])
        if not found.samples:
            continue
        yield new(
            evidence=kind,
            quantity=quantity,
            unit=before.unit,
            baseline=found.baseline,
            value=found.value,
            ratio=_ratio(found.baseline, found.value),
            moves=found.moves,
            acts=found.acts,
            reference_noise=found.noise_share,
            samples=found.samples,
            from_s=before.from_s or None,
            role=_role(quantity, found.samples),
        )


def role_alone(
    quantity: str,
    windows: int,
    *,
    independent: bool,
    delay: ReferenceDelay | None,
) -> Role:
    """Return what an error of a filter that was replayed alone may do, in another comparison than with a candidate.

    A velocity is shown only, where the reference may be late; ``delay`` is None in early results, which do not tell.
    """
    if quantity.startswith("velocity") and delay is not None and not delay.is_checked:
        return Role.SHOWN
    return _role(quantity, windows, may_decide=independent or quantity != "position")


def _role(quantity: str, samples: int, *, may_decide: bool = True) -> Role:
    """Return what a row of a dive may do."""
    has_few_windows = quantity.startswith("outage") and samples < FEWEST_WINDOWS
    if quantity in PRIMARIES and may_decide and not has_few_windows:
        return Role.PRIMARY
    if any(quantity in kind for kind in SECONDARIES.values()):
        return Role.SECONDARY
    return Role.SHOWN


def _track_rows(
    new: Callable[..., EvidenceRow], measured: Measured, candidate: str
) -> Iterator[EvidenceRow]:
    """Compare the tracks of the whole dive. Position decides if what it is compared with is independent."""
    pair = measured.track.get(candidate, ({}, {}))
    rows = {row.quantity: row for row in _rows_of_pair(new, "track", pair)}
    if "position" in rows:
        role = _role("position", rows["position"].samples, may_decide=measured.independent)
        rows["position"] = msgspec.structs.replace(rows["position"], role=role)
    ends = measured.ends.get(candidate, {})
    for quantity, (unit, _, _) in TRACK.items():
        if quantity in rows:
            yield rows[quantity]
        elif quantity in ends:
            before, after = ends[quantity]
            yield new(
                evidence="track",
                quantity=quantity,
                unit=unit,
                baseline=before,
                value=after,
                ratio=_ratio(before, after),
                samples=1,
            )
    if DRAWN_HEADING in rows:
        yield rows[DRAWN_HEADING]


def _prediction_rows(
    new: Callable[..., EvidenceRow], measured: Measured, candidate: str
) -> Iterator[EvidenceRow]:
    """Compare how well two filters predict the DVL, and how well the position."""
    if candidate in measured.prediction:
        score = measured.prediction[candidate]
        yield new(
            evidence=PREDICTION,
            quantity=PREDICTION,
            unit="nat",
            baseline=score.baseline,
            value=score.value,
            ratio=score.ratio,
            samples=score.pings,
            role=Role.VETO,
        )
    if candidate in measured.crps:
        before, after = measured.crps[candidate]
        yield new(
            evidence=PREDICTION,
            quantity="position_crps",
            unit="m",
            baseline=before,
            value=after,
            ratio=_ratio(before, after),
            samples=1,
        )


def _convergence_rows(
    new: Callable[..., EvidenceRow], converged: Mapping[str, MeasuredConvergence], drawn: int
) -> Iterator[EvidenceRow]:
    """Compare the times after which two filters have settled, from drawn starts."""
    for quantity, name in CONVERGED.items():
        if name not in converged:
            continue
        found = converged[name]
        yield new(
            evidence="convergence",
            quantity=f"convergence_{quantity}",
            unit="s",
            baseline=found.baseline_s,
            value=found.candidate_s,
            ratio=found.candidate_s / found.baseline_s,
            samples=drawn,
            starts=drawn,
            role=Role.SETTLING,
        )


# --- Consistency as evidence; it decides nothing.


_RANK: Final[Mapping[str, int]] = {word: rank for rank, word in enumerate(VERDICTS_BEST_FIRST)}


class _Size(NamedTuple):
    """A mean NIS or NEES over its degrees of freedom, of which 1 is expected, and its verdict."""

    filter: str
    size: float
    verdict: str

    @staticmethod
    def of_mean(row: ConsistencyRow | CredibilityRow, mean: Number) -> "_Size":
        size = math.nan
        if row.dof:
            size = finite(mean) / row.dof
        return _Size(row.filter, size, row.verdict)

    @property
    def is_known(self) -> bool:
        return math.isfinite(self.size)

    @property
    def off(self) -> float:
        """How far the size is from 1: the logarithm of its factor, infinite for zero."""
        if self.size > 0.0:
            return abs(math.log(self.size))
        return math.inf

    @property
    def order(self) -> tuple[int, float]:
        """Sort key: the worst verdict is last, then the largest size, and what is not known is first.

        Small sizes are less certain, since a filter that starts on the reference has small errors for a while.
        """
        rank = _RANK.get(self.verdict, -1)
        if math.isnan(self.size):
            return rank, -1.0
        return rank, self.size


def _consistency_rows(
    new: Callable[..., EvidenceRow],
    baseline: str,
    candidate: str,
    consistency: Sequence[ConsistencyRow],
    credibility: Sequence[CredibilityRow],
    is_partial: bool,
) -> Iterator[EvidenceRow]:
    """Compare how far NIS and NEES are from what each filter expects; the ratio is that of the distances from 1."""
    sizes_of = _consistency_sizes(baseline, consistency, credibility, candidate, is_partial)
    for quantity, sizes in sizes_of.items():
        before = _worst(sizes, baseline)
        after = _worst(sizes, candidate)
        if before is None or after is None or not (before.is_known and after.is_known):
            continue
        ratio = math.nan
        if math.isfinite(before.off):
            ratio = math.exp(after.off - before.off)
        yield new(
            evidence=CONSISTENCY,
            quantity=quantity,
            unit="",
            baseline=before.size,
            value=after.size,
            ratio=ratio,
        )


def _worst(sizes: Sequence[_Size], name: str) -> _Size | None:
    """Return the size of a filter with the worst verdict; None if it has no size."""
    own = [size for size in sizes if size.filter == name]
    return max(own, key=lambda size: size.order, default=None)


def _consistency_sizes(
    baseline: str,
    consistency: Sequence[ConsistencyRow],
    credibility: Sequence[CredibilityRow],
    candidate: str,
    is_partial: bool,
) -> dict[str, list[_Size]]:
    """Return the sizes of all measurements and of all groups of states.

    Further sensors of the candidate count only if it is overconfident in them. A partial solution has only some groups.
    """
    shared = {row.measurement for row in consistency if row.filter == baseline}
    compared_groups = set(ALL_CREDIBILITY_GROUPS)
    if is_partial:
        compared_groups &= {row.quantity for row in credibility if row.filter == candidate}
    nis = []
    for row in consistency:
        counts = row.measurement in shared or row.verdict == Consistency.OVERCONFIDENT
        if counts and is_used(row.measurement):
            nis.append(_Size.of_mean(row, row.mean_nis))
    nees = [
        _Size.of_mean(row, row.mean_nees) for row in credibility if row.quantity in compared_groups
    ]
    return {"nis": nis, "nees": nees}
