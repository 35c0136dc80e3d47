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
    about : str
        Who writes it, and what is to be known of it, for the page of inputs.
    """

    fields: Fields
    conventions: Mapping[str, Any] = field(default_factory=dict)
    stamp: str = ""
    about: str = ""


Types = Mapping[str, KnownType]
"""By name; of two types that a log has, the earlier one is the better source."""

LOG_TIME: Final = "log_time"
"""The recorder's time of arrival, as a stamp."""

_G_UPSIDE_DOWN: Final = {"specific_force_unit": "g", "specific_force_axes": "-x-y-z"}
_BLUEYE_IMU: Final = {"specific_force": "imu.accelerometer", "angular_rate": "imu.gyroscope"}

IMU: Final[Types] = {
    "sensor_msgs/msg/Imu": KnownType(
        {
            "specific_force": "linear_acceleration",
            "angular_rate": "angular_velocity",
            "specific_force_var": "linear_acceleration_covariance[0]",
            "angular_rate_var": "angular_velocity_covariance[0]",
        }
    ),
    "interfaces/msg/IMU": KnownType(
        {
            "specific_force": "accelerometer_x, accelerometer_y, accelerometer_z",
            "angular_rate": "gyro_x, gyro_y, gyro_z",
        },
        stamp="system_timestamp",
    ),
    "blueye.protocol.Imu2Tel": KnownType(_BLUEYE_IMU, {"specific_force_unit": "g"}, LOG_TIME),
    "blueye.protocol.Imu1Tel": KnownType(_BLUEYE_IMU, _G_UPSIDE_DOWN, LOG_TIME),
    "blueye.protocol.CalibratedImuTel": KnownType(_BLUEYE_IMU, _G_UPSIDE_DOWN, LOG_TIME),
}
"""A variance of -1 says that the quantity is not measured. ``interfaces`` is Nortek's package for the Nucleus."""

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
        }
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
    ),
}
"""iXblue's angles are degrees with the pitch positive bow down, its velocity is forward-port-up."""

ODOMETRY: Final[Types] = {
    "nav_msgs/msg/Odometry": KnownType({"quaternion": "pose.pose.orientation", "velocity_b": "twist.twist.linear"})
}
"""East-north-up and forward-port-up, the twist in the child frame; the position has no known origin."""

_BLUEYE_SENSORS: Final = "position_estimate.navigation_sensors[*]"

FIX: Final[Types] = {
    "sensor_msgs/msg/NavSatFix": KnownType(
        {"latitude": "latitude", "longitude": "longitude", "height": "altitude", "fix_status": "status.status"}
    ),
    "geographic_msgs/msg/GeoPoseStamped": KnownType(
        {
            "latitude": "pose.position.latitude",
            "longitude": "pose.position.longitude",
            "height": "pose.position.altitude",
            "quaternion": "pose.orientation",
        }
    ),
    "blueye.protocol.PositionEstimateTel": KnownType(
        {
            "sensor_id": f"{_BLUEYE_SENSORS}.sensor_id",
            "sensor_valid": f"{_BLUEYE_SENSORS}.is_valid",
            "latitude": f"{_BLUEYE_SENSORS}.global_position.latitude",
            "longitude": f"{_BLUEYE_SENSORS}.global_position.longitude",
        },
        stamp=LOG_TIME,
    ),
}
"""A status below 0 says that there is no fix. Of the Blueye's sensors only the satellite receiver is independent."""

BLUEYE_GNSS: Final = 4
"""``NAVIGATION_SENSOR_ID_BLUEYE_GNSS``."""

TRUTH: Final[Types] = {
    "insdvl_msgs/msg/SensorBiases": KnownType({"accel_bias": "accel_bias_mps2", "gyro_bias": "gyro_bias_radps"})
}
