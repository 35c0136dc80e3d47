"""A Kalman filter for which the noise of the DVL is correlated with that of the IMU, as a class.

N. Cohen and I. Klein, "Enhancing Underwater Navigation through Cross-Correlation-Aware Deep INS/DVL Fusion", 2025
(arXiv:2503.21727), use it for a network that makes a velocity of the readings of both sensors:

    M = rho sqrt(diag Q) sqrt(diag R)'                      covariance of the noises, (12, 3)
    K = (P H' + M) S^-1,   S = H P H' + H M + M' H' + R,   P - K (H P + M') after the update

Q is the process noise and R that of the DVL. They find rho = 0.42 by trial. No noise can have such an M: it correlates
each of 12 independent components with each of 3, which takes rho of 1 / sqrt(36) at most. Here Q is that of the whole
time since the last ping. The paper does not say over which step it is; over one of 10 ms, M is ten times smaller.
"""

import numpy as np
from kalman_filter import KalmanFilter


class CorrelatedNoise(KalmanFilter):
    """The usual filter with the gain and the rho of the paper."""

    rho = 0.42

    def gain(self, P, H, R, since_ping):
        """Return K, the covariance S of the innovation, and P after the update."""
        M = covariance_of_noises(self.rho, since_ping, R)
        S = H @ P @ H.T + H @ M + M.T @ H.T + R
        K = np.linalg.solve(S, (P @ H.T + M).T).T
        return K, S, P - K @ (H @ P + M.T)


class WeaklyCorrelatedNoise(CorrelatedNoise):
    """The same with the largest rho that noise can have."""

    rho = 1.0 / 6.0


def covariance_of_noises(rho, Q, R):
    """Return M, shape (12, 3)."""
    return rho * np.outer(np.sqrt(np.diag(Q)), np.sqrt(np.diag(R)))
