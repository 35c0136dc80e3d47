"""What topics of unknown types show in their first messages: vectors and beams by name and size, and single numbers."""

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.states import GRAVITY_MPS2, SPECIFIC_FORCE_UNITS
from insdvl_replay.logs.container.blocks import Block
from insdvl_replay.logs.container.recording import Recording
from insdvl_replay.logs.container.records import LogChannel
from insdvl_replay.logs.encoding.decoded_fields import DecodedFields
from insdvl_replay.logs.encoding.fields import NUMBER, FieldReader, Kinds, check_encoding, open_reader, split_paths
from insdvl_replay.logs.encoding.ros2msg import PRIMITIVES

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
"""Words and letters by which fields differ that belong together; of two families that begin alike the longer first."""
_SECONDS: Final = {"sec", "secs", "seconds"}
_NANOSECONDS: Final = {"nsec", "nsecs", "nanosec", "nanos", "nanoseconds"}


def vector_paths(known: Kinds) -> list[str]:
    """Find what could be a vector or beams among the fields of a type."""
    numbers = _numbers(known)
    lists = [path.removesuffix("[*]") for path in numbers if path.count("[*]") == 1]
    structures = set(_structures(numbers))
    closed = structures | set(_quaternions(numbers))
    single = [path for path in scalar_paths(known) if path.rpartition(".")[0] not in closed]
    return sorted({*structures, *_families(single), *lists})


def scalar_paths(known: Kinds) -> list[str]:
    """Find the single numbers among the fields of a type."""
    in_times = tuple(f"{path}." for path in time_paths(known))
    numbers = [path for path in _numbers(known) if f"{path}[*]" not in known and "[*]" not in path]
    return [path for path in numbers if not path.startswith(in_times)]


def time_paths(known: Kinds) -> list[str]:
    """Find the times and durations of a type: structures of seconds and nanoseconds."""
    return [
        path
        for path, names in _children(_numbers(known)).items()
        if len(names) == 2 and names[0] in _SECONDS and names[1] in _NANOSECONDS
    ]


def _numbers(known: Kinds) -> list[str]:
    return [path for path, kind in known.items() if kind == NUMBER or kind in PRIMITIVES]


def _children(numbers: Iterable[str]) -> dict[str, list[str]]:
    """Return the names of the numbers in each structure that is in no list."""
    children: dict[str, list[str]] = {}
    for path in numbers:
        parent, _, child = path.rpartition(".")
        if parent and "[*]" not in parent:
            children.setdefault(parent, []).append(child)
    return children


def _structures(numbers: Iterable[str]) -> Iterator[str]:
    """Find structures of exactly x, y and z."""
    return (path for path, names in _children(numbers).items() if sorted(names) == ["x", "y", "z"])


def _quaternions(numbers: Iterable[str]) -> Iterator[str]:
    return (path for path, names in _children(numbers).items() if sorted(names) == ["w", "x", "y", "z"])


def _families(single: Iterable[str]) -> Iterator[str]:
    """Find fields such as ``ax``, ``ay``, ``az`` or ``p``, ``q``, ``r`` or ``beam_1`` to ``beam_4``."""
    paths = set(single)
    for path in paths:
        complete = (names for names in _siblings(path) if paths.issuperset(names))
        names = next(complete, None)
        if names is not None:
            yield ", ".join(names)


def _siblings(path: str) -> Iterator[list[str]]:
    """Return the names that a field and its siblings would have, were it the first of a family; larger ones first."""
    parent, dot, name = path.rpartition(".")
    for first, *others in _FAMILIES:
        for place in re.finditer(first, name):
            before, after = f"{parent}{dot}{name[: place.start()]}", name[place.end() :]
            yield [path, *(f"{before}{other}{after}" for other in others)]


_BLOCKS: Final = 2
_MESSAGES: Final = 1000
_LARGEST_BYTES: Final = 1_000_000
_MOST_WORK: Final = 1 << 18
"""Fields that are gone over in one topic: to look at one costs as much as the type has, which may be thousands."""
_MOST_WORK_OF_ALL: Final = 1 << 21
_WIDTHS: Final = range(3, 9)
_NEVER: Final = re.compile(r"cov|var|std|bias|offset|magn|time|stamp|ang\w*acc|quat|orient")
_WORDS: Final = {
    "specific_force": re.compile(r"acc|force|\b[af]x\b"),
    "angular_rate": re.compile(r"gyr|ang|rate|omega|rot|turn|\b[gw]x\b|\bp, (\S+\.)?q, "),
    "velocity": re.compile(r"^(?!.*(ang|gyr)).*(vel|speed|twist|surge|\bvx\b|\bu, (\S+\.)?v, )"),
    "beam_velocity": re.compile(r"(\[\*\]|beam|trans).*(vel|[._]v$)|vel.*(beam|trans)"),
    "beam_valid": re.compile(r"(\[\*\]|beam|trans).*(valid|lock|good)"),
}
_GRAVITY_PART: Final = 0.1
"""A specific force is known by its size, where it differs from gravity by no more than this part of it."""


@dataclass(frozen=True)
class Candidate:
    """A vector or beams, seen in the first messages: the median of each number, the median length and the longest."""

    path: str
    median: Floats
    size: float
    largest: float

    @property
    def is_beams(self) -> bool:
        """Whether the numbers are those of a list, or more than a vector has."""
        return "[*]" in self.path or self.median.size > 3

    @property
    def force_unit(self) -> str:
        """The unit in which the vector has the size of gravity; empty if in none."""
        for unit, factor in SPECIFIC_FORCE_UNITS.items():
            if not self.is_beams and abs(self.size * factor / GRAVITY_MPS2 - 1.0) < _GRAVITY_PART:
                return unit
        return ""

    def __str__(self) -> str:
        """State what was seen."""
        numbers = ", ".join(f"{value:.3g}" for value in self.median)
        return f"median ({numbers}), size {self.size:.3g}, at most {self.largest:.3g}"


@dataclass(frozen=True)
class ProbedTopic:
    """What the first messages of a topic show: every path with its type, and the median of each single number."""

    channel: LogChannel
    known: Kinds
    candidates: tuple[Candidate, ...]
    scalars: dict[str, float]

    @property
    def topic(self) -> str:
        """Its name."""
        return self.channel.topic

    @property
    def forces(self) -> list[Candidate]:
        """What could be the specific force: what is named like it, else what has the size of gravity."""
        return self.likely("specific_force") or [candidate for candidate in self.plausible if candidate.force_unit]

    @property
    def rates(self) -> list[Candidate]:
        """What is named like an angular rate and is no specific force."""
        return [candidate for candidate in self.likely("angular_rate") if candidate not in self.forces]

    @property
    def vectors(self) -> list[Candidate]:
        """Those of three numbers that are not named like something else."""
        return [candidate for candidate in self.plausible if not candidate.is_beams]

    @property
    def plausible(self) -> list[Candidate]:
        """Those that are not named like something else."""
        return [candidate for candidate in self.candidates if not _NEVER.search(candidate.path.lower())]

    def likely(self, quantity: str) -> list[Candidate]:
        """Return those that are named like a quantity, and have as many numbers as it."""
        named = [candidate for candidate in self.plausible if _WORDS[quantity].search(candidate.path.lower())]
        return [candidate for candidate in named if candidate.is_beams == quantity.startswith("beam")]


def probe_topics(log: Recording, channels: Sequence[LogChannel]) -> tuple[list[ProbedTopic], list[str]]:
    """Look at the first messages of some topics for vectors, beams and single numbers."""
    seen: list[ProbedTopic] = []
    unseen: list[str] = []
    work = 0
    for channel in channels:
        if not channel.messages:
            continue
        if work >= _MOST_WORK_OF_ALL:
            unseen.append(channel.topic)
            continue
        # What cannot be read cannot be proposed; it is no error before someone asks for it.
        with suppress(LogError):
            topic, looks = _probe(log, channel)
            seen.append(topic)
            work += looks * len(topic.known)
    return [topic for topic in seen if topic.candidates or topic.scalars], unseen


def _probe(log: Recording, channel: LogChannel) -> tuple[ProbedTopic, int]:
    """Probe a topic; return how many fields were looked at, too."""
    check_encoding(channel)
    blocks = [_first_of(block) for block in islice(log.blocks({channel.id}), _BLOCKS)]
    reader = open_reader(channel, ())
    # In JSON without schema only the messages show which fields there are.
    for block in blocks[:1]:
        reader.columns(block)
    candidates: dict[str, Candidate] = {}
    scalars: dict[str, float] = {}
    # Read one by one, since one field that is not what it seems would spoil the others.
    paths = [*vector_paths(reader.known), *scalar_paths(reader.known)][: _MOST_WORK // max(len(reader.known), 1)]
    for path in paths:
        values = _values(reader, channel, path, blocks)
        finite = values[np.isfinite(values).all(axis=1)]
        sizes = np.linalg.norm(finite, axis=1)
        if len(finite) and values.shape[1] in _WIDTHS:
            candidates[path] = Candidate(path, np.median(finite, axis=0), float(np.median(sizes)), float(sizes.max()))
        elif len(finite) and values.shape[1] == 1:
            scalars[path] = float(np.median(finite))
    return ProbedTopic(channel, reader.known, tuple(candidates.values()), scalars), len(paths)


def _first_of(block: Block) -> Block:
    """Return a block's first messages; of images and sonar records one or two."""
    within = int(np.searchsorted(np.cumsum(block.sizes), _LARGEST_BYTES))
    return block.part(slice(max(1, min(_MESSAGES, within))))


def _values(seen: FieldReader, channel: LogChannel, path: str, blocks: Sequence[Block]) -> Floats:
    paths = split_paths(path)
    reader = seen.of(paths) if isinstance(seen, DecodedFields) else open_reader(channel, paths)
    parts = []
    for block in blocks:
        columns = reader.columns(block)
        parts.append(np.concatenate([columns[part].astype(np.float64) for part in paths], axis=1))
    width = min((part.shape[1] for part in parts), default=0)
    return np.concatenate([part[:, :width] for part in parts]) if parts else np.empty((0, 0))
