"""What topics of unknown types show in their first messages: vectors and beams, by name and by size."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Final

import numpy as np

from insdvl_replay.columns import Floats
from insdvl_replay.errors import LogError
from insdvl_replay.logs.channel import LogChannel
from insdvl_replay.logs.decode import GRAVITY_MPS2, SPECIFIC_FORCE_UNITS
from insdvl_replay.logs.encodings import channel_paths, check_encoding, open_reader
from insdvl_replay.logs.field_paths import split_paths
from insdvl_replay.logs.recording import Recording
from insdvl_replay.logs.vectors import vector_paths

_BLOCKS: Final = 2
_WIDTHS: Final = range(3, 9)
_NEVER: Final = re.compile(r"cov|var|std|bias|offset|magn|time|stamp|ang\w*acc")
_WORDS: Final = {
    "specific_force": re.compile(r"acc|force|\b[af]x\b"),
    "angular_rate": re.compile(r"gyr|ang|rate|omega|rot|turn|\b[gw]x\b"),
    "velocity": re.compile(r"^(?!.*(ang|gyr)).*(vel|speed|twist|\bvx\b)"),
    "beam_velocity": re.compile(r"(\[\*\]|beam|trans).*vel"),
    "beam_valid": re.compile(r"(\[\*\]|beam|trans).*(valid|lock)"),
}
_GRAVITY_PART: Final = 0.1
"""A specific force is known by its size, where it differs from gravity by no more than this part of it."""


@dataclass(frozen=True)
class Candidate:
    """A vector or beams, seen in the first messages of a topic.

    Attributes
    ----------
    path : str
        As the configuration takes it.
    median : ndarray, shape (n,)
        Of each number.
    size : float
        Median length of the vector.
    """

    path: str
    median: Floats
    size: float

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
        """Say what was seen."""
        numbers = ", ".join(f"{value:.3g}" for value in self.median)
        return f"median ({numbers}), size {self.size:.3g}"


@dataclass(frozen=True)
class SeenTopic:
    """What the first messages of a topic show.

    Attributes
    ----------
    topic, type_name : str
    candidates : tuple of Candidate
    has_header : bool
        Whether there is a stamp where ROS 2 messages have it.
    """

    topic: str
    type_name: str
    candidates: tuple[Candidate, ...]
    has_header: bool

    @property
    def forces(self) -> list[Candidate]:
        """What could be the specific force: what is named like it, else what has the size of gravity."""
        return self.likely("specific_force") or [candidate for candidate in self._sound if candidate.force_unit]

    @property
    def rates(self) -> list[Candidate]:
        """What is named like an angular rate and is no specific force."""
        return [candidate for candidate in self.likely("angular_rate") if candidate not in self.forces]

    def likely(self, quantity: str) -> list[Candidate]:
        """Give those that are named like a quantity, and have as many numbers as it."""
        named = [candidate for candidate in self._sound if _WORDS[quantity].search(candidate.path.lower())]
        return [candidate for candidate in named if candidate.is_beams == quantity.startswith("beam")]

    @property
    def _sound(self) -> list[Candidate]:
        """Those that are not named like something else."""
        return [candidate for candidate in self.candidates if not _NEVER.search(candidate.path.lower())]


def see_topics(log: Recording, channels: Sequence[LogChannel]) -> list[SeenTopic]:
    """Look at the first messages of some topics for vectors and beams.

    Parameters
    ----------
    log : Recording
    channels : sequence of LogChannel
        Those without messages, and those that cannot be read, are left out.

    Returns
    -------
    list of SeenTopic
        Those with any vector or beams.
    """
    seen = []
    for channel in channels:
        if channel.messages:
            try:
                seen.append(_see(log, channel))
            except LogError:
                # What cannot be read cannot be proposed; it is no error before someone asks for it.
                continue
    return [topic for topic in seen if topic.candidates]


def _see(log: Recording, channel: LogChannel) -> SeenTopic:
    check_encoding(channel, str(log.path))
    known = channel_paths(channel, str(log.path))
    found: dict[str, Candidate] = {}
    # Read one by one, since one field that is not what it seems would spoil the others.
    for path in vector_paths(known):
        values = _first_values(log, channel, path)
        finite = values[np.isfinite(values).all(axis=1)]
        if values.shape[1] in _WIDTHS and len(finite):
            found[path] = Candidate(path, np.median(finite, axis=0), float(np.median(np.linalg.norm(finite, axis=1))))
    has_header = "header.stamp" in known
    return SeenTopic(channel.topic, channel.type_name, tuple(found.values()), has_header)


def _first_values(log: Recording, channel: LogChannel, path: str) -> Floats:
    paths = split_paths(path)
    reader = open_reader(channel, paths, f"{log.path}: {channel.topic}")
    parts = []
    for block in islice(log.blocks({channel.id}), _BLOCKS):
        columns = reader.columns(block)
        parts.append(np.concatenate([columns[part].astype(np.float64) for part in paths], axis=1))
    width = min((part.shape[1] for part in parts), default=0)
    return np.concatenate([part[:, :width] for part in parts]) if parts else np.empty((0, 0))
