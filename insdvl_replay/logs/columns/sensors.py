"""The sensors other than IMU and DVL: their readings in the project's units."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from insdvl_replay.core.config import Config, Depth, Heading, Position
from insdvl_replay.core.dive_columns import Floats, SensorColumns
from insdvl_replay.core.errors import ConfigError, LogError, Note
from insdvl_replay.core.states import BY_SENSOR, DEG, STANDARD_GRAVITY_MPS2
from insdvl_replay.core.units import ANGLE_UNITS, PRESSURE_UNITS
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.logs.columns.clean import Cleaner
from insdvl_replay.logs.columns.reference import attitude, is_by_quaternion, of_receiver
from insdvl_replay.logs.columns.tables import Table

Readings = tuple[Floats, Floats | None]
"""Values, (k, s), the first NaN where there is no reading; attitudes that they are part of, (k, 3, 3)."""


def decode_sensor(name: str, table: Table, config: Config) -> tuple[SensorColumns, list[Note]]:
    """Make the columns of a sensor; a `LogError` where no reading can be used."""
    settings = table.source.completed(getattr(config, name))
    (values, mat_nb), cleaner = _READ[name](table, settings), Cleaner(table)
    cleaner.keep_finite(values[:, :1], reason=f"messages have no {name}")
    if "sensor_id" in table:
        cleaner.drop_repeated_values(values)
    cleaner.drop_repeated_times(values)
    cleaner.require_rows()
    # Of a dive of hours the attitudes take more memory than the IMU's readings.
    wanted = mat_nb is not None and config.initial.source == BY_SENSOR
    kept_mat_nb = cleaner.kept(mat_nb) if wanted and mat_nb is not None else None
    return SensorColumns(cleaner.times, cleaner.kept(values), kept_mat_nb), cleaner.notes


def decode_log_topic(table: Table) -> tuple[SensorColumns, list[Note]]:
    """Make columns of a topic for user-defined measurements, as its messages have them."""
    values, cleaner = table.values("values"), Cleaner(table)
    cleaner.keep_finite(values)
    cleaner.drop_repeated_times(values)
    cleaner.require_rows()
    return SensorColumns(cleaner.times, cleaner.kept(values)), cleaner.notes


def _depth(table: Table, settings: Depth) -> Readings:
    """Return the metres below where the depth sensor reads nothing, (k, 1); the filters find where that is."""
    if "depth" in table:
        depth_m = table.column("depth")
    elif "height" in table:
        depth_m = -table.column("height")
    else:
        pressure_pa = table.column("pressure") * PRESSURE_UNITS[settings.pressure_unit or "Pa"]
        depth_m = pressure_pa / (settings.density_kgpm3 * STANDARD_GRAVITY_MPS2)
    return np.asarray(depth_m[:, None], np.float64), None


def _heading(table: Table, settings: Heading) -> Readings:
    """Return the true heading, (k, 1), and the attitude that it is part of; NaN where a message has none."""
    declination, turned = settings.declination_deg * DEG, any(settings.mounting_rpy_deg)
    heading_alone = settings.heading is not None and settings.quaternion is None and settings.roll is None
    if not heading_alone and settings.angle_unit not in (None, "deg") and is_by_quaternion(table, settings):
        raise ConfigError(
            "heading.angle_unit is set, but the messages have a quaternion",
            "leave heading.angle_unit out; to read an angle: heading.heading",
        )
    mat = None if heading_alone else attitude(table, settings)  # from magnetic or true north
    if mat is None:
        if turned:
            raise ConfigError(
                "heading.mounting_rpy_deg needs an attitude, but the messages have a heading only",
                "to correct a heading: heading.declination_deg",
            )
        heading = table.column("heading") * ANGLE_UNITS[settings.angle_unit or "deg"]
        return np.asarray((heading + declination)[:, None]), None
    if turned:
        mat = np.asarray(mat @ mat_from_rpy(np.array(settings.mounting_rpy_deg) * DEG).T)
    if "quaternion_var" in table:
        without = table.column("quaternion_var") < 0.0
        if without.all():
            text = "all messages are marked as without orientation"
            raise LogError(text, "to use another topic: heading.topic", *table.where)
        mat[without] = np.nan
    heading = rpy_from_mat(mat)[:, 2] + declination
    return np.asarray(heading[:, None]), mat_from_rpy(np.array([0.0, 0.0, declination])) @ mat


def _position(table: Table, settings: Position) -> Readings:
    """Return latitude rad, longitude rad, height m, (k, 3): NaN where there was no fix.

    A fix without height is dropped if heights are used. Otherwise its height is NaN.
    """
    unit = ANGLE_UNITS[settings.angle_unit or "deg"]
    latitude, longitude = (of_receiver(table, name) * unit for name in ("latitude", "longitude"))
    polar = np.abs(latitude) > 0.5 * np.pi
    count, known = int(polar.sum()), int(np.isfinite(latitude).sum())
    if 2 * count > known:
        furthest = latitude[np.nanargmax(np.abs(latitude))] / unit
        raise LogError(
            f"{count} of {known} latitudes are beyond the poles, up to {furthest:.6g} {settings.angle_unit or 'deg'}",
            'position.angle_unit = "deg" or "rad"; to read another field: position.latitude = "field.path"',
            *table.where,
        )
    height_m = table.column("height") if "height" in table else np.full(len(table), np.nan)
    position = np.stack([latitude, longitude, np.where(np.isfinite(height_m), height_m, np.nan)], axis=1)
    needed = position[:, : 2 if settings.height_sd_m is None else 3]
    lost = (latitude == 0.0) & (longitude == 0.0) | polar | ~np.isfinite(needed).all(axis=1)
    if "fix_status" in table:
        lost |= table.column("fix_status") < 0.0
    position[lost] = np.nan
    return position, None


_READ: Final[dict[str, Callable[[Table, Any], Readings]]] = {
    "depth": _depth,
    "heading": _heading,
    "position": _position,
}
