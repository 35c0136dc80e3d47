"""What of the evidence is drawn over time, in the little that a picture needs: drift without velocities, convergence.

A dive of hours has as many numbers here as one of minutes, but for one of each window in which the DVL was withheld.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Floats, TimeNs
from insdvl_replay.core.quantities import CONVERGED
from insdvl_replay.core.states import DV, PHI
from insdvl_replay.evaluation.coasting import Coasts, DriftOverTime, drift_over_time, window_ends
from insdvl_replay.evaluation.drawn_errors import DrawnErrors, squared_errors
from insdvl_replay.evaluation.measured_convergence import limit_of, over_last_part

FEWEST_STARTS: Final = 3
"""The dive's own, and two that are drawn."""


class CoastingCurve(NamedTuple):
    """How one filter drifts while the DVL is withheld.

    Attributes
    ----------
    over_time : DriftOverTime
        Over overlapping windows.
    begin_ns : ndarray, shape (w,)
        Last used ping before each of them.
    drift_m : ndarray, shape (w,)
        Horizontal drift at the end of each.
    """

    over_time: DriftOverTime
    begin_ns: TimeNs
    drift_m: Floats


class ConvergenceCurves(NamedTuple):
    """The errors of all filters from drawn starts, in one quantity, at times that lie ever further apart.

    Attributes
    ----------
    time_s : ndarray, shape (g,)
        After the start.
    rms, believed : dict of str to ndarray, shape (g,)
        By filter, SI units: true errors over the starts, and what the filter says of them from its own; both over the
        last part of what has passed, as `measured_convergence` has them.
    limit : float
        Below which a filter has converged.
    """

    time_s: Floats
    rms: Mapping[str, Floats]
    believed: Mapping[str, Floats]
    limit: float


class PositionCurve(NamedTuple):
    """The horizontal position errors of one filter over time.

    Attributes
    ----------
    time_s : ndarray, shape (k,)
        After the start.
    median_m, low_m, high_m : ndarray, shape (k,)
        Middle, smallest and largest over the starts; NaN where none is known.
    starts : int
        Drawn ones; the dive's own, if there is no other.
    """

    time_s: Floats
    median_m: Floats
    low_m: Floats
    high_m: Floats
    starts: int


@dataclass(frozen=True)
class Curves:
    """All that is drawn of the evidence on one dive.

    Attributes
    ----------
    coasting : dict of str to CoastingCurve
        By filter; empty where the dive is too short.
    convergence : dict of str to ConvergenceCurves
        By quantity of `quantities.CONVERGED`; empty without a reference or drawn starts.
    position : dict of str to PositionCurve
        By filter; empty without positions of a reference.
    """

    coasting: Mapping[str, CoastingCurve]
    convergence: Mapping[str, ConvergenceCurves]
    position: Mapping[str, PositionCurve]


def curves_of(drawn: Sequence[DrawnErrors], coasts: Coasts) -> Curves:
    """Reduce what was measured to what is drawn.

    Parameters
    ----------
    drawn : sequence of DrawnErrors
        Of the filters, the baseline first; empty without a reference.
    """
    return Curves(coasting_curves(coasts), convergence_curves(drawn), position_curves(drawn))


def position_curves(drawn: Sequence[DrawnErrors]) -> dict[str, PositionCurve]:
    """Gather the horizontal position errors of each filter from its drawn starts, or from its own alone."""
    found = {}
    for of_one in drawn:
        ned_m = np.stack([run.position_error_ned_m for run in of_one.against_reference])
        with np.errstate(over="ignore", invalid="ignore"):
            error_m = np.hypot(ned_m[..., 0], ned_m[..., 1])
        if np.isfinite(error_m).all(axis=0).any():
            shown = error_m[1:] if len(error_m) > 1 else error_m
            ends = np.median(shown, axis=0), shown.min(axis=0), shown.max(axis=0)
            found[of_one.filter] = PositionCurve(of_one.time_s, *ends, len(shown))
    return found


def coasting_curves(coasts: Coasts) -> dict[str, CoastingCurve]:
    """Gather the drift of each filter in the windows that are shown."""
    shown = coasts.plan.shown
    if not len(shown.first):
        return {}
    begin_ns = coasts.plan.ping_ns[shown.first]
    with np.errstate(over="ignore", invalid="ignore"):
        return {
            name: CoastingCurve(drift_over_time(coasts, name), begin_ns, window_ends(coasts, name, shown).drift_m)
            for name in coasts.runs
        }


def convergence_curves(drawn: Sequence[DrawnErrors]) -> dict[str, ConvergenceCurves]:
    """Take the rms of each filter's true errors over its drawn starts, without the dive's own."""
    drawn = [of_one for of_one in drawn if len(of_one.error) >= FEWEST_STARTS]
    if not drawn:
        return {}
    squares = [_from_drawn_starts(of_one) for of_one in drawn]
    found = {
        quantity: _curves(quantity, drawn, [square[quantity] for square in squares])
        for quantity in CONVERGED
        if all(quantity in square for square in squares)
    }
    return {quantity: curves for quantity, curves in found.items() if curves is not None}


def _from_drawn_starts(drawn: DrawnErrors) -> dict[str, Floats]:
    squares = squared_errors(drawn)
    return {quantity: squares[name][1:] for quantity, name in CONVERGED.items() if name in squares}


def _curves(quantity: str, drawn: Sequence[DrawnErrors], squares: Sequence[Floats]) -> ConvergenceCurves | None:
    known = np.all([np.isfinite(square).any(axis=0) for square in squares], axis=0)
    if not known.any():
        return None
    believed = [_believed_sq(quantity, of_one.sd) for of_one in drawn]
    at_s, *means = over_last_part(drawn[0].time_s[known], *(square[:, known] for square in (*squares, *believed)))
    rms = {of_one.filter: np.sqrt(mean.mean(axis=0)) for of_one, mean in zip(drawn, means, strict=False)}
    expected = {of_one.filter: np.sqrt(mean[0]) for of_one, mean in zip(drawn, means[len(drawn) :], strict=True)}
    limit = limit_of(float(rms[drawn[0].filter][-1]), len(squares[0]))
    return ConvergenceCurves(at_s, rms, expected, limit)


def _believed_sq(quantity: str, sd: Floats) -> Floats:
    """Return the square that a filter expects, shape (1, k)."""
    with np.errstate(over="ignore"):
        velocity_sq, attitude_sq = sd[:, DV] ** 2, sd[:, PHI] ** 2
    expected: dict[str, Floats] = {
        "velocity": velocity_sq[:, :2].sum(axis=1),
        "level": attitude_sq[:, :2].mean(axis=1),
        "heading": attitude_sq[:, 2],
    }
    return expected[quantity][None, :]
