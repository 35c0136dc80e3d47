"""Observability: which errors at the start of a span its measurements can tell apart.

The rows ``H(t) Phi(t, t0)`` of all pings are stacked. Each is divided by its measurement's noise, so that velocities
and accelerations can stand in one stack, and each state is counted in units of its prior standard deviation. A singular
value s is then a ratio of signal to noise: were there no process noise, the measurements would leave
``1 / sqrt(1 + s^2)`` of the prior uncertainty along its direction. What they leave with it, see `remaining_cov`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import compiled, inlined
from insdvl_replay.nav.innovation import InsAtPing, linearise
from insdvl_replay.nav.kalman import cholesky, innovation_cov, multiply, transposed_gain, update_cov
from insdvl_replay.nav.local_earth import place_at
from insdvl_replay.nav.measurements import Measurement, Stack, stacked
from insdvl_replay.nav.nominal_motion import NominalPings
from insdvl_replay.nav.state_layout import TWELVE, TWELVE_ALONE
from insdvl_replay.nav.vector_algebra import Vector, row_matrix, row_vector, vector

TOLERANCE: Final = 3e-6
"""Rounding leaves about 1e-8 of the largest singular value; the weakest effect, of the Earth's rate, is about 1e-5."""


def whitened_rows(pings: NominalPings, measurement: Measurement, lever_arm_b: Floats) -> Floats:
    """Stack ``R^(-1/2) H(t) Phi(t, t0)`` over the pings that have a measurement.

    Equation (47) of Levy and Klein: a direction is unobservable where all these rows are blind to it.

    Parameters
    ----------
    pings : NominalPings
        m pings.
    measurement : Measurement
        Of the same pings.
    lever_arm_b : ndarray, shape (3,)
        IMU to DVL, m.

    Returns
    -------
    ndarray, shape (3 k, 12)
        Three rows for each of the k pings that have the measurement.
    """
    rows = np.flatnonzero(measurement.available)
    H = jacobians(pings, measurement, lever_arm_b)[rows]
    L = np.linalg.cholesky(measurement.cov[rows])
    whitened: Floats = np.linalg.solve(L, H @ pings.transition[rows]).reshape(-1, TWELVE)
    return whitened


def jacobians(pings: NominalPings, measurement: Measurement, lever_arm_b: Floats) -> Floats:
    """Return the H of a measurement at every ping.

    Parameters
    ----------
    pings : NominalPings
        m pings.
    measurement : Measurement
        Of the same pings.
    lever_arm_b : ndarray, shape (3,)
        IMU to DVL, m.

    Returns
    -------
    ndarray, shape (m, 3, 12)
        Zero where there is no measurement.
    """
    H = np.zeros((len(measurement.available), 3, TWELVE))
    _write_jacobians(stacked((measurement,)), np.flatnonzero(measurement.available), pings, vector(lever_arm_b), H)
    return H


@dataclass(frozen=True)
class Observability:
    """What a stack of measurements tells about the errors at the start.

    Attributes
    ----------
    singular_values : ndarray, shape (12,)
        Falling; signal to noise of each direction.
    directions : ndarray, shape (12, 12)
        Row i is the direction of singular value i, in prior standard deviations, of unit length; its largest
        component is positive.
    tolerance : float
        A singular value up to this share of the largest is called zero.
    """

    singular_values: Floats
    directions: Floats
    tolerance: float

    @property
    def rank(self) -> int:
        """Number of observable directions."""
        return int(np.sum(self.singular_values > self.tolerance * self.singular_values[0]))

    @property
    def gap(self) -> float:
        """Ratio of the last singular value that counts to the first that does not; NaN with full rank."""
        if not 0 < self.rank < len(self.singular_values):
            return float("nan")
        above, below = self.singular_values[self.rank - 1 : self.rank + 1]
        return float(above / below) if below > 0.0 else float("inf")

    @property
    def unobservable(self) -> Floats:
        """Orthonormal basis of what is not observable, in prior standard deviations, shape (12 - rank, 12)."""
        return self.directions[self.rank :]

    def response(self, direction: Floats) -> float:
        """Return the signal to noise with which the measurements see an error in a direction.

        Parameters
        ----------
        direction : ndarray, shape (12,)
            In prior standard deviations, of unit length.

        Returns
        -------
        float
            Between the smallest and the largest singular value.
        """
        return float(np.linalg.norm(self.singular_values * (self.directions @ direction)))

    def left(self) -> Floats:
        """Return the share of each state's prior standard deviation at the start that is left without process noise.

        Returns
        -------
        ndarray, shape (12,)
        """
        var = 1.0 / (1.0 + self.singular_values**2)
        share: Floats = np.sqrt(var @ self.directions**2)
        return share


def analyse(rows: Floats, prior_sd: Floats, tolerance: float = TOLERANCE) -> Observability:
    """Decompose a stack of measurement rows.

    Parameters
    ----------
    rows : ndarray, shape (k, 12)
        From `whitened_rows`, of one measurement or several.
    prior_sd : ndarray, shape (12,)
        Standard deviations of the states at the start, SI units.
    tolerance : float
        A singular value up to this share of the largest is called zero.
    """
    # R has the singular values of the stack, and is as small as one ping whatever the length of the dive.
    triangle = np.asarray(np.linalg.qr(rows * prior_sd, mode="r"))
    R = np.zeros((TWELVE, TWELVE))
    R[: len(triangle)] = triangle
    _, singular_values, directions = np.linalg.svd(R)
    largest = np.take_along_axis(directions, np.abs(directions).argmax(axis=1)[:, None], axis=1)
    return Observability(singular_values, directions * np.sign(largest), tolerance)


@compiled
def _write_jacobians(
    measurement: Stack, rows: NDArray[np.int64], pings: NominalPings, lever_arm_b: Vector, H: Floats
) -> None:
    """Write the Jacobian of each ping. What only the innovation needs is left at zero."""
    unused, unused_b, z = (0.0, 0.0, 0.0), np.zeros(pings.velocity_n.shape), np.empty(3)
    nowhere, nothing = place_at(0.0, 0.0), np.empty(0)
    for ping in rows:
        ins = InsAtPing(
            unused,
            row_vector(pings.velocity_n, ping),
            row_matrix(pings.mat_nb, ping),
            unused,
            ping,
            pings.rate_nb_b,
            unused_b,
            unused_b,
            pings.gravity[ping],
            lever_arm_b,
            nowhere,
            unused,
            nothing,
        )
        linearise(measurement, 0, ping, ins, TWELVE_ALONE, None, z, H[ping])


def remaining_cov(
    pings: NominalPings, measurements: Sequence[Measurement], lever_arm_b: Floats, prior_sd: Floats
) -> Floats:
    """Carry the covariance over all pings: ``P <- Phi P Phi' + Q`` from one to the next, then its updates.

    Observability asks what measurements tell of the errors at the start, which do not change any more. On the way
    errors grow into each other and process noise adds to them, so that more may be left at the end than there was at
    the start.

    Parameters
    ----------
    pings : NominalPings
        m pings.
    measurements : sequence of Measurement
        Of the same pings; applied in this order.
    lever_arm_b : ndarray, shape (3,)
        IMU to DVL, m.
    prior_sd : ndarray, shape (12,)
        Standard deviations of the states at the start, SI units.

    Returns
    -------
    ndarray, shape (12, 12)
        P after the last ping.
    """
    P = np.diag(np.square(prior_sd))
    H = np.stack([jacobians(pings, measurement, lever_arm_b) for measurement in measurements])
    cov_b = np.stack([measurement.cov for measurement in measurements])
    available = np.stack([measurement.available for measurement in measurements])
    _walk(pings.step, pings.noise, H, cov_b, available, P)
    return P


@compiled
def _walk(steps: Floats, noises: Floats, H: Floats, cov_b: Floats, available: NDArray[np.bool_], P: Floats) -> None:
    """Take P from ping to ping, in place."""
    (HP, KT, rest), grown = np.empty((3, 3, TWELVE)), np.empty((TWELVE, TWELVE))
    S, L = np.empty((2, 3, 3))
    for ping in range(len(steps)):
        _advance(P, steps[ping], noises[ping], grown)
        for m in range(len(H)):
            if available[m, ping]:
                innovation_cov(P, H[m, ping], cov_b[m, ping], HP, S)
                cholesky(S, L)
                transposed_gain(HP, L, KT)
                update_cov(P, H[m, ping], cov_b[m, ping], HP, KT, rest)


@inlined
def _advance(P: Floats, step: Floats, noise: Floats, grown: Floats) -> None:
    """Write ``Phi P Phi' + Q`` to P, symmetric to the last bit."""
    multiply(step, P, grown)
    for i in range(TWELVE):
        for j in range(i + 1):
            total = noise[i, j]
            for k in range(TWELVE):
                total += grown[i, k] * step[j, k]
            P[i, j] = P[j, i] = total
