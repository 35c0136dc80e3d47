"""The message types that are known by name: which quantity stands in which field, and in which units and axes.

Every other type is read by the field paths of the configuration. Those of a DVL are in `known_dvls`. Sources: the
definitions in the public repositories of the packages, and the Blueye protocol's descriptors.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

Fields = Mapping[str, str]
"""Path of the field by the quantity that it holds."""


@dataclass(frozen=True)
class KnownType:
    """What is known of a message type.

    Attributes
    ----------
    fields : mapping of str to str
        Path of the field by the quantity that it holds; logs whose schema lacks one of them do without.
    conventions : mapping of str to Any
        Values for keys of the role's section in the configuration that are left out there.
    stamp : str
        Where the time of validity stands; empty for the header, or the recorder's log time where there is none.
    element : tuple of str
        Of a list in the messages: its field, and the texts in its elements by which settings tell which count.
    about : str
        Who writes it, and what is to be known of it, for the page of inputs.
    """

    fields: Fields
    conventions: Mapping[str, Any] = field(default_factory=dict)
    stamp: str = ""
    about: str = ""
    element: tuple[str, ...] = ()


Types = Mapping[str, KnownType]
"""By name; of two types that a log has, the earlier one is the better source."""

LOG_TIME: Final = "log_time"
"""The recorder's time of arrival, as a stamp."""

_G_UPSIDE_DOWN: Final = {"specific_force_unit": "g", "specific_force_axes": "-x-y-z"}
_BLUEYE: Final = "Blueye X3; specific force in g"
_BLUEYE_IMU: Final = {"specific_force": "imu.accelerometer", "angular_rate": "imu.gyroscope"}

IMU: Final[Types] = {
    "sensor_msgs/msg/Imu": KnownType(
        {
            "specific_force": "linear_acceleration",
            "angular_rate": "angular_velocity",
            "specific_force_var": "linear_acceleration_covariance[0]",
            "angular_rate_var": "angular_velocity_covariance[0]",
        },
        about="specific force in m/s^2 and rad/s; axes as `imu.axes` says, forward-starboard-down if nothing does",
    ),
    "interfaces/msg/IMU": KnownType(
        {
            "specific_force": "accelerometer_x, accelerometer_y, accelerometer_z",
            "angular_rate": "gyro_x, gyro_y, gyro_z",
        },
        stamp="system_timestamp",
        about="Nortek Nucleus",
    ),
    "px4_msgs/msg/VehicleImu": KnownType(
        {
            "specific_force": "delta_velocity",
            "angular_rate": "delta_angle",
            "force_interval_us": "delta_velocity_dt",
            "rate_interval_us": "delta_angle_dt",
            "interval_us": "delta_angle_dt",
        },
        stamp="timestamp_sample",
        about="PX4; increments over their intervals, forward-starboard-down; the stamp is the end of the interval, and "
        "the middle of it is taken",
    ),
    "px4_msgs/msg/SensorCombined": KnownType(
        {"specific_force": "accelerometer_m_s2", "angular_rate": "gyro_rad", "interval_us": "gyro_integral_dt"},
        stamp="timestamp",
        about="PX4; means over an interval, forward-starboard-down; the middle of the interval is taken",
    ),
    "blueye.protocol.Imu2Tel": KnownType(_BLUEYE_IMU, {"specific_force_unit": "g"}, LOG_TIME, _BLUEYE),
    "blueye.protocol.Imu1Tel": KnownType(_BLUEYE_IMU, _G_UPSIDE_DOWN, LOG_TIME, _BLUEYE),
    "blueye.protocol.CalibratedImuTel": KnownType(_BLUEYE_IMU, _G_UPSIDE_DOWN, LOG_TIME, _BLUEYE),
}
"""A variance of -1 says that the quantity is not measured. ``interfaces`` is Nortek's package for the Nucleus. What is
given with an interval is an increment over it, and what has one at all is of its middle; PX4 counts in microseconds."""

_VECTORNAV: Final = (
    "VectorNav, {0}; what its user has not switched on is zero and no reading; stamped by the computer as it came in"
)
IMU_OF_DRIVERS: Final[Types] = {
    "sbg_driver/msg/SbgImuData": KnownType(
        {"specific_force": "accel", "angular_rate": "gyro"},
        about='SBG Systems; axes of the device, and `imu.axes = "+y+x-z"` where its driver was set to ENU',
    ),
    "vectornav_msgs/msg/CommonGroup": KnownType(
        {"specific_force": "imu_accel", "angular_rate": "imu_rate"},
        about=_VECTORNAV.format("the readings without what its own filter takes off them"),
    ),
    "vectornav_msgs/msg/ImuGroup": KnownType(
        {"specific_force": "uncompaccel", "angular_rate": "uncompgyro"},
        about=_VECTORNAV.format("likewise"),
    ),
}
"""What drivers write beside a `sensor_msgs/Imu`, of which the latter is taken. Sources:
SBG-Systems/sbg_ros2_driver@5a543fb; dawonn/vectornav@3f13c4b."""

NAV_SOLUTION: Final[Types] = {
    "insdvl_msgs/msg/NavSolution": KnownType(
        {
            "latitude": "latitude_deg",
            "longitude": "longitude_deg",
            "height": "height_m",
            "velocity_n": "velocity_ned_mps",
            "roll": "roll_deg",
            "pitch": "pitch_deg",
            "heading": "heading_deg",
        },
        about="written by this program",
    ),
    "ixblue_ins_msgs/msg/Ins": KnownType(
        {
            "latitude": "latitude",
            "longitude": "longitude",
            "height": "altitude",
            "velocity_b": "speed_vessel_frame",
            "roll": "roll",
            "pitch_bow_down": "pitch",
            "heading": "heading",
        },
        {"axes": "enu_flu"},
        about="iXblue, now Exail: position, velocity, attitude",
    ),
}
"""iXblue's angles are degrees with the pitch positive bow down, its velocity is forward-port-up."""

_LOCAL: Final = (
    "if `reference.topic` names it; attitude, and positions in metres east-north-up from the place of `[initial]`, "
    "whose `latitude_deg` must be set"
)

ODOMETRY: Final[Types] = {
    "nav_msgs/msg/Odometry": KnownType(
        {
            "quaternion": "pose.pose.orientation",
            "velocity_b": "twist.twist.linear",
            "local_position": "pose.pose.position",
        },
        about="velocity in the body, attitude and position, east-north-up and forward-port-up; positions are in metres "
        "from the place of `[initial]`, whose `latitude_deg` must be set, and left out where the log has fixes",
    ),
    "px4_msgs/msg/VehicleOdometry": KnownType(
        {
            "quaternion": "q[1], q[2], q[3], q[0]",
            "pose_frame": "pose_frame",
            "local_frame": "local_frame",
            "velocity_n": "velocity",
            "velocity_b": "velocity",
            "velocity_frame": "velocity_frame",
            "local_position": "position",
        },
        {"axes": "ned_frd"},
        "timestamp_sample",
        "PX4; attitude, position and velocity where their frames are north-east-down or the body, since others have no "
        "north",
    ),
}
"""East-north-up and forward-port-up, the twist in the child frame; the position is from an origin that no message
tells. PX4's pose frame is 1, and that of its older messages 0, for north-east-down; its velocity frame 1 for that and 3
for the body."""

_TRANSFORMS: Final = KnownType(
    {
        "quaternion": "transforms[*].transform.rotation",
        "local_position": "transforms[*].transform.translation",
    },
    stamp="transforms[*].header.stamp",
    about=f'{_LOCAL}; `reference.frames` names parent and child, as `["map", "base_link"]`, whose transform stands in '
    "the messages as such: a chain of several is not composed",
    element=("transforms", "header.frame_id", "child_frame_id"),
)

POSES: Final[Types] = {
    "geometry_msgs/msg/PoseStamped": KnownType(
        {"quaternion": "pose.orientation", "local_position": "pose.position"}, about=_LOCAL
    ),
    "geometry_msgs/msg/PoseWithCovarianceStamped": KnownType(
        {"quaternion": "pose.pose.orientation", "local_position": "pose.pose.position"}, about=_LOCAL
    ),
    **dict.fromkeys(("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"), _TRANSFORMS),
    "px4_msgs/msg/VehicleLocalPosition": KnownType(
        {
            "velocity_n": "vx, vy, vz",
            "velocity_valid": "v_xy_valid, v_z_valid",
            "local_position": "x, y, z",
            "local_valid": "xy_valid, z_valid",
            "origin": "ref_lat, ref_lon, ref_alt",
            "origin_valid": "xy_global",
        },
        {"axes": "ned_frd"},
        "timestamp_sample",
        "PX4, if `reference.topic` names it; positions from the origin in the message, else from `[initial]`",
    ),
}
"""Only if the configuration names their topic: goals and set points are of the same types."""

_BLUEYE_SENSORS: Final = "position_estimate.navigation_sensors[*]"

FIX: Final[Types] = {
    "sensor_msgs/msg/NavSatFix": KnownType(
        {"latitude": "latitude", "longitude": "longitude", "height": "altitude", "fix_status": "status.status"},
        about="positions with a fix",
    ),
    "px4_msgs/msg/SensorGps": KnownType(
        {
            "latitude": "latitude_deg",
            "longitude": "longitude_deg",
            "height": "altitude_ellipsoid_m",
            "fix_type": "fix_type",
        },
        stamp="timestamp",
        about="PX4 since 1.14; positions with a fix of two dimensions at least",
    ),
    "geographic_msgs/msg/GeoPoseStamped": KnownType(
        {
            "latitude": "pose.position.latitude",
            "longitude": "pose.position.longitude",
            "height": "pose.position.altitude",
            "quaternion": "pose.orientation",
        },
        about="positions and attitude",
    ),
    "blueye.protocol.PositionEstimateTel": KnownType(
        {
            "sensor_id": f"{_BLUEYE_SENSORS}.sensor_id",
            "sensor_valid": f"{_BLUEYE_SENSORS}.is_valid",
            "latitude": f"{_BLUEYE_SENSORS}.global_position.latitude",
            "longitude": f"{_BLUEYE_SENSORS}.global_position.longitude",
        },
        stamp=LOG_TIME,
        about="Blueye X3: of its sensors the satellite receiver",
    ),
}
"""A status below 0 says that there is no fix, and so does a type of fix below 2.
Of the Blueye's sensors only the satellite receiver is independent."""

EXTENDED_FIX: Final[Types] = {
    "gps_msgs/msg/GPSFix": KnownType(
        {"latitude": "latitude", "longitude": "longitude", "height": "altitude", "fix_status": "status.status"},
        about="positions with a fix",
    ),
}
"""What receivers write beside a NavSatFix, of which the latter is taken."""

BLUEYE_GNSS: Final = 4
"""``NAVIGATION_SENSOR_ID_BLUEYE_GNSS``."""


def _upper(path: str, size: int) -> str:
    """Name the upper triangle of the first rows of a covariance of six: a third of what its messages repeat."""
    return ", ".join(f"{path}[{6 * row + column}]" for row in range(size) for column in range(row, size))


def _with(known: KnownType, **more: str) -> KnownType:
    return KnownType({**known.fields, **more})


_POSE, _TWIST = _upper("pose.covariance", 6), _upper("twist.covariance", 3)
_ODOMETRY, _POSED = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped"

SOLUTIONS: Final[Types] = {
    **NAV_SOLUTION,
    **ODOMETRY,
    **POSES,
    **FIX,
    _ODOMETRY: _with(ODOMETRY[_ODOMETRY], pose_cov=_POSE, twist_cov=_TWIST),
    _POSED: _with(POSES[_POSED], pose_cov=_POSE),
    "blueye.protocol.PositionEstimateTel": KnownType(
        {axis: f"position_estimate.global_position.{axis}" for axis in ("latitude", "longitude")}, stamp=LOG_TIME
    ),
}
"""Of a solution of the vehicle's own, whose topic is always named: what it says of its errors is read, too. Of the
Blueye the estimate of all its sensors together."""

TRUTH: Final[Types] = {
    "insdvl_msgs/msg/SensorBiases": KnownType(
        {"accel_bias": "accel_bias_mps2", "gyro_bias": "gyro_bias_radps"}, about="written by `simulate`"
    )
}
