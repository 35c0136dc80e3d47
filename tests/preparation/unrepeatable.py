"""Filters of a user's whose answers do not repeat, as `test_repeats` names them.

Each of their runs is a process, which imports this module and with it only what they need.
"""

import time
from dataclasses import replace

import numpy as np
from baseline_as_candidate import Baseline

from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.nav.user_candidate import Candidate, CandidateStart, Solution
from insdvl_replay.preparation.user_runs import LATER_NS

CHAOS_M = 50.0
JITTER_M = 1e-4


def moved_north(solution: Solution, north_m: float) -> Solution:
    """Move a track more and more, up to a distance at its end."""
    assert solution.position is not None
    away_m = np.zeros((len(solution.time_ns), 3))
    away_m[:, 0] = np.linspace(0.0, north_m, len(away_m))
    return replace(solution, position=moved_position(solution.position, away_m))


class Random(Baseline):
    """A filter with random numbers that nobody seeded."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Go astray by some metres."""
        return moved_north(super().run(dive, start), np.random.default_rng().uniform(-10.0, 10.0))


class Jittering(Baseline):
    """A filter whose sums depend on the order of its threads, so to speak."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Go astray by far less than any error."""
        return moved_north(
            super().run(dive, start), np.random.default_rng().uniform(0.0, JITTER_M)
        )


class Hashing(Baseline):
    """A filter that depends on the order of a set, which is another in each process and the same within one."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Go astray by the hash of a word."""
        return moved_north(super().run(dive, start), hash("heading") % 1000 / 50.0)


class Chaotic(Baseline):
    """A filter that goes another way where stamps are not whole microseconds times two."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Go astray by the stamps."""
        return moved_north(super().run(dive, start), CHAOS_M * (start.time_ns // LATER_NS % 2))


class Counting(Baseline):
    """A filter that counts samples where it should look at their stamps."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Go astray by the number of samples."""
        return moved_north(super().run(dive, start), CHAOS_M * (len(dive.imu.time_ns) % 2))


class Refusing(Baseline):
    """A filter that cannot take two samples with the same readings."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Fail if there are any."""
        if np.any(np.all(np.diff(dive.imu.specific_force_b, axis=0) == 0.0, axis=1)):
            raise ValueError("the IMU is frozen")
        return super().run(dive, start)


class Turning(Baseline):
    """A filter whose velocities are random."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Change the velocity by some cm/s."""
        solution = super().run(dive, start)
        assert solution.velocity_n is not None
        return replace(
            solution,
            velocity_n=solution.velocity_n + np.random.default_rng().uniform(-0.1, 0.1, 3),
        )


class Burning(Candidate):
    """A filter that works for long."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Work, then give the baseline's answer."""
        until_s = time.process_time() + 0.3
        while time.process_time() < until_s:
            pass
        return Baseline().run(dive, start)
