"""What topics of unknown types show in their first messages: vectors and beams by name and size, and single numbers."""

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.states import GRAVITY_MPS2, SPECIFIC_FORCE_UNITS
from insdvl_replay.logs.formats.decoded import DecodedFields
from insdvl_replay.logs.formats.definitions import PRIMITIVES
from insdvl_replay.logs.formats.fields import NUMBER, Kinds, check_encoding, open_reader, split_paths
from insdvl_replay.logs.formats.log_file import LogChannel
from insdvl_replay.logs.formats.recording import Recording

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


def _numbers(known: Kinds) -> tuple[list[str], dict[str, list[str]]]:
    """Return the fields that are numbers, and the names of the numbers in each structure that is in no list."""
    numbers = [path for path, kind in known.items() if kind == NUMBER or kind in PRIMITIVES]
    children: dict[str, list[str]] = {}
    for path in numbers:
        parent, _, child = path.rpartition(".")
        if parent and "[*]" not in parent:
            children.setdefault(parent, []).append(child)
    return numbers, children


def vector_paths(known: Kinds) -> list[str]:
    """Find what could be a vector or beams among the fields of a type."""
    numbers, children = _numbers(known)
    lists = [path.removesuffix("[*]") for path in numbers if path.count("[*]") == 1]
    structures = {path for path, names in children.items() if sorted(names) == ["x", "y", "z"]}
    quaternions = {path for path, names in children.items() if sorted(names) == ["w", "x", "y", "z"]}
    single = {path for path in scalar_paths(known) if path.rpartition(".")[0] not in structures | quaternions}
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
    numbers = [path for path in _numbers(known)[0] if f"{path}[*]" not in known and "[*]" not in path]
    return [path for path in numbers if not path.startswith(in_times)]


def time_paths(known: Kinds) -> list[str]:
    """Find the times and durations of a type: structures of seconds and nanoseconds."""
    pairs = {path: names for path, names in _numbers(known)[1].items() if len(names) == 2}
    return [path for path, (first, second) in pairs.items() if first in _SECONDS and second in _NANOSECONDS]


@dataclass(frozen=True)
class Candidate:
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
    """What the first messages of a topic show."""

    channel: LogChannel
    known: Kinds  # every path with its type
    candidates: tuple[Candidate, ...]
    scalars: dict[str, float]  # the median of each single number

    @property
    def topic(self) -> str:
        """Its name."""
        return self.channel.topic

    @property
    def plausible(self) -> list[Candidate]:
        """Those that are not named like something else."""
        return [candidate for candidate in self.candidates if not _NEVER.search(candidate.path.lower())]

    @property
    def vectors(self) -> list[Candidate]:
        """Those of three numbers that are not named like something else."""
        return [candidate for candidate in self.plausible if not candidate.is_beams]

    @property
    def forces(self) -> list[Candidate]:
        """What could be the specific force: what is named like it, else what has the size of gravity."""
        return self.likely("specific_force") or [candidate for candidate in self.plausible if candidate.force_unit]

    @property
    def rates(self) -> list[Candidate]:
        """What is named like an angular rate and is no specific force."""
        return [candidate for candidate in self.likely("angular_rate") if candidate not in self.forces]

    def likely(self, quantity: str) -> list[Candidate]:
        """Return those that are named like a quantity, and have as many numbers as it."""
        named = [candidate for candidate in self.plausible if _WORDS[quantity].search(candidate.path.lower())]
        return [candidate for candidate in named if candidate.is_beams == quantity.startswith("beam")]


def probe_topics(log: Recording, channels: Sequence[LogChannel]) -> tuple[list[ProbedTopic], list[str]]:
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
    candidates: list[Candidate] = []
    scalars: dict[str, float] = {}
    paths = [*vector_paths(reader.known), *scalar_paths(reader.known)][: _MOST_WORK // max(len(reader.known), 1)]
    for path in paths:
        # Read one by one, since one field that is not what it seems would spoil the others.
        parts = split_paths(path)
        fields = reader.of(parts) if isinstance(reader, DecodedFields) else open_reader(channel, parts)
        read = (fields.columns(block) for block in blocks)
        values = [np.concatenate([columns[part].astype(np.float64) for part in parts], axis=1) for columns in read]
        width = min((columns.shape[1] for columns in values), default=0)
        every = np.concatenate([columns[:, :width] for columns in values]) if values else np.empty((0, 0))
        finite = every[np.isfinite(every).all(axis=1)]
        if len(finite) and width in _WIDTHS:
            sizes = np.linalg.norm(finite, axis=1)
            candidates.append(Candidate(path, np.median(finite, axis=0), float(np.median(sizes)), float(sizes.max())))
        elif len(finite) and width == 1:
            scalars[path] = float(np.median(finite))
    return ProbedTopic(channel, reader.known, tuple(candidates), scalars), len(paths)
