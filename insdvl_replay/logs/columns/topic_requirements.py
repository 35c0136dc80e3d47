"""What each role needs of a topic: a type that is known by name, or the field paths of the configuration."""

import re
from collections.abc import Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

import msgspec

from insdvl_replay.core.config import TOPIC_KEYS, Config, Navigation, Solution
from insdvl_replay.core.errors import LogError, error_context
from insdvl_replay.core.states import SENSORS
from insdvl_replay.logs.columns import known_dvls, known_sensors, known_types
from insdvl_replay.logs.columns.known_types import LOG_TIME, Fields, KnownType, Types
from insdvl_replay.logs.container.records import LogChannel
from insdvl_replay.logs.encoding.fields import Element, Kinds, channel_paths, check_encoding, find_path, split_paths
from insdvl_replay.logs.encoding.ros2msg import full_name

_MAVLINK: Final = re.compile(r"(?:^|/)mavlink/\d+/\d+/([A-Z][A-Z0-9_]+)$")
"""Topics of whole messages, as BlueOS records them beside one for each field."""
OWN_TOPIC: Final = "topics."
"""Begins the role of a topic for measurements of the user's own."""
BOW_DOWN: Final = "_bow_down"
"""Ends the name of a pitch with the opposite sign."""
_ANGLES: Final = ({"latitude", "longitude"}, {"roll", "pitch", "heading"})
_MOTION: Final = ({"velocity_n"}, {"velocity_b"}, {"quaternion"}, *_ANGLES)

PROPOSED: Final = ("imu", "dvl", "reference")
"""Roles for which `inspect` proposes topics and fields of unknown types."""
Section = TypeVar("Section", bound=msgspec.Struct)


SOLUTION: Final = "solution"
"""Begins the codes of notes on a solution that is judged as a filter, whichever."""


def code_of(role: str) -> str:
    """Return what the codes of notes on a role begin with."""
    return SOLUTION if role.startswith("filters.") else role


@dataclass(frozen=True)
class Source:
    """A topic that plays a role.

    Attributes
    ----------
    role : str
        ``imu``, ``dvl``, ``reference``, ``truth``, a sensor's, or the section of a solution, ``filters.NAME.solution``.
    channels : tuple of LogChannel
        The channels of the topic that have messages.
    fields : mapping of str to str
        Path of the field by the quantity that it holds.
    stamp : str
        ``header``, ``log_time``, ``publish_time`` or a field path.
    latency_s : float
        From validity to stamp.
    conventions : mapping of str to Any
        What the type says where the configuration leaves a key out.
    element : Element or None
        Which elements of a list in the messages count, each as if it were a message.
    """

    role: str
    topic: str
    type_name: str
    channels: tuple[LogChannel, ...]
    fields: Fields
    stamp: str
    latency_s: float
    conventions: Mapping[str, Any] = field(default_factory=dict)
    element: Element | None = None

    @property
    def code(self) -> str:
        """What the codes of notes on it begin with."""
        return code_of(self.role)

    def completed(self, section: Section) -> Section:
        """Fill in by the type what this role's section of the configuration leaves out."""
        left_out = {key: value for key, value in self.conventions.items() if getattr(section, key) is None}
        return msgspec.structs.replace(section, **left_out)


@dataclass(frozen=True)
class TopicRequirement:
    """What a role needs.

    Attributes
    ----------
    key : str
        The configuration's key that names the topic; empty where none does.
    topic : str or None
        The topic that the configuration names.
    by_type : sequence of Types
        Of several groups of types, the first that the log has is taken.
    if_named : Types
        Types that only a topic may have that the configuration names.
    paths : mapping of str to str or None
        Field paths of the configuration by quantity.
    enough : sequence of set of str
        The quantities of one of these sets must be there.
    together : sequence of set of str
        Of each of these sets all must be there or none.
    stamp : str or None
        Of the configuration.
    latency_s : float
        From validity to stamp.
    frames : tuple of str or None
        Parent and child of the transforms that count.
    """

    role: str
    key: str
    topic: str | None
    by_type: Sequence[Types]
    if_named: Types = field(default_factory=dict)
    paths: Mapping[str, str | None] = field(default_factory=dict)
    enough: Sequence[AbstractSet[str]] = ()
    together: Sequence[AbstractSet[str]] = ()
    stamp: str | None = None
    latency_s: float = 0.0
    frames: tuple[str, str] | None = None

    def known(self, channel: LogChannel) -> KnownType | None:
        """Return what is known of the type of a channel's messages."""
        groups, name = (*self.by_type, self.if_named), type_of(channel)
        return next((types[name] for types in groups if name in types), None)

    def source(self, topic: str, channels: Sequence[LogChannel]) -> Source:
        """Make a topic the source of the role."""
        for channel in channels:
            check_encoding(channel)
        type_name = channels[0].type_name
        with error_context(topic):
            paths = channel_paths(channels[0])
        known = self.known(channels[0]) or KnownType({})
        fields = {**_present(known.fields, paths), **{name: path for name, path in self.paths.items() if path}}
        self._raise_if_incomplete(topic, fields)
        if not any(quantities <= fields.keys() for quantities in self.enough):
            reason = f"is of type {type_name or 'unknown'}, which is not known as a type for {self.key}"
            if known.fields:
                reason = f"is of type {type_name}, and its schema lacks some of {', '.join(known.fields.values())}"
            raise LogError(f"topic '{topic}' {reason}", self.how_to_name())
        stamp = self.stamp or _stamp(known.stamp, paths)
        channel_tuple, element = tuple(channels), self._element(topic, known)
        return Source(
            self.role, topic, type_name, channel_tuple, fields, stamp, self.latency_s, known.conventions, element
        )

    def _element(self, topic: str, known: KnownType) -> Element | None:
        if known.element:
            list_name, *texts = known.element
            return Element(list_name, tuple(texts), self.frames or ())
        if self.frames is not None:
            raise LogError(f"topic '{topic}' has no transforms, and {self.role}.frames is set", "leave it out")
        return None

    def _raise_if_incomplete(self, topic: str, fields: Fields) -> None:
        """Refuse quantities that say nothing without another one."""
        given = {quantity.removesuffix(BOW_DOWN) for quantity in fields}
        for quantities in self.together:
            if (lacking := sorted(quantities - given)) and (alone := sorted(quantities & given)):
                missing = f'{self.role}.{lacking[0]} = "field.path"'
                raise LogError(f"topic '{topic}' gives {' and '.join(alone)} without {' and '.join(lacking)}", missing)

    def how_to_name(self) -> str:
        """State which keys lead to a topic of an unknown type."""
        if not self.paths:
            return f"known are {', '.join(name for types in (*self.by_type, self.if_named) for name in types)}"
        section = self.role
        ways = sorted(sorted(quantities) for quantities in self.enough)
        joined = " or ".join(" and ".join(f'{section}.{name} = "field.path"' for name in way) for way in ways)
        does = "proposes what to set" if section in PROPOSED else "lists the topics"
        return f'for other types, set {self.key} = "/topic" with {joined}; `insdvl-replay inspect` {does}'


def type_of(channel: LogChannel) -> str:
    """Return the type of a channel's messages as it is known: ROS 1's as ROS 2's, MAVLink's in JSON by its topic."""
    mavlink = _MAVLINK.search(channel.topic) if channel.encoding == "json" else None
    return f"mavlink.{mavlink[1]}" if mavlink else full_name(channel.type_name)


def imu_requirement(config: Config) -> TopicRequirement:
    """State what an IMU needs."""
    quantities = ("specific_force", "angular_rate")
    return _required(
        config.imu, "imu", quantities, by_type=[known_types.IMU, known_types.IMU_OF_DRIVERS], enough=[set(quantities)]
    )


def dvl_requirement(config: Config) -> TopicRequirement:
    """State what a DVL needs."""
    return _required(
        config.dvl,
        "dvl",
        ("beam_velocity", "beam_valid", "velocity", "valid"),
        by_type=[known_dvls.DVL_BEAMS, known_dvls.DVL_VELOCITY],
        if_named=known_dvls.DVL_IF_NAMED,
        enough=[{"beam_velocity"}, {"velocity"}],
    )


def solution_requirement(config: Config) -> TopicRequirement:
    """State what a reference solution needs."""
    return _required(
        config.reference,
        "reference",
        TOPIC_KEYS,
        by_type=[known_types.NAV_SOLUTION, known_types.ODOMETRY],
        if_named={**known_types.FIX, **known_types.EXTENDED_FIX, **known_types.POSES},
        enough=_MOTION,
        together=_ANGLES,
    )


def fix_requirement(settings: Navigation, role: str) -> TopicRequirement:
    """State what a geographic position needs."""
    enough = [{"latitude", "longitude"}]
    return _required(settings, role, (), "fix", by_type=[known_types.FIX, known_types.EXTENDED_FIX], enough=enough)


def own_solution_requirement(settings: Solution, role: str) -> TopicRequirement:
    """State what a solution of the vehicle's own needs, whose topic is named."""
    return _required(
        settings,
        role,
        TOPIC_KEYS,
        by_type=[],
        if_named={**known_types.SOLUTIONS, **known_types.EXTENDED_FIX},
        enough=[*_MOTION, {"latitude", "longitude"}, {"local_position"}],
        together=_ANGLES,
    )


def sensor_requirement(name: str, config: Config) -> TopicRequirement:
    """State what one of the sensors of `core.states` needs."""
    return _required(
        getattr(config, name),
        name,
        SENSORS[name].quantities,
        by_type=known_sensors.TYPES[name],
        if_named=known_sensors.TYPES_IF_NAMED.get(name, {}),
        enough=SENSORS[name].enough,
        together=[SENSORS[name].together],
    )


def own_requirement(name: str, config: Config) -> TopicRequirement:
    """State what a topic needs that only measurements of the user's own read."""
    return _required(config.topics[name], f"{OWN_TOPIC}{name}", ("values",), by_type=[], enough=[{"values"}])


def _required(section: Any, role: str, quantities: Iterable[str], key: str = "topic", **needs: Any) -> TopicRequirement:
    """State what a role needs, with what its section of the configuration says of topic, fields and stamp."""
    return TopicRequirement(
        role=role,
        key=f"{role}.{key}",
        topic=getattr(section, key),
        paths={quantity: getattr(section, quantity) for quantity in quantities},
        stamp=section.stamp,
        latency_s=section.latency_s,
        frames=getattr(section, "frames", None) if key == "topic" else None,
        **needs,
    )


TRUTH_REQUIREMENT: Final = TopicRequirement(
    "truth", "", None, [known_types.TRUTH], enough=[{"accel_bias", "gyro_bias"}]
)
"""What true sensor biases need."""


def _present(fields: Fields, paths: Kinds) -> Fields:
    """Leave out the fields that a schema does not have; the same type name comes with different fields."""
    return {
        quantity: path
        for quantity, path in fields.items()
        if not paths or all(find_path(part, paths) for part in split_paths(path))
    }


def _stamp(by_type: str, paths: Kinds) -> str:
    """Choose the stamp of the type, else of the header, else of the recorder."""
    if by_type == LOG_TIME or find_path(by_type, paths):
        return by_type
    return "header" if find_path("header.stamp", paths) else LOG_TIME
