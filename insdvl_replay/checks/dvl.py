"""Checks of a DVL: its unit, constant values, and its velocity against the reference's.

Horizontal vectors are complex numbers: forward or north, plus i times starboard or east.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.checks.imu import AXES, ENOUGH, LONGEST_STEP_S, lies_within, since_s, turned_by
from insdvl_replay.checks.sentences import Measured, Remark, refusal
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    DvlColumns,
    Floats,
    ImuColumns,
    Mask,
    ReferenceColumns,
    TimeNs,
    in_pauses,
    nanoseconds,
    seconds,
)
from insdvl_replay.core.notes import note
from insdvl_replay.core.states import DEG, DEG_PER_HOUR, FASTEST_MPS
from insdvl_replay.geometry.frames import (
    Complex,
    DvlMounting,
    horizontal,
    north_east_m,
    solve_beams,
)
from insdvl_replay.geometry.rotation import wrap_angle

# Share of a speed or a rate; sound speed and lever arm explain less.
LARGEST_SCALE_ERROR: Final = 0.1
COHERENT: Final = 0.97  # only what follows the reference this well can be measured by it
INCOHERENT: Final = 0.95  # what follows the reference worse than this contradicts it

LEAST_MOVED_M: Final = 3.0  # in ten seconds, above the noise of a satellite fix

Rows = NDArray[np.intp]
Complexes = NDArray[np.complex128]
_SCALES: Final = np.concatenate([[DEG], np.geomspace(0.3, 3.0, 93), [1.0 / DEG]])


@dataclass(frozen=True)
class Fit:
    """How one series of horizontal vectors follows another."""

    scale: float  # length of the first over the second
    turn: float  # rad, by which the first is turned from the second, towards starboard
    coherence: float  # 1 where the first is the second turned and scaled, 0 without any relation


def fit(measured: Complex, true: Complex) -> Fit:
    """Fit ``measured = scale exp(i turn) true`` by least squares, both of shape (k,)."""
    product = complex(np.vdot(true, measured))
    power = float(np.vdot(true, true).real)
    other_power = float(np.vdot(measured, measured).real)
    if not power or not other_power:
        return Fit(0.0, 0.0, 0.0)
    coherence = abs(product) / float(np.sqrt(power * other_power))
    return Fit(abs(product) / power, float(np.angle(product)), coherence)


def dvl_by_velocity(dvl: DvlColumns, reference: ReferenceColumns, config: Config) -> Fit | None:
    """Compare the DVL's horizontal velocity in body axes with the reference's; None where too few rows move."""
    return _horizontal_fit(*velocity_pairs(dvl, reference, config))


def _horizontal_fit(measured_b: Floats, true_b: Floats) -> Fit | None:
    measured = horizontal(measured_b)
    true = horizontal(true_b)
    moving = np.abs(true) > 0.2  # m/s, above a DVL's noise and a lever arm's swing
    if np.count_nonzero(moving) >= ENOUGH:
        return fit(measured[moving], true[moving])
    return None


def velocity_pairs(
    dvl: DvlColumns, reference: ReferenceColumns, config: Config
) -> tuple[Floats, Floats]:
    """Return the velocities of DVL and reference in body axes, (k, 3), at times of the reference that have both."""
    ping_ns, measured_b = velocities_b(dvl, config)
    if len(ping_ns) < ENOUGH:
        return np.empty((0, 3)), np.empty((0, 3))
    complete = reference.known["velocities"] & reference.known["attitudes"]
    rows = np.flatnonzero(complete & lies_within(reference.time_ns, ping_ns))
    after = np.clip(np.searchsorted(ping_ns, reference.time_ns[rows]), 1, len(ping_ns) - 1)
    rows = rows[seconds(ping_ns[after], ping_ns[after - 1]) <= LONGEST_STEP_S]
    true_b = np.einsum("kji,kj->ki", reference.mat_nb[rows], reference.velocity_n[rows])
    at_s = seconds(reference.time_ns[rows], ping_ns[0])
    ping_s = seconds(ping_ns, ping_ns[0])
    columns = [np.interp(at_s, ping_s, column) for column in measured_b.T]
    return np.stack(columns, axis=1), true_b


def velocities_b(dvl: DvlColumns, config: Config) -> tuple[TimeNs, Floats]:
    """Return the velocities in body axes of the pings that have a velocity or all beams."""
    if dvl.velocity_d is not None:
        velocity_d = dvl.velocity_d
    elif dvl.beam_velocity_mps is not None and dvl.beam_vectors_d is not None:
        velocity_d = solve_beams(dvl.beam_velocity_mps, dvl.beam_vectors_d)[0]
        velocity_d[~np.isfinite(dvl.beam_velocity_mps).all(axis=1)] = np.nan
    else:
        raise ValueError("a DVL gives beams with their vectors, or velocities")
    good = np.isfinite(velocity_d).all(axis=1)
    mounting = DvlMounting.from_rpy(
        config.dvl.lever_arm_m, config.dvl.mounting_rpy_deg, config.dvl.scale
    )
    return dvl.time_ns[good], mounting.velocity_b(velocity_d[good])


def measured_mps(dvl: DvlColumns) -> Floats:
    """Return the velocities as they were measured, along the axes or the beams, (m, n)."""
    values = dvl.velocity_d if dvl.velocity_d is not None else dvl.beam_velocity_mps
    if values is None:
        return np.empty((0, 3))
    return values


def median_speed_mps(dvl: DvlColumns) -> float:
    """Return the largest component of a ping in the median, 0 without any."""
    values = measured_mps(dvl)
    if not np.isfinite(values).any():
        return 0.0
    return float(np.median(np.abs(values).max(axis=1, initial=0.0, where=np.isfinite(values))))


def dvl_remarks(
    place: str,
    dvl: DvlColumns,
    reference: ReferenceColumns | None,
    config: Config,
) -> Iterator[Remark]:
    """Check the pings of a DVL."""
    speed_mps = median_speed_mps(dvl)
    values = measured_mps(dvl)
    if speed_mps > FASTEST_MPS:
        yield refusal("dvl_too_fast", place, speed_mps=speed_mps)
    zero = np.flatnonzero((values == 0.0).all(axis=1))
    if zero.size:
        first_s = since_s(dvl.time_ns, zero[0])
        yield note("dvl_zero", int(zero.size), pings=len(values), first_s=first_s)
    names: Sequence[str] = AXES
    if dvl.velocity_d is None:
        names = [f"along beam {number}" for number in range(1, values.shape[1] + 1)]
    for name, column in zip(names, values.T, strict=True):
        given = column[np.isfinite(column)]
        if len(given) >= ENOUGH and np.all(given == given[0]):
            value = given[0] + 0.0  # never a negative zero
            yield note("dvl_constant", len(given), name=name, value=value)
    if reference is not None:
        yield from _velocity_remarks(place, dvl, reference, config)


def _velocity_remarks(
    place: str,
    dvl: DvlColumns,
    reference: ReferenceColumns,
    config: Config,
) -> Iterator[Remark]:
    """Compare the velocity of a DVL with the reference's: its scale, its direction, and its axes."""
    count = len(dvl.time_ns)
    measured_b, true_b = velocity_pairs(dvl, reference, config)
    found = _horizontal_fit(measured_b, true_b)
    opposite = _opposite_axes(measured_b, true_b)
    if found is None or found.coherence < COHERENT:
        if opposite:
            yield note("dvl_axes", count, axes=" and ".join(opposite))
        elif found is not None and found.coherence < INCOHERENT:
            yield note("dvl_contradiction", count, coherence=found.coherence)
        return
    # By less than 10 deg, lever arm and sideslip turn a velocity on average.
    is_turned = abs(found.turn) > 10.0 * DEG
    if is_turned or not opposite:
        yield from scale_remarks(place, found.scale, dvl, config)
    if is_turned:
        roll, pitch, heading = config.dvl.mounting_rpy_deg
        right = float(wrap_angle(np.asarray(heading * DEG - found.turn))) / DEG
        angles = {"roll": roll, "pitch": pitch, "heading": right}
        turned = note("dvl_direction", count, turn_deg=found.turn / DEG, **angles)
        yield Measured(turned)
    elif opposite:
        yield note("dvl_axes", count, axes=" and ".join(opposite))


def _opposite_axes(measured_b: Floats, true_b: Floats) -> list[str]:
    """Name the axes across which velocities, (k, 3), have the opposite sign of others."""
    opposite: list[str] = []
    if len(true_b) < ENOUGH:
        return opposite
    for axis, measured, true in zip(AXES[1:], measured_b.T[1:], true_b.T[1:], strict=True):
        # Below 0.015 m/s a DVL shows its noise. Sound logs have correlations of more than 0.7.
        is_moving = true.std() > 0.015 and measured.std() > 0.0
        if is_moving and np.corrcoef(measured, true)[0, 1] < -0.5:
            opposite.append(axis)
    return opposite


def scale_remarks(
    place: str,
    scale: float,
    dvl: DvlColumns,
    config: Config,
) -> Iterator[Remark]:
    """Warn of the scale of a DVL, and refuse what must be another unit."""
    if not 0.2 < scale < 5.0:
        yield refusal("dvl_unit", place, scale=scale)
    elif abs(scale - 1.0) > LARGEST_SCALE_ERROR:
        setting = scale * config.dvl.scale
        yield Measured(note("dvl_scale", len(dvl.time_ns), scale=scale, setting=setting))


@dataclass(frozen=True)
class TrackFit:
    """How the track of gyros and DVL follows the positions; scales are measured over true."""

    gyro_scale: float | None  # None where the vehicle turned too little to tell
    dvl_scale: float
    # rad, at the start of the replay; None where a pause of the IMU comes before the track
    heading: float | None
    coherence: float
    is_in_radians: bool = False  # the positions fit only if what was read as degrees are radians


def pairs_of_fixes(fix_ns: TimeNs, ping_ns: TimeNs, sample_ns: TimeNs) -> tuple[Rows, Rows]:
    """Return the rows of fixes that are ten seconds apart.

    No pair has a part in a long pause of the pings or of the IMU, where nobody saw how the vehicle moved.
    """
    last = np.searchsorted(fix_ns, fix_ns + 10 * NS_PER_S)
    first = np.flatnonzero(last < len(fix_ns))
    last = last[first]
    longest_ns = nanoseconds(LONGEST_STEP_S)
    paused = in_pauses(fix_ns[first], fix_ns[last], ping_ns, longest_ns)
    paused |= in_pauses(fix_ns[first], fix_ns[last], sample_ns, longest_ns)
    usable = ~paused & (fix_ns[last] - fix_ns[first] < 20 * NS_PER_S)
    return first[usable], last[usable]


def _side_of_pauses(time_ns: TimeNs, sample_ns: TimeNs) -> tuple[int, Mask]:
    """Return on which side of the IMU's long pauses most times lie, counted from 0, and which times these are.

    How far the vehicle turned in a pause is unknown, so that one rotation fits the track of one side alone.
    """
    ends_ns = sample_ns[1:][np.diff(sample_ns) > nanoseconds(LONGEST_STEP_S)]
    side = np.searchsorted(ends_ns, time_ns, "right")
    longest = int(np.bincount(side).argmax())
    return longest, side == longest


def _moved_m(position: Floats, first: Rows, last: Rows) -> Complexes | None:
    """Return by how much pairs of positions, (k, 3), are apart, north and east; None where that may be their noise."""
    if np.abs(position[:, 0]).max() > np.pi / 2.0:
        return None
    north_m, east_m = north_east_m(position, position[0], position[0])
    fixes_m = north_m + 1j * east_m
    moved_m = fixes_m[last] - fixes_m[first]
    if np.sqrt(np.mean(np.abs(moved_m) ** 2)) < LEAST_MOVED_M:
        return None
    return np.asarray(moved_m)


class _Moves(NamedTuple):
    """By how much pairs of fixes, ten seconds apart, are apart, on one side of the pauses of the IMU."""

    fix_ns: TimeNs
    first: Rows  # of the fixes of each pair
    last: Rows
    moved_m: Complexes  # north, and east as the imaginary part
    is_first_side: bool  # before any pause
    is_in_radians: bool


def _moves_of(reference: ReferenceColumns, ping_ns: TimeNs, sample_ns: TimeNs) -> _Moves | None:
    """Return how the reference moves while DVL and IMU measure; None where it does so too little."""
    fixes = np.flatnonzero(np.isfinite(reference.position[:, :2]).all(axis=1))
    if len(ping_ns) < ENOUGH or len(fixes) < ENOUGH:
        return None
    fixes = fixes[lies_within(reference.time_ns[fixes], ping_ns)]
    fix_ns = reference.time_ns[fixes]
    position = reference.position[fixes]
    first, last = pairs_of_fixes(fix_ns, ping_ns, sample_ns)
    if not len(first):
        return None
    side, kept = _side_of_pauses(fix_ns[first], sample_ns)
    first = first[kept]
    last = last[kept]
    if len(first) < ENOUGH:
        return None
    for read, is_in_radians in ((position, False), (position / DEG, True)):
        moved_m = _moved_m(read, first, last)
        if moved_m is not None:
            return _Moves(fix_ns, first, last, moved_m, side == 0, is_in_radians)
    return None


def track_by_positions(
    imu: ImuColumns,
    dvl: DvlColumns,
    reference: ReferenceColumns,
    config: Config,
) -> TrackFit | None:
    """Fit the track of gyros and DVL to positions, by the scale of the gyros at which it follows them best."""
    ping_ns, measured_b = velocities_b(dvl, config)
    moves = _moves_of(reference, ping_ns, imu.time_ns)
    if moves is None:
        return None
    at_s = np.concatenate([[config.span.start_s or 0.0], seconds(ping_ns, imu.time_ns[0])])
    yaw = turned_by(imu, at_s)[:, 2] - config.initial.gyro_bias_degph[2] * DEG_PER_HOUR * at_s
    start_yaw = yaw[0]
    turned = yaw[1:]
    measured = horizontal(measured_b)
    ping_s = seconds(ping_ns, ping_ns[0])
    fix_s = seconds(moves.fix_ns, ping_ns[0])

    def fitted(gyro_scale: float) -> Fit:
        velocity = measured * np.exp(1j * turned / gyro_scale)
        moved_m = np.append(0.0, np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(ping_s)))
        track = np.asarray(np.interp(fix_s, ping_s, moved_m))
        return fit(track[moves.last] - track[moves.first], moves.moved_m)

    turns = float(np.ptp(turned)) > np.pi / 2.0
    gyro_scale = 1.0
    best = fitted(1.0)
    if turns:
        other = max(_SCALES.tolist(), key=lambda scale: fitted(scale).coherence)
        # Another scale has to halve what a scale of 1 leaves unexplained.
        if 1.0 - fitted(other).coherence < (1.0 - best.coherence) / 2.0:
            gyro_scale = other
            best = fitted(other)
    is_alike = best.coherence >= COHERENT and abs(best.scale - 1.0) <= LARGEST_SCALE_ERROR
    if moves.is_in_radians and not is_alike:
        return None  # the fixes stay where they are
    heading = None
    if moves.is_first_side:
        heading = float(wrap_angle(np.asarray(start_yaw / gyro_scale - best.turn)))
    return TrackFit(
        gyro_scale if turns else None, best.scale, heading, best.coherence, moves.is_in_radians
    )
