"""Which topic plays which role: by type where only one topic has a known type, else as the settings say.

The message types that are known by name are in `known_types.toml`, by the groups in which roles look for them.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec

from insdvl_replay.core.config import TOPIC_KEYS, key_of
from insdvl_replay.core.errors import LogError, error_context, listed, nearest
from insdvl_replay.core.states import SENSORS
from insdvl_replay.core.units import UNITS_BY_KIND, USUAL_UNITS, unit_at_end
from insdvl_replay.logs.columns.flags import flag_columns
from insdvl_replay.logs.formats.definitions import full_name
from insdvl_replay.logs.formats.fields import (
    TABLE,
    Element,
    check_encoding,
    find_path,
    split_paths,
)
from insdvl_replay.logs.formats.log_file import LogChannel, by_topic
from insdvl_replay.logs.formats.readers import channel_paths, column_of


class KnownType(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is known of a message type; `known_types.toml` says what each entry means."""

    names: tuple[str, ...] = ()
    fields: dict[str, str] = {}
    conventions: dict[str, Any] = {}
    stamp: str = ""
    element: tuple[str, ...] = ()
    about: str = ""


Types = Mapping[
    str, KnownType
]  # by name; of two types that a log has, the earlier one is the better source
LOG_TIME: Final = "log_time"  # the recorder's time of arrival, as a stamp
_ENTRIES: Final = msgspec.toml.decode(
    Path(__file__).with_name("known_types.toml").read_text("utf-8"), type=dict[str, list[KnownType]]
)
TYPES: Final[dict[str, Types]] = {
    group: {name: entry for entry in entries for name in entry.names}
    for group, entries in _ENTRIES.items()
}


def _upper_triangle(path: str, size: int, of: int = 6) -> str:
    """Name the upper triangle of the first rows of a covariance of some: of six, a third of what messages repeat."""
    return ", ".join(
        f"{path}[{of * row + column}]" for row in range(size) for column in range(row, size)
    )


# Of a reference and of an onboard solution the covariances are read, too.
_POSE_COV: Final = {"pose_cov": _upper_triangle("pose.covariance", 6)}
_COVARIANCES: Final = {
    "nav_msgs/msg/Odometry": {**_POSE_COV, "twist_cov": _upper_triangle("twist.covariance", 3)},
    "geometry_msgs/msg/PoseWithCovarianceStamped": _POSE_COV,
    "sensor_msgs/msg/NavSatFix": {
        "position_cov": _upper_triangle("position_covariance", 3, of=3),
        "position_cov_type": "position_covariance_type",
    },
}
_SOLUTIONS: Final = ("nav_solution", "odometry", "poses", "fix", "onboard", "extended_fix")
for _group in _SOLUTIONS:
    TYPES[_group] = {
        name: msgspec.structs.replace(entry, fields={**entry.fields, **_COVARIANCES.get(name, {})})
        for name, entry in TYPES[_group].items()
    }
TYPES["solution"] = {name: entry for group in _SOLUTIONS for name, entry in TYPES[group].items()}


@dataclass(frozen=True)
class Needs:
    """What a role needs of a topic: a type that is known by name, or the field paths of the settings."""

    quantities: Sequence[str] = ()  # whose paths the settings may name
    groups: Sequence[str] = ()  # of known types; the first of which the log has a type is taken
    if_named: Sequence[
        str
    ] = ()  # groups of types that only a topic may have that the settings name
    enough: Sequence[AbstractSet[str]] = ()  # the quantities of one of these sets must be there
    together: Sequence[AbstractSet[str]] = ()  # of each of these sets all must be there or none


_POSITION: Final = {"latitude", "longitude"}
_ANGLES: Final = (_POSITION, {"roll", "pitch", "heading"})
_MOTION: Final = ({"velocity_n"}, {"velocity_b"}, {"quaternion"}, *_ANGLES)
_IMU: Final = ("specific_force", "angular_rate")
_FIXES: Final = ("fix", "extended_fix")
_SENSOR_GROUPS: Final = {"heading": ("heading", "heading_of_imu"), "position": _FIXES}
_BY_SENSOR: Final = {
    name: Needs(
        sensor.quantities,
        _SENSOR_GROUPS.get(name, (name,)),
        [group for group in (f"{name}_if_named",) if group in TYPES],
        sensor.enough,
        [sensor.together],
    )
    for name, sensor in SENSORS.items()
}
_DVL: Final = ("beam_velocity", "beam_valid", "velocity", "valid", "invalid")
NEEDS: Final = {
    "imu": Needs((*_IMU, "increment_s"), ("imu", "imu_of_drivers"), enough=[set(_IMU)]),
    "dvl": Needs(
        _DVL, ("dvl_beams", "dvl_velocity"), ["dvl_if_named"], [{"beam_velocity"}, {"velocity"}]
    ),
    "reference": Needs(
        TOPIC_KEYS, ("nav_solution", "odometry"), (*_FIXES, "poses"), _MOTION, _ANGLES
    ),
    "fix": Needs(groups=_FIXES, enough=[_POSITION]),
    "solution": Needs(
        TOPIC_KEYS, (), ["solution"], [*_MOTION, _POSITION, {"local_position"}], _ANGLES
    ),
    "truth": Needs(groups=["truth"], enough=[{"accel_bias", "gyro_bias"}]),
    "topic": Needs(["values"], enough=[{"values"}]),
    **_BY_SENSOR,
}

# Of quantities with a unit: its kind, and the key of the role's settings that names it, if there is one.
_KINDS: Final = {
    "specific_force": ("specific force", "specific_force_unit"),
    "angular_rate": ("angular rate", "angular_rate_unit"),
    "velocity": ("velocity", "velocity_unit"),
    "beam_velocity": ("velocity", "velocity_unit"),
    "velocity_n": ("velocity", ""),
    "velocity_b": ("velocity", ""),
    "pressure": ("pressure", "pressure_unit"),
    "increment_s": ("time", ""),
    "depth": ("length", ""),
    "height": ("length", ""),
    **dict.fromkeys(("latitude", "longitude", "roll", "pitch", "heading"), ("angle", "angle_unit")),
}
# Of increments over a time: their kind, and the unit in which they give the usual one of the rate.
_INCREMENTS: Final = {"specific_force": ("velocity", "m/s"), "angular_rate": ("angle", "rad")}
UNUSED_FLAGS: Final = (
    "unused_flags"  # columns of a table that may mark pings as invalid, and that no setting names
)
LOG_TOPIC: Final = "topics."  # begins the role of a topic for user-defined measurements
BOW_DOWN: Final = "_bow_down"  # ends the name of a pitch with the opposite sign
PROPOSED: Final = (
    "imu",
    "dvl",
    "reference",
)  # roles for which `inspect` proposes topics and fields of unknown types
_MAVLINK: Final = re.compile(
    r"(?:^|/)mavlink/\d+/\d+/([A-Z][A-Z0-9_]+)$"
)  # whole messages, as BlueOS records them
_TELEMETRY: Final = re.compile(
    r"(^|/)(RAW_IMU|SCALED_IMU\d?|HIGHRES_IMU)$"
)  # of MAVLink, too slow to be replayed
_FULL_RATE: Final = (
    "convert the vehicle's .BIN with clydemcqueen/dive_to_bag; it has every sample if LOG_REPLAY was 1; see "
    "docs/inputs.md"
)
Section = TypeVar("Section", bound=msgspec.Struct)


def code_of(role: str) -> str:
    """Return the beginning of the codes of notes on a role; all onboard solutions share one."""
    if role.startswith("filters."):
        return "solution"
    return role


def solution_role(name: str) -> str:
    """Return the role of the topics of a filter's solution: its section in the settings."""
    return f"filters.{name}.solution"


def solution_name(role: str) -> str | None:
    """Return which filter's solution plays a role; None where none does."""
    if role.startswith("filters."):
        return role.removeprefix("filters.").removesuffix(".solution")
    return None


@dataclass(frozen=True)
class Source:
    """A topic that plays a role."""

    role: str  # imu, dvl, reference, truth, a sensor, topics.NAME or filters.NAME.solution
    topic: str
    type_name: str
    channels: tuple[LogChannel, ...]  # those of the topic that have messages
    fields: Mapping[str, str]  # path of the field by the quantity that it holds
    stamp: str  # header, log_time, publish_time or a field path
    latency_s: float  # from validity to stamp
    conventions: Mapping[str, Any] = field(
        default_factory=dict
    )  # of the type, where the settings leave a key out
    element: Element | None = (
        None  # which elements of a list in the messages count, each as if it were a message
    )
    factors: Mapping[str, float] = field(
        default_factory=dict
    )  # from the unit in a column's title to the usual one

    @property
    def code(self) -> str:
        """The beginning of the codes of notes on it."""
        return code_of(self.role)

    def completed(self, section: Section) -> Section:
        """Fill in by the type what this role's settings leave out."""
        left_out = {
            key: value for key, value in self.conventions.items() if getattr(section, key) is None
        }
        return msgspec.structs.replace(section, **left_out)


@dataclass(frozen=True)
class TopicRequirement:
    """What a role needs of a topic, with what its settings say of topic, fields and stamp."""

    role: str
    needs: Needs
    key: str = ""  # of the settings that names the topic; empty where none does
    topic: str | None = None  # that the settings name
    paths: Mapping[str, str | None] = field(
        default_factory=dict
    )  # field paths of the settings by quantity
    stamp: str | None = None
    latency_s: float = 0.0  # from validity to stamp
    frames: tuple[str, str] | None = None  # parent and child of the transforms that count
    unit_keys: AbstractSet[str] = frozenset()  # keys of units that the settings have
    has_increments: bool = False  # whether the readings of an IMU are increments

    @property
    def by_type(self) -> list[Types]:
        """The groups of types that are looked for."""
        return [TYPES[group] for group in self.needs.groups]

    @property
    def types(self) -> Types:
        """All types that the topic may have."""
        groups = (*self.needs.if_named, *self.needs.groups)
        return {name: known for group in groups for name, known in TYPES[group].items()}

    def source(self, topic: str, channels: Sequence[LogChannel]) -> Source:
        """Make a topic the source of the role."""
        for channel in channels:
            check_encoding(channel)
        type_name = channels[0].type_name
        name = type_of(channels[0])
        with error_context(topic):
            paths = channel_paths(channels[0])
        known = self.types.get(name, KnownType())
        # The same type name comes with different fields.
        fields = {
            quantity: path
            for quantity, path in known.fields.items()
            if not paths or all(find_path(part, paths) for part in split_paths(path))
        }
        fields |= {name: path for name, path in self.paths.items() if path}
        given = {quantity.removesuffix(BOW_DOWN) for quantity in fields}
        for quantities in self.needs.together:
            if (lacking := sorted(quantities - given)) and (alone := sorted(quantities & given)):
                missing = f'{self.role}.{lacking[0]} = "field.path"'
                raise LogError(
                    f"topic '{topic}' has {' and '.join(alone)}, but no {' and '.join(lacking)}",
                    missing,
                )
        if not any(quantities <= fields.keys() for quantities in self.needs.enough):
            reason = (
                f"is of type {type_name or 'unknown'}, which is not known as a type for {self.key}"
            )
            if known.fields:
                reason = f"is of type {type_name}, but its schema lacks some of {', '.join(known.fields.values())}"
            raise LogError(f"topic '{topic}' {reason}", self.how_to_name())
        stamp = self.stamp
        if stamp is None:
            by_type = known.stamp == LOG_TIME or find_path(known.stamp, paths)
            stamp = (
                known.stamp
                if by_type
                else "header"
                if find_path("header.stamp", paths)
                else LOG_TIME
            )
        element = None
        if known.element:
            element = Element(known.element[0], known.element[1:], self.frames or ())
        elif self.frames is not None:
            text = f"topic '{topic}' has no transforms, but {self.role}.frames is set"
            raise LogError(text, f"remove {self.role}.frames")
        if channels[0].untimed and stamp == LOG_TIME:
            by_rate = f'or count rows: {self.role}.stamp = "100 Hz"'
            raise LogError(
                channels[0].untimed,
                f"write seconds, the unit in the title as in time [h], or dates; {by_rate}",
            )
        factors: Mapping[str, float] = {}
        if channels[0].encoding == TABLE:
            factors = self._factors(channels[0], fields)
            if self.role == "dvl" and not fields.keys() & {"valid", "invalid", "beam_valid"}:
                used = {path for joined in fields.values() for path in split_paths(joined)}
                single = [name for name in paths if f"{name}[*]" not in paths]
                flags = [name for name in flag_columns(single).names if name not in used]
                fields |= {UNUSED_FLAGS: ", ".join(flags)} if flags else {}
        return Source(
            role=self.role,
            topic=topic,
            type_name=type_name,
            channels=tuple(channels),
            fields=fields,
            stamp=stamp,
            latency_s=self.latency_s,
            conventions=known.conventions,
            element=element,
            factors=factors,
        )

    def _factors(self, channel: LogChannel, fields: Mapping[str, str]) -> dict[str, float]:
        """Return factors of columns whose titles have another unit than the usual; what the settings say counts more.

        A unit in brackets that is not known is a LogError; at the end of a name it may be part of the name.
        """
        factors: dict[str, float] = {}
        for quantity, joined in fields.items():
            kind, key = _KINDS.get(quantity, ("", ""))
            if not kind or key in self.unit_keys:
                continue
            usual = USUAL_UNITS[kind]
            if self.has_increments and quantity in _INCREMENTS:
                kind, usual = _INCREMENTS[quantity]
            units = UNITS_BY_KIND[kind]
            for path in split_paths(joined):
                column = column_of(channel, path)
                unit = channel.metadata.get(column, usual)
                if unit in units:
                    factors[path] = units[unit] / units[usual]
                elif unit != unit_at_end(column):
                    text = f"column '{column}' of {channel.topic} is in '{unit}', which is no known unit of {kind}"
                    or_set = f", or set {self.role}.{key}" if key else ""
                    of_increments = _INCREMENTS.get(quantity)
                    if of_increments and unit in UNITS_BY_KIND[of_increments[0]]:
                        or_set = (
                            f"; of increments set {self.role}.increment_s, the interval in seconds"
                        )
                    raise LogError(
                        text, f"known are {', '.join(units)}: convert the column{or_set}"
                    )
        return {path: factor for path, factor in factors.items() if factor != 1.0}

    def how_to_name(self) -> str:
        """State which keys lead to a topic of an unknown type."""
        if not self.paths:
            return f"known types: {', '.join(self.types)}"
        ways = sorted(sorted(quantities) for quantities in self.needs.enough)
        joined = " or ".join(
            " and ".join(f'{self.role}.{name} = "field.path"' for name in way) for way in ways
        )
        does = "for a proposal" if self.role in PROPOSED else "for a list of topics"
        return (
            f'for other types: {self.key} = "/topic" with {joined}; {does}: `insdvl-replay inspect`'
        )


def requirement(role: str, section: Any, kind: str = "", key: str = "topic") -> TopicRequirement:
    """State what a role of some kind needs; its section of the settings names topic, fields and stamp."""
    needs = NEEDS[kind or role]
    given = {quantity: getattr(section, quantity) for quantity in needs.quantities}
    return TopicRequirement(
        role=role,
        needs=needs,
        key=f"{role}.{key}",
        topic=getattr(section, key),
        paths={quantity: path for quantity, path in given.items() if isinstance(path, str)}
        | {quantity: None for quantity, path in given.items() if not isinstance(path, str)},
        has_increments=given.get("increment_s") is not None,
        stamp=section.stamp,
        latency_s=section.latency_s,
        frames=getattr(section, "frames", None) if key == "topic" else None,
        unit_keys={
            name for _, name in _KINDS.values() if name and getattr(section, name, None) is not None
        },
    )


def type_of(channel: LogChannel) -> str:
    """Return the type of a channel's messages as it is known: ROS 1's as ROS 2's, MAVLink's in JSON by its topic."""
    mavlink = _MAVLINK.search(channel.topic) if channel.encoding == "json" else None
    if mavlink:
        return f"mavlink.{mavlink[1]}"
    return full_name(channel.type_name)


class Topics:
    """The topics of a log that have messages; the place is the file in messages to the user."""

    def __init__(self, place: str, channels: Sequence[LogChannel]) -> None:
        self.place = place
        self._channels = by_topic(channel for channel in channels if channel.messages)
        self._empty = {
            channel.topic: channel.type_name
            for channel in channels
            if channel.topic not in self._channels
        }
        announced = (
            f" Topics without messages: {listed(sorted(self._empty))}" if self._empty else ""
        )
        self._nothing_recorded = f"was anything recorded?{announced}"
        self.reason_for_none = (
            "no topic has a known type for it" if self._channels else "the log has no messages"
        )

    def source(self, required: TopicRequirement, topic: str) -> Source:
        """Make a topic the source of a role."""
        if topic in self._channels:
            return required.source(topic, self._channels[topic])
        meant = nearest(topic, self._channels)
        hint = f'the nearest is {required.key} = "{meant}"' if meant else self._nothing_recorded
        if required.key.endswith(".solution.topic") and key_of(topic) == "file":
            hint = f'for a file: {required.key.removesuffix("topic")}file = "{topic}"'
        elif self._channels and not meant:
            hint = f"topics with messages: {listed(sorted(self._channels))}"
        raise LogError(f"has no messages on topic '{topic}' ({required.key})", hint)

    def candidates(self, required: TopicRequirement, besides: Collection[str]) -> list[str]:
        """Name the topics of the first group of types that the log has, the better types first."""
        type_names = {
            topic: type_of(channels[0])
            for topic, channels in self._channels.items()
            if topic not in besides
        }
        for types in required.by_type:
            if found := [topic for topic, type_name in type_names.items() if type_name in types]:
                order = list(types)
                return sorted(found, key=lambda topic: order.index(type_names[topic]))
        return []

    def find(self, required: TopicRequirement, besides: Collection[str] = ()) -> Source | None:
        """Find the topic of a role, not looking at those of others."""
        if required.topic is not None:
            return self.source(required, required.topic)
        candidates = self.candidates(required, besides)
        if len(candidates) > 1:
            named = " or ".join(f'{required.key} = "{topic}"' for topic in candidates)
            hint = named if required.key else "keep one of them"
            raise LogError(
                f"{' and '.join(candidates)} could each be the {required.key or required.role}",
                hint,
            )
        if candidates:
            return self.source(required, candidates[0])
        return None

    def need(self, required: TopicRequirement) -> Source:
        """Find the topic of a role that a replay needs."""
        if (source := self.find(required)) is not None:
            return source
        role = required.role
        lack = f"has no {role.upper() if role in ('imu', 'dvl') else f'topic for the {role}'}"
        if not self._channels:
            raise LogError(f"{lack}: it has no messages at all", self._nothing_recorded)
        if all(channel.encoding == TABLE for same in self._channels.values() for channel in same):
            ways = " or ".join(
                " and ".join(f"{role}.{name}" for name in sorted(way))
                for way in required.needs.enough
            )
            hint = f"give the folder of all tables, or all of them with --one-dive; to name its fields: {ways}"
            raise LogError(
                f"{lack}: no setting names a table for it; it has {listed(sorted(self._channels))}",
                hint,
            )
        slow = sorted(topic for topic in self._channels if _TELEMETRY.search(topic))
        if role == "imu" and slow:
            text = f"{lack} that can be replayed: {listed(slow, 3)} is telemetry and too slow"
            raise LogError(text, _FULL_RATE)
        wanted = [type_name for types in required.by_type for type_name in types]
        empty = sorted(
            topic for topic, type_name in self._empty.items() if full_name(type_name) in wanted
        )
        found = sorted(
            {
                channel.type_name or topic
                for topic, same in self._channels.items()
                for channel in same
            }
        )
        but = f"; {listed(empty)} has a known type, but no messages" if empty else ""
        raise LogError(
            f"{lack}: no topic has one of its known types ({', '.join(wanted)}); it has {listed(found)}{but}",
            required.how_to_name(),
        )
