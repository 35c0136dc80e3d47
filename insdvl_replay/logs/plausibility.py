"""Whether IMU and DVL can be what their log says: rate, dead channels, gravity, and the scale and sign of each.

What would make the tables wrong ends the work with the key that puts it right; what may make them wrong is a warning.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay import earth
from insdvl_replay.columns import DvlColumns, Floats, ImuColumns, ReferenceColumns, seconds
from insdvl_replay.config import Config, Imu, Initial
from insdvl_replay.errors import LogError, Note
from insdvl_replay.logs.comparison import ENOUGH, Fit, TrackFit, dvl_by_velocity, gyro_by_attitude, track_by_positions
from insdvl_replay.rotation import wrap_angle
from insdvl_replay.states import DEG, MG

SLOW_HZ: Final = 40.0
"""A vehicle rolls and surges at 1 to 2 Hz; slower samples miss part of it."""
NOMINAL: Final = 0.95
"""Share of the nominal rate that an IMU holds."""
LONG_ENOUGH_S: Final = 10.0
"""No axis of a vehicle in water stands still to the last bit for so long."""
GRAVITY_DOUBT: Final = 0.05
"""Share of gravity that no bias of a working accelerometer reaches: 50 mg."""
GRAVITY_WRONG: Final = 1.5
"""Factor of gravity at which it is another unit or scale, and every table is wrong."""
UNIT_WRONG: Final = 5.0
"""Factor of the angular rate at which it is another unit: deg/s are 57 times rad/s."""
SCALE_DOUBT: Final = 0.1
"""Share of a speed or a rate beyond what temperature, sound speed and lever arm explain."""
DIRECTION_DOUBT: Final = 10.0 * DEG
"""Beyond what lever arm and sideslip turn a velocity on average."""
HEADING_DOUBT: Final = 30.0 * DEG
"""Beyond what gyro bias turns a track during a dive."""

_STUCK_S: Final = 1.0
_BLOCKS: Final = 1000
_TILT_BLOCK_S: Final = 0.25
_COHERENT: Final = 0.9
_TILT_COHERENT: Final = 0.7
_UNIT_BY_RATIO: Final = (
    (1.0 / (1000.0 * MG), "g"),
    (1.0 / MG, "mg"),
    (1000.0 * MG, "m/s2"),
    (MG, "m/s2"),
    (1e-3, "g"),
    (1e3, "mg"),
)
"""Ratio of what was read to gravity where the readings are in this unit and were taken for another."""
_AXES: Final = ("forward", "starboard", "down")


@dataclass(frozen=True)
class _GyroScale:
    """Angular rate measured over true, by whom, and the factor up to which it is in order."""

    scale: float
    by: str
    tolerance: float


def plausibility_notes(
    place: str, imu: ImuColumns, dvl: DvlColumns, reference: ReferenceColumns | None, config: Config
) -> tuple[Note, ...]:
    """Look for what cannot be in the columns of a dive.

    Parameters
    ----------
    place : str
        The file, for messages to the user.
    imu : ImuColumns
    dvl : DvlColumns
    reference : ReferenceColumns or None
    config : Config

    Returns
    -------
    tuple of Note
        Each with how often, since when, and the key that helps.

    Raises
    ------
    LogError
        The IMU is too slow, dead, or in another unit than the configuration says.
    """
    track = None
    if reference is not None and not (reference.has_attitude and reference.has_velocity):
        track = track_by_positions(imu, dvl, reference, config)
    return (
        *_rate_notes(place, imu, config.imu),
        *_dead_notes(place, imu),
        *_stuck_notes(imu),
        *_gravity_notes(place, imu, reference, config.imu),
        *_gyro_notes(place, imu, _gyro_scale(imu, reference, track), config.imu),
        *_zero_notes(dvl),
        *_direction_notes(dvl, reference, config),
        *_track_notes(track, dvl, config.initial),
    )


def _rate_notes(place: str, imu: ImuColumns, settings: Imu) -> list[Note]:
    steps_s = seconds(imu.time_ns[1:], imu.time_ns[:-1])
    short_s = steps_s[steps_s <= settings.max_gap_s]
    if len(short_s) < ENOUGH:
        return []
    rate_hz = 1.0 / float(short_s.mean())
    text = f"the IMU has {rate_hz:.1f} samples a second, too few for an INS to follow a vehicle's motion"
    hint = f"imu.topic names a faster one; imu.min_rate_hz = {np.floor(rate_hz):g} tries with this one"
    if rate_hz < NOMINAL * settings.min_rate_hz:
        raise LogError(f"{place}: {text}", hint)
    if rate_hz < SLOW_HZ:
        return [Note("imu_slow", text, len(imu.time_ns), "warning", "imu.topic names a faster one, if the log has any")]
    return []


def _dead_notes(place: str, imu: ImuColumns) -> list[Note]:
    """Find axes that never change."""
    span_s = float(seconds(imu.time_ns[-1:], imu.time_ns[0])[0])
    if span_s < LONG_ENOUGH_S:
        return []
    notes = []
    for quantity, unit, readings in (
        ("specific_force", "m/s^2", imu.specific_force_b),
        ("angular_rate", "rad/s", imu.angular_rate_b),
    ):
        words, hint = quantity.replace("_", " "), f'imu.{quantity} = "field.path" names another field'
        if not readings.any():
            raise LogError(f"{place}: the {words} is zero in all {len(readings)} samples of the IMU", hint)
        for axis in np.flatnonzero(readings.min(axis=0) == readings.max(axis=0)).tolist():
            text = f"{words} {_AXES[axis]} is {readings[0, axis]:g} {unit} in all {len(readings)} samples, from 0 s on"
            notes.append(Note("imu_constant", text, len(readings), "warning", hint))
    return notes


def _stuck_notes(imu: ImuColumns) -> list[Note]:
    """Find runs in which all six readings repeat."""
    same = np.ones(len(imu.time_ns) + 1, np.bool_)
    for readings in (*imu.specific_force_b.T, *imu.angular_rate_b.T):
        same[1:-1] &= readings[1:] == readings[:-1]
    same[[0, -1]] = False
    starts = np.flatnonzero(~same[:-1] & same[1:])
    ends = np.flatnonzero(same[:-1] & ~same[1:])
    lengths_s = seconds(imu.time_ns[ends], imu.time_ns[starts])
    long = np.flatnonzero(lengths_s > _STUCK_S)
    if not long.size:
        return []
    first_s = float(seconds(imu.time_ns[starts[long[:1]]], imu.time_ns[0])[0])
    count = int(np.sum(ends[long] - starts[long]))
    text = (
        f"{count} samples of the IMU repeat all readings of the one before for over {_STUCK_S:g} s, "
        f"the first at {first_s:.1f} s, the longest run of {lengths_s.max():.1f} s"
    )
    return [Note("imu_stuck", text, count, "warning", "--start and --end leave them out")]


def _gravity_notes(place: str, imu: ImuColumns, reference: ReferenceColumns | None, settings: Imu) -> list[Note]:
    """Compare the specific force of the quieter half of the seconds with gravity."""
    mean_b, starts = _quiet_blocks(imu)
    sizes = np.linalg.norm(mean_b, axis=1)
    gravity, size = _gravity(reference), float(np.median(sizes))
    ratio = size / gravity
    text = (
        f"the specific force is {size:.3f} m/s^2 in the median of quiet seconds, where gravity is {gravity:.3f} m/s^2"
    )
    if not 1.0 / GRAVITY_WRONG < ratio < GRAVITY_WRONG:
        raise LogError(f"{place}: {text}", _force_hint(ratio, settings))
    doubtful = np.abs(sizes / gravity - 1.0) > GRAVITY_DOUBT
    if abs(ratio - 1.0) > GRAVITY_DOUBT:
        text += f"; the first time at {_since_s(imu, starts[doubtful]):.1f} s"
        return [Note("imu_gravity", text, int(doubtful.sum()), "warning", _force_hint(ratio, settings))]
    along_down = float(np.median(mean_b[:, 2]))
    if along_down > 0.0:
        above = mean_b[:, 2] > 0.0
        text = (
            f"the specific force along down is {along_down:+.3f} m/s^2 in the median of quiet seconds, the first time at "
            f"{_since_s(imu, starts[above]):.1f} s, where a level vehicle has {-gravity:.3f} m/s^2"
        )
        hint = 'imu.axes = "flu" turns y and z; imu.specific_force_axes = "-x-y-z" turns the sign of the force alone'
        return [Note("imu_upside_down", text, int(above.sum()), "warning", hint)]
    return []


def _quiet_blocks(imu: ImuColumns) -> tuple[Floats, Floats]:
    """Give the mean force over each of the quieter half of some seconds, and the rows at which they begin."""
    length = min(_samples_in(imu, 1.0), len(imu.time_ns))
    blocks = len(imu.time_ns) // length
    some = np.arange(0, blocks, 1 + blocks // _BLOCKS)
    force_b = imu.specific_force_b[: blocks * length].reshape(blocks, length, 3)[some]
    unrest = force_b.var(axis=1).sum(axis=1)
    quiet = unrest <= np.median(unrest)
    return force_b[quiet].mean(axis=1), some[quiet] * length


def _gravity(reference: ReferenceColumns | None) -> float:
    """Give gravity at the reference's latitude, and the standard's where there is none."""
    if reference is None or not reference.has_position:
        return 1000.0 * MG
    return float(earth.normal_gravity(float(np.nanmedian(reference.position[:, 0])), 0.0))


def _force_hint(ratio: float, settings: Imu) -> str:
    for wrong, unit in _UNIT_BY_RATIO:
        if abs(ratio / wrong - 1.0) < 0.1:
            return f'imu.specific_force_unit = "{unit}"'
    return f"imu.specific_force_scale = {ratio * settings.specific_force_scale:.4g}"


def _gyro_scale(imu: ImuColumns, reference: ReferenceColumns | None, track: TrackFit | None) -> _GyroScale | None:
    """Ask for the scale of the gyros whoever knows it best."""
    by_attitude = gyro_by_attitude(imu, reference) if reference is not None else None
    if by_attitude is not None and abs(by_attitude[1]) > _COHERENT:
        return _GyroScale(by_attitude[0], "the reference's attitude", 1.0 + SCALE_DOUBT)
    if track is not None and track.gyro_scale is not None and track.coherence > _COHERENT:
        return _GyroScale(track.gyro_scale, "the DVL's track against the reference's positions", 1.15)
    # Gravity swings in a moving vehicle with its own acceleration, which shows more turning or less than there is.
    by_gravity = gyro_by_gravity(imu)
    return _GyroScale(by_gravity, "the swing of gravity", 1.7) if by_gravity is not None else None


def gyro_by_gravity(imu: ImuColumns) -> float | None:
    """Compare the gyros with the change of gravity's direction in body axes, ``du/dt = -w x u``.

    Parameters
    ----------
    imu : ImuColumns

    Returns
    -------
    float or None
        Angular rate measured over true; None where the two do not move together enough to tell.
    """
    length = _samples_in(imu, _TILT_BLOCK_S)
    blocks = len(imu.time_ns) // length
    if blocks <= 2 * ENOUGH:
        return None
    force_b, rate_b = (
        readings[: blocks * length].reshape(blocks, length, 3).mean(axis=1)
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
    if product**2 <= _TILT_COHERENT**2 * power * float(np.sum(seen[good] ** 2)):
        return None
    return power / product


def _gyro_notes(place: str, imu: ImuColumns, found: _GyroScale | None, settings: Imu) -> list[Note]:
    if found is None or 1.0 / found.tolerance < found.scale < found.tolerance:
        return []
    text = f"the angular rate is {found.scale:.3g} times what {found.by} shows, from 0 s on"
    if found.scale < 0.0:
        hint = 'imu.axes = "flu" turns y and z, and imu.specific_force_axes names those of the force where they differ'
        return [Note("imu_gyro_sign", text, len(imu.time_ns), "warning", hint)]
    if found.scale > UNIT_WRONG:
        raise LogError(f"{place}: {text}", 'imu.angular_rate_unit = "deg/s"')
    if found.scale < 1.0 / UNIT_WRONG:
        raise LogError(f"{place}: {text}", 'imu.angular_rate_unit = "rad/s"')
    hint = f"imu.angular_rate_scale = {found.scale * settings.angular_rate_scale:.3g}"
    return [Note("imu_gyro_scale", text, len(imu.time_ns), "warning", hint)]


def _zero_notes(dvl: DvlColumns) -> list[Note]:
    """Find pings that are exactly zero, as some instruments report without a lock."""
    values = dvl.velocity_d if dvl.velocity_d is not None else dvl.beam_velocity_mps
    if values is None:
        return []
    zero = np.flatnonzero((values == 0.0).all(axis=1))
    if not zero.size:
        return []
    first_s = float(seconds(dvl.time_ns[zero[:1]], dvl.time_ns[0])[0])
    text = (
        f"{zero.size} of {len(values)} pings are exactly zero, the first {first_s:.1f} s after the first ping: "
        "the instrument may have had no lock"
    )
    return [Note("dvl_zero", text, int(zero.size), "warning", 'dvl.valid = "field.path" names what marks good pings')]


def _direction_notes(dvl: DvlColumns, reference: ReferenceColumns | None, config: Config) -> list[Note]:
    found = dvl_by_velocity(dvl, reference, config) if reference is not None else None
    if found is None or found.coherence < _COHERENT:
        return []
    notes = _scale_notes(found, dvl, config.dvl.scale)
    if abs(found.turn) > DIRECTION_DOUBT:
        roll, pitch, heading = config.dvl.mounting_rpy_deg
        right = float(wrap_angle(np.asarray(heading * DEG - found.turn))) / DEG
        text = (
            f"the DVL's velocity is turned by {found.turn / DEG:.0f} deg from the reference's, from the first ping on"
        )
        hint = f"dvl.mounting_rpy_deg = [{roll:g}, {pitch:g}, {right:.0f}], or another reference.axes"
        notes.append(Note("dvl_direction", text, len(dvl.time_ns), "warning", hint))
    return notes


def _scale_notes(found: Fit | TrackFit, dvl: DvlColumns, configured: float) -> list[Note]:
    scale = found.scale if isinstance(found, Fit) else found.dvl_scale
    if abs(scale - 1.0) <= SCALE_DOUBT:
        return []
    text = f"the DVL's velocity is {scale:.3f} times the reference's, from the first ping on"
    hint = f"dvl.scale = {scale * configured:.3f}, or dvl.beam_tilt_deg"
    return [Note("dvl_scale", text, len(dvl.time_ns), "warning", hint)]


def _track_notes(track: TrackFit | None, dvl: DvlColumns, initial: Initial) -> list[Note]:
    if track is None or track.coherence < _COHERENT:
        return []
    notes = _scale_notes(track, dvl, 1.0)
    if initial.heading_deg is not None:
        off = float(wrap_angle(np.asarray(initial.heading_deg * DEG - track.heading)))
        if abs(off) > HEADING_DOUBT:
            text = (
                f"the DVL's track fits the reference's positions with a heading of {track.heading / DEG:.0f} deg at the "
                f"start, {initial.heading_deg:g} deg are configured"
            )
            hint = "initial.heading_deg, or dvl.mounting_rpy_deg where the heading is known"
            notes.append(Note("dvl_direction", text, len(dvl.time_ns), "warning", hint))
    return notes


def _samples_in(imu: ImuColumns, length_s: float) -> int:
    steps_s = seconds(imu.time_ns[1:], imu.time_ns[:-1])
    return max(1, round(length_s / float(np.median(steps_s)))) if steps_s.size else 1


def _since_s(imu: ImuColumns, rows: Floats) -> float:
    return float(seconds(imu.time_ns[rows[:1]], imu.time_ns[0])[0])
