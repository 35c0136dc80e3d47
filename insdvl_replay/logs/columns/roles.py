"""Which topics play which role: by type where only one can, else as the configuration says."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import LogError, listed, nearest
from insdvl_replay.logs.columns.topic_requirements import (
    TRUTH_WISH,
    Source,
    Wish,
    dvl_wish,
    fix_wish,
    imu_wish,
    solution_wish,
)
from insdvl_replay.logs.container.channel import LogChannel


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
    imu = topics.need(imu_wish(config))
    dvl = topics.need(dvl_wish(config))
    references = _references(topics, config, dvl.topic)
    truth = topics.find(TRUTH_WISH)
    return Roles(imu, dvl, references, truth)


@dataclass(frozen=True)
class Finding:
    """What was found for one role, for a person who asks.

    Attributes
    ----------
    role : {'imu', 'dvl', 'reference', 'truth'}
    sources : tuple of Source
        Those that a replay reads; none, or, for a reference, up to two.
    reason : str
        Why these.
    error : LogError or None
        Why a replay would stop here.
    candidates : tuple of Source
        Where several topics could each play the role, each of them.
    """

    role: str
    sources: tuple[Source, ...]
    reason: str
    error: LogError | None = None
    candidates: tuple[Source, ...] = ()


def explain_roles(place: str, channels: Sequence[LogChannel], config: Config) -> tuple[Finding, ...]:
    """Find the topic for each role as `assign_roles` does, but go on where it would stop, and say why.

    Parameters
    ----------
    place : str
        The file, for messages to the user.
    channels : sequence of LogChannel
    config : Config

    Returns
    -------
    tuple of Finding
        IMU, DVL, reference, and truth where the log has it.
    """
    topics = _Topics(place, channels)
    imu = _explained(topics, imu_wish(config), lambda: (topics.need(imu_wish(config)),))
    dvl = _explained(topics, dvl_wish(config), lambda: (topics.need(dvl_wish(config)),))
    besides = dvl.sources[0].topic if dvl.sources else ""
    wish = solution_wish(config)
    reference = _explained(topics, wish, lambda: _references(topics, config, besides), besides)
    truth = _explained(topics, TRUTH_WISH, lambda: tuple(filter(None, [topics.find(TRUTH_WISH)])))
    return (imu, dvl, reference, truth) if truth.sources or truth.error else (imu, dvl, reference)


def _explained(topics: "_Topics", wish: Wish, look: Callable[[], tuple[Source, ...]], besides: str = "") -> Finding:
    try:
        sources = look()
    except LogError as error:
        candidates = tuple(topics.alternatives(wish, besides))
        reason = "see what stops a replay"
        if candidates:
            reason = f"{', '.join(source.topic for source in candidates)} could each be it"
        elif wish.topic is None and not topics.candidates(wish, besides):
            reason = topics.reason_for_none
        return Finding(wish.role, (), reason, error, candidates)
    if not sources:
        return Finding(wish.role, (), topics.reason_for_none)
    if wish.topic is not None:
        return Finding(wish.role, sources, f"named by {wish.key}")
    return Finding(wish.role, sources, "by type, which no other topic has")


def _references(topics: "_Topics", config: Config, dvl_topic: str) -> tuple[Source, ...]:
    wish = solution_wish(config)
    solution = topics.find(wish, besides=dvl_topic) or (topics.need(wish) if any(wish.paths.values()) else None)
    if solution and "latitude" in solution.fields and config.reference.fix is None:
        return (solution,)
    fix = topics.find(fix_wish(config))
    return tuple(source for source in (solution, fix) if source is not None)


class _Topics:
    """The topics of a log that have messages."""

    def __init__(self, place: str, channels: Sequence[LogChannel]) -> None:
        self._place = place
        self._channels: dict[str, list[LogChannel]] = {}
        for channel in channels:
            if channel.messages:
                self._channels.setdefault(channel.topic, []).append(channel)
        self._empty = {channel.topic: channel.type_name for channel in channels if channel.topic not in self._channels}

    @property
    def reason_for_none(self) -> str:
        """Why no topic plays a role that none is named for."""
        return "no message is of a type known for one" if self._channels else "the log has no messages"

    def need(self, wish: Wish) -> Source:
        """Find the topic of a role that a replay cannot do without."""
        source = self.find(wish)
        if source is None:
            raise self._lacks(wish)
        return source

    def _lacks(self, wish: Wish) -> LogError:
        """Say that no topic plays a role, and which might have."""
        lack = f"{self._place}: has no {wish.role.upper()}"
        if not self._channels:
            return LogError(f"{lack}: it has no messages at all", self._nothing_recorded())
        wanted = ", ".join(type_name for types in wish.by_type for type_name in types)
        empty = sorted(topic for topic, type_name in self._empty.items() if type_name in wanted.split(", "))
        found = sorted({one.type_name or one.topic for channels in self._channels.values() for one in channels})
        but = f"; {listed(empty)} would be, without a single message" if empty else ""
        return LogError(
            f"{lack}: no message is of a type known for one ({wanted}); it has {listed(found)}{but}",
            wish.how_to_name(),
        )

    def _nothing_recorded(self) -> str:
        announced = f" Announced are {listed(sorted(self._empty))}" if self._empty else ""
        return f"was anything recorded?{announced}"

    def find(self, wish: Wish, besides: str = "") -> Source | None:
        """Find the topic of a role, not looking at the topic of another."""
        topic = self._only_topic(wish, besides) if wish.topic is None else wish.topic
        return None if topic is None else self.source(wish, topic)

    def source(self, wish: Wish, topic: str) -> Source:
        """Make a topic the source of a role."""
        return wish.source(topic, self._channels_of(topic, wish.key), self._place)

    def candidates(self, wish: Wish, besides: str) -> list[str]:
        """Name the topics of the first group of types that the log has, the better types first."""
        for types in wish.by_type:
            order = list(types)
            type_of = {topic: channels[0].type_name for topic, channels in self._channels.items() if topic != besides}
            if found := [topic for topic, type_name in type_of.items() if type_name in types]:
                return sorted(found, key=lambda topic: order.index(type_of[topic]))
        return []

    def alternatives(self, wish: Wish, besides: str) -> Iterator[Source]:
        """Make sources of the topics between which the configuration has to choose; those that cannot be are left out.

        Parameters
        ----------
        wish : Wish
        besides : str
            A topic that has another role.

        Yields
        ------
        Source
        """
        candidates = self.candidates(wish, besides) if wish.topic is None else []
        for topic in candidates if len(candidates) > 1 else []:
            with suppress(LogError):
                yield self.source(wish, topic)

    def _only_topic(self, wish: Wish, besides: str) -> str | None:
        candidates = self.candidates(wish, besides)
        if len(candidates) > 1:
            named = " or ".join(f'{wish.key} = "{topic}"' for topic in candidates)
            hint = named if wish.key else "keep one of them"
            raise LogError(f"{self._place}: {' and '.join(candidates)} could each be the {wish.key or wish.role}", hint)
        return next(iter(candidates), None)

    def _channels_of(self, topic: str, key: str) -> list[LogChannel]:
        if topic not in self._channels:
            meant = nearest(topic, self._channels)
            there_are = f"those with messages are {listed(sorted(self._channels))}"
            hint = there_are if self._channels else self._nothing_recorded()
            raise LogError(
                f"{self._place}: has no messages on topic '{topic}' ({key})",
                f'the nearest is {key} = "{meant}"' if meant else hint,
            )
        return self._channels[topic]
