"""Which topic plays which role: by type where only one topic has a known type, else as the settings say.

The message types that are known by name are in `known_types.toml`, by the groups in which roles look for them.
"""

import re
import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec

from insdvl_replay.core.config import TOPIC_KEYS, key_of
from insdvl_replay.core.errors import LogError, error_context, listed, nearest
from insdvl_replay.core.states import SENSORS, Sensor
from insdvl_replay.core.units import UNITS_BY_KIND, USUAL_UNITS, unit_at_end
from insdvl_replay.logs.columns.flags import flag_columns
from insdvl_replay.logs.formats.definitions import full_name
from insdvl_replay.logs.formats.fields import (
    TABLE,
    Element,
    Kinds,
    check_encoding,
    find_path,
    split_paths,
)
from insdvl_replay.logs.formats.known_formats import dvl_next_to, log_next_to
from insdvl_replay.logs.formats.log_file import LogChannel, by_topic
from insdvl_replay.logs.formats.readers import channel_paths, column_of
from insdvl_replay.logs.formats.table_rows import widths_of


class KnownType(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is known of a message type; `known_types.toml` says what each entry means."""

    names: tuple[str, ...] = ()
    fields: dict[str, str] = {}
    conventions: dict[str, Any] = {}
    stamp: str = ""
    element: tuple[str, ...] = ()
    about: str = ""


# By name; of two types that a log has, the earlier one is the better source.
Types = Mapping[str, KnownType]
# As a stamp: the recorder's time of arrival; of a file of an instrument the time that its reader found.
LOG_TIME: Final = "log_time"
_ENTRIES: Final = msgspec.toml.decode(
    Path(__file__).with_name("known_types.toml").read_text("utf-8"),
    type=dict[str, list[KnownType]],
)


def _by_name(entries: Sequence[KnownType]) -> Types:
    types: dict[str, KnownType] = {}
    for entry in entries:
        types |= dict.fromkeys(entry.names, entry)
    return types


TYPES: Final = {group: _by_name(entries) for group, entries in _ENTRIES.items()}


def _of_groups(groups: Iterable[str]) -> dict[str, KnownType]:
    """Return all types of some groups by their names."""
    types: dict[str, KnownType] = {}
    for group in groups:
        types |= TYPES[group]
    return types


def _upper_triangle(path: str, size: int, of: int = 6) -> str:
    """Name the upper triangle of the first rows of a covariance of some: of six, a third of what messages repeat."""
    elements = []
    for row in range(size):
        elements += [f"{path}[{of * row + column}]" for column in range(row, size)]
    return ", ".join(elements)


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
_SOLUTIONS: Final = (
    "nav_solution",
    "odometry",
    "poses",
    "fix",
    "onboard",
    "flown",
    "extended_fix",
)
for _group in _SOLUTIONS:
    TYPES[_group] = {
        name: msgspec.structs.replace(entry, fields={**entry.fields, **_COVARIANCES.get(name, {})})
        for name, entry in TYPES[_group].items()
    }
TYPES["solution"] = _of_groups(_SOLUTIONS)


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
    "local_position": ("length", ""),
    **dict.fromkeys(
        ("latitude", "longitude", "roll", "pitch", "heading"), ("angle", "angle_unit")
    ),
}
# Of increments over a time: their kind, and the unit in which they give the usual one of the rate.
_INCREMENTS: Final = {"specific_force": ("velocity", "m/s"), "angular_rate": ("angle", "rad")}
# Columns of a table that may mark pings as invalid, and that no setting names.
UNUSED_FLAGS: Final = "unused_flags"
LOG_TOPIC: Final = "topics."  # begins the role of a topic for user-defined measurements
BOW_DOWN: Final = "_bow_down"  # ends the name of a pitch with the opposite sign
# Roles for which `inspect` proposes topics and fields of unknown types.
PROPOSED: Final = ("imu", "dvl", "reference")
# Whole messages, as BlueOS records them.
_MAVLINK: Final = re.compile(r"(?:^|/)mavlink/\d+/\d+/([A-Z][A-Z0-9_]+)$")
# Of MAVLink, too slow to be replayed.
_TELEMETRY: Final = re.compile(r"(^|/)(RAW_IMU|SCALED_IMU\d?|HIGHRES_IMU)$")
_FULL_RATE: Final = (
    "give the vehicle's .BIN, which has every sample if LOG_REPLAY was 1: beside this log with --one-dive, or alone; "
    "see docs/inputs.md"
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
    # Of the type, where the settings leave a key out.
    conventions: Mapping[str, Any] = field(default_factory=dict)
    # Which elements of a list in the messages count, each as if it were a message.
    element: Element | None = None
    # From the unit in a column's title to the usual one.
    factors: Mapping[str, float] = field(default_factory=dict)

    @property
    def code(self) -> str:
        """The beginning of the codes of notes on it."""
        return code_of(self.role)

    def completed(self, section: Section) -> Section:
        """Fill in by the type what this role's settings leave out."""
        left_out = {}
        for key, value in self.conventions.items():
            if getattr(section, key) is None:
                left_out[key] = value
        return msgspec.structs.replace(section, **left_out)


@dataclass(frozen=True)
class TopicRole:
    """A role that a topic may play: what it needs of a topic, and what its settings say of topic, fields and stamp."""

    name: str
    # What it needs: a type that is known by name, or the field paths of the settings.
    quantities: Sequence[str] = ()  # whose paths the settings may name
    groups: Sequence[str] = ()  # of known types; the first of which the log has a type is taken
    if_named: Sequence[str] = ()  # and of those that only a topic may have that the settings name
    enough: Sequence[AbstractSet[str]] = ()  # the quantities of one of these sets must be there
    together: Sequence[AbstractSet[str]] = ()  # of each of these sets all must be there or none
    # What the settings say.
    key: str = ""  # that names the topic; empty where none does
    topic: str | None = None  # that they name
    paths: Mapping[str, str | None] = field(default_factory=dict)  # of fields, by quantity
    stamp: str | None = None
    latency_s: float = 0.0  # from validity to stamp
    frames: tuple[str, str] | None = None  # parent and child of the transforms that count
    unit_keys: AbstractSet[str] = frozenset()  # keys of units that they have
    has_increments: bool = False  # whether the readings of an IMU are increments

    @property
    def by_type(self) -> list[Types]:
        """The groups of types that are looked for."""
        return [TYPES[group] for group in self.groups]

    @property
    def types(self) -> Types:
        """All types that the topic may have."""
        return _of_groups((*self.if_named, *self.groups))

    def source(self, topic: str, channels: Sequence[LogChannel]) -> Source:
        """Make a topic the source of the role."""
        for channel in channels:
            check_encoding(channel)
        first = channels[0]
        with error_context(topic):
            paths = channel_paths(first)
        known = self.types.get(type_of(first), KnownType())
        fields = self._fields(known, paths)
        self._require_whole(topic, fields)
        self._require_enough(topic, first.type_name, known, fields, paths)
        element = self._element(topic, known)
        stamp = _stamp_of(known, paths) if self.stamp is None else self.stamp
        if first.untimed and stamp == LOG_TIME:
            by_rate = f'or count rows: {self.name}.stamp = "100 Hz"'
            hint = f"write seconds, the unit in the title as in time [h], or dates; {by_rate}"
            raise LogError(first.untimed, hint)
        factors: Mapping[str, float] = {}
        if first.encoding == TABLE:
            factors = self._factors(first, fields)
            if self.name == "dvl":
                fields |= _unused_flags(paths, fields)
        return Source(
            role=self.name,
            topic=topic,
            type_name=first.type_name,
            channels=tuple(channels),
            fields=fields,
            stamp=stamp,
            latency_s=self.latency_s,
            conventions=known.conventions,
            element=element,
            factors=factors,
        )

    def _fields(self, known: KnownType, paths: Kinds) -> dict[str, str]:
        """Return the path of each quantity: those of the settings, else those of the type that its schema has."""
        fields = {}
        for quantity, path in known.fields.items():
            # The same type name comes with different fields.
            if not paths or all(find_path(part, paths) for part in split_paths(path)):
                fields[quantity] = path
        fields |= {quantity: path for quantity, path in self.paths.items() if path}
        return fields

    def _require_whole(self, topic: str, fields: Collection[str]) -> None:
        """Refuse quantities without others that they are of no use without."""
        given = {quantity.removesuffix(BOW_DOWN) for quantity in fields}
        for quantities in self.together:
            lacking = sorted(quantities - given)
            alone = sorted(quantities & given)
            if lacking and alone:
                what = f"topic '{topic}' has {' and '.join(alone)}, but no {' and '.join(lacking)}"
                raise LogError(what, f'{self.name}.{lacking[0]} = "field.path"')

    def _require_enough(
        self,
        topic: str,
        type_name: str,
        known: KnownType,
        fields: Collection[str],
        paths: Kinds,
    ) -> None:
        """Refuse a topic that has too little for the role."""
        if any(quantities <= set(fields) for quantities in self.enough):
            return
        reason = (
            f"is of type {type_name or 'unknown'}, which is not known as a type for {self.key}"
        )
        hint = self.how_to_name()
        if known.fields:
            lacking = self._lacking(known, paths)
            reason = f"is of type {type_name}, but its schema lacks {', '.join(lacking)}"
            near = _nearest_of(lacking, known, paths)
            if near:
                hint = f"near: {', '.join(near)}; {hint}"
        raise LogError(f"topic '{topic}' {reason}", hint)

    def _lacking(self, known: KnownType, paths: Kinds) -> list[str]:
        """List the fields of a type that the role needs, and that a schema lacks."""
        needed = set[str]().union(*self.enough)
        lacking = dict[str, None]()
        for quantity, joined in known.fields.items():
            if quantity not in needed:
                continue
            for path in split_paths(joined):
                if not find_path(path, paths):
                    lacking[path] = None
        return [*lacking]

    def _element(self, topic: str, known: KnownType) -> Element | None:
        """Return which elements of a list in the messages count; None where the messages are no lists."""
        if known.element:
            return Element(known.element[0], known.element[1:], self.frames or ())
        if self.frames is not None:
            text = f"topic '{topic}' has no transforms, but {self.name}.frames is set"
            raise LogError(text, f"remove {self.name}.frames")
        return None

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
                    or_set = self._or_set(quantity, key, unit)
                    hint = f"known are {', '.join(units)}: convert the column{or_set}"
                    raise LogError(text, hint)
        return {path: factor for path, factor in factors.items() if factor != 1.0}

    def _or_set(
        self,
        quantity: str,
        key: str,
        unit: str,
    ) -> str:
        """End a hint on an unknown unit with the key that tells the unit, or that the readings are increments."""
        kind, _ = _INCREMENTS.get(quantity, ("", ""))
        if kind and unit in UNITS_BY_KIND[kind]:
            return f"; of increments set {self.name}.increment_s, the interval in seconds"
        if key:
            return f", or set {self.name}.{key}"
        return ""

    def how_to_name(self) -> str:
        """State which keys lead to a topic of an unknown type."""
        if not self.paths:
            return f"known types: {', '.join(self.types)}"
        ways = []
        for quantities in sorted(sorted(quantities) for quantities in self.enough):
            keys = [f'{self.name}.{name} = "field.path"' for name in quantities]
            ways.append(" and ".join(keys))
        does = "for a proposal" if self.name in PROPOSED else "for a list of topics"
        by_name = f'{self.key} = "/topic" with {" or ".join(ways)}'
        return f"for other types: {by_name}; {does}: `insdvl-replay inspect`"


def _nearest_of(lacking: Iterable[str], known: KnownType, paths: Kinds) -> list[str]:
    """Return the paths beside those that a schema lacks that may be misspelt; what the type uses is not."""
    used = set[str]()
    for joined in known.fields.values():
        used.update(split_paths(joined))
    near = list[str]()
    for path in lacking:
        within, dot, name = path.rpartition(".")
        names = list[str]()
        for other in paths:
            other_within, _, other_name = other.rpartition(".")
            if other_within == within and other not in used:
                names.append(other_name)
        meant = nearest(name, names)
        if meant:
            near.append(f"{within}{dot}{meant}")
    return near


def _stamp_of(known: KnownType, paths: Kinds) -> str:
    """Return the stamp of a type, else that of the header, else the recorder's time."""
    if known.stamp == LOG_TIME or find_path(known.stamp, paths):
        return known.stamp
    if find_path("header.stamp", paths):
        return "header"
    return LOG_TIME


def _unused_flags(paths: Collection[str], fields: Mapping[str, str]) -> dict[str, str]:
    """Return the columns of a DVL that may mark pings as invalid, where no field does; nothing without any."""
    if fields.keys() & {"valid", "invalid", "beam_valid"}:
        return {}
    used: set[str] = set()
    for joined in fields.values():
        used.update(split_paths(joined))
    single = [name for name in paths if f"{name}[*]" not in paths]
    flags = [name for name in flag_columns(single).names if name not in used]
    if not flags:
        return {}
    return {UNUSED_FLAGS: ", ".join(flags)}


_POSITION: Final = {"latitude", "longitude"}
_ANGLES: Final = (_POSITION, {"roll", "pitch", "heading"})
_MOTION: Final = ({"velocity_n"}, {"velocity_b"}, {"quaternion"}, *_ANGLES)
_IMU: Final = ("specific_force", "angular_rate")
_FIXES: Final = ("fix", "extended_fix")
_SENSOR_GROUPS: Final = {
    "depth": ("depth", "depth_of_dvl"),
    "heading": ("heading", "heading_of_imu", "heading_of_dvl"),
    "position": _FIXES,
}


def _role_of_sensor(name: str, sensor: Sensor) -> TopicRole:
    """Return the role of a sensor other than IMU and DVL."""
    if_named = f"{name}_if_named"
    return TopicRole(
        name,
        quantities=sensor.quantities,
        groups=_SENSOR_GROUPS.get(name, (name,)),
        if_named=[if_named] if if_named in TYPES else [],
        enough=sensor.enough,
        together=[sensor.together],
    )


# By kind; all onboard solutions share one, and so do all topics of user-defined measurements.
ROLES: Final = {
    "imu": TopicRole(
        "imu",
        quantities=(*_IMU, "increment_s"),
        groups=("imu", "imu_of_drivers"),
        if_named=["imu_if_named"],
        enough=[set(_IMU)],
    ),
    "dvl": TopicRole(
        "dvl",
        quantities=("beam_velocity", "beam_valid", "velocity", "valid", "invalid"),
        groups=("dvl_beams", "dvl_velocity"),
        if_named=["dvl_if_named"],
        enough=[{"beam_velocity"}, {"velocity"}],
    ),
    "reference": TopicRole(
        "reference",
        quantities=TOPIC_KEYS,
        groups=("nav_solution", "odometry"),
        if_named=(*_FIXES, "poses", "flown"),
        enough=(*_MOTION, {"local_position"}),
        together=_ANGLES,
    ),
    "fix": TopicRole("fix", groups=_FIXES, enough=[_POSITION]),
    "solution": TopicRole(
        "solution",
        quantities=TOPIC_KEYS,
        if_named=["solution"],
        enough=[*_MOTION, _POSITION, {"local_position"}],
        together=_ANGLES,
    ),
    "truth": TopicRole("truth", groups=["truth"], enough=[{"accel_bias", "gyro_bias"}]),
    "topic": TopicRole("topic", quantities=["values"], enough=[{"values"}]),
    **{name: _role_of_sensor(name, sensor) for name, sensor in SENSORS.items()},
}


def role_with(
    name: str,
    section: Any,
    kind: str = "",
    key: str = "topic",
) -> TopicRole:
    """Return a role of some kind with what its section of the settings says of topic, fields and stamp."""
    role = ROLES[kind or name]
    given = {quantity: getattr(section, quantity) for quantity in role.quantities}
    unit_keys = {name for _, name in _KINDS.values() if name}
    return replace(
        role,
        name=name,
        key=f"{name}.{key}",
        topic=getattr(section, key),
        paths={
            quantity: path if isinstance(path, str) else None for quantity, path in given.items()
        },
        has_increments=given.get("increment_s") is not None,
        stamp=section.stamp,
        latency_s=section.latency_s,
        frames=getattr(section, "frames", None) if key == "topic" else None,
        unit_keys={name for name in unit_keys if getattr(section, name, None) is not None},
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
        self._nothing_recorded = "was anything recorded?"
        if self._empty:
            self._nothing_recorded += f" Topics without messages: {listed(sorted(self._empty))}"
        self.reason_for_none = "the log has no messages"
        if self._channels:
            self.reason_for_none = "no topic has a known type for it"

    def source(self, role: TopicRole, topic: str) -> Source:
        """Make a topic the source of a role."""
        if topic in self._channels:
            return role.source(topic, self._channels[topic])
        what = f"has no messages on topic '{topic}' ({role.key})"
        raise LogError(what, self._hint_for_topic(role, topic))

    def _hint_for_topic(self, role: TopicRole, topic: str) -> str:
        """Say what may be meant by the name of a topic that is not there."""
        if role.key.endswith(".solution.topic") and key_of(topic) == "file":
            return f'for a file: {role.key.removesuffix("topic")}file = "{topic}"'
        meant = nearest(topic, self._channels)
        if meant:
            return f'the nearest is {role.key} = "{meant}"'
        if self._channels:
            return f"topics with messages: {listed(sorted(self._channels))}"
        return self._nothing_recorded

    def candidates(self, role: TopicRole, besides: Collection[str]) -> list[str]:
        """Name the topics of the first group of types that the log has, the better types first."""
        type_names = {topic: type_of(same[0]) for topic, same in self._channels.items()}
        for types in role.by_type:
            order = list(types)
            found = [topic for topic in type_names if type_names[topic] in types]
            found = [topic for topic in found if topic not in besides]
            if found:
                return sorted(found, key=lambda topic: order.index(type_names[topic]))
        return []

    def find(self, role: TopicRole, besides: Collection[str] = ()) -> Source | None:
        """Find the topic of a role, not looking at those of others."""
        if role.topic is not None:
            return self.source(role, role.topic)
        candidates = self.candidates(role, besides)
        if len(candidates) > 1:
            hint = "keep one of them"
            if role.key:
                hint = " or ".join(f'{role.key} = "{topic}"' for topic in candidates)
            what = f"{' and '.join(candidates)} could each be the {role.key or role.name}"
            raise LogError(what, hint)
        if candidates:
            return self.source(role, candidates[0])
        return None

    def need(self, role: TopicRole) -> Source:
        """Find the topic of a role that a replay needs."""
        source = self.find(role)
        if source is None:
            raise self._error_for_none(role)
        return source

    def _error_for_none(self, role: TopicRole) -> LogError:
        """Return the error for a role that no topic plays."""
        lack = f"has no topic for the {role.name}"
        if role.name in ("imu", "dvl"):
            lack = f"has no {role.name.upper()}"
        if not self._channels:
            return LogError(f"{lack}: it has no messages at all", self._nothing_recorded)
        if all(_is_of_instrument(channels) for channels in self._channels.values()):
            return self._error_for_instruments(role, lack)
        if all(_is_table(channels) for channels in self._channels.values()):
            what = f"{lack}: no setting names a table for it; it has {listed(self._tables())}"
            return LogError(what, _hint_for_tables(role))
        slow = sorted(topic for topic in self._channels if _TELEMETRY.search(topic))
        if role.name == "imu" and slow:
            text = f"{lack} that can be replayed: {listed(slow, 3)} is telemetry and too slow"
            return LogError(text, _FULL_RATE)
        wanted: list[str] = []
        for types in role.by_type:
            wanted += types
        what = f"{lack}: no topic has one of its known types ({', '.join(wanted)}); it has {listed(self._types())}"
        empty = [topic for topic in self._empty if full_name(self._empty[topic]) in wanted]
        if empty:
            what += f"; {listed(sorted(empty))} has a known type, but no messages"
        return LogError(what, self._dvl_next_to(role) + role.how_to_name())

    def _dvl_next_to(self, role: TopicRole) -> str:
        """Say how a log without a DVL is read with the only file of one beside it; empty where there is none."""
        if role.name != "dvl":
            return ""
        log = Path(self.place)
        dvl = dvl_next_to(log)
        if dvl is None:
            return ""
        return f"{dvl.name} beside it is of a DVL: {_command_for(log, dvl)}; "

    def _error_for_instruments(self, role: TopicRole, lack: str) -> LogError:
        """Return the error for a role that no file of an instrument plays, such as the IMU beside a DVL alone."""
        what = f"{lack}: it has {listed(sorted(self._channels))} of an instrument"
        file = Path(self.place)
        log = log_next_to(file)
        if role.name == "imu" and log is not None:
            hint = f"if {log.name} beside it has one: {_command_for(log, file)}"
            return LogError(what, hint)
        other = Path("imu.csv" if role.name == "imu" else f"{role.name}.csv")
        hint = (
            f"add the file that has it: {_command_for(file, other)}, or put both into one folder "
            "and give the folder"
        )
        return LogError(what, hint)

    def _tables(self) -> list[str]:
        """Name the tables, each with its columns."""
        tables = []
        for topic, channels in sorted(self._channels.items()):
            columns = [name for channel in channels for name in widths_of(channel)]
            tables.append(f"{topic} ({listed(columns)})")
        return tables

    def _types(self) -> list[str]:
        """Name the types of the messages; of those without type, their topics."""
        names: set[str] = set()
        for topic, channels in self._channels.items():
            names.update(channel.type_name or topic for channel in channels)
        return sorted(names)


def _command_for(file: Path, other: Path) -> str:
    """Write the command that reads two files as one dive."""
    return f"`insdvl-replay run --one-dive {shlex.quote(str(file))} {shlex.quote(str(other))}`"


def _is_table(channels: Sequence[LogChannel]) -> bool:
    return all(channel.encoding == TABLE for channel in channels)


def _is_of_instrument(channels: Sequence[LogChannel]) -> bool:
    """Return whether a topic is decoded from what an instrument wrote; a table that a user made has no type."""
    return _is_table(channels) and channels[0].type_name != TABLE


def _hint_for_tables(role: TopicRole) -> str:
    """Say how tables are given whole, and which keys name the table of a role and its fields."""
    ways = []
    for quantities in role.enough:
        ways.append(" and ".join(f"{role.name}.{name}" for name in sorted(quantities)))
    whole = "give the folder of all tables, or all of them with --one-dive"
    return f"{whole}; to name its fields: {role.key} with {' or '.join(ways)}"
