"""The samples of an IMU and the truth about it: SI units, the project's axes, clean rows, no single samples that jump.

One sample of 300 m/s^2 at 100 Hz is a velocity of 3 m/s that never was. A vehicle that is hit swings for several
samples; a jump that is gone with the next one is the instrument's.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from insdvl_replay.core.config import Imu
from insdvl_replay.core.dive_columns import (
    Floats,
    ImuColumns,
    Mask,
    TimeNs,
    TruthColumns,
    nanoseconds,
)
from insdvl_replay.core.errors import ConfigError, Note
from insdvl_replay.core.states import DEG, LARGEST_FORCE_MPS2, LARGEST_RATE_RADPS
from insdvl_replay.core.units import ANGULAR_RATE_UNITS, SPECIFIC_FORCE_UNITS
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.logs.columns.clean import (
    Cleaner,
    is_few,
    note_bursts,
    note_gaps,
    note_lost_samples,
)
from insdvl_replay.logs.columns.tables import Table

FRD: Final = "frd"  # the project's axes, the default
_NAMED_AXES: Final = {FRD: "+x+y+z", "flu": "+x-y-z"}


def in_frd(
    vectors: Floats,
    axes: str,
    key: str,
    unit: float = 1.0,
) -> Floats:
    """Bring vectors, (k, 3), from the log's axes and unit to forward-starboard-down and SI.

    Axes are ``frd``, ``flu``, or a signed permutation whose i-th part is the reading along the i-th of the axes
    forward, starboard, down. An odd number of turned signs is allowed: some instruments report the opposite of a
    vector. The key is that of the axes in messages to the user.
    """
    text = _NAMED_AXES.get(axes, axes)
    readings = re.findall(r"([+-])([xyz])", text)
    if len(text) != 6 or sorted(axis for _, axis in readings) != ["x", "y", "z"]:
        hint = f'{key} = "frd", "flu" or for example "+y+x-z"'
        raise ConfigError(f'{key} = "{axes}" is no set of axes', hint)
    if text == _NAMED_AXES[FRD] and unit == 1.0:
        return vectors
    turned = np.empty_like(vectors)
    for i, (sign, axis) in enumerate(readings):
        factor = unit if sign == "+" else -unit
        np.multiply(vectors[:, "xyz".index(axis)], factor, out=turned[:, i])
    return turned


def decode_imu(table: Table, settings: Imu) -> tuple[ImuColumns, list[Note]]:
    """Make the columns of the IMU; a `LogError` where no reading can be used, a `ConfigError` where axes are none."""
    settings = table.source.completed(settings)
    force_unit = SPECIFIC_FORCE_UNITS[settings.specific_force_unit or "m/s2"]
    force_unit /= settings.specific_force_scale
    rate_unit = ANGULAR_RATE_UNITS[settings.angular_rate_unit or "rad/s"]
    rate_unit /= settings.angular_rate_scale
    axes = settings.axes or FRD
    force_axes = axes
    force_key = "imu.axes"
    if settings.specific_force_axes is not None:
        force_axes = settings.specific_force_axes
        force_key = "imu.specific_force_axes"
    force = measured_vectors(table, "specific_force", "force", settings)
    rate = measured_vectors(table, "angular_rate", "rate", settings)
    specific_force_b = in_frd(force, force_axes, force_key, force_unit)
    angular_rate_b = in_frd(rate, axes, "imu.axes", rate_unit)
    cleaner = Cleaner(table)
    note_lost_samples(cleaner)
    # A sample is possible within the limits, and not free of gravity and Earth rate; what is not finite is not either.
    possible = _is_within(specific_force_b, LARGEST_FORCE_MPS2)
    possible &= _is_within(angular_rate_b, LARGEST_RATE_RADPS)
    dead = np.flatnonzero(specific_force_b[:, 0] == 0.0)
    possible[dead] &= specific_force_b[dead].any(axis=1) | angular_rate_b[dead].any(axis=1)
    if not possible.all():
        code = "not_finite expected"
        cleaner.keep_finite(specific_force_b, angular_rate_b, code=code, is_expected=True)
        _drop_impossible(cleaner, possible, specific_force_b, angular_rate_b)
    cleaner.drop_repeated_times(specific_force_b, angular_rate_b)
    cleaner.require_rows()
    _drop_spikes(cleaner, specific_force_b, angular_rate_b)
    steps_ns = np.diff(cleaner.times)
    note_gaps(cleaner, steps_ns, settings.max_gap_s)
    note_bursts(cleaner, steps_ns, "noise.accel_white_mps_rts and noise.gyro_white_rad_rts")
    imu = ImuColumns(cleaner.times, cleaner.kept(specific_force_b), cleaner.kept(angular_rate_b))
    return turned_to_body(imu, settings.mounting_rpy_deg), cleaner.notes


def turned_to_body(imu: ImuColumns, rpy_deg: Sequence[float]) -> ImuColumns:
    """Turn readings from the IMU's axes to the body's, by roll, pitch and heading, deg."""
    if not any(rpy_deg):
        return imu
    turn_b = mat_from_rpy(np.array(rpy_deg) * DEG).T
    return replace(
        imu,
        specific_force_b=imu.specific_force_b @ turn_b,
        angular_rate_b=imu.angular_rate_b @ turn_b,
    )


def measured_vectors(
    table: Table,
    quantity: str,
    short: str,
    settings: Imu,
) -> Floats:
    """Return a vector, NaN where its message says by a negative variance that it is not measured.

    What is given with an interval, by type or by the settings, is an increment over it; one over no time is NaN.
    """
    values = table.values(quantity, 3)
    if f"{short}_interval_us" in table:
        interval_us = table.values(f"{short}_interval_us", 1)
        values = values / np.where(interval_us > 0.0, interval_us * 1e-6, np.nan)
    elif "increment_s" in table:
        interval_s = table.values("increment_s", 1)
        values = values / np.where(interval_s > 0.0, interval_s, np.nan)
    elif isinstance(settings.increment_s, float):
        values = values / settings.increment_s
    if f"{quantity}_var" not in table:
        return values
    unmeasured = table.column(f"{quantity}_var") < 0.0
    if unmeasured.any():
        return np.where(unmeasured[:, None], np.nan, values)
    return values


def _drop_impossible(
    cleaner: Cleaner,
    possible: Mask,
    specific_force_b: Floats,
    angular_rate_b: Floats,
) -> None:
    """Drop samples that no IMU on a vehicle reads, unless it reads nothing else."""
    rows = cleaner.rows[~possible[cleaner.rows]]
    if not 0 < rows.size < cleaner.rows.size:
        return
    force = specific_force_b[rows]
    rate = angular_rate_b[rows]
    beyond = [force[np.abs(force) > LARGEST_FORCE_MPS2], rate[np.abs(rate) > LARGEST_RATE_RADPS]]
    if not (force.any(axis=1) | rate.any(axis=1)).all():
        beyond.append(np.zeros(1))
    cleaner.keep_possible(possible, np.concatenate(beyond), "impossible samples")


def _is_within(vectors: Floats, limit: float) -> Mask:
    """Find which vectors have no component beyond a limit; the extremes mostly tell that none has."""
    if vectors.min() >= -limit and vectors.max() <= limit:
        return np.ones(len(vectors), np.bool_)
    return np.asarray((np.abs(vectors) <= limit).all(axis=1))


def _drop_spikes(cleaner: Cleaner, specific_force_b: Floats, angular_rate_b: Floats) -> None:
    """Drop samples that jump beyond what a vehicle can do and back; the pause is bridged like any other."""
    spikes = np.zeros(len(cleaner.rows), np.bool_)
    for readings, jump in ((specific_force_b, 20.0), (angular_rate_b, 3.5)):  # 2 g and 200 deg/s
        kept = cleaner.kept(readings)
        # Readings that are never so far apart have no such jump, and need no second look.
        if kept.max() - kept.min() > jump:
            spikes |= find_spikes(cleaner.times, kept, jump)
    count = int(np.count_nonzero(spikes))
    if count and is_few(count, len(spikes)):
        good = np.ones(len(specific_force_b), np.bool_)
        good[cleaner.rows[spikes]] = False
        cleaner.keep(good, "spikes")


def find_spikes(time_ns: TimeNs, readings: Floats, jump: float) -> Mask:
    """Find single samples, shape (k, 3), that are far from both of their neighbours, while these are near."""
    spikes = np.zeros(len(readings), np.bool_)
    if len(readings) < 3:
        return spikes
    step = np.diff(readings, axis=0)
    there = step[:-1]
    back = step[1:]
    # Where readings jump all the time, or are in another unit, none stands out.
    far = np.maximum(jump, 20.0 * np.median(np.abs(step), axis=0))
    smaller = np.minimum(np.abs(there), np.abs(back))
    returns = np.abs(there + back) < np.maximum(0.25 * far, 0.05 * smaller)
    alone = (smaller > far) & (there * back < 0.0) & returns
    # Further apart, two samples do not tell a spike from a jolt.
    near = np.diff(time_ns) <= nanoseconds(0.03)
    spikes[1:-1] = alone.any(axis=1) & near[:-1] & near[1:]
    # Of an end the samples next to it say where it should be.
    for end, first, second in ((0, 0, 1), (-1, -1, -2)):
        away = (np.abs(step[first]) > far) & (np.abs(step[second]) < 0.25 * far)
        spikes[end] = away.any() and near[first] and near[second]
    return spikes


def decode_truth(table: Table) -> tuple[TruthColumns, list[Note]]:
    """Make the columns of the true sensor biases."""
    accel_bias_b = table.values("accel_bias", 3)
    gyro_bias_b = table.values("gyro_bias", 3)
    cleaner = Cleaner(table)
    cleaner.drop_repeated_times()
    cleaner.note_missing("accelerometer biases", accel_bias_b)
    cleaner.note_missing("gyro biases", gyro_bias_b)
    return TruthColumns(
        cleaner.times, cleaner.kept(accel_bias_b), cleaner.kept(gyro_bias_b)
    ), cleaner.notes
