"""All tables of a dive: the filters that ran side by side, compared with the reference and with each other.

`tables_of_filters` fills the tables, `judged_candidates` puts the evidence in words, `reference_notes` says what the
reference does not see, and `curves_of` keeps what is drawn over time.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from msgspec.structs import replace

from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns, TimeNs, seconds
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import IS_REFERENCE, TRACK
from insdvl_replay.core.states import DEG
from insdvl_replay.core.tables import Candidate, JumpRow, ReferenceErrorRow, Tables, finite
from insdvl_replay.core.words import ReferenceStatus, Severity
from insdvl_replay.evaluation.consistency import consistency_table
from insdvl_replay.evaluation.convergence import (
    ConvergenceCurves,
    convergence_curves,
    convergence_table,
    measured_convergences,
)
from insdvl_replay.evaluation.credibility import credibility_table, state_errors
from insdvl_replay.evaluation.drift import drift_table, track_fit_table
from insdvl_replay.evaluation.errors import (
    WELL_COVERED,
    DrawnErrors,
    Known,
    ReferenceErrors,
    covered_share,
    reference_error_table,
    reference_errors,
    run_from_start,
)
from insdvl_replay.evaluation.evidence import (
    Measured,
    Pair,
    ReferenceNoise,
    accuracy_beside,
    accuracy_errors,
    evidence_table,
    held_out_errors,
    held_out_track,
    nothing_better,
    without_words,
)
from insdvl_replay.evaluation.outage_test import (
    OutageCurve,
    OutageRuns,
    outage_curves,
    outage_test_table,
    window_drifts,
)
from insdvl_replay.evaluation.predicted import improvement_table
from insdvl_replay.evaluation.verdicts import not_evaluated, surprised, verdicts

MOST_COVARIANCES: Final = 20_000
"""So many P, 23 MB of them, are kept until the errors are judged; a longer dive is judged at fewer times."""
SMALL_TURN: Final = 10.0 * DEG
"""Through a smaller turn a straight line between two samples misses less than 0.4 % of the speed, 1 - cos(5 deg)."""
LARGE_TURN: Final = 45.0 * DEG
"""Through a larger one it misses more than 7 %, 1 - cos(22.5 deg), and the turn may have come and gone unseen."""


def judged_times(reference: ReferenceColumns | None, start_ns: int, end_ns: int, *, filters: int) -> TimeNs:
    """Choose the times at which P is kept and errors are judged by it: all of the reference, or evenly some of them."""
    if reference is None:
        return np.empty(0, dtype=np.int64)
    inside_ns = reference.time_ns[(reference.time_ns >= start_ns) & (reference.time_ns <= end_ns)]
    every = math.ceil(len(inside_ns) * filters / MOST_COVARIANCES)
    return inside_ns[:: max(every, 1)]


# --- The tables.


def tables_of_filters(
    dive: Dive,
    histories: tuple[History, ...],  # the first is the baseline
    drawn: tuple[DrawnErrors, ...],  # of the filters, in the same order; empty without a reference
    outages: OutageRuns,
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
    errors, in_states, drift, fits = {}, {}, [], []
    if reference is not None:
        errors = {history.filter: reference_errors(history, reference, baseline) for history in histories}
        in_states = {
            history.filter: state_errors(history, reference, dive.truth).after(start_ns) for history in histories
        }
        drift = drift_table(log, errors, reference, start_ns, bridged_gaps=bridged_gaps)
        fits = [] if bridged_gaps else track_fit_table(log, errors, reference)
    convergence = {found.filter: measured_convergences(drawn[0], found) for found in drawn[1:]}
    reference_error = reference_error_table(log, histories, errors, bridged_gaps=bridged_gaps)
    consistency = consistency_table(log, histories, sensor_sd)
    credibility = credibility_table(log, names, in_states)

    # What the evidence compares, pair by pair.
    accuracy: dict[str, Pair] = {}
    if reference is not None:
        before = accuracy_errors(drawn[0], reference, noise, bridged_gaps=bridged_gaps)
        for history, found in zip(candidates, drawn[1:], strict=True):
            if history.has_own_start:
                accuracy[found.filter] = accuracy_beside(
                    drawn[0], found, reference, noise, bridged_gaps=bridged_gaps, given_heading=history.is_turned
                )
            else:
                after = accuracy_errors(found, reference, noise, bridged_gaps=bridged_gaps)
                accuracy[found.filter] = before, after
    held_out = held_out_errors(baseline, sensor_sd)
    measured = Measured(
        accuracy,
        window_drifts(outages),
        convergence,
        {history.filter: (held_out, held_out_errors(history, sensor_sd)) for history in candidates},
        {history.filter: _track(baseline, history, reference_error) for history in candidates},
        [history.filter for history in candidates if history.is_partial],
    )
    return errors, Tables(
        improvement_table(log, histories),
        convergence_table(log, histories, convergence),
        reference_error,
        consistency,
        credibility,
        evidence_table(log, names[0], names[1:], measured, consistency, credibility),
        outage_test_table(log, outages),
        drift,
        fits,
        jumps,
    )


def _track(baseline: History, candidate: History, rows: Sequence[ReferenceErrorRow]) -> dict[str, tuple[float, float]]:
    """Return the errors of both tracks, by the reference where it covers the dive, else by held-out fixes and depths.

    There are none of a candidate with a start of its own: only the baseline starts with the heading of the reference.
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
    """Add the errors of histories that were not run from drawn starts, at the times of those that were."""
    if dive.reference is None:
        return ()
    known = {errors.filter for errors in drawn}
    reference = dive.reference.rows(np.isin(dive.reference.time_ns, drawn[0].time_ns))
    single = (history for history in histories if history.filter not in known)
    return (*drawn, *(run_from_start(history, reference, dive.truth) for history in single))


def judged_candidates(
    histories: tuple[History, ...],  # the first is the baseline
    errors: Mapping[str, ReferenceErrors],  # by filter; empty without a reference
    tables: Tables,
    notes: Sequence[Note],  # of the dive
    *,
    independent: bool,  # whether the reference shares no sensors with the filters
) -> tuple[Tables, dict[str, Candidate]]:
    """Judge each candidate by the evidence in the tables; those that are not evaluated lose their words there."""
    baseline, *candidates = (history.filter for history in histories)
    unsound = not_evaluated(histories, errors, tables, notes)
    depth_is_reference = any(note.code == f"depth{IS_REFERENCE}" for note in notes)
    by_depth = {
        history.filter
        for history in histories
        if depth_is_reference and any(met.measurement == "depth" for met in history.innovations)
    }
    evidence = []
    for name in candidates:
        # Depth is no evidence where a filter is aided by the depth that the reference is made of.
        left_out = "depth" if by_depth & {baseline, name} else ""
        rows = [row for row in tables.evidence if row.filter == name and row.quantity != left_out]
        evidence += nothing_better(rows) if surprised(name, tables.consistency) else rows
    tables = replace(tables, evidence=without_words(evidence, unsound))
    return tables, verdicts(tables, baseline, candidates, unsound, independent=independent)


# --- What the reference does not see.


def reference_notes(
    dive: Dive, start_ns: int, end_ns: int, history: History, judged_ns: TimeNs, *, independent: bool
) -> tuple[Note, ...]:
    """Note what the reference cannot tell: errors that it shares, and what of the dive it does not see."""
    reference, truth = dive.reference, dive.truth
    if reference is None:
        return ()
    notes = []
    if not independent:
        text = "the reference shares sensors with the filters: errors that they have in common are not seen"
        notes.append(Note("reference_not_independent", text))
    known = {quantity: rows for quantity, rows in reference.known.items() if rows.any()}
    covering = [("reference", reference.time_ns, known)]
    if truth is not None:
        biases = {"accelerometer biases": truth.accel_bias_b, "gyro biases": truth.gyro_bias_b}
        told = {quantity: np.asarray(np.isfinite(values).all(axis=1)) for quantity, values in biases.items()}
        covering.append(("truth", truth.time_ns, told))
    for source, time_ns, found in covering:
        # One note for each percent, of all quantities that cover so much.
        alike: dict[str, list[str]] = {}
        for quantity, rows in found.items():
            share = covered_share(time_ns, rows, start_ns, end_ns)
            if share < WELL_COVERED:
                alike.setdefault(f"{100.0 * share:.0f}", []).append(quantity)
        inside: Known = (time_ns >= start_ns) & (time_ns <= end_ns)
        for percent, quantities in alike.items():
            joined = " and ".join(filter(None, [", ".join(quantities[:-1]), quantities[-1]]))
            text = (
                f"{joined} of the {source} cover {percent} % of the replay; the errors against them are of "
                "that part alone"
            )
            count = min(int(np.sum(found[quantity] & inside)) for quantity in quantities)
            hint = "--start and --end choose that part"
            notes.append(Note(f"{source}_coverage", text, count, Severity.WARNING, hint))
    count = int(np.sum((reference.time_ns >= start_ns) & (reference.time_ns <= end_ns)))
    if left_out := count - len(judged_ns):
        text = (
            f"credibility is judged at {len(judged_ns)} of the {count} times of the reference, evenly chosen: P "
            "at all of them would fill the memory"
        )
        notes.append(Note("credibility_thinned", text, left_out))
    return (*notes, *reference_rate_notes(history, reference.time_ns))


def reference_rate_notes(history: History, reference_ns: TimeNs) -> tuple[Note, ...]:
    """Say that a reference is too slow for the dive's turns, where it is; any filter's history shows the motion.

    The note counts the intervals with more than `SMALL_TURN`, and is a warning above `LARGE_TURN`.
    """
    sampled = np.flatnonzero(np.isin(history.time_ns, reference_ns))
    if len(sampled) < 2:
        return ()
    # Turn and change of velocity since the last sample before each recorded time.
    rows = np.arange(sampled[0] + 1, sampled[-1] + 1)
    last = sampled[np.searchsorted(sampled, rows, side="left") - 1]
    trace = np.einsum("kij,kij->k", history.mat_nb[rows], history.mat_nb[last])  # of a rotation: 1 + 2 cos(angle)
    turn = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    change_mps = np.linalg.norm(history.velocity_n[rows] - history.velocity_n[last], axis=1)
    since, turning = history.time_ns[last], turn > SMALL_TURN
    if not turning.any():
        return ()
    worst = int(np.argmax(turn))
    apart_s = float(seconds(reference_ns[np.searchsorted(reference_ns, since[worst], side="right")], since[worst]))
    text = (
        f"between two samples of the reference, {apart_s:.2g} s apart, the vehicle turns by up to "
        f"{turn[worst] / DEG:.0f} deg and changes its velocity by up to {change_mps.max():.2f} m/s; errors in "
        "between are not seen"
    )
    hint = f"a reference at {turn[worst] / SMALL_TURN / apart_s:.2g} Hz would see this turn"
    count, severity = len(np.unique(since[turning])), Severity.WARNING if turn[worst] > LARGE_TURN else Severity.INFO
    return (Note("reference_slow", text, count, severity, hint),)


# --- What is drawn over time: as much for a dive of hours as for one of minutes, but for one number of each window.


class PositionCurve(NamedTuple):
    """Horizontal position errors of one filter over time, over its drawn starts, or its own if there is no other."""

    time_s: Floats  # (k,), after the start
    median_m: Floats  # (k,), middle, smallest and largest over the starts; NaN where none is known
    low_m: Floats
    high_m: Floats
    starts: int


@dataclass(frozen=True)
class Curves:
    """All that is drawn of the evidence on one dive."""

    outage: Mapping[str, OutageCurve]  # by filter; empty where the dive is too short
    convergence: Mapping[str, ConvergenceCurves]  # by quantity; empty without a reference or drawn starts
    position: Mapping[str, PositionCurve]  # by filter; empty without positions of a reference


def curves_of(drawn: Sequence[DrawnErrors], outages: OutageRuns) -> Curves:
    """Reduce what was measured, of the baseline first, to what is drawn."""
    position = {}
    for errors in drawn:
        with np.errstate(over="ignore", invalid="ignore"):
            error_m = np.hypot(errors.position_error_ned_m[..., 0], errors.position_error_ned_m[..., 1])
        if np.isfinite(error_m).all(axis=0).any():
            shown = error_m[1:] if len(error_m) > 1 else error_m
            ends = np.median(shown, axis=0), shown.min(axis=0), shown.max(axis=0)
            position[errors.filter] = PositionCurve(errors.time_s, *ends, len(shown))
    return Curves(outage_curves(outages), convergence_curves(drawn), position)
