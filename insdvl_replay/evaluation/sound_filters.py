"""Filters of which nothing is said: dead ones, and those set so wrong that gain or loss would be an accident."""

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from insdvl_replay.core.dive_columns import NS_PER_S
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.quantities import IS_REFERENCE, is_beam, is_used
from insdvl_replay.core.rows import ConsistencyRow, ReferenceErrorRow
from insdvl_replay.core.table_layout import finite
from insdvl_replay.core.tables import Tables
from insdvl_replay.core.words import ReferenceStatus
from insdvl_replay.evaluation.consistency import MANY_REJECTED, refusals

MANY_REOPENED: Final = 0.01
"""Share of the pings; each comes after several that were rejected."""
FEW: Final = 2
"""So many rejections prove nothing, in however short a dive."""
LARGEST_NIS_PER_DOF: Final = 10.0
"""Innovations three times as large as a filter says come from what it does not know of: axes, units, clocks."""
FARTHEST_PCT: Final = 20.0
"""Of the distance; dead reckoning by a DVL without any INS drifts less."""
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


def not_to_be_judged(histories: tuple[History, ...], tables: Tables, notes: Sequence[Note]) -> dict[str, str]:
    """Find the candidates of which nothing can be said beside the baseline.

    Parameters
    ----------
    histories : tuple of History
        The first is the baseline.
    notes : sequence of Note
        Of the dive: where its columns contradict each other, no filter is judged.

    Returns
    -------
    dict of str to str
        By candidate what is wrong with it or the baseline, or with both; those that are sound are left out. That one of
        the two alone is surprised by the dive, or far off, is for the evidence to say.
    """
    baseline, *candidates = (history.filter for history in histories)
    unfit = _told_the_reference(histories, notes) | dead_filters(histories)
    contradicted = "; ".join(_contradictions(notes))
    misled = misled_filters([baseline, *candidates], tables.consistency, tables.reference_error)
    found = {}
    for candidate in candidates:
        pair = baseline, candidate
        wrong = [unfit[name] for name in pair if name in unfit]
        wrong += [misled[name] for name in pair] if misled.keys() >= set(pair) else []
        found[candidate] = contradicted or " and ".join(wrong)
    return {candidate: wrong for candidate, wrong in found.items() if wrong}


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


def misled_filters(
    names: Sequence[str], consistency: Sequence[ConsistencyRow], reference_error: Sequence[ReferenceErrorRow]
) -> dict[str, str]:
    """Find the filters, the baseline first, whose innovations or errors are those of wrong settings, and what is wrong.

    Returns
    -------
    dict of str to str
        By name; those that are sound are left out.
    """
    off_pct = _position_pct(names[0], reference_error)
    found = {name: _surprised(name, consistency) or _far_off(name, off_pct.get(name, 0.0)) for name in names}
    return {name: wrong for name, wrong in found.items() if wrong}


def _contradictions(notes: Iterable[Note]) -> list[str]:
    return [note.text for note in notes if note.code in CONTRADICTIONS and note.severity == "warning"]


def _surprised(name: str, rows: Sequence[ConsistencyRow]) -> str:
    for row in rows:
        if row.filter == name and is_used(row.measurement) and finite(row.mean_nis) > LARGEST_NIS_PER_DOF * row.dof:
            mean_nis = finite(row.mean_nis)
            return f"the {row.measurement} innovations of {name} have NIS {mean_nis:.3g}, {row.dof} is right"
    return ""


def _position_pct(baseline: str, rows: Sequence[ReferenceErrorRow]) -> dict[str, float]:
    """Return the horizontal position error of each filter in percent of the distance, where it is known."""
    known = [row for row in rows if row.quantity == "position_h_pct" and row.status == ReferenceStatus.COMPARED]
    of_baseline = dict.fromkeys([baseline], finite(known[0].baseline_rmse)) if known else {}
    return of_baseline | {row.filter: finite(row.rmse) for row in known}


def _far_off(name: str, error_pct: float) -> str:
    return f"{name} is off by {error_pct:.3g} % of the distance" if error_pct > FARTHEST_PCT else ""


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
