"""Filters of a user's that fail, or harm what they can, as `test_user_candidates` names them.

Each of their runs is a process, which imports this module and with it only what they need.
"""

import contextlib
import os
import sys
import time

import numpy as np

from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.nav.user_candidate import Candidate, CandidateStart, Solution


class Depths(Candidate):
    """A class that names the sensors it is given."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Fail, with their names."""
        raise ValueError(f"given {sorted(dive.sensors)}")


class Failing(Candidate):
    """A class with a mistake."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Fail."""
        sys.stdout.write("before\n")
        raise ZeroDivisionError("here")


class Leaving(Candidate):
    """A class that prints past Python, and ends its process."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """End."""
        os.write(1, b"to the descriptor\n")
        os._exit(7)


class Sleeping(Candidate):
    """A class that does not end."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Wait."""
        time.sleep(77.0)
        raise AssertionError


class Daemon(Candidate):
    """A class that leaves a process behind, which keeps its pipes open and is in no group of the tool."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Leave it, and end."""
        if os.fork() == 0:
            os.setsid()
            time.sleep(20.0)
        os._exit(7)


class Writing(Candidate):
    """A class that writes wherever it can."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Write, and return nothing that is read."""
        for descriptor in range(3, 30):
            with contextlib.suppress(OSError):
                os.write(descriptor, b"anything, which is longer than a header")
        raise AssertionError


class Unfinished(Candidate):
    """A class without a result."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Return nothing."""
        return None  # type: ignore[return-value]


class Scaling(Candidate):
    """A class that changes what it is given."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Fail, with what it was given."""
        given = float(np.sum(np.abs(dive.imu.angular_rate_b)))
        dive.imu.angular_rate_b[:] *= 2.0
        raise ValueError(f"given {given:.6g}")
