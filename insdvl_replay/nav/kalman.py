"""The Kalman update in Joseph form, for measurements of m components. It knows neither time nor sensors.

Inner loops run along the n states, as memory does. The loops are written out: the matrices are small, and the compiler
makes less of library calls. Source: Groves, chapter 3; for NIS, Bar-Shalom, Li and Kirubarajan, "Estimation with
Applications to Tracking and Navigation", chapter 5.
"""

import math

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import inlined


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
def innovation_cov(P: Floats, H: Floats, R: Floats, HP: Floats, S: Floats) -> None:
    """Write the covariance of the innovation, ``S = H P H' + R``.

    Parameters
    ----------
    P : ndarray, shape (n, n)
    H : ndarray, shape (m, n)
    R : ndarray, shape (m, m)
        Symmetric.
    HP : ndarray, shape (m, n)
        Written: H P.
    S : ndarray, shape (m, m)
        Written, symmetric.
    """
    multiply(H, P, HP)
    for i in range(H.shape[0]):
        for j in range(i + 1):
            total = R[i, j]
            for k in range(H.shape[1]):
                total += HP[i, k] * H[j, k]
            S[i, j] = S[j, i] = total


@inlined
def cholesky(S: Floats, L: Floats) -> None:
    """Write the lower triangle L with ``L L' = S``; NaN where S is not positive definite. Both have shape (m, m)."""
    for i in range(S.shape[0]):
        for j in range(i):
            rest = S[i, j]
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            L[i, j] = rest / L[j, j]
        square = S[i, i]
        for k in range(i):
            square -= L[i, k] * L[i, k]
        L[i, i] = math.sqrt(square) if square > 0.0 else math.nan


@inlined
def normalised_square(L: Floats, innovation: Floats, standardised: Floats) -> float:
    """Return ``z' S^-1 z``, the NIS, and write ``L^-1 z``: innovations in standard deviations, uncorrelated.

    Parameters
    ----------
    L : ndarray, shape (m, m)
        Of `cholesky`.
    innovation : ndarray, shape (m,)
    standardised : ndarray, shape (m,)
        Written.
    """
    total = 0.0
    for i in range(L.shape[0]):
        rest = innovation[i]
        for k in range(i):
            rest -= L[i, k] * standardised[k]
        standardised[i] = rest / L[i, i]
        total += standardised[i] * standardised[i]
    return total


@inlined
def transposed_gain(HP: Floats, L: Floats, KT: Floats) -> None:
    """Solve ``S K' = H P`` for the gain, with the Cholesky factor of S and without inverting it.

    Parameters
    ----------
    HP : ndarray, shape (m, n)
    L : ndarray, shape (m, m)
    KT : ndarray, shape (m, n)
        Written: K'.
    """
    for i in range(HP.shape[0]):
        for j in range(HP.shape[1]):
            KT[i, j] = HP[i, j]
    _substitute_forward(L, KT)
    _substitute_backward(L, KT)


@inlined
def _substitute_forward(L: Floats, X: Floats) -> None:
    """Write ``L^-1 X`` in the place of X, shape (m, n)."""
    for i in range(X.shape[0]):
        for k in range(i):
            for j in range(X.shape[1]):
                X[i, j] -= L[i, k] * X[k, j]
        for j in range(X.shape[1]):
            X[i, j] /= L[i, i]


@inlined
def _substitute_backward(L: Floats, X: Floats) -> None:
    """Write ``L'^-1 X`` in the place of X, shape (m, n)."""
    for i in range(X.shape[0] - 1, -1, -1):
        for k in range(i + 1, X.shape[0]):
            for j in range(X.shape[1]):
                X[i, j] -= L[k, i] * X[k, j]
        for j in range(X.shape[1]):
            X[i, j] /= L[i, i]


@inlined
def update_cov(P: Floats, H: Floats, R: Floats, HP: Floats, KT: Floats, rest: Floats) -> None:
    """Update the covariance in place, ``P <- (I - K H) P (I - K H)' + K R K'``, and keep it symmetric.

    With ``B = P (I - K H)'`` it is ``B + K (R K' - H B)``; if K is the gain, the bracket vanishes but for rounding.
    Multiplied out in this way, no product is of two matrices of n columns and rows.

    Parameters
    ----------
    P : ndarray, shape (n, n)
    H : ndarray, shape (m, n)
    R : ndarray, shape (m, m)
    HP : ndarray, shape (m, n)
        H P; used up.
    KT : ndarray, shape (m, n)
        K'.
    rest : ndarray, shape (m, n)
        Written: the bracket.
    """
    _subtract_transposed_product(HP, KT, P, rest[0])
    multiply(H, P, rest)
    multiply(R, KT, HP)
    for i in range(H.shape[0]):
        for j in range(H.shape[1]):
            rest[i, j] -= HP[i, j]
    _subtract_transposed_product(KT, rest, P, HP[0])
    for i in range(P.shape[0]):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@inlined
def _subtract_transposed_product(A: Floats, B: Floats, total: Floats, row: Floats) -> None:
    """Subtract ``A' B``, row by row; ``row`` is written."""
    for i in range(A.shape[1]):
        for j in range(B.shape[1]):
            row[j] = A[0, i] * B[0, j]
        for k in range(1, A.shape[0]):
            for j in range(B.shape[1]):
                row[j] += A[k, i] * B[k, j]
        for j in range(B.shape[1]):
            total[i, j] -= row[j]
