"""All tables of a dive: the filters compared with the reference and with each other.

`tables_of_filters` fills the tables, and `curves_of` keeps what is drawn over time. `verdicts` puts the evidence in
words.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns, TimeNs
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import TRACK
from insdvl_replay.core.tables import JumpRow, ReferenceErrorRow, Tables, finite
from insdvl_replay.core.words import ReferenceStatus
from insdvl_replay.evaluation.consistency import consistency_table
from insdvl_replay.evaluation.convergence import (
    ConvergenceCurves,
    convergence_curves,
    convergence_table,
    improvement_table,
    measured_convergences,
)
from insdvl_replay.evaluation.credibility import credibility_table, state_errors
from insdvl_replay.evaluation.drift import drift_table, track_fit_table
from insdvl_replay.evaluation.evidence import (
    Measured,
    ReferenceNoise,
    accuracy_errors,
    accuracy_pair,
    evidence_table,
    held_out_errors,
    held_out_track,
)
from insdvl_replay.evaluation.outage_test import (
    OutageCurve,
    OutageRuns,
    outage_curves,
    outage_test_table,
    window_drifts,
)
from insdvl_replay.evaluation.reference_errors import (
    DrawnErrors,
    ReferenceErrors,
    reference_error_table,
    reference_errors,
    run_from_start,
)

# At most this number of P (23 MB) is kept for the evaluation of errors; a longer dive is evaluated at fewer times.
MOST_COVARIANCES: Final = 20_000


def evaluated_times(reference: ReferenceColumns | None, start_ns: int, end_ns: int, *, filters: int) -> TimeNs:
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
    spread: tuple[History, ...],  # of those that were run here, from a start as uncertain as [initial]
    drawn: tuple[DrawnErrors, ...],  # of the filters, in the same order; empty without a reference
    outages: OutageRuns,
    user_outages: Mapping[str, OutageRuns],  # by filter of the user's, with the baseline's runs
    noise: ReferenceNoise,
    sensor_sd: Mapping[str, Floats],  # (s,), noise of one reading of each sensor that may be held out
    jumps: list[JumpRow],  # from `drift.jump_table`
    *,
    start_ns: int,
    bridged_gaps: bool,  # the filters went through long gaps of the IMU
) -> tuple[dict[str, ReferenceErrors], Tables]:
    """Compare the filters with the reference and with each other; return their errors by filter, too."""
    log, reference, (baseline, *candidates) = dive.name, dive.reference, histories
    names = [history.filter for history in histories]
    # Others than the built-in filters are compared from the dive's own start.
    run_here = {history.filter for history in spread}
    others = (baseline, *(history for history in candidates if history.filter not in run_here))
    errors, in_states, drift, fits, accuracy = {}, {}, [], [], {}
    if reference is not None:
        for history in histories:
            errors[history.filter] = reference_errors(history, reference, baseline)
            in_states[history.filter] = state_errors(history, reference, dive.truth).after(start_ns)
        drift = drift_table(log, errors, reference, start_ns, bridged_gaps=bridged_gaps)
        fits = [] if bridged_gaps else track_fit_table(log, errors, reference)
        before = accuracy_errors(drawn[0], reference, noise, bridged_gaps=bridged_gaps)
        for history, found in zip(candidates, drawn[1:], strict=True):
            accuracy[found.filter] = (
                accuracy_pair(
                    drawn[0], found, reference, noise, bridged_gaps=bridged_gaps, given_heading=history.is_turned
                )
                if history.has_own_start
                else (before, accuracy_errors(found, reference, noise, bridged_gaps=bridged_gaps))
            )
    convergence = {found.filter: measured_convergences(drawn[0], found) for found in drawn[1:]}
    reference_error = reference_error_table(log, histories, errors, bridged_gaps=bridged_gaps)
    consistency = consistency_table(log, histories, sensor_sd)
    credibility = credibility_table(log, names, in_states)
    held_out = held_out_errors(baseline, sensor_sd)
    measured = Measured(
        accuracy=accuracy,
        outage=_outage_pairs(names, outages, user_outages),
        convergence=convergence,
        held_out={history.filter: (held_out, held_out_errors(history, sensor_sd)) for history in candidates},
        track={history.filter: _track(baseline, history, reference_error) for history in candidates},
        partial=[history.filter for history in candidates if history.is_partial],
    )
    user_outage_rows = [
        row for name, runs in user_outages.items() for row in outage_test_table(log, runs) if row.filter == name
    ]
    return errors, Tables(
        improvement=improvement_table(log, histories),
        convergence=convergence_table(log, spread, convergence) + convergence_table(log, others, convergence),
        reference_error=reference_error,
        consistency=consistency,
        credibility=credibility,
        evidence=evidence_table(log, names[0], names[1:], measured, consistency, credibility),
        outage=outage_test_table(log, outages) + user_outage_rows,
        drift=drift,
        track_fit=fits,
        jumps=jumps,
    )


def _outage_pairs(
    names: Sequence[str], outages: OutageRuns, user_outages: Mapping[str, OutageRuns]
) -> dict[str, tuple[Mapping[str, Floats], Mapping[str, Floats]]]:
    """Return the drifts of the baseline and of each candidate in the same windows, by candidate."""
    baseline, *candidates = names
    pairs: dict[str, tuple[Mapping[str, Floats], Mapping[str, Floats]]] = {}
    for name in candidates:
        drifts = window_drifts(user_outages.get(name, outages))
        if name in drifts:
            pairs[name] = drifts[baseline], drifts[name]
    return pairs


def _track(baseline: History, candidate: History, rows: Sequence[ReferenceErrorRow]) -> dict[str, tuple[float, float]]:
    """Return the errors of both tracks, by the reference where it covers the dive, else by held-out fixes and depths.

    A candidate with its own start has none, since only the baseline starts with the heading of the reference.
    """
    if candidate.has_own_start:
        return {}
    compared = [row for row in rows if row.filter == candidate.filter and row.status == ReferenceStatus.COMPARED]
    known, found = {row.quantity: row for row in compared}, {}
    tracks = [held_out_track(history) for history in (baseline, candidate)]
    for quantity, (_, name, column) in TRACK.items():
        if name in known:
            before, after = (getattr(known[name], key) for key in (f"baseline_{column}", column))
            found[quantity] = abs(finite(before)), abs(finite(after))
        elif all(quantity in track for track in tracks):
            found[quantity] = tracks[0][quantity], tracks[1][quantity]
    return found


def with_solutions(drawn: Sequence[DrawnErrors], histories: Iterable[History], dive: Dive) -> tuple[DrawnErrors, ...]:
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
    convergence: Mapping[str, ConvergenceCurves]  # by quantity; empty without a reference or random starts
    position: Mapping[str, PositionCurve]  # by filter; empty without positions of a reference


def curves_of(drawn: Sequence[DrawnErrors], outages: OutageRuns) -> Curves:
    """Reduce the measured errors to curves, baseline first."""
    position = {}
    for errors in drawn:
        with np.errstate(over="ignore", invalid="ignore"):
            error_m = np.hypot(errors.position_error_ned_m[..., 0], errors.position_error_ned_m[..., 1])
        if np.isfinite(error_m).all(axis=0).any():
            shown = error_m[1:] if len(error_m) > 1 else error_m
            ends = np.median(shown, axis=0), shown.min(axis=0), shown.max(axis=0)
            position[errors.filter] = PositionCurve(errors.time_s, *ends, len(shown))
    return Curves(outage_curves(outages), convergence_curves(drawn), position)
