"""The Kalman update in Joseph form. It knows neither time nor sensors.

The loops are written out: the matrices are small, and the compiler makes less of library calls.
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
            total = 0.0
            for k in range(A.shape[1]):
                total += A[i, k] * B[k, j]
            product[i, j] = total


@compiled
def multiply_transposed(A: Floats, B: Floats, product: Floats) -> None:
    """Write ``A B'``; ``product`` is neither of them."""
    for i in range(A.shape[0]):
        for j in range(B.shape[0]):
            total = 0.0
            for k in range(A.shape[1]):
                total += A[i, k] * B[j, k]
            product[i, j] = total


@compiled
def innovation_cov(P: Floats, H: Floats, R: Floats, PH: Floats, S: Floats) -> None:
    """Write the covariance of the innovation, ``S = H P H' + R``.

    Parameters
    ----------
    P : ndarray, shape (n, n)
    H : ndarray, shape (m, n)
    R : ndarray, shape (m, m)
    PH : ndarray, shape (n, m)
        Written: P H'.
    S : ndarray, shape (m, m)
        Written, symmetric.
    """
    multiply_transposed(P, H, PH)
    multiply(H, PH, S)
    for i in range(S.shape[0]):
        for j in range(i + 1):
            S[i, j] = 0.5 * (S[i, j] + S[j, i] + R[i, j] + R[j, i])
            S[j, i] = S[i, j]


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
def gain(PH: Floats, L: Floats) -> Floats:
    """Solve ``K S = P H'`` for the gain, with the Cholesky factor of S and without inverting it.

    Parameters
    ----------
    PH : ndarray, shape (n, m)
    L : ndarray, shape (m, m)

    Returns
    -------
    ndarray, shape (n, m)
    """
    n, m = PH.shape
    K = np.empty((n, m))
    for row in range(n):
        for i in range(m):
            total = PH[row, i]
            for k in range(i):
                total -= L[i, k] * K[row, k]
            K[row, i] = total / L[i, i]
        for i in range(m - 1, -1, -1):
            total = K[row, i]
            for k in range(i + 1, m):
                total -= L[k, i] * K[row, k]
            K[row, i] = total / L[i, i]
    return K


@compiled
def update_cov(P: Floats, H: Floats, R: Floats, K: Floats) -> None:
    """Update the covariance in place, ``P <- (I - K H) P (I - K H)' + K R K'``, and keep it symmetric.

    With ``A = I - K H`` it is ``A P + (K R - A P H') K'``; if K is the gain, the bracket vanishes but for rounding.
    Multiplied out in this way, no product is of two matrices of n columns.

    Parameters
    ----------
    P : ndarray, shape (n, n)
    H : ndarray, shape (m, n)
    R : ndarray, shape (m, m)
    K : ndarray, shape (n, m)
    """
    n, m = K.shape
    HP, AP, change = np.empty((m, n)), np.empty((n, n)), np.empty((n, n))
    APH, rest = np.empty((n, m)), np.empty((n, m))
    multiply(H, P, HP)
    multiply(K, HP, change)
    for i in range(n):
        for j in range(n):
            AP[i, j] = P[i, j] - change[i, j]
    multiply_transposed(AP, H, APH)
    multiply(K, R, rest)
    for i in range(n):
        for j in range(m):
            rest[i, j] -= APH[i, j]
    multiply_transposed(rest, K, change)
    for i in range(n):
        for j in range(n):
            P[i, j] = 0.5 * ((AP[i, j] + AP[j, i]) + (change[i, j] + change[j, i]))
