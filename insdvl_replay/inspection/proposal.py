"""Settings to start from, for a log that cannot be replayed as it is.

In three steps, each of which reads with what the one before has found: who plays which role, with which fields and
stamps; what units and axes those show; and whether their clocks agree. What then stops a replay is said too.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

from insdvl_replay.checks.plausibility import gyro_scale
from insdvl_replay.core.config import Config, Initial
from insdvl_replay.core.config_file import toml_value
from insdvl_replay.core.dive_columns import ImuColumns
from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import LogError, Note, listed
from insdvl_replay.core.states import BY_SENSOR
from insdvl_replay.inspection.dry_run import DryRun
from insdvl_replay.inspection.dvl_proposal import dvl_settings, dvl_topic, measured_dvl
from insdvl_replay.inspection.imu_proposal import corrected_rates, imu_settings, imu_topic, measured_imu, measured_scale
from insdvl_replay.inspection.inventory import Obstacle
from insdvl_replay.inspection.proposed_settings import (
    Setting,
    not_yet_set,
    recorder_stamps,
    settings_toml,
    undecided_keys,
    with_settings,
)
from insdvl_replay.inspection.reference_proposal import measured_reference, reference_settings, reference_topic
from insdvl_replay.inspection.topic_probe import ProbedTopic, probe_topics
from insdvl_replay.logs.columns.roles import Finding, find_roles
from insdvl_replay.logs.columns.tables import clock_notes
from insdvl_replay.logs.columns.topic_requirements import Source
from insdvl_replay.logs.container.recording import Recording

_NEEDED: Final = {"imu": ("specific_force", "angular_rate"), "dvl": ("velocity",)}
_INSTEAD: Final = {"velocity": ("beam_velocity =  # one number for each beam",)}
_LONGEST: Final = 12
"""Topics that are listed at most."""


def listed_settings(role: str, seen: Sequence[ProbedTopic]) -> Iterator[Setting]:
    """List every field with numbers, that a person may choose."""
    if not seen or role not in _NEEDED:
        return
    often = sorted(seen, key=lambda topic: -topic.channel.messages)
    lines = [line for topic in often[:_LONGEST] for line in _lines(topic)]
    if (more := len(often) - _LONGEST) > 0:
        lines.append(f"and {more} topics with fewer messages")
    text = "no topic has fields that are named like those of this role; the topics with numbers, and their fields, are"
    yield Setting(f"{role}.topic", None, open=text, listed=tuple(lines))
    for quantity in _NEEDED[role]:
        text = 'one of three numbers, or three side by side as in "p, q, r"'
        yield Setting(f"{role}.{quantity}", None, open=text, others=_INSTEAD.get(quantity, ()))


def _lines(topic: ProbedTopic) -> Iterator[str]:
    yield f'"{topic.topic}", {topic.channel.messages} messages'
    for candidate in topic.candidates:
        yield f'  "{candidate.path}"'
        yield f"    {candidate}"
    for path, median in topic.scalars.items():
        yield f'  "{path}", median {median:.3g}'


_DEFAULTS: Final = ("frd", "rad/s")
"""What a known type is taken to give; only something else is worth a setting."""


_REFERENCE: Final = 2
"""Its place among the findings."""
_ROLES: Final = (
    ("imu", imu_topic, imu_settings),
    ("dvl", dvl_topic, dvl_settings),
    ("reference", reference_topic, reference_settings),
)
"""How the topic of each role is chosen, and what is then proposed for it; what one has is no other's."""


@dataclass(frozen=True)
class Proposal:
    """Settings that nobody has made yet, and as TOML; the keys to decide in it, and what stops a replay with it too."""

    settings: tuple[Setting, ...] = ()
    configuration: str = ""
    decisions: tuple[str, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()
    notes: tuple[Note, ...] = ()


def propose(log: Recording, findings: Sequence[Finding], seen: DryRun, config: Config) -> Proposal:
    """Propose what a replay lacks, by what was seen of the roles; else what settles a contradiction."""
    if not seen.obstacles and not list(_start(findings, config.initial)):
        contradicted = any(note.code == "reference_contradiction" for note in seen.notes)
        sources = findings[_REFERENCE].sources if contradicted else ()
        settled = [setting for source in sources for setting in measured_reference(log, source, config)]
        return Proposal(tuple(settled), settings_toml(settled))
    fields, notes = _fields(log, findings, config)
    settings = [*_choices(findings, seen), *not_yet_set(fields, config)]
    settings += _measured(log, with_settings(config, settings), settings, deep=seen.deep)
    draft = with_settings(config, settings)
    found = find_roles(str(log.path), log.channels, draft)
    settings += _start(found, draft.initial)
    last = DryRun(log, with_settings(config, settings), deep=False)
    last.examine(found)
    return Proposal(tuple(settings), settings_toml(settings), undecided_keys(settings), tuple(last.obstacles), notes)


def _choices(findings: Sequence[Finding], seen: DryRun) -> Iterator[Setting]:
    """Choose between topics that could each play a role, those without warnings first; one alone that can is chosen.

    As far as settings can: none names that of the true biases.
    """
    for finding in findings:
        if finding.error and finding.candidates and finding.role in Config.__struct_fields__:
            first, *others = sorted((source.topic for source in finding.candidates), key=_doubts(seen))
            key = f"{finding.role}.topic"
            if first not in seen.refused and all(topic in seen.refused for topic in others):
                yield Setting(key, first, "; ".join(f"{topic} cannot be it: {seen.refused[topic]}" for topic in others))
                continue
            lines = tuple(f"topic = {toml_value(topic)}" for topic in others)
            yield Setting(key, first, open="each of these could be it", others=lines)


def _doubts(seen: DryRun) -> Callable[[str], tuple[bool, bool]]:
    """Order topics: those that cannot be last, before them those with warnings."""
    return lambda topic: (topic in seen.refused, topic in seen.doubted)


def _fields(log: Recording, findings: Sequence[Finding], config: Config) -> tuple[list[Setting], tuple[Note, ...]]:
    """Find topics of unknown types for the roles that no topic of a known type plays; note what was not looked at."""
    wanted = {finding.role for finding in findings if not finding.sources and not finding.candidates}
    if config.initial.source != "reference":
        wanted -= {"reference"}
    if not wanted:
        return [], ()
    taken = {source.topic for finding in findings for source in finding.sources if source.role != "reference"}
    seen, unseen = probe_topics(log, [channel for channel in log.channels if channel.topic not in taken])
    settings: list[Setting] = []
    for role, choose, settings_of in _ROLES:
        if role not in wanted:
            continue
        free = [topic for topic in seen if role != "imu" or topic.topic != config.dvl.topic]
        candidates = _named(free, getattr(config, role).topic)
        topic = choose(candidates)
        settings += settings_of(log, topic) if topic else listed_settings(role, candidates)
        seen = [other for other in seen if other is not topic]
    return settings, tuple(_unseen_notes(unseen))


def _unseen_notes(unseen: Sequence[str]) -> Iterator[Note]:
    if unseen:
        text = f"the log has so many fields that topics were not looked at for a proposal: {listed(unseen)}"
        yield Note("topics_not_looked_at", text, len(unseen), hint="name the topic of each role in the configuration")


def _named(seen: Sequence[ProbedTopic], topic: str | None) -> Sequence[ProbedTopic]:
    """Look at the topic alone that the configuration names, if the log has it."""
    return [found for found in seen if found.topic == topic] or seen


def _measured(log: Recording, config: Config, settings: Sequence[Setting], *, deep: bool) -> list[Setting]:
    """Evaluate units, axes and clocks by what the messages show, read as proposed so far."""
    findings = find_roles(str(log.path), log.channels, config)
    seen = DryRun(log, config, deep)
    seen.examine(findings)
    named = {setting.key for setting in settings}
    measured = _stamps(log, findings, seen.clocks, config)
    if seen.columns.imu is not None:
        (source,) = findings[0].sources
        found = list(_measured_imu(seen, seen.columns.imu, source))
        measured += found if "imu.angular_rate" in named else _worth_proposing(found, source.topic)
    for source in findings[_REFERENCE].sources if deep else ():  # it takes all messages to tell
        measured += measured_reference(log, source, config)
    if "dvl.velocity" in named and len(seen.columns.dvl.time_ns):
        measured += measured_dvl(seen.columns.dvl, seen.columns.reference, config)
    return measured


def _measured_imu(seen: DryRun, imu: ImuColumns, source: Source) -> Iterator[Setting]:
    scale = gyro_scale(imu, seen.columns.dvl, seen.columns.reference, seen.config)
    settings = source.completed(seen.config.imu)
    measured = measured_imu(imu, settings, seen.columns.reference, scale)
    yield from measured
    if seen.deep:
        turned = corrected_rates(imu, settings, measured)
        yield from measured_scale(settings, gyro_scale(turned, seen.columns.dvl, seen.columns.reference, seen.config))


def _worth_proposing(measured: Sequence[Setting], topic: str) -> list[Setting]:
    """Of an IMU of a known type, propose only what is unlike its type, and of which topic it holds."""
    return [replace(found, seen=f"{topic}: {found.seen}") for found in measured if found.value not in _DEFAULTS]


def _stamps(log: Recording, findings: Sequence[Finding], clocks: Sequence[Clock], config: Config) -> list[Setting]:
    """Stamp all roles by the recorder where their own clocks do not belong together."""
    stamps = {(source.role, source.topic): source.stamp for finding in findings for source in finding.sources}
    if any(clock.stamp != stamps.get((clock.role, clock.topic), clock.stamp) for clock in clocks):
        return not_yet_set(recorder_stamps(clocks, "not all stamps of the roles are times"), config)
    if not clocks or clocks[0].role != "imu":
        return []
    try:
        clock_notes(str(log.path), clocks, config.clocks.max_disagreement_s)
    except LogError:
        together = "the clocks of the roles have nothing to do with each other"
        return not_yet_set(recorder_stamps(clocks, together), config)
    return []


def _start(findings: Sequence[Finding], initial: Initial) -> Iterator[Setting]:
    """Name the keys without which a replay has no start, by what the type of the reference can give."""
    reference = next(finding for finding in findings if finding.role == "reference")
    if reference.candidates:
        return
    given = {quantity for source in reference.sources for quantity in source.fields}
    if not given and initial.source == "reference":
        yield Setting("initial.source", "level", "no reference to start from: roll and pitch come from gravity")
    posed = initial.source == BY_SENSOR or (initial.source == "reference" and given & {"quaternion", "roll"})
    if initial.heading_deg is None and not posed:
        text = f'at the start, from north over east; "{BY_SENSOR}" where an AHRS or a compass tells it'
        yield Setting("initial.heading_deg", None, open=text)
    if initial.latitude_deg is None and "latitude" not in given:
        yield Setting("initial.latitude_deg", None, open="for gravity and Earth rate; half a degree will do")
