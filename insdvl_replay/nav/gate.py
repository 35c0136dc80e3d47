"""The gate for innovations, and the way back in when it has locked the DVL out.

A spike of the IMU, or a long outage of which less was known than the filter says, leaves a velocity that is far off and
a covariance that does not know it: each ping is rejected, and none can put the velocity right. Outliers of a DVL do not
last; so many of them in a row are the INS's.
"""

import math

from insdvl_replay.columns import Floats
from insdvl_replay.compiled import inlined
from insdvl_replay.nav.vector_algebra import Matrix, Vector, dot


@inlined
def locks_out(nis: float, refused_in_a_row: int, reopen_after: int) -> bool:
    """Tell whether a gate has rejected so many in a row that it is the INS which is off.

    Parameters
    ----------
    nis : float
        Of the innovation that has been rejected; one that is not finite helps nobody.
    refused_in_a_row : int
        Rejections, this one included.
    reopen_after : int
        So many are enough; 0: none are.

    Returns
    -------
    bool
    """
    return 0 < reopen_after <= refused_in_a_row and math.isfinite(nis)


@inlined
def open_velocity(P: Floats, S: Matrix, innovation: Vector) -> Matrix:
    """Let the velocity be as uncertain on each axis as the innovation is large: the next gain sets it to the DVL's.

    Other states keep their uncertainty and their correlations with the velocity, and hardly move.

    Parameters
    ----------
    P : ndarray, shape (12, 12)
        Covariance; the variances of the velocity error grow, in place.
    S : tuple of 3 rows
        Covariance of the innovation before.
    innovation : tuple of 3 float
        z, m/s.

    Returns
    -------
    tuple of 3 rows
        Covariance of the innovation after. The rows of H that belong to the velocity are a rotation.
    """
    variance = dot(innovation, innovation)
    for i in range(3):
        P[i, i] += variance
    return (
        (S[0][0] + variance, S[0][1], S[0][2]),
        (S[1][0], S[1][1] + variance, S[1][2]),
        (S[2][0], S[2][1], S[2][2] + variance),
    )
