"""How uncertain a start is, by the source that it comes from.

A reference may state its standard deviations, in ``[reference]`` or in its messages. Otherwise they are estimated
over the first minutes from what other sensors show:

- attitude: its scatter about the integrated gyros, without a straight line in time. It contains the noise of single
  rows and everything that changes within minutes. The gyros' bias, scale factors and axes are fitted first.
- heading: also the angle between the reference's velocity and the DVL's, if the reference is independent of the DVL.
- velocity: the scatter of its third differences, which is noise, and the mean differences to the DVL over ten pings.
- position: the scatter of its third differences.

An error that stays constant over these minutes is invisible, apart from that angle. The floors below stand for it.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.core.config import Config, Reference
from insdvl_replay.core.dive_columns import (
    Dive,
    Floats,
    ImuColumns,
    ReferenceColumns,
    TimeNs,
    apart_s,
    nanoseconds,
    nothing,
    seconds,
)
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.earth import earth_rate_n
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import mat_from_vector, vector_from_mat
from insdvl_replay.nav.dvl import DvlVelocities

# of the dive around the start, in which errors of a source are looked for
STRETCH_S: Final = 300.0
FEWEST_ROWS: Final = 20  # with fewer, nothing is estimated
LONGEST_STEP_S: Final = 5.0  # over longer steps the gyros say nothing about single attitudes
UNEVEN: Final = 0.2  # share by which steps may differ where differences of neighbours are taken
BLOCK: Final = 10  # pings in a mean, in which the noise of the DVL is small
FEWEST_BLOCKS: Final = 3
SLOWEST_MPS: Final = 0.3  # slower velocities have no direction
GYRO_AXES_SD: Final = 0.01  # scale factors and axes of gyros, of which most are better
NORMAL: Final = 1.4826  # standard deviation over median absolute deviation, of normal numbers
# of four values at even steps, the noise that no motion explains
THIRD: Final = np.array([-1.0, 3.0, -3.0, 1.0])

# What a source may err by without anything that shows it.
LEVEL_FLOOR: Final = 0.02 * DEG
HEADING_FLOOR: Final = 0.05 * DEG
VELOCITY_FLOOR_MPS: Final = 0.002
POSITION_FLOOR_M: Final = 0.1
ATTITUDE_FLOOR: Final = np.array([LEVEL_FLOOR, LEVEL_FLOOR, HEADING_FLOOR])
# Larger stated values stand for "unknown".
LARGEST_ATTITUDE: Final = 30.0 * DEG
LARGEST_VELOCITY_MPS: Final = 10.0
LARGEST_POSITION_M: Final = 1000.0
UNKNOWN: Final = np.full(3, np.nan)


@dataclass(frozen=True)
class SourceSd:
    """Standard deviations of a source in n, each (3,); NaN where nothing is known."""

    attitude: Floats  # rad, about north, east and down
    velocity: Floats  # m/s
    position: Floats  # m, north, east and down


def reference_sd(
    dive: Dive,
    config: Config,
    velocities: DvlVelocities,
    start_ns: int,
    latitude: float,
) -> SourceSd:
    """Return the standard deviations of the reference at the start: stated, else estimated.

    A stated value counts unless single rows scatter by more.
    """
    reference = dive.reference
    assert reference is not None
    rows = reference.within(start_ns - nanoseconds(STRETCH_S), start_ns + nanoseconds(STRETCH_S))
    stated = stated_sd(reference, config.reference, start_ns)
    velocity_white = third_difference_sd(rows.time_ns, rows.velocity_n)
    velocity_slow = np.zeros(3)
    attitude = attitude_scatter(dive.imu, rows, latitude, config.noise.gyro_white_rad_rts)
    attitude_white = UNKNOWN
    attitude_sd = UNKNOWN
    if attitude is not None:
        attitude_white = attitude.white
        attitude_sd = np.maximum(attitude.sd, ATTITUDE_FLOOR)
        pair = velocity_pair(
            dive.imu, rows, attitude, velocities, np.array(config.dvl.lever_arm_m), latitude
        )
        velocity_slow = slow_difference_sd(pair)
        if config.reference.independent:
            attitude_sd[2] = np.hypot(attitude_sd[2], direction_difference(pair))
    velocity_sd = np.maximum(np.hypot(velocity_white, velocity_slow), VELOCITY_FLOOR_MPS)
    position_white = third_difference_sd(rows.time_ns, _moved_m(rows))
    position_sd = np.maximum(position_white, POSITION_FLOOR_M)
    return SourceSd(
        attitude=_stated_or(stated.attitude, attitude_white, attitude_sd),
        velocity=_stated_or(stated.velocity, velocity_white, velocity_sd),
        position=_stated_or(stated.position, position_white, position_sd),
    )


def ahrs_sd(
    dive: Dive,
    config: Config,
    start_ns: int,
    latitude: float,
) -> Floats:
    """Return the standard deviations of the AHRS's attitude at the start, (3,), rad, about north, east and down.

    They are those of its messages, else of ``[heading]``; more if the gyros show it.
    """
    sensor = dive.sensors["heading"]
    settings = config.heading
    assert sensor.mat_nb is not None
    scatter = None
    around = sensor.within(start_ns - nanoseconds(STRETCH_S), start_ns + nanoseconds(STRETCH_S))
    if around.mat_nb is not None:
        missing = nothing((len(around.time_ns), 3))
        rows = ReferenceColumns(around.time_ns, missing, missing, around.mat_nb)
        scatter = attitude_scatter(dive.imu, rows, latitude, config.noise.gyro_white_rad_rts)
    stated = UNKNOWN
    if sensor.attitude_sd is not None:
        nearest = int(np.argmin(np.abs(sensor.time_ns - start_ns)))
        north, east, down = sensor.attitude_sd[nearest]
        level = np.sqrt(0.5 * (north**2 + east**2))  # its axes may be those of the body
        stated = np.array([level, level, down])
        stated = np.where(stated < LARGEST_ATTITUDE, stated, np.nan)
    by_settings = np.array([settings.level_sd_deg, settings.level_sd_deg, settings.sd_deg]) * DEG
    if scatter is None:
        return np.where(np.isfinite(stated), stated, by_settings)
    return _stated_or(stated, scatter.white, np.maximum(by_settings, scatter.sd))


def _stated_or(stated: Floats, white: Floats, estimated: Floats) -> Floats:
    """Return stated values where there are some, but at least the noise of single rows."""
    return np.where(np.isfinite(stated), np.fmax(stated, white), estimated)


def stated_sd(reference: ReferenceColumns, settings: Reference, start_ns: int) -> SourceSd:
    """Return what the settings, else the messages of a reference say of its error at the start."""
    values = {"velocity": UNKNOWN, "attitude": UNKNOWN, "position": UNKNOWN}
    if reference.stated is not None:
        nearest = np.argmin(np.abs(reference.stated.time_ns - start_ns))
        sd = np.sqrt(np.diagonal(reference.stated.cov[nearest]))
        values = {"velocity": sd[:3], "attitude": sd[3:6], "position": sd[6:]}
    limits = {
        "velocity": LARGEST_VELOCITY_MPS,
        "attitude": LARGEST_ATTITUDE,
        "position": LARGEST_POSITION_M,
    }
    in_settings = {
        "velocity": settings.velocity_sd_mps,
        "attitude": settings.attitude_sd_deg * DEG,
        "position": settings.position_sd_m,
    }
    for name, limit in limits.items():
        values[name] = np.where(values[name] < limit, values[name], np.nan)
        if in_settings[name] > 0.0:
            values[name] = np.full(3, in_settings[name])
    return SourceSd(**values)


# --- Attitude, by the gyros.


class Turns:
    """The turns that the gyros measure between times, to second order (Bortz, 1971)."""

    def __init__(
        self,
        imu: ImuColumns,
        first_ns: int,
        last_ns: int,
    ) -> None:
        first = max(0, int(np.searchsorted(imu.time_ns, first_ns, side="right")) - 1)
        last = int(np.searchsorted(imu.time_ns, last_ns)) + 1
        self._origin_ns = first_ns
        self._time_s = seconds(imu.time_ns[first:last], first_ns)
        rate = imu.angular_rate_b[first:last]
        step = 0.5 * (rate[1:] + rate[:-1]) * np.diff(self._time_s)[:, None]
        self._turn = np.zeros_like(rate)
        np.cumsum(step, axis=0, out=self._turn[1:])
        # The integral of the turn so far times its change.
        self._swing = np.zeros_like(rate)
        np.cumsum(
            np.cross(0.5 * (self._turn[1:] + self._turn[:-1]), step), axis=0, out=self._swing[1:]
        )

    def between(self, start_ns: TimeNs, end_ns: TimeNs) -> Floats:
        """Return rotation vectors from body axes at the start to those at the end of spans, (k, 3), rad."""
        turn, swing = self._at(start_ns)
        end_turn, end_swing = self._at(end_ns)
        change = end_turn - turn
        return np.asarray(change + 0.5 * (end_swing - swing - np.cross(turn, change)))

    def _at(self, time_ns: TimeNs) -> tuple[Floats, Floats]:
        at_s = seconds(time_ns, self._origin_ns)
        turn = _interpolated(at_s, self._time_s, self._turn)
        swing = _interpolated(at_s, self._time_s, self._swing)
        return turn, swing


@dataclass(frozen=True)
class AttitudeScatter:
    """How attitudes scatter about the integrated gyros."""

    time_ns: TimeNs  # (k,) of the attitudes
    mat_nb: Floats  # (k, 3, 3), without the scatter
    turns: Turns
    white: Floats  # (3,) rad, noise of single rows, about north, east and down
    sd: Floats  # (3,) rad, all that changes within the stretch


def attitude_scatter(
    imu: ImuColumns,
    rows: ReferenceColumns,
    latitude: float,
    gyro_white_rad_rts: float,  # the gyros' own random walk is not the reference's error
) -> AttitudeScatter | None:
    """Compare attitudes with the integrated gyros; None with fewer than `FEWEST_ROWS` of them."""
    inside = (
        rows.known["attitudes"]
        & (rows.time_ns >= imu.time_ns[0])
        & (rows.time_ns <= imu.time_ns[-1])
    )
    time_ns = rows.time_ns[inside]
    mat_nb = rows.mat_nb[inside]
    if len(time_ns) < FEWEST_ROWS:
        return None
    turns = Turns(imu, int(time_ns[0]), int(time_ns[-1]))
    step_s = np.diff(time_ns) * 1e-9
    turned_b = turns.between(time_ns[:-1], time_ns[1:])
    # The rest of each step: bias, scale and axes of the gyros, and changes of the reference's error.
    rest_b = vector_from_mat(
        mat_from_vector(-turned_b) @ np.swapaxes(mat_nb[:-1], 1, 2) @ mat_nb[1:]
    )
    rest_b += step_s[:, None] * (earth_rate_n(latitude) @ mat_nb[:-1])
    seen = step_s <= LONGEST_STEP_S
    if np.count_nonzero(seen) < FEWEST_ROWS - 1:
        return None
    rest_b -= _gyro_errors(step_s, turned_b, rest_b, seen)
    rest_b[~seen] = 0.0
    error = np.zeros((len(time_ns), 3))
    np.cumsum(np.einsum("kij,kj->ki", mat_nb[:-1], rest_b), axis=0, out=error[1:])
    time_s = seconds(time_ns, int(time_ns[0]))
    error -= _line(time_s, error)
    white = NORMAL * np.median(np.abs(np.diff(error, axis=0)[seen]), axis=0) / np.sqrt(2.0)
    # What is left of a random walk without its line is a fifteenth of its variance at the end.
    by_gyros = gyro_white_rad_rts**2 * time_s[-1] / 15.0
    whole = (NORMAL * np.median(np.abs(error), axis=0)) ** 2
    sd = np.sqrt(np.maximum(whole - by_gyros, white**2))
    return AttitudeScatter(time_ns, mat_from_vector(-error) @ mat_nb, turns, white, sd)


def _gyro_errors(
    step_s: Floats,
    turned_b: Floats,
    rest_b: Floats,
    seen: Floats,
) -> Floats:
    """Return the part of each step, (k, 3), that a bias, scale factors and axes of the gyros explain."""
    causes = np.column_stack([step_s, turned_b])
    known = causes[seen]
    effect = rest_b[seen]
    scatter = (NORMAL * np.median(np.abs(effect - np.median(effect, axis=0)))) ** 2 + 1e-16
    information = known.T @ known / scatter
    information[1:, 1:] += np.eye(3) / GYRO_AXES_SD**2
    information[0, 0] += 1e-9
    return np.asarray(causes @ np.linalg.solve(information, known.T @ effect / scatter))


def _line(time_s: Floats, values: Floats) -> Floats:
    """Return the straight line through columns of values, (k, n)."""
    design = np.column_stack([np.ones(len(time_s)), time_s])
    return np.asarray(design @ np.linalg.lstsq(design, values, rcond=None)[0])


# --- Velocity and position.


def third_difference_sd(time_ns: TimeNs, values: Floats) -> Floats:
    """Return the noise of rows of values, (k, 3), by differences that no smooth motion has; NaN with too few."""
    found = np.full(3, np.nan)
    for axis in range(3):
        known = np.isfinite(values[:, axis])
        step_s = np.diff(time_ns[known]) * 1e-9
        column = values[known, axis]
        if len(column) < FEWEST_ROWS:
            continue
        even = np.abs(step_s - np.median(step_s)) <= UNEVEN * np.median(step_s)
        differences = np.convolve(column, THIRD[::-1], mode="valid")
        differences = differences[even[2:] & even[1:-1] & even[:-2]]
        if len(differences) >= FEWEST_ROWS:
            found[axis] = NORMAL * np.median(np.abs(differences)) / np.linalg.norm(THIRD)
    return found


def _moved_m(rows: ReferenceColumns) -> Floats:
    """Return positions as metres north, east and down of the first one, (k, 3)."""
    first = np.flatnonzero(rows.known["positions"])
    if not len(first):
        return np.full_like(rows.position, np.nan)
    origin = np.nan_to_num(rows.position[first[0]])
    return north_east_down_m(rows.position, origin)


@dataclass(frozen=True)
class VelocityPair:
    """Velocities of the IMU over ground in n by a reference and by the DVL, (m, 3) each, m/s."""

    reference_n: Floats
    dvl_n: Floats  # turned by the reference's attitude without its scatter


def velocity_pair(
    imu: ImuColumns,
    rows: ReferenceColumns,
    attitude: AttitudeScatter,
    velocities: DvlVelocities,
    arm_b: Floats,  # (3,) IMU to DVL, m
    latitude: float,
) -> VelocityPair:
    """Return the velocities of the reference, between its rows, and of the DVL at the pings that both cover."""
    known = rows.rows(rows.known["velocities"])
    if len(known.time_ns) < FEWEST_ROWS:
        return VelocityPair(np.empty((0, 3)), np.empty((0, 3)))
    first_ns = max(int(known.time_ns[0]), int(attitude.time_ns[0]))
    last_ns = min(int(known.time_ns[-1]), int(attitude.time_ns[-1]))
    pings = velocities.within(first_ns, last_ns)
    before = np.searchsorted(attitude.time_ns, pings.time_ns, side="right") - 1
    turn_b = attitude.turns.between(attitude.time_ns[before], pings.time_ns)
    mat_nb = attitude.mat_nb[before] @ mat_from_vector(turn_b)
    rate_ib_b = _at(pings.time_ns, imu.time_ns, imu.angular_rate_b)
    rate_eb_b = rate_ib_b - earth_rate_n(latitude) @ mat_nb
    velocity_b = pings.velocity_b - np.cross(rate_eb_b, arm_b)
    dvl_n = np.einsum("kij,kj->ki", mat_nb, velocity_b)
    # Not across pauses of the reference.
    near = apart_s(known.time_ns, known.velocity_n, pings.time_ns) <= LONGEST_STEP_S
    return VelocityPair(_at(pings.time_ns, known.time_ns, known.velocity_n)[near], dvl_n[near])


def _at(at_ns: TimeNs, time_ns: TimeNs, values: Floats) -> Floats:
    """Interpolate columns, (k, n), at times inside them."""
    at_s = seconds(at_ns, int(time_ns[0]))
    time_s = seconds(time_ns, int(time_ns[0]))
    return _interpolated(at_s, time_s, values)


def _interpolated(at_s: Floats, time_s: Floats, values: Floats) -> Floats:
    return np.column_stack([np.interp(at_s, time_s, column) for column in values.T])


def slow_difference_sd(pair: VelocityPair) -> Floats:
    """Return the part of the difference of two velocities that means over ten pings do not remove, (3,), m/s."""
    difference = pair.reference_n - pair.dvl_n
    blocks = len(difference) // BLOCK
    if blocks < FEWEST_BLOCKS:
        return np.zeros(3)
    in_blocks = difference[: blocks * BLOCK].reshape(blocks, BLOCK, 3)
    means = in_blocks.mean(axis=1)
    noise = np.median(in_blocks.var(axis=1, ddof=1), axis=0) / BLOCK
    slow = (NORMAL * np.median(np.abs(means), axis=0)) ** 2
    return np.asarray(np.sqrt(np.maximum(slow - noise, 0.0)))


def direction_difference(pair: VelocityPair) -> float:
    """Return the angle between two horizontal velocities, rad, as far as it is beyond its scatter."""
    ours = pair.reference_n[:, 0] + 1j * pair.reference_n[:, 1]
    dvls = pair.dvl_n[:, 0] + 1j * pair.dvl_n[:, 1]
    moving = np.minimum(np.abs(ours), np.abs(dvls)) > SLOWEST_MPS
    if np.count_nonzero(moving) < FEWEST_ROWS:
        return 0.0
    angle = np.angle(ours[moving] / dvls[moving])
    middle = float(np.median(angle))
    scatter = NORMAL * float(np.median(np.abs(angle - middle)))
    # Neighbours err alike, so that one ping of ten counts.
    return float(np.sqrt(max(0.0, middle**2 - BLOCK * scatter**2 / len(angle))))
