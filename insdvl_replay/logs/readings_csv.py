"""The readings of a dive as CSV files, for a user's program that reads no MCAP."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Columns, Dive, Floats
from insdvl_replay.core.states import DEG

_Table = tuple[str, Callable[[Dive], tuple[Columns, Floats] | None]]
"""Names of the columns after the time, and the readings with their numbers; None where the dive has no such sensor."""


def _imu(dive: Dive) -> tuple[Columns, Floats]:
    return dive.imu, np.column_stack([dive.imu.specific_force_b, dive.imu.angular_rate_b])


def _dvl(dive: Dive) -> tuple[Columns, Floats]:
    velocity_d = dive.dvl.velocity_d
    assert velocity_d is not None  # which a user's filter is given of any DVL
    return dive.dvl, velocity_d


def _sensor(name: str, *units: float) -> Callable[[Dive], tuple[Columns, Floats] | None]:
    """Return what gives the readings of a sensor, each number in its unit."""

    def readings(dive: Dive) -> tuple[Columns, Floats] | None:
        sensor = dive.sensors.get(name)
        if sensor is None:
            return None
        return sensor, sensor.values[:, : len(units)] / np.array(units)

    return readings


_TABLES: Final[Mapping[str, _Table]] = {
    "imu_csv": (
        "specific_force_x_mps2,specific_force_y_mps2,specific_force_z_mps2,"
        "angular_rate_x_radps,angular_rate_y_radps,angular_rate_z_radps",
        _imu,
    ),
    "dvl_csv": ("velocity_x_mps,velocity_y_mps,velocity_z_mps", _dvl),
    "depth_csv": ("depth_m", _sensor("depth", 1.0)),
    "heading_csv": ("heading_deg", _sensor("heading", DEG)),
    "position_csv": ("latitude_deg,longitude_deg,height_m", _sensor("position", DEG, DEG, 1.0)),
}
READING_FILES: Final = tuple(_TABLES)
"""Words in braces among a program's arguments that stand for such a file."""


def write_readings(path: Path, word: str, dive: Dive) -> None:
    """Write the readings that a word stands for; of a sensor that the dive does not have, the header alone.

    Numbers have all their digits. One that is not known is an empty cell.
    """
    names, readings = _TABLES[word]
    lines = [f"time_ns,{names}"]
    found = readings(dive)
    if found is not None:
        columns, numbers = found
        for time_ns, row in zip(columns.time_ns.tolist(), numbers.tolist(), strict=True):
            cells = [str(time_ns)]
            for number in row:
                cells.append("" if number != number else repr(number))
            lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n", "utf-8")
