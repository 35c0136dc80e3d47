"""Which channels play which role: by type where only one can, else as the configuration says.

The tables hold the conventions of the types that are known by name; every other type is read by field paths.
"""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from insdvl_replay.columns import Channel
from insdvl_replay.config import Config
from insdvl_replay.errors import LogError
from insdvl_replay.logs.container import LogChannel

Fields = Mapping[str, str]
"""Path of the field by the quantity that it holds."""
Types = Mapping[str, Fields]
"""Fields by the name of the type."""

ODOMETRY: Final = "nav_msgs/msg/Odometry"
NAV_SOLUTION: Final = "insdvl_msgs/msg/NavSolution"
NAV_SAT_FIX: Final = "sensor_msgs/msg/NavSatFix"

_IMU: Final[Types] = {
    "sensor_msgs/msg/Imu": {
        "specific_force": "linear_acceleration",
        "angular_rate": "angular_velocity",
        "specific_force_var": "linear_acceleration_covariance[0]",
        "angular_rate_var": "angular_velocity_covariance[0]",
    }
}
_DVL_BEAMS: Final[Types] = {
    "marine_acoustic_msgs/msg/Dvl": {
        "beam_velocity": "beam_velocity",
        "beams_valid": "beam_velocities_valid",
        "beam_vectors": "beam_unit_vec",
        "beam_ranges": "range",
        "ranges_valid": "beam_ranges_valid",
        "altitude": "altitude",
        "mode": "velocity_mode",
        "good_beams": "num_good_beams",
        "velocity": "velocity",
    }
}
_DVL_VELOCITY: Final[Types] = {
    "geometry_msgs/msg/TwistStamped": {"velocity": "twist.linear"},
    "geometry_msgs/msg/TwistWithCovarianceStamped": {"velocity": "twist.twist.linear"},
}
_DVL_IF_NAMED: Final[Types] = {ODOMETRY: {"velocity": "twist.twist.linear"}}
_SOLUTION: Final[Types] = {
    NAV_SOLUTION: {
        "latitude": "latitude_deg",
        "longitude": "longitude_deg",
        "height": "height_m",
        "velocity_n": "velocity_ned_mps",
        "roll": "roll_deg",
        "pitch": "pitch_deg",
        "heading": "heading_deg",
    }
}
_ODOMETRY: Final[Types] = {ODOMETRY: {"quaternion": "pose.pose.orientation", "velocity_b": "twist.twist.linear"}}
_FIX: Final[Types] = {
    NAV_SAT_FIX: {"latitude": "latitude", "longitude": "longitude", "height": "altitude", "status": "status.status"}
}
_TRUTH: Final[Types] = {
    "insdvl_msgs/msg/SensorBiases": {"accel_bias": "accel_bias_mps2", "gyro_bias": "gyro_bias_radps"}
}


@dataclass(frozen=True)
class Source:
    """A topic that plays a role.

    Attributes
    ----------
    role : {'imu', 'dvl', 'reference', 'truth'}
    topic, type_name : str
    channels : tuple of LogChannel
        The channels of the topic that have messages.
    fields : mapping of str to str
        Path of the field by the quantity that it holds.
    stamp : str
        Where the time of validity stands.
    latency_s : float
        From validity to stamp.
    """

    role: str
    topic: str
    type_name: str
    channels: tuple[LogChannel, ...]
    fields: Fields
    stamp: str = "header"
    latency_s: float = 0.0


@dataclass(frozen=True)
class Roles:
    """The topics that are read.

    Attributes
    ----------
    imu, dvl : Source
    solution : Source or None
        Velocity and attitude of the reference, perhaps position.
    fix : Source or None
        Position of the reference.
    truth : Source or None
        True sensor biases.
    """

    imu: Source
    dvl: Source
    solution: Source | None
    fix: Source | None
    truth: Source | None

    @property
    def sources(self) -> tuple[Source, ...]:
        """All topics that are read."""
        every = (self.imu, self.dvl, self.solution, self.fix, self.truth)
        return tuple(source for source in every if source is not None)


@dataclass(frozen=True)
class _Search:
    """What one role looks for; of several groups of types, the first that the log has is taken."""

    role: str
    key: str
    by_type: Sequence[Types]
    if_named: Types
    required: Sequence[str] = ()


def assign_roles(place: str, channels: Sequence[LogChannel], config: Config) -> Roles:
    """Find the topic for each role.

    Parameters
    ----------
    place : str
        The file, for messages to the user.
    channels : sequence of LogChannel
    config : Config

    Returns
    -------
    Roles

    Raises
    ------
    LogError
        No topic is an IMU or a DVL, several are and the configuration names none, a named topic is not there, or its
        type is not known and the configuration does not say where its fields are.
    """
    topics = _Topics(place, channels)
    named = {"specific_force": config.imu.specific_force, "angular_rate": config.imu.angular_rate}
    imu = topics.find(
        _Search("imu", "imu.topic", [_IMU], {}, ("specific_force", "angular_rate")), config.imu.topic, named
    )
    named = {"beam_velocity": config.dvl.beam_velocity, "velocity": config.dvl.velocity}
    dvl = topics.find(
        _Search("dvl", "dvl.topic", [_DVL_BEAMS, _DVL_VELOCITY], _DVL_IF_NAMED), config.dvl.topic, named
    )
    for role, source in (("imu", imu), ("dvl", dvl)):
        if source is None:
            raise topics.missing(role)
    return Roles(imu, dvl, *_reference(topics, config, dvl), topics.find(_Search("truth", "", [_TRUTH], {}), None))
