"""Runs of neighbouring rows that have something in common."""

import numpy as np
from numpy.typing import NDArray


def find_runs(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find where a mask is true.

    Parameters
    ----------
    mask : ndarray of bool, shape (k,)

    Returns
    -------
    starts, ends : ndarray, shape (runs,)
        First row of each run, and the row behind its last.
    """
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    return edges[::2], edges[1::2]
