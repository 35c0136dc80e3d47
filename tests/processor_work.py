"""What `test_processors.py` has done on another processor, in a process of its own.

Usage: python processor_work.py FEATURES, with command lines on stdin, one a line; prints the digest of a motion.

FEATURES are those of numpy that must be switched off, so that an emulation that does not work is noticed.
"""

import hashlib
import shlex
import sys

import numpy as np
from numpy._core._multiarray_umath import __cpu_features__

from insdvl_replay.cli import run_command_line
from insdvl_replay.sim.trajectories import SCENARIOS, Trajectory


def motion_digest() -> str:
    """Digest of every bit of an exact motion, before anything is rounded."""
    motion = Trajectory(SCENARIOS["figure-eight"], 394.0).at(np.arange(0.0, 394.0, 0.01))
    digest = hashlib.sha256()
    for array in vars(motion).values():
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


if __name__ == "__main__":
    assert not any(__cpu_features__[name] for name in sys.argv[1].split()), (
        "numpy uses what it should not"
    )
    sys.stdout.write(motion_digest())
    for line in sys.stdin:
        assert run_command_line(shlex.split(line)) == 0, line
