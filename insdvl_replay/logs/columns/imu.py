"""The samples of an IMU and the truth about it: SI units, the project's axes, clean rows, no single samples that jump.

One sample of 300 m/s^2 at 100 Hz is a velocity of 3 m/s that never was. A vehicle that is hit swings for several
samples; a jump that is gone with the next one is the instrument's.
"""

import re
from typing import Final

import numpy as np

from insdvl_replay.core.config import Imu
from insdvl_replay.core.dive_columns import NS_PER_S, Floats, ImuColumns, TimeNs, TruthColumns, nanoseconds
from insdvl_replay.core.errors import ConfigError, Note
from insdvl_replay.core.states import ANGULAR_RATE_UNITS, LARGEST_FORCE_MPS2, LARGEST_RATE_RADPS, SPECIFIC_FORCE_UNITS
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.columns.cleaning import Cleaner, is_few, note_bursts, note_lost_samples
from insdvl_replay.logs.columns.order import Mask
from insdvl_replay.logs.columns.tables import Table

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
    """Drop samples that jump beyond what a vehicle can do and back; the pause is bridged like any other."""
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
        cleaner.keep(good, "spikes", _REASON, Severity.WARNING, "the instrument or its cable; the pauses are bridged")


def find_spikes(time_ns: TimeNs, readings: Floats, jump: float) -> Mask:
    """Find single samples, shape (k, 3), that are far from both of their neighbours, while these are near."""
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


FRD: Final = "frd"
"""The project's axes, which are assumed where nothing tells them."""
_LOST_HINT: Final = "imu.specific_force and imu.angular_rate name other fields; imu.max_gap_s says what is bridged"
_NAMED_AXES: Final = {"frd": "+x+y+z", "flu": "+x-y-z"}


def in_frd(vectors: Floats, axes: str, key: str, unit: float = 1.0) -> Floats:
    """Bring vectors from the log's axes and unit to forward-starboard-down and SI.

    Parameters
    ----------
    vectors : ndarray, shape (k, 3)
    axes : str
        ``frd``, ``flu``, or a signed permutation whose i-th part is the reading along the i-th of the axes forward,
        starboard, down. An odd number of turned signs is allowed: some instruments report the opposite of a vector.
    key : str
        The configuration's key of the axes, for messages to the user.
    unit : float
        One unit of the log in SI.

    Returns
    -------
    ndarray, shape (k, 3)

    Raises
    ------
    ConfigError
        The axes are none.
    """
    text = _NAMED_AXES.get(axes, axes)
    readings = re.findall(r"([+-])([xyz])", text)
    if len(text) != 6 or sorted(axis for _, axis in readings) != ["x", "y", "z"]:
        raise ConfigError(f'{key} = "{axes}" is no set of axes', f'{key} = "frd", "flu" or for example "+y+x-z"')
    if "".join(map("".join, readings)) == _NAMED_AXES["frd"] and unit == 1.0:
        return vectors
    turned = np.empty_like(vectors)
    for i, (sign, axis) in enumerate(readings):
        np.multiply(vectors[:, "xyz".index(axis)], unit if sign == "+" else -unit, out=turned[:, i])
    return turned


def decode_imu(table: Table, settings: Imu) -> tuple[ImuColumns, list[Note]]:
    """Make the columns of the IMU.

    Raises
    ------
    LogError
        No reading is finite, or a field is not a vector.
    ConfigError
        The axes are none.
    """
    settings = table.source.completed(settings)
    force_unit = SPECIFIC_FORCE_UNITS[settings.specific_force_unit or "m/s2"] / settings.specific_force_scale
    rate_unit = ANGULAR_RATE_UNITS[settings.angular_rate_unit or "rad/s"] / settings.angular_rate_scale
    axes = settings.axes or FRD
    force_axes, force_key = axes, "imu.axes"
    if settings.specific_force_axes is not None:
        force_axes, force_key = settings.specific_force_axes, "imu.specific_force_axes"
    force, rate = _measured(table, "specific_force", "force"), _measured(table, "angular_rate", "rate")
    specific_force_b = in_frd(force, force_axes, force_key, force_unit)
    angular_rate_b = in_frd(rate, axes, "imu.axes", rate_unit)
    cleaner = Cleaner(table)
    note_lost_samples(cleaner)
    possible = _is_possible(specific_force_b, angular_rate_b)
    if not possible.all():  # what is not finite is not possible either
        cleaner.keep_finite(specific_force_b, angular_rate_b, hint=_LOST_HINT)
        reason = "samples are above 50 g or 2000 deg/s, or zero in all six readings"
        cleaner.keep_possible(possible, reason, _LOST_HINT)
    cleaner.drop_repeated_times(specific_force_b, angular_rate_b)
    cleaner.require_rows()
    drop_spikes(cleaner, specific_force_b, angular_rate_b)
    steps_ns = np.diff(cleaner.times)
    note_gaps(cleaner, steps_ns, settings.max_gap_s)
    note_clock_set(cleaner, steps_ns)
    note_bursts(cleaner, steps_ns, "noise.accel_white_mps_rts and noise.gyro_white_rad_rts")
    imu = ImuColumns(cleaner.times, cleaner.kept(specific_force_b), cleaner.kept(angular_rate_b))
    return imu, cleaner.notes


def _measured(table: Table, quantity: str, short: str) -> Floats:
    """Return a vector, NaN where its message says by a negative variance that it is not measured.

    What is given with an interval in microseconds is an increment over it; one over no time is NaN.
    """
    values = table.values(quantity, 3)
    if f"{short}_interval_us" in table:
        interval_us = table.values(f"{short}_interval_us", 1)
        values = values / np.where(interval_us > 0.0, interval_us * 1e-6, np.nan)
    if f"{quantity}_var" not in table:
        return values
    unmeasured = table.column(f"{quantity}_var") < 0.0
    return np.where(unmeasured[:, None], np.nan, values) if unmeasured.any() else values


def decode_truth(table: Table) -> tuple[TruthColumns, list[Note]]:
    """Make the columns of the true sensor biases."""
    accel_bias_b, gyro_bias_b = table.values("accel_bias", 3), table.values("gyro_bias", 3)
    cleaner = Cleaner(table)
    cleaner.drop_repeated_times()
    cleaner.note_missing("accelerometer biases", accel_bias_b)
    cleaner.note_missing("gyro biases", gyro_bias_b)
    return TruthColumns(cleaner.times, cleaner.kept(accel_bias_b), cleaner.kept(gyro_bias_b)), cleaner.notes


def _is_possible(specific_force_b: Floats, angular_rate_b: Floats) -> Mask:
    """Find which samples an IMU on a vehicle can have felt: within limits, and not free of gravity and Earth rate."""
    possible = _is_within(specific_force_b, LARGEST_FORCE_MPS2) & _is_within(angular_rate_b, LARGEST_RATE_RADPS)
    dead = np.flatnonzero(specific_force_b[:, 0] == 0.0)
    possible[dead] &= specific_force_b[dead].any(axis=1) | angular_rate_b[dead].any(axis=1)
    return possible


def _is_within(vectors: Floats, limit: float) -> Mask:
    """Find which vectors have no component beyond a limit; the extremes mostly tell that none has."""
    if vectors.min() >= -limit and vectors.max() <= limit:
        return np.ones(len(vectors), np.bool_)
    return np.asarray((np.abs(vectors) <= limit).all(axis=1))


GAP_STEPS: Final = 5.0
"""A pause of this many steps is more than the jitter of stamps that come in bursts."""
LONGEST_PAUSE_NS: Final = 86_400 * NS_PER_S
"""No recorder waits for a day in the middle of a dive."""


def note_gaps(cleaner: Cleaner, pauses_ns: TimeNs, max_gap_s: float) -> None:
    """Note pauses between rows in which several are missing."""
    max_gap_ns = nanoseconds(max_gap_s)
    is_short = pauses_ns <= max_gap_ns
    short_ns = pauses_ns if is_short.all() else pauses_ns[is_short]
    least_ns = min(GAP_STEPS * float(short_ns.mean()), max_gap_ns) if short_ns.size else max_gap_ns
    gaps = np.flatnonzero(pauses_ns > least_ns)
    if not gaps.size:
        return
    long = int(np.count_nonzero(pauses_ns > max_gap_ns))
    text = (
        f"gaps are longer than {least_ns / NS_PER_S:.3g} s, the longest of {pauses_ns.max() / NS_PER_S:.3f} s, "
        f"{pauses_ns[gaps].sum() / NS_PER_S:.3f} s in all; {long} longer than {max_gap_s:g} s"
    )
    hint = f"{cleaner.role}.max_gap_s says which are harmless" if long else ""
    cleaner.note("gaps", text, gaps.size, Severity.WARNING if long else Severity.INFO, hint, first=cleaner.rows[gaps])


def note_clock_set(cleaner: Cleaner, steps_ns: TimeNs) -> None:
    """Note steps that are no pause of a dive: a recorder without a clock of its own begins in 1970 until it is told."""
    if not steps_ns.size or steps_ns.max() <= LONGEST_PAUSE_NS:
        return
    steps = np.flatnonzero(steps_ns > LONGEST_PAUSE_NS)
    before, after = (np.datetime64(int(cleaner.times[steps[0] + i]), "ns").astype("M8[s]") for i in (0, 1))
    text = (
        f"steps are longer than a day, the first from {before} to {after} UTC: the clock was set while the log was "
        "recorded, or two dives are in it"
    )
    hint = "--start and --end choose what is before or behind"
    cleaner.note("clock_set", text, steps.size, Severity.WARNING, hint, first=cleaner.rows[steps])
