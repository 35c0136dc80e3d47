"""The last velocities of the DVL as a user-defined measurement where it has none: the simplest forecast.

Z. Yampolsky, N. Cohen and I. Klein, "Transformer-Based Robust Underwater Inertial Navigation in Prolonged Doppler
Velocity Log Outages", 2025 (arXiv:2504.07697), forecast the velocity in an outage by a network. This class forecasts
the mean of the last three velocities. Its noise is what such forecasts were off by earlier in the dive. ``DVL_ARM_M``
is the lever arm of the vehicle.
"""

import os

import numpy as np

from insdvl_replay import UserMeasurement, UserReadings

ARM_X, ARM_Y, ARM_Z = map(float, os.environ.get("DVL_ARM_M", "0,0,0").split(","))  # IMU to DVL
PINGS = 3  # in the mean
STEP_S = 1.0  # between forecasts
LEAST_SD_MPS = 0.01
FEWEST = 10  # earlier forecasts, below which there is none
NO_WEIGHT_MPS = 1000.0


class HeldVelocity(UserMeasurement):
    """The mean of the last velocities, each second from the last ping to the next."""

    name, unit = "held_velocity", "m/s"

    def readings(self, dive):
        """Return forecasts where pings are missing; it looks at no later ping."""
        velocity = velocity_of(dive.dvl)
        usable = np.isfinite(velocity).all(axis=1)
        ping_ns = dive.dvl.time_ns[usable]
        velocity = velocity[usable]
        usual_s = np.median(np.diff(ping_ns)) * 1e-9
        ends_ns = np.append(ping_ns[1:], dive.imu.time_ns[-1])
        pauses = np.flatnonzero((ends_ns - ping_ns) * 1e-9 > 2.0 * max(usual_s, STEP_S))
        # A measurement needs a reading: where no ping is missing, it is one without weight.
        times = [ping_ns[FEWEST]]
        values = [velocity[FEWEST]]
        sds = [np.full(3, NO_WEIGHT_MPS)]
        for last in pauses[pauses >= PINGS + FEWEST]:
            known = velocity[: last + 1]
            pause_s = (ends_ns[last] - ping_ns[last]) * 1e-9
            for ahead_s in np.arange(STEP_S, pause_s - 0.5 * STEP_S, STEP_S):
                sd = usual_error(known, round(ahead_s / usual_s))
                if sd is not None:
                    times.append(ping_ns[last] + int(ahead_s * 1e9))
                    values.append(known[-PINGS:].mean(axis=0))
                    sds.append(np.maximum(sd, LEAST_SD_MPS))
        return UserReadings(np.array(times, dtype=np.int64), np.array(values), np.array(sds))

    @staticmethod
    def predict(ins, z, H):
        """Write C' v + w x l and its Jacobian, [C' | C' [v x] | 0 | -[l x]]."""
        for i in range(3):
            north, east, down = ins[6 + i], ins[9 + i], ins[12 + i]
            z[i] = north * ins[3] + east * ins[4] + down * ins[5]
            H[i, 0], H[i, 1], H[i, 2] = north, east, down
            H[i, 3] = east * ins[5] - down * ins[4]
            H[i, 4] = down * ins[3] - north * ins[5]
            H[i, 5] = north * ins[4] - east * ins[3]
        z[0] += ins[19] * ARM_Z - ins[20] * ARM_Y
        z[1] += ins[20] * ARM_X - ins[18] * ARM_Z
        z[2] += ins[18] * ARM_Y - ins[19] * ARM_X
        H[0, 10], H[0, 11] = ARM_Z, -ARM_Y
        H[1, 9], H[1, 11] = -ARM_Z, ARM_X
        H[2, 9], H[2, 10] = ARM_Y, -ARM_X


def velocity_of(dvl):
    """Return the velocity of each ping, shape (k, 3), by least squares where the DVL has beams."""
    if dvl.velocity_d is not None:
        return dvl.velocity_d
    return dvl.beam_velocity_mps @ np.linalg.pinv(dvl.beam_vectors_d).T


def usual_error(velocity, pings_ahead):
    """Return the rms error of such forecasts of known velocities, shape (3,); None for too few of them."""
    sums = np.cumsum(np.vstack([np.zeros(3), velocity]), axis=0)
    means = (
        sums[PINGS:] - sums[:-PINGS]
    ) / PINGS  # of the ping in row i + PINGS - 1 and those before
    later = velocity[PINGS - 1 + pings_ahead :]
    if len(later) < FEWEST:
        return None
    return np.sqrt(np.mean((means[: len(later)] - later) ** 2, axis=0))
