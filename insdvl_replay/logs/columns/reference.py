"""The reference solution: positions, velocities and attitudes of one or two topics, on the union of their times."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from insdvl_replay.core.config import Heading, Initial, Navigation, Reference
from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs, distinct, in_blocks, nothing
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.states import DEG
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.earth import meridian_radius_m, transverse_radius_m
from insdvl_replay.geometry.frames import MAT_ENU_NED, MAT_FRD_FLU
from insdvl_replay.geometry.rotation import mat_from_quat, mat_from_rpy, wrap_angle
from insdvl_replay.logs.columns.cleaning import Cleaner, is_few, note_lost_samples
from insdvl_replay.logs.columns.known_types import BLUEYE_GNSS
from insdvl_replay.logs.columns.tables import Table
from insdvl_replay.logs.columns.topic_requirements import BOW_DOWN

_LEAST_FIX: Final = 2
"""PX4's type of a fix in two dimensions."""
_NED, _BODY, _OLD_NED = 1, 3, 0
"""PX4's frames, and that of the messages before 1.13."""
_NORTHS: Final = (("pose_frame", _NED), ("local_frame", _OLD_NED))
"""Which frame of a pose is north-east-down."""

ANGLE_UNITS: Final = {"deg": DEG, "rad": 1.0}
"""Factors to rad."""


@dataclass(frozen=True)
class Part:
    """What one topic tells.

    Attributes
    ----------
    cleaner : Cleaner
        Which of its messages were taken.
    """

    time_ns: TimeNs
    position: Floats | None
    velocity_n: Floats | None
    mat_nb: Floats | None
    cleaner: Cleaner


def decode_reference(
    tables: list[Table], settings: Reference, initial: Initial
) -> tuple[ReferenceColumns | None, list[Note]]:
    """Make the columns of the reference; positions in metres are from the initial one."""
    has_fixes = any("latitude" in table for table in tables)
    parts = [read_part(_without_local_positions(table) if has_fixes else table, settings, initial) for table in tables]
    return (union(parts) if parts else None), [note for part in parts for note in part.cleaner.notes]


def _without_local_positions(table: Table) -> Table:
    """Leave out positions from an origin that nobody knows, where another topic has them on Earth."""
    fields = {quantity: path for quantity, path in table.source.fields.items() if quantity != "local_position"}
    return replace(table, source=replace(table.source, fields=fields))


def read_part(table: Table, settings: Navigation, initial: Initial) -> Part:
    """Read what a topic tells of position, velocity and attitude, and clean it."""
    settings = table.source.completed(settings)
    cleaner = Cleaner(table)
    note_lost_samples(cleaner)
    position = _position(table, settings, initial)
    told = None if position is None else position.copy()
    if position is not None:
        _keep_latitudes(position, cleaner)
        _drop_zeros(position, cleaner)
    if "fix_status" in table:
        cleaner.keep(table.column("fix_status") >= 0.0, "no_fix", "positions have no fix")
    if "fix_type" in table:
        cleaner.keep(table.column("fix_type") >= _LEAST_FIX, "no_fix", "positions have no fix")
    if position is not None and "sensor_id" in table:
        cleaner.keep(np.isfinite(position[:, 0]), "no_fix", "positions are without satellites")
        cleaner.drop_repeated_values(position)
    cleaner.drop_repeated_times()
    mat_nb = attitude(table, settings)
    velocity_n = _velocity_n(table, settings, mat_nb)
    _note_missing(cleaner, told, velocity_n, mat_nb)
    position, velocity_n, mat_nb = (
        None if values is None else cleaner.kept(values) for values in (position, velocity_n, mat_nb)
    )
    return Part(cleaner.times, position, velocity_n, mat_nb, cleaner)


def _position(table: Table, settings: Navigation, initial: Initial) -> Floats | None:
    if "latitude" not in table:
        return _local_position(table, settings, initial) if "local_position" in table else None
    unit = ANGLE_UNITS[settings.angle_unit]
    latitude, longitude = of_receiver(table, "latitude") * unit, of_receiver(table, "longitude") * unit
    # The wrapped negative lies in [-pi, pi), so that its negative lies in (-pi, pi].
    return np.stack([latitude, -wrap_angle(-longitude), _height_m(table)], axis=1)


def _local_position(table: Table, settings: Navigation, initial: Initial) -> Floats | None:
    """Make positions of metres from an origin: the messages' own, else the initial position; none without either.

    Nor where all are zero in the plane, as in messages that are about something else.
    """
    north_east_down_m = local_way_n(table, settings)
    if not np.nan_to_num(north_east_down_m[:, :2]).any():
        return None
    origin = np.full((len(table), 3), np.nan)
    if initial.latitude_deg is not None:
        origin[:] = initial.latitude_deg, initial.longitude_deg, initial.height_m
    if "origin" in table:
        told = table.column("origin_valid") > 0.0 if "origin_valid" in table else np.ones(len(table), np.bool_)
        origin = np.where(told[:, None], table.values("origin", 3), origin)
    if np.isnan(origin).all():
        return None
    latitude, longitude, height_m = origin[:, 0] * DEG, origin[:, 1] * DEG, origin[:, 2]
    north_m, east_m, down_m = north_east_down_m.T
    return np.stack(
        [
            latitude + north_m / (meridian_radius_m(latitude) + height_m),
            longitude + east_m / ((transverse_radius_m(latitude) + height_m) * np.cos(latitude)),
            height_m - down_m,
        ],
        axis=1,
    )


def local_way_n(table: Table, settings: Navigation) -> Floats:
    """Return the ways from the origin that positions in metres have, shape (k, 3), north, east, down."""
    local_m = table.values("local_position", 3)
    if "local_valid" in table:
        local_m = np.where(table.values("local_valid", 2)[:, [0, 0, 1]] > 0.0, local_m, np.nan)
    for frame, north in _NORTHS:
        if frame in table:
            local_m = np.where(table.column(frame)[:, None] == north, local_m, np.nan)
    return local_m if settings.axes == "ned_frd" else local_m @ MAT_ENU_NED


def _height_m(table: Table) -> Floats:
    if "depth" in table:
        return -table.column("depth")
    return table.column("height") if "height" in table else np.full(len(table), np.nan)


def _keep_latitudes(position: Floats, cleaner: Cleaner) -> None:
    """Drop the few positions beyond the poles; where they are many, the angles are something else."""
    possible = ~(np.abs(position[:, 0]) > np.pi / 2.0)
    count, hint = (
        int(np.count_nonzero(~possible)),
        f"{cleaner.role}.angle_unit, or {cleaner.role}.latitude names another field",
    )
    if not is_few(count, possible.size):
        raise LogError(f"{count} of {possible.size} latitudes are beyond the poles", hint, *cleaner.table.where)
    cleaner.keep_possible(possible, "latitudes are beyond the poles", hint)


def _drop_zeros(position: Floats, cleaner: Cleaner) -> None:
    """Take latitude and longitude 0 for no position: receivers without satellites report it, and no dive is there."""
    zero = np.flatnonzero((position[:, :2] == 0.0).all(axis=1))
    if zero.size:
        position[zero] = np.nan
        text = "positions have latitude and longitude 0, as receivers without satellites report, and are left out"
        cleaner.note(
            "zero",
            text,
            zero.size,
            Severity.WARNING,
            f"{cleaner.role}.fix names another topic of positions",
            first=zero,
        )


def _note_missing(cleaner: Cleaner, position: Floats | None, velocity_n: Floats | None, mat_nb: Floats | None) -> None:
    if position is not None:
        cleaner.note_missing("positions", position[:, :2])
        cleaner.note_missing("heights", position[:, 2:])
    if velocity_n is not None:
        cleaner.note_missing("velocities", velocity_n)
    if mat_nb is not None:
        cleaner.note_missing("attitudes", mat_nb.reshape(-1, 9))


def of_receiver(table: Table, quantity: str) -> Floats:
    """Return one number a message; of several sensors that of the satellite receiver, NaN where it is invalid."""
    if "sensor_id" not in table:
        return table.column(quantity)
    satellites = (table.values("sensor_id") == BLUEYE_GNSS) & (table.values("sensor_valid") > 0.0)
    chosen = np.where(satellites, table.values(quantity), np.nan)
    return np.asarray(chosen[np.arange(len(chosen)), satellites.argmax(axis=1)])


def attitude(table: Table, settings: Navigation | Heading) -> Floats | None:
    """Return the attitude as it was written, shape (k, 3, 3), or None where the messages hold none whole."""
    if is_by_quaternion(table, settings):
        to_north = mat_from_quat if settings.axes == "ned_frd" else _mat_from_enu_flu
        mat = in_blocks(to_north, table.values("quaternion", 4), np.empty((len(table), 3, 3)))
        for frame, north in _NORTHS:
            if frame in table:
                mat[table.column(frame) != north] = np.nan
        return mat
    if "roll" in table:
        if "heading" not in table:
            role = table.source.role
            raise LogError(
                f"{role}.roll and {role}.pitch name roll and pitch without a heading",
                f'{role}.heading = "field.path", or leave both out',
                *table.where,
            )
        pitch = table.column("pitch") if "pitch" in table else -table.column(f"pitch{BOW_DOWN}")
        rpy = np.stack([table.column("roll"), pitch, table.column("heading")], axis=1)
        return mat_from_rpy(rpy * ANGLE_UNITS[settings.angle_unit])
    return None


def _mat_from_enu_flu(quat: Floats) -> Floats:
    return np.asarray(MAT_ENU_NED @ mat_from_quat(quat) @ MAT_FRD_FLU)


def _is_east_north_up(table: Table, settings: Navigation) -> bool:
    """Return in which axes a velocity in n is: unless it is said, in those of the quaternion beside it."""
    return settings.axes == "enu_flu" or (settings.axes is None and is_by_quaternion(table, settings))


def is_by_quaternion(table: Table, settings: Navigation | Heading) -> bool:
    """Return whether an attitude is that of a quaternion, which goes before three angles only where it is named."""
    return "quaternion" in table and ("roll" not in table or settings.quaternion is not None)


def _velocity_n(table: Table, settings: Navigation, mat_nb: Floats | None) -> Floats | None:
    if "velocity_frame" in table:
        return _velocity_by_frame(table, mat_nb)
    if "velocity_n" in table and ("velocity_b" not in table or settings.velocity_n is not None):
        velocity = table.values("velocity_n", 3)
        if "velocity_valid" in table:
            velocity = np.where(table.values("velocity_valid", 2)[:, [0, 0, 1]] > 0.0, velocity, np.nan)
        return velocity @ MAT_ENU_NED if _is_east_north_up(table, settings) else velocity
    if "velocity_b" not in table or mat_nb is None:
        return None
    velocity_b = table.values("velocity_b", 3)
    if settings.axes != "ned_frd":
        velocity_b = velocity_b @ MAT_FRD_FLU
    return np.asarray(np.einsum("kij,kj->ki", mat_nb, velocity_b))


def _velocity_by_frame(table: Table, mat_nb: Floats | None) -> Floats:
    """Turn velocities, each in the frame that its message says, north-east-down; NaN in frames without a north."""
    velocity, frame = table.values("velocity_n", 3), table.column("velocity_frame")
    in_n = np.where((frame == _NED)[:, None], velocity, np.nan)
    if mat_nb is None:
        return in_n
    return np.where((frame == _BODY)[:, None], np.einsum("kij,kj->ki", mat_nb, velocity), in_n)


def union(parts: Sequence[Part]) -> ReferenceColumns:
    """Lay what several topics tell on the union of their times; what one tells alone is not copied."""
    if len(parts) == 1:
        return _alone(parts[0])
    time_ns = distinct(np.concatenate([part.time_ns for part in parts]))
    position, velocity_n = np.full((time_ns.size, 3), np.nan), np.full((time_ns.size, 3), np.nan)
    mat_nb = np.full((time_ns.size, 3, 3), np.nan)
    for part in parts:
        rows = np.searchsorted(time_ns, part.time_ns)
        for column, values in ((position, part.position), (velocity_n, part.velocity_n), (mat_nb, part.mat_nb)):
            if values is not None:
                column[rows] = values
    return ReferenceColumns(time_ns, position, velocity_n, mat_nb)


def _alone(part: Part) -> ReferenceColumns:
    """Take over what a topic tells; of what it does not, one row stands for all."""
    columns = {"position": part.position, "velocity_n": part.velocity_n, "mat_nb": part.mat_nb}
    shapes = {"position": (3,), "velocity_n": (3,), "mat_nb": (3, 3)}
    count = len(part.time_ns)
    told = {
        name: nothing((count, *shapes[name])) if values is None else np.ascontiguousarray(values)
        for name, values in columns.items()
    }
    return ReferenceColumns(part.time_ns, **told)
