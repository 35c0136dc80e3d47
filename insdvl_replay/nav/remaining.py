"""What measurements leave of the errors at the end of a span: the filter's covariance along a nominal motion.

Observability asks what measurements tell of the errors at the start, which do not change any more. On the way errors
grow into each other and process noise adds to them, so that more may be left at the end than there was at the start.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.columns import Floats
from insdvl_replay.core.compiled import compiled, inlined
from insdvl_replay.nav.kalman import cholesky, innovation_cov, multiply, transposed_gain, update_cov
from insdvl_replay.nav.measurements import Measurement
from insdvl_replay.nav.nominal_motion import NominalPings
from insdvl_replay.nav.observability import jacobians
from insdvl_replay.nav.vector_algebra import row_matrix


def remaining_cov(
    pings: NominalPings, measurements: Sequence[Measurement], lever_arm_b: Floats, prior_sd: Floats
) -> Floats:
    """Carry the covariance over all pings: ``P <- Phi P Phi' + Q`` from one to the next, then its updates.

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
    cov_b = np.stack([measurement.cov_b for measurement in measurements])
    available = np.stack([measurement.available for measurement in measurements])
    _walk(pings.step, pings.noise, H, cov_b, available, P)
    return P


@compiled
def _walk(steps: Floats, noises: Floats, H: Floats, cov_b: Floats, available: NDArray[np.bool_], P: Floats) -> None:
    """Take P from ping to ping, in place."""
    HP, KT, rest, grown = np.empty((3, 12)), np.empty((3, 12)), np.empty((3, 12)), np.empty((12, 12))
    for ping in range(len(steps)):
        _advance(P, steps[ping], noises[ping], grown)
        for m in range(len(H)):
            if available[m, ping]:
                R = row_matrix(cov_b[m], ping)
                L = cholesky(innovation_cov(P, H[m, ping], R, HP))
                transposed_gain(HP, L, KT)
                update_cov(P, H[m, ping], R, HP, KT, rest)


@inlined
def _advance(P: Floats, step: Floats, noise: Floats, grown: Floats) -> None:
    """Write ``Phi P Phi' + Q`` to P, symmetric to the last bit."""
    multiply(step, P, grown)
    for i in range(12):
        for j in range(i + 1):
            total = noise[i, j]
            for k in range(12):
                total += grown[i, k] * step[j, k]
            P[i, j] = P[j, i] = total
