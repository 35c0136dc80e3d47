"""The readings of the sensors beside IMU and DVL, in the project's units and signs, and clean."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from insdvl_replay.core.config import Config, Depth
from insdvl_replay.core.dive_columns import Floats, SensorColumns
from insdvl_replay.core.errors import Note
from insdvl_replay.core.states import STANDARD_GRAVITY_MPS2
from insdvl_replay.logs.columns.cleaning import Cleaner
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


_VALUES: Final[dict[str, Callable[[Table, Any], Floats]]] = {"depth": _depth_m}
