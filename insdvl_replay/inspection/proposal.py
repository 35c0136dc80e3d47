"""Settings to start from, for a log that cannot be replayed as it is.

There are three steps. Each one reads the log with the findings of the step before: the topic, fields and stamp of each
role; their units; whether their clocks agree. Trials find axes. Blockers that remain are reported too.

Each setting has the observation behind it, the alternatives, and whether a person must decide. A key whose value only
a person can know is a comment. Every other key has the likeliest value, so the proposal can be used as it is.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.checks.reference import velocity_misfit
from insdvl_replay.core.config import Config, Imu, Initial, Reference
from insdvl_replay.core.config_file import toml_value
from insdvl_replay.core.dive_columns import ImuColumns
from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import LogError, Note, UserError, listed
from insdvl_replay.core.notes import note
from insdvl_replay.core.states import BY_SENSOR, SENSORS
from insdvl_replay.core.units import SPECIFIC_FORCE_UNITS
from insdvl_replay.inspection.clock_words import apart
from insdvl_replay.inspection.dry_run import DryRun
from insdvl_replay.inspection.inventory import Blocker
from insdvl_replay.inspection.named_fields import dvl_settings, imu_settings, reference_settings
from insdvl_replay.inspection.probed_topics import (
    ProbedTopic,
    probe_topics,
)
from insdvl_replay.inspection.settings import Alternative, Setting, not_yet_set, with_settings
from insdvl_replay.inspection.table_clocks import table_clock_settings
from insdvl_replay.inspection.unit_by_size import force_units, is_rate_in_degrees
from insdvl_replay.logs.columns.reference import decode_reference
from insdvl_replay.logs.columns.tables import Table, clock_notes, read_tables
from insdvl_replay.logs.columns.topics import PROPOSED, TYPES, Source
from insdvl_replay.logs.file_clocks import align_files
from insdvl_replay.logs.formats.fields import TABLE
from insdvl_replay.logs.formats.recording import Recording, open_recording
from insdvl_replay.logs.read import Finding, find_roles, sources_of

_LONGEST: Final = 12  # topics that are listed at most


@dataclass(frozen=True)
class Proposal:
    """Settings that nobody has made yet."""

    settings: tuple[Setting, ...]
    blockers: tuple[Blocker, ...] = ()  # what stops a replay with them too
    notes: tuple[Note, ...] = ()
    # those of the settings that correct the clocks of tables
    table_clocks: tuple[Setting, ...] = ()
    clocks: tuple[Clock, ...] = ()  # by the stamps that the roles have without the settings


def propose_settings(
    path: Path | Sequence[Path], config: Config, *, allow_damaged: bool = False
) -> Proposal:
    """Propose what a replay lacks, by all messages of the roles.

    Raises
    ------
    LogError
        The file cannot be read, or is damaged and must not be.
    """
    log = open_recording(path, allow_damaged=allow_damaged)
    with log.watched():
        findings = find_roles(str(log.path), log.channels, config)
        with suppress(UserError):  # whoever replays reports it
            align_files(log, sources_of(findings), config)
        seen = DryRun(log, config, deep=False)
        seen.examine(findings)
        return propose(log, findings, seen, config, whole_reference=True)


def propose(
    log: Recording,
    findings: Sequence[Finding],
    seen: DryRun,
    config: Config,
    *,
    whole_reference: bool = False,
) -> Proposal:
    """Propose what a replay lacks, by what was seen of the roles; else what settles a contradiction.

    It takes the whole reference to find in which frame its velocity is.
    """
    if not seen.blockers and not list(_start(findings, config.initial)):
        if whole_reference or any(note.code == "reference_contradiction" for note in seen.notes):
            return Proposal(tuple(_measured_reference(log, findings, config)))
        return Proposal(())
    fields, unseen = _unknown_topics(log, findings, config)
    settings = [*_choices(findings, seen), *not_yet_set(fields, config)]
    draft = with_settings(config, settings)
    with suppress(UserError):
        align_files(log, sources_of(find_roles(str(log.path), log.channels, draft)), draft)
    clocks: list[Setting] = []
    if any(channel.encoding == TABLE for channel in log.channels):
        clocks = not_yet_set(table_clock_settings(log, with_settings(config, settings)), config)
        settings += clocks
    draft = with_settings(config, settings)
    settings += _measured(
        log, draft, settings, deep=seen.deep, whole_reference=whole_reference or seen.deep
    )
    draft = with_settings(config, settings)
    found = find_roles(str(log.path), log.channels, draft)
    settings += _start(found, draft.initial)
    last = DryRun(log, with_settings(config, settings), deep=False)
    last.examine(found)
    notes = []
    if unseen:
        notes.append(
            note(
                "topics_not_looked_at",
                len(unseen),
                topics=listed(unseen),
            )
        )
    return Proposal(
        tuple(settings), tuple(last.blockers), tuple(notes), tuple(clocks), tuple(seen.clocks)
    )


# --- Topics: one of several of a known type, or one of an unknown type.


def _choices(findings: Sequence[Finding], seen: DryRun) -> Iterator[Setting]:
    """Choose between topics that could each play a role, as far as settings can: none names that of the true biases."""
    for finding in findings:
        if finding.error and finding.candidates and finding.role in Config.__struct_fields__:
            yield _choice(finding, seen)


def _choice(finding: Finding, seen: DryRun) -> Setting:
    """Choose a topic without warnings, if there is one; one alone with which a replay would not stop is chosen."""
    topics = [source.topic for source in finding.candidates]
    # Those that cannot be it last, before them those with warnings.
    first, *others = sorted(
        topics, key=lambda topic: (topic in seen.refused, topic in seen.warned)
    )
    key = f"{finding.role}.topic"
    if first not in seen.refused and all(topic in seen.refused for topic in others):
        why = "; ".join(f"not {topic}: {seen.refused[topic]}" for topic in others)
        return Setting(key, first, why)
    ways = tuple(Alternative(f"topic = {toml_value(topic)}") for topic in others)
    return Setting(key, first, open="each of these is possible", others=ways)


@dataclass(frozen=True)
class _Proposed:
    """A role for which topics of unknown types are proposed."""

    role: str
    settings: Callable[[Recording, Sequence[ProbedTopic]], Iterator[Setting]]  # its topic first
    needed: tuple[str, ...] = ()  # what a person must name where no topic is found


_PROPOSED: Final = (
    _Proposed("imu", imu_settings, ("specific_force", "angular_rate")),
    _Proposed("dvl", dvl_settings, ("velocity",)),
    _Proposed("reference", reference_settings),
)


def _unknown_topics(
    log: Recording, findings: Sequence[Finding], config: Config
) -> tuple[list[Setting], Sequence[str]]:
    """Find topics of unknown types for the roles that no topic of a known type plays; name those not looked at."""
    wanted = _roles_without_topic(findings, config)
    if not wanted:
        return [], ()
    taken: set[str] = set()
    for finding in findings:
        if finding.role != "reference":
            taken.update(source.topic for source in finding.sources)
    # The filter that was flown is judged, and judges none.
    for channel in log.channels:
        if channel.type_name in TYPES["flown"]:
            taken.add(channel.topic)
    free = [channel for channel in log.channels if channel.topic not in taken]
    seen, unseen = probe_topics(log, free)
    settings: list[Setting] = []
    for proposed in _PROPOSED:
        if proposed.role not in wanted:
            continue
        candidates = _topics_for(proposed.role, seen, config)
        found = list(proposed.settings(log, candidates))
        if not found:
            settings += _listed(proposed.role, proposed.needed, candidates)
            continue
        settings += found
        # The topic of one role is no other's, but a table may have the columns of several.
        chosen = found[0].value
        seen = [topic for topic in seen if topic.is_table or topic.topic != chosen]
    return settings, unseen


def _roles_without_topic(findings: Sequence[Finding], config: Config) -> set[str]:
    """Name the roles that no topic of a known type can play; a reference only where the start needs one."""
    roles = set()
    for finding in findings:
        if not finding.sources and not finding.candidates:
            roles.add(finding.role)
    if config.initial.source != "reference":
        roles.discard("reference")
    return roles


def _topics_for(role: str, seen: Sequence[ProbedTopic], config: Config) -> Sequence[ProbedTopic]:
    """Return the topics that may play a role: the one that the configuration names, if the log has it, else all."""
    if role == "imu":
        seen = [topic for topic in seen if topic.is_table or topic.topic != config.dvl.topic]
    named = getattr(config, role).topic
    return [topic for topic in seen if topic.topic == named] or seen


def _listed(role: str, needed: Sequence[str], seen: Sequence[ProbedTopic]) -> Iterator[Setting]:
    """List every field with numbers, that a person may choose."""
    if not seen or not needed:
        return
    often = sorted(seen, key=lambda topic: -topic.channel.messages)
    lines = []
    for topic in often[:_LONGEST]:
        lines.append(f'"{topic.topic}", {topic.channel.messages} messages')
        for candidate in topic.candidates:
            lines += [f'  "{candidate.path}"', f"    {candidate}"]
        lines += [f'  "{path}", median {median:.3g}' for path, median in topic.scalars.items()]
    if (more := len(often) - _LONGEST) > 0:
        lines.append(f"and {more} topics with fewer messages")
    text = "no topic has fields with the names of this role; all topics with numbers, and their fields:"
    yield Setting(f"{role}.topic", None, open=text, listed=tuple(lines))
    for quantity in needed:
        text = 'a field of three numbers, or three fields such as "p, q, r"'
        others: tuple[Alternative, ...] = ()
        if quantity == "velocity":
            others = (Alternative("beam_velocity =", "one number for each beam"),)
        yield Setting(f"{role}.{quantity}", None, open=text, others=others)


# --- Units, clocks and frames, by what the messages show.

# What a known type is taken to give; only something else is worth a setting.
_DEFAULTS: Final = ("frd", "rad/s")
_FITS: Final = 0.1  # share of the distance by which velocity and positions may differ
_FITS_CLEARLY: Final = 0.3


def _measured(
    log: Recording,
    config: Config,
    settings: Sequence[Setting],
    *,
    deep: bool,
    whole_reference: bool,
) -> list[Setting]:
    """Evaluate units and clocks by what the messages show, read as proposed so far."""
    findings = find_roles(str(log.path), log.channels, config)
    seen = DryRun(log, config, deep)
    seen.examine(findings)
    measured = not_yet_set(_recorder_stamps(log, findings, seen.clocks, config), config)
    if seen.columns.imu is not None:
        (source,) = _finding_of("imu", findings).sources
        found = _measured_units(seen.columns.imu, source.completed(config.imu))
        if any(setting.key == "imu.angular_rate" for setting in settings):
            measured += found
        else:  # of a known type only what is unlike it, and of which topic it holds
            measured += [
                replace(setting, seen=f"{source.topic}: {setting.seen}")
                for setting in found
                if setting.value not in _DEFAULTS
            ]
    if whole_reference:
        measured += _measured_reference(log, findings, config)
    return measured


def _finding_of(role: str, findings: Sequence[Finding]) -> Finding:
    by_role = {finding.role: finding for finding in findings}
    return by_role[role]


def _recorder_stamps(
    log: Recording,
    findings: Sequence[Finding],
    clocks: Sequence[Clock],
    config: Config,
) -> Iterator[Setting]:
    """Stamp all roles by the recorder where their own clocks do not belong together."""
    why = _why_not_own_clocks(log, findings, clocks, config)
    if not why:
        return
    own = {clock.role: clock for clock in clocks if clock.role in (*PROPOSED, *SENSORS)}
    for role, clock in own.items():
        yield Setting(f"{role}.stamp", "log_time", f"{why}; {clock.topic}: {apart(clock)}")


def _why_not_own_clocks(
    log: Recording,
    findings: Sequence[Finding],
    clocks: Sequence[Clock],
    config: Config,
) -> str:
    """Return why the clocks of the roles do not belong together; empty if they do."""
    stamps: dict[tuple[str, str], str] = {}
    for finding in findings:
        for source in finding.sources:
            stamps[source.role, source.topic] = source.stamp
    for clock in clocks:
        if clock.stamp != stamps.get((clock.role, clock.topic), clock.stamp):
            return "not all stamps of the roles are times"
    if clocks and clocks[0].role == "imu":
        try:
            clock_notes(str(log.path), clocks, config.clocks.max_disagreement_s)
        except LogError:
            return "the clocks of the roles are unrelated"
    return ""


def _measured_units(imu: ImuColumns, settings: Imu) -> Iterator[Setting]:
    """Propose units by the size of gravity, and by how fast a vehicle can turn."""
    read_in = settings.specific_force_unit or "m/s2"
    size_mps2 = float(np.median(np.linalg.norm(imu.specific_force_b, axis=1)))
    size = size_mps2 / SPECIFIC_FORCE_UNITS[read_in]
    units = force_units(size, read_in)
    if units and read_in not in units:
        text = f"the size is {size:.3g}, which is gravity in this unit"
        yield Setting("imu.specific_force_unit", units[0], text)
    if settings.angular_rate_unit is not None:
        return
    sizes = np.linalg.norm(imu.angular_rate_b, axis=1)
    median = float(np.median(sizes))
    largest = float(sizes.max())
    if is_rate_in_degrees(median):
        text = f"the median is {median:.3g}, too fast for a vehicle in rad/s"
        yield Setting("imu.angular_rate_unit", "deg/s", text)
    else:
        text = f"the largest value is {largest:.3g}, possible in both units"
        yield Setting("imu.angular_rate_unit", "rad/s", text, "rad/s or deg/s, see the data sheet")


def _measured_reference(
    log: Recording, findings: Sequence[Finding], config: Config
) -> Iterator[Setting]:
    """Propose that the velocity of a reference is in the axes of the world, if only that fits its positions.

    `nav_msgs/Odometry` has it in the body by definition, but Gazebo writes it in the world.
    """
    if config.reference.velocity_n is not None:
        return
    for source in _finding_of("reference", findings).sources:
        if source.fields.keys() >= {"velocity_b", "local_position"}:
            yield from _velocity_frame(log, source, config)


def _velocity_frame(log: Recording, source: Source, config: Config) -> Iterator[Setting]:
    """Compare the velocity of a topic with its positions, in the axes of the body and of the world."""
    path = source.fields["velocity_b"]
    # The place on Earth does not matter for displacements.
    place = msgspec.structs.replace(
        config.initial, latitude_deg=config.initial.latitude_deg or 0.0
    )
    try:
        (table,) = read_tables(log, [source])
        in_body = _misfit(table, config.reference, place)
        fields = {**source.fields, "velocity_n": path}
        as_world = replace(table, source=replace(source, fields=fields))
        settings = msgspec.structs.replace(config.reference, velocity_n=path)
        in_world = _misfit(as_world, settings, place)
    except LogError:  # a reference that cannot be read is reported where it is used
        return
    if in_body is None or in_world is None:
        return
    if in_world <= min(_FITS, _FITS_CLEARLY * in_body):
        text = (
            f"in the axes of the world it differs by {in_world:.1%} from the displacements of the positions; in the "
            f"axes of the body, as its type defines it, by {in_body:.0%}"
        )
        yield Setting("reference.velocity_n", path, text)


def _misfit(table: Table, settings: Reference, place: Initial) -> float | None:
    """Return the share by which velocity and positions differ; None where one of them is missing."""
    columns, _ = decode_reference([table], settings, place)
    if columns is None:
        return None
    return velocity_misfit(columns)


# --- The start.


def _start(findings: Sequence[Finding], initial: Initial) -> Iterator[Setting]:
    """Name the keys without which a replay has no start, by what the type of the reference can give."""
    reference = _finding_of("reference", findings)
    if reference.candidates:
        return
    given: set[str] = set()
    for source in reference.sources:
        given.update(source.fields)
    from_reference = initial.source == "reference"
    if not given and from_reference:
        text = "no reference to start from; roll and pitch come from gravity"
        yield Setting("initial.source", "level", text)
    has_attitude = bool(given & {"quaternion", "roll"})
    is_posed = initial.source == BY_SENSOR or (from_reference and has_attitude)
    if initial.heading_deg is None and not is_posed:
        text = f'heading at the start, from north over east; "{BY_SENSOR}" if the log has an AHRS or a compass'
        yield Setting("initial.heading_deg", None, open=text)
    if initial.latitude_deg is None and "latitude" not in given:
        text = "for gravity and Earth rate; half a degree is accurate enough"
        yield Setting("initial.latitude_deg", None, open=text)
