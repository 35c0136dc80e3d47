"""What is in a log: its topics by their log times, who plays which role and why, and what the messages show.

Built on the functions that read a dive, so that what is said here is what a replay would meet.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

import numpy as np

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import TimeNs, seconds
from insdvl_replay.core.errors import Note, UserError
from insdvl_replay.core.words import Reading
from insdvl_replay.inspection.dry_run import DryRun
from insdvl_replay.inspection.inventory import Inventory, LogFacts, Obstacle, RoleFacts, TopicFacts
from insdvl_replay.inspection.proposal import Proposal, propose
from insdvl_replay.logs.columns.roles import Finding, find_roles, idle_sensors
from insdvl_replay.logs.container.recording import Recording, open_recording
from insdvl_replay.logs.container.records import LogChannel, by_topic
from insdvl_replay.preparation.alignment import check_start


def inspect_log(
    path: Path | Sequence[Path], config: Config, *, deep: bool = False, allow_damaged: bool = False
) -> Inventory:
    """State what a log holds and whether it can be replayed.

    Parameters
    ----------
    path : Path or sequence of Path
        A log, a bag, or several of them that are one dive.
    deep : bool
        Read the messages of all roles whole, and go as far as a replay would before its filters run; else the first
        messages of each role show of its clock and units.
    allow_damaged : bool
        Damage is reported, and is no obstacle.

    Raises
    ------
    LogError
        The file cannot be read at all.
    """
    inventory = survey_log(path, config, deep=deep, allow_damaged=allow_damaged)
    try:
        if inventory.obstacles or not deep:
            _check_start(inventory, config)
            return inventory
        # Not imported before it is needed: a look at the file alone takes less than the filters' import.
        from insdvl_replay.preparation.prepared import read_checked_dive, with_reference_at_imu
        from insdvl_replay.preparation.run import prepare_with_heading

        dive = read_checked_dive(path, config, allow_damaged=allow_damaged)
        idle = (note for note in inventory.notes if note.code == _IDLE)
        notes = (*prepare_with_heading(with_reference_at_imu(dive, config), config).notes, *idle)
    except UserError as error:
        obstacle = Obstacle(error.message, error.hint)
        return replace(inventory, obstacles=(*inventory.obstacles, obstacle))
    return replace(inventory, notes=dive.notes + notes)


_IDLE: Final = "sensors_idle"


def _idle_notes(idle: Mapping[str, Sequence[str]]) -> Iterator[Note]:
    """Say which sensors of the log no filter is aided by."""
    if idle:
        said = "; ".join(f"{name} by {' or '.join(topics)}" for name, topics in idle.items())
        aiding = ", ".join(f'"{word}"' for word in ("velocity", *idle))
        hint = f"--set 'filters.told.aiding=[{aiding}]'; evaluation.withheld judges by them"
        yield Note(_IDLE, f"could aid a filter: {said}", len(idle), hint=hint)


def _check_start(inventory: Inventory, config: Config) -> None:
    """Refuse what a replay would refuse for want of a start, by what the types of the reference can give."""
    reference = next(role for role in inventory.roles if role.role == "reference")
    if reference.candidates:
        # Which of them is chosen decides what it gives.
        return
    located = (role for role in inventory.roles if role.role in ("reference", "position"))
    check_start(
        config.initial,
        has_reference=bool(reference.fields),
        has_position=any("latitude" in role.fields for role in located),
        has_attitude="quaternion" in reference.fields or "roll" in reference.fields,
        has_heading=any(role.role == "heading" and role.fields for role in inventory.roles),
    )


_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


def survey_log(
    path: Path | Sequence[Path], config: Config, *, deep: bool = False, allow_damaged: bool = False
) -> Inventory:
    """Take stock of a log."""
    log = open_recording(path, allow_damaged=True)
    with log.watched():
        return _surveyed(log, config, deep=deep, allow_damaged=allow_damaged)


def propose_settings(path: Path | Sequence[Path], config: Config, *, allow_damaged: bool = False) -> Proposal:
    """Propose what a replay lacks, by all messages of the roles.

    Raises
    ------
    LogError
        The file cannot be read, or is damaged and must not be.
    """
    log = open_recording(path, allow_damaged=allow_damaged)
    with log.watched():
        findings = find_roles(str(log.path), log.channels, config)
        seen = DryRun(log, config, deep=True)
        seen.examine(findings)
        return propose(log, findings, seen, config)


def _surveyed(log: Recording, config: Config, *, deep: bool, allow_damaged: bool) -> Inventory:
    findings = find_roles(str(log.path), log.channels, config)
    seen = DryRun(log, config, deep)
    seen.examine(findings)
    sources = [source for finding in findings for source in (*finding.sources, *finding.candidates)]
    looked_at = {source.topic for source in sources}
    seen.examine_others(channel for channel in log.channels if channel.topic not in looked_at)
    log_times = log.log_times()
    proposal = propose(log, findings, seen, config)
    # Last of all, since damage inside the chunks is found as they are opened.
    refusals = [error] if not allow_damaged and (error := log.damage_error()) is not None else []
    return Inventory(
        log=_log_facts(log, log_times),
        reading=Reading.WHOLE if deep else Reading.SAMPLE,
        topics=_topics(log.channels, log_times, findings),
        roles=tuple(_role_facts(finding) for finding in findings),
        conventions={source.topic: dict(source.conventions) for source in sources if source.conventions},
        clocks=tuple(seen.clocks),
        pings=seen.pings,
        reference=seen.reference,
        obstacles=(*(Obstacle(error.message, error.hint) for error in refusals), *seen.obstacles),
        notes=(
            *log.notes,
            *seen.notes,
            *proposal.notes,
            *_idle_notes(idle_sensors(str(log.path), log.channels, findings, config)),
        ),
        configuration=proposal.configuration,
        decisions=proposal.decisions,
        remaining=proposal.obstacles,
    )


def _log_facts(log: Recording, log_times: Mapping[int, TimeNs]) -> LogFacts:
    times = [times for times in log_times.values() if times.size]
    first_ns = min((int(part.min()) for part in times), default=0)
    last_ns = max((int(part.max()) for part in times), default=0)
    parts = log.parts
    return LogFacts(
        name=log.path.name,
        parts=len(parts),
        size_bytes=sum(part.size_bytes for part in parts),
        profile=", ".join(sorted({part.profile for part in parts})),
        library=", ".join(sorted({part.library for part in parts})),
        compression=tuple(sorted({name for part in parts for name in part.compression})),
        chunks=sum(part.chunk_count for part in parts),
        messages=sum(part.size for part in times),
        has_summary=all(part.has_summary for part in parts),
        start_utc=_utc(first_ns) if times and first_ns >= 0 else None,
        duration_s=(last_ns - first_ns) * 1e-9,
        metadata=tuple(record.name for part in parts for record in part.metadata),
        attachments=tuple(attachment.name for part in parts for attachment in part.attachments),
    )


def _utc(time_ns: int) -> str:
    return (_EPOCH + timedelta(microseconds=time_ns // 1000)).isoformat(timespec="seconds")


def _topics(
    channels: Sequence[LogChannel], log_times: Mapping[int, TimeNs], findings: Sequence[Finding]
) -> tuple[TopicFacts, ...]:
    role_of = {source.topic: source.role for finding in reversed(findings) for source in finding.sources}
    start_ns = min((int(times.min()) for times in log_times.values() if times.size), default=0)
    facts = []
    for topic, same in sorted(by_topic(channels).items()):
        log_time = np.concatenate([log_times[channel.id] for channel in same])
        facts.append(_topic_facts(same, log_time, start_ns, role_of.get(topic, "")))
    return tuple(facts)


def _topic_facts(same: Sequence[LogChannel], log_time: TimeNs, start_ns: int, role: str) -> TopicFacts:
    # The channel that has messages is the one to describe: some recorders register every topic twice.
    channel = max(same, key=lambda channel: channel.messages)
    # A stable sort takes next to no time for what is in order already.
    time_s = np.sort(seconds(log_time, start_ns), kind="stable")
    span_s = float(time_s[-1] - time_s[0]) if time_s.size > 1 else 0.0
    return TopicFacts(
        topic=channel.topic,
        type_name=channel.type_name,
        encoding=channel.encoding,
        schema_encoding=channel.schema_encoding,
        role=role,
        channels=len(same),
        messages=time_s.size,
        start_s=float(time_s[0]) if time_s.size else None,
        end_s=float(time_s[-1]) if time_s.size else None,
        rate_hz=(time_s.size - 1) / span_s if span_s > 0.0 else None,
        longest_gap_s=float(np.diff(time_s).max()) if time_s.size > 1 else None,
    )


def _role_facts(finding: Finding) -> RoleFacts:
    topics = ", ".join(source.topic for source in finding.sources)
    fields = {quantity: path for source in finding.sources for quantity, path in source.fields.items()}
    candidates = tuple(source.topic for source in finding.candidates)
    return RoleFacts(finding.role, topics or None, finding.reason, candidates, fields)
