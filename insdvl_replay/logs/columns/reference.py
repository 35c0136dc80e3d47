"""The reference and onboard solutions: positions, velocities and attitudes of one or two topics, or of a TUM file.

Sources of covariances and files: the definitions of nav_msgs/Odometry (the pose in its own frame, the twist in that of
the child) and of geometry_msgs/PoseWithCovariance (x, y, z, then rotations about these fixed axes, row by row); "File
formats - ground-truth trajectories" of the TUM RGB-D benchmark: ``timestamp tx ty tz qx qy qz qw``, seconds and metres,
the quaternion from the body to the frame of the positions; lines that begin with # are comments.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from insdvl_replay.core.config import (
    MOST_BYTES,
    TOPIC_KEYS,
    Heading,
    Initial,
    Navigation,
    Reference,
    Solution,
)
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Floats,
    Mask,
    ReferenceColumns,
    SolutionColumns,
    StatedErrors,
    TimeNs,
    distinct,
    find_runs,
    in_blocks,
    is_new,
    nothing,
    seconds,
)
from insdvl_replay.core.errors import LogError, Note, read_regular
from insdvl_replay.core.notes import note
from insdvl_replay.core.states import (
    DEG,
    DV,
    FASTEST_MPS,
    HIGHEST_M,
    LARGEST_ANGLE_RAD,
    LOWEST_M,
    NO_HEIGHT_M,
    PHI,
)
from insdvl_replay.core.units import ANGLE_UNITS
from insdvl_replay.geometry.earth import meridian_radius_m, transverse_radius_m
from insdvl_replay.geometry.frames import MAT_ENU_NED, MAT_FRD_FLU, north_east_m
from insdvl_replay.geometry.rotation import mat_from_quat, mat_from_rpy, skew, wrap_angle
from insdvl_replay.logs.columns.clean import Cleaner, note_lost_samples, stand_for_none
from insdvl_replay.logs.columns.named_columns import PLACE
from insdvl_replay.logs.columns.tables import Table, rows_among
from insdvl_replay.logs.columns.topics import BOW_DOWN
from insdvl_replay.logs.columns.tum import TUM_FORMAT, tum_poses
from insdvl_replay.logs.formats.fields import TABLE

# PX4's frames, and that of the messages before 1.13.
_NED: Final = 1
_BODY: Final = 3
_OLD_NED: Final = 0
# Which frame of a pose is north-east-down.
_NORTHS: Final = (("pose_frame", _NED), ("local_frame", _OLD_NED))
SIZE: Final = 9  # velocity error, misalignment and position error
DP: Final = slice(6, 9)
_LARGEST: Final = 1e30  # powers of larger variances are no numbers
_FLAT: Final = 2  # numbers of a position without a height
_FARTHEST_M: Final = 100e3  # of a position from where the dive began
_LONGER: Final = 0.01  # of a quaternion, more than rounding


_FEW_AGAIN: Final = 0.2  # share of rows up to which values repeat by chance, such as rounded ones
_LONGEST_AGAIN_S: Final = 2.5  # in which a topic repeats a value
_LEAST_VALUES: Final = 20


_LEAST_OFF_M: Final = 10.0  # by which a position is off that is no noise of a receiver
_TIMES_NOISE: Final = 10.0
_MOST_TOGETHER: Final = 5  # positions that follow one another and are off
_FEW_OFF: Final = 0.05  # share of positions up to which those are off, and not the others

# What one topic gives of `_SHAPES`, and which of its messages were taken.
Part = tuple[Cleaner, dict[str, Floats]]
_SHAPES: Final = {"position": (3,), "velocity_n": (3,), "mat_nb": (3, 3)}


def decode_reference(
    tables: list[Table], settings: Reference, initial: Initial
) -> tuple[ReferenceColumns | None, list[Note]]:
    """Make the columns of the reference; positions in metres are from the initial one."""
    if any("latitude" in table for table in tables):
        # Positions from an origin that nobody knows are left out where another topic has them on Earth.
        for i, table in enumerate(tables):
            fields = dict(table.source.fields)
            fields.pop("local_position", None)
            tables[i] = replace(table, source=replace(table.source, fields=fields))
    if not tables:
        return None, []
    parts = [read_part(table, settings, initial) for table in tables]
    stated = []
    for table, part in zip(tables, parts, strict=True):
        stated.append(_stated(table, settings, part))
    reference = replace(union(parts), stated=_joined(stated))
    return reference, _notes_of(parts)


def _notes_of(parts: Sequence[Part]) -> list[Note]:
    notes: list[Note] = []
    for cleaner, _ in parts:
        notes += cleaner.notes
    return notes


def _stated(table: Table, settings: Navigation, part: Part) -> StatedErrors:
    """Return what the messages of one topic say of the errors of what was read from them."""
    cleaner, found = part
    order, rows = rows_among(table.sampled, cleaner.rows, len(table))
    cov, _ = _covariances(table, table.source.completed(settings), found, order, rows)
    if "position" not in found:
        cov[:, DP] = np.nan
        cov[:, :, DP] = np.nan
    return StatedErrors(cleaner.times[rows], cov)


def _joined(stated: Sequence[StatedErrors]) -> StatedErrors | None:
    """Join what two topics say, at the times of the first one; None where none says anything."""
    given = [errors for errors in stated if np.isfinite(errors.cov).any()]
    if not given:
        return None
    first, *others = given
    cov = first.cov.copy()
    for other in others:
        nearest = np.searchsorted(other.time_ns, first.time_ns).clip(0, len(other.time_ns) - 1)
        cov = np.where(np.isnan(cov), other.cov[nearest], cov)
    return StatedErrors(first.time_ns, cov)


def read_part(table: Table, settings: Navigation, initial: Initial) -> Part:
    """Read what a topic gives of position, velocity and attitude, and clean it."""
    settings = table.source.completed(settings)
    cleaner = Cleaner(table)
    note_lost_samples(cleaner)
    position = _position(table, settings, initial, cleaner)
    reported = None if position is None else position.copy()
    if position is not None and table.source.type_name == TABLE:
        cleaner.keep(_holds_motion(table, position), "empty")
    if position is not None:
        _drop_beyond_poles(cleaner, position[:, 0])
        _clear_zero(cleaner, position)
    cleaner.keep_where("fix_status", lambda status: status >= 0.0, "no_fix")
    # From 2 on, a fix has two dimensions or three.
    cleaner.keep_where("fix_type", lambda kind: kind >= 2, "no_fix")
    if position is not None and "sensor_id" in table:
        cleaner.keep(np.isfinite(position[:, 0]), "no_fix satellites")
        cleaner.drop_repeated_values(position)
    cleaner.drop_repeated_times()
    if position is not None and isinstance(settings, Reference):
        _clear_outliers(cleaner, position)  # a solution is judged with those that it has
    mat_nb = attitude(table, settings, cleaner)
    velocity_n = _velocity_n(table, settings, mat_nb)
    if velocity_n is not None:
        velocity_n = cleaner.without_impossible(
            velocity_n,
            np.abs(velocity_n) > FASTEST_MPS,
            "impossible velocities",
            fastest_mps=FASTEST_MPS,
        )
    found = {
        "position": _without_published_again(cleaner, "positions", position),
        "velocity_n": _without_published_again(cleaner, "velocities", velocity_n),
        "mat_nb": _without_published_again(cleaner, "attitudes", mat_nb),
    }
    if reported is not None:
        cleaner.note_missing("positions", reported[:, :2])
        cleaner.note_missing("heights", reported[:, 2:])
    if found["velocity_n"] is not None:
        cleaner.note_missing("velocities", found["velocity_n"])
    if found["mat_nb"] is not None:
        cleaner.note_missing("attitudes", found["mat_nb"].reshape(-1, 9))
    kept = {name: cleaner.kept(values) for name, values in found.items() if values is not None}
    return cleaner, kept


def _holds_motion(table: Table, position: Floats) -> Mask:
    """Return which rows hold a position or another number of the reference; those of other sensors hold none."""
    holds = np.asarray(np.isfinite(position).any(axis=1))
    if holds.all():
        return holds
    for quantity in TOPIC_KEYS:
        if quantity in table and quantity not in PLACE:
            holds |= np.isfinite(table.values(quantity)).any(axis=1)
    return holds


def _clear_zero(cleaner: Cleaner, position: Floats) -> None:
    """Take out latitude and longitude 0, which receivers without satellites report; no dive is there."""
    zero = np.flatnonzero((position[:, :2] == 0.0).all(axis=1))
    if zero.size:
        position[zero] = np.nan
        cleaner.note(
            "zero",
            zero.size,
            zero,
        )


def _clear_outliers(cleaner: Cleaner, position: Floats) -> None:
    """Take out a few positions, (k, 3), to which and from which no vehicle moves: a satellite fix may be an echo.

    Where the positions stay beyond a jump, nobody can tell which side of it is right, and both stay as they are.
    """
    rows = cleaner.rows[np.isfinite(position[cleaner.rows, :2]).all(axis=1)]
    if len(rows) < _LEAST_VALUES:
        return
    north_m, east_m = north_east_m(position[rows], position[rows[0]], position[rows[0]])
    place_m = north_m + 1j * east_m
    steps_m = np.diff(place_m)
    # Noise alone may look like a speed where positions follow one another closely.
    noise_m = float(np.median(np.abs(np.diff(steps_m))))
    time_s = seconds(cleaner.time_ns[rows], cleaner.time_ns[rows[0]])
    reach_m = FASTEST_MPS * np.diff(time_s) + max(_LEAST_OFF_M, _TIMES_NOISE * noise_m)
    piece = np.append(0, np.cumsum(np.abs(steps_m) > reach_m))
    is_short = np.bincount(piece) <= _MOST_TOGETHER
    is_off = is_short[piece]
    count = int(np.count_nonzero(is_off))
    if not count or count > _FEW_OFF * len(rows):
        return
    usual_m = np.interp(time_s, time_s[~is_off], place_m[~is_off])
    largest_m = float(np.abs(place_m - usual_m)[is_off].max())
    position[rows[is_off]] = np.nan
    cleaner.note("impossible positions", count, rows[is_off], largest_m=largest_m)


def _drop_beyond_poles(cleaner: Cleaner, latitude: Floats) -> None:
    """Drop positions beyond the poles; where most are, and differ, the angles are something else."""
    possible = ~(np.abs(latitude) > np.pi / 2.0)
    if possible.all():
        return
    count = int(np.count_nonzero(~possible))
    hint = f'{cleaner.role}.angle_unit, or another field: {cleaner.role}.latitude = "field.path"'
    impossible_deg = latitude[~possible] / DEG
    cleaner.keep_possible(possible, impossible_deg, "impossible latitudes")
    if not possible[cleaner.rows].all() or not cleaner.rows.size:
        what = f"{count} of {possible.size} latitudes are beyond the poles"
        if _are_degrees_and_minutes(impossible_deg):
            what += (
                f", such as {impossible_deg[0]:.8g}: degrees and minutes, as NMEA 0183 writes them"
            )
            hint = "write them as degrees"
        raise LogError(what, hint, *cleaner.table.where)


def _are_degrees_and_minutes(latitudes: Floats) -> bool:
    """Return whether numbers are 100 times degrees, and then minutes: NMEA 0183 writes 48 deg 7.038 min as 4807.038."""
    degrees, minutes = np.divmod(np.abs(latitudes), 100.0)
    return bool((degrees <= 90.0).all() and (minutes < 60.0).all())


def heights_without_marks(cleaner: Cleaner, height_m: Floats) -> Floats:
    """Return heights, (k,), NaN where no water is, or where the number stands for none."""
    is_impossible = ~((height_m > LOWEST_M) & (height_m < HIGHEST_M))
    is_impossible |= np.abs(height_m) == NO_HEIGHT_M
    is_impossible &= np.isfinite(height_m)
    code = "impossible heights"
    return cleaner.without_impossible(height_m[:, None], is_impossible[:, None], code)[:, 0]


def angles_without_marks(cleaner: Cleaner, angles: Floats, unit: float) -> Floats:
    """Return angles in a unit, (k, n), NaN where they are a number that stands for none, such as 999."""
    # A heading that counts its turns may be large, too.
    beyond = np.abs(angles) * unit > LARGEST_ANGLE_RAD
    if not beyond.any() or not stand_for_none(angles[beyond]):
        return angles
    return cleaner.without_impossible(angles, beyond, "impossible angles")


def _without_published_again(
    cleaner: Cleaner, plural: str, columns: Floats | None
) -> Floats | None:
    """Return values, missing where they repeat the row before because a topic is published faster than they are made.

    Else they would be those of a time that has passed. Values that stay for longer are of a vehicle at rest, or frozen.
    """
    rows = cleaner.rows
    if columns is None or not len(rows):
        return columns
    values = columns[rows].reshape(len(rows), -1)
    again = np.zeros(len(rows), np.bool_)
    again[1:] = (values[1:] == values[:-1]).all(axis=1)
    if np.count_nonzero(again) <= _FEW_AGAIN * len(rows):
        return columns
    starts, ends = find_runs(again)
    times = cleaner.times
    is_long = seconds(times[ends - 1], times[starts - 1]) > _LONGEST_AGAIN_S
    for start, end in zip(starts[is_long].tolist(), ends[is_long].tolist(), strict=True):
        again[start:end] = False
    count = int(np.count_nonzero(again))
    if count <= _FEW_AGAIN * len(rows) or len(rows) - count < _LEAST_VALUES:
        return columns
    columns = columns.copy()
    columns[rows[again]] = np.nan
    first = rows[again]
    code = "same_values published"
    cleaner.note(
        code,
        count,
        first,
        quantity=plural,
        rows=len(rows),
    )
    return columns


def _position(
    table: Table,
    settings: Navigation,
    initial: Initial,
    cleaner: Cleaner,
) -> Floats | None:
    if "latitude" in table:
        return _position_on_earth(table, settings, cleaner)
    if "local_position" in table:
        return _position_from_origin(table, settings, initial, cleaner)
    return None


def _position_on_earth(table: Table, settings: Navigation, cleaner: Cleaner) -> Floats:
    """Return positions that are given as latitude, longitude and perhaps height or depth, shape (k, 3)."""
    unit = ANGLE_UNITS[settings.angle_unit or "deg"]
    latitude = of_receiver(table, "latitude") * unit
    longitude = longitude_of(table, cleaner, unit)
    height_m = np.full(len(table), np.nan)
    if "depth" in table:
        height_m = -table.column("depth")
    elif "height" in table:
        height_m = table.column("height")
    height_m = heights_without_marks(cleaner, height_m)
    # The wrapped negative is in [-pi, pi), so that its negative is in (-pi, pi].
    return np.stack([latitude, -wrap_angle(-longitude), height_m], axis=1)


def _position_from_origin(
    table: Table, settings: Navigation, initial: Initial, cleaner: Cleaner
) -> Floats | None:
    """Return positions that are given in metres from the messages' own origin, else from the initial position.

    None without an origin, and where all are zero: then the messages are about something else.
    """
    moved_n = local_position_n(table, settings)
    if not np.nan_to_num(moved_n[:, :2]).any():
        return None
    origin = np.full((len(table), 3), np.nan)
    if initial.latitude_deg is not None:
        origin[:] = initial.latitude_deg, initial.longitude_deg, initial.height_m
    if "origin" in table:
        given = table.values("origin", 3)
        if "origin_valid" in table:
            given = np.where(table.values("origin_valid", 1) > 0.0, given, origin)
        origin = given
    if np.isnan(origin).all():
        return None
    _count_from_first(cleaner, moved_n)
    latitude = origin[:, 0] * DEG
    longitude = origin[:, 1] * DEG
    height_m = origin[:, 2]
    north_m, east_m, down_m = moved_n.T
    north = latitude + north_m / (meridian_radius_m(latitude) + height_m)
    east = longitude + east_m / ((transverse_radius_m(latitude) + height_m) * np.cos(latitude))
    return np.stack([north, east, height_m - down_m], axis=1)


def _count_from_first(cleaner: Cleaner, moved_n: Floats) -> None:
    """Count positions of a grid, such as UTM, from the first one: no dive is so far from where it began."""
    rows = cleaner.rows[np.isfinite(moved_n[cleaner.rows, :2]).all(axis=1)]
    if not rows.size:
        return
    first_m = moved_n[rows[0], :2].copy()
    if np.abs(first_m).max() < _FARTHEST_M:
        return
    moved_n[:, :2] -= first_m
    north_m, east_m = first_m.tolist()
    cleaner.note("grid", len(rows), north_m=north_m, east_m=east_m)


def local_position_n(table: Table, settings: Navigation) -> Floats:
    """Return the displacements from the origin that positions in metres have, shape (k, 3), north, east, down.

    Those without a third number have NaN as down.
    """
    local_m = table.values("local_position")
    if local_m.shape[1] == _FLAT:
        north_east_m = local_m if settings.axes == "ned_frd" else local_m[:, ::-1]
        return np.column_stack([north_east_m, np.full(len(table), np.nan)])
    local_m = table.values("local_position", 3)
    if "local_valid" in table:
        local_m = np.where(table.values("local_valid", 2)[:, [0, 0, 1]] > 0.0, local_m, np.nan)
    for frame, north in _NORTHS:
        if frame in table:
            local_m = np.where(table.column(frame)[:, None] == north, local_m, np.nan)
    return local_m if settings.axes == "ned_frd" else local_m @ MAT_ENU_NED


def longitude_of(table: Table, cleaner: Cleaner, unit: float) -> Floats:
    """Return the longitudes in a unit as rad, shape (k,), NaN where they are a number that stands for none."""
    longitude = of_receiver(table, "longitude")[:, None]
    return angles_without_marks(cleaner, longitude, unit)[:, 0] * unit


def of_receiver(table: Table, quantity: str) -> Floats:
    """Return one number a message; of several sensors that of the satellite receiver, NaN where it is invalid."""
    if "sensor_id" not in table:
        return table.column(quantity)
    # NAVIGATION_SENSOR_ID_BLUEYE_GNSS
    satellites = (table.values("sensor_id") == 4) & (table.values("sensor_valid") > 0.0)
    chosen = np.where(satellites, table.values(quantity), np.nan)
    return np.asarray(chosen[np.arange(len(chosen)), satellites.argmax(axis=1)])


def attitude(table: Table, settings: Navigation | Heading, cleaner: Cleaner) -> Floats | None:
    """Return the attitude as it was written, shape (k, 3, 3), or None where the messages hold none whole."""
    if is_by_quaternion(table, settings):

        def to_north(quat: Floats) -> Floats:
            mat = mat_from_quat(quat)
            if settings.axes == "ned_frd":
                return mat
            return np.asarray(MAT_ENU_NED @ mat @ MAT_FRD_FLU)

        mat = in_blocks(to_north, table.values("quaternion", 4), np.empty((len(table), 3, 3)))
        for frame, north in _NORTHS:
            if frame in table:
                mat[table.column(frame) != north] = np.nan
        return mat
    if "roll" not in table:
        return None
    if "heading" not in table:
        role = table.source.role
        text = f"{role}.roll and {role}.pitch are set without a heading"
        raise LogError(text, f'{role}.heading = "field.path", or leave both out', *table.where)
    pitch = table.column("pitch") if "pitch" in table else -table.column(f"pitch{BOW_DOWN}")
    rpy = np.stack([table.column("roll"), pitch, table.column("heading")], axis=1)
    unit = ANGLE_UNITS[settings.angle_unit or "deg"]
    return mat_from_rpy(angles_without_marks(cleaner, rpy, unit) * unit)


def is_by_quaternion(table: Table, settings: Navigation | Heading) -> bool:
    """Return whether an attitude is that of a quaternion, which goes before three angles only where it is named."""
    return "quaternion" in table and ("roll" not in table or settings.quaternion is not None)


def _velocity_n(table: Table, settings: Navigation, mat_nb: Floats | None) -> Floats | None:
    if "velocity_frame" in table:
        return _velocity_by_frame(table, mat_nb)
    if "velocity_n" in table and ("velocity_b" not in table or settings.velocity_n is not None):
        velocity = table.values("velocity_n", 3)
        if "velocity_valid" in table:
            valid = table.values("velocity_valid", 2)[:, [0, 0, 1]] > 0.0
            velocity = np.where(valid, velocity, np.nan)
        is_enu = settings.axes == "enu_flu"
        if settings.axes is None:
            # Then it is in those of the quaternion beside it.
            is_enu = is_by_quaternion(table, settings)
        return velocity @ MAT_ENU_NED if is_enu else velocity
    if "velocity_b" not in table or mat_nb is None:
        return None
    velocity_b = table.values("velocity_b", 3)
    if settings.axes != "ned_frd":
        velocity_b = velocity_b @ MAT_FRD_FLU
    return np.asarray(np.einsum("kij,kj->ki", mat_nb, velocity_b))


def _velocity_by_frame(table: Table, mat_nb: Floats | None) -> Floats:
    """Return velocities of which each is in the frame that its message says; NaN in frames without a north."""
    velocity = table.values("velocity_n", 3)
    frame = table.column("velocity_frame")
    velocity_n = np.where((frame == _NED)[:, None], velocity, np.nan)
    if mat_nb is None:
        return velocity_n
    turned_n = np.einsum("kij,kj->ki", mat_nb, velocity)
    return np.where((frame == _BODY)[:, None], turned_n, velocity_n)


def union(parts: Sequence[Part]) -> ReferenceColumns:
    """Join topics on the union of their times; one alone is not copied, and one row stands for what it lacks."""
    columns: dict[str, Any] = {}
    if len(parts) == 1:
        [(cleaner, found)] = parts
        for name, shape in _SHAPES.items():
            columns[name] = nothing((cleaner.times.size, *shape))
            if name in found:
                columns[name] = np.ascontiguousarray(found[name])
        return ReferenceColumns(cleaner.times, **columns)
    time_ns = distinct(np.concatenate([cleaner.times for cleaner, _ in parts]))
    for name, shape in _SHAPES.items():
        columns[name] = np.full((time_ns.size, *shape), np.nan)
    for cleaner, found in parts:
        for name, values in found.items():
            columns[name][np.searchsorted(time_ns, cleaner.times)] = values
    return ReferenceColumns(time_ns, **columns)


# Onboard solutions.


def no_covariances() -> tuple[TimeNs, Floats]:
    """Return the times and covariances of a solution that has none."""
    return np.empty(0, np.int64), np.empty((0, SIZE, SIZE))


def decode_solution(
    tables: Sequence[Table], settings: Solution
) -> tuple[SolutionColumns, list[Note]]:
    """Make the columns of a solution of its topic, and of the one with its geographic positions if there is one."""
    # Positions in metres are aligned where the filters start, not where [initial] says.
    parts = [read_part(table, settings, Initial()) for table in tables]
    for cleaner, _ in parts:
        cleaner.require_rows()
    motion = union(parts)
    table = tables[0]
    cleaner, found = parts[0]
    completed = table.source.completed(settings)
    notes = _notes_of(parts)
    moved_n = None
    if "local_position" in table and not motion.has_position:
        moved_n = cleaner.kept(local_position_n(table, completed))
    order, rows = rows_among(table.sampled, cleaner.rows, len(table))
    cov, wrong = _covariances(table, completed, found, order, rows)
    if wrong:
        notes.append(note("solution_covariance", wrong).about(table.source.role))
    return SolutionColumns(motion, moved_n, cleaner.times[rows], cov), notes


def _covariances(
    table: Table,
    settings: Navigation,
    found: Mapping[str, Floats],
    order: TimeNs,
    rows: TimeNs,
) -> tuple[Floats, int]:
    """Return the covariance of the sampled rows in n, shape (c, 9, 9), and count matrices that are none.

    A velocity in the body errs by what its own covariance says, and in n by a misalignment, too: with
    ``v_n = C v_b`` the error is ``dv = C dv_b - v x phi``.
    """
    cov = np.full((len(rows), SIZE, SIZE), np.nan)
    wrong = 0
    ned_frd = settings.axes == "ned_frd"
    turn_n = np.eye(3) if ned_frd else MAT_ENU_NED
    if "pose_cov" in table:
        pose, wrong = _valid_covariances(table.values("pose_cov", 21)[order], 6)
        blocks = ((DP, slice(0, 3)), (PHI, slice(3, 6)))
        for (row, pose_row), (column, pose_column) in product(blocks, blocks):
            cov[:, row, column] = turn_n @ pose[:, pose_row, pose_column] @ turn_n.T
    if "position_cov" in table:
        # East, north, up; of the types of covariances, 0 is unknown.
        position, more = _valid_covariances(table.values("position_cov", 6)[order], 3)
        wrong += more
        if "position_cov_type" in table:
            position[table.column("position_cov_type")[order] == 0.0] = np.nan
        cov[:, DP, DP] = MAT_ENU_NED @ position @ MAT_ENU_NED.T
    if "twist_cov" in table and "velocity_n" in found:
        twist, more = _valid_covariances(table.values("twist_cov", 6)[order], 3)
        wrong += more
        in_body = "velocity_b" in table and settings.velocity_n is None
        if in_body and "mat_nb" in found:
            turn_b = np.eye(3) if ned_frd else MAT_FRD_FLU
            mat = found["mat_nb"][rows] @ turn_b
            _fill_by_body(cov, mat @ twist @ mat.swapaxes(1, 2), found["velocity_n"][rows])
        elif not in_body:
            _fill_velocity(cov, turn_n @ twist @ turn_n.T)
    return cov, wrong


def _fill_velocity(cov: Floats, velocity_cov: Floats) -> None:
    """Fill the covariance of velocities that depend on no attitude."""
    cov[:, DV, DV] = velocity_cov
    for other in (PHI, DP):
        cov[:, DV, other] = 0.0
        cov[:, other, DV] = 0.0


def _fill_by_body(cov: Floats, velocity_cov: Floats, velocity_n: Floats) -> None:
    """Fill the covariance of velocities that were turned by the attitude, and err with it."""
    velocity_x = skew(velocity_n)
    by_phi = -velocity_x @ cov[:, PHI]
    cov[:, DV, DV] = velocity_cov - by_phi[:, :, PHI] @ velocity_x.swapaxes(1, 2)
    for other in (PHI, DP):
        cov[:, DV, other] = by_phi[:, :, other]
        cov[:, other, DV] = by_phi[:, :, other].swapaxes(1, 2)


def _valid_covariances(upper: Floats, size: int) -> tuple[Floats, int]:
    """Make covariances of upper triangles, NaN in the blocks of three that are not given; count what is none.

    A variance of 0 or less, such as the -1 in front of a matrix that stands for none, says nothing.
    """
    cov = np.empty((len(upper), size, size))
    row, column = np.triu_indices(size)
    cov[:, row, column] = cov[:, column, row] = upper
    variances = np.diagonal(cov, axis1=1, axis2=2)
    is_variance = (variances > 0.0) & np.isfinite(variances)
    given = np.asarray(is_variance.reshape(len(cov), -1, 3).all(axis=2))
    given[cov[:, 0, 0] == -1.0] = False
    rows = np.repeat(given, 3, axis=1)
    given_cov = np.where(rows[:, :, None] & rows[:, None, :], cov, 0.0)
    # What is not given stands for itself alone, so that it does not hide the rest.
    given_cov[:, np.arange(size), np.arange(size)] += ~rows
    wrong = np.asarray(~(np.abs(given_cov) < _LARGEST).all(axis=(1, 2)))
    possible = np.flatnonzero(~wrong)
    wrong[possible] = np.linalg.eigvalsh(given_cov[possible])[:, 0] <= 0.0
    rows[wrong] = False
    valid = np.where(rows[:, :, None] & rows[:, None, :], given_cov, np.nan)
    return valid, int(np.count_nonzero(wrong))


def read_tum(path: Path, settings: Solution, role: str) -> tuple[SolutionColumns, list[Note]]:
    """Read a solution from a TUM file; the role is its section of the settings."""
    try:
        content = read_regular(path, MOST_BYTES)
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}", f"check {role}.file", path) from error
    sha256 = hashlib.sha256(content).hexdigest()
    if settings.sha256 not in (None, sha256):
        text = f"has changed since the settings were read: its SHA-256 is {sha256}"
        raise LogError(text, "run again", path)
    time_ns, numbers = tum_poses(path, content.decode("utf-8", "replace"))
    finite = np.isfinite(numbers)
    if not finite.any():
        raise LogError(f"has no number in any of its {len(numbers)} poses", TUM_FORMAT, path)
    numbers = np.where(finite, numbers, np.nan)
    notes = []
    lacking = int(np.count_nonzero(~finite[:, :3].all(axis=1)))
    if lacking:
        notes.append(note("tum_without_position", lacking, lines=len(numbers)).about(role))
    back = int(np.count_nonzero(np.diff(time_ns) < 0))
    if back:
        notes.append(note("solution_out_of_order lines", back).about(role))
    repeats = len(time_ns) - len(np.unique(time_ns))
    if repeats:
        notes.append(note("solution_repeats lines", repeats).about(role))
    order = np.argsort(time_ns, kind="stable")
    rows = order[is_new(time_ns[order])]
    way = numbers[rows, :3]
    mat = mat_from_quat(numbers[rows, 3:])
    notes += [found.about(role) for found in length_notes(numbers[rows, 3:])]
    if settings.axes != "ned_frd":
        way = way @ MAT_ENU_NED
        mat = np.asarray(MAT_ENU_NED @ mat @ MAT_FRD_FLU)
    nothing = np.full_like(way, np.nan)
    motion = ReferenceColumns(
        time_ns[rows] - round(settings.latency_s * NS_PER_S), nothing, nothing.copy(), mat
    )
    return SolutionColumns(motion, way, *no_covariances()), notes


def length_notes(quat: Floats) -> list[Note]:
    """Note quaternions, shape (k, 4), that are not of length 1."""
    lengths = np.linalg.norm(quat, axis=1)
    lengths = lengths[np.abs(lengths - 1.0) > _LONGER]
    if not len(lengths):
        return []
    return [
        note(
            "quaternion_length",
            len(lengths),
            least=float(lengths.min()),
            most=float(lengths.max()),
        )
    ]
