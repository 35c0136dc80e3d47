"""Settings to start from, for a log whose topics nobody has told the tool about.

Names of fields say what could be what; the size of the numbers says in which unit. What is proposed stands beside what
was seen, so that a person can judge it.
"""

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Final

import numpy as np

from insdvl_replay.columns import Floats
from insdvl_replay.errors import LogError
from insdvl_replay.logs.container import Log, LogChannel
from insdvl_replay.logs.decode import GRAVITY_MPS2, SPECIFIC_FORCE_UNITS
from insdvl_replay.logs.encodings import channel_paths, check_encoding, open_reader
from insdvl_replay.logs.field_paths import split_paths
from insdvl_replay.logs.vectors import vector_paths

_BLOCKS: Final = 2
_WIDTHS: Final = range(3, 9)
_NEVER: Final = re.compile(r"cov|var|std|bias|offset|magn|time|stamp|ang\w*acc")
_WORDS: Final = {
    "specific_force": re.compile(r"acc|force"),
    "angular_rate": re.compile(r"gyr|ang|rate|omega|rot"),
    "velocity": re.compile(r"^(?!.*(ang|gyr)).*(vel|speed|twist)"),
    "beam_velocity": re.compile(r"(\[\*\]|beam|trans).*vel"),
    "beam_valid": re.compile(r"(\[\*\]|beam|trans).*(valid|lock)"),
}
_DVL_WORDS: Final = re.compile(r"dvl|doppler|bottom")
_GRAVITY_PART: Final = 0.1
"""A specific force is known by its size, where it differs from gravity by no more than this part of it."""
_FASTEST_RADPS: Final = 5.0
"""A vehicle does not turn faster than this on the whole; a gyro that says so counts degrees."""


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

    def likely(self, quantity: str) -> list[Candidate]:
        """Give those that are named like a quantity, and have as many numbers as it."""
        words = _WORDS[quantity]
        return [
            candidate
            for candidate in self.candidates
            if words.search(candidate.path.lower())
            and not _NEVER.search(candidate.path.lower())
            and candidate.is_beams == quantity.startswith("beam")
        ]


def see_topics(log: Log, channels: Sequence[LogChannel]) -> list[SeenTopic]:
    """Look at the first messages of some topics for vectors and beams.

    Parameters
    ----------
    log : Log
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


def _see(log: Log, channel: LogChannel) -> SeenTopic:
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


def _first_values(log: Log, channel: LogChannel, path: str) -> Floats:
    paths = split_paths(path)
    reader = open_reader(channel, paths, f"{log.path}: {channel.topic}")
    parts = []
    for block in islice(log.blocks({channel.id}), _BLOCKS):
        columns = reader.columns(block)
        parts.append(np.concatenate([columns[part].astype(np.float64) for part in paths], axis=1))
    width = min((part.shape[1] for part in parts), default=0)
    return np.concatenate([part[:, :width] for part in parts]) if parts else np.empty((0, 0))


def propose_choice(role: str, topics: Sequence[str]) -> str:
    """Write the setting that chooses between topics that could each play a role.

    Parameters
    ----------
    role : str
    topics : sequence of str
        The first is proposed.

    Returns
    -------
    str
        TOML.
    """
    first, *others = (f'"{topic}"' for topic in topics)
    return f"[{role}]\ntopic = {first}  # or {', '.join(others)}\n"


def propose_fields(seen: Sequence[SeenTopic], roles: Collection[str]) -> list[str]:
    """Write settings to start from for roles that no topic of a known type plays.

    Parameters
    ----------
    seen : sequence of SeenTopic
        Topics that could.
    roles : collection of str
        ``imu``, ``dvl``.

    Returns
    -------
    list of str
        TOML for each role; what a person must decide is a comment.
    """
    imu = _imu_topic(seen) if "imu" in roles else None
    dvl = _dvl_topic([topic for topic in seen if topic is not imu])
    proposals = []
    if "imu" in roles and seen:
        proposals.append(["[imu]", *(_imu_lines(imu) if imu else _vector_lines(seen))])
    if "dvl" in roles and seen:
        proposals.append(["[dvl]", *(_dvl_lines(dvl) if dvl else _vector_lines(seen))])
    return ["\n".join(lines) + "\n" for lines in proposals]


def propose_start(lacks: Collection[str]) -> str:
    """Write the settings of the start that no reference gives.

    Parameters
    ----------
    lacks : collection of str
        Keys of the section ``initial``.

    Returns
    -------
    str
        TOML; empty where nothing lacks. What only a person can know is a comment.
    """
    lines = [line for key, line in _START_LINES.items() if key in lacks]
    return "\n".join(["[initial]", *lines]) + "\n" if lines else ""


_START_LINES: Final = {
    "source": 'source = "level"  # there is no reference to start from: roll and pitch come from gravity',
    "heading_deg": "# heading_deg =   # needed: at the start, from north over east",
    "latitude_deg": "# latitude_deg =  # needed: for gravity and Earth rate",
}


def _imu_topic(seen: Sequence[SeenTopic]) -> SeenTopic | None:
    """Choose a topic with a specific force and an angular rate; the size of gravity decides where several have."""
    both = [topic for topic in seen if topic.likely("specific_force") and topic.likely("angular_rate")]
    heavy = [topic for topic in both if _force_unit(topic.likely("specific_force")[0])]
    return next(iter([*heavy, *both]), None)


def _dvl_topic(seen: Sequence[SeenTopic]) -> SeenTopic | None:
    moving = [topic for topic in seen if topic.likely("velocity") or topic.likely("beam_velocity")]
    named = [topic for topic in moving if _DVL_WORDS.search(f"{topic.topic} {topic.type_name}".lower())]
    return next(iter([*named, *moving]), None)


def _imu_lines(topic: SeenTopic) -> Iterator[str]:
    force, rate = topic.likely("specific_force")[0], topic.likely("angular_rate")[0]
    unit, rate_unit = _force_unit(force), "deg/s" if rate.size > _FASTEST_RADPS else "rad/s"
    yield f'topic = "{topic.topic}"'
    yield from _path_lines(topic, "specific_force")
    if unit:
        yield f'specific_force_unit = "{unit}"'
    else:
        yield "# specific_force_unit =  # m/s2, g or mg; the size is none of 9.81, 1 and 1000"
    yield from _path_lines(topic, "angular_rate")
    yield f'angular_rate_unit = "{rate_unit}"  # rad/s or deg/s'
    yield _axes_line(force)
    yield from _stamp_lines(topic)


def _force_unit(force: Candidate) -> str:
    """Tell the unit by the size that gravity has in it."""
    for unit, factor in SPECIFIC_FORCE_UNITS.items():
        if abs(force.size * factor / GRAVITY_MPS2 - 1.0) < _GRAVITY_PART:
            return unit
    return ""


def _axes_line(force: Candidate) -> str:
    strongest = int(np.argmax(np.abs(force.median)))
    seen = f"gravity is felt along {'+' if force.median[strongest] > 0 else '-'}{'xyz'[strongest]}"
    if seen.endswith("-z"):
        return f'axes = "frd"  # {seen}, as forward-starboard-down has it'
    if seen.endswith("+z"):
        return f'axes = "flu"  # {seen}, as forward-port-up has it; or "-x-y-z", if all signs are turned'
    return f'# axes =  # {seen}; a level vehicle must feel it along -z, as with "+x-z+y"'


def _dvl_lines(topic: SeenTopic) -> Iterator[str]:
    beams, velocities = topic.likely("beam_velocity"), topic.likely("velocity")
    yield f'topic = "{topic.topic}"'
    if beams:
        yield from _path_lines(topic, "beam_velocity")
        yield from _path_lines(topic, "beam_valid")
        yield "# beam_tilt_deg = 30.0  # from the instrument's z axis"
        yield "# beam_azimuth_deg = [45, 135, 225, 315]  # from forward towards starboard"
    if velocities:
        yield from _path_lines(topic, "velocity")
        yield f'kind = "velocity"{"  # or beams, once their angles are known" if beams else ""}'
    yield '# velocity_unit = "m/s"  # or mm/s, cm/s'
    yield '# axes = "frd"  # or flu, or a signed permutation'
    yield "# lever_arm_m = [0.0, 0.0, 0.0]  # IMU to DVL, forward-starboard-down"
    yield "# mounting_rpy_deg = [0.0, 0.0, 0.0]  # DVL to body"
    yield from _stamp_lines(topic)


def _path_lines(topic: SeenTopic, quantity: str) -> Iterator[str]:
    """Propose the first field that is named like a quantity; the others stand below it."""
    for rank, candidate in enumerate(topic.likely(quantity)):
        yield f'{"# or " if rank else ""}{quantity} = "{candidate.path}"  # {candidate}'


def _stamp_lines(topic: SeenTopic) -> Iterator[str]:
    if not topic.has_header:
        yield 'stamp = "log_time"  # the messages have no header; a field path names another stamp'


def _vector_lines(seen: Sequence[SeenTopic]) -> Iterator[str]:
    """List every vector, where none is named like what is needed."""
    yield "# no field is named like what is needed; the vectors in the log are"
    for topic in seen:
        yield f'# topic = "{topic.topic}"'
        for candidate in topic.candidates:
            yield f'#   "{candidate.path}"  # {candidate}'
