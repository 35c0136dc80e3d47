"""Filters that ran side by side, compared with the reference and with each other: all tables of a dive."""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np
from msgspec.structs import replace

from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns, TimeNs
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import IS_REFERENCE, TRACK
from insdvl_replay.core.table import finite
from insdvl_replay.core.tables import Candidate, DriftRow, JumpRow, ReferenceErrorRow, Tables, TrackFitRow
from insdvl_replay.core.words import ReferenceStatus
from insdvl_replay.evaluation.believed import improvement_table
from insdvl_replay.evaluation.coasting import Coasts, coasting_table, window_drifts
from insdvl_replay.evaluation.consistency import consistency_table
from insdvl_replay.evaluation.convergence import convergence_table
from insdvl_replay.evaluation.coverage import reference_coverage_notes, reference_rate_notes, truth_coverage_notes
from insdvl_replay.evaluation.credibility import credibility_table
from insdvl_replay.evaluation.drawn_errors import DrawnErrors, errors_of_one_run
from insdvl_replay.evaluation.drift_table import drift_table, track_fit_table
from insdvl_replay.evaluation.evidence import Measured, evidence_table, nothing_better, without_words
from insdvl_replay.evaluation.losses import Losses, ReferenceNoise, losses_beside, losses_of, without_heading
from insdvl_replay.evaluation.measured_convergence import measured_convergences
from insdvl_replay.evaluation.reference import ReferenceErrors, reference_error_table, reference_errors
from insdvl_replay.evaluation.sound_filters import not_to_be_judged, surprised
from insdvl_replay.evaluation.state_errors import state_errors
from insdvl_replay.evaluation.verdicts import verdicts
from insdvl_replay.evaluation.withheld import withheld_losses, withheld_track

MOST_COVARIANCES: Final = 20_000
"""So many P, 23 MB of them, are kept until the errors are judged; a longer dive is judged at fewer times."""


def judged_times(reference: ReferenceColumns | None, start_ns: int, end_ns: int, *, filters: int) -> TimeNs:
    """Choose the times at which P is kept and errors are judged by it: all of the reference, or evenly some of them.

    Returns
    -------
    ndarray, shape (c,), ns
    """
    if reference is None:
        return np.empty(0, dtype=np.int64)
    inside_ns = _inside(reference.time_ns, start_ns, end_ns)
    every = math.ceil(len(inside_ns) * filters / MOST_COVARIANCES)
    return inside_ns[:: max(every, 1)]


def _inside(reference_ns: TimeNs, start_ns: int, end_ns: int) -> TimeNs:
    return reference_ns[(reference_ns >= start_ns) & (reference_ns <= end_ns)]


def tables_of_filters(
    dive: Dive,
    histories: tuple[History, ...],
    drawn: tuple[DrawnErrors, ...],
    coasts: Coasts,
    noise: ReferenceNoise,
    sensor_sd: Mapping[str, Floats],
    jumps: list[JumpRow],
    *,
    start_ns: int,
    bridged_gaps: bool,
) -> tuple[dict[str, ReferenceErrors], Tables]:
    """Compare the filters with the reference and with each other.

    Parameters
    ----------
    drawn : tuple of DrawnErrors
        Of the filters; empty without a reference.
    noise : ReferenceNoise
        How far the reference itself may be off.
    sensor_sd : mapping of str to ndarray, shape (s,)
        Noise of the components of one reading of the sensors that may be withheld, see `withheld.withheld_losses`.
    jumps : list of JumpRow
        From `jumps.jump_table`.

    Returns
    -------
    dict of str to ReferenceErrors
        By filter; empty without a reference.
    Tables
    """
    errors, in_states = {}, {}
    if dive.reference is not None:
        errors = {history.filter: reference_errors(history, dive.reference, histories[0]) for history in histories}
        in_states = {
            history.filter: state_errors(history, dive.reference, dive.truth).after(start_ns) for history in histories
        }
    names = [history.filter for history in histories]
    convergence = {of_one.filter: measured_convergences(drawn[0], of_one) for of_one in drawn[1:]}
    consistency = consistency_table(dive.name, histories, sensor_sd)
    reference_error = reference_error_table(dive.name, histories, errors, bridged_gaps=bridged_gaps)
    credibility = credibility_table(dive.name, names, in_states)
    measured = Measured(
        _losses(dive, drawn, noise, bridged_gaps=bridged_gaps),
        window_drifts(coasts),
        convergence,
        {history.filter: withheld_losses(history, sensor_sd) for history in histories},
        _losses_beside(dive, drawn, histories, noise, bridged_gaps=bridged_gaps),
        {history.filter: _track(histories[0], history, reference_error) for history in histories[1:]},
    )
    return errors, Tables(
        improvement_table(dive.name, histories),
        convergence_table(dive.name, histories, convergence),
        reference_error,
        consistency,
        credibility,
        evidence_table(dive.name, names[0], names[1:], measured, consistency, credibility),
        coasting_table(dive.name, coasts),
        *_drift(dive, errors, start_ns, bridged_gaps=bridged_gaps),
        jumps,
    )


def _track(baseline: History, candidate: History, rows: Sequence[ReferenceErrorRow]) -> dict[str, tuple[float, float]]:
    """Return the errors of both tracks, by the reference where it covers the dive, else by fixes and depths held out.

    There are none of a solution that was read: only the baseline starts with the heading of the reference.
    """
    known = {
        row.quantity: row for row in rows if row.filter == candidate.filter and row.status == ReferenceStatus.COMPARED
    }
    tracks, found = [withheld_track(history) for history in (baseline, candidate)], {}
    for quantity, (_, name, column) in () if candidate.is_read else TRACK.items():
        if name in known:
            before, after = (getattr(known[name], key) for key in (f"baseline_{column}", column))
            found[quantity] = abs(finite(before)), abs(finite(after))
        elif all(quantity in track for track in tracks):
            found[quantity] = tracks[0][quantity], tracks[1][quantity]
    return found


def _drift(
    dive: Dive, errors: dict[str, ReferenceErrors], start_ns: int, *, bridged_gaps: bool
) -> tuple[list[DriftRow], list[TrackFitRow]]:
    if dive.reference is None:
        return [], []
    fits = [] if bridged_gaps else track_fit_table(dive.name, errors, dive.reference)
    return drift_table(dive.name, errors, dive.reference, start_ns, bridged_gaps=bridged_gaps), fits


def _losses(
    dive: Dive, drawn: tuple[DrawnErrors, ...], noise: ReferenceNoise, *, bridged_gaps: bool
) -> dict[str, dict[str, Losses]]:
    if dive.reference is None:
        return {}
    return {of_one.filter: losses_of(of_one, dive.reference, noise, bridged_gaps=bridged_gaps) for of_one in drawn}


def _losses_beside(
    dive: Dive,
    drawn: tuple[DrawnErrors, ...],
    histories: tuple[History, ...],
    noise: ReferenceNoise,
    *,
    bridged_gaps: bool,
) -> dict[str, tuple[dict[str, Losses], dict[str, Losses]]]:
    """Square the errors of solutions that were read, and of the baseline from starts like theirs."""
    if dive.reference is None:
        return {}
    of_filters, found = {of_one.filter: of_one for of_one in drawn}, {}
    for history in (history for history in histories if history.is_read):
        before, after = losses_beside(
            drawn[0], of_filters[history.filter], dive.reference, noise, bridged_gaps=bridged_gaps
        )
        if history.is_turned:
            before, after = without_heading(before), without_heading(after)
        found[history.filter] = before, after
    return found


def with_solutions(drawn: Sequence[DrawnErrors], histories: Iterable[History], dive: Dive) -> tuple[DrawnErrors, ...]:
    """Add the errors of solutions that were read to those of the filters from drawn starts."""
    if dive.reference is None:
        return ()
    read = (history for history in histories if history.is_read)
    return (*drawn, *(errors_of_one_run(history, drawn[0], dive.reference, dive.truth) for history in read))


def judged_candidates(
    histories: tuple[History, ...],
    errors: Mapping[str, ReferenceErrors],
    tables: Tables,
    notes: Sequence[Note],
    *,
    independent: bool,
) -> tuple[Tables, dict[str, Candidate]]:
    """Judge each candidate by the evidence in the tables.

    Parameters
    ----------
    histories : tuple of History
        The first is the baseline.
    errors : mapping of str to ReferenceErrors
        By filter; empty without a reference.
    notes : sequence of Note
        Of the dive.
    independent : bool
        Whether the reference shares no sensors with the filters.

    Returns
    -------
    Tables
        Without words on candidates that are not judged.
    dict of str to Candidate
        What there is to say of each, by name.
    """
    baseline, *candidates = (history.filter for history in histories)
    unsound = not_to_be_judged(histories, errors, tables, notes)
    evidence = []
    for name in candidates:
        is_told_depth = _is_told_depth({baseline, name}, histories, notes)
        left_out = "depth" if is_told_depth else ""
        rows = [row for row in tables.evidence if row.filter == name and row.quantity != left_out]
        evidence += nothing_better(rows) if surprised(name, tables.consistency) else rows
    tables = replace(tables, evidence=without_words(evidence, unsound))
    return tables, verdicts(tables, baseline, candidates, unsound, independent=independent)


def _is_told_depth(names: Collection[str], histories: Iterable[History], notes: Iterable[Note]) -> bool:
    """Return whether any of the filters is aided by the depth that the reference is made of."""
    told = (one.measurement for history in histories if history.filter in names for one in history.innovations)
    return any(note.code == f"depth{IS_REFERENCE}" for note in notes) and "depth" in told


def reference_notes(
    dive: Dive, start_ns: int, end_ns: int, history: History, judged_ns: TimeNs, *, independent: bool
) -> tuple[Note, ...]:
    """Note what the reference cannot tell: errors that it shares, and what of the dive it does not see."""
    if dive.reference is None:
        return ()
    notes = []
    if not independent:
        text = "the reference shares sensors with the filters: errors that they have in common are not seen"
        notes.append(Note("reference_not_independent", text))
    notes += reference_coverage_notes(dive.reference, start_ns, end_ns)
    if dive.truth is not None:
        notes += truth_coverage_notes(dive.truth, start_ns, end_ns)
    notes += _thinned_notes(len(_inside(dive.reference.time_ns, start_ns, end_ns)), len(judged_ns))
    return (*notes, *reference_rate_notes(history, dive.reference.time_ns))


def _thinned_notes(inside: int, judged: int) -> Iterator[Note]:
    if left_out := inside - judged:
        text = (
            f"credibility is judged at {judged} of the {inside} times of the reference, evenly chosen: P "
            "at all of them would fill the memory"
        )
        yield Note("credibility_thinned", text, left_out)
