"""What is in a log: its topics by their log times, which topic plays which role and why, and what the messages show.

It uses the functions that read a dive, so it reports what a replay would find.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

import numpy as np

from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import check_start
from insdvl_replay.core.dive_columns import TimeNs, seconds
from insdvl_replay.core.errors import Note, UserError
from insdvl_replay.core.words import Reading
from insdvl_replay.inspection.dry_run import DryRun
from insdvl_replay.inspection.inventory import Blocker, Inventory, LogFacts, RoleFacts, TopicFacts
from insdvl_replay.inspection.proposal import propose
from insdvl_replay.inspection.settings import settings_toml, undecided_keys
from insdvl_replay.logs.formats.log_file import LogChannel, by_topic
from insdvl_replay.logs.formats.recording import Recording, open_recording
from insdvl_replay.logs.formats.remote import read_summary, remote_name
from insdvl_replay.logs.read import Finding, find_roles, idle_sensors

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


def inspect_log(
    path: Path | Sequence[Path], config: Config, *, deep: bool = False, allow_damaged: bool = False
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
        seen = DryRun(log, config, deep)
        seen.examine(findings)
        sources = [
            source for finding in findings for source in (*finding.sources, *finding.candidates)
        ]
        others = [
            channel
            for channel in log.channels
            if channel.topic not in {source.topic for source in sources}
        ]
        seen.examine_others(others)
        log_times = log.log_times()
        facts = _log_facts(log, log_times)
        proposal = propose(log, findings, seen, config)
        # Last of all, since damage inside the chunks is found as they are opened.
        damage = None if allow_damaged else log.damage_error()
    notes = [*log.notes, *seen.notes, *proposal.notes]
    if idle := idle_sensors(str(log.path), log.channels, findings, config):
        kind, them = ("sensor", "it") if len(idle) == 1 else ("sensors", "them")
        sensors = "; ".join(f"{name} on {' or '.join(topics)}" for name, topics in idle.items())
        aiding = ", ".join(f'"{word}"' for word in ("velocity", *idle))
        held_out = ", ".join(f'"{word}"' for word in idle)
        hint = f"to use {them}: aiding = [{aiding}]; to judge by {them}: evaluation.held_out = [{held_out}]"
        notes.append(Note("sensors_unused", f"unused {kind}: {sensors}", len(idle), hint=hint))
    inventory = Inventory(
        log=facts,
        reading=Reading.WHOLE if deep else Reading.SAMPLE,
        topics=tuple(_topic_facts(log, log_times, findings)),
        roles=_role_facts(findings),
        conventions=_conventions(findings),
        clocks=tuple(seen.clocks),
        pings=seen.pings,
        reference=seen.reference,
        blockers=(*([Blocker(damage.message, damage.hint)] if damage else []), *seen.blockers),
        notes=tuple(notes),
        configuration=settings_toml(proposal.settings),
        decisions=undecided_keys(proposal.settings),
        remaining=proposal.blockers,
    )
    try:
        if inventory.blockers or not deep:
            # By what the types of the reference can give; of several, which is chosen decides what it gives.
            fields = {role.role: role.fields for role in inventory.roles}
            if not next(role.candidates for role in inventory.roles if role.role == "reference"):
                reference = fields["reference"]
                check_start(
                    config.initial,
                    has_reference=bool(reference),
                    has_position="latitude" in reference
                    or "latitude" in fields.get("position", ()),
                    has_attitude="quaternion" in reference or "roll" in reference,
                    has_heading=bool(fields.get("heading")),
                )
            return inventory
        # Not imported before it is needed: a look at the file alone takes less than the filters' import.
        from insdvl_replay.preparation.prepared import read_checked_dive, with_reference_at_imu
        from insdvl_replay.preparation.run import prepare_with_heading

        dive = read_checked_dive(path, config, allow_damaged=allow_damaged)
        unused = (note for note in inventory.notes if note.code == "sensors_unused")
        prepared = prepare_with_heading(with_reference_at_imu(dive, config), config)
        return replace(inventory, notes=(*dive.notes, *prepared.notes, *unused))
    except UserError as error:
        return replace(
            inventory, blockers=(*inventory.blockers, Blocker(error.message, error.hint))
        )


def inspect_summary(url: str, config: Config) -> Inventory:
    """State what the summary of a remote MCAP file tells: its topics and roles. No message is read.

    The times of a topic are those of the chunks that have messages of it.

    Raises
    ------
    LogError
        The summary cannot be read.
    """
    summary = read_summary(url)
    stated = summary.statistics
    name = remote_name(url).name
    findings = find_roles(name, summary.channels, config)
    role_of = _role_of(findings)
    topics = []
    for topic, same in sorted(by_topic(summary.channels).items()):
        count = sum(channel.messages for channel in same)
        ids = {channel.id for channel in same}
        chunks = [
            chunk for chunk in summary.chunks if not ids.isdisjoint(chunk.message_index_offsets)
        ]
        start_ns = min(
            (chunk.message_start_time for chunk in chunks), default=stated.message_start_time
        )
        end_ns = max((chunk.message_end_time for chunk in chunks), default=stated.message_end_time)
        span_s = (
            tuple((time_ns - stated.message_start_time) * 1e-9 for time_ns in (start_ns, end_ns))
            if count
            else ()
        )
        topics.append(_topic(same, role_of.get(topic, ""), count, span_s))
    facts = LogFacts(
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
        metadata=summary.metadata,
        attachments=summary.attachments,
    )
    errors = [finding.error for finding in findings if finding.error is not None]
    return Inventory(
        facts,
        Reading.SUMMARY,
        tuple(topics),
        _role_facts(findings),
        _conventions(findings),
        blockers=tuple(Blocker(error.message, error.hint) for error in errors),
    )


def _role_facts(findings: Sequence[Finding]) -> tuple[RoleFacts, ...]:
    return tuple(
        RoleFacts(
            finding.role,
            ", ".join(source.topic for source in finding.sources) or None,
            finding.reason,
            tuple(source.topic for source in finding.candidates),
            {
                quantity: path
                for source in finding.sources
                for quantity, path in source.fields.items()
            },
        )
        for finding in findings
    )


def _role_of(findings: Sequence[Finding]) -> dict[str, str]:
    """Return the role by topic, the first of several."""
    return {
        source.topic: source.role for finding in reversed(findings) for source in finding.sources
    }


def _conventions(findings: Sequence[Finding]) -> dict[str, dict[str, Any]]:
    sources = [source for finding in findings for source in (*finding.sources, *finding.candidates)]
    return {source.topic: dict(source.conventions) for source in sources if source.conventions}


def _utc(time_ns: int) -> str:
    return (_EPOCH + timedelta(microseconds=time_ns // 1000)).isoformat(timespec="seconds")


def _log_facts(log: Recording, log_times: Mapping[int, TimeNs]) -> LogFacts:
    parts = log.parts
    times = [times for times in log_times.values() if times.size]
    first_ns = min((int(part.min()) for part in times), default=0)
    last_ns = max((int(part.max()) for part in times), default=0)
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


def _topic_facts(
    log: Recording, log_times: Mapping[int, TimeNs], findings: Sequence[Finding]
) -> Iterator[TopicFacts]:
    role_of = _role_of(findings)
    start_ns = min((int(times.min()) for times in log_times.values() if times.size), default=0)
    for topic, same in sorted(by_topic(log.channels).items()):
        time_ns = np.concatenate([log_times[channel.id] for channel in same])
        # A stable sort takes next to no time for what is in order already.
        time_s = np.sort(seconds(time_ns, start_ns), kind="stable")
        span_s = (float(time_s[0]), float(time_s[-1])) if time_s.size else ()
        gap_s = float(np.diff(time_s).max()) if time_s.size > 1 else None
        yield _topic(same, role_of.get(topic, ""), time_s.size, span_s, gap_s)


def _topic(
    same: Sequence[LogChannel],
    role: str,
    count: int,
    span_s: tuple[float, ...],
    longest_gap_s: float | None = None,
) -> TopicFacts:
    """Describe a topic by its channels and the times of its first and last message, if it has any."""
    # The channel that has messages is the one to describe: some recorders register every topic twice.
    channel = max(same, key=lambda channel: channel.messages)
    length_s = span_s[1] - span_s[0] if span_s else 0.0
    return TopicFacts(
        topic=channel.topic,
        type_name=channel.type_name,
        encoding=channel.encoding,
        schema_encoding=channel.schema_encoding,
        role=role,
        channels=len(same),
        messages=count,
        start_s=span_s[0] if span_s else None,
        end_s=span_s[1] if span_s else None,
        rate_hz=(count - 1) / length_s if count > 1 and length_s > 0.0 else None,
        longest_gap_s=longest_gap_s,
    )
