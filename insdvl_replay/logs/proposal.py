"""Settings to start from, for a log whose topics nobody has told the tool about.

Names of fields say what could be what; the size of the numbers says in which unit. What is proposed stands beside what
was seen, so that a person can judge it.
"""

import re
from collections.abc import Collection, Iterator, Sequence
from typing import Final

import numpy as np

from insdvl_replay.logs.sightings import Candidate, SeenTopic

_DVL_WORDS: Final = re.compile(r"dvl|doppler|bottom")
_FASTEST_RADPS: Final = 5.0
"""A vehicle does not turn faster than this on the whole; a gyro that says so counts degrees."""
_START_LINES: Final = {
    "source": 'source = "level"  # there is no reference to start from: roll and pitch come from gravity',
    "heading_deg": "# heading_deg =   # needed: at the start, from north over east",
    "latitude_deg": "# latitude_deg =  # needed: for gravity and Earth rate",
}


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


def _imu_topic(seen: Sequence[SeenTopic]) -> SeenTopic | None:
    """Choose a topic with a specific force; an angular rate beside it and the size of gravity speak for it."""
    felt = [topic for topic in seen if topic.forces]
    return max(felt, key=lambda topic: (bool(topic.rates), bool(topic.forces[0].force_unit)), default=None)


def _dvl_topic(seen: Sequence[SeenTopic]) -> SeenTopic | None:
    moving = [topic for topic in seen if topic.likely("velocity") or topic.likely("beam_velocity")]
    named = [topic for topic in moving if _DVL_WORDS.search(f"{topic.topic} {topic.type_name}".lower())]
    return next(iter([*named, *moving]), None)


def _imu_lines(topic: SeenTopic) -> Iterator[str]:
    force, rates = topic.forces[0], topic.rates
    yield f'topic = "{topic.topic}"'
    yield from _path_lines("specific_force", topic.forces)
    if force.force_unit:
        yield f'specific_force_unit = "{force.force_unit}"'
    else:
        yield "# specific_force_unit =  # m/s2, g or mg; the size is none of 9.81, 1 and 1000"
    if rates:
        yield from _path_lines("angular_rate", rates)
        yield f'angular_rate_unit = "{"deg/s" if rates[0].size > _FASTEST_RADPS else "rad/s"}"  # rad/s or deg/s'
    else:
        for candidate in topic.candidates:
            if candidate not in topic.forces:
                yield f'# angular_rate = "{candidate.path}"  # {candidate}'
        yield '# angular_rate_unit = "rad/s"  # or deg/s'
    yield _axes_line(force)
    yield from _stamp_lines(topic)


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
        yield from _path_lines("beam_velocity", beams)
        yield from _path_lines("beam_valid", topic.likely("beam_valid"))
        yield "# beam_tilt_deg = 30.0  # from the instrument's z axis"
        yield "# beam_azimuth_deg = [45, 135, 225, 315]  # from forward towards starboard"
    if velocities:
        yield from _path_lines("velocity", velocities)
        yield f'kind = "velocity"{"  # or beams, once their angles are known" if beams else ""}'
    yield '# velocity_unit = "m/s"  # or mm/s, cm/s'
    yield '# axes = "frd"  # or flu, or a signed permutation'
    yield "# lever_arm_m = [0.0, 0.0, 0.0]  # IMU to DVL, forward-starboard-down"
    yield "# mounting_rpy_deg = [0.0, 0.0, 0.0]  # DVL to body"
    yield from _stamp_lines(topic)


def _path_lines(quantity: str, candidates: Sequence[Candidate]) -> Iterator[str]:
    """Propose the first of several fields; the others stand below it."""
    for rank, candidate in enumerate(candidates):
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
