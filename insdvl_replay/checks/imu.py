"""Whether an IMU can be what its log says: fast enough, alive, feeling gravity, and turning as others see it.

What would make the tables wrong ends the work with the key that puts it right; what may make them wrong is a warning.
The gyros are compared with who else knows how the vehicle turned: the reference's attitude, or the swing of gravity.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.config import Imu
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Floats,
    ImuColumns,
    ReferenceColumns,
    TimeNs,
    find_runs,
    nanoseconds,
    seconds,
)
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.states import DEG, MG
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry import earth
from insdvl_replay.geometry.rotation import vector_from_mat

SLOW_HZ: Final = 40.0
"""A vehicle rolls and surges at 1 to 2 Hz; slower samples miss part of it."""
NOMINAL: Final = 0.95
"""Share of the nominal rate that an IMU holds."""
LONG_ENOUGH_S: Final = 10.0
"""No axis of a vehicle in water stands still to the last bit for so long."""
LEAST_S: Final = 2.0
"""A shorter piece of a log is no reason to refuse it."""
SPIN_RADPS: Final = 1.0
"""No vehicle that a DVL can follow turns faster than this half of the time."""
STUCK_S: Final = 1.0
"""Nor do all six of them together for so long."""
GRAVITY_DOUBT: Final = 0.05
"""Share of gravity that no bias of a working accelerometer reaches: 50 mg."""
GRAVITY_WRONG: Final = 1.5
"""Factor of gravity at which it is another unit or scale, and every table is wrong."""
_ENOUGH_STEPS: Final = 20
_FEW: Final = 1000
_BLOCKS: Final = 1000
_SAMPLES: Final = 100_000
_UNIT_BY_RATIO: Final = (
    (1.0 / (1000.0 * MG), "g"),
    (1.0 / MG, "mg"),
    (1000.0 * MG, "m/s2"),
    (MG, "m/s2"),
    (1e-3, "g"),
    (1e3, "mg"),
)
"""Ratio of what was read to gravity where the readings are in this unit and were taken for another."""
AXES: Final = ("forward", "starboard", "down")
Check = Callable[[], Iterable[Note]]
"""Looks at one thing, and raises `LogError` where the tables would be wrong."""


def imu_checks(place: str, imu: ImuColumns, reference: ReferenceColumns | None, settings: Imu) -> tuple[Check, ...]:
    """List what has to be looked at in the readings of an IMU."""
    return (
        partial(_spin_notes, place, imu),
        partial(_rate_notes, place, imu, settings),
        partial(_dead_notes, place, imu),
        partial(_stuck_notes, imu),
        partial(_gravity_notes, place, imu, reference, settings),
    )


def samples_in(imu: ImuColumns, length_s: float) -> int:
    """Return the number of samples, 1 at least, that an IMU takes in a time."""
    return max(1, round(length_s / imu.usual_step_s)) if len(imu.time_ns) > 1 else 1


def _rate_notes(place: str, imu: ImuColumns, settings: Imu) -> list[Note]:
    steps_ns = np.diff(imu.time_ns)
    is_short = steps_ns <= nanoseconds(settings.max_gap_s)
    short_ns = steps_ns if is_short.all() else steps_ns[is_short]
    if len(short_ns) < _ENOUGH_STEPS:
        return []
    rate_hz = NS_PER_S / float(short_ns.mean())
    text = f"the IMU has {rate_hz:.1f} samples a second, too few for an INS to follow a vehicle's motion, from 0 s on"
    hint = f"imu.topic names a faster one; imu.min_rate_hz = {np.floor(rate_hz):g} tries with this one"
    if rate_hz < NOMINAL * settings.min_rate_hz:
        raise LogError(text, hint, place)
    if rate_hz < SLOW_HZ:
        hint = "imu.topic names a faster one, if the log has any"
        return [Note("imu_slow", text, len(imu.time_ns), Severity.WARNING, hint)]
    return []


def _dead_notes(place: str, imu: ImuColumns) -> list[Note]:
    """Find axes that never change."""
    if _span_s(imu) < LONG_ENOUGH_S:
        return []
    notes = []
    for quantity, unit, readings in (
        ("specific_force", "m/s^2", imu.specific_force_b),
        ("angular_rate", "rad/s", imu.angular_rate_b),
    ):
        words, hint = quantity.replace("_", " "), f'imu.{quantity} = "field.path" names another field'
        if not readings[0].any() and not readings.any():
            raise LogError(f"the {words} is zero in all {len(readings)} samples of the IMU", hint, place)
        for axis in [axis for axis, column in enumerate(readings.T) if _is_constant(column)]:
            text = f"{words} {AXES[axis]} is {readings[0, axis]:g} {unit} in all {len(readings)} samples, from 0 s on"
            notes.append(Note("imu_constant", text, len(readings), Severity.WARNING, hint))
    return notes


def _is_constant(column: Floats) -> bool:
    """Return whether all numbers are the same; the first few mostly show that they are not."""
    return bool(np.all(column[:_FEW] == column[0]) and np.all(column == column[0]))


def _stuck_notes(imu: ImuColumns) -> list[Note]:
    """Find runs in which all six readings repeat."""
    same = imu.specific_force_b[1:, 0] == imu.specific_force_b[:-1, 0]
    rows = np.flatnonzero(same)
    for readings in (imu.specific_force_b, imu.angular_rate_b):
        same[rows] &= (readings[rows + 1] == readings[rows]).all(axis=1)
    starts, ends = find_runs(same)
    lengths_s = seconds(imu.time_ns[ends], imu.time_ns[starts])
    long = np.flatnonzero(lengths_s > STUCK_S)
    if not long.size:
        return []
    first_s = float(seconds(imu.time_ns[starts[long[:1]]], imu.time_ns[0])[0])
    count = int(np.sum(ends[long] - starts[long]))
    text = (
        f"{count} samples of the IMU repeat all readings of the one before for over {STUCK_S:g} s, "
        f"the first at {first_s:.1f} s, the longest run of {lengths_s.max():.1f} s"
    )
    return [Note("imu_stuck", text, count, Severity.WARNING, "--start and --end leave them out")]


def _spin_notes(place: str, imu: ImuColumns) -> list[Note]:
    some_b = imu.angular_rate_b[:: 1 + len(imu.time_ns) // _SAMPLES]
    turning_radps = float(np.median(np.linalg.norm(some_b, axis=1)))
    if turning_radps > SPIN_RADPS and _span_s(imu) > LEAST_S:
        raise LogError(
            f"the angular rate is {turning_radps:.3f} rad/s in the median, {turning_radps / DEG:.0f} deg/s, "
            "and no vehicle turns so fast for so long",
            'imu.angular_rate_unit = "deg/s", or imu.angular_rate = "field.path" names another field',
            place,
        )
    return []


def _gravity_notes(place: str, imu: ImuColumns, reference: ReferenceColumns | None, settings: Imu) -> list[Note]:
    """Compare the specific force of the quieter half of the seconds with gravity."""
    mean_b, starts = _quiet_blocks(imu)
    sizes = np.linalg.norm(mean_b, axis=1)
    gravity, size = _gravity(reference), float(np.median(sizes))
    ratio = size / gravity
    text = (
        f"the specific force is {size:.3f} m/s^2 in the median of quiet seconds, where gravity is {gravity:.3f} m/s^2"
    )
    if not 1.0 / GRAVITY_WRONG < ratio < GRAVITY_WRONG and _span_s(imu) > LEAST_S:
        raise LogError(text, _force_hint(ratio, settings), place)
    doubtful = np.abs(sizes / gravity - 1.0) > GRAVITY_DOUBT
    if abs(ratio - 1.0) > GRAVITY_DOUBT:
        text += f"; the first time at {_since_s(imu, starts[doubtful]):.1f} s"
        return [Note("imu_gravity", text, int(doubtful.sum()), Severity.WARNING, _force_hint(ratio, settings))]
    along_down = float(np.median(mean_b[:, 2]))
    if along_down > 0.0:
        above = mean_b[:, 2] > 0.0
        text = (
            f"the specific force along down is {along_down:+.3f} m/s^2 in the median of quiet seconds, the first time "
            f"at {_since_s(imu, starts[above]):.1f} s, where a level vehicle has {-gravity:.3f} m/s^2"
        )
        hint = 'imu.axes = "flu" turns y and z; imu.specific_force_axes = "-x-y-z" turns the sign of the force alone'
        return [Note("imu_upside_down", text, int(above.sum()), Severity.WARNING, hint)]
    return []


def _quiet_blocks(imu: ImuColumns) -> tuple[Floats, Floats]:
    """Return the mean force over each of the quieter half of some seconds, and the rows at which they begin."""
    length = min(samples_in(imu, 1.0), len(imu.time_ns))
    blocks = len(imu.time_ns) // length
    some = np.arange(0, blocks, 1 + blocks // _BLOCKS)
    force_b = imu.specific_force_b[: blocks * length].reshape(blocks, length, 3)[some]
    unrest = force_b.var(axis=1).sum(axis=1)
    quiet = unrest <= np.median(unrest)
    return force_b[quiet].mean(axis=1), some[quiet] * length


def _gravity(reference: ReferenceColumns | None) -> float:
    """Return gravity at the reference's latitude, and the standard's where there is none."""
    if reference is None or not reference.has_position:
        return 1000.0 * MG
    return float(earth.normal_gravity(float(np.nanmedian(reference.position[:, 0])), 0.0))


def _force_hint(ratio: float, settings: Imu) -> str:
    if not ratio:
        return 'imu.specific_force = "field.path" names another field'
    for wrong, unit in _UNIT_BY_RATIO:
        if abs(ratio / wrong - 1.0) < 0.1:
            return f'imu.specific_force_unit = "{unit}"'
    return f"imu.specific_force_scale = {ratio * settings.specific_force_scale:.4g}"


def _span_s(imu: ImuColumns) -> float:
    return float(seconds(imu.time_ns[-1:], imu.time_ns[0])[0])


def _since_s(imu: ImuColumns, rows: Floats) -> float:
    return float(seconds(imu.time_ns[rows[:1]], imu.time_ns[0])[0])


ENOUGH: Final = 20
"""Fewer pairs than this may agree by chance."""
LONGEST_STEP_S: Final = 2.5
"""What lies further apart is not compared, since nobody saw what was between."""
_LEAST_TURN_RADPS: Final = 0.3 * DEG  # above the noise that differences of attitudes have
_TILT_BLOCK_S: Final = 0.25
_TILT_CORRELATION: Final = 0.7


@dataclass(frozen=True)
class AttitudeFit:
    """How the gyros follow the change of the reference's attitude: measured over true, and how they correlate.

    How far the attitude goes to and fro about each axis, its swing, rad, tells whether there is more than noise to
    compare. By axis, shape (3,).
    """

    scale: float
    correlation: float
    excursion: Floats
    by_axis: Floats


def gyro_by_attitude(imu: ImuColumns, reference: ReferenceColumns) -> AttitudeFit | None:
    """Compare what the gyros add up to between two attitudes of the reference with the turn that it shows.

    None where the vehicle turned too little to tell.
    """
    rows = np.flatnonzero(np.isfinite(reference.mat_nb).all(axis=(1, 2)) & lies_within(reference.time_ns, imu.time_ns))
    time_s, mat_nb = seconds(reference.time_ns[rows], imu.time_ns[0]), reference.mat_nb[rows]
    if len(rows) < ENOUGH:
        return None
    turned = vector_from_mat(np.swapaxes(mat_nb[:-1], 1, 2) @ mat_nb[1:])
    step_s = np.diff(time_s)
    summed = np.diff(turned_by(imu, time_s), axis=0)
    turning = np.linalg.norm(turned, axis=1) > _LEAST_TURN_RADPS * step_s
    good = turning & (step_s <= LONGEST_STEP_S) & (np.linalg.norm(turned, axis=1) < 1.0)
    if np.count_nonzero(good) < ENOUGH:
        return None
    product, power, summed_power = (
        np.sum(one[good] * other[good], axis=0) for one, other in ((summed, turned), (turned, turned), (summed, summed))
    )
    return AttitudeFit(
        scale=float(product.sum() / power.sum()),
        correlation=float(_correlation(product.sum(), power.sum() * summed_power.sum())),
        excursion=np.ptp(np.cumsum(turned, axis=0), axis=0),
        by_axis=_correlation(product, power * summed_power),
    )


def _correlation(product: Floats, powers: Floats) -> Floats:
    """Divide by the root of both powers; 0 where one is 0."""
    return np.divide(product, np.sqrt(powers), out=np.zeros_like(product), where=powers > 0.0)


def gyro_by_gravity(imu: ImuColumns) -> float | None:
    """Compare the gyros with the change of gravity's direction in body axes, ``du/dt = -w x u``."""
    length = samples_in(imu, _TILT_BLOCK_S)
    blocks = len(imu.time_ns) // length
    if blocks <= 2 * ENOUGH:
        return None
    starts = np.arange(0, blocks * length, length)
    force_b, rate_b = (
        np.add.reduceat(readings[: blocks * length], starts, axis=0) / length
        for readings in (imu.specific_force_b, imu.angular_rate_b)
    )
    size = np.linalg.norm(force_b, axis=1, keepdims=True)
    direction = np.divide(force_b, size, out=np.zeros_like(force_b), where=size > 0.0)
    step_s = seconds(imu.time_ns[length : blocks * length : length], imu.time_ns[: (blocks - 1) * length : length])
    turned = -np.cross(rate_b[1:] + rate_b[:-1], direction[1:] + direction[:-1]) / 4.0 * step_s[:, None]
    seen = np.diff(direction, axis=0)
    good = step_s < 2.0 * _TILT_BLOCK_S
    product = float(np.sum(turned[good] * seen[good]))
    power = float(np.sum(turned[good] ** 2))
    if product**2 <= _TILT_CORRELATION**2 * power * float(np.sum(seen[good] ** 2)):
        return None
    return power / product


def turned_by(imu: ImuColumns, at_s: Floats, longest_s: float = np.inf) -> Floats:
    """Add up the angular rate about each axis from the first sample to times, shape (k,), in s since it; shape (k, 3).

    The turns are in rad. In longer pauses nothing is added, since nobody saw what turned in them.
    """
    sample_s = seconds(imu.time_ns, imu.time_ns[0])
    step_s = np.diff(sample_s)
    step_s[step_s > longest_s] = 0.0
    columns = []
    for rate in imu.angular_rate_b.T:
        total = np.zeros(len(rate))
        turned = np.add(rate[1:], rate[:-1], out=total[1:])
        turned *= 0.5
        turned *= step_s
        np.cumsum(turned, out=turned)
        columns.append(np.interp(at_s, sample_s, total))
    return np.stack(columns, axis=1)


def lies_within(time_ns: TimeNs, others_ns: TimeNs) -> NDArray[np.bool_]:
    """Find which times, shape (k,), lie between the first and the last of others, which are in order."""
    return np.asarray((time_ns >= others_ns[0]) & (time_ns <= others_ns[-1]))
