"""Dead reckoning as a candidate: the gyros turn the attitude, the DVL gives the velocity. A class, and a program."""

import numpy as np

from insdvl_replay import Candidate, Solution, run_as_program

EARTH_RATE, SEMI_MAJOR_M, ECCENTRICITY_SQUARED = 7.292115e-5, 6378137.0, 6.69437999e-3


class DeadReckoning(Candidate):
    """It estimates no biases, and has no covariance."""

    def run(self, dive, start):
        """Return the trajectory from the start to the end of the dive."""
        inside = dive.imu.time_ns >= start.time_ns
        time_ns, rate_b = (
            dive.imu.time_ns[inside],
            dive.imu.angular_rate_b[inside] - start.gyro_bias_b,
        )
        time_s = (time_ns - start.time_ns) * 1e-9
        sine, cosine = np.sin(start.position[0]), np.cos(start.position[0])
        earth_rate_n = EARTH_RATE * np.array([cosine, 0.0, -sine])

        # Attitude: each step turns by the mean rate, less the Earth's.
        mat_nb = np.repeat(start.mat_nb[None], len(time_ns), axis=0)
        for i, step_s in enumerate(np.diff(time_s)):
            turn = (0.5 * (rate_b[i] + rate_b[i + 1]) - mat_nb[i].T @ earth_rate_n) * step_s
            x, y, z = turn
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            mat_nb[i + 1] = mat_nb[i] @ (np.eye(3) + cross + 0.5 * cross @ cross)

        # Velocity of the IMU: that of the DVL, less what the turn of the lever arm adds.
        ping_s = (dive.dvl.time_ns - start.time_ns) * 1e-9
        dvl_b = np.column_stack(
            [np.interp(time_s, ping_s, axis) for axis in dive.dvl.velocity_d.T]
        )
        rate_eb_b = rate_b - np.einsum("kji,j->ki", mat_nb, earth_rate_n)
        velocity_n = np.einsum(
            "kij,kj->ki", mat_nb, dvl_b - np.cross(rate_eb_b, start.dvl_lever_arm_b)
        )

        # Position: the integral of the velocity, on the ellipsoid.
        steps_m = 0.5 * (velocity_n[1:] + velocity_n[:-1]) * np.diff(time_s)[:, None]
        moved_m = np.vstack([np.zeros(3), np.cumsum(steps_m, axis=0)])
        root = np.sqrt(1.0 - ECCENTRICITY_SQUARED * sine**2)
        north_m, east_m = (
            SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQUARED) / root**3,
            SEMI_MAJOR_M / root * cosine,
        )
        return Solution(
            time_ns, start.position + moved_m / [north_m, east_m, -1.0], velocity_n, mat_nb
        )


if __name__ == "__main__":
    run_as_program(DeadReckoning)
