"""The gate for innovations, and the way back in when it has locked the DVL out.

A spike of the IMU, or a long outage of which less was known than the filter says, leaves a velocity that is far off and
a covariance that does not know it: each ping is rejected, and none can put the velocity right. Outliers of a DVL do not
last; so many of them in a row are the INS's. Where the velocity alone does not help, because levels or biases took part
of the error over before the gate closed, they are opened, too.
"""

import math
from typing import Final

from insdvl_replay.core.columns import Floats
from insdvl_replay.core.compiled import inlined
from insdvl_replay.nav.state_log import Updates
from insdvl_replay.nav.vector_algebra import Vector, dot

RUN_PAUSE_S: Final = 60.0
"""Rejections further apart, as on both sides of an outage, are no run."""
SOON_S: Final = 60.0
"""A filter that is lost again so soon was not put right by its velocity."""


@inlined
def locks_out(updates: Updates, m: int, nis: float, time_s: float, reopen_after: int) -> bool:
    """Count a rejection, and tell whether there were so many in a row that it is the INS which is off."""
    if not math.isfinite(nis):
        return False
    goes_on = time_s - updates.refused_s[m] <= RUN_PAUSE_S
    updates.refused_in_a_row[m] = updates.refused_in_a_row[m] + 1 if goes_on else 1
    updates.refused_s[m] = time_s
    lost: bool = 0 < reopen_after <= updates.refused_in_a_row[m]
    return lost


@inlined
def open_state(P: Floats, innovation: Vector, start_var: Floats, updates: Updates, m: int, time_s: float) -> None:
    """Let the velocity be as uncertain on each axis as the innovation is large: the next gain sets it to the DVL's.

    Other states keep their uncertainty and their correlations with the velocity, and hardly move. A filter that is lost
    again within `SOON_S` was not put right by that: levels, heading and biases become as uncertain as at the start, on
    top of what they are.

    Parameters
    ----------
    P : ndarray, shape (12, 12)
        Covariance; variances grow, in place.
    innovation : tuple of 3 float
        z, m/s.
    start_var : ndarray, shape (12,)
        Variances at the start.
    updates : Updates
        Its time of this kind of measurement is changed.
    m : int
        The kind of measurement.
    time_s : float
        Seconds from the start.
    """
    if time_s - updates.reopened_s[m] <= SOON_S:
        for i in range(3, 12):
            P[i, i] += start_var[i]
    for i in range(3):
        P[i, i] += dot(innovation, innovation)
    updates.reopened_s[m], updates.refused_in_a_row[m] = time_s, 0
