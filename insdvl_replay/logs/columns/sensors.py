"""The sensors beside IMU and DVL: the types that hold them, and their readings in the project's units."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from insdvl_replay.core.config import Config, Depth, Heading, Position
from insdvl_replay.core.dive_columns import Floats, SensorColumns
from insdvl_replay.core.errors import ConfigError, LogError, Note
from insdvl_replay.core.states import BY_SENSOR, DEG, SENSORS, STANDARD_GRAVITY_MPS2
from insdvl_replay.geometry.frames import MAT_ENU_NED, MAT_FRD_FLU
from insdvl_replay.geometry.rotation import mat_from_rpy, quat_from_mat, rpy_from_mat
from insdvl_replay.logs.columns.clean import Cleaner
from insdvl_replay.logs.columns.known_types import LOG_TIME, TYPES, KnownType, Types, types_of
from insdvl_replay.logs.columns.reference import ANGLE_UNITS, attitude, is_by_quaternion, of_receiver
from insdvl_replay.logs.columns.tables import Table
from insdvl_replay.logs.columns.topics import TopicRequirement, requirement

_QUATERNION_DIGITS: Final = 12
_FIX_DIGITS: Final = 10  # decimals of the degrees of a fix: 11 um
_PRESSURE_DIGITS: Final = 1  # decimals of a pressure, Pa: a hundredth of a millimetre of water
_ATMOSPHERE_PA: Final = 101325.0
_SEA_WATER_KGPM3: Final = 1025.0
_POSED: Final = ("geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry")
_TURNS: Final = "from forward-port-up to east-north-up, or as `heading.axes` says"
PRESSURE_UNITS: Final = {"Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "dbar": 1e4, "bar": 1e5}

Readings = tuple[Floats, Floats | None]
"""Values, (k, s), the first NaN where there is no reading; attitudes that they are part of, (k, 3, 3)."""

Message = tuple[str, str, str, dict[str, Any]]
"""Topic, type, frame, and the columns of the fields."""


@dataclass(frozen=True)
class SensorTopic:
    """How a log holds a sensor of `core.states`."""

    read: Callable[[Table, Any], Readings]
    message: Callable[[Floats, Floats | None], Message]  # of values and attitudes, in the log of a simulated dive
    types: Sequence[Types]  # of several groups, the first that a log has is taken
    if_named: Types = field(default_factory=dict)  # too common to be taken unasked for what one of their fields holds


def sensor_requirement(name: str, config: Config) -> TopicRequirement:
    """State what a sensor needs of a topic."""
    sensor, held = SENSORS[name], SENSOR_TOPICS[name]
    return requirement(
        getattr(config, name),
        name,
        sensor.quantities,
        by_type=held.types,
        if_named=held.if_named,
        enough=sensor.enough,
        together=[sensor.together],
    )


def decode_sensor(name: str, table: Table, config: Config) -> tuple[SensorColumns, list[Note]]:
    """Make the columns of a sensor; a `LogError` where no reading can be used."""
    settings = table.source.completed(getattr(config, name))
    (values, mat_nb), cleaner = SENSOR_TOPICS[name].read(table, settings), Cleaner(table)
    cleaner.keep_finite(values[:, :1], reason=f"messages hold no {name}")
    if "sensor_id" in table:
        cleaner.drop_repeated_values(values)
    cleaner.drop_repeated_times(values)
    cleaner.require_rows()
    # Of a dive of hours the attitudes take more memory than the IMU's readings.
    wanted = mat_nb is not None and config.initial.source == BY_SENSOR
    kept_mat_nb = cleaner.kept(mat_nb) if wanted and mat_nb is not None else None
    return SensorColumns(cleaner.times, cleaner.kept(values), kept_mat_nb), cleaner.notes


def decode_own_topic(table: Table) -> tuple[SensorColumns, list[Note]]:
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


def _pressure_message(depth_m: Floats, _: Floats | None) -> Message:
    pressure_pa = _ATMOSPHERE_PA + _SEA_WATER_KGPM3 * STANDARD_GRAVITY_MPS2 * depth_m[:, 0]
    columns = {"fluid_pressure": np.round(pressure_pa, _PRESSURE_DIGITS), "variance": 0.0}
    return "/pressure", "sensor_msgs/msg/FluidPressure", "imu", columns


def _heading(table: Table, settings: Heading) -> Readings:
    """Return the true heading, (k, 1), and the attitude that it is part of; NaN where a message has none."""
    declination, turned = settings.declination_deg * DEG, any(settings.mounting_rpy_deg)
    heading_alone = settings.heading is not None and settings.quaternion is None and settings.roll is None
    if not heading_alone and settings.angle_unit != "deg" and is_by_quaternion(table, settings):
        raise ConfigError(
            "heading.angle_unit is of a heading, roll and pitch, and the messages hold a quaternion",
            "leave it out; heading.heading names an angle in its place",
        )
    mat = None if heading_alone else attitude(table, settings)  # from magnetic or true north
    if mat is None:
        if turned:
            raise ConfigError(
                "heading.mounting_rpy_deg turns an attitude, and the messages hold a heading alone",
                "heading.declination_deg takes what it is off by",
            )
        heading = table.column("heading") * ANGLE_UNITS[settings.angle_unit]
        return np.asarray((heading + declination)[:, None]), None
    if turned:
        mat = np.asarray(mat @ mat_from_rpy(np.array(settings.mounting_rpy_deg) * DEG).T)
    if "quaternion_var" in table:
        without = table.column("quaternion_var") < 0.0
        if without.all():
            text = "all messages say that they hold no orientation"
            raise LogError(text, "heading.topic names another", *table.where)
        mat[without] = np.nan
    heading = rpy_from_mat(mat)[:, 2] + declination
    return np.asarray(heading[:, None]), mat_from_rpy(np.array([0.0, 0.0, declination])) @ mat


def _attitude_message(heading: Floats, mat_nb: Floats | None) -> Message:
    """Return the attitude, level where it is not known, east-north-up and forward-port-up, as its type has it."""
    if mat_nb is None:
        mat_nb = mat_from_rpy(np.concatenate([np.zeros((len(heading), 2)), heading], axis=1))
    quat = np.round(quat_from_mat(MAT_ENU_NED.T @ mat_nb @ MAT_FRD_FLU.T), _QUATERNION_DIGITS)
    columns = {f"quaternion.{axis}": column for axis, column in zip("xyzw", quat.T, strict=True)}
    return "/ahrs", "geometry_msgs/msg/QuaternionStamped", "base_link", columns


def _position(table: Table, settings: Position) -> Readings:
    """Return latitude rad, longitude rad, height m, (k, 3): NaN where there was no fix.

    A fix without height is none where heights are used, and else one whose height alone is NaN.
    """
    unit = ANGLE_UNITS[settings.angle_unit]
    latitude, longitude = (of_receiver(table, name) * unit for name in ("latitude", "longitude"))
    polar = np.abs(latitude) > 0.5 * np.pi
    count, known = int(polar.sum()), int(np.isfinite(latitude).sum())
    if 2 * count > known:
        furthest = latitude[np.nanargmax(np.abs(latitude))] / unit
        raise LogError(
            f"{count} of {known} latitudes are beyond the poles, up to {furthest:.6g} {settings.angle_unit}",
            'position.angle_unit = "deg" or "rad", or position.latitude = "field.path" names another field',
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


def _fix_message(position: Floats, _: Floats | None) -> Message:
    latitude_deg, longitude_deg = np.round(np.rad2deg(position[:, :2]), _FIX_DIGITS).T
    columns = {"latitude": latitude_deg, "longitude": longitude_deg, "altitude": np.round(position[:, 2], 4)}
    return "/gnss", "sensor_msgs/msg/NavSatFix", "base_link", columns


SENSOR_TOPICS: Final[dict[str, SensorTopic]] = {
    "depth": SensorTopic(
        _depth,
        _pressure_message,
        [
            types_of(
                KnownType(("sensor_msgs/msg/FluidPressure",), {"pressure": "fluid_pressure"}, about="Pa"),
                KnownType(("blueye.protocol.DepthTel",), {"depth": "depth.value"}, stamp=LOG_TIME, about="Blueye X3"),
            )
        ],
        types_of(
            KnownType(_POSED, {"height": "pose.pose.position.z"}, about="if `depth.topic` names it; metres upwards")
        ),
    ),
    "heading": SensorTopic(
        _heading,
        _attitude_message,
        [
            types_of(KnownType(("geometry_msgs/msg/QuaternionStamped",), {"quaternion": "quaternion"}, about=_TURNS)),
            types_of(
                KnownType(
                    ("sensor_msgs/msg/Imu",),
                    {"quaternion": "orientation", "quaternion_var": "orientation_covariance[0]"},
                    about=f"{_TURNS}; a first covariance of -1 says that there is none",
                )
            ),
        ],
        types_of(
            KnownType(_POSED, {"quaternion": "pose.pose.orientation"}, about=f"if `heading.topic` names it; {_TURNS}")
        ),
    ),
    "position": SensorTopic(_position, _fix_message, [TYPES["fix"], TYPES["extended_fix"]]),
}
