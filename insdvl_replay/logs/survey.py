"""What is in a log: its topics by their log times, who plays which role and why, and what the messages tell.

Built on the functions that read a dive, so that what is said here is what a replay would meet.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

import numpy as np

from insdvl_replay.columns import DvlColumns, ImuColumns, ReferenceColumns, TimeNs, seconds
from insdvl_replay.config import Config, Initial
from insdvl_replay.errors import ConfigError, Note, UserError
from insdvl_replay.inventory import (
    Clock,
    Inventory,
    LogFacts,
    Obstacle,
    PingFacts,
    ReferenceFacts,
    RoleFacts,
    TopicFacts,
)
from insdvl_replay.logs.clocks import clock_notes
from insdvl_replay.logs.container import Log, LogChannel
from insdvl_replay.logs.decode import decode_imu
from insdvl_replay.logs.pings import decode_dvl
from insdvl_replay.logs.proposal import propose_choice, propose_fields, propose_start, see_topics
from insdvl_replay.logs.reference import decode_reference
from insdvl_replay.logs.roles import Finding, explain_roles
from insdvl_replay.logs.tables import Table, read_sample, read_tables
from insdvl_replay.logs.wishes import Source

_ENOUGH: Final = 1000
"""Messages of a role that show its clock and its units."""
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


def survey_log(path: Path, config: Config, *, deep: bool = False) -> Inventory:
    """Take stock of a log.

    Parameters
    ----------
    path : Path
    config : Config
    deep : bool
        Read the messages of all roles whole, not only the first of each.

    Returns
    -------
    Inventory

    Raises
    ------
    LogError
        The file cannot be read at all.
    """
    log = Log(path)
    findings = explain_roles(str(path), log.channels, config)
    stock = _Stock(log, config, deep)
    for finding in findings:
        stock.look_at(finding)
    stock.compare_clocks()
    log_times = log.log_times()
    return Inventory(
        log=_log_facts(log, log_times),
        reading="whole" if deep else "sample",
        topics=_topics(log.channels, log_times, findings),
        roles=tuple(_role_facts(finding) for finding in findings),
        clocks=tuple(stock.clocks),
        pings=stock.pings,
        reference=stock.reference,
        obstacles=tuple(stock.obstacles),
        notes=tuple(stock.notes),
        configuration=_proposal(log, findings, config.initial),
    )


@dataclass
class _Stock:
    """Collects what the messages tell, role by role."""

    log: Log
    config: Config
    deep: bool
    clocks: list[Clock] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)
    obstacles: list[Obstacle] = field(default_factory=list)
    pings: PingFacts | None = None
    reference: ReferenceFacts | None = None
    imu: ImuColumns | None = None

    def look_at(self, finding: Finding) -> None:
        """Look at the topic of a role, or at each that could play it."""
        if finding.error is not None:
            self._stopped_by(finding.error)
        for source in finding.candidates:
            self._look_at_candidate(source)
        try:
            tables = [self._read(source) for source in finding.sources]
        except UserError as error:
            self._stopped_by(error)
            return
        if tables:
            self._judge(finding.role, tables)

    def compare_clocks(self) -> None:
        """See whether the clocks of the roles may be mixed."""
        if self.clocks and self.clocks[0].role == "imu":
            try:
                self._remark(clock_notes(str(self.log.path), self.clocks, self.config.clocks.max_disagreement_s))
            except UserError as error:
                self._stopped_by(error)

    def _read(self, source: Source) -> Table:
        table = read_tables(self.log, [source])[0] if self.deep else read_sample(self.log, source, _ENOUGH)
        self.clocks.append(table.clock())
        return table

    def _judge(self, role: str, tables: list[Table]) -> None:
        try:
            self._decode(role, tables)
        except UserError as error:
            # The first pings may be made in air and the first fixes without sky: this says nothing of the rest.
            if self.deep or role == "imu" or isinstance(error, ConfigError):
                self._stopped_by(error)

    def _decode(self, role: str, tables: list[Table]) -> None:
        if role == "imu":
            self.imu, notes = decode_imu(tables[0], self.config.imu)
        elif role == "dvl":
            dvl, notes = decode_dvl(tables[0], self.config.dvl)
            self.pings = _ping_facts(len(tables[0]), dvl, notes)
        elif role == "reference":
            reference, notes = decode_reference(tables, self.config.reference)
            self.reference = _reference_facts(reference, self.imu) if reference and self.imu and self.deep else None
        else:
            notes = []
        self._remark(notes)

    def _look_at_candidate(self, source: Source) -> None:
        """Say of one of several topics what would be noted if it were the one."""
        try:
            table = self._read(source)
            notes = decode_imu(table, self.config.imu)[1] if source.role == "imu" else []
            self._remark(replace(note, text=f"{source.topic}: {note.text}") for note in notes)
        except UserError as error:
            self.notes.append(Note(f"{source.role}_candidate", error.message, 1, "warning", error.hint))

    def _remark(self, notes: Iterable[Note]) -> None:
        """Keep notes; of those from a sample the warnings alone, since its counts are not the log's."""
        self.notes += [note for note in notes if self.deep or note.severity == "warning"]

    def _stopped_by(self, error: UserError) -> None:
        self.obstacles.append(Obstacle(error.message, error.hint))


def _log_facts(log: Log, log_times: Mapping[int, TimeNs]) -> LogFacts:
    times = [times for times in log_times.values() if times.size]
    first_ns = min((int(part.min()) for part in times), default=0)
    last_ns = max((int(part.max()) for part in times), default=0)
    return LogFacts(
        name=log.path.name,
        size_bytes=log.path.stat().st_size,
        profile="",
        library="",
        compression=(),
        chunks=0,
        messages=sum(part.size for part in times),
        has_summary=True,
        start_utc=_utc(first_ns) if times else None,
        duration_s=(last_ns - first_ns) * 1e-9,
        metadata=(),
        attachments=(),
    )


def _utc(time_ns: int) -> str:
    return (_EPOCH + timedelta(microseconds=time_ns // 1000)).isoformat(timespec="seconds")


def _topics(
    channels: Sequence[LogChannel], log_times: Mapping[int, TimeNs], findings: Sequence[Finding]
) -> tuple[TopicFacts, ...]:
    role_of = {source.topic: source.role for finding in reversed(findings) for source in finding.sources}
    start_ns = min((int(times.min()) for times in log_times.values() if times.size), default=0)
    by_topic: dict[str, list[LogChannel]] = {}
    for channel in channels:
        by_topic.setdefault(channel.topic, []).append(channel)
    facts = []
    for topic, same in sorted(by_topic.items()):
        log_time = np.concatenate([log_times[channel.id] for channel in same])
        facts.append(_topic_facts(same, log_time, start_ns, role_of.get(topic, "")))
    return tuple(facts)


def _topic_facts(same: Sequence[LogChannel], log_time: TimeNs, start_ns: int, role: str) -> TopicFacts:
    # The channel that has messages is the one to describe: some recorders register every topic twice.
    channel = max(same, key=lambda channel: channel.messages)
    time_s = np.sort(seconds(log_time, start_ns))
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
    return RoleFacts(finding.role, topics or None, finding.reason, fields)


def _ping_facts(messages: int, dvl: DvlColumns, notes: Sequence[Note]) -> PingFacts:
    repeats = sum(note.count for note in notes if note.code in ("dvl_repeats", "dvl_same_values"))
    steps_s = np.diff(seconds(dvl.time_ns, int(dvl.time_ns[0])))
    if dvl.beam_velocity_mps is None:
        by_beams = (0, 0, 0)
    else:
        beams = np.isfinite(dvl.beam_velocity_mps).sum(axis=1)
        by_beams = (int(np.sum(beams > 3)), int(np.sum(beams == 3)), int(np.sum(beams < 3)))
    rate_hz = 1.0 / float(np.median(steps_s)) if steps_s.size else None
    return PingFacts(messages, repeats, len(dvl.time_ns), *by_beams, rate_hz)


def _reference_facts(reference: ReferenceColumns, imu: ImuColumns) -> ReferenceFacts:
    given = (reference.position[:, :2], reference.velocity_n, reference.mat_nb.reshape(-1, 9))
    parts = [_covered_pct(reference.time_ns[np.isfinite(values).all(axis=1)], imu.time_ns) for values in given]
    return ReferenceFacts(len(reference.time_ns), *parts)


def _covered_pct(time_ns: TimeNs, imu_time_ns: TimeNs) -> float:
    """Give the part of the IMU's span that lies between the first and the last of some times."""
    first_ns, last_ns = int(imu_time_ns[0]), int(imu_time_ns[-1])
    if not time_ns.size or last_ns == first_ns:
        return 0.0
    covered_ns = min(last_ns, int(time_ns[-1])) - max(first_ns, int(time_ns[0]))
    return max(0.0, 100.0 * covered_ns / (last_ns - first_ns))


def _proposal(log: Log, findings: Sequence[Finding], initial: Initial) -> str:
    """Propose settings for what a replay lacks."""
    choices = {finding.role: [source.topic for source in finding.candidates] for finding in findings if finding.error}
    unknown = {role for role, topics in choices.items() if not topics and role in ("imu", "dvl")}
    taken = {source.topic for finding in findings for source in finding.sources if source.role != "reference"}
    free = [channel for channel in log.channels if channel.topic not in taken] if unknown else []
    parts = [
        *(propose_choice(role, topics) for role, topics in choices.items() if topics),
        *propose_fields(see_topics(log, free), unknown),
        propose_start(_start_lacks(findings, initial)),
    ]
    return "\n".join(part for part in parts if part)


def _start_lacks(findings: Sequence[Finding], initial: Initial) -> list[str]:
    """Name the keys without which a replay has no start, by what the type of the reference can give."""
    reference = next(finding for finding in findings if finding.role == "reference")
    if reference.candidates:
        return []
    given = {quantity for source in reference.sources for quantity in source.fields}
    lacks = [] if given or initial.source == "level" else ["source"]
    given = set() if initial.source == "level" else given
    if initial.heading_deg is None and not given & {"quaternion", "roll"}:
        lacks.append("heading_deg")
    if initial.latitude_deg is None and "latitude" not in given:
        lacks.append("latitude_deg")
    return lacks
