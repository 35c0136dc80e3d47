"""The message types that are known by name: which quantity stands in which field, and in which units and axes.

Every other type is read by the field paths of the configuration. Sources: the definitions in the public repositories of
the packages, the Blueye protocol's descriptors, and the makers' manuals for the beams.
"""

from collections.abc import Mapping, Sequence
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
    """

    fields: Fields
    conventions: Mapping[str, Any] = field(default_factory=dict)
    stamp: str = ""


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

DVL_BEAMS: Final[Types] = {
    "marine_acoustic_msgs/msg/Dvl": KnownType(
        {
            "mode": "velocity_mode",
            "velocity": "velocity",
            "altitude": "altitude",
            "good_beams": "num_good_beams",
            "beams_valid": "beam_velocities_valid",
            "beam_velocity": "beam_velocity",
            "beam_vectors": "beam_unit_vec",
            "beam_ranges": "range",
        }
    ),
    # The beams of Water Linked's A50 and A125, which both drivers number from behind starboard clockwise.
    "dvl_msgs/msg/DVL": KnownType(
        {
            "velocity": "velocity",
            "valid": "velocity_valid",
            "beam_velocity": "beams[*].velocity",
            "beam_valid": "beams[*].valid",
        },
        {"beam_tilt_deg": 22.5, "beam_azimuth_deg": (135.0, 225.0, 315.0, 45.0)},
        "time_of_validity",
    ),
    # The Blueye turns the velocity of its A50, which looks backwards, into the vehicle's axes, and leaves the beams be:
    # in these axes they stand half a turn further.
    "blueye.protocol.DvlVelocityTel": KnownType(
        {
            "velocity": "dvl_velocity.velocity",
            "status": "dvl_velocity.status",
            "water_track": "dvl_velocity.is_water_tracking",
            "beam_velocity": "dvl_velocity.transducers[*].velocity",
            "beam_valid": "dvl_velocity.transducers[*].beam_valid",
        },
        {"beam_tilt_deg": 22.5, "beam_azimuth_deg": (315.0, 45.0, 135.0, 225.0)},
        LOG_TIME,
    ),
    # No message tells where the three beams of a Nucleus point: its velocity is taken unless the configuration tells.
    "interfaces/msg/BottomTrack": KnownType(
        {
            "velocity": "velocity_x, velocity_y, velocity_z",
            "valid": "x_velocity_valid, y_velocity_valid, z_velocity_valid",
            "beam_velocity": "velocity_beam_1, velocity_beam_2, velocity_beam_3",
            "beam_valid": "beam_1_velocity_valid, beam_2_velocity_valid, beam_3_velocity_valid",
        },
        {"kind": "velocity"},
        "system_timestamp",
    ),
    # The raw velocities are along the beams only in one of four modes, which most drivers do not use.
    "ds_sensor_msgs/msg/Dvl": KnownType(
        {
            "mode": "velocity_mode",
            "coordinates": "coordinate_mode",
            "velocity": "velocity",
            "good_beams": "num_good_beams",
            "beam_velocity": "raw_velocity",
            "beam_vectors": "beam_unit_vec",
        },
        {"kind": "velocity"},
    ),
}
"""Mode 1 is bottom track, 2 water track; coordinates 0 are along the beams, 1 of the instrument; a status below 0 and
flags that are 0 say that there is no velocity."""

DVL_VELOCITY: Final[Types] = {
    "geometry_msgs/msg/TwistStamped": KnownType({"velocity": "twist.linear"}),
    "geometry_msgs/msg/TwistWithCovarianceStamped": KnownType({"velocity": "twist.twist.linear"}),
}

DVL_IF_NAMED: Final[Types] = {"nav_msgs/msg/Odometry": KnownType({"velocity": "twist.twist.linear"})}
"""Too common to be taken for a DVL's unasked."""

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

SENSORS: Final[Mapping[str, Sequence[Types]]] = {
    "depth": [
        {
            "sensor_msgs/msg/FluidPressure": KnownType({"pressure": "fluid_pressure"}),
            "blueye.protocol.DepthTel": KnownType({"depth": "depth.value"}, stamp=LOG_TIME),
        }
    ],
    "heading": [
        {"geometry_msgs/msg/QuaternionStamped": KnownType({"quaternion": "quaternion"})},
        {
            "sensor_msgs/msg/Imu": KnownType(
                {"quaternion": "orientation", "quaternion_var": "orientation_covariance[0]"}
            ),
        },
    ],
    "position": [FIX],
}
"""Of the sensors of `core.sensors`; of several groups of types, the first that a log has is taken."""
SENSORS_IF_NAMED: Final[Mapping[str, Types]] = {
    "depth": {
        "geometry_msgs/msg/PoseWithCovarianceStamped": KnownType({"height": "pose.pose.position.z"}),
        "nav_msgs/msg/Odometry": KnownType({"height": "pose.pose.position.z"}),
    },
}
"""Too common to be taken unasked for what one of their fields holds."""

TRUTH: Final[Types] = {
    "insdvl_msgs/msg/SensorBiases": KnownType({"accel_bias": "accel_bias_mps2", "gyro_bias": "gyro_bias_radps"})
}
