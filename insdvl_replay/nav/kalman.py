"""The Kalman update in Joseph form, for measurements of three components. It knows neither time nor sensors.

What has three components is a tuple; what has a column for each of the n states is an array, whose inner loops run
along memory. The loops are written out: the matrices are small, and the compiler makes less of library calls.
Source: Groves, chapter 3; for NIS, Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and
Navigation", chapter 5.
"""

import math

from insdvl_replay.core.compiled import inlined
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.nav.vector_algebra import Matrix, Vector, column_vector, dot, rotate, subtract, write_column_vector


@inlined
def multiply(A: Floats, B: Floats, product: Floats) -> None:
    """Write ``A B``; ``product`` is neither of them."""
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            product[i, j] = 0.0
        for k in range(A.shape[1]):
            factor = A[i, k]
            for j in range(B.shape[1]):
                product[i, j] += factor * B[k, j]


@inlined
def innovation_cov(P: Floats, H: Floats, R: Matrix, HP: Floats) -> Matrix:
    """Return the covariance of the innovation, ``S = H P H' + R``.

    Parameters
    ----------
    P : ndarray, shape (n, n)
    H : ndarray, shape (3, n)
    HP : ndarray, shape (3, n)
        Written: H P.

    Returns
    -------
    tuple of 3 rows
        Symmetric.
    """
    multiply(H, P, HP)
    xx, yx, yy, zx, zy, zz = R[0][0], R[1][0], R[1][1], R[2][0], R[2][1], R[2][2]
    for k in range(H.shape[1]):
        h, hp = column_vector(H, k), column_vector(HP, k)
        xx, yx, yy = xx + hp[0] * h[0], yx + hp[1] * h[0], yy + hp[1] * h[1]
        zx, zy, zz = zx + hp[2] * h[0], zy + hp[2] * h[1], zz + hp[2] * h[2]
    return (xx, yx, zx), (yx, yy, zy), (zx, zy, zz)


@inlined
def cholesky(S: Matrix) -> Matrix:
    """Return the lower triangle L with ``L L' = S``; NaN where S is not positive definite."""
    xx = _root(S[0][0])
    yx, zx = S[1][0] / xx, S[2][0] / xx
    yy = _root(S[1][1] - yx * yx)
    zy = (S[2][1] - zx * yx) / yy
    return (xx, 0.0, 0.0), (yx, yy, 0.0), (zx, zy, _root(S[2][2] - zx * zx - zy * zy))


@inlined
def _root(square: float) -> float:
    return math.sqrt(square) if square > 0.0 else math.nan


@inlined
def standardised(L: Matrix, innovation: Vector) -> Vector:
    """Return ``L^-1 z``: innovations in standard deviations, uncorrelated. The sum of their squares is NIS."""
    x = innovation[0] / L[0][0]
    y = (innovation[1] - L[1][0] * x) / L[1][1]
    return x, y, (innovation[2] - L[2][0] * x - L[2][1] * y) / L[2][2]


@inlined
def transposed_gain(HP: Floats, L: Matrix, KT: Floats) -> None:
    """Solve ``S K' = H P`` for the gain, with the Cholesky factor of S and without inverting it.

    Parameters
    ----------
    HP : ndarray, shape (3, n)
    KT : ndarray, shape (3, n)
        Written: K'.
    """
    for j in range(HP.shape[1]):
        halfway = standardised(L, column_vector(HP, j))
        z = halfway[2] / L[2][2]
        y = (halfway[1] - L[2][1] * z) / L[1][1]
        x = (halfway[0] - L[1][0] * y - L[2][0] * z) / L[0][0]
        write_column_vector((x, y, z), KT, j)


@inlined
def update_cov(P: Floats, H: Floats, R: Matrix, HP: Floats, KT: Floats, rest: Floats) -> None:
    """Update the covariance in place, ``P <- (I - K H) P (I - K H)' + K R K'``, and keep it symmetric.

    With ``B = P (I - K H)'`` it is ``B + K (R K' - H B)``; if K is the gain, the bracket vanishes but for rounding.
    Multiplied out in this way, no product is of two matrices of n columns and rows.

    Parameters
    ----------
    P : ndarray, shape (n, n)
    H : ndarray, shape (3, n)
    HP : ndarray, shape (3, n)
        H P.
    KT : ndarray, shape (3, n)
        K'.
    rest : ndarray, shape (3, n)
        Written: the bracket.
    """
    _subtract_transposed_product(HP, KT, P)
    multiply(H, P, rest)
    for j in range(H.shape[1]):
        write_column_vector(subtract(column_vector(rest, j), rotate(R, column_vector(KT, j))), rest, j)
    _subtract_transposed_product(KT, rest, P)
    for i in range(P.shape[0]):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@inlined
def _subtract_transposed_product(A: Floats, B: Floats, total: Floats) -> None:
    """Subtract ``A' B``."""
    for i in range(A.shape[1]):
        a = column_vector(A, i)
        for j in range(B.shape[1]):
            total[i, j] -= dot(a, column_vector(B, j))
