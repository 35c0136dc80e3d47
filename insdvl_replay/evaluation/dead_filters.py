"""Filters that have lost their way: of what they are better or worse at, nothing can be said."""

from typing import Final

import numpy as np
from scipy.special import chdtrc

from insdvl_replay.core.columns import NS_PER_S
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.evaluation.consistency import MANY_REJECTED, rejections

MANY_REOPENED = 0.01
"""Share of the pings; each comes after several that were rejected."""
FEW: Final = 2
"""So many rejections prove nothing, in however short a dive."""


def dead_filters(histories: tuple[History, ...]) -> dict[str, str]:
    """Find the filters that are not to be judged.

    Parameters
    ----------
    histories : tuple of History

    Returns
    -------
    dict of str to str
        By name of the filter what is wrong with it; those that are sound are left out. A filter is dead where its state
        is not finite, where its gate rejected more than `MANY_REJECTED` of what locks it out (the velocities, or the
        accelerations of a filter that has no others), or where it was set to the DVL again more than once and at more
        than `MANY_REOPENED` of its pings. What a gate rejects of a sound filter by chance is allowed for.
    """
    found = {
        history.filter: _not_finite(history) or _locked_out(history) or _set_again(history) for history in histories
    }
    return {name: wrong for name, wrong in found.items() if wrong}


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
    innovations = _leading(history)
    if innovations is None:
        return ""
    rejected, total = rejections(innovations), len(innovations.used)
    if rejected <= max(FEW, (MANY_REJECTED + _by_chance(innovations)) * total):
        return ""
    return f"{history.filter} rejected {rejected} of {total} {innovations.measurement} innovations"


def _set_again(history: History) -> str:
    """Find a filter that is not thrown off once, but errs all the time, and is saved from itself every so often."""
    innovations = _leading(history)
    if innovations is None:
        return ""
    reopened, total = int(innovations.reopened.sum()), len(innovations.used)
    if reopened <= max(1.0, (MANY_REOPENED + _by_chance(innovations) ** innovations.reopen_after) * total):
        return ""
    return f"{history.filter} lost its way {reopened} times in {total} velocity innovations"


def _by_chance(innovations: Innovations) -> float:
    """Give the share of the innovations that the gate of a sound filter rejects."""
    return float(chdtrc(innovations.dof, innovations.gate))


def _leading(history: History) -> Innovations | None:
    velocities = [innovations for innovations in history.innovations if innovations.measurement == "velocity"]
    return next(iter((*velocities, *history.innovations)), None)
