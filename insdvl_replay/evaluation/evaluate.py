"""All tables of a dive: the filters compared with the reference and with each other.

`tables_of_filters` fills the tables, and `curves_of` keeps what is drawn over time. `verdicts` puts the evidence in
words.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns, TimeNs, seconds
from insdvl_replay.core.dive_record import ReferenceDelay
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import DRAWN_HEADING, DRIFT_STRETCHES, TRACK
from insdvl_replay.core.states import DEG, POSITION
from insdvl_replay.core.tables import (
    ConvergenceRow,
    CredibilityRow,
    JumpRow,
    OutageRow,
    ReferenceErrorRow,
    Tables,
    WhereRow,
    finite,
)
from insdvl_replay.core.words import DelayStatus, ReferenceStatus
from insdvl_replay.evaluation.consistency import consistency_table
from insdvl_replay.evaluation.convergence import (
    ConvergenceCurves,
    MeasuredConvergence,
    convergence_curves,
    convergence_table,
    improvement_table,
    measured_convergences,
)
from insdvl_replay.evaluation.credibility import (
    StateErrors,
    credibility_table,
    settled_table,
    state_errors,
)
from insdvl_replay.evaluation.drift import drift_table, track_fit_table
from insdvl_replay.evaluation.evidence import (
    HEADING_FREE,
    ErrorSeries,
    Measured,
    ReferenceNoise,
    Series,
    accuracy_errors,
    covered_errors,
    evidence_table,
    held_out_errors,
    held_out_track,
    settling_times,
)
from insdvl_replay.evaluation.outage_test import (
    OutageCurve,
    OutageRuns,
    outage_curves,
    outage_test_table,
    window_drifts,
)
from insdvl_replay.evaluation.prediction import Score, crps, prediction_of
from insdvl_replay.evaluation.reference_errors import (
    WELL_COVERED,
    DrawnErrors,
    ReferenceErrors,
    covered_share,
    reference_error_table,
    reference_errors,
    run_from_start,
)
from insdvl_replay.evaluation.where import QUANTITY, where_table

# At most this number of P (23 MB) is kept for the evaluation of errors; a longer dive is evaluated at fewer times.
MOST_COVARIANCES: Final = 20_000
FEWEST_ROWS: Final = 3  # of a reference whose acceleration is known


def evaluated_times(
    reference: ReferenceColumns | None,
    start_ns: int,
    end_ns: int,
    *,
    filters: int,
) -> TimeNs:
    """Choose the times at which P is kept for the evaluation of errors: all of the reference, or evenly chosen ones."""
    if reference is None:
        return np.empty(0, dtype=np.int64)
    inside_ns = reference.time_ns[(reference.time_ns >= start_ns) & (reference.time_ns <= end_ns)]
    every = math.ceil(len(inside_ns) * filters / MOST_COVARIANCES)
    return inside_ns[:: max(every, 1)]


# --- The tables.


def tables_of_filters(
    dive: Dive,
    histories: tuple[History, ...],  # the first is the baseline
    # of those that were run here, from a start as uncertain as [initial]
    spread: tuple[History, ...],
    drawn: tuple[DrawnErrors, ...],  # of the filters, in the same order; empty without a reference
    outages: OutageRuns,
    user_outages: Mapping[str, OutageRuns],  # by filter of the user's, with the baseline's runs
    noise: ReferenceNoise,
    # (s,), noise of one reading of each sensor that may be held out
    sensor_sd: Mapping[str, Floats],
    jumps: list[JumpRow],  # from `drift.jump_table`
    *,
    # of those that depend on the heading at the start, from a drawn one
    turned: tuple[History, ...] = (),
    start_ns: int,
    bridged_gaps: bool,  # the filters went through long gaps of the IMU
    independent: bool,  # the reference shares no sensors with the filters
    lost_m: float,  # position error above which a vehicle counts as lost
) -> tuple[dict[str, ReferenceErrors], Tables]:
    """Compare the filters with the reference and with each other; return their errors by filter, too."""
    log = dive.name
    reference = dive.reference
    baseline, *candidates = histories
    names = [history.filter for history in histories]
    errors = {}
    in_states = {}
    drift = []
    fits = []
    settled_s = {}
    if reference is not None:
        for history in histories:
            errors[history.filter] = reference_errors(history, reference, baseline)
            in_states[history.filter] = state_errors(history, reference, dive.truth).after(
                start_ns
            )
        drift = drift_table(
            log, errors, reference, start_ns, lost_m=lost_m, bridged_gaps=bridged_gaps
        )
        if not bridged_gaps:
            fits = track_fit_table(log, errors, reference)
        settled_s = settling_times(baseline, errors[baseline.filter].time_ns)
    convergence = {found.filter: measured_convergences(drawn[0], found) for found in drawn[1:]}
    reference_error = reference_error_table(log, histories, errors, bridged_gaps=bridged_gaps)
    consistency = consistency_table(log, histories, sensor_sd)
    credibility = credibility_table(log, names, in_states)
    if independent:
        credibility += _settled_rows(dive, in_states, baseline.filter, start_ns, settled_s, noise)

    in_time = accuracy_series(
        histories, errors, reference, noise, settled_s, bridged_gaps=bridged_gaps
    )
    held_out = {history.filter: held_out_errors(history, sensor_sd) for history in histories}
    tracks = track_series(histories, errors, noise, bridged_gaps=bridged_gaps)
    track_pairs = _track_pairs(histories, tracks, sensor_sd)
    from_drawn = turned_pairs(turned, reference, noise, sensor_sd, bridged_gaps=bridged_gaps)
    for name, (before_drawn, after_drawn) in from_drawn.items():
        before, after = track_pairs[name]
        track_pairs[name] = ({**before, **before_drawn}, {**after, **after_drawn})
    by_reference = any("position" in series for series in tracks.values())
    measured = Measured(
        accuracy=pairs_of(baseline, candidates, in_time),
        outage=_outage_pairs(names, outages, user_outages),
        held_out=pairs_of(baseline, candidates, held_out),
        track=track_pairs,
        ends=ends_of(candidates, reference_error),
        convergence=convergence,
        prediction=predictions(histories, outages, user_outages, settled_s),
        crps=_crps_pairs(histories, errors),
        # The dive's own start is the first, and no convergence is from it.
        drawn=max((len(found.error) - 1 for found in drawn), default=0),
        partial=[history.filter for history in candidates if history.is_partial],
        late_mps=late_mps(reference, dive.reference_delay),
        # Held-out fixes are independent of the filters.
        independent=independent or not by_reference,
    )
    return errors, Tables(
        improvement=improvement_table(log, histories),
        convergence=_convergence_rows(log, histories, spread, convergence),
        reference_error=reference_error,
        consistency=consistency,
        credibility=credibility,
        evidence=evidence_table(log, names[0], names[1:], measured, consistency, credibility),
        outage=_outage_rows(log, outages, user_outages),
        drift=drift,
        track_fit=fits,
        jumps=jumps,
        where=_where_rows(dive, histories, errors, in_time),
    )


def _where_rows(
    dive: Dive,
    histories: Sequence[History],  # the first is the baseline
    errors: Mapping[str, ReferenceErrors],  # by filter
    in_time: Mapping[str, Series],  # from `accuracy_series`
) -> list[WhereRow]:
    """Return the drift by what the vehicle does; no rows without a reference that covers the dive."""
    if dive.reference is None:
        return []
    drifts = {}
    for name, series in in_time.items():
        if QUANTITY in series:
            drifts[name] = series[QUANTITY].errors
    time_ns = errors[histories[0].filter].time_ns
    return where_table(dive.name, histories, drifts, time_ns, dive.reference, dive.dvl)


def _settled_rows(
    dive: Dive,
    in_states: Mapping[str, StateErrors],  # by filter
    baseline: str,
    start_ns: int,
    settled_s: Mapping[str, float],  # by quantity
    noise: ReferenceNoise,
) -> list[CredibilityRow]:
    """Return whether the baseline is fit to judge by; nothing without a reference that is on time."""
    if dive.reference is None or not is_on_time(dive.reference_delay):
        return []
    return settled_table(
        dive.name,
        in_states[baseline],
        dive.reference,
        start_ns,
        settled_s,
        velocity_sd_mps=noise.velocity_mps,
        attitude_sd_rad=noise.attitude_deg * DEG,
    )


def is_on_time(delay: ReferenceDelay | None) -> bool:
    """Return whether the errors against a reference hold no motion in its delay, as far as this can be known."""
    if delay is None or delay.status == DelayStatus.NO_ATTITUDE:
        return False
    return not delay.is_late


def _convergence_rows(
    log: str,
    histories: Sequence[History],
    spread: tuple[History, ...],
    measured: Mapping[str, Mapping[str, MeasuredConvergence]],
) -> list[ConvergenceRow]:
    """Compare the built-in filters from uncertain starts, the others from the dive's own start."""
    run_here = {history.filter for history in spread}
    baseline, *candidates = histories
    others = [history for history in candidates if history.filter not in run_here]
    from_spread = convergence_table(log, spread, measured)
    return from_spread + convergence_table(log, (baseline, *others), measured)


def _outage_rows(
    log: str, outages: OutageRuns, user_outages: Mapping[str, OutageRuns]
) -> list[OutageRow]:
    rows = outage_test_table(log, outages)
    for name, runs in user_outages.items():
        rows += [row for row in outage_test_table(log, runs) if row.filter == name]
    return rows


def accuracy_series(
    histories: Sequence[History],  # the first is the baseline
    errors: Mapping[str, ReferenceErrors],  # by filter
    reference: ReferenceColumns | None,
    noise: ReferenceNoise,
    settled_s: Mapping[str, float],  # by quantity
    *,
    bridged_gaps: bool,
    stretches: Iterable[str] = DRIFT_STRETCHES,  # over which a drift is measured
) -> dict[str, Series]:
    """Return the errors of each filter from the start that the dive had, by filter; empty without a reference."""
    baseline = histories[0]
    if reference is None or not len(errors[baseline.filter].time_ns):
        return {history.filter: {} for history in histories}
    start_ns = int(baseline.time_ns[0])
    end_ns = int(baseline.time_ns[-1])
    found = dict[str, Series]()
    for history in histories:
        own = errors[history.filter]
        if history is baseline:
            own = covered_errors(own, start_ns, end_ns)
        with np.errstate(over="ignore", invalid="ignore"):
            series = accuracy_errors(
                own,
                reference,
                noise,
                settled_s,
                start_ns=start_ns,
                bridged_gaps=bridged_gaps,
                stretches=stretches,
            )
        if history.is_turned:
            # A solution that was turned to the baseline's heading says nothing of it.
            series = {name: one for name, one in series.items() if name in HEADING_FREE}
        found[history.filter] = series
    return found


def track_series(
    histories: Sequence[History],  # the first is the baseline
    errors: Mapping[str, ReferenceErrors],  # by filter
    noise: ReferenceNoise,
    *,
    bridged_gaps: bool,
) -> dict[str, dict[str, ErrorSeries]]:
    """Return the errors of each filter's position and depth over the whole dive, by filter.

    Empty where the reference covers too little, or the position was lost in a gap of the IMU.
    """
    found: dict[str, dict[str, ErrorSeries]] = {history.filter: {} for history in histories}
    baseline = histories[0]
    if baseline.filter not in errors or not len(errors[baseline.filter].time_ns) or bridged_gaps:
        return found
    of_baseline = errors[baseline.filter]
    start_ns = int(baseline.time_ns[0])
    end_ns = int(baseline.time_ns[-1])
    for quantity, axes in (("position", [0, 1]), ("depth", [2])):
        known = np.asarray(np.isfinite(of_baseline.position_error_ned_m[:, axes]).all(axis=1))
        if covered_share(of_baseline.time_ns, known, start_ns, end_ns) < WELL_COVERED:
            continue
        for history in histories:
            if not history.is_turned:
                error_m = errors[history.filter].position_error_ned_m[:, axes]
                noise_m = math.sqrt(len(axes)) * noise.position_m
                found[history.filter][quantity] = ErrorSeries("m", error_m, noise_m)
    return found


def _track_pairs(
    histories: Sequence[History],  # the first is the baseline
    tracks: Mapping[str, Series],  # from `track_series`
    sensor_sd: Mapping[str, Floats],
) -> dict[str, tuple[Series, Series]]:
    """Pair the errors of the tracks, by candidate: against the reference, where it has them, else held-out sensors."""
    baseline, *candidates = histories
    series = {
        history.filter: {**held_out_track(history, sensor_sd), **tracks[history.filter]}
        for history in histories
    }
    return pairs_of(baseline, candidates, series)


def turned_pairs(
    turned: Sequence[History],  # the first is the baseline
    reference: ReferenceColumns | None,
    noise: ReferenceNoise,
    sensor_sd: Mapping[str, Floats],
    *,
    bridged_gaps: bool,
) -> dict[str, tuple[Series, Series]]:
    """Pair the positions of the baseline and of each candidate from a drawn heading, by candidate."""
    if len(turned) < 2 or reference is None:
        return {}
    errors = {
        history.filter: reference_errors(history, reference, turned[0]) for history in turned
    }
    tracks = track_series(turned, errors, noise, bridged_gaps=bridged_gaps)
    found: dict[str, Series] = {}
    for history in turned:
        series = held_out_track(history, sensor_sd) | tracks[history.filter]
        found[history.filter] = {}
        if "position" in series:
            found[history.filter] = {DRAWN_HEADING: series["position"]}
    return pairs_of(turned[0], turned[1:], found)


def late_mps(reference: ReferenceColumns | None, delay: ReferenceDelay | None) -> float | None:
    """Return the velocity by which a late reference is off: rms acceleration times delay; None where unknown."""
    if reference is None or delay is None or not delay.is_checked:
        return None
    moving = reference.known["velocities"]
    if np.count_nonzero(moving) < FEWEST_ROWS:
        return None
    time_s = seconds(reference.time_ns[moving], reference.time_ns[moving][0])
    acceleration_n = np.gradient(reference.velocity_n[moving], time_s, axis=0)
    size_mps2 = math.sqrt(float(np.mean(np.sum(acceleration_n[:, :2] ** 2, axis=1))))
    return size_mps2 * abs(finite(delay.delay_s))


def predictions(
    histories: Sequence[History],  # the first is the baseline
    outages: OutageRuns,
    user_outages: Mapping[str, OutageRuns],
    settled_s: Mapping[str, float],
) -> dict[str, Score]:
    """Compare how each candidate and the baseline predict the DVL, by candidate."""
    baseline, *candidates = histories
    found = {}
    for history in candidates:
        runs = user_outages.get(history.filter, outages)
        score = prediction_of(baseline, history, runs, settled_s.get("velocity_along", 0.0))
        if score is not None:
            found[history.filter] = score
    return found


def _crps_pairs(
    histories: Sequence[History], errors: Mapping[str, ReferenceErrors]
) -> dict[str, tuple[float, float]]:
    """Return the CRPS of the position of the baseline and of each candidate that estimate it, by candidate."""
    baseline, *candidates = histories
    if not errors or not baseline.estimates_position:
        return {}
    before = position_crps(baseline, errors)
    return {
        history.filter: (before, position_crps(history, errors))
        for history in candidates
        if history.estimates_position
    }


def position_crps(history: History, errors: Mapping[str, ReferenceErrors]) -> float:
    """Return the mean CRPS of a filter's horizontal position, m."""
    own = errors[history.filter]
    rows = np.searchsorted(history.time_ns, own.time_ns)
    return crps(own.position_error_ned_m[:, :2], history.sd[rows][:, POSITION][:, :2])


def pairs_of(
    baseline: History, candidates: Iterable[History], series: Mapping[str, Series]
) -> dict[str, tuple[Series, Series]]:
    """Pair the errors of the baseline and of each candidate, by candidate."""
    return {
        history.filter: (series[baseline.filter], series[history.filter]) for history in candidates
    }


def _outage_pairs(
    names: Sequence[str], outages: OutageRuns, user_outages: Mapping[str, OutageRuns]
) -> dict[str, tuple[Series, Series]]:
    """Return the drifts of the baseline and of each candidate in the same windows, by candidate."""
    baseline, *candidates = names
    pairs: dict[str, tuple[Series, Series]] = {}
    for name in candidates:
        drifts = window_drifts(user_outages.get(name, outages))
        if name in drifts:
            pairs[name] = (_outage_series(drifts[baseline]), _outage_series(drifts[name]))
    return pairs


def _outage_series(drifts: Mapping[str, Floats]) -> Series:
    """Return the drifts of a filter, given by length of the windows, by quantity of the evidence."""
    return {f"outage_{length}": ErrorSeries("m", drift_m) for length, drift_m in drifts.items()}


def ends_of(
    candidates: Iterable[History], rows: Sequence[ReferenceErrorRow]
) -> dict[str, dict[str, tuple[float, float]]]:
    """Return the errors of both tracks at the end and in percent of the distance, by candidate and quantity.

    There are none of a solution that was turned, nor where the reference covers too little.
    """
    found: dict[str, dict[str, tuple[float, float]]] = {}
    for history in candidates:
        if history.is_turned:
            continue
        found[history.filter] = {}
        compared = {
            row.quantity: row
            for row in rows
            if row.filter == history.filter and row.status == ReferenceStatus.COMPARED
        }
        for quantity, (_, name, column) in TRACK.items():
            if name in compared:
                before = abs(finite(getattr(compared[name], f"baseline_{column}")))
                after = abs(finite(getattr(compared[name], column)))
                found[history.filter][quantity] = (before, after)
    return found


def with_solutions(
    drawn: Sequence[DrawnErrors], histories: Iterable[History], dive: Dive
) -> tuple[DrawnErrors, ...]:
    """Add the errors of histories that were not run from random starts, at the times of those that were."""
    if dive.reference is None:
        return ()
    known = {errors.filter for errors in drawn}
    reference = dive.reference.rows(np.isin(dive.reference.time_ns, drawn[0].time_ns))
    single = (history for history in histories if history.filter not in known)
    return (*drawn, *(run_from_start(history, reference, dive.truth) for history in single))


# --- Curves for figures. Their length does not grow with the dive, except for one number of each window.


class PositionCurve(NamedTuple):
    """Horizontal position errors of one filter over time, over its random starts, or its own if there is no other."""

    time_s: Floats  # (k,), after the start
    median_m: Floats  # (k,), middle, smallest and largest over the starts; NaN where none is known
    low_m: Floats
    high_m: Floats
    starts: int


@dataclass(frozen=True)
class Curves:
    """The curves of the evidence on one dive."""

    outage: Mapping[str, OutageCurve]  # by filter; empty where the dive is too short
    # by quantity; empty without a reference or random starts
    convergence: Mapping[str, ConvergenceCurves]
    position: Mapping[str, PositionCurve]  # by filter; empty without positions of a reference


def curves_of(drawn: Sequence[DrawnErrors], outages: OutageRuns) -> Curves:
    """Reduce the measured errors to curves, baseline first."""
    position = {}
    for errors in drawn:
        with np.errstate(over="ignore", invalid="ignore"):
            error_m = np.hypot(
                errors.position_error_ned_m[..., 0], errors.position_error_ned_m[..., 1]
            )
        if not np.isfinite(error_m).all(axis=0).any():
            continue
        if len(error_m) > 1:
            error_m = error_m[1:]
        position[errors.filter] = PositionCurve(
            time_s=errors.time_s,
            median_m=np.median(error_m, axis=0),
            low_m=error_m.min(axis=0),
            high_m=error_m.max(axis=0),
            starts=len(error_m),
        )
    return Curves(outage_curves(outages), convergence_curves(drawn), position)
