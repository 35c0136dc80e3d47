"""The message types of a DVL that are known by name: which quantity stands in which field, units, axes, validity.

Sources, by repository and commit: apl-ocean-engineering/marine_msgs@ad0fa4b; waterlinked/dvl-a50-ros-driver@e86b038;
uuvsimulator/uuv_simulator and its copies smarc_msgs@562af48, stonefish_ros@da007c0, stonefish_ros2@6646e7a, mvp_msgs,
vortexntnu/dvl1000-driver@0d98629, cola2_msgs; labust/uuv_sensor_msgs@8e46b8f; IOES-Lab/dave@2bd7cce;
gazebosim/gz-msgs@a9a203a, whose sensor is gz-sensors@028bd08; uf-mil/mil; arvpUofA/nortek_dvl@232f80d;
osu-uwrt/riptide_msgs@29e8bbe; GSO-soslab/nortek_dvl@05338be; san-soucie/ds_msgs; UCSD-E4E/dvl_driver@7698c40;
the makers' manuals for the beams; for MAVLink https://mavlink.io/en/messages/ardupilotmega.html, and what
bluerobotics/BlueOS-Water-Linked-DVL@02e75d0 sends.
"""

from typing import Final

from insdvl_replay.logs.columns.known_types import LOG_TIME, Fields, KnownType, Types

_ALONG_X: Final = "{0}.x, {0}.y, {0}.z"
"""A vector of each element of a list, component by component; where one is absent, its numbers stay in place."""

_APL: Final = KnownType(
    {
        "mode": "velocity_mode",
        "velocity": "velocity",
        "altitude": "altitude",
        "good_beams": "num_good_beams",
        "beams_valid": "beam_velocities_valid",
        "beam_velocity": "beam_velocity",
        "beam_vectors": "beam_unit_vec",
        "beam_ranges": "range",
    },
    about="the common message; water track is left out; beam vectors that cannot be true are not used",
)

# The beams of Water Linked's A50 and A125, which all drivers number from behind starboard clockwise.
_A50: Final = {"beam_tilt_deg": 22.5, "beam_azimuth_deg": (135.0, 225.0, 315.0, 45.0)}
_A50_FIELDS: Final[Fields] = {
    "velocity": "velocity",
    "valid": "velocity_valid",
    "beam_velocity": "beams[*].velocity",
    "beam_valid": "beams[*].valid",
}

_UUV_FIELDS: Final[Fields] = {
    "velocity": "velocity",
    "velocity_var": "velocity_covariance[0]",
    "status": "altitude",
    "beam_velocity": "beams[*].velocity",
    "beam_var": "beams[*].velocity_covariance",
    "beam_quaternions": "beams[*].pose.pose.orientation",
}
"""A variance of -1 says that there is no velocity, an altitude of -1 that the beams found no bottom. A beam looks along
the x axis of its pose."""
_UUV_PACKAGES: Final = (
    "uuv_sensor_ros_plugins_msgs",
    "uuv_sensor_plugins_ros_msgs",
    "smarc_msgs",
    "stonefish_ros",
    "stonefish_ros2",
    "mvp_msgs",
    "cola2_msgs",
    "dvl1000_ros",
)
_UUV: Final = KnownType(
    _UUV_FIELDS,
    about="UUV Simulator, Plankton, Stonefish, MVP and others of this layout; beams point where their poses say; those "
    "of simulators that leave them at zero are not used; axes are those of the simulated link",
)

_GAZEBO_FIELDS: Final[Fields] = {
    "mode": "target.type",
    "velocity": _ALONG_X.format("velocity.mean"),
    "beam_velocity_vectors": _ALONG_X.format("beams[*].velocity.mean"),
    "beam_valid": "beams[*].locked",
}
_DAVE_FIELDS: Final[Fields] = {
    "velocity": "velocity.twist.linear",
    "beam_velocity_vectors": _ALONG_X.format("beams[*].velocity.twist.linear"),
    "beam_valid": "beams[*].locked",
}
_FLU: Final = {"axes": "flu"}
_PNORBT: Final = (
    "Nortek DVL by its NMEA sentences: velocities alone, of which -32.768 m/s says that there is none; the figure of "
    "merit is a standard deviation in m/s and is not used; stamped by the computer as they came in"
)

DVL_BEAMS: Final[Types] = {
    "marine_acoustic_msgs/msg/Dvl": _APL,
    "acoustic_msgs/msg/Dvl": _APL,
    "dvl_msgs/msg/DVL": KnownType(
        _A50_FIELDS,
        _A50,
        "time_of_validity",
        "Water Linked A50 and A125 in ROS 2; the figure of merit is a standard deviation in m/s and is not used",
    ),
    "waterlinked_a50_ros_driver/msg/DVL": KnownType(
        _A50_FIELDS,
        _A50,
        about="Water Linked A50 in ROS 1, and its 20 copies; early ones have no beams; `time` is ms since the last "
        "report and no stamp; the figure of merit is a standard deviation in m/s and is not used",
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
        "Blueye X3 with a Water Linked A50",
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
        "Nortek Nucleus; its velocity unless the configuration tells where the three beams point",
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
        about="WHOI's drivers; velocities in the instrument's coordinates",
    ),
    **{f"{package}/msg/DVL": _UUV for package in _UUV_PACKAGES},
    "uuv_sensor_msgs/msg/DVL": KnownType(
        {"mode": "velocity_reference", "velocity": "velocity", "velocity_var": "velocity_covariance[0]"},
        about="LABUST; velocities alone; those against water are left out",
    ),
    "gz.msgs.DVLVelocityTracking": KnownType(
        _GAZEBO_FIELDS,
        _FLU,
        about="Gazebo's own; each beam's velocity is a vector along it, so that its direction is known once it has "
        "moved; beams that are not locked are lost; water track is left out",
    ),
    "dave_interfaces/msg/DVL": KnownType(
        _DAVE_FIELDS,
        _FLU,
        about="DAVE's bridge of Gazebo's DVL; likewise, but bottom and water are told apart by words, which are not "
        "read: record bottom track",
    ),
    "mil_msgs/msg/VelocityMeasurements": KnownType(
        {
            "beam_velocity": "velocity_measurements[*].velocity",
            "beam_vectors": "velocity_measurements[*].direction",
        },
        _FLU,
        about="SubjuGator's Teledyne; beams with their own directions, z up, NaN where one is lost",
    ),
    "nortek_dvl/msg/Dvl": KnownType({"velocity": "velocity"}, about=_PNORBT),
    "riptide_msgs/msg/Dvl": KnownType({"velocity": "velocity"}, about=_PNORBT),
    "nortek_dvl/msg/ButtomTrack": KnownType({"velocity": "speed"}, about=_PNORBT),
    # The velocities of the beams there hold the same number three times, which points nowhere.
    "msgs/msg/DVLData": KnownType(
        {"mode": "target.type", "velocity": "velocity.mean"},
        about="Stanford's AUV: Gazebo's message in ROS 2; velocities alone; water track is left out",
    ),
    "ds_sensor_msgs/msg/NortekDF21": KnownType(
        {"velocity": "velX, velY, velZ1", "beam_velocity": "velBeam", "nortek_status": "status"},
        {"kind": "velocity"},
        about="Nortek DVL by its binary format DF21; bits of its status mark what is valid; its velocity unless the "
        "configuration tells where its beams point",
    ),
}
"""Mode 1 is bottom track, 2 water track; coordinates 0 are along the beams, 1 of the instrument; a status below 0 and
flags that are 0 say that there is no velocity. Bits 0 to 3 of Nortek's status are the validity of the beams, 12 to 14
that of x, y and z."""

DVL_VELOCITY: Final[Types] = {
    "geometry_msgs/msg/TwistStamped": KnownType({"velocity": "twist.linear"}, about="velocities alone"),
    "geometry_msgs/msg/TwistWithCovarianceStamped": KnownType(
        {"velocity": "twist.twist.linear"}, about="velocities alone"
    ),
    "mavlink.VISION_POSITION_DELTA": KnownType(
        {
            "velocity": "message.position_delta",
            "velocity_interval_us": "message.time_delta_usec",
            "valid": "message.confidence",
        },
        stamp=LOG_TIME,
        about="BlueOS with a Water Linked, by its topic `mavlink/SYSTEM/COMPONENT/VISION_POSITION_DELTA` in JSON: the "
        "way over its time, forward-starboard-down; a confidence of 0 is no velocity; times are the recorder's",
    ),
}

DVL_IF_NAMED: Final[Types] = {
    "nav_msgs/msg/Odometry": KnownType({"velocity": "twist.twist.linear"}, about="if `dvl.topic` names it"),
    # Its header is left empty, and no field says in which coordinates the numbers are.
    "dvl_driver/msg/DVL": KnownType(
        {"velocity": "velocity[0], velocity[1], velocity[2]", "beam_velocity": "velocity"},
        {"kind": "velocity"},
        LOG_TIME,
        "UCSD: a Teledyne's bottom track, if `dvl.topic` names it: its message tells neither coordinates nor sign, so "
        "that `dvl.axes` has to be set; times are the recorder's",
    ),
    "mavlink.VISION_SPEED_ESTIMATE": KnownType(
        {"velocity": "message.x, message.y, message.z"},
        stamp=LOG_TIME,
        about="BlueOS with a Water Linked, if `dvl.topic` names it: velocities forward-starboard-down; times are the "
        "recorder's",
    ),
}
"""Too common to be taken for a DVL's unasked."""
