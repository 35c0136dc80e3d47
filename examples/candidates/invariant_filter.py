"""An invariant extended Kalman filter of INS and DVL, as a class.

E. R. Potokar, K. Norman and J. G. Mangelson, "Invariant Extended Kalman Filtering for Underwater Navigation", IEEE
Robotics and Automation Letters, 2021 (doi 10.1109/LRA.2021.3085167), compare such a filter with the usual one. The
equations below are derived anew, for a frame n that turns with the Earth.

Attitude and velocity are one element of a group, and its error is the estimate times the inverse of the truth. To
first order this is the usual misalignment ``phi`` and, instead of ``dv``,

    xi   = dv + v x phi                                                             n, m/s
    xi'  = [g x] phi - [2 w_ie + w_en] x xi + v x (w_ie x phi) + C ba + v x (C bg)  g: gravity in n, m/s2
    z    = C' v + w x l - y,   H = [C' | 0 | 0 | -[l x]]

So neither a specific force nor, in C z, the estimate itself is in F and H, but for biases and the Earth's rate.
A correction multiplies the estimate by the exponential of the error.
"""

import numpy as np
from kalman_filter import BA, BG, PHI, KalmanFilter, V, rotation, skew


class InvariantFilter(KalmanFilter):
    """The usual filter with another error."""

    def error_rate(self, ins, force_n, gravity_n, rates_n):
        """Return F: the error changes by ``F e`` a second."""
        earth_n, frame_n, coriolis_n = rates_n
        across = skew(ins.velocity_n)
        F = np.zeros((12, 12))
        F[V, V] = -skew(coriolis_n)
        F[V, PHI] = skew(gravity_n) + across @ skew(earth_n)
        F[V, BA] = ins.mat_nb
        F[V, BG] = across @ ins.mat_nb
        F[PHI, PHI] = -skew(frame_n)
        F[PHI, BG] = ins.mat_nb
        return F

    def noise_input(self, ins):
        """Return G: how the noise of accelerometers, gyros and biases comes into the error."""
        G = super().noise_input(ins)
        G[V, PHI] = skew(ins.velocity_n) @ ins.mat_nb
        return G

    def innovation(self, ins, measured_b, turn_b, arm_b):
        """Return z, predicted minus measured velocity in b, and H."""
        z, H = super().innovation(ins, measured_b, turn_b, arm_b)
        H[:, PHI] = 0.0
        return z, H

    def correct(self, ins, error):
        """Multiply the estimate by the exponential of the error, turned round."""
        back = rotation(-error[PHI])
        ins.velocity_n = back @ ins.velocity_n - left_jacobian(-error[PHI]) @ error[V]
        ins.mat_nb = back @ ins.mat_nb
        ins.accel_bias_b = ins.accel_bias_b + error[BA]
        ins.gyro_bias_b = ins.gyro_bias_b + error[BG]

    def from_usual(self, velocity_n):
        """Return the matrix that makes the error of this filter of the usual one."""
        change = np.eye(12)
        change[V, PHI] = skew(velocity_n)
        return change


def left_jacobian(vector):
    """Return the mean of the rotations from none to that about a vector."""
    angle = np.sqrt(vector @ vector)
    cross = skew(vector)
    if angle < 1e-6:
        return np.eye(3) + 0.5 * cross
    first = (1.0 - np.cos(angle)) / angle**2
    second = (angle - np.sin(angle)) / angle**3
    return np.eye(3) + first * cross + second * cross @ cross
