"""Clocks, pings and plausibility of each role of a log.

Reading a dive stops at the first error. Here each error is kept, and the rest is checked too.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

import numpy as np

from insdvl_replay.checks.reference import plausibility_remarks, says_anything
from insdvl_replay.checks.sentences import Measured, Remark, without_mark
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import (
    DvlColumns,
    Floats,
    ImuColumns,
    ReferenceColumns,
    seconds,
)
from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import ConfigError, LogError, Note, UserError
from insdvl_replay.core.notes import note
from insdvl_replay.core.words import Severity
from insdvl_replay.inspection.inventory import Blocker, PingFacts, ReferenceFacts
from insdvl_replay.logs.columns.imu import decode_imu
from insdvl_replay.logs.columns.reference import decode_reference
from insdvl_replay.logs.columns.tables import Table, read_sample, read_tables
from insdvl_replay.logs.columns.topics import Source
from insdvl_replay.logs.formats.fields import check_encoding
from insdvl_replay.logs.formats.log_file import LogChannel
from insdvl_replay.logs.formats.readers import channel_paths
from insdvl_replay.logs.formats.recording import Recording
from insdvl_replay.logs.read import Finding, RoleColumns, loss_notes, source_notes, stamp_notes

_ENOUGH: Final = 1000  # messages of a topic that show its clock and its units
_ENOUGH_OF_OTHERS: Final = 10
_LOOK_DEEPER: Final = "to measure the value on all messages: `inspect --deep`"

OnError = Callable[[UserError], None]  # what is done about an error that would end a replay


@contextmanager
def errors_to(on_error: OnError) -> Iterator[None]:
    """Hand an error that is raised inside to a function, and continue after the block."""
    try:
        yield
    except UserError as error:
        on_error(error)


@dataclass
class DryRun:
    """Looks at the messages, role by role, and keeps what it finds."""

    log: Recording
    config: Config
    deep: bool  # reads the messages whole, not only the first of each topic
    # of the topics with a role, then of the others
    clocks: list[Clock] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)
    blockers: list[Blocker] = field(default_factory=list)
    pings: PingFacts | None = None
    reference: ReferenceFacts | None = None
    # of several topics for one role, those of which there is a warning
    warned: set[str] = field(default_factory=set)
    # and those with which a replay would stop, with the reason
    refused: dict[str, str] = field(default_factory=dict)
    columns: RoleColumns = field(init=False)
    other_imus: dict[str, ImuColumns] = field(default_factory=dict)  # that could be it, by topic

    def __post_init__(self) -> None:
        self.columns = RoleColumns(str(self.log.path), self.config)

    def examine(self, findings: Sequence[Finding]) -> None:
        """Look at all topics that play a role or could."""
        own_clocks: list[Clock] = []
        for finding in findings:
            if finding.error is not None:
                self._add_blocker(finding.error)
            own_clocks += self._examine_role(finding)
            # A fault of one of several topics is not a blocker yet.
            for source in finding.candidates:
                with errors_to(partial(self._warn_of, source.topic)):
                    self._examine_candidate(source, own_clocks)
        if self.columns.imu is not None:
            self._compare_roles(self.columns.imu, own_clocks)
        for topic, imu in self.other_imus.items():
            self._compare_other_imu(topic, imu)

    def examine_others(self, channels: Iterable[LogChannel]) -> None:
        """Look at the clocks of topics without a role, as far as their messages have a header."""
        for channel in channels:
            try:
                check_encoding(channel)
                has_header = channel.messages > 0 and "header.stamp" in channel_paths(channel)
            except UserError:  # what cannot be read is no matter where nobody needs it
                continue
            if not has_header:
                continue
            source = Source("", channel.topic, channel.type_name, (channel,), {}, "header", 0.0)
            try:
                self.clocks.append(read_sample(self.log, source, _ENOUGH_OF_OTHERS).clock())
            except UserError as error:
                self.notes.append(note("other_clock", why=error.message))

    def _examine_role(self, finding: Finding) -> list[Clock]:
        """Look at the topics that play a role; return their clocks, or none where one cannot be read."""
        try:
            tables, clocks = self._read_role(finding.sources)
        except UserError as error:
            self._add_blocker(error)
            return []
        if tables and finding.role != "truth":
            with errors_to(partial(self._not_decoded, finding.role)):
                self._decode(finding.role, tables)
        return clocks

    def _read_role(self, sources: Sequence[Source]) -> tuple[list[Table], list[Clock]]:
        """Read the topics that play a role, and note what is wrong with their messages."""
        tables: list[Table] = []
        clocks: list[Clock] = []
        for source in sources:
            table, clock = self._read(source, self._add_blocker)
            tables.append(table)
            clocks.append(clock)
        self._remark([*source_notes(sources), *stamp_notes(tables)])
        if self.deep:
            self._remark(loss_notes(tables))
        return tables, clocks

    def _examine_candidate(self, source: Source, own_clocks: Sequence[Clock]) -> None:
        """Look at one of several topics that could play a role; a UserError where a replay would stop with it."""
        table, clock = self._read(source, partial(self._warn_of, source.topic))
        if source.role == "imu":
            self.other_imus[source.topic], _ = decode_imu(table, self.config.imu)
        elif source.role == "reference":
            columns, _ = decode_reference([table], self.config.reference, self.config.initial)
            if columns is not None and not says_anything(columns):
                text = "has no attitude, and its velocity is zero in all messages"
                raise LogError(text, "", *table.where)
        if own_clocks and own_clocks[0].role == "imu":
            self.columns.clock_notes([own_clocks[0], clock])

    def _read(self, source: Source, on_error: OnError) -> tuple[Table, Clock]:
        """Read a topic; where its stamps are no times, report it and go on with the recorder's."""
        if self.deep:
            (table,) = read_tables(self.log, [source])
        else:
            table = read_sample(self.log, source, _ENOUGH)
        if table.unreadable_ns:
            on_error(table.damage_error())
        try:
            clock = table.clock()
        except UserError as error:
            on_error(error)
            table = replace(table, source=replace(source, stamp="log_time"))
            clock = table.clock()
        self.clocks.append(clock)
        return table, clock

    def _decode(self, role: str, tables: list[Table]) -> None:
        messages = len(tables[0])
        notes = self.columns.decode(role, tables)
        if role == "dvl":
            self.pings = _ping_facts(self.columns.dvl, messages, notes)
        elif role == "reference" and self.deep:
            imu = self.columns.imu
            reference = self.columns.reference
            if imu is not None and reference is not None:
                self.reference = _reference_facts(reference, imu)
        self._remark(notes)

    def _compare_roles(self, imu: ImuColumns, clocks: Sequence[Clock]) -> None:
        """Compare the topics that play the roles with each other."""
        with errors_to(self._add_blocker):
            self._remark(self.columns.clock_notes(clocks))
        for remark in self._remarks(imu):
            said = without_mark(remark)
            hint = self._hint(remark)
            if isinstance(said, LogError):
                self.blockers.append(Blocker(said.message, hint))
            else:
                self._remark([replace(said, hint=hint)])

    def _compare_other_imu(self, topic: str, imu: ImuColumns) -> None:
        """Compare a topic that could be the IMU with those that play the other roles."""
        for remark in self._remarks(imu):
            said = without_mark(remark)
            hint = self._hint(remark)
            if isinstance(said, LogError):
                self._warn_of(topic, said, hint)
            elif said.code.startswith("imu"):
                if said.severity == Severity.WARNING:
                    self.warned.add(topic)
                self._remark([replace(said.about(topic), hint=hint)])

    def _not_decoded(self, role: str, error: UserError) -> None:
        if self.deep or role == "imu" or isinstance(error, ConfigError):
            self._add_blocker(error)
            return
        # The first pings may be made in air and the first fixes without sky: this says nothing of the rest.
        self.notes.append(note("first_messages", why=error.inside(self.log.path)))

    def _remarks(self, imu: ImuColumns) -> Iterator[Remark]:
        return plausibility_remarks(
            str(self.log.path), imu, self.columns.dvl, self.columns.reference, self.config
        )

    def _remark(self, notes: Iterable[Note]) -> None:
        """Keep notes; of those from a sample the warnings alone, since its counts are not the log's."""
        self.notes += [note for note in notes if self.deep or note.severity == Severity.WARNING]

    def _hint(self, remark: Remark) -> str:
        """Return the hint of a remark, without a value to copy that only the whole log shows well enough."""
        if isinstance(remark, Measured) and not self.deep:
            return _LOOK_DEEPER
        return without_mark(remark).hint

    def _warn_of(
        self,
        topic: str,
        error: UserError,
        hint: str | None = None,
    ) -> None:
        """Note what is wrong with one of several topics; the hint is that of the error if no other is given."""
        self.warned.add(topic)
        why = error.inside(self.log.path, topic)
        self.refused.setdefault(topic, why)
        given = error.hint if hint is None else hint
        self.notes.append(
            note(
                "candidate",
                why=why,
                hint=given,
            ).about(topic)
        )

    def _add_blocker(self, error: UserError) -> None:
        self.blockers.append(Blocker(error.message, error.hint))


def _ping_facts(dvl: DvlColumns, messages: int, notes: Iterable[Note]) -> PingFacts:
    """Count the pings of a DVL, by the messages that were read and the notes on them."""
    repeats = 0
    for found in notes:
        if found.code in ("dvl_repeats", "dvl_same_values"):
            repeats += found.count
    rate_hz = None
    steps_s = np.diff(seconds(dvl.time_ns, int(dvl.time_ns[0])))
    if steps_s.size:
        rate_hz = 1.0 / float(np.median(steps_s))
    beams = np.empty(0)
    if dvl.beam_velocity_mps is not None:
        beams = np.isfinite(dvl.beam_velocity_mps).sum(axis=1)
    return PingFacts(
        messages=messages,
        repeats=repeats,
        pings=len(dvl.time_ns),
        four_or_more=int(np.count_nonzero(beams > 3)),
        three=int(np.count_nonzero(beams == 3)),
        fewer=int(np.count_nonzero(beams < 3)),
        rate_hz=rate_hz,
    )


def _reference_facts(reference: ReferenceColumns, imu: ImuColumns) -> ReferenceFacts:
    """State over which part of the IMU's span a reference gives position, velocity and attitude."""
    first_ns = int(imu.time_ns[0])
    last_ns = int(imu.time_ns[-1])

    def covered_pct(values: Floats) -> float:
        time_ns = reference.time_ns[np.isfinite(values).all(axis=1)].clip(first_ns, last_ns)
        if not len(time_ns):
            return 0.0
        covered_ns = int(time_ns[-1] - time_ns[0])
        return 100.0 * covered_ns / max(last_ns - first_ns, 1)

    return ReferenceFacts(
        rows=len(reference.time_ns),
        position_pct=covered_pct(reference.position[:, :2]),
        velocity_pct=covered_pct(reference.velocity_n),
        attitude_pct=covered_pct(reference.mat_nb.reshape(-1, 9)),
    )
