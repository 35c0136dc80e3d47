"""What is in a log: its topics by their log times, which topic plays which role and why, and what the messages show.

It uses the functions that read a dive, so it reports what a replay would find.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import numpy as np

from insdvl_replay.core.config import Config, Initial
from insdvl_replay.core.config_file import check_start
from insdvl_replay.core.dive_columns import TimeNs, seconds
from insdvl_replay.core.errors import Note, UserError
from insdvl_replay.core.notes import note
from insdvl_replay.core.words import Reading
from insdvl_replay.inspection.dry_run import DryRun
from insdvl_replay.inspection.inventory import Blocker, Inventory, LogFacts, RoleFacts, TopicFacts
from insdvl_replay.inspection.proposal import propose
from insdvl_replay.inspection.settings import settings_toml, undecided_keys
from insdvl_replay.logs.columns.topics import Source
from insdvl_replay.logs.file_clocks import align_files
from insdvl_replay.logs.formats.log_file import LogChannel, by_topic
from insdvl_replay.logs.formats.recording import Recording, open_recording
from insdvl_replay.logs.formats.remote import read_summary, remote_name
from insdvl_replay.logs.formats.remote_parts import LogSummary
from insdvl_replay.logs.read import Finding, find_roles, idle_sensors, sources_of

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


def inspect_log(
    path: Path | Sequence[Path],
    config: Config,
    *,
    deep: bool = False,
    allow_damaged: bool = False,
) -> Inventory:
    """State what a log holds and whether it can be replayed.

    Deep reads the messages of all roles whole, and goes as far as a replay would before its filters run; else the first
    messages of each role show of its clock and units. Damage that is allowed is reported, and is not a blocker.

    Raises
    ------
    LogError
        The file cannot be read at all.
    """
    log = open_recording(path, allow_damaged=True)
    with log.watched():
        findings = find_roles(str(log.path), log.channels, config)
        blockers = []
        try:
            align_files(log, sources_of(findings), config)
        except UserError as error:
            blockers.append(Blocker(error.message, error.hint))
        seen = DryRun(log, config, deep)
        seen.examine(findings)
        with_role = {source.topic for source in _possible_sources(findings)}
        seen.examine_others(channel for channel in log.channels if channel.topic not in with_role)
        log_times = log.log_times()
        facts = _log_facts(log, log_times)
        proposal = propose(log, findings, seen, config)
        # Last of all, since damage inside the chunks is found as they are opened.
        damage = None if allow_damaged else log.damage_error()
    blockers += seen.blockers
    if damage is not None:
        blockers.insert(0, Blocker(damage.message, damage.hint))
    unused = _unused_sensors(log, findings, config)
    inventory = Inventory(
        log=facts,
        reading=Reading.WHOLE if deep else Reading.SAMPLE,
        topics=tuple(_topic_facts(log, log_times, findings)),
        roles=_role_facts(findings),
        conventions=_conventions(findings),
        clocks=tuple(seen.clocks),
        pings=seen.pings,
        reference=seen.reference,
        blockers=tuple(blockers),
        notes=(*log.notes, *seen.notes, *proposal.notes, *unused),
        configuration=settings_toml(proposal.settings),
        decisions=undecided_keys(proposal.settings),
        remaining=proposal.blockers,
    )
    try:
        if deep and not blockers:
            prepared = _notes_of_preparation(path, config, allow_damaged=allow_damaged)
            return replace(inventory, notes=(*prepared, *unused))
        _check_start(inventory.roles, config.initial)
        return inventory
    except UserError as error:
        blockers.append(Blocker(error.message, error.hint))
        return replace(inventory, blockers=tuple(blockers))


def _unused_sensors(log: Recording, findings: Sequence[Finding], config: Config) -> list[Note]:
    """Note the sensors of a log that could aid a filter, and do not."""
    idle = idle_sensors(str(log.path), log.channels, findings, config)
    if not idle:
        return []
    sensors = "; ".join(f"{name} on {' or '.join(topics)}" for name, topics in idle.items())
    names = ", ".join(f'"{name}"' for name in idle)
    code = "sensors_unused"
    if len(idle) == 1:
        code = "sensors_unused one"
    return [
        note(
            code,
            len(idle),
            sensors=sensors,
            names=names,
        )
    ]


def _check_start(roles: Sequence[RoleFacts], initial: Initial) -> None:
    """Raise a UserError where a replay would have no start, by what the type of the reference can give."""
    by_role = {role.role: role for role in roles}
    if by_role["reference"].candidates:
        return  # which of them is chosen decides what it gives
    fields = {role.role: role.fields for role in roles}
    given = fields["reference"]
    check_start(
        initial,
        has_reference=bool(given),
        has_position="latitude" in given or "latitude" in fields.get("position", {}),
        has_attitude="quaternion" in given or "roll" in given,
        has_heading=bool(fields.get("heading")),
    )


def _notes_of_preparation(
    path: Path | Sequence[Path], config: Config, *, allow_damaged: bool
) -> tuple[Note, ...]:
    """Go as far as a replay would before its filters run, and return what it notes."""
    # Not imported before it is needed: a look at the file alone takes less than the filters' import.
    from insdvl_replay.preparation.prepared import read_checked_dive, with_reference_at_imu
    from insdvl_replay.preparation.run import prepare_with_heading

    dive = read_checked_dive(path, config, allow_damaged=allow_damaged)
    prepared = prepare_with_heading(with_reference_at_imu(dive, config), config)
    return (*dive.notes, *prepared.notes)


def inspect_summary(url: str, config: Config) -> Inventory:
    """State what the summary of a remote MCAP file tells: its topics and roles. No message is read.

    The times of a topic are those of the chunks that have messages of it.

    Raises
    ------
    LogError
        The summary cannot be read.
    """
    summary = read_summary(url)
    name = remote_name(url).name
    findings = find_roles(name, summary.channels, config)
    blockers = []
    for finding in findings:
        if finding.error is not None:
            blockers.append(Blocker(finding.error.message, finding.error.hint))
    return Inventory(
        _summary_facts(name, summary),
        Reading.SUMMARY,
        tuple(_summary_topics(summary, _role_of(findings))),
        _role_facts(findings),
        _conventions(findings),
        blockers=tuple(blockers),
    )


def _summary_facts(name: str, summary: LogSummary) -> LogFacts:
    stated = summary.statistics
    return LogFacts(
        name=name,
        parts=1,
        size_bytes=summary.size_bytes,
        profile="",
        library="",
        compression=tuple(sorted({chunk.compression or "none" for chunk in summary.chunks})),
        chunks=stated.chunk_count,
        messages=stated.message_count,
        has_summary=True,
        start_utc=_utc(stated.message_start_time) if stated.message_count else None,
        duration_s=(stated.message_end_time - stated.message_start_time) * 1e-9,
        metadata=tuple(map(attrgetter("name"), summary.metadata)),
        attachments=tuple(map(attrgetter("name"), summary.attachments)),
    )


def _summary_topics(summary: LogSummary, role_of: Mapping[str, str]) -> Iterator[TopicFacts]:
    for topic, same in sorted(by_topic(summary.channels).items()):
        count = sum(channel.messages for channel in same)
        span_s = _span_of_chunks(summary, same) if count else None
        yield _topic(same, role_of.get(topic, ""), count, span_s)


def _span_of_chunks(summary: LogSummary, same: Sequence[LogChannel]) -> tuple[float, float]:
    """Return begin and end of the chunks that have messages of some channels, else of all messages, s."""
    stated = summary.statistics
    ids = {channel.id for channel in same}
    starts_ns = []
    ends_ns = []
    for chunk in summary.chunks:
        if not ids.isdisjoint(chunk.message_index_offsets):
            starts_ns.append(chunk.message_start_time)
            ends_ns.append(chunk.message_end_time)
    start_ns = min(starts_ns, default=stated.message_start_time)
    end_ns = max(ends_ns, default=stated.message_end_time)
    zero_ns = stated.message_start_time
    return (start_ns - zero_ns) * 1e-9, (end_ns - zero_ns) * 1e-9


def _role_facts(findings: Sequence[Finding]) -> tuple[RoleFacts, ...]:
    facts = []
    for finding in findings:
        fields: dict[str, str] = {}
        for source in finding.sources:
            fields.update(source.fields)
        topics = ", ".join(source.topic for source in finding.sources)
        candidates = tuple(source.topic for source in finding.candidates)
        facts.append(RoleFacts(finding.role, topics or None, finding.reason, candidates, fields))
    return tuple(facts)


def _role_of(findings: Sequence[Finding]) -> dict[str, str]:
    """Return the role by topic, the first of several."""
    roles: dict[str, str] = {}
    for finding in findings:
        for source in finding.sources:
            roles.setdefault(source.topic, source.role)
    return roles


def _conventions(findings: Sequence[Finding]) -> dict[str, dict[str, Any]]:
    sources = _possible_sources(findings)
    return {source.topic: dict(source.conventions) for source in sources if source.conventions}


def _possible_sources(findings: Sequence[Finding]) -> list[Source]:
    """Return the topics that play a role or could."""
    sources: list[Source] = []
    for finding in findings:
        sources += (*finding.sources, *finding.candidates)
    return sources


def _utc(time_ns: int) -> str:
    return (_EPOCH + timedelta(microseconds=time_ns // 1000)).isoformat(timespec="seconds")


def _log_facts(log: Recording, log_times: Mapping[int, TimeNs]) -> LogFacts:
    parts = log.parts
    compression: set[str] = set()
    metadata: list[str] = []
    attachments: list[str] = []
    for part in parts:
        compression.update(part.compression)
        metadata += [record.name for record in part.metadata]
        attachments += [attachment.name for attachment in part.attachments]
    start_utc = None
    duration_s = 0.0
    span_ns = _span_ns(log_times)
    if span_ns is not None:
        first_ns, last_ns = span_ns
        duration_s = (last_ns - first_ns) * 1e-9
        if first_ns >= 0:
            start_utc = _utc(first_ns)
    return LogFacts(
        name=log.path.name,
        parts=len(parts),
        size_bytes=sum(part.size_bytes for part in parts),
        profile=", ".join(sorted({part.profile for part in parts})),
        library=", ".join(sorted({part.library for part in parts})),
        compression=tuple(sorted(compression)),
        chunks=sum(part.chunk_count for part in parts),
        messages=sum(times.size for times in log_times.values()),
        has_summary=all(part.has_summary for part in parts),
        start_utc=start_utc,
        duration_s=duration_s,
        metadata=tuple(metadata),
        attachments=tuple(attachments),
    )


def _span_ns(log_times: Mapping[int, TimeNs]) -> tuple[int, int] | None:
    """Return the first and the last log time; None without messages."""
    recorded = [times for times in log_times.values() if times.size]
    if not recorded:
        return None
    return min(int(times.min()) for times in recorded), max(int(times.max()) for times in recorded)


def _topic_facts(
    log: Recording, log_times: Mapping[int, TimeNs], findings: Sequence[Finding]
) -> Iterator[TopicFacts]:
    role_of = _role_of(findings)
    start_ns, _ = _span_ns(log_times) or (0, 0)
    for topic, same in sorted(by_topic(log.channels).items()):
        time_ns = np.concatenate([log_times[channel.id] for channel in same])
        # A stable sort takes next to no time for what is in order already.
        time_s = np.sort(seconds(time_ns, start_ns), kind="stable")
        span_s = (float(time_s[0]), float(time_s[-1])) if time_s.size else None
        gap_s = float(np.diff(time_s).max()) if time_s.size > 1 else None
        yield _topic(same, role_of.get(topic, ""), time_s.size, span_s, gap_s)


def _topic(
    same: Sequence[LogChannel],
    role: str,
    count: int,
    span_s: tuple[float, float] | None,
    longest_gap_s: float | None = None,
) -> TopicFacts:
    """Describe a topic by its channels and the times of its first and last message, if it has any."""
    # The channel that has messages is the one to describe: some recorders register every topic twice.
    channel = max(same, key=lambda channel: channel.messages)
    start_s = end_s = rate_hz = None
    if span_s is not None:
        start_s, end_s = span_s
        if count > 1 and end_s > start_s:
            rate_hz = (count - 1) / (end_s - start_s)
    return TopicFacts(
        topic=channel.topic,
        type_name=channel.type_name,
        encoding=channel.encoding,
        schema_encoding=channel.schema_encoding,
        role=role,
        channels=len(same),
        messages=count,
        start_s=start_s,
        end_s=end_s,
        rate_hz=rate_hz,
        longest_gap_s=longest_gap_s,
    )
