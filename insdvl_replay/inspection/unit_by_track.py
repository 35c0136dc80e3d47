"""In which unit a DVL measures, by how far a reference moves at the same time.

A mounting that is tilted far enough explains a wrong unit as well, so that the unit is found before any mounting.
"""

from typing import Final

import numpy as np

from insdvl_replay.checks.dvl import LEAST_MOVED_M, pairs_of_fixes
from insdvl_replay.checks.imu import ENOUGH, lies_within
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    DvlColumns,
    Floats,
    Integers,
    Mask,
    ReferenceColumns,
    TimeNs,
    seconds,
)
from insdvl_replay.core.units import VELOCITY_UNITS
from insdvl_replay.geometry.frames import Complex, horizontal, north_east_down_m

# Units in which the speeds of a vehicle could be m/s, so that their size alone does not tell them.
TRACK_UNITS: Final = ("kn", "ft/s", "km/h")
_NEAR: Final = 0.04  # share by which a ratio may be off; ft/s and km/h are 9 % apart
# Share of the ratio within which half of the legs agree; a current spreads them further.
_SPREAD: Final = 0.2
_HALF_A_LEG_NS: Final = 5 * NS_PER_S
_STRAIGHT: Final = 0.97  # least length of a leg over that of its halves
_LEVEL: Final = 0.3  # largest change of height over the length of a leg
_ONE_WAY: Final = 0.9  # length of the mean direction from which all legs go one way


def unit_by_track(dvl: DvlColumns, reference: ReferenceColumns) -> str | None:
    """Return the unit in which velocities of a DVL, read as m/s, are as fast as the reference moves; None for m/s.

    None as well where the dive does not tell: without straight legs, or where all legs go one way,
    so that a current explains the ratio too.
    """
    ratios, legs_m = _legs(dvl, reference)
    if len(ratios) < ENOUGH or abs(np.mean(legs_m / np.abs(legs_m))) > _ONE_WAY:
        return None
    low, ratio, high = np.quantile(ratios, [0.25, 0.5, 0.75])
    if high - low > _SPREAD * ratio:
        return None
    for unit in TRACK_UNITS:
        if abs(ratio * VELOCITY_UNITS[unit] - 1.0) < _NEAR:
            return unit
    return None


def _legs(dvl: DvlColumns, reference: ReferenceColumns) -> tuple[Floats, Complex]:
    """Return for straight legs how far the DVL moves over how far the reference does, and the legs themselves, m."""
    nothing = np.empty(0), np.empty(0, complex)
    if dvl.velocity_d is None:
        return nothing
    complete = np.isfinite(dvl.velocity_d).all(axis=1)
    ping_ns = dvl.time_ns[complete]
    if len(ping_ns) < ENOUGH:
        return nothing
    time_ns, place_m = _track(reference)
    within = lies_within(time_ns, ping_ns)
    if np.count_nonzero(within) < ENOUGH:
        return nothing
    time_ns = time_ns[within]
    first, middle, last = _rows_of_legs(time_ns, ping_ns)
    moved_m, straight = _straight_legs(place_m[within], first, middle, last)
    by_dvl_m = _summed_m(ping_ns, dvl.velocity_d[complete], time_ns)
    dvl_m = np.linalg.norm(by_dvl_m[last] - by_dvl_m[first], axis=1)[straight]
    return dvl_m / np.abs(moved_m), moved_m


def _track(reference: ReferenceColumns) -> tuple[TimeNs, Floats]:
    """Return north, east, down by the positions, else by the velocities, m, shape (k, 3); NaN for unknown heights."""
    placed = reference.known["positions"]
    if placed.any():
        position = reference.position[placed]
        return reference.time_ns[placed], north_east_down_m(position, position[0])
    moving = reference.known["velocities"]
    time_ns = reference.time_ns[moving]
    if not len(time_ns):
        return time_ns, np.empty((0, 3))
    return time_ns, _summed_m(time_ns, reference.velocity_n[moving], time_ns)


def _rows_of_legs(time_ns: TimeNs, ping_ns: TimeNs) -> tuple[Integers, Integers, Integers]:
    """Return the first, middle and last row of each leg in which the DVL does not pause."""
    first, last = pairs_of_fixes(time_ns, ping_ns, ping_ns)
    middle = np.searchsorted(time_ns, time_ns[first] + _HALF_A_LEG_NS)
    return first, middle, last


def _straight_legs(
    track_m: Floats, first: Integers, middle: Integers, last: Integers
) -> tuple[Complex, Mask]:
    """Return the legs that are straight, level and long enough, m north plus i times east, and which these are."""
    place_m = horizontal(track_m)
    moved_m = place_m[last] - place_m[first]
    length_m = np.abs(moved_m)
    halves_m = np.abs(place_m[middle] - place_m[first]) + np.abs(place_m[last] - place_m[middle])
    climbed_m = np.nan_to_num(np.abs(track_m[last, 2] - track_m[first, 2]))
    straight = length_m >= np.maximum(_STRAIGHT * halves_m, LEAST_MOVED_M)
    straight &= climbed_m <= _LEVEL * length_m
    return moved_m[straight], straight


def _summed_m(time_ns: TimeNs, velocity_mps: Floats, at_ns: TimeNs) -> Floats:
    """Sum velocities, (k, 3), in the axes that they have, up to some times, m, shape (n, 3)."""
    time_s = seconds(time_ns, time_ns[0])
    steps_m = 0.5 * (velocity_mps[1:] + velocity_mps[:-1]) * np.diff(time_s)[:, np.newaxis]
    moved_m = np.vstack([np.zeros(3), np.cumsum(steps_m, axis=0)])
    at_s = seconds(at_ns, time_ns[0])
    columns = [np.interp(at_s, time_s, column) for column in moved_m.T]
    return np.stack(columns, axis=1)
