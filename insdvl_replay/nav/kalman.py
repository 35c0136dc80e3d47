"""The Kalman update in Joseph form. It knows neither time nor sensors.

The loops are written out: the matrices are small, and the compiler makes less of library calls. All matrices of a
measurement have its few components as rows and the n states as columns, so that the inner loops run along memory.
Source: Groves, chapter 3; for NIS, Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and
Navigation", chapter 5.
"""

import math

import numpy as np

from insdvl_replay.columns import Floats
from insdvl_replay.compiled import compiled


@compiled
def multiply(A: Floats, B: Floats, product: Floats) -> None:
    """Write ``A B``; ``product`` is neither of them."""
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            product[i, j] = 0.0
        for k in range(A.shape[1]):
            factor = A[i, k]
            for j in range(B.shape[1]):
                product[i, j] += factor * B[k, j]


@compiled
def add_transposed_product(A: Floats, B: Floats, sign: float, total: Floats) -> None:
    """Add ``sign A' B``."""
    for i in range(A.shape[1]):
        for k in range(A.shape[0]):
            factor = sign * A[k, i]
            for j in range(B.shape[1]):
                total[i, j] += factor * B[k, j]


@compiled
def innovation_cov(P: Floats, H: Floats, R: Floats, HP: Floats, S: Floats) -> None:
    """Write the covariance of the innovation, ``S = H P H' + R``.

    Parameters
    ----------
    P : ndarray, shape (n, n)
    H : ndarray, shape (m, n)
    R : ndarray, shape (m, m)
    HP : ndarray, shape (m, n)
        Written: H P.
    S : ndarray, shape (m, m)
        Written, symmetric.
    """
    multiply(H, P, HP)
    for i in range(S.shape[0]):
        for j in range(i + 1):
            twice = R[i, j] + R[j, i]
            for k in range(H.shape[1]):
                twice += HP[i, k] * H[j, k] + HP[j, k] * H[i, k]
            S[i, j] = S[j, i] = 0.5 * twice


@compiled
def cholesky(S: Floats, L: Floats) -> None:
    """Write the lower triangle L with ``L L' = S``; NaN where S is not positive definite.

    Parameters
    ----------
    S : ndarray, shape (m, m)
    L : ndarray, shape (m, m)
        Written; above the diagonal it is left alone.
    """
    for i in range(S.shape[0]):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total / L[j, j]
            else:
                L[i, i] = math.sqrt(total) if total > 0.0 else math.nan


@compiled
def standardised(L: Floats, innovation: Floats) -> Floats:
    """Give ``L^-1 z``: innovations in standard deviations, uncorrelated. The sum of their squares is NIS.

    Parameters
    ----------
    L : ndarray, shape (m, m)
        Cholesky factor of S.
    innovation : ndarray, shape (m,)

    Returns
    -------
    ndarray, shape (m,)
    """
    whitened = np.empty(len(innovation))
    for i in range(len(innovation)):
        total = innovation[i]
        for k in range(i):
            total -= L[i, k] * whitened[k]
        whitened[i] = total / L[i, i]
    return whitened


@compiled
def transposed_gain(HP: Floats, L: Floats) -> Floats:
    """Solve ``S K' = H P`` for the gain, with the Cholesky factor of S and without inverting it.

    Parameters
    ----------
    HP : ndarray, shape (m, n)
    L : ndarray, shape (m, m)

    Returns
    -------
    ndarray, shape (m, n)
        K'.
    """
    m, n = HP.shape
    KT = HP.copy()
    for i in range(m):
        for k in range(i):
            for j in range(n):
                KT[i, j] -= L[i, k] * KT[k, j]
        for j in range(n):
            KT[i, j] /= L[i, i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            for j in range(n):
                KT[i, j] -= L[k, i] * KT[k, j]
        for j in range(n):
            KT[i, j] /= L[i, i]
    return KT


@compiled
def update_cov(P: Floats, H: Floats, R: Floats, HP: Floats, KT: Floats) -> None:
    """Update the covariance in place, ``P <- (I - K H) P (I - K H)' + K R K'``, and keep it symmetric.

    With ``B = P (I - K H)'`` it is ``B + K (R K' - H B)``; if K is the gain, the bracket vanishes but for rounding.
    Multiplied out in this way, no product is of two matrices of n columns and rows.

    Parameters
    ----------
    P : ndarray, shape (n, n)
    H : ndarray, shape (m, n)
    R : ndarray, shape (m, m)
    HP : ndarray, shape (m, n)
        H P.
    KT : ndarray, shape (m, n)
        K'.
    """
    m, n = H.shape
    B, HB, rest = P.copy(), np.empty((m, n)), np.empty((m, n))
    add_transposed_product(HP, KT, -1.0, B)
    multiply(H, B, HB)
    multiply(R, KT, rest)
    for i in range(m):
        for j in range(n):
            rest[i, j] -= HB[i, j]
    add_transposed_product(KT, rest, 1.0, B)
    for i in range(n):
        for j in range(n):
            P[i, j] = 0.5 * (B[i, j] + B[j, i])
