"""Clocks, pings and plausibility of each role of a log, and the fields of unknown types.

Reading a dive stops at the first error. Here each error is kept, and the rest is checked too.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from typing import Final

import numpy as np

from insdvl_replay.checks.reference import plausibility_remarks, says_anything
from insdvl_replay.checks.sentences import Measured, Remark, without_mark
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Floats, ImuColumns, seconds
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
    Kinds,
    check_encoding,
    split_paths,
)
from insdvl_replay.logs.formats.log_file import LogChannel
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

    def __post_init__(self) -> None:
        self.columns = RoleColumns(str(self.log.path), self.config)

    def examine(self, findings: Sequence[Finding]) -> None:
        """Look at all topics that play a role or could."""
        own_clocks: list[Clock] = []
        other_imus: dict[str, ImuColumns] = {}
        for finding in findings:
            if finding.error is not None:
                self._add_blocker(finding.error)
            tables: list[Table] = []
            with errors_to(self._add_blocker):
                read = [self._read(source, self._add_blocker) for source in finding.sources]
                self._remark([*source_notes(finding.sources), *stamp_notes(read)])
                if self.deep:
                    self._remark(loss_notes(read))
                tables = read
                own_clocks += self.clocks[len(self.clocks) - len(read) :]
            if tables and finding.role != "truth":
                with errors_to(partial(self._not_decoded, finding.role)):
                    self._decode(finding.role, tables)
            # A fault of one of several topics is not a blocker yet.
            for source in finding.candidates:
                warn = partial(self._warn_of, source.topic)
                with errors_to(warn):
                    table = self._read(source, warn)
                    if source.role == "imu":
                        other_imus[source.topic], _ = decode_imu(table, self.config.imu)
                    elif source.role == "reference":
                        columns, _ = decode_reference(
                            [table], self.config.reference, self.config.initial
                        )
                        if columns is not None and not says_anything(columns):
                            text = "has no attitude, and its velocity is zero in all messages"
                            raise LogError(text, "", *table.where)
                    if own_clocks and own_clocks[0].role == "imu":
                        self.columns.clock_notes([own_clocks[0], self.clocks[-1]])
        if self.columns.imu is not None:
            with errors_to(self._add_blocker):
                self._remark(self.columns.clock_notes(own_clocks))
            for remark in self._remarks(self.columns.imu):
                said = without_mark(remark)
                if isinstance(said, LogError):
                    self.blockers.append(Blocker(said.message, self._hint(remark)))
                else:
                    self._remark([replace(said, hint=self._hint(remark))])
        for topic, imu in other_imus.items():
            for remark in self._remarks(imu):
                said = without_mark(remark)
                hint = self._hint(remark)
                if isinstance(said, LogError):
                    self._warn_of(topic, said, hint)
                elif said.code.startswith("imu"):
                    if said.severity == Severity.WARNING:
                        self.warned.add(topic)
                    self._remark([replace(said, text=f"{topic}: {said.text}", hint=hint)])

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
        table = (
            read_tables(self.log, [source])[0]
            if self.deep
            else read_sample(self.log, source, _ENOUGH)
        )
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
        columns = self.columns
        messages = len(tables[0])
        notes = columns.decode(role, tables)
        if role == "dvl":
            dvl = columns.dvl
            repeats = sum(
                note.count for note in notes if note.code in ("dvl_repeats", "dvl_same_values")
            )
            steps_s = np.diff(seconds(dvl.time_ns, int(dvl.time_ns[0])))
            rate_hz = 1.0 / float(np.median(steps_s)) if steps_s.size else None
            beams = (
                np.empty(0)
                if dvl.beam_velocity_mps is None
                else np.isfinite(dvl.beam_velocity_mps).sum(axis=1)
            )
            four, three, fewer = (
                int(np.count_nonzero(part)) for part in (beams > 3, beams == 3, beams < 3)
            )
            self.pings = PingFacts(messages, repeats, len(dvl.time_ns), four, three, fewer, rate_hz)
        elif columns.reference is not None and columns.imu is not None and self.deep:
            reference, (first_ns, last_ns) = (
                columns.reference,
                columns.imu.time_ns[[0, -1]].tolist(),
            )
            parts_pct = []
            for values in (
                reference.position[:, :2],
                reference.velocity_n,
                reference.mat_nb.reshape(-1, 9),
            ):
                time_ns = reference.time_ns[np.isfinite(values).all(axis=1)].clip(first_ns, last_ns)
                covered_ns = int(time_ns[-1] - time_ns[0]) if len(time_ns) else 0
                parts_pct.append(100.0 * covered_ns / max(last_ns - first_ns, 1))
            self.reference = ReferenceFacts(len(reference.time_ns), *parts_pct)
        self._remark(notes)

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
    lists = [path.removesuffix("[*]") for path in numbers if path.count("[*]") == 1]
    structures = {path for path, names in children.items() if sorted(names) == ["x", "y", "z"]}
    quaternions = {
        path for path, names in children.items() if sorted(names) == ["w", "x", "y", "z"]
    }
    single = {
        path
        for path in scalar_paths(known)
        if path.rpartition(".")[0] not in structures | quaternions
    }
    # Fields such as ``ax``, ``ay``, ``az`` or ``p``, ``q``, ``r`` or ``beam_1`` to ``beam_4``.
    families = set()
    for path in single:
        parent, dot, name = path.rpartition(".")
        complete = (
            siblings
            for first, *others in _FAMILIES
            for place in re.finditer(first, name)
            for before, after in [(f"{parent}{dot}{name[: place.start()]}", name[place.end() :])]
            for siblings in [[path, *(f"{before}{other}{after}" for other in others)]]
            if single.issuperset(siblings)
        )
        families |= {", ".join(siblings) for siblings in islice(complete, 1)}
    return sorted({*structures, *families, *lists})


def scalar_paths(known: Kinds) -> list[str]:
    """Find the single numbers among the fields of a type."""
    in_times = tuple(f"{path}." for path in time_paths(known))
    numbers = [
        path for path in _numbers(known)[0] if f"{path}[*]" not in known and "[*]" not in path
    ]
    return [path for path in numbers if not path.startswith(in_times)]


def time_paths(known: Kinds) -> list[str]:
    """Find the times and durations of a type: structures of seconds and nanoseconds."""
    pairs = {path: names for path, names in _numbers(known)[1].items() if len(names) == 2}
    return [
        path
        for path, (first, second) in pairs.items()
        if first in _SECONDS and second in _NANOSECONDS
    ]


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
        units = (
            ()
            if self.is_beams
            else fitting_units(self.size, SPECIFIC_FORCE_BY_SIZE, *AS_GRAVITY_MPS2)
        )
        if units:
            return units[0]
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
        known = [
            candidate
            for candidate in self.candidates
            if not _NEVER.search(candidate.path.lower())
            and candidate.is_beams == quantity.startswith("beam")
        ]
        words = _WORDS.get(quantity)
        named = (
            known
            if words is None
            else [candidate for candidate in known if words.search(candidate.path.lower())]
        )
        if quantity == "specific_force" and not named:
            return [candidate for candidate in known if candidate.force_unit]
        if quantity == "velocity" and self.is_table and not named:
            return [candidate for candidate in known if "dvl" in candidate.path]
        return named


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
    paths = [*vector_paths(reader.known), *scalar_paths(reader.known)][
        : _MOST_WORK // max(len(reader.known), 1)
    ]
    for path in paths:
        # Read one by one, since one field that is not what it seems would spoil the others.
        parts = split_paths(path)
        fields = (
            reader.of(parts) if isinstance(reader, DecodedFields) else open_reader(channel, parts)
        )
        read = (fields.columns(block) for block in blocks)
        values = [
            np.concatenate([columns[part].astype(np.float64) for part in parts], axis=1)
            for columns in read
        ]
        width = min((columns.shape[1] for columns in values), default=0)
        every = (
            np.concatenate([columns[:, :width] for columns in values])
            if values
            else np.empty((0, 0))
        )
        finite = without_marks(every[np.isfinite(every).all(axis=1)])
        if len(finite) and width in _WIDTHS:
            sizes = np.linalg.norm(finite, axis=1)
            candidates.append(
                FieldMatch(
                    path, np.median(finite, axis=0), float(np.median(sizes)), float(sizes.max())
                )
            )
        elif len(finite) and width == 1:
            scalars[path] = float(np.median(finite))
    return ProbedTopic(channel, reader.known, tuple(candidates), scalars), len(paths)
