"""Filters of which nothing is said: dead ones, and those set so wrong that gain or loss would be an accident."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from insdvl_replay.core.dive_columns import NS_PER_S, TimeNs
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.quantities import IS_REFERENCE, is_beam, is_used
from insdvl_replay.core.table import finite
from insdvl_replay.core.tables import ConsistencyRow, Tables
from insdvl_replay.core.words import Judgement, ReferenceStatus
from insdvl_replay.evaluation.coasting_windows import OUTAGE
from insdvl_replay.evaluation.consistency import MANY_REJECTED, refusals
from insdvl_replay.evaluation.evidence import nothing_better
from insdvl_replay.evaluation.reference import ReferenceErrors
from insdvl_replay.evaluation.verdicts import judgement_of

MANY_REOPENED: Final = 0.01
"""Share of the pings; each comes after several that were rejected."""
FEW: Final = 2
"""So many rejections prove nothing, in however short a dive."""
LARGEST_NIS_PER_DOF: Final = 10.0
"""Innovations three times as large as a filter says come from what it does not know of: axes, units, clocks."""
FARTHEST_PCT: Final = 20.0
"""Of the distance, while the DVL is there; dead reckoning by a DVL without any INS drifts less."""
CONTRADICTIONS: Final = (
    "beam_contradiction",
    "dvl_contradiction",
    "dvl_direction",
    "imu_gyro_contradiction",
    "imu_gyro_sign",
    "imu_upside_down",
    "reference_contradiction",
    "start_heading_contradiction",
    "track_contradiction",
)
"""Notes on columns that cannot all be right."""


def not_to_be_judged(
    histories: tuple[History, ...], errors: Mapping[str, ReferenceErrors], tables: Tables, notes: Sequence[Note]
) -> dict[str, str]:
    """Find the candidates of which nothing can be said beside the baseline.

    Parameters
    ----------
    histories : tuple of History
        The first is the baseline.
    errors : mapping of str to ReferenceErrors
        By filter; empty without a reference.
    notes : sequence of Note
        Of the dive: where its columns contradict each other, no filter is judged.

    Returns
    -------
    dict of str to str
        By candidate what is wrong with it or the baseline, or with both; those that are sound are left out. That one of
        the two alone is far off is for the evidence to say, and so is a surprised baseline. A candidate whose own
        innovations are far too large is worse or is not judged.
    """
    baseline, *candidates = (history.filter for history in histories)
    unfit = _told_the_reference(histories, notes) | dead_filters(histories)
    contradicted = "; ".join(_contradictions(notes))
    misled = {
        history.filter: found
        for history in histories
        if (found := surprised(history.filter, tables.consistency) or far_off(history, histories[0], errors, tables))
    }
    unsound = {}
    for candidate in candidates:
        pair = baseline, candidate
        wrong = [unfit[name] for name in pair if name in unfit]
        wrong += [misled[name] for name in pair] if misled.keys() >= set(pair) else []
        left = nothing_better(row for row in tables.evidence if row.filter == candidate)
        too_large = "" if judgement_of(left) == Judgement.WORSE else surprised(candidate, tables.consistency)
        unsound[candidate] = contradicted or " and ".join(wrong) or too_large
    return {candidate: reason for candidate, reason in unsound.items() if reason}


def _told_the_reference(histories: tuple[History, ...], notes: Iterable[Note]) -> dict[str, str]:
    """Find the filters that are aided by the reference's own readings, or made of it: errors against it say nothing.

    Depth is left out: it has no vote, and the rest of the reference is as good as before.
    """
    own = {note.code.removesuffix(IS_REFERENCE) for note in notes if note.code.endswith(IS_REFERENCE)}
    read = (history.filter for history in histories if history.is_read)
    made_of_it = {name: f"{name} is, or may know, the reference" for name in read if f"solution_{name}" in own}
    return made_of_it | {
        history.filter: f"{history.filter} is aided by the {one.measurement} that the reference is made of"
        for history in histories
        for one in history.innovations
        if one.measurement in own - {"depth"}
    }


def dead_filters(histories: tuple[History, ...]) -> dict[str, str]:
    """Find the filters that are not to be judged by what they did.

    Returns
    -------
    dict of str to str
        By name of the filter what is wrong with it; those that are sound are left out. A filter is dead where its state
        is not finite, where its gate rejected more than `MANY_REJECTED` of what locks it out (the velocities, the
        pings of the beams, or what else a filter is aided by first), or where it was set to the DVL again more than
        once and at more than `MANY_REOPENED` of its pings. What a gate rejects of a sound filter by chance is allowed
        for.
    """
    found = {
        history.filter: _not_finite(history) or _locked_out(history) or _set_again(history)
        for history in histories
        if not history.is_read  # what a solution leaves out it leaves out
    }
    return {name: wrong for name, wrong in found.items() if wrong}


def _contradictions(notes: Iterable[Note]) -> list[str]:
    return [note.text for note in notes if note.code in CONTRADICTIONS and note.severity == "warning"]


def surprised(name: str, rows: Sequence[ConsistencyRow]) -> str:
    """Name a sensor whose innovations are far larger than the filter that it aids expects; empty if there is none."""
    for row in rows:
        if row.filter == name and is_used(row.measurement) and finite(row.mean_nis) > LARGEST_NIS_PER_DOF * row.dof:
            mean_nis = finite(row.mean_nis)
            return f"the {row.measurement} innovations of {name} have NIS {mean_nis:.3g}, {row.dof} is right"
    return ""


def far_off(history: History, baseline: History, errors: Mapping[str, ReferenceErrors], tables: Tables) -> str:
    """Find a filter that goes astray while the DVL is there: what it gains without is nobody's mistake.

    If the DVL is silent for more than half of the time, all of the error counts.
    """
    rows = [row for row in tables.reference_error if row.quantity == "position_h_pct"]
    if history.filter not in errors or not any(row.status == ReferenceStatus.COMPARED for row in rows):
        return ""
    found, ping_ns = errors[history.filter], _ping_ns(baseline)
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
    return f"{history.filter} is off by {error_pct:.3g} % of the distance" if error_pct > FARTHEST_PCT else ""


def _ping_ns(history: History) -> TimeNs:
    """Return the times at which velocities or beams aid a filter."""
    times = [one.time_ns for one in history.innovations if one.measurement == "velocity" or is_beam(one.measurement)]
    return np.unique(np.concatenate(times)) if times else np.empty(0, np.int64)


def _not_finite(history: History) -> str:
    columns = (history.position, history.velocity_n, history.mat_nb, history.accel_bias_b, history.gyro_bias_b)
    finite = np.isfinite(history.sd).all(axis=1)
    for column in columns:
        finite &= np.isfinite(column.reshape(len(column), -1)).all(axis=1)
    if finite.all():
        return ""
    first_s = (history.time_ns[np.argmin(finite)] - history.time_ns[0]) / NS_PER_S
    return f"the state of {history.filter} is not finite from {first_s:.1f} s on"


def _locked_out(history: History) -> str:
    leading = _leading(history)
    if leading is None:
        return ""
    rejected, total = int(leading.refused.sum()), len(leading.refused)
    if rejected <= max(FEW, (MANY_REJECTED + leading.by_chance) * total):
        return ""
    return f"{history.filter} rejected {rejected} of {total} {leading.of}"


def _set_again(history: History) -> str:
    """Find a filter that is not thrown off once, but errs all the time, and is saved from itself every so often."""
    leading = _leading(history)
    if leading is None:
        return ""
    reopened, total = len(history.reopened_ns), len(leading.refused)
    if reopened <= max(1.0, (MANY_REOPENED + leading.by_chance**leading.reopen_after) * total):
        return ""
    return f"{history.filter} lost its way {reopened} times in {total} {leading.of}"


class _Leading(NamedTuple):
    """What a filter hangs on: which of its readings the gate refused, and which share of them it would by chance."""

    of: str
    refused: NDArray[np.bool_]
    by_chance: float
    reopen_after: int


def _leading(history: History) -> _Leading | None:
    """Return the velocities, else the pings of the beams, else what a filter is aided by first."""
    used = [innovations for innovations in history.innovations if is_used(innovations.measurement)]
    beams = [innovations for innovations in used if is_beam(innovations.measurement)]
    if beams:
        return _pings(beams)
    velocities = [innovations for innovations in used if innovations.measurement == "velocity"]
    first = next(iter((*velocities, *used)), None)
    if first is None:
        return None
    by_chance, of = float(chdtrc(first.dof, first.gate)), f"{first.measurement} innovations"
    return _Leading(of, refusals(first), by_chance, first.reopen_after)


def _pings(beams: Sequence[Innovations]) -> _Leading:
    """Put the beams of each ping together: refused where all that were heard are; by chance, at most as one is."""
    time_ns, ping = np.unique(np.concatenate([one.time_ns for one in beams]), return_inverse=True)
    passed = np.zeros(len(time_ns), np.bool_)
    passed[ping[~np.concatenate([refusals(one) for one in beams])]] = True
    return _Leading("pings", ~passed, float(chdtrc(1, beams[0].gate)), beams[0].reopen_after)
