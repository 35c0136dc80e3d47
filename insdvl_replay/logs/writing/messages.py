"""Columns become messages: a `Batch` names for each column the field that it fills.

`dive_log` and `replay_log` say what goes where; `writer` serialises it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.columns import NS_PER_S, Floats, TimeNs

NED: Final = "ned"
IMU: Final = "imu"
DVL: Final = "dvl"
ODOM: Final = "odom"
BASE_LINK: Final = "base_link"

FRAMES: Final = {
    NED: "north-east-down at the vehicle",
    IMU: "the body: forward-starboard-down at the IMU",
    DVL: "the DVL: forward-starboard-down of the instrument",
    ODOM: "east-north-up at the first position",
    BASE_LINK: "the body with the axes forward-port-up",
}
"""What the names in ``frame_id`` mean."""


@dataclass(frozen=True)
class InUnit:
    """A column in another unit, which is converted as it is written: a copy would take as much memory as the history.

    Attributes
    ----------
    values : ndarray, shape (k,) or (k, n)
        SI units.
    unit : float
        One unit in SI.
    """

    values: Floats
    unit: float

    def __getitem__(self, rows: slice) -> Floats:
        """Return some rows in the unit."""
        return self.values[rows] / self.unit


Column = NDArray[Any] | InUnit | str | float | tuple[float, ...]
"""Values of one field: an array with one row per message, or what all messages share."""


@dataclass(frozen=True)
class Batch:
    """Messages of one topic whose strings are the same, as columns.

    Attributes
    ----------
    topic, type_name : str
        Where they go, and of which type they are.
    time_ns : ndarray, shape (k,)
        Times of validity, not decreasing.
    columns : mapping of str to Column
        By the path of the field, such as ``header.stamp.sec``. Fields that are not named stay zero.
    """

    topic: str
    type_name: str
    time_ns: TimeNs
    columns: Mapping[str, Column]


def stamped(topic: str, type_name: str, time_ns: TimeNs, frame: str, columns: Mapping[str, Column]) -> Batch:
    """Make a batch of messages that begin with a header.

    Parameters
    ----------
    time_ns : ndarray, shape (k,)
    frame : str
        One of `FRAMES`.
    """
    return Batch(topic, type_name, time_ns, {**stamp("header.stamp", time_ns), "header.frame_id": frame, **columns})


def stamp(path: str, time_ns: TimeNs) -> dict[str, Column]:
    """Fill a builtin_interfaces/Time.

    Parameters
    ----------
    path : str
        Of the field.
    time_ns : ndarray, shape (k,)
    """
    seconds, nanoseconds = np.divmod(time_ns, NS_PER_S)
    return {f"{path}.sec": seconds.astype(np.int32), f"{path}.nanosec": nanoseconds.astype(np.uint32)}


def xyz(path: str, vectors: Floats) -> dict[str, Column]:
    """Fill a geometry_msgs/Vector3 or Point.

    Parameters
    ----------
    path : str
        Of the field.
    vectors : ndarray, shape (k, 3)
    """
    return {f"{path}.{axis}": vectors[:, i] for i, axis in enumerate("xyz")}


def missing_xyz(path: str) -> dict[str, Column]:
    """Fill a geometry_msgs/Vector3 with NaN, for what is not known."""
    return {f"{path}.{axis}": np.nan for axis in "xyz"}


def solution(position: Floats, velocity_n: Floats, rpy: Floats) -> dict[str, Column]:
    """Fill the fields that insdvl_msgs/NavSolution and FilterState share.

    Parameters
    ----------
    position : ndarray, shape (k, 3)
        Latitude rad, longitude rad, height m.
    velocity_n : ndarray, shape (k, 3)
    rpy : ndarray, shape (k, 3), rad
    """
    latitude_deg, longitude_deg = np.rad2deg(position[:, :2]).T
    return {
        "latitude_deg": latitude_deg,
        "longitude_deg": longitude_deg,
        "height_m": position[:, 2],
        "velocity_ned_mps": velocity_n,
        **angles(rpy),
    }


def angles(rpy: Floats) -> dict[str, Column]:
    """Fill roll, pitch, heading.

    Parameters
    ----------
    rpy : ndarray, shape (k, 3), rad
    """
    roll_deg, pitch_deg, heading_deg = np.rad2deg(rpy).T
    return {"roll_deg": roll_deg, "pitch_deg": pitch_deg, "heading_deg": heading_deg}
