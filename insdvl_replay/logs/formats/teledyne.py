"""What Teledyne's formats share: coordinates, clocks, attitude and depth.

Sources: Teledyne RD Instruments, "Pathfinder DVL Guide", 95B-6116-00, April 2018, and "ADCP Coordinate Transformation:
Formulas and Calculations", 951-6079-00, January 2010.

Axes of the instrument: x from beam 1 to beam 2, y from beam 4 to beam 3, z towards the transducer. Axes of the ship:
starboard, forward, up. Axes of the earth: east, north, up. Beam 3 is forward; seen from above, beam 2 of an instrument
that looks down is starboard of it, and port of it for one that looks up.
"""

from collections.abc import Iterator, Mapping
from enum import IntEnum
from typing import Any, Final

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Array, Floats, Integers, Mask, TimeNs
from insdvl_replay.core.states import DEG
from insdvl_replay.core.units import TIME_UNITS_NS
from insdvl_replay.logs.formats.instrument_file import InstrumentTable

Fields = Mapping[str, tuple[str, int]]
"""Fields of a structure by name: their format, and their first byte, which counts from 1 as in the manuals."""

MISSING: Final = -32768  # mm/s, of a velocity that is none
VELOCITY: Final = "dvl/velocity"
BOTTOM_TRACK: Final = "teledyne.bottom_track"
RECORD_PD0: Final = "record PD0, which has all that is needed, or ship coordinates (EX10000)"


class Coordinates(IntEnum):
    """The axes of velocities, by the two bits that the command EX sets."""

    BEAM = 0
    INSTRUMENT = 1
    SHIP = 2
    EARTH = 3


def structure(
    fields: Fields,
    size: int,
) -> np.dtype[Any]:
    """Return the structure of so many bytes in which fields are read."""
    layout: Any = {
        "names": list(fields),
        "formats": [format_ for format_, _ in fields.values()],
        "offsets": [byte - 1 for _, byte in fields.values()],
        "itemsize": size,
    }
    found: np.dtype[Any] = np.dtype(layout)
    return found


def metres_per_second(velocity_mmps: Array) -> Floats:
    """Return velocities in m/s, NaN where there is none."""
    return np.where(velocity_mmps == MISSING, np.nan, velocity_mmps * 1e-3)


def with_z_down(axes_mps: Floats) -> Floats:
    """Return velocities starboard, forward, up as forward, starboard, down; east, north, up as north, east, down."""
    right = axes_mps[:, 0]
    ahead = axes_mps[:, 1]
    return np.column_stack([ahead, right, -axes_mps[:, 2]])


def attitude_deg(
    pitch_deg: Floats,
    roll_deg: Floats,
    heading_deg: Floats,
) -> Floats:
    """Return roll, pitch, heading, (k, 3), deg, of tilts as the sensor measures them.

    It measures both tilts from the horizon, so that the pitch depends on the roll.
    """
    tangent = np.tan(pitch_deg * DEG) * np.cos(roll_deg * DEG)
    return np.column_stack([roll_deg, np.arctan(tangent) / DEG, heading_deg])


def clock_ns(fields: Integers) -> tuple[TimeNs, Mask]:
    """Return times, (k,), and which of them can be, of year, month, day, hour, minute, second, hundredth, (k, 7)."""
    year, month, day = fields[:, :3].T
    in_day_ns, known = time_of_day_ns(fields[:, 3:])
    known &= (year >= 1970) & (year < 2200) & (month >= 1) & (month <= 12)
    months = np.where(known, 12 * (year - 1970) + month - 1, 0).astype("M8[M]")
    days = months.astype("M8[D]") + (np.where(known, day, 1) - 1)
    known &= days.astype("M8[M]") == months
    since_1970_ns = days.astype(np.int64) * TIME_UNITS_NS["d"]
    return since_1970_ns + in_day_ns, known


def time_of_day_ns(fields: Integers) -> tuple[TimeNs, Mask]:
    """Return times of day, (k,), and which of them can be, of hour, minute, second, hundredth, (k, 4)."""
    known = (fields >= 0).all(axis=1) & (fields < [24, 60, 60, 100]).all(axis=1)
    hundredths = np.where(known, fields @ [360_000, 6_000, 100, 1], 0)
    return hundredths * (NS_PER_S // 100), np.asarray(known)


def sensor_tables(
    time_ns: TimeNs,
    rpy_deg: Floats,
    depth: str,
    values: Floats,
) -> Iterator[InstrumentTable]:
    """Give the tables of attitude and of depth, each where it was measured: what a person has set is always the same.

    The depth is a ``depth``, m, or a ``pressure``, Pa.
    """
    if _changes(rpy_deg[:, 2]):
        roll, pitch, heading = rpy_deg.T
        columns = {"roll": roll, "pitch": pitch, "heading": heading}
        yield InstrumentTable(
            "dvl/attitude",
            "teledyne.attitude",
            time_ns,
            columns,
        )
    if _changes(values):
        yield InstrumentTable(
            "dvl/depth",
            "teledyne.depth",
            time_ns,
            {depth: values},
        )


def _changes(values: Floats) -> bool:
    known = values[np.isfinite(values)]
    return bool(len(known)) and float(np.ptp(known)) > 0.0
