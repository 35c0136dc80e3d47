"""Topics of unknown types, by their first messages: vectors and beams by name and size, and single numbers."""

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.errors import LogError
from insdvl_replay.inspection.unit_by_size import force_units
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
from insdvl_replay.logs.formats.readers import open_reader
from insdvl_replay.logs.formats.recording import Recording

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


def _family_of(path: str, single: set[str]) -> list[str]:
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
        units = force_units(self.size)
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
            candidates.append(
                FieldMatch(path, middle, float(np.median(sizes)), float(sizes.max()))
            )
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
