"""What the messages of topics with a role show: their clocks, their pings, and whether they are plausible.

Where a dive is read, the first error ends the work; here each is kept, and the rest is looked at too.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

import numpy as np

from insdvl_replay.checks.imu import Remark
from insdvl_replay.checks.reference import plausibility_remarks, says_anything
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import ImuColumns, seconds
from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import ConfigError, LogError, Note, UserError
from insdvl_replay.core.words import Severity
from insdvl_replay.inspection.inventory import Obstacle, PingFacts, ReferenceFacts
from insdvl_replay.logs.columns.imu import decode_imu
from insdvl_replay.logs.columns.reference import decode_reference
from insdvl_replay.logs.columns.tables import Table, read_sample, read_tables
from insdvl_replay.logs.columns.topics import Source
from insdvl_replay.logs.formats.fields import channel_paths, check_encoding
from insdvl_replay.logs.formats.log_file import LogChannel
from insdvl_replay.logs.formats.recording import Recording
from insdvl_replay.logs.read import Finding, RoleColumns, loss_notes, source_notes, stamp_notes

_ENOUGH: Final = 1000  # messages of a topic that show its clock and its units
_ENOUGH_OF_OTHERS: Final = 10
_MEASURED: Final = re.compile(r"(scale|heading_deg|mounting_rpy_deg) = ")
_LOOK_DEEPER: Final = "`inspect --deep` measures by how much; the first messages only show that something is off"
_LOOK_FURTHER: Final = "`inspect --deep` reads all messages and tells whether it is so"

OnError = Callable[[UserError], None]  # what is done about an error that would end a replay


@contextmanager
def errors_to(on_error: OnError) -> Iterator[None]:
    """Keep an error that arises inside, and go on behind it."""
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
    clocks: list[Clock] = field(default_factory=list)  # of the topics with a role, then of the others
    notes: list[Note] = field(default_factory=list)
    obstacles: list[Obstacle] = field(default_factory=list)
    pings: PingFacts | None = None
    reference: ReferenceFacts | None = None
    doubted: set[str] = field(default_factory=set)  # of several topics for one role, those of which there is a warning
    refused: dict[str, str] = field(default_factory=dict)  # and those with which a replay would stop, with the reason
    columns: RoleColumns = field(init=False)

    def __post_init__(self) -> None:
        self.columns = RoleColumns(str(self.log.path), self.config)

    def examine(self, findings: Sequence[Finding]) -> None:
        """Look at all topics that play a role or could."""
        own_clocks: list[Clock] = []
        other_imus: dict[str, ImuColumns] = {}
        for finding in findings:
            if finding.error is not None:
                self._add_obstacle(finding.error)
            tables: list[Table] = []
            with errors_to(self._add_obstacle):
                read = [self._read(source, self._add_obstacle) for source in finding.sources]
                self._remark([*source_notes(finding.sources), *stamp_notes(read)])
                if self.deep:
                    self._remark(loss_notes(read))
                tables = read
                own_clocks += self.clocks[len(self.clocks) - len(read) :]
            if tables and finding.role != "truth":
                with errors_to(partial(self._not_decoded, finding.role)):
                    self._decode(finding.role, tables)
            # What is wrong with one of several topics is no obstacle yet.
            for source in finding.candidates:
                doubt = partial(self._doubt, source.topic)
                with errors_to(doubt):
                    table = self._read(source, doubt)
                    if source.role == "imu":
                        other_imus[source.topic], _ = decode_imu(table, self.config.imu)
                    elif source.role == "reference":
                        columns, _ = decode_reference([table], self.config.reference, self.config.initial)
                        if columns is not None and not says_anything(columns):
                            text = "has neither an attitude nor a velocity that is not zero in all messages"
                            raise LogError(text, "", *table.where)
                    if own_clocks and own_clocks[0].role == "imu":
                        self.columns.clock_notes([own_clocks[0], self.clocks[-1]])
        if self.columns.imu is not None:
            with errors_to(self._add_obstacle):
                self._remark(self.columns.clock_notes(own_clocks))
            for remark in self._remarks(self.columns.imu):
                if isinstance(remark, LogError):
                    self._add_obstacle(remark)
                else:
                    self._remark([remark])
        for topic, imu in other_imus.items():
            for remark in self._remarks(imu):
                if isinstance(remark, LogError):
                    self._doubt(topic, remark)
                elif remark.code.startswith("imu"):
                    self.doubted |= {topic} if remark.severity == Severity.WARNING else set()
                    self._remark([replace(remark, text=f"{topic}: {remark.text}")])

    def examine_others(self, channels: Iterable[LogChannel]) -> None:
        """Look at the clocks of topics without a role, as far as their messages have a header."""
        for channel in channels:
            try:
                check_encoding(channel)
                has_header = channel.messages > 0 and "header.stamp" in channel_paths(channel)
            except UserError:  # what cannot be read is no matter where nobody needs it
                continue
            if has_header:
                source = Source("", channel.topic, channel.type_name, (channel,), {}, "header", 0.0)
                with errors_to(lambda error: self.notes.append(Note("other_clock", error.message))):
                    self.clocks.append(read_sample(self.log, source, _ENOUGH_OF_OTHERS).clock())

    def _read(self, source: Source, on_error: OnError) -> Table:
        """Read a topic; where its stamps are no times, report it and go on with the recorder's."""
        table = read_tables(self.log, [source])[0] if self.deep else read_sample(self.log, source, _ENOUGH)
        if table.unreadable_ns:
            on_error(table.damage_error())
        try:
            clock = table.clock()
        except UserError as error:
            on_error(error)
            table = replace(table, source=replace(source, stamp="log_time"))
            clock = table.clock()
        self.clocks.append(clock)
        return table

    def _decode(self, role: str, tables: list[Table]) -> None:
        columns, messages = self.columns, len(tables[0])
        notes = columns.decode(role, tables)
        if role == "dvl":
            dvl = columns.dvl
            repeats = sum(note.count for note in notes if note.code in ("dvl_repeats", "dvl_same_values"))
            steps_s = np.diff(seconds(dvl.time_ns, int(dvl.time_ns[0])))
            rate_hz = 1.0 / float(np.median(steps_s)) if steps_s.size else None
            beams = np.empty(0) if dvl.beam_velocity_mps is None else np.isfinite(dvl.beam_velocity_mps).sum(axis=1)
            four, three, fewer = (int(np.count_nonzero(part)) for part in (beams > 3, beams == 3, beams < 3))
            self.pings = PingFacts(messages, repeats, len(dvl.time_ns), four, three, fewer, rate_hz)
        elif columns.reference is not None and columns.imu is not None and self.deep:
            reference, (first_ns, last_ns) = columns.reference, columns.imu.time_ns[[0, -1]].tolist()
            parts_pct = []
            for values in (reference.position[:, :2], reference.velocity_n, reference.mat_nb.reshape(-1, 9)):
                time_ns = reference.time_ns[np.isfinite(values).all(axis=1)].clip(first_ns, last_ns)
                covered_ns = int(time_ns[-1] - time_ns[0]) if len(time_ns) else 0
                parts_pct.append(100.0 * covered_ns / max(last_ns - first_ns, 1))
            self.reference = ReferenceFacts(len(reference.time_ns), *parts_pct)
        self._remark(notes)

    def _not_decoded(self, role: str, error: UserError) -> None:
        if self.deep or role == "imu" or isinstance(error, ConfigError):
            self._add_obstacle(error)
            return
        # The first pings may be made in air and the first fixes without sky: this says nothing of the rest.
        text = f"by the first messages alone a replay would stop: {error.inside(self.log.path)}"
        self.notes.append(Note("first_messages", text, 1, Severity.WARNING, _LOOK_FURTHER))

    def _remarks(self, imu: ImuColumns) -> Iterator[Remark]:
        return plausibility_remarks(str(self.log.path), imu, self.columns.dvl, self.columns.reference, self.config)

    def _remark(self, notes: Iterable[Note]) -> None:
        """Keep notes; of those from a sample the warnings alone, since its counts are not the log's."""
        kept = (note for note in notes if self.deep or note.severity == Severity.WARNING)
        self.notes += [replace(note, hint=self._hint(note.hint)) for note in kept]

    def _hint(self, hint: str) -> str:
        """Return no value to copy that only the whole log shows well enough."""
        return hint if self.deep or not _MEASURED.search(hint) else _LOOK_DEEPER

    def _doubt(self, topic: str, error: UserError) -> None:
        self.doubted.add(topic)
        self.refused.setdefault(topic, error.inside(self.log.path, topic))
        text = f"{topic}: {error.inside(self.log.path, topic)}"
        self.notes.append(Note("candidate", text, 1, Severity.WARNING, self._hint(error.hint)))

    def _add_obstacle(self, error: UserError) -> None:
        self.obstacles.append(Obstacle(error.message, self._hint(error.hint)))
