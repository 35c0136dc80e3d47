"""A Kalman filter that turns the DVL's velocity into n as if its attitude had no error, as a class.

J. Huang, Z. Liu, H. Li, Z. Wang and Y. Chen, "A DVL-Aided Loosely Coupled Inertial Navigation Strategy for AUVs with
Attitude Error Modeling and Variance Propagation", 2026 (arXiv:2601.19509), call this conventional, and add the error of
the attitude to the measurement. The baseline of this tool has it; here it is left out:

    z = C' v + w x l - y,   H = [C' | 0 | 0 | -[l x]]   in place of [C' | C' [v x] | 0 | -[l x]]
"""

from kalman_filter import PHI, KalmanFilter


class WithoutAttitude(KalmanFilter):
    """The usual filter without the attitude in H."""

    def innovation(self, ins, measured_b, turn_b, arm_b):
        """Return z, predicted minus measured velocity in b, and H."""
        z, H = super().innovation(ins, measured_b, turn_b, arm_b)
        H[:, PHI] = 0.0
        return z, H
