"""Long series made short for the eye: lowest and highest value of each column of the paper, so that no peak is lost."""

import numpy as np

from insdvl_replay.core.dive_columns import Floats

COLUMNS = 150
"""Columns of a panel: about two screen pixels each."""
_FEW = 4
"""So many curves have all columns each; more share as many, or the page of many filters would be too large to send."""


def shared_columns(curves: int) -> int:
    """Return the columns of each of the curves of a panel."""
    return COLUMNS * _FEW // max(curves, _FEW)


def envelope(x: Floats, y: Floats, columns: int = COLUMNS) -> tuple[Floats, Floats]:
    """Keep the lowest and the highest value of each column, where they are.

    Parameters
    ----------
    x : ndarray, shape (k,)
        Not decreasing.
    y : ndarray, shape (k,)
    columns : int
        Shorter lines, up to two points for each column, are left as they are.

    Returns
    -------
    x, y : ndarray, shape (m,)
        At most two points for each column; NaN where all of a column is missing.
    """
    if len(x) <= 2 * columns:
        return x, y
    column = _columns(x, columns)
    known = np.flatnonzero(np.isfinite(y))
    by_size = known[np.lexsort((y[known], column[known]))]
    begins = np.diff(column[by_size], prepend=-1.0) > 0.0
    lowest, highest = by_size[begins], by_size[np.roll(begins, -1)]
    missing = np.unique(column, return_index=True)[1]
    missing = missing[~np.isin(column[missing], column[known])]
    kept = np.unique(np.concatenate([lowest, highest, missing]))
    return x[kept], y[kept]


def band_envelope(x: Floats, low: Floats, high: Floats, columns: int = COLUMNS) -> tuple[Floats, Floats, Floats]:
    """Make a band short: the lowest of the lower and the highest of the upper edge in each column.

    Parameters
    ----------
    x, low, high : ndarray, shape (k,)

    Returns
    -------
    x, low, high : ndarray, shape (m,)
    """
    if len(x) <= columns:
        return x, low, high
    starts = np.flatnonzero(np.diff(_columns(x, columns), prepend=-1.0))
    ends = np.append(starts[1:], len(x)) - 1
    return (x[starts] + x[ends]) / 2.0, np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)


def without_standstill(x: Floats, y: Floats, step: float) -> tuple[Floats, Floats]:
    """Leave out the points of a curve in the plane that do not leave their cell of a grid.

    Parameters
    ----------
    x, y : ndarray, shape (k,)
    step : float
        Width of a cell, above zero.

    Returns
    -------
    x, y : ndarray, shape (m,)
        The first point of each stay in a cell, and the last point of all.
    """
    cells = np.floor(np.column_stack([x, y]) / step)
    moved = np.ones(len(x), dtype=bool)
    moved[1:-1] = (cells[1:-1] != cells[:-2]).any(axis=1)
    return x[moved], y[moved]


def _columns(x: Floats, columns: int) -> Floats:
    """Return the column of each point, counted from 0."""
    column: Floats = np.floor((x - x[0]) * (columns / (x[-1] - x[0])))
    return column.clip(max=columns - 1.0)
