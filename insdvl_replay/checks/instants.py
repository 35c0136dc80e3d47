"""Rows of two roles that were recorded at one instant: where they hold the same numbers, one was made of the other."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import TimeNs, nanoseconds

SAME_NS: Final = 2_000
"""Times that differ by less are one: a file of seconds since 1970 holds microseconds."""


def same_instants(
    ours_ns: TimeNs, theirs_ns: TimeNs, latency_s: float = 0.0
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pair rows whose times differ by what most of them do, which may be up to half a step of theirs.

    Parameters
    ----------
    ours_ns, theirs_ns : ndarray, shapes (k,) and (r,)
        Strictly increasing.
    latency_s : float
        That was taken off ours, less that which was taken off theirs: what was one message lies so far apart.

    Returns
    -------
    tuple of ndarray
        Rows of the one and of the other, pair by pair.
    """
    if not len(ours_ns) or not len(theirs_ns):
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    ours_ns = ours_ns + nanoseconds(latency_s)
    after = np.minimum(np.searchsorted(theirs_ns, ours_ns), len(theirs_ns) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(theirs_ns[before] - ours_ns) < np.abs(theirs_ns[after] - ours_ns), before, after)
    apart_ns = ours_ns - theirs_ns[nearest]
    ours = np.flatnonzero(np.abs(apart_ns - int(np.median(apart_ns))) <= SAME_NS)
    return ours, nearest[ours]
