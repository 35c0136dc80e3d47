"""How near the slope of the DVL's velocities comes to the acceleration of the reference.

Both are rates of the velocity's components in body axes. The reference is differentiated at its own times, between the
rows on either side; in between, the acceleration is taken on the line from row to row. No attitude is interpolated: a
reference of 1 Hz says nothing of it inside a sharp turn, while the body's own velocity hardly changes there.
"""

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs, seconds


def reference_acceleration(reference: ReferenceColumns, max_gap_s: float) -> Floats:
    """Differentiate the reference's velocity in body axes, by central differences of second order.

    Parameters
    ----------
    reference : ReferenceColumns
        r rows, at any spacing.
    max_gap_s : float
        Rows that a longer pause follows or precedes have no acceleration.

    Returns
    -------
    ndarray, shape (r, 3), m/s^2
        NaN in the first and last row, beside gaps, and beside rows without velocity or attitude.
    """
    acceleration_b = np.full((len(reference.time_ns), 3), np.nan)
    if len(reference.time_ns) < 3:
        return acceleration_b
    velocity_b = np.einsum("kji,kj->ki", reference.mat_nb, reference.velocity_n)
    time_s = seconds(reference.time_ns, reference.time_ns[:1])
    acceleration_b[1:-1] = np.gradient(velocity_b, time_s, axis=0)[1:-1]
    apart = np.diff(time_s) > max_gap_s
    acceleration_b[:-1][apart] = acceleration_b[1:][apart] = np.nan
    return acceleration_b


def acceleration_at(time_ns: TimeNs, reference_ns: TimeNs, acceleration_b: Floats) -> Floats:
    """Return the reference's acceleration at other times, on the line between its rows.

    Parameters
    ----------
    time_ns : ndarray, shape (k,)
    reference_ns : ndarray, shape (r,)
    acceleration_b : ndarray, shape (r, 3)
        From `reference_acceleration`.

    Returns
    -------
    ndarray, shape (k, 3), m/s^2
        NaN where a row beside the time has none.
    """
    time_s, row_s = seconds(time_ns, reference_ns[:1]), seconds(reference_ns, reference_ns[:1])
    return np.column_stack([np.interp(time_s, row_s, axis, np.nan, np.nan) for axis in acceleration_b.T])


def differentiated_over_s(reference: ReferenceColumns) -> float:
    """Return the time over which the reference's velocity is differentiated, from row to row but one, in the median.

    Parameters
    ----------
    reference : ReferenceColumns
        At least three rows.
    """
    return float(np.median(seconds(reference.time_ns[2:], reference.time_ns[:-2])))


def vector_rmse(estimated: Floats, reference: Floats, rows: NDArray[np.bool_]) -> float:
    """Return the root mean square length of the difference of vectors.

    Equation (55) of Levy and Klein.

    Parameters
    ----------
    estimated, reference : ndarray, shape (k, 3)
    rows : ndarray of bool, shape (k,)
        Which of them count.

    Returns
    -------
    float
        NaN without rows.
    """
    if not rows.any():
        return float("nan")
    return float(np.sqrt(np.mean(np.sum((estimated[rows] - reference[rows]) ** 2, axis=1))))
