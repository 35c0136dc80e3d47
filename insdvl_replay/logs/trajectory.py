"""A trajectory from a file of any kind: TUM, a table whose columns are named, or a topic of a log or bag.

It is read as the onboard solution of a vehicle is, by the same columns, units and clocks.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np

from insdvl_replay.core.config import Solution
from insdvl_replay.core.dive_columns import Floats, Integers, SolutionColumns
from insdvl_replay.core.dive_record import TABLE_SUFFIXES
from insdvl_replay.core.errors import LogError, Note, listed
from insdvl_replay.core.notes import note
from insdvl_replay.core.states import DEG, DV, PHI
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.logs.columns.named_columns import NamedColumns, trajectory_columns
from insdvl_replay.logs.columns.reference import (
    DP,
    decode_solution,
    length_notes,
    no_covariances,
    read_tum,
)
from insdvl_replay.logs.columns.tables import MOST_SAMPLED, Table, read_tables
from insdvl_replay.logs.columns.topics import Source, TopicRole, Topics, role_with
from insdvl_replay.logs.formats.fields import TABLE, split_paths
from insdvl_replay.logs.formats.readers import channel_paths
from insdvl_replay.logs.formats.recording import Recording, open_recording

Axes = Literal["ned_frd", "enu_flu"]
AXES: Final[tuple[Axes, ...]] = get_args(Axes)
ROLE: Final = "trajectory"
_TUM_NUMBERS: Final = 8
_LONGEST_LINE: Final = 1 << 12
_LINES: Final = 100  # comments in front of the first pose, at most
_FULL_CIRCLE: Final = 6.3  # no angle in radians is larger
_ANGLES: Final = ("latitude", "longitude", "roll", "pitch", "heading")
_SD: Final = "_sd"  # ends the name of a quantity that is a standard deviation of another
# Types of messages that are a trajectory; a type of an earlier group is the better source.
_GROUPS: Final = ("nav_solution", "odometry", "poses", "onboard", "fix", "extended_fix", "flown")
_NAMES: Final = (
    "columns such as x, y, z, qx, qy, qz, qw, or latitude, longitude, height, roll, pitch, "
    "heading, behind one of the time; or TUM: time x y z qx qy qz qw"
)


def read_trajectory(
    path: Path, topic: str = "", axes: Axes | None = None
) -> tuple[SolutionColumns, list[Note]]:
    """Read a trajectory from a TUM file, a table, or a topic of a log or a bag.

    A `LogError` where the file cannot be read, has several topics that could be meant, or has no position, velocity or
    attitude.
    """
    settings = Solution(axes=axes)
    if is_tum(path):
        if topic:
            raise LogError(f"is a TUM file, which has no topic {topic}", f"name {path}", path)
        return read_tum(path, settings, ROLE)
    log = open_recording(path)
    source, columns = _source_of(log, topic)
    with log.watched():
        [table] = read_tables(log, [source])
        log.check_unopened()
    if columns.is_ned and axes is None:
        settings = Solution(axes="ned_frd")
    found, notes = decode_solution([table], settings)
    notes = [*log.notes, *notes, *_unit_notes(table)]
    if "quaternion" in table:
        notes += length_notes(table.values("quaternion", 4))
    if columns.sds:
        found = _with_deviations(found, table)
    return found, notes


def is_tum(path: Path) -> bool:
    """Return whether the first line that is no comment holds eight numbers, and the file is not named as a table."""
    if path.is_dir() or path.suffix.lower() in TABLE_SUFFIXES:
        return False
    if path.suffix.lower() == ".tum":
        return True
    try:
        if not path.is_file():
            return False  # a pipe would be waited for
        with path.open("rb") as file:
            lines = list(islice(iter(lambda: file.readline(_LONGEST_LINE), b""), _LINES))
    except OSError:
        return False
    for line in lines:
        words = line.replace(b",", b" ").split()
        if words and not words[0].startswith(b"#"):
            return len(words) == _TUM_NUMBERS and all(map(_is_number, words))
    return path.suffix.lower() == ".txt"


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _source_of(log: Recording, topic: str) -> tuple[Source, NamedColumns]:
    """Return the topic of a trajectory, and the columns of a table whose names are known."""
    place = str(log.path)
    topics = Topics(place, log.channels)
    role = replace(role_with("solution", Solution()), name=ROLE, key=ROLE, groups=_GROUPS)
    tables = [
        channel for channel in log.channels if channel.encoding == TABLE and channel.messages
    ]
    named: dict[str, NamedColumns] = {}
    for channel in tables:
        columns = trajectory_columns(channel_paths(channel))
        if columns.fields:
            named[channel.topic] = columns
    candidates = topics.candidates(role, ()) or list(named)
    if topic:
        candidates = [topic]
    if len(candidates) > 1:
        text = f"has several trajectories: {listed(candidates)}"
        raise LogError(text, f"name one: {place}:{candidates[0]}", place)
    if not candidates:
        seen = listed(sorted({channel.topic for channel in log.channels}))
        if len(tables) == 1:
            seen = listed(channel_paths(tables[0]))
        text = f"has no trajectory; it has {seen or 'no messages'}"
        raise LogError(text, _NAMES, place)
    [chosen] = candidates
    columns = named.get(chosen, NamedColumns({}))
    paths = {**columns.fields, **{f"{name}{_SD}": path for name, path in columns.sds.items()}}
    chosen_role: TopicRole = replace(role, topic=chosen, paths=paths)
    try:
        return topics.source(chosen_role, chosen), columns
    except LogError as error:
        raise LogError(error.what, error.hint, place, *error.where) from error


def _unit_notes(table: Table) -> list[Note]:
    """Note angles of a table without a unit that may be radians."""
    if table.source.channels[0].encoding != TABLE:
        return []
    known = table.source.channels[0].metadata
    angles = [name for name in _ANGLES if name in table.source.fields]
    unnamed = [
        name for name in angles if known.get(table.source.fields[name]) not in ("deg", "rad")
    ]
    if not unnamed:
        return []
    largest = max(float(np.nanmax(np.abs(table.column(name)), initial=0.0)) for name in unnamed)
    if largest > _FULL_CIRCLE:
        return []
    return [note("trajectory_angle_unit", names=", ".join(unnamed), largest=largest)]


# --- Standard deviations in columns of their own.


def _with_deviations(found: SolutionColumns, table: Table) -> SolutionColumns:
    """Return a solution with covariances by the standard deviations of a table, evenly chosen."""
    motion = found.motion
    _, first = np.unique(table.time_ns(), return_index=True)
    rows = np.intersect1d(np.sort(first), np.arange(len(table)))
    if len(rows) != len(motion.time_ns):
        at = np.isin(table.time_ns()[rows], motion.time_ns)
        rows = rows[at]
    every = max(1, -(-len(rows) // MOST_SAMPLED))
    chosen = rows[::every]
    cov_ns = table.time_ns()[chosen]
    kept = np.searchsorted(motion.time_ns, cov_ns)
    _, blank = no_covariances()
    cov = np.full((len(chosen), *blank.shape[1:]), np.nan)
    position_sd = _position_sd(table, chosen, motion.position[kept])
    velocity_sd = _numbers(table, ["velocity_n"], chosen)
    attitude_sd = _numbers(table, ["roll", "pitch", "heading"], chosen)
    for block, sd in ((DP, position_sd), (DV, velocity_sd)):
        if sd is not None:
            cov[:, block, block] = sd[:, :, None] ** 2 * np.eye(3)
    if attitude_sd is not None:
        heading = np.nan_to_num(rpy_from_mat(motion.mat_nb[kept])[:, 2])
        level = mat_from_rpy(np.column_stack([np.zeros((len(heading), 2)), heading]))
        variance = (attitude_sd * DEG)[:, None, :] ** 2
        cov[:, PHI, PHI] = (level * variance) @ np.swapaxes(level, 1, 2)
    return replace(found, cov_ns=cov_ns, cov=cov)


def _numbers(table: Table, quantities: Sequence[str], rows: Integers) -> Floats | None:
    """Return standard deviations of some rows, shape (k, 3); None where they are not given."""
    names = [f"{quantity}{_SD}" for quantity in quantities]
    if not all(name in table.source.fields for name in names):
        return None
    values = np.concatenate([table.values(name) for name in names], axis=1)
    return np.asarray(values[rows])


def _position_sd(table: Table, rows: Integers, position: Floats) -> Floats | None:
    """Return standard deviations of positions, m, shape (k, 3), north, east, down."""
    local = _numbers(table, ["local_position"], rows)
    if local is not None:
        paths = split_paths(table.source.fields["local_position"])
        is_enu = paths[0].endswith("x")
        return local[:, [1, 0, 2]] if is_enu else local
    geographic = _numbers(table, ["latitude", "longitude", "height"], rows)
    if geographic is None:
        return None
    here = np.nan_to_num(position)
    return np.abs(north_east_down_m(here + geographic * [DEG, DEG, 1.0], here))
