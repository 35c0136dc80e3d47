"""The readings of the sensors beside IMU and DVL, in the project's units and signs, and clean."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from insdvl_replay.core.config import Config, Depth, Heading, Position
from insdvl_replay.core.dive_columns import Floats, SensorColumns
from insdvl_replay.core.errors import Note
from insdvl_replay.core.states import DEG, STANDARD_GRAVITY_MPS2
from insdvl_replay.geometry.frames import MAT_ENU_NED, MAT_FRD_FLU
from insdvl_replay.geometry.rotation import mat_from_quat, rpy_from_mat
from insdvl_replay.logs.columns.cleaning import Cleaner
from insdvl_replay.logs.columns.reference import ANGLE_UNITS, of_receiver
from insdvl_replay.logs.columns.tables import Table

PRESSURE_UNITS: Final = {"Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "dbar": 1e4, "bar": 1e5}
"""Pa of one unit."""


def decode_sensor(name: str, table: Table, config: Config) -> tuple[SensorColumns, list[Note]]:
    """Make the columns of a sensor of `core.sensors`.

    Raises
    ------
    LogError
        No reading can be used.
    """
    settings = table.source.completed(getattr(config, name))
    values, cleaner = _VALUES[name](table, settings), Cleaner(table)
    cleaner.keep_finite(values)
    if "sensor_id" in table:
        cleaner.drop_repeated_values(values)
    cleaner.drop_repeated_times(values)
    cleaner.require_rows()
    return SensorColumns(cleaner.times, cleaner.kept(values)), cleaner.notes


def decode_own_topic(table: Table) -> tuple[SensorColumns, list[Note]]:
    """Make columns of the numbers of a topic that only measurements of the user's own read, as its messages have them.

    Raises
    ------
    LogError
        No reading can be used.
    """
    values, cleaner = table.values("values"), Cleaner(table)
    cleaner.keep_finite(values)
    cleaner.drop_repeated_times(values)
    cleaner.require_rows()
    return SensorColumns(cleaner.times, cleaner.kept(values)), cleaner.notes


def _depth_m(table: Table, settings: Depth) -> Floats:
    """Return the metres below where the gauge reads nothing, shape (k, 1); the filters find where that is."""
    if "depth" in table:
        depth_m = table.column("depth")
    elif "height" in table:
        depth_m = -table.column("height")
    else:
        pressure_pa = table.column("pressure") * PRESSURE_UNITS[settings.pressure_unit or "Pa"]
        depth_m = pressure_pa / (settings.density_kgpm3 * STANDARD_GRAVITY_MPS2)
    return np.asarray(depth_m[:, None], np.float64)


def _heading_rad(table: Table, settings: Heading) -> Floats:
    """Return the true heading, shape (k, 1): NaN where its message says that there is none."""
    if "quaternion" in table:
        mat = mat_from_quat(table.values("quaternion", 4))
        mat_nb = mat if settings.axes == "ned_frd" else MAT_ENU_NED @ mat @ MAT_FRD_FLU
        heading = rpy_from_mat(mat_nb)[:, 2]
        if "quaternion_var" in table:
            heading = np.where(table.column("quaternion_var") < 0.0, np.nan, heading)
    else:
        heading = table.column("heading") * ANGLE_UNITS[settings.angle_unit]
    return np.asarray((heading + settings.declination_deg * DEG)[:, None])


def _position(table: Table, settings: Position) -> Floats:
    """Return latitude rad, longitude rad, height m, shape (k, 3): NaN where there was no fix."""
    unit = ANGLE_UNITS[settings.angle_unit]
    latitude, longitude = (of_receiver(table, name) * unit for name in ("latitude", "longitude"))
    height_m = table.column("height") if "height" in table else np.zeros(len(table))
    position = np.stack([latitude, longitude, np.nan_to_num(height_m)], axis=1)
    lost = (latitude == 0.0) & (longitude == 0.0) | (np.abs(latitude) > 0.5 * np.pi)
    if "fix_status" in table:
        lost |= table.column("fix_status") < 0.0
    position[lost] = np.nan
    return position


_VALUES: Final[dict[str, Callable[[Table, Any], Floats]]] = {
    "depth": _depth_m,
    "heading": _heading_rad,
    "position": _position,
}
