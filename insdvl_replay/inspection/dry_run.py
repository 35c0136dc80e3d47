"""Clocks, pings and plausibility of each role of a log, and the fields of unknown types.

Reading a dive stops at the first error. Here each error is kept, and the rest is checked too.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
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
from insdvl_replay.core.states import GRAVITY_MPS2
from insdvl_replay.core.units import SPECIFIC_FORCE_BY_SIZE
from insdvl_replay.core.words import Severity
from insdvl_replay.inspection.inventory import Blocker, PingFacts, ReferenceFacts
from insdvl_replay.logs.columns.imu import decode_imu
from insdvl_replay.logs.columns.reference import decode_reference
from insdvl_replay.logs.columns.tables import Table, read_sample, read_tables
from insdvl_replay.logs.columns.topics import Source
from insdvl_replay.logs.formats.decoded import DecodedFields
from insdvl_replay.logs.formats.definitions import PRIMITIVES
from insdvl_replay.logs.formats.fields import (
    NUMBER,
    TABLE,
    FieldReader,
    Kinds,
    check_encoding,
    split_paths,
)
from insdvl_replay.logs.formats.log_file import Block, LogChannel
from insdvl_replay.logs.formats.readers import channel_paths, open_reader
from insdvl_replay.logs.formats.recording import Recording
from insdvl_replay.logs.read import Finding, RoleColumns, loss_notes, source_notes, stamp_notes

_ENOUGH: Final = 1000  # messages of a topic that show its clock and its units
_ENOUGH_OF_OTHERS: Final = 10
_LOOK_DEEPER: Final = "to measure the value on all messages: `inspect --deep`"
_LOOK_FURTHER: Final = "to check all messages: `inspect --deep`"

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
    clocks: list[Clock] = field(
        default_factory=list
    )  # of the topics with a role, then of the others
    notes: list[Note] = field(default_factory=list)
    blockers: list[Blocker] = field(default_factory=list)
    pings: PingFacts | None = None
    reference: ReferenceFacts | None = None
    warned: set[str] = field(
        default_factory=set
    )  # of several topics for one role, those of which there is a warning
    refused: dict[str, str] = field(
        default_factory=dict
    )  # and those with which a replay would stop, with the reason
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
                self.notes.append(Note("other_clock", error.message))

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
                self._remark([replace(said, text=f"{topic}: {said.text}", hint=hint)])

    def _not_decoded(self, role: str, error: UserError) -> None:
        if self.deep or role == "imu" or isinstance(error, ConfigError):
            self._add_blocker(error)
            return
        # The first pings may be made in air and the first fixes without sky: this says nothing of the rest.
        text = f"the first messages would stop a replay: {error.inside(self.log.path)}"
        self.notes.append(Note("first_messages", text, 1, Severity.WARNING, _LOOK_FURTHER))

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

    def _warn_of(self, topic: str, error: UserError, hint: str | None = None) -> None:
        """Note what is wrong with one of several topics; the hint is that of the error if no other is given."""
        self.warned.add(topic)
        self.refused.setdefault(topic, error.inside(self.log.path, topic))
        text = f"{topic}: {error.inside(self.log.path, topic)}"
        given = error.hint if hint is None else hint
        self.notes.append(Note("candidate", text, 1, Severity.WARNING, given))

    def _add_blocker(self, error: UserError) -> None:
        self.blockers.append(Blocker(error.message, error.hint))


def _ping_facts(dvl: DvlColumns, messages: int, notes: Iterable[Note]) -> PingFacts:
    """Count the pings of a DVL, by the messages that were read and the notes on them."""
    repeats = 0
    for note in notes:
        if note.code in ("dvl_repeats", "dvl_same_values"):
            repeats += note.count
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


# --- Topics of unknown types: vectors and beams by name and size, and single numbers.

# Words and letters by which fields differ that belong together; of two families that begin alike the longer first.
_FAMILIES: Final = (
    ("x", "y", "z"),
    ("X", "Y", "Z"),
    ("p", "q", "r"),
    ("u", "v", "w"),
    ("surge", "sway", "heave"),
    ("forward", "starboard", "down"),
    ("fwd", "stbd", "down"),
    ("roll", "pitch", "yaw"),
    ("1", "2", "3", "4"),
    ("0", "1", "2", "3"),
    ("1", "2", "3"),
    ("0", "1", "2"),
)
_SECONDS: Final = {"sec", "secs", "seconds"}
_NANOSECONDS: Final = {"nsec", "nsecs", "nanosec", "nanos", "nanoseconds"}
_BLOCKS: Final = 2
_FAR_AWAY: Final = 5.0  # ratio to the largest other reading above which equal ones stand for none
_MESSAGES: Final = 1000
_LARGEST_BYTES: Final = 1_000_000
# Fields that are gone over in one topic: to look at one costs as much as the type has, which may be thousands.
_MOST_WORK: Final = 1 << 18
_MOST_WORK_OF_ALL: Final = 1 << 21
_WIDTHS: Final = range(3, 9)
_NEVER: Final = re.compile(r"cov|var|std|bias|offset|magn|time|stamp|ang\w*acc|quat|orient")
_WORDS: Final = {
    "specific_force": re.compile(r"acc|force|\b[af]x\b|delta_?v|\bdvx\b"),
    "angular_rate": re.compile(r"gyr|ang|rate|omega|rot|turn|\b[gw]x\b|\bp, (\S+\.)?q, "),
    "velocity": re.compile(
        r"^(?!.*(ang|gyr|delta)).*(vel|speed|twist|surge|\bvx\b|\bu, (\S+\.)?v, )"
    ),
    "beam_velocity": re.compile(r"(\[\*\]|beam|trans).*(vel|[._]v$)|vel.*(beam|trans)"),
    "beam_valid": re.compile(r"(\[\*\]|beam|trans).*(valid|lock|good)"),
}
AS_GRAVITY_MPS2: Final = (
    0.9 * GRAVITY_MPS2,
    1.1 * GRAVITY_MPS2,
)  # a specific force is known by its size


def fitting_units(
    size: float, units: Mapping[str, float], least: float, most: float
) -> tuple[str, ...]:
    """Return the units, by their SI factors, in which a size is between two limits."""
    return tuple(unit for unit, factor in units.items() if least < size * factor < most)


def _numbers(known: Kinds) -> tuple[list[str], dict[str, list[str]]]:
    """Return the fields that are numbers, and the names of the numbers in each structure that is in no list."""
    numbers = [path for path, kind in known.items() if kind == NUMBER or kind in PRIMITIVES]
    children: dict[str, list[str]] = {}
    for path in numbers:
        parent, _, child = path.rpartition(".")
        if parent and "[*]" not in parent:
            children.setdefault(parent, []).append(child)
    return numbers, children


def without_marks(values: Floats) -> Floats:
    """Leave out the rows of values, (k, n), with a number that stands for none: the largest, repeated and far away."""
    sizes = np.abs(values).max(axis=1, initial=0.0)
    is_mark = sizes == sizes.max(initial=0.0)
    others = sizes[~is_mark]
    is_far = others.size > 0 and sizes.max() > _FAR_AWAY * others.max()
    is_repeated = np.count_nonzero(is_mark) > 1
    return values[~is_mark] if is_far and is_repeated else values


def vector_paths(known: Kinds) -> list[str]:
    """Find what could be a vector or beams among the fields of a type."""
    numbers, children = _numbers(known)
    found = {path.removesuffix("[*]") for path in numbers if path.count("[*]") == 1}
    joined: set[str] = set()  # structures whose numbers belong together already
    for path, names in children.items():
        if sorted(names) == ["x", "y", "z"]:
            joined.add(path)
            found.add(path)
        elif sorted(names) == ["w", "x", "y", "z"]:  # a quaternion
            joined.add(path)
    single = {path for path in scalar_paths(known) if path.rpartition(".")[0] not in joined}
    for path in single:
        family = _family_of(path, single)
        if family:
            found.add(", ".join(family))
    return sorted(found)


def _family_of(path: str, single: AbstractSet[str]) -> list[str]:
    """Return the single numbers that belong to a first one; none where one of them is missing.

    Such as ``ax``, ``ay``, ``az`` or ``p``, ``q``, ``r`` or ``beam_1`` to ``beam_4``.
    """
    parent, dot, name = path.rpartition(".")
    for first, *others in _FAMILIES:
        for place in re.finditer(first, name):
            before = f"{parent}{dot}{name[: place.start()]}"
            after = name[place.end() :]
            family = [path, *(f"{before}{other}{after}" for other in others)]
            if single >= set(family):
                return family
    return []


def scalar_paths(known: Kinds) -> list[str]:
    """Find the single numbers among the fields of a type."""
    in_times = tuple(f"{path}." for path in time_paths(known))
    numbers, _ = _numbers(known)
    found = []
    for path in numbers:
        is_list = "[*]" in path or f"{path}[*]" in known
        if not is_list and not path.startswith(in_times):
            found.append(path)
    return found


def time_paths(known: Kinds) -> list[str]:
    """Find the times and durations of a type: structures of seconds and nanoseconds."""
    _, children = _numbers(known)
    found = []
    for path, names in children.items():
        if len(names) == 2:
            first, second = names
            if first in _SECONDS and second in _NANOSECONDS:
                found.append(path)
    return found


@dataclass(frozen=True)
class FieldMatch:
    """A vector or beams, seen in the first messages."""

    path: str
    median: Floats  # of each number
    size: float  # the median length
    largest: float

    @property
    def is_beams(self) -> bool:
        """Whether the numbers are those of a list, or more than a vector has."""
        return "[*]" in self.path or self.median.size > 3

    @property
    def force_unit(self) -> str:
        """The unit in which the vector has the size of gravity; empty if in none."""
        if self.is_beams:
            return ""
        for unit in fitting_units(self.size, SPECIFIC_FORCE_BY_SIZE, *AS_GRAVITY_MPS2):
            return unit
        return ""

    def __str__(self) -> str:
        """State what was seen."""
        numbers = ", ".join(f"{value:.3g}" for value in self.median)
        return f"median ({numbers}), size {self.size:.3g}, at most {self.largest:.3g}"


@dataclass(frozen=True)
class ProbedTopic:
    """What the first messages of a topic show."""

    channel: LogChannel
    known: Kinds  # every path with its type
    candidates: tuple[FieldMatch, ...]
    scalars: dict[str, float]  # the median of each single number

    @property
    def topic(self) -> str:
        """Its name."""
        return self.channel.topic

    @property
    def is_table(self) -> bool:
        """Whether its messages are the rows of a table."""
        return self.channel.encoding == TABLE

    def stated_unit(self, path: str) -> str:
        """Return the unit that a table states for a path; empty if there is none."""
        return self.channel.metadata.get(split_paths(path)[0], "")

    def likely(self, quantity: str) -> list[FieldMatch]:
        """Return what could be a quantity by its name and number; of a specific force by its size, if none is named so.

        A ``vector`` has any name that is not that of something else.
        """
        known = self._nameable(are_beams=quantity.startswith("beam"))
        words = _WORDS.get(quantity)
        if words is None:
            return known
        named = [candidate for candidate in known if words.search(candidate.path.lower())]
        if named:
            return named
        if quantity == "specific_force":
            return [candidate for candidate in known if candidate.force_unit]
        if quantity == "velocity" and self.is_table:
            return [candidate for candidate in known if "dvl" in candidate.path]
        return []

    def _nameable(self, *, are_beams: bool) -> list[FieldMatch]:
        """Return the vectors, or the beams, whose name is not that of something else."""
        found = []
        for candidate in self.candidates:
            is_other = _NEVER.search(candidate.path.lower())
            if candidate.is_beams == are_beams and not is_other:
                found.append(candidate)
        return found


def probe_topics(
    log: Recording, channels: Sequence[LogChannel]
) -> tuple[list[ProbedTopic], list[str]]:
    """Look at the first messages of some topics; name those that were too many to be looked at, too."""
    seen: list[ProbedTopic] = []
    unseen: list[str] = []
    work = 0
    for channel in channels:
        if channel.messages and work >= _MOST_WORK_OF_ALL:
            unseen.append(channel.topic)
        elif channel.messages:
            # What cannot be read cannot be proposed; it is no error before someone asks for it.
            with suppress(LogError):
                topic, looks = _probe(log, channel)
                seen.append(topic)
                work += looks * len(topic.known)
    return [topic for topic in seen if topic.candidates or topic.scalars], unseen


def _probe(log: Recording, channel: LogChannel) -> tuple[ProbedTopic, int]:
    """Probe a topic; return how many fields were looked at, too."""
    check_encoding(channel)
    blocks = []
    for block in islice(log.blocks({channel.id}), _BLOCKS):
        # The first messages; of images and sonar records one or two.
        within = int(np.searchsorted(np.cumsum(block.sizes), _LARGEST_BYTES))
        blocks.append(block.part(slice(max(1, min(_MESSAGES, within)))))
    reader = open_reader(channel, ())
    # In JSON without schema only the messages show which fields there are.
    for block in blocks[:1]:
        reader.columns(block)
    candidates: list[FieldMatch] = []
    scalars: dict[str, float] = {}
    most = _MOST_WORK // max(len(reader.known), 1)
    paths = [*vector_paths(reader.known), *scalar_paths(reader.known)][:most]
    for path in paths:
        # Read one by one, since one field that is not what it seems would spoil the others.
        parts = split_paths(path)
        if isinstance(reader, DecodedFields):
            values = _values_of(parts, reader.of(parts), blocks)
        else:
            values = _values_of(parts, open_reader(channel, parts), blocks)
        finite = without_marks(values[np.isfinite(values).all(axis=1)])
        width = values.shape[1]
        if len(finite) and width in _WIDTHS:
            sizes = np.linalg.norm(finite, axis=1)
            middle = np.median(finite, axis=0)
            candidates.append(FieldMatch(path, middle, float(np.median(sizes)), float(sizes.max())))
        elif len(finite) and width == 1:
            scalars[path] = float(np.median(finite))
    return ProbedTopic(channel, reader.known, tuple(candidates), scalars), len(paths)


def _values_of(parts: Sequence[str], fields: FieldReader, blocks: Sequence[Block]) -> Floats:
    """Read the numbers of some fields, (messages, numbers); of lists as many as the shortest block has."""
    values = []
    for block in blocks:
        columns = fields.columns(block)
        values.append(np.concatenate([columns[part].astype(np.float64) for part in parts], axis=1))
    if not values:
        return np.empty((0, 0))
    width = min(columns.shape[1] for columns in values)
    return np.concatenate([columns[:, :width] for columns in values])
