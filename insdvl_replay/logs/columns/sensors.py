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
from insdvl_replay.logs.columns.clean import Cleaner, stand_for_none
from insdvl_replay.logs.columns.reference import (
    angles_without_marks,
    attitude,
    heights_without_marks,
    is_by_quaternion,
    longitude_of,
    of_receiver,
)
from insdvl_replay.logs.columns.tables import Table

Readings = tuple[Floats, Floats | None]
"""Values, (k, s), the first NaN where there is no reading; attitudes that they are part of, (k, 3, 3)."""


def decode_sensor(name: str, table: Table, config: Config) -> tuple[SensorColumns, list[Note]]:
    """Make the columns of a sensor; a `LogError` where no reading can be used."""
    settings = table.source.completed(getattr(config, name))
    cleaner = Cleaner(table)
    values, mat_nb = _READ[name](table, settings, cleaner)
    cleaner.keep_finite(values[:, :1], code="not_finite reading", quantity=name)
    if "sensor_id" in table:
        cleaner.drop_repeated_values(values)
    cleaner.drop_repeated_times(values)
    cleaner.require_rows()
    # Of a dive of hours the attitudes take more memory than the IMU's readings.
    wanted = mat_nb is not None and config.initial.source == BY_SENSOR
    kept_mat_nb = cleaner.kept(mat_nb) if wanted and mat_nb is not None else None
    kept_sd = cleaner.kept(_attitude_sd(table)) if wanted and "attitude_var" in table else None
    return SensorColumns(cleaner.times, cleaner.kept(values), kept_mat_nb, kept_sd), cleaner.notes


def _attitude_sd(table: Table) -> Floats:
    """Return the standard deviations of attitudes, (k, 3), rad; NaN where the messages state none."""
    variance = table.values("attitude_var", 3)
    is_stated = (variance > 0.0).all(axis=1, keepdims=True)
    return np.sqrt(np.where(is_stated, variance, np.nan))


def decode_log_topic(table: Table) -> tuple[SensorColumns, list[Note]]:
    """Make columns of a topic for user-defined measurements, as its messages have them."""
    values = table.values("values")
    cleaner = Cleaner(table)
    cleaner.keep_finite(values)
    cleaner.drop_repeated_times(values)
    cleaner.require_rows()
    return SensorColumns(cleaner.times, cleaner.kept(values)), cleaner.notes


def _depth(table: Table, settings: Depth, cleaner: Cleaner) -> Readings:
    """Return the metres below where the depth sensor reads nothing, (k, 1); the filters find where that is."""
    if "depth" in table:
        depth_m = table.column("depth")
    elif "height" in table:
        depth_m = -table.column("height")
    else:
        pressure_pa = table.column("pressure") * PRESSURE_UNITS[settings.pressure_unit or "Pa"]
        depth_m = pressure_pa / (settings.density_kgpm3 * STANDARD_GRAVITY_MPS2)
    depth_m = -heights_without_marks(cleaner, -np.asarray(depth_m, np.float64))
    return depth_m[:, None], None


def _heading(table: Table, settings: Heading, cleaner: Cleaner) -> Readings:
    """Return the true heading, (k, 1), and the attitude that it is part of; NaN where a message has none."""
    declination = settings.declination_deg * DEG
    mat = _attitude(table, settings, cleaner)  # from magnetic or true north
    if mat is None:
        if any(settings.mounting_rpy_deg):
            raise ConfigError(
                "heading.mounting_rpy_deg needs an attitude, but the messages have a heading only",
                "to correct a heading: heading.declination_deg",
            )
        unit = ANGLE_UNITS[settings.angle_unit or "deg"]
        heading = angles_without_marks(cleaner, table.values("heading", 1), unit) * unit
        return heading + declination, None
    if any(settings.mounting_rpy_deg):
        mounting = mat_from_rpy(np.array(settings.mounting_rpy_deg) * DEG)
        mat = np.asarray(mat @ mounting.T)
    if "quaternion_var" in table:
        without = table.column("quaternion_var") < 0.0
        if without.all():
            text = "all messages are marked as without orientation"
            raise LogError(text, "to use another topic: heading.topic", *table.where)
        mat[without] = np.nan
    heading = rpy_from_mat(mat)[:, 2] + declination
    return np.asarray(heading[:, None]), mat_from_rpy(np.array([0.0, 0.0, declination])) @ mat


def _attitude(table: Table, settings: Heading, cleaner: Cleaner) -> Floats | None:
    """Return the attitude that a heading is part of, (k, 3, 3); None where the settings name a heading alone."""
    if settings.heading is not None and settings.quaternion is None and settings.roll is None:
        return None
    if settings.angle_unit not in (None, "deg") and is_by_quaternion(table, settings):
        raise ConfigError(
            "heading.angle_unit is set, but the messages have a quaternion",
            "leave heading.angle_unit out; to read an angle: heading.heading",
        )
    return attitude(table, settings, cleaner)


def _position(table: Table, settings: Position, cleaner: Cleaner) -> Readings:
    """Return latitude rad, longitude rad, height m, (k, 3): NaN where there was no fix.

    A fix without height is dropped if heights are used. Otherwise its height is NaN.
    """
    unit = ANGLE_UNITS[settings.angle_unit or "deg"]
    latitude = of_receiver(table, "latitude") * unit
    longitude = longitude_of(table, cleaner, unit)
    polar = np.abs(latitude) > 0.5 * np.pi
    count = int(polar.sum())
    known = int(np.isfinite(latitude).sum())
    hint = 'to read another field: position.latitude = "field.path"'
    if 2 * count > known and (count == known or not stand_for_none(latitude[polar])):
        furthest = latitude[np.nanargmax(np.abs(latitude))] / unit
        largest = f"{furthest:.6g} {settings.angle_unit or 'deg'}"
        text = f"{count} of {known} latitudes are beyond the poles, up to {largest}"
        raise LogError(text, f'position.angle_unit = "deg" or "rad"; {hint}', *table.where)
    code = "impossible fixes"
    latitude = cleaner.without_impossible(latitude[:, None], polar[:, None], code)[:, 0]
    height_m = np.full(len(table), np.nan)
    if "height" in table:
        height_m = heights_without_marks(cleaner, table.column("height"))
    height_m = np.where(np.isfinite(height_m), height_m, np.nan)
    position = np.stack([latitude, longitude, height_m], axis=1)
    needed = position[:, : 2 if settings.height_sd_m is None else 3]
    lost = (latitude == 0.0) & (longitude == 0.0) | ~np.isfinite(needed).all(axis=1)
    if "fix_status" in table:
        lost |= table.column("fix_status") < 0.0
    position[lost] = np.nan
    return position, None


_READ: Final[dict[str, Callable[[Table, Any, Cleaner], Readings]]] = {
    "depth": _depth,
    "heading": _heading,
    "position": _position,
}
