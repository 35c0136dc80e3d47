"""Which topics play which role: by type where only one can, else as the configuration says."""

import re
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from insdvl_replay.core.config import Config, Solution, key_of
from insdvl_replay.core.dive_columns import (
    DvlColumns,
    ImuColumns,
    ReferenceColumns,
    SensorColumns,
    SolutionColumns,
    TruthColumns,
)
from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import LogError, Note, error_context, listed, nearest
from insdvl_replay.core.states import SENSORS
from insdvl_replay.logs.columns.dvl import decode_dvl
from insdvl_replay.logs.columns.imu import decode_imu, decode_truth
from insdvl_replay.logs.columns.reference import decode_reference
from insdvl_replay.logs.columns.sensors import decode_own_topic, decode_sensor
from insdvl_replay.logs.columns.solutions import decode_solution, solution_name, solution_role
from insdvl_replay.logs.columns.tables import Table, clock_notes
from insdvl_replay.logs.columns.topic_requirements import (
    OWN_TOPIC,
    TRUTH_REQUIREMENT,
    Source,
    TopicRequirement,
    dvl_requirement,
    fix_requirement,
    imu_requirement,
    own_requirement,
    own_solution_requirement,
    sensor_requirement,
    solution_requirement,
    type_of,
)
from insdvl_replay.logs.columns.tum import read_tum
from insdvl_replay.logs.container.records import LogChannel, by_topic
from insdvl_replay.logs.encoding.ros2msg import full_name

_TELEMETRY: Final = re.compile(r"(^|/)(RAW_IMU|SCALED_IMU\d?|HIGHRES_IMU)$")
"""Topics of MAVLink's messages, as BlueOS records them."""
_FULL_RATE: Final = (
    "the vehicle's .BIN has every sample, if LOG_REPLAY was 1: clydemcqueen/dive_to_bag writes a bag of it; "
    "docs/inputs.md says more"
)


def _no_pings() -> DvlColumns:
    return DvlColumns(np.empty(0, np.int64), velocity_d=np.empty((0, 3)))


@dataclass
class RoleColumns:
    """The columns of the roles as far as they are read; the place is the file, for messages to the user."""

    place: str
    config: Config
    imu: ImuColumns | None = None
    dvl: DvlColumns = field(default_factory=_no_pings)
    reference: ReferenceColumns | None = None
    truth: TruthColumns | None = None
    sensors: dict[str, SensorColumns] = field(default_factory=dict)
    solutions: dict[str, SolutionColumns] = field(default_factory=dict)
    topics: dict[str, SensorColumns] = field(default_factory=dict)

    def decode(self, role: str, tables: list[Table]) -> list[Note]:
        """Make the columns of a role; the raw ones are let go, since those of a long dive are large."""
        if role == "reference":
            self.reference, notes = decode_reference(tables, self.config.reference, self.config.initial)
        elif role == "imu":
            self.imu, notes = decode_imu(tables.pop(), self.config.imu)
        elif role == "dvl":
            self.dvl, notes = decode_dvl(tables.pop(), self.config.dvl)
        elif role in SENSORS:
            self.sensors[role], notes = decode_sensor(role, tables.pop(), self.config)
        elif (name := solution_name(role)) is not None:
            self.solutions[name], notes = decode_solution(tables, self.config.solutions[name])
        elif role.startswith(OWN_TOPIC):
            self.topics[role.removeprefix(OWN_TOPIC)], notes = decode_own_topic(tables.pop())
        else:
            self.truth, notes = decode_truth(tables.pop())
        return notes

    def read_files(self) -> list[Note]:
        """Read the solutions that stand in files beside the log."""
        notes = []
        for name, settings in self.config.solutions.items():
            if settings.file is not None:
                self.solutions[name], found = read_tum(Path(settings.file), settings, solution_role(name))
                notes += found
        return notes

    def clock_notes(self, clocks: Sequence[Clock]) -> tuple[Note, ...]:
        """Compare the clocks of the roles, that of the IMU first, as `tables.clock_notes`."""
        return clock_notes(self.place, clocks, self.config.clocks.max_disagreement_s)


@dataclass(frozen=True)
class Finding:
    """What was found for one role.

    Attributes
    ----------
    role : str
        As of `topic_requirements.Source`.
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


def find_roles(place: str, channels: Sequence[LogChannel], config: Config) -> tuple[Finding, ...]:
    """Find the topic for each role: IMU, DVL, reference, and truth where the log has it.

    A finding has an error where no topic is an IMU or a DVL, several are and the configuration names none, a named
    topic is not there, its type is not known and the configuration does not say where its fields are, or its messages
    cannot be read.
    """
    topics = _Topics(place, channels)
    imu, dvl = _needed(topics, imu_requirement(config)), _needed(topics, dvl_requirement(config))
    besides = {source.topic for source in dvl.sources} | {own.topic for own in config.solutions.values() if own.topic}
    required = solution_requirement(config)
    reference = _explained(topics, required, lambda: _references(topics, config, besides), besides)
    named = ((name, own) for name, own in config.solutions.items() if own.topic is not None)
    solutions = [_solution(topics, own, solution_role(name), reference.sources) for name, own in named]
    truth = _explained(topics, TRUTH_REQUIREMENT, lambda: tuple(filter(None, [topics.find(TRUTH_REQUIREMENT)])))
    sensors = [_needed(topics, sensor_requirement(name, config)) for name in config.sensors]
    sensors += [_needed(topics, own_requirement(name, config)) for name in config.topics]
    return (imu, dvl, reference, *sensors, *solutions, *([truth] if truth.sources or truth.error else []))


def idle_sensors(
    place: str, channels: Sequence[LogChannel], findings: Sequence[Finding], config: Config
) -> dict[str, list[str]]:
    """Name the topics of sensors that nobody asks for, by sensor: what could aid a filter, and plays no other role."""
    topics, asked = _Topics(place, channels), {finding.role for finding in findings}
    taken = {source.topic for finding in findings for source in (*finding.sources, *finding.candidates)}
    found = {name: topics.candidates(sensor_requirement(name, config), taken) for name in SENSORS if name not in asked}
    return {name: candidates for name, candidates in found.items() if candidates}


def _needed(topics: "_Topics", required: TopicRequirement) -> Finding:
    return _explained(topics, required, lambda: (topics.need(required),))


def _explained(
    topics: "_Topics", required: TopicRequirement, look: Callable[[], tuple[Source, ...]], besides: Collection[str] = ()
) -> Finding:
    try:
        with error_context(topics.place):
            sources = look()
    except LogError as error:
        candidates = tuple(topics.alternatives(required, besides))
        reason = "see what stops a replay"
        if candidates:
            reason = f"{', '.join(source.topic for source in candidates)} could each be it"
        elif required.topic is None and not topics.candidates(required, besides):
            reason = topics.reason_for_none
        return Finding(required.role, (), reason, error, candidates)
    if not sources:
        return Finding(required.role, (), topics.reason_for_none)
    if required.topic is not None:
        return Finding(required.role, sources, f"named by {required.key}")
    return Finding(required.role, sources, "by type, which no other topic has")


def _references(topics: "_Topics", config: Config, besides: Collection[str]) -> tuple[Source, ...]:
    required = solution_requirement(config)
    solution = topics.find(required, besides) or (topics.need(required) if any(required.paths.values()) else None)
    if solution and solution.fields.keys() & {"latitude", "origin"} and config.reference.fix is None:
        return (solution,)
    fix = topics.find(fix_requirement(config.reference, "reference"), besides)
    return tuple(source for source in (solution, fix) if source is not None)


def _solution(topics: "_Topics", settings: Solution, role: str, reference: Sequence[Source]) -> Finding:
    required = own_solution_requirement(settings, role)
    of_fix = [fix_requirement(settings, role)] if settings.fix is not None else []

    def look() -> tuple[Source, ...]:
        sources = tuple(map(topics.need, [required, *of_fix]))
        for source in sources:
            _raise_if_same(source, reference)
        return sources

    return _explained(topics, required, look)


def _raise_if_same(source: Source, reference: Sequence[Source]) -> None:
    """Refuse a solution that is what it would be judged by."""
    for other in reference:
        shared = [path for name, path in source.fields.items() if other.fields.get(name) == path]
        if other.topic == source.topic and shared:
            what = f"{source.role} reads {shared[0]} of topic '{source.topic}', which is the reference"
            raise LogError(
                f"{what}: its error would be 0",
                "reference.topic and reference.fix name what it is to be judged by",
            )


class _Topics:
    """The topics of a log that have messages."""

    def __init__(self, place: str, channels: Sequence[LogChannel]) -> None:
        self.place = place
        self._channels = by_topic(channel for channel in channels if channel.messages)
        self._empty = {channel.topic: channel.type_name for channel in channels if channel.topic not in self._channels}

    @property
    def reason_for_none(self) -> str:
        """Why no topic plays a role that none is named for."""
        return "no message is of a type known for one" if self._channels else "the log has no messages"

    def need(self, required: TopicRequirement) -> Source:
        """Find the topic of a role that a replay cannot do without."""
        source = self.find(required)
        if source is None:
            raise self._lacks(required)
        return source

    def _lacks(self, required: TopicRequirement) -> LogError:
        """State that no topic plays a role, and which might have."""
        lack = (
            f"has no {required.role.upper() if required.role in ('imu', 'dvl') else f'topic for the {required.role}'}"
        )
        if not self._channels:
            return LogError(f"{lack}: it has no messages at all", self._nothing_recorded())
        wanted = ", ".join(type_name for types in required.by_type for type_name in types)
        empty = sorted(topic for topic, type_name in self._empty.items() if full_name(type_name) in wanted.split(", "))
        found = sorted({one.type_name or one.topic for channels in self._channels.values() for one in channels})
        but = f"; {listed(empty)} would be, without a single message" if empty else ""
        if required.role == "imu" and (slow := [topic for topic in self._channels if _TELEMETRY.search(topic)]):
            what = f"{lack} that can be replayed: {listed(sorted(slow), 3)} is telemetry and too slow"
            return LogError(what, _FULL_RATE)
        return LogError(
            f"{lack}: no message is of a type known for one ({wanted}); it has {listed(found)}{but}",
            required.how_to_name(),
        )

    def _nothing_recorded(self) -> str:
        announced = f" Announced are {listed(sorted(self._empty))}" if self._empty else ""
        return f"was anything recorded?{announced}"

    def find(self, required: TopicRequirement, besides: Collection[str] = ()) -> Source | None:
        """Find the topic of a role, not looking at those of others."""
        topic = self._only_topic(required, besides) if required.topic is None else required.topic
        return None if topic is None else self.source(required, topic)

    def source(self, required: TopicRequirement, topic: str) -> Source:
        """Make a topic the source of a role."""
        return required.source(topic, self._channels_of(topic, required.key))

    def candidates(self, required: TopicRequirement, besides: Collection[str]) -> list[str]:
        """Name the topics of the first group of types that the log has, the better types first."""
        for types in required.by_type:
            order = list(types)
            looked_at = {topic: channels[0] for topic, channels in self._channels.items() if topic not in besides}
            type_names = {topic: type_of(channel) for topic, channel in looked_at.items()}
            if found := [topic for topic, type_name in type_names.items() if type_name in types]:
                return sorted(found, key=lambda topic: order.index(type_names[topic]))
        return []

    def alternatives(self, required: TopicRequirement, besides: Collection[str]) -> Iterator[Source]:
        """Make sources of the topics between which the configuration has to choose, of those that can be."""
        candidates = self.candidates(required, besides) if required.topic is None else []
        for topic in candidates if len(candidates) > 1 else []:
            with suppress(LogError):
                yield self.source(required, topic)

    def _only_topic(self, required: TopicRequirement, besides: Collection[str]) -> str | None:
        candidates = self.candidates(required, besides)
        if len(candidates) > 1:
            named = " or ".join(f'{required.key} = "{topic}"' for topic in candidates)
            hint = named if required.key else "keep one of them"
            raise LogError(f"{' and '.join(candidates)} could each be the {required.key or required.role}", hint)
        return next(iter(candidates), None)

    def _channels_of(self, topic: str, key: str) -> list[LogChannel]:
        if topic not in self._channels:
            meant = nearest(topic, self._channels)
            there_are = f"those with messages are {listed(sorted(self._channels))}"
            hint = there_are if self._channels else self._nothing_recorded()
            if key.endswith(".solution.topic") and key_of(topic) == "file":
                hint, meant = f'a file is {key.removesuffix("topic")}file = "{topic}"', None
            raise LogError(
                f"has no messages on topic '{topic}' ({key})",
                f'the nearest is {key} = "{meant}"' if meant else hint,
            )
        return self._channels[topic]
