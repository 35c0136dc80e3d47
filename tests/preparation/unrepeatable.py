"""Filters of a user's whose answers do not repeat, as `test_repeats` names them.

Each of their runs is a process, which imports this module and with it only what they need.
"""

import time
from dataclasses import replace

import numpy as np

from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.nav.user_candidate import Candidate, CandidateStart, Solution

LATER_NS = 1_000  # by which a repeat moves all stamps; its own module is heavy
CHAOS_M = 50.0
JITTER_M = 1e-4


def moved_north(solution: Solution, north_m: float) -> Solution:
    """Move a track more and more, up to a distance at its end."""
    assert solution.position is not None
    away_m = np.zeros((len(solution.time_ns), 3))
    away_m[:, 0] = np.linspace(0.0, north_m, len(away_m))
    return replace(solution, position=moved_position(solution.position, away_m))


class Level(Candidate):
    """Dead reckoning of a vehicle that stays level: the gyro about down, and the velocity of the DVL."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Return the trajectory from the start to the end of the dive."""
        inside = dive.imu.time_ns >= start.time_ns
        time_ns = dive.imu.time_ns[inside]
        time_s = (time_ns - start.time_ns) * 1e-9
        step_s = np.diff(time_s, prepend=0.0)
        rate = dive.imu.angular_rate_b[inside, 2] - start.gyro_bias_b[2]
        rpy = np.tile(rpy_from_mat(start.mat_nb), (len(time_s), 1))
        rpy[:, 2] += np.cumsum(rate * step_s)
        mat_nb = mat_from_rpy(rpy)
        ping_s = (dive.dvl.time_ns - start.time_ns) * 1e-9
        axes = [np.interp(time_s, ping_s, axis) for axis in dive.dvl.velocity_d.T]
        velocity_n = np.einsum("kij,jk->ki", mat_nb, np.array(axes))
        away_m = np.cumsum(velocity_n * step_s[:, None], axis=0)
        position = moved_position(np.broadcast_to(start.position, away_m.shape), away_m)
        return Solution(time_ns, position, velocity_n, mat_nb)


class Random(Level):
    """A filter with random numbers that nobody seeded."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Go astray by some metres."""
        return moved_north(super().run(dive, start), np.random.default_rng().uniform(-10.0, 10.0))


class Jittering(Level):
    """A filter whose sums depend on the order of its threads, so to speak."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Go astray by far less than any error."""
        return moved_north(
            super().run(dive, start), np.random.default_rng().uniform(0.0, JITTER_M)
        )


class Hashing(Level):
    """A filter that depends on the order of a set, which is another in each process and the same within one."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Go astray by the hash of a word."""
        return moved_north(super().run(dive, start), hash("heading") % 1000 / 50.0)


class Chaotic(Level):
    """A filter that goes another way where stamps are not whole microseconds times two."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Go astray by the stamps."""
        return moved_north(super().run(dive, start), CHAOS_M * (start.time_ns // LATER_NS % 2))


class Counting(Level):
    """A filter that counts samples where it should look at their stamps."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Go astray by the number of samples."""
        return moved_north(super().run(dive, start), CHAOS_M * (len(dive.imu.time_ns) % 2))


class Refusing(Level):
    """A filter that cannot take two samples with the same readings."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Fail if there are any."""
        if np.any(np.all(np.diff(dive.imu.specific_force_b, axis=0) == 0.0, axis=1)):
            raise ValueError("the IMU is frozen")
        return super().run(dive, start)


class Turning(Level):
    """A filter whose velocities are random."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Change the velocity by some cm/s."""
        solution = super().run(dive, start)
        assert solution.velocity_n is not None
        return replace(
            solution,
            velocity_n=solution.velocity_n + np.random.default_rng().uniform(-0.1, 0.1, 3),
        )


class Burning(Level):
    """A filter that works for long."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Work, then answer."""
        until_s = time.process_time() + 0.3
        while time.process_time() < until_s:
            pass
        return super().run(dive, start)
