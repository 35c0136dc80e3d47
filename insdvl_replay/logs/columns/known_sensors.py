"""Message types of the sensors beside IMU and DVL."""

from collections.abc import Mapping, Sequence
from typing import Final

from insdvl_replay.logs.columns.known_types import EXTENDED_FIX, FIX, LOG_TIME, KnownType, Types

_TURNS: Final = "from forward-port-up to east-north-up, or as `heading.axes` says"

TYPES: Final[Mapping[str, Sequence[Types]]] = {
    "depth": [
        {
            "sensor_msgs/msg/FluidPressure": KnownType({"pressure": "fluid_pressure"}, about="Pa"),
            "blueye.protocol.DepthTel": KnownType({"depth": "depth.value"}, stamp=LOG_TIME, about="Blueye X3"),
        }
    ],
    "heading": [
        {"geometry_msgs/msg/QuaternionStamped": KnownType({"quaternion": "quaternion"}, about=_TURNS)},
        {
            "sensor_msgs/msg/Imu": KnownType(
                {"quaternion": "orientation", "quaternion_var": "orientation_covariance[0]"},
                about=f"{_TURNS}; a first covariance of -1 says that there is none",
            ),
        },
    ],
    "position": [FIX, EXTENDED_FIX],
}
"""Of the sensors of `core.states`; of several groups of types, the first that a log has is taken."""
TYPES_IF_NAMED: Final[Mapping[str, Types]] = {
    "depth": {
        name: KnownType({"height": "pose.pose.position.z"}, about="if `depth.topic` names it; metres upwards")
        for name in ("geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry")
    },
    "heading": {
        name: KnownType({"quaternion": "pose.pose.orientation"}, about=f"if `heading.topic` names it; {_TURNS}")
        for name in ("geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry")
    },
}
"""Too common to be taken unasked for what one of their fields holds."""
