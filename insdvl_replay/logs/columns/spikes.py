"""Single samples of an IMU that jump away and back, as a flipped bit or a lost byte makes them.

One sample of 300 m/s^2 at 100 Hz is a velocity of 3 m/s that never was. A vehicle that is hit swings for several
samples; a jump that is gone with the next one is the instrument's.
"""

from typing import Final

import numpy as np

from insdvl_replay.core.columns import Floats, TimeNs, nanoseconds
from insdvl_replay.logs.columns.cleaning import Cleaner, is_few
from insdvl_replay.logs.columns.order import Mask

FORCE_JUMP_MPS2: Final = 20.0
"""2 g from one sample to the next, and back with the one after."""
RATE_JUMP_RADPS: Final = 3.5
"""200 deg/s, likewise."""
NEAR_S: Final = 0.03
"""Further apart, two samples do not tell a spike from a jolt."""
UNREST: Final = 20.0
"""And this many times the usual step: where readings jump all the time, or are in another unit, none stands out."""
_REASON: Final = "samples jump by over 20 m/s^2 or 200 deg/s, 20 times the usual step, and back with the next"
BACK: Final = 0.25
"""Share of these by which the samples on the two sides of a spike may differ."""
SLANT: Final = 0.05
"""Share of a larger jump by which they may."""


def drop_spikes(cleaner: Cleaner, specific_force_b: Floats, angular_rate_b: Floats) -> None:
    """Drop samples that jump beyond what a vehicle can do and back; the pause that is left is bridged like any other.

    Parameters
    ----------
    cleaner : Cleaner
        Its rows have times of their own.
    specific_force_b, angular_rate_b : ndarray, shape (k, 3)
        For each row of the file, m/s^2 and rad/s.
    """
    spikes = np.zeros(len(cleaner.rows), np.bool_)
    for readings, jump in ((specific_force_b, FORCE_JUMP_MPS2), (angular_rate_b, RATE_JUMP_RADPS)):
        kept = cleaner.kept(readings)
        # Readings that are never so far apart have no such jump, and need no second look.
        if kept.max() - kept.min() > jump:
            spikes |= find_spikes(cleaner.times, kept, jump)
    count = int(np.count_nonzero(spikes))
    if count and is_few(count, len(spikes)):
        good = np.ones(len(specific_force_b), np.bool_)
        good[cleaner.rows[spikes]] = False
        cleaner.keep(good, "spikes", _REASON, "warning", "the instrument or its cable; the pauses are bridged")


def find_spikes(time_ns: TimeNs, readings: Floats, jump: float) -> Mask:
    """Find single samples that are far from both of their neighbours, which are near each other.

    Parameters
    ----------
    time_ns : ndarray, shape (k,)
        Increasing.
    readings : ndarray, shape (k, 3)
    jump : float
        In the unit of the readings.

    Returns
    -------
    ndarray of bool, shape (k,)
    """
    spikes = np.zeros(len(readings), np.bool_)
    if len(readings) < 3:
        return spikes
    step = np.diff(readings, axis=0)
    there, back = step[:-1], step[1:]
    far = np.maximum(jump, UNREST * np.median(np.abs(step), axis=0))
    smaller = np.minimum(np.abs(there), np.abs(back))
    alone = (smaller > far) & (there * back < 0.0) & (np.abs(there + back) < np.maximum(BACK * far, SLANT * smaller))
    near = np.diff(time_ns) <= nanoseconds(NEAR_S)
    spikes[1:-1] = alone.any(axis=1) & near[:-1] & near[1:]
    # Of an end the samples next to it say where it should be.
    for end, first, second in ((0, 0, 1), (-1, -1, -2)):
        away = (np.abs(step[first]) > far) & (np.abs(step[second]) < BACK * far)
        spikes[end] = away.any() and near[first] and near[second]
    return spikes
