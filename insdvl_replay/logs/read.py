"""A log becomes a dive: which topics play the roles, and what becomes of their messages."""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

import numpy as np

from insdvl_replay.core.config import Config, Solution
from insdvl_replay.core.dive_columns import (
    Dive,
    DvlColumns,
    ImuColumns,
    ReferenceColumns,
    SensorColumns,
    SolutionColumns,
    TimeNs,
    TruthColumns,
    in_spans,
)
from insdvl_replay.core.dive_record import Channel, Clock, dive_name
from insdvl_replay.core.errors import LogError, Note, error_context
from insdvl_replay.core.held_out import Span, Why
from insdvl_replay.core.notes import note
from insdvl_replay.core.of_reference import solution_is_reference
from insdvl_replay.core.runtime import report_stage
from insdvl_replay.core.states import SENSORS
from insdvl_replay.logs.columns.dvl import decode_dvl
from insdvl_replay.logs.columns.imu import decode_imu, decode_truth
from insdvl_replay.logs.columns.reference import (
    decode_reference,
    decode_solution,
    read_tum,
)
from insdvl_replay.logs.columns.sensors import decode_log_topic, decode_sensor
from insdvl_replay.logs.columns.tables import SAMPLED, Table, clock_notes, read_tables, stamp_unit
from insdvl_replay.logs.columns.topics import (
    LOG_TOPIC,
    ROLES,
    Source,
    TopicRole,
    Topics,
    role_with,
    solution_name,
    solution_role,
)
from insdvl_replay.logs.file_clocks import align_files
from insdvl_replay.logs.formats.definitions import defines_nothing, missing_types
from insdvl_replay.logs.formats.log_file import LogChannel, by_topic
from insdvl_replay.logs.formats.mcap_file import MAGIC
from insdvl_replay.logs.formats.recording import open_recording


def read_dive(path: Path | Sequence[Path], config: Config, *, allow_damaged: bool = False) -> Dive:
    """Read everything that is needed to replay a dive, from a log, a folder with the parts of one, or several.

    The columns are clean and every loss is a note. Whether they can be true is not asked, and the span of the settings
    is not applied. A `LogError` where the file cannot be read, changes meanwhile or is damaged (unless that is
    allowed), has no IMU or DVL, is not clear about which topic is which, or mixes clocks; a `ConfigError` where axes
    or beam geometry of the settings cannot be.
    """
    report_stage("reading the log")
    log = open_recording(path, allow_damaged=allow_damaged)
    place = str(log.path)
    name = dive_name(log.path)
    config = config.of_dive(name)
    findings = find_roles(place, log.channels, config)
    for finding in findings:
        if finding.error is not None:
            raise finding.error
    sources = sources_of(findings)
    with log.watched(), ThreadPoolExecutor(1) as checker:
        digests = checker.submit(log.digests)
        align_files(log, sources, config)
        tables = read_tables(log, sources)
        log.check_unopened()
        sha256 = log.sha256(digests.result())
    notes = [*log.notes, *source_notes(sources), *loss_notes(tables), *stamp_notes(tables)]
    role_of = {source.topic: source.role for source in reversed(sources)}
    channels = tuple(
        _stored_channel(topic, same, role_of.get(topic, ""))
        for topic, same in sorted(by_topic(log.channels).items())
    )
    paths = tuple(part.path for part in log.parts)
    del log  # its open chunks are large, and decoding needs the room
    columns = RoleColumns(place, config)
    notes += columns.clock_notes([table.clock() for table in tables])
    for finding in findings:
        if finding.sources:
            of_role = [tables.pop(0) for _ in finding.sources]
            notes += columns.decode(finding.role, of_role)
    for filter_name, settings in config.solutions.items():
        if settings.file is not None:
            role = solution_role(filter_name)
            columns.solutions[filter_name], found = read_tum(Path(settings.file), settings, role)
            notes += found
    if columns.imu is None:
        raise ValueError("a dive without an IMU is an error of its finding")
    return Dive(
        name=name,
        imu=columns.imu,
        dvl=columns.dvl,
        reference=columns.reference,
        truth=columns.truth,
        sensors=columns.sensors,
        solutions=columns.solutions,
        topics=columns.topics,
        sha256=sha256,
        paths=paths,
        channels=channels,
        notes=tuple(notes),
    )


def _stored_channel(topic: str, channels: Sequence[LogChannel], role: str) -> Channel:
    """Return what results say of a topic."""
    return Channel(
        topic=topic,
        type_name=channels[0].type_name,
        encoding=channels[0].encoding,
        role=role,
        messages=sum(channel.messages for channel in channels),
    )


def held_back_messages(
    paths: Sequence[Path], config: Config, outages: Sequence[Span]
) -> dict[str, TimeNs | None]:
    """Return the log times of the messages that judge a filter, by topic; None stands for all of a topic.

    These are the reference, truth, onboard solutions and held-out sensors, and the DVL in outages, which are spans of
    its times of validity, without their starts.
    """
    log = open_recording(paths, allow_damaged=True)
    held_out = config.held_out.in_outages(outages).with_judges()
    found: dict[str, TimeNs | None] = {}
    of_dvl: list[Source] = []
    own_config = config.of_dive(dive_name(log.path))
    sources = sources_of(find_roles(str(log.path), log.channels, own_config))
    for source in sources:
        topic = config.topics.get(source.role.removeprefix(LOG_TOPIC))
        role = (topic and topic.sensor) or source.role
        why = held_out.why(role)
        if why == Why.OUTAGE:
            of_dvl.append(source)
        elif why is not None:
            found[source.topic] = None
    written = read_tables(log, of_dvl)
    align_files(log, sources, own_config)
    for as_written, table in zip(written, read_tables(log, of_dvl), strict=True):
        absent = in_spans(table.time_ns(), held_out.outages)
        found.setdefault(table.source.topic, as_written.columns["log_time"][absent, 0])
    return found


def read_solution(path: Path) -> tuple[SolutionColumns, list[Note]]:
    """Read a solution from a file of its own: from a log with one topic of a known type, or from a TUM file.

    A log may have a second topic with the geographic positions.
    """
    with path.open("rb") as file:
        if not file.read(len(MAGIC)).startswith(MAGIC):
            return read_tum(path, Solution(), "solution")
    log = open_recording(path)
    topics = Topics(str(path), log.channels)
    fix = role_with("solution", Solution(), "fix")
    role = role_with("solution", Solution())
    fixes = topics.candidates(fix, ())
    named = [topic for topic in by_topic(log.channels) if topic not in fixes]
    wanted = [topics.source(role, topic) for topic in named or fixes]
    if len(wanted) != 1 or len(fixes) > 1:
        text = f"has {len(named)} topics beside {len(fixes)} fixes"
        hint = "write one topic, such as nav_msgs/Odometry, and at most one of NavSatFix"
        raise LogError(text, hint, path)
    sources = wanted
    if named:
        sources += [topics.source(fix, topic) for topic in fixes]
    with log.watched():
        return decode_solution(read_tables(log, sources), Solution())


def source_notes(sources: Sequence[Source]) -> Iterator[Note]:
    """Note the topics whose log has no schema, or a part of one, and the solutions in messages of the reference."""
    for source in sources:
        if source.channels[0].encoding != "cdr":
            continue
        missing: set[str] = set()
        for channel in source.channels:
            if defines_nothing(channel.type_name, channel.schema_text):
                missing.add(channel.type_name)
            elif channel.schema_encoding != "ros2idl":
                missing.update(missing_types(channel.type_name, channel.schema_text))
        lacking = ", ".join(sorted(missing))
        if lacking:
            yield note("builtin_definition", types=lacking).about(source.topic)
    of_reference = {source.topic for source in sources if source.role == "reference"}
    for source in sources:
        name = solution_name(source.role)
        if name is not None and source.topic in of_reference:
            code = f"{solution_is_reference(name)} topic"
            yield note(code, role=source.role, topic=source.topic)


def loss_notes(tables: Iterable[Table]) -> list[Note]:
    """Note messages that are missing, do not fit their schema, or are in more than one channel or file."""
    missing = []
    left_out = []
    for table in tables:
        topic = table.source.topic
        unreadable = len(table.unreadable_ns)
        announced = sum(channel.messages for channel in table.source.channels)
        found = len(table) + table.others + table.duplicates + unreadable
        if announced != found:
            said = note(
                "messages_missing",
                abs(announced - found),
                announced=announced,
                found=found,
            )
            missing.append(said.about(topic))
        if unreadable and table.fault is not None:
            behind_s = (np.array(table.unreadable_ns) - table.columns["log_time"].min()) * 1e-9
            said = note(
                "messages_unreadable",
                unreadable,
                first_s=behind_s.min(),
                last_s=behind_s.max(),
                why=table.fault.message,
            )
            left_out.append(said.about(topic))
        if table.duplicates:
            left_out.append(note("messages_repeated", table.duplicates).about(topic))
    return [*missing, *left_out]


def stamp_notes(tables: Iterable[Table]) -> Iterator[Note]:
    """Note the unit of stamps that are plain numbers."""
    for table in tables:
        numbers = table.stamp_numbers
        if numbers is not None:
            unit = stamp_unit(numbers, table.columns["log_time"][:, 0])[1]
            code = f"{table.source.code}_stamp_unit"
            yield note(
                code,
                stamp=table.source.stamp,
                unit=unit,
            ).about(table.source.topic)


@dataclass
class RoleColumns:
    """The columns of the roles as far as they are read; the place is the file in messages to the user."""

    place: str
    config: Config
    imu: ImuColumns | None = None
    dvl: DvlColumns = field(
        default_factory=lambda: DvlColumns(np.empty(0, np.int64), velocity_d=np.empty((0, 3)))
    )
    reference: ReferenceColumns | None = None
    truth: TruthColumns | None = None
    sensors: dict[str, SensorColumns] = field(default_factory=dict)
    solutions: dict[str, SolutionColumns] = field(default_factory=dict)
    topics: dict[str, SensorColumns] = field(default_factory=dict)

    def decode(self, role: str, tables: list[Table]) -> list[Note]:
        """Make the columns of a role; the raw ones are let go, since those of a long dive are large."""
        if role == "reference":
            self.reference, notes = decode_reference(
                tables, self.config.reference, self.config.initial
            )
        elif role == "imu":
            self.imu, notes = decode_imu(tables.pop(), self.config.imu)
        elif role == "dvl":
            self.dvl, notes = decode_dvl(tables.pop(), self.config.dvl)
        elif role in SENSORS:
            self.sensors[role], notes = decode_sensor(role, tables.pop(), self.config)
        elif (name := solution_name(role)) is not None:
            self.solutions[name], notes = decode_solution(tables, self.config.solutions[name])
        elif role.startswith(LOG_TOPIC):
            self.topics[role.removeprefix(LOG_TOPIC)], notes = decode_log_topic(tables.pop())
        else:
            self.truth, notes = decode_truth(tables.pop())
        return notes

    def clock_notes(self, clocks: Sequence[Clock]) -> tuple[Note, ...]:
        """Compare the clocks of the roles, that of the IMU first."""
        return clock_notes(self.place, clocks, self.config.clocks.max_disagreement_s)


@dataclass(frozen=True)
class Finding:
    """What was found for one role."""

    role: str
    sources: tuple[Source, ...]  # those that a replay reads; none, or for a reference up to two
    reason: str
    error: LogError | None = None  # why a replay would stop here
    candidates: tuple[Source, ...] = ()  # where several topics could play the role, each of them


def find_roles(place: str, channels: Sequence[LogChannel], config: Config) -> tuple[Finding, ...]:
    """Find the topic for each role: IMU, DVL, reference, and truth where the log has it.

    A finding has an error where no topic is an IMU or a DVL, several are and the settings name none, a named topic is
    missing, its type is not known and the settings do not name its fields, or its messages cannot be read.
    """
    topics = Topics(place, channels)

    def needed(role: TopicRole) -> Finding:
        return _explained(topics, role, lambda: (topics.need(role),))

    imu = needed(role_with("imu", config.imu))
    dvl = needed(role_with("dvl", config.dvl))
    besides = {source.topic for source in dvl.sources}
    besides.update(own.topic for own in config.solutions.values() if own.topic)
    role = role_with("reference", config.reference)
    reference = Finding("reference", (), "ignored by the settings")
    if not config.reference.ignore:
        reference = _explained(topics, role, lambda: _references(topics, config, besides), besides)
    others = [needed(role_with(name, getattr(config, name))) for name in config.sensors]
    for name, section in config.topics.items():
        others.append(needed(role_with(f"{LOG_TOPIC}{name}", section, "topic")))
    for name, settings in config.solutions.items():
        if settings.topic is not None:
            others.append(_solution(topics, name, settings, reference))
    of_truth = ROLES["truth"]
    truth = _explained(topics, of_truth, lambda: tuple(filter(None, [topics.find(of_truth)])))
    if truth.sources or truth.error:
        others.append(truth)
    return imu, dvl, reference, *others


def single_references(
    place: str, channels: Sequence[LogChannel], config: Config
) -> Iterator[Source]:
    """Yield each topic that could be the reference by itself, solutions before fixes; none where settings name it."""
    reference = config.reference
    if reference.ignore or reference.topic is not None or reference.fix is not None:
        return
    topics = Topics(place, channels)
    role = role_with("reference", reference)
    for kind in (role, role_with("reference", reference, "fix", "fix")):
        for topic in topics.candidates(kind, ()):
            with suppress(LogError):
                yield topics.source(role, topic)


def sources_of(findings: Iterable[Finding]) -> list[Source]:
    """Return the topics that a replay reads, role by role."""
    sources: list[Source] = []
    for finding in findings:
        sources += finding.sources
    return sources


def _solution(
    topics: Topics,
    name: str,
    settings: Solution,
    reference: Finding,
) -> Finding:
    """Find the topics of an onboard solution, whose fields must not be those of the reference."""
    section = solution_role(name)
    wanted = [role_with(section, settings, "solution")]
    if settings.fix is not None:
        wanted.append(role_with(section, settings, "fix", "fix"))

    def look() -> tuple[Source, ...]:
        sources = tuple(map(topics.need, wanted))
        for source, other in product(sources, reference.sources):
            shared = _shared_fields(source, other)
            if other.topic == source.topic and shared:
                text = f"{source.role} and the reference read the same field, {shared[0]} of '{source.topic}'"
                hint = "to judge it by another reference: reference.topic and reference.fix"
                raise LogError(f"{text}: its error would be 0", hint)
        return sources

    return _explained(topics, wanted[0], look)


def _shared_fields(source: Source, other: Source) -> list[str]:
    """Return the fields from which two sources read the same quantity."""
    shared = []
    for quantity, path in source.fields.items():
        if quantity not in SAMPLED and other.fields.get(quantity) == path:
            shared.append(path)
    return shared


def idle_sensors(
    place: str,
    channels: Sequence[LogChannel],
    findings: Sequence[Finding],
    config: Config,
) -> dict[str, list[str]]:
    """Name the topics of unused sensors, by sensor: they could aid a filter and play no other role."""
    topics = Topics(place, channels)
    asked = {finding.role for finding in findings}
    taken: set[str] = set()
    for finding in findings:
        taken.update(source.topic for source in (*finding.sources, *finding.candidates))
    unused = [role_with(name, getattr(config, name)) for name in SENSORS if name not in asked]
    found = {role.name: topics.candidates(role, taken) for role in unused}
    return {name: candidates for name, candidates in found.items() if candidates}


def _explained(
    topics: Topics,
    role: TopicRole,
    look: Callable[[], tuple[Source, ...]],
    besides: Collection[str] = (),
) -> Finding:
    """Return the sources of a role, or the reason why there are none and the readable topics that are possible."""
    possible: list[str] = []
    if role.topic is None:
        possible = topics.candidates(role, besides)
    try:
        with error_context(topics.place):
            sources = look()
    except LogError as error:
        candidates = tuple(_readable(topics, role, possible))
        reason = "see the blockers"
        if candidates:
            reason = f"possible topics: {', '.join(source.topic for source in candidates)}"
        elif role.topic is None and not possible:
            reason = topics.reason_for_none
        return Finding(role.name, (), reason, error, candidates)
    reason = f"set by {role.key}"
    if not sources:
        reason = topics.reason_for_none
    elif role.topic is None:
        reason = "the only topic of a known type"
    return Finding(role.name, sources, reason)


def _readable(topics: Topics, role: TopicRole, possible: Sequence[str]) -> Iterator[Source]:
    """Give those of several topics that could play a role."""
    if len(possible) < 2:
        return
    for topic in possible:
        with suppress(LogError):
            yield topics.source(role, topic)


def _references(topics: Topics, config: Config, besides: Collection[str]) -> tuple[Source, ...]:
    role = role_with("reference", config.reference)
    solution = topics.find(role, besides)
    if solution is None and any(role.paths.values()):
        solution = topics.need(role)
    if solution is not None:
        has_place = bool(solution.fields.keys() & {"latitude", "origin"})
        if has_place and config.reference.fix is None:
            return (solution,)
    fix = topics.find(role_with("reference", config.reference, "fix", "fix"), besides)
    return tuple(source for source in (solution, fix) if source is not None)
