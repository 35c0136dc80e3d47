"""Logs of PX4's vehicles (.ulg): which of their topics are IMU, DVL, fixes and the EKF; their types are px4_msgs'.

Axes are forward-starboard-down and north-east-down. Times are since the start of the vehicle, which its receiver brings
to UTC. A DVL is what was sent to the vehicle as visual odometry in the axes of the body. Source: PX4/px4_msgs, and
the comments of VehicleOdometry.msg on frames.
"""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Array, Integers
from insdvl_replay.logs.formats.instrument_file import LATEST_S, InstrumentTable
from insdvl_replay.logs.formats.ulog import Messages, UlogFile, single_counts

_IMUS: Final = ("vehicle_imu", "sensor_combined")
_FIXES: Final = ("vehicle_gps_position", "sensor_gps")
_TYPES: Final = {
    "vehicle_imu": "px4_msgs/msg/VehicleImu",
    "sensor_combined": "px4_msgs/msg/SensorCombined",
    "vehicle_visual_odometry": "px4.visual_odometry",
    "vehicle_gps_position": "px4_msgs/msg/SensorGps",
    "sensor_gps": "px4_msgs/msg/SensorGps",
    "vehicle_odometry": "px4_msgs/msg/VehicleOdometry",
    "vehicle_local_position": "px4_msgs/msg/VehicleLocalPosition",
    "vehicle_attitude": "px4_msgs/msg/VehicleAttitude",
}
_SAMPLED: Final = "timestamp_sample"  # time of validity, where a topic has it
_NOT_READ: Final = (
    "timestamp",
    _SAMPLED,
)  # numbers of 64 bits; the times of the rows have them exactly
# Of older versions: vectors by their parts, and numbers in other units.
_JOINED: Final = {"position": ("x", "y", "z"), "velocity": ("vx", "vy", "vz")}
_SCALED: Final = {
    "latitude_deg": ("lat", 1e-7),
    "longitude_deg": ("lon", 1e-7),
    "altitude_ellipsoid_m": ("alt_ellipsoid", 1e-3),
}
_IN_BODY: Final = 3  # a frame of a velocity
_FIX_3D: Final = 3


class Px4File(UlogFile):
    """A log of a vehicle."""

    def tables(self) -> Iterator[InstrumentTable]:
        """Decode the messages."""
        found = self.read_messages(_TYPES.keys())
        start_us = _vehicle_start_us(found)
        mains = [_most(found, _IMUS), _first(found, _FIXES)]
        for name in _TYPES:
            if name not in (*_IMUS, *_FIXES):
                mains.append(_first(found, (name,)))
        for key, rows in found.items():
            yield _table(key, rows, start_us, is_main=key in mains)


def _first(found: Messages, names: Sequence[str]) -> tuple[str, int] | None:
    """Return the first of some topics that a log has, with its first instance."""
    keys = [key for key in found if key[0] in names]
    return min(keys, key=lambda key: (names.index(key[0]), key[1]), default=None)


def _most(found: Messages, names: Sequence[str]) -> tuple[str, int] | None:
    """Return which of some topics has the most messages: others may be logged too slowly to be replayed."""
    keys = sorted(key for key in found if key[0] in names)
    return max(keys, key=lambda key: len(found[key]), default=None)


def _vehicle_start_us(found: Messages) -> int:
    """Return the time of the vehicle's start since 1970, by the times of its receiver; 0 without a fix."""
    for name in _FIXES:
        rows = found.get((name, 0))
        if rows is None or not {"time_utc_usec", "fix_type"} <= single_counts(rows):
            continue
        fixed = rows[(rows["fix_type"] >= _FIX_3D) & (rows["time_utc_usec"] > 0)]
        starts_us = fixed["time_utc_usec"].astype(np.int64) - fixed["timestamp"].astype(np.int64)
        if len(starts_us) and 0 < np.median(starts_us) < 5e5 * LATEST_S:
            return int(np.median(starts_us))
    return 0


def _table(
    key: tuple[str, int],
    rows: Array,
    start_us: int,
    *,
    is_main: bool,
) -> InstrumentTable:
    """Make a table of messages; only the main one of a role has the type by which it is found."""
    name, instance = key
    columns: dict[str, Array] = {}
    for label in rows.dtype.names or ():
        is_number = rows.dtype[label].base.kind in "iuf"
        if is_number and label not in _NOT_READ and not label.startswith("_"):
            columns[label] = rows[label].astype(np.float64)
    _add_newer(columns)
    topic = name
    type_name = _TYPES[name]
    if not is_main:
        topic += f"/{instance}"
        type_name = f"px4.{name}_other"
    time_us = _time_us(name, rows) + start_us
    return InstrumentTable(topic, type_name, 1000 * time_us, columns)


def _add_newer(columns: dict[str, Array]) -> None:
    """Add columns that older versions have under other names, and whether a velocity is in the axes of the body."""
    single = {label for label, values in columns.items() if values.ndim == 1}
    for label, parts in _JOINED.items():
        if label not in columns and single.issuperset(parts):
            columns[label] = np.stack([columns[part] for part in parts], axis=1)
    for label, (older, factor) in _SCALED.items():
        if label not in columns and older in columns:
            columns[label] = factor * columns[older]
    if "velocity_frame" in columns:
        columns["is_in_body"] = (columns["velocity_frame"] == _IN_BODY).astype(np.float64)


def _time_us(name: str, rows: Array) -> Integers:
    """Return the times of validity, (k,): of fixes those of the messages, as their type has it."""
    time_us = rows["timestamp"].astype(np.int64)
    if name in _FIXES or _SAMPLED not in single_counts(rows):
        return time_us
    sampled_us = rows[_SAMPLED].astype(np.int64)
    # Later than its message no sample is.
    return np.where((sampled_us > 0) & (sampled_us <= time_us), sampled_us, time_us)
