"""The message types that are known by name, of `known_types.toml`, by the groups in which roles look for them.

Those of the sensors beside IMU and DVL are in `sensors`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import msgspec


class KnownType(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is known of a message type; `known_types.toml` says what each entry means."""

    names: tuple[str, ...] = ()
    fields: dict[str, str] = {}
    conventions: dict[str, Any] = {}
    stamp: str = ""
    element: tuple[str, ...] = ()
    about: str = ""


Fields = Mapping[str, str]
"""Path of the field by the quantity that it holds."""
Types = Mapping[str, KnownType]
"""By name; of two types that a log has, the earlier one is the better source."""
LOG_TIME: Final = "log_time"  # the recorder's time of arrival, as a stamp


def types_of(*entries: KnownType) -> Types:
    """Make a group of types."""
    return {name: entry for entry in entries for name in entry.names}


_ENTRIES: Final = msgspec.toml.decode(
    Path(__file__).with_name("known_types.toml").read_text("utf-8"), type=dict[str, list[KnownType]]
)
TYPES: Final[Mapping[str, Types]] = {group: types_of(*entries) for group, entries in _ENTRIES.items()}


def _upper_triangle(path: str, size: int) -> str:
    """Name the upper triangle of the first rows of a covariance of six: a third of what its messages repeat."""
    return ", ".join(f"{path}[{6 * row + column}]" for row in range(size) for column in range(row, size))


_COVARIANCES: Final = {
    "nav_msgs/msg/Odometry": {
        "pose_cov": _upper_triangle("pose.covariance", 6),
        "twist_cov": _upper_triangle("twist.covariance", 3),
    },
    "geometry_msgs/msg/PoseWithCovarianceStamped": {"pose_cov": _upper_triangle("pose.covariance", 6)},
}
SOLUTIONS: Final[Types] = {
    name: msgspec.structs.replace(entry, fields={**entry.fields, **_COVARIANCES.get(name, {})})
    for group in ("nav_solution", "odometry", "poses", "fix", "onboard", "extended_fix")
    for name, entry in TYPES[group].items()
}
"""Of an onboard solution, whose topic is always named, the covariances are read, too."""
