"""Which topics play which role: by type where only one can, else as the configuration says."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from insdvl_replay.config import Config
from insdvl_replay.errors import LogError
from insdvl_replay.logs import known_types
from insdvl_replay.logs.container import LogChannel
from insdvl_replay.logs.known_types import Fields, Types


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
        ``header``, ``log_time``, ``publish_time`` or a field path.
    latency_s : float
        From validity to stamp.
    """

    role: str
    topic: str
    type_name: str
    channels: tuple[LogChannel, ...]
    fields: Fields
    stamp: str
    latency_s: float


@dataclass(frozen=True)
class Roles:
    """The topics that are read.

    Attributes
    ----------
    imu, dvl : Source
    references : tuple of Source
        None, one, or two of which the second gives the position.
    truth : Source or None
        True sensor biases.
    """

    imu: Source
    dvl: Source
    references: tuple[Source, ...]
    truth: Source | None

    @property
    def sources(self) -> tuple[Source, ...]:
        """All topics that are read."""
        return (self.imu, self.dvl, *self.references, *((self.truth,) if self.truth else ()))


@dataclass(frozen=True)
class _Wish:
    """What a role needs: of several groups of types, the first that the log has is taken."""

    role: str
    key: str
    topic: str | None
    by_type: Sequence[Types]
    if_named: Types = field(default_factory=dict)
    paths: Mapping[str, str | None] = field(default_factory=dict)
    enough: Sequence[set[str]] = ()
    stamp: str = "header"
    latency_s: float = 0.0

    def fields(self, type_name: str) -> Fields:
        """Give the paths for a type, those of the configuration first."""
        known = next((types[type_name] for types in (*self.by_type, self.if_named) if type_name in types), {})
        return {**known, **{quantity: path for quantity, path in self.paths.items() if path is not None}}


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
        No topic is an IMU or a DVL, several are and the configuration names none, a named topic is not there, its type
        is not known and the configuration does not say where its fields are, or its messages are not ROS 2's.
    """
    topics = _Topics(place, channels)
    imu = topics.need(_imu_wish(config))
    dvl = topics.need(_dvl_wish(config))
    references = _references(topics, config, dvl)
    truth = topics.find(_Wish("truth", "", None, [known_types.TRUTH], enough=[{"accel_bias", "gyro_bias"}]))
    return Roles(imu, dvl, references, truth)


def _imu_wish(config: Config) -> _Wish:
    imu = config.imu
    return _Wish(
        role="imu",
        key="imu.topic",
        topic=imu.topic,
        by_type=[known_types.IMU],
        paths={"specific_force": imu.specific_force, "angular_rate": imu.angular_rate},
        enough=[{"specific_force", "angular_rate"}],
        stamp=imu.stamp,
        latency_s=imu.latency_s,
    )


def _dvl_wish(config: Config) -> _Wish:
    dvl = config.dvl
    return _Wish(
        role="dvl",
        key="dvl.topic",
        topic=dvl.topic,
        by_type=[known_types.DVL_BEAMS, known_types.DVL_VELOCITY],
        if_named=known_types.DVL_IF_NAMED,
        paths={"beam_velocity": dvl.beam_velocity, "velocity": dvl.velocity},
        enough=[{"beam_velocity"}, {"velocity"}],
        stamp=dvl.stamp,
        latency_s=dvl.latency_s,
    )


def _references(topics: "_Topics", config: Config, dvl: Source) -> tuple[Source, ...]:
    reference = config.reference
    stamp, latency_s = reference.stamp, reference.latency_s
    solution = topics.find(
        _Wish(
            role="reference",
            key="reference.topic",
            topic=reference.topic,
            by_type=[known_types.NAV_SOLUTION, known_types.ODOMETRY],
            if_named=known_types.FIX,
            enough=[{"velocity_n"}, {"velocity_b"}, {"latitude"}],
            stamp=stamp,
            latency_s=latency_s,
        ),
        besides=dvl.topic,
    )
    if solution and "latitude" in solution.fields and reference.fix is None:
        return (solution,)
    wish = _Wish("reference", "reference.fix", reference.fix, [known_types.FIX], enough=[{"latitude"}])
    fix = topics.find(replace(wish, stamp=stamp, latency_s=latency_s))
    return tuple(source for source in (solution, fix) if source is not None)


class _Topics:
    """The topics of a log that have messages."""

    def __init__(self, place: str, channels: Sequence[LogChannel]) -> None:
        self._place = place
        self._channels: dict[str, list[LogChannel]] = {}
        for channel in channels:
            if channel.messages:
                self._channels.setdefault(channel.topic, []).append(channel)

    def need(self, wish: _Wish) -> Source:
        """Find the topic of a role that a replay cannot do without."""
        source = self.find(wish)
        if source is None:
            wanted = " or ".join(type_name for types in wish.by_type for type_name in types)
            found = sorted({channel.type_name for channels in self._channels.values() for channel in channels})
            raise LogError(
                f"{self._place}: has no {wish.role.upper()}: no message of type {wanted}; "
                f"it has {', '.join(found) if found else 'no messages at all'}",
                _how_to_name(wish),
            )
        return source

    def find(self, wish: _Wish, besides: str = "") -> Source | None:
        """Find the topic of a role, not looking at the topic of another."""
        topic = self._only_topic(wish, besides) if wish.topic is None else wish.topic
        if topic is None:
            return None
        channels = self._channels_of(topic, wish.key)
        type_name, fields = channels[0].type_name, wish.fields(channels[0].type_name)
        if not any(quantities <= fields.keys() for quantities in wish.enough):
            raise LogError(
                f"{self._place}: topic '{topic}' is of type {type_name or 'unknown'}, "
                f"which is not known as a type for {wish.key}",
                _how_to_name(wish),
            )
        for channel in channels:
            self._check_encoding(channel)
        return Source(wish.role, topic, type_name, tuple(channels), fields, wish.stamp, wish.latency_s)

    def _only_topic(self, wish: _Wish, besides: str) -> str | None:
        for types in wish.by_type:
            topics = [topic for topic, channels in self._channels.items() if channels[0].type_name in types]
            candidates = [topic for topic in topics if topic != besides]
            if len(candidates) > 1:
                hint = f'{wish.key} = "{candidates[0]}"' if wish.key else "keep one of them"
                raise LogError(
                    f"{self._place}: {' and '.join(candidates)} could each be the {wish.key or wish.role}", hint
                )
            if candidates:
                return candidates[0]
        return None

    def _channels_of(self, topic: str, key: str) -> list[LogChannel]:
        if topic not in self._channels:
            nearest = difflib.get_close_matches(topic, self._channels, n=1, cutoff=0.0)
            raise LogError(
                f"{self._place}: has no messages on topic '{topic}' ({key})",
                f'the nearest is {key} = "{nearest[0]}"' if nearest else "the log has no messages at all",
            )
        return self._channels[topic]

    def _check_encoding(self, channel: LogChannel) -> None:
        if channel.encoding != "cdr" or channel.schema_encoding not in ("ros2msg", ""):
            raise LogError(
                f"{self._place}: messages on '{channel.topic}' are encoded as {channel.encoding or 'nothing'} with "
                f"{channel.schema_encoding or 'no'} schema; only cdr with ros2msg can be read",
                "name another topic, or record ROS 2 messages",
            )


def _how_to_name(wish: _Wish) -> str:
    """Say which keys lead to a topic of an unknown type."""
    if not wish.paths:
        return f"known are {', '.join(name for types in (*wish.by_type, wish.if_named) for name in types)}"
    section = wish.role
    paths = " and ".join(f'{section}.{quantity} = "field.path"' for quantity in wish.paths)
    joined = paths if section == "imu" else paths.replace(" and ", " or ")
    return f'for other types, set {wish.key} = "/topic" with {joined}'
