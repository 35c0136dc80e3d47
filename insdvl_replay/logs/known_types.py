"""The message types that are known by name: which quantity stands in which field.

Every other type is read by the field paths of the configuration.
"""

from collections.abc import Mapping
from typing import Final

Fields = Mapping[str, str]
"""Path of the field by the quantity that it holds."""
Types = Mapping[str, Fields]
"""Fields by the name of the type."""

IMU: Final[Types] = {
    "sensor_msgs/msg/Imu": {
        "specific_force": "linear_acceleration",
        "angular_rate": "angular_velocity",
        "specific_force_var": "linear_acceleration_covariance[0]",
        "angular_rate_var": "angular_velocity_covariance[0]",
    }
}
"""A variance of -1 says that the quantity is not measured."""

DVL_BEAMS: Final[Types] = {
    "marine_acoustic_msgs/msg/Dvl": {
        "mode": "velocity_mode",
        "velocity": "velocity",
        "altitude": "altitude",
        "good_beams": "num_good_beams",
        "beams_valid": "beam_velocities_valid",
        "beam_velocity": "beam_velocity",
        "beam_vectors": "beam_unit_vec",
        "beam_ranges": "range",
    }
}
"""The stamp is the time of validity; mode 1 is bottom track, 2 water track."""

DVL_VELOCITY: Final[Types] = {
    "geometry_msgs/msg/TwistStamped": {"velocity": "twist.linear"},
    "geometry_msgs/msg/TwistWithCovarianceStamped": {"velocity": "twist.twist.linear"},
}

DVL_IF_NAMED: Final[Types] = {"nav_msgs/msg/Odometry": {"velocity": "twist.twist.linear"}}
"""Too common to be taken for a DVL's unasked."""

NAV_SOLUTION: Final[Types] = {
    "insdvl_msgs/msg/NavSolution": {
        "latitude": "latitude_deg",
        "longitude": "longitude_deg",
        "height": "height_m",
        "velocity_n": "velocity_ned_mps",
        "roll": "roll_deg",
        "pitch": "pitch_deg",
        "heading": "heading_deg",
    }
}

ODOMETRY: Final[Types] = {
    "nav_msgs/msg/Odometry": {"quaternion": "pose.pose.orientation", "velocity_b": "twist.twist.linear"}
}
"""East-north-up and forward-port-up, the twist in the child frame; the position has no known origin."""

FIX: Final[Types] = {
    "sensor_msgs/msg/NavSatFix": {
        "latitude": "latitude",
        "longitude": "longitude",
        "height": "altitude",
        "fix_status": "status.status",
    }
}
"""A status below 0 says that there is no fix."""

TRUTH: Final[Types] = {
    "insdvl_msgs/msg/SensorBiases": {"accel_bias": "accel_bias_mps2", "gyro_bias": "gyro_bias_radps"}
}
