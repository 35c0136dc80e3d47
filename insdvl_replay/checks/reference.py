"""Checks of a reference, and of gyros and DVL against it; all checks together.

Where a reference has positions alone, they are compared with the track that gyros and DVL make together.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from insdvl_replay.checks.dvl import (
    COHERENT,
    INCOHERENT,
    LARGEST_SCALE_ERROR,
    TrackFit,
    dvl_remarks,
    median_speed_mps,
    scale_remarks,
    track_by_positions,
    velocities_b,
)
from insdvl_replay.checks.imu import (
    AXES,
    ENOUGH,
    LONGEST_STEP_S,
    AttitudeFit,
    gyro_by_attitude,
    gyro_by_gravity,
    imu_remarks,
    lies_within,
    since_s,
    turn_to_reference,
    turned_by,
)
from insdvl_replay.checks.sentences import (
    Measured,
    Remark,
    ignore_hint,
    refusal,
    refused,
    without_mark,
)
from insdvl_replay.core.config import Config, Imu
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    DvlColumns,
    Floats,
    ImuColumns,
    Integers,
    Mask,
    ReferenceColumns,
    TimeNs,
    find_runs,
    in_pauses,
    nanoseconds,
    seconds,
)
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.notes import note
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import (
    AROUND,
    Complex,
    Steps,
    find_jumps,
    horizontal,
    least_difference,
    steps_of,
    unexplained_m,
)
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat, vector_from_mat, wrap_angle

# Factor of the angular rate at which it is another unit: deg/s are 57 times rad/s.
UNIT_WRONG: Final = 5.0
_UNDER_WAY_MPS: Final = 0.1  # beyond the noise of a DVL
_TURNED_RAD: Final = 5.0 * DEG  # beyond the gyros' bias and Earth's rate in a minute
_PINGS_LATE: Final = 3  # by which a velocity of the DVL is reported late by another topic
_MOVING_MPS: Final = 0.05
_SAME_MPS: Final = 2e-5  # single precision, and digits that are rounded
_SAME_SHARE: Final = 0.5
# Share by which the gyros may differ from a track, whose DVL and positions err too.
LARGEST_TRACK_ERROR: Final = 0.15


@dataclass(frozen=True)
class GyroScale:
    """How the gyros compare with another source: measured over true, and the factor up to which it is in order."""

    scale: float
    by: str
    tolerance: float
    by_reference: bool = True

    @property
    def off(self) -> float:
        """Factor by which the scale is off, 1 or more; infinite where the sign is wrong."""
        if self.scale > 0.0:
            return max(self.scale, 1.0 / self.scale)
        return np.inf


def plausibility_remarks(
    place: str,
    imu: ImuColumns,
    dvl: DvlColumns,
    reference: ReferenceColumns | None,
    config: Config,
) -> Iterator[Remark]:
    """Check IMU, DVL and reference; the place is the file in messages to the user."""
    by_attitude, track = _comparisons(imu, dvl, reference, config)
    yield from imu_remarks(place, imu, reference, config.imu)
    turn = _turn_that_follows(imu, reference, by_attitude)
    if turn is None:
        scale = _best_scale(imu, by_attitude, track)
        yield from _gyro_remarks(place, imu, by_attitude, scale, config.imu)
    else:
        turn = turn @ mat_from_rpy(np.array(config.imu.mounting_rpy_deg) * DEG)
        roll, pitch, heading = (rpy_from_mat(turn) / DEG + 0.0).tolist()
        count = len(imu.time_ns)
        yield Measured(note("imu_turned", count, roll=roll, pitch=pitch, heading=heading))
    yield from dvl_remarks(place, dvl, reference, config)
    if reference is not None:
        yield from reference_notes(imu, dvl, reference)
    if track is not None:
        yield from _track_remarks(place, track, dvl, config)


def plausibility_notes(
    place: str,
    imu: ImuColumns,
    dvl: DvlColumns,
    reference: ReferenceColumns | None,
    config: Config,
) -> tuple[Note, ...]:
    """Run all checks; raise the first error."""
    notes = []
    for remark in plausibility_remarks(place, imu, dvl, reference, config):
        said = without_mark(remark)
        if isinstance(said, LogError):
            raise said
        notes.append(said)
    return tuple(notes)


def gyro_scale(
    imu: ImuColumns,
    dvl: DvlColumns,
    reference: ReferenceColumns | None,
    config: Config,
) -> GyroScale | None:
    """Compare the gyros with the best source of their scale; None where the vehicle moved too little."""
    return _best_scale(imu, *_comparisons(imu, dvl, reference, config))


def _comparisons(
    imu: ImuColumns,
    dvl: DvlColumns,
    reference: ReferenceColumns | None,
    config: Config,
) -> tuple[AttitudeFit | None, TrackFit | None]:
    if reference is None:
        return None, None
    complete = reference.has_attitude and reference.has_velocity
    track = None if complete else track_by_positions(imu, dvl, reference, config)
    return gyro_by_attitude(imu, reference), track


def _best_scale(
    imu: ImuColumns, by_attitude: AttitudeFit | None, track: TrackFit | None
) -> GyroScale | None:
    if by_attitude is not None and abs(by_attitude.correlation) > COHERENT:
        return GyroScale(by_attitude.scale, "the reference's attitude", 1.0 + LARGEST_SCALE_ERROR)
    if track is not None and track.gyro_scale is not None and track.coherence > COHERENT:
        by = "the DVL's track and the reference's positions"
        return GyroScale(track.gyro_scale, by, 1.0 + LARGEST_TRACK_ERROR)
    # In a moving vehicle, the direction of gravity swings with its own acceleration.
    by_gravity = gyro_by_gravity(imu)
    if by_gravity is not None:
        return GyroScale(by_gravity, "gravity's change of direction", 1.7, by_reference=False)
    return None


def _turn_that_follows(
    imu: ImuColumns, reference: ReferenceColumns | None, found: AttitudeFit | None
) -> Floats | None:
    """Return the constant rotation with which gyros follow a reference that they do not follow without it, (3, 3)."""
    if reference is None or found is None or abs(found.correlation) >= INCOHERENT:
        return None
    turn = turn_to_reference(imu, reference)
    if turn is None:
        return None
    turned = ImuColumns(imu.time_ns, imu.specific_force_b @ turn.T, imu.angular_rate_b @ turn.T)
    again = gyro_by_attitude(turned, reference)
    if again is not None and again.correlation >= COHERENT:
        return turn
    return None


def _gyro_remarks(
    place: str,
    imu: ImuColumns,
    by_attitude: AttitudeFit | None,
    found: GyroScale | None,
    settings: Imu,
) -> Iterator[Remark]:
    count = len(imu.time_ns)
    if found is not None and found.off >= found.tolerance:
        shown = {
            "scale": found.scale,
            "by": found.by,
            "ignore": ignore_hint(by_reference=found.by_reference),
        }
        unit = "deg/s" if found.scale > 1.0 else "rad/s"
        if found.scale < 0.0:
            yield note("imu_gyro_sign", count, **shown)
        elif found.off > UNIT_WRONG and unit != (settings.angular_rate_unit or "rad/s"):
            yield refusal("imu_gyro_unit", place, unit=unit, **shown)
        else:
            shown["setting"] = found.scale * settings.angular_rate_scale
            said = note("imu_gyro_scale", count, **shown)
            if found.off > UNIT_WRONG:
                yield Measured(refused(said, place))
            else:
                yield Measured(said)
    # Attitudes that swing less say nothing.
    if by_attitude is None or by_attitude.excursion.max() < 3.0 * DEG:
        return
    known = by_attitude.excursion >= 3.0 * DEG
    if abs(by_attitude.correlation) < INCOHERENT:
        yield note("imu_gyro_contradiction", count, correlation=by_attitude.correlation)
    elif np.any(known & (by_attitude.by_axis > 0.7)):
        # Axes that turn the other way while another one follows.
        for axis in np.flatnonzero(known & (by_attitude.by_axis < -0.7)).tolist():
            correlation = by_attitude.by_axis[axis]
            yield note("imu_gyro_axis", count, axis=AXES[axis], correlation=correlation)


def _track_remarks(
    place: str,
    track: TrackFit,
    dvl: DvlColumns,
    config: Config,
) -> Iterator[Remark]:
    if track.is_in_radians:
        yield refusal("reference_in_radians", place)
        return
    if track.coherence < INCOHERENT:
        yield note("track_contradiction", len(dvl.time_ns), coherence=track.coherence)
    if track.coherence < COHERENT:
        return
    yield from scale_remarks(place, track.dvl_scale, dvl, config)
    heading_deg = config.initial.heading_deg
    if track.heading is None or not isinstance(heading_deg, float | int):
        return
    # Gyro bias turns a track by less during a dive.
    if abs(float(wrap_angle(np.asarray(heading_deg * DEG - track.heading)))) > 30.0 * DEG:
        fitted_deg = track.heading / DEG
        both = {"fitted_deg": fitted_deg, "heading_deg": heading_deg}
        yield Measured(note("dvl_direction by_positions", len(dvl.time_ns), **both))


def reference_notes(
    imu: ImuColumns, dvl: DvlColumns, reference: ReferenceColumns
) -> Iterator[Note]:
    """Check a reference."""
    yield from _constant_notes(imu, dvl, reference)
    yield from _scale_notes(reference)
    # Steps of the positions that neither the velocity nor any of the steps around explains.
    steps = steps_of(reference)
    yield from _jump_notes("positions", unexplained_m(steps), 2.0, "m", 1.0, steps.time_s)
    # Turns that the gyros do not show. An error of the gyros is in the steps around, too, and is smaller than they are.
    rows = np.flatnonzero(
        reference.known["attitudes"] & lies_within(reference.time_ns, imu.time_ns)
    )
    if len(rows) <= 2 * AROUND + 1:
        return
    time_s = seconds(reference.time_ns[rows], imu.time_ns[0])
    mat_nb = reference.mat_nb[rows]
    shown = np.diff(turned_by(imu, time_s), axis=0)
    unseen = vector_from_mat(np.swapaxes(mat_nb[:-1], 1, 2) @ mat_nb[1:]) - shown
    unlike = np.fmin(np.linalg.norm(unseen, axis=1), least_difference(unseen))
    # In longer steps a turning vehicle turns unlike in the ones around.
    unlike[np.diff(time_s) > 1.5] = np.nan
    ends_ns = reference.time_ns[rows]
    unlike[in_pauses(ends_ns[:-1], ends_ns[1:], imu.time_ns, nanoseconds(LONGEST_STEP_S))] = np.nan
    smallest = np.maximum(5.0 * DEG, np.linalg.norm(shown, axis=1))
    yield from _jump_notes("attitudes", unlike, smallest, "deg", DEG, time_s - time_s[0])


def says_anything(reference: ReferenceColumns) -> bool:
    """Return whether it gives an attitude, a position, or a velocity that is not always zero."""
    return (
        reference.has_attitude
        or reference.has_position
        or bool(np.nan_to_num(reference.velocity_n).any())
    )


def without_frozen(
    imu: ImuColumns, dvl: DvlColumns, reference: ReferenceColumns
) -> tuple[ReferenceColumns, tuple[Note, ...]]:
    """Return a reference without positions and attitudes that stay the same while the vehicle moves, and notes of them.

    A receiver under water goes on with its last fix. The first row of a run stays. A reference that never changes is
    told by another note.
    """
    ping_ns, velocity_b = velocities_b(dvl, Config())
    speed_mps = np.abs(horizontal(velocity_b))

    def moves(start_ns: int, end_ns: int) -> bool:
        first = np.searchsorted(ping_ns, start_ns)
        behind = np.searchsorted(ping_ns, end_ns, "right")
        inside = speed_mps[first:behind]
        return len(inside) > 1 and float(np.median(inside)) > _UNDER_WAY_MPS

    def turns(start_ns: int, end_ns: int) -> bool:
        from_s = (start_ns - int(imu.time_ns[0])) / NS_PER_S
        at_s = np.linspace(from_s, from_s + (end_ns - start_ns) / NS_PER_S, ENOUGH)
        return bool(np.ptp(turned_by(imu, at_s, LONGEST_STEP_S), axis=0).max() > _TURNED_RAD)

    notes = []
    frozen = _frozen_rows(reference.time_ns, reference.position[:, :2], moves)
    if frozen.any():
        doing = "the DVL measures a velocity"
        notes.append(_frozen_note(reference.time_ns, frozen, quantity="position", doing=doing))
        reference = replace(reference, position=_without_rows(reference.position, frozen))
    frozen = _frozen_rows(reference.time_ns, reference.mat_nb.reshape(-1, 9), turns)
    if frozen.any():
        doing = "the gyros measure a turn"
        notes.append(_frozen_note(reference.time_ns, frozen, quantity="attitude", doing=doing))
        reference = replace(reference, mat_nb=_without_rows(reference.mat_nb, frozen))
    return reference, tuple(notes)


def _frozen_note(
    time_ns: TimeNs,
    frozen: Mask,
    *,
    quantity: str,
    doing: str,
) -> Note:
    """Note the rows of a quantity that stay the same."""
    starts, ends = find_runs(frozen)
    longest_s = float(seconds(time_ns[ends - 1], time_ns[starts - 1]).max())
    spans = {"first_s": since_s(time_ns, int(starts[0])), "longest_s": longest_s}
    count = int(frozen.sum())
    return note("reference_frozen", count, quantity=quantity, doing=doing, **spans)


def _without_rows(values: Floats, rows: Mask) -> Floats:
    kept = values.copy()
    kept[rows] = np.nan
    return kept


def _frozen_rows(time_ns: TimeNs, rows: Floats, is_moving: Callable[[int, int], bool]) -> Mask:
    """Return which rows repeat the one before, shape (k,), for long while the vehicle moves."""
    frozen = np.zeros(len(rows), np.bool_)
    known = np.flatnonzero(np.isfinite(rows).all(axis=1))
    again = np.zeros(len(known), np.bool_)
    again[1:] = (rows[known[1:]] == rows[known[:-1]]).all(axis=1)
    if np.count_nonzero(again) >= len(known) - 1:
        return frozen
    starts, ends = find_runs(again)
    from_ns = time_ns[known[starts - 1]]
    to_ns = time_ns[known[ends - 1]]
    for run in np.flatnonzero(seconds(to_ns, from_ns) > LONGEST_STEP_S).tolist():
        if is_moving(int(from_ns[run]), int(to_ns[run])):
            frozen[known[starts[run] : ends[run]]] = True
    return frozen


def is_of_dvl(reference: ReferenceColumns, dvl: DvlColumns) -> bool:
    """Return whether the velocities of a reference are those of a DVL, in whatever axes, as in its dead reckoning.

    Another source is never as fast to the last digits, ping by ping.
    """
    if dvl.velocity_d is None or not len(dvl.time_ns):
        return False
    known = reference.known["velocities"] & lies_within(reference.time_ns, dvl.time_ns)
    speeds_mps = np.linalg.norm(reference.velocity_n[known], axis=1)
    pings_mps = np.linalg.norm(dvl.velocity_d, axis=1)
    ping = np.searchsorted(dvl.time_ns, reference.time_ns[known])
    least_mps = np.full(len(speeds_mps), np.inf)
    for offset in range(-_PINGS_LATE, _PINGS_LATE + 1):
        row = np.clip(ping + offset, 0, len(pings_mps) - 1)
        least_mps = np.fmin(least_mps, np.abs(pings_mps[row] - speeds_mps))
    moving = speeds_mps > _MOVING_MPS
    same = moving & (least_mps < _SAME_MPS)
    return bool(
        np.count_nonzero(moving) >= ENOUGH
        and np.count_nonzero(same) > _SAME_SHARE * np.count_nonzero(moving)
    )


def _constant_notes(
    imu: ImuColumns, dvl: DvlColumns, reference: ReferenceColumns
) -> Iterator[Note]:
    found = []
    if median_speed_mps(dvl) > 0.1:  # beyond its noise
        doing = "the DVL measures a velocity"
        if _is_constant(reference.position[:, :2]):
            found.append(("position", doing))
        # A velocity may be constant, but not zero.
        velocities = reference.velocity_n[reference.known["velocities"]]
        if len(velocities) and not velocities.any():
            found.append(("velocity", doing))
    if _is_constant(reference.mat_nb.reshape(-1, 9)):
        turned = turned_by(imu, seconds(imu.time_ns, imu.time_ns[0]), LONGEST_STEP_S)
        if np.ptp(turned, axis=0).max() > 30.0 * DEG:  # beyond the gyros' bias and Earth's rate
            found.append(("attitude", "the gyros measure turns"))
    for quantity, doing in found:
        yield note("reference_constant", len(reference.time_ns), quantity=quantity, doing=doing)


def _is_constant(rows: Floats) -> bool:
    given = rows[np.isfinite(rows).all(axis=1)]
    return len(given) >= ENOUGH and bool((given == given[0]).all())


def legs_m(steps: Steps) -> tuple[Complex, Complex]:
    """Sum steps by positions and by velocity to legs of ten seconds, of which those that are whole are returned.

    Over such a leg, single positions of a receiver are good enough for a direction.
    """
    if not len(steps.time_s):
        return steps.by_position_m, steps.by_velocity_m
    # Each leg begins with the first row at or behind a multiple of its length, of which the last row ends one.
    legs = np.floor(steps.time_s / 10.0)
    legs[-1] = np.ceil(steps.time_s[-1] / 10.0) - 1.0
    rows = np.append(0, np.flatnonzero(np.diff(legs) > 0.0) + 1)
    by_position_m = _sums_between(rows, steps.by_position_m)
    by_velocity_m = _sums_between(rows, np.nan_to_num(steps.by_velocity_m))
    unknown = np.diff(np.append(0, np.cumsum(~np.isfinite(steps.by_velocity_m)))[rows])
    whole = (unknown == 0) & (np.diff(steps.time_s[rows]) < 20.0)
    return by_position_m[whole], by_velocity_m[whole]


def _sums_between(rows: Integers, moved_m: Complex) -> Complex:
    """Sum steps between rows."""
    return np.asarray(np.diff(np.append(0.0, np.cumsum(moved_m))[rows]))


def velocity_misfit(reference: ReferenceColumns) -> float | None:
    """Return the share of the distance by which velocity and positions differ over legs; None if undetermined."""
    by_position_m, by_velocity_m = legs_m(steps_of(reference))
    if len(by_position_m) < 4 or np.abs(by_position_m).sum() < 20.0:
        return None
    apart_m = float(np.linalg.norm(by_velocity_m - by_position_m))
    return apart_m / float(np.linalg.norm(by_position_m))


def _scale_notes(reference: ReferenceColumns) -> Iterator[Note]:
    """Compare displacements by positions with those by velocity, over legs."""
    by_position_m, by_velocity_m = legs_m(steps_of(reference))
    shorter_m = min(np.abs(by_position_m).sum(), np.abs(by_velocity_m).sum())
    if len(by_position_m) < 4 or shorter_m < 20.0:
        return
    power = float(np.vdot(by_velocity_m, by_velocity_m).real)
    product = np.vdot(by_velocity_m, by_position_m).real
    coherence = float(product / (np.sqrt(power) * np.linalg.norm(by_position_m)))
    if coherence < 0.8:
        count = int(np.count_nonzero(reference.known["positions"] & reference.known["velocities"]))
        yield note("reference_contradiction", count, coherence=coherence)
        return
    # Noise of the velocity makes the one too small, noise of the positions the other too large: the scale lies between.
    scale = float(product / power)
    at_most = float(np.vdot(by_position_m, by_position_m).real / product)
    # Each leg's own residual stands for its noise, whatever its length.
    left = by_velocity_m.conj() * (by_position_m - scale * by_velocity_m)
    scale_sd = float(np.linalg.norm(left.real)) / power
    # Fewer than ten legs do not tell how they scatter.
    if len(by_position_m) >= 10 and max(scale - 1.0, 1.0 - at_most) >= max(0.003, 3.0 * scale_sd):
        off_pct = 100.0 * abs(scale - 1.0)
        sd_pct = 100.0 * scale_sd
        longer = "longer" if scale > 1.0 else "shorter"
        yield note(
            "reference_scale", len(by_position_m), off_pct=off_pct, sd_pct=sd_pct, longer=longer
        )


def _jump_notes(
    quantity: str,
    unlike: Floats,
    smallest: float | Floats,
    unit: str,
    factor: float,
    time_s: Floats,
) -> Iterator[Note]:
    jumps = find_jumps(unlike, smallest)
    if jumps.size:
        largest = int(jumps[np.argmax(unlike[jumps])])
        known = {
            "quantity": quantity,
            "steps": len(unlike),
            "unit": unit,
            "at_s": time_s[largest + 1],
        }
        yield note("reference_jump", int(jumps.size), largest=unlike[largest] / factor, **known)
