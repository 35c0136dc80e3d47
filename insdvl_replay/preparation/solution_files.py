"""Files of solutions: what a program writes as CSV, MCAP or TUM, and a class that is run as a program as npz.

The first bytes of a file determine its format, not its name.
"""

import io
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from insdvl_replay.core.config import MOST_BYTES
from insdvl_replay.core.dive_columns import NS_PER_S, Floats, TimeNs
from insdvl_replay.core.errors import LogError, hint_for, read_regular, visible
from insdvl_replay.core.states import DEG
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import moved_position, north_east_down_m
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.logs import MAGIC
from insdvl_replay.logs import read_solution as read_solution_of_log
from insdvl_replay.nav.user_candidate import (
    CandidateError,
    CandidateStart,
    Solution,
    misalignment_cov,
)
from insdvl_replay.preparation.solution_check import checked_solution

if TYPE_CHECKING:
    import pandas as pd  # heavy

MOST_COVARIANCES: Final = 20_000  # of one solution, evenly chosen
SAME_TIME_NS: Final = NS_PER_S  # from the start within which a solution begins there
LONGEST_LINE: Final = 200  # letters of what others wrote in a message
VELOCITY: Final = ("velocity_n_mps", "velocity_e_mps", "velocity_d_mps")
ATTITUDE: Final = ("roll_deg", "pitch_deg", "heading_deg")
POSITION: Final = ("latitude_deg", "longitude_deg", "height_m")
INNOVATION: Final = ("innovation_x_mps", "innovation_y_mps", "innovation_z_mps")
_QUANTITIES: Final = (*POSITION, *VELOCITY, *ATTITUDE, *INNOVATION)
_NUMBERS: Final = (*_QUANTITIES, *(f"{name}_sd" for name in _QUANTITIES))
_COLUMNS: Final = ("time_ns", *_NUMBERS)
# Rows of a covariance.
VELOCITY_BLOCK: Final = slice(0, 3)
ATTITUDE_BLOCK: Final = slice(3, 6)
POSITION_BLOCK: Final = slice(6, 9)


def read_solution(path: Path, start: CandidateStart) -> Solution:
    """Read the solution of a program; a `CandidateError` says why it cannot be used."""
    try:
        data = read_regular(path, MOST_BYTES)
    except FileNotFoundError as error:
        raise CandidateError("wrote no solution") from error
    except OSError as error:
        raise CandidateError(f"wrote a solution: {error.strerror}") from error
    if not data.strip():
        raise CandidateError("wrote an empty solution")
    if data.startswith(b"PK"):
        return _read_npz(data)
    if not data.startswith(MAGIC) and data.lstrip()[:1] not in b"#+-.0123456789":
        return checked_solution(_read_csv(data))
    return _read_log(path, start)


def _read_npz(data: bytes) -> Solution:
    """Read and check the solution of a class that was run as a program."""
    try:
        with np.load(io.BytesIO(data)) as columns:
            return checked_solution(Solution(**columns))
    except (
        TypeError, ValueError, KeyError, EOFError, OSError, NotImplementedError, zipfile.BadZipFile, zlib.error,
    ) as error:  # fmt: skip
        raise CandidateError(f"wrote a solution that is not of run_as_program: {error}") from error


# --- MCAP and TUM.


def _read_log(path: Path, start: CandidateStart) -> Solution:
    """Read a solution as MCAP or TUM; positions from an unknown origin are those from the start."""
    try:
        read, notes = read_solution_of_log(path)
    except LogError as error:
        raise CandidateError(
            f"wrote a solution that cannot be read: {visible(error.inside(path))}"
        ) from error
    for note in notes:
        if note.severity == Severity.WARNING:
            raise CandidateError(f"wrote a solution that cannot be used: {visible(note.text)}")
    motion = read.motion
    position = motion.position
    if read.moved_n is not None:
        position = _from_start(motion.time_ns, read.moved_n, start)
    cov = _if_any(read.cov)
    return Solution(
        time_ns=motion.time_ns,
        position=_if_any(position),
        velocity_n=_if_any(motion.velocity_n),
        mat_nb=_if_any(motion.mat_nb),
        cov=cov,
        cov_ns=None if cov is None else read.cov_ns,
    )


def _from_start(time_ns: TimeNs, moved_n: Floats, start: CandidateStart) -> Floats:
    """Return the positions of movements from the start; those that begin there may have an origin of their own."""
    first = int(np.argmax(np.isfinite(moved_n).all(axis=1)))
    begins_there = abs(int(time_ns[first]) - start.time_ns) <= SAME_TIME_NS
    if begins_there:
        moved_n = moved_n - moved_n[first]
    return moved_position(np.broadcast_to(start.position, moved_n.shape), moved_n)


def _if_any(values: Floats) -> Floats | None:
    """Return values; None if there is no number among them."""
    if np.isfinite(values).any():
        return values
    return None


# --- CSV.


def _read_csv(data: bytes) -> Solution:
    """Read a solution as CSV; columns may be missing."""
    table = _table_of(data)
    time_ns = table["time_ns"].to_numpy(np.int64)
    position = _columns(table, POSITION)
    if position is not None:
        position = position * [DEG, DEG, 1.0]
    rpy = _columns(table, ATTITUDE)
    mat_nb = None
    if rpy is not None:
        rpy = rpy * DEG
        mat_nb = mat_from_rpy(rpy)
    chosen = slice(None, None, 1 + len(table) // MOST_COVARIANCES)
    cov = _if_any(_csv_cov(table, position, rpy, chosen))
    innovation_b = _columns(table, INNOVATION)
    innovation_sd = _columns(table, INNOVATION, "_sd")
    innovation_cov = None
    if innovation_sd is not None:
        innovation_cov = _diagonal(innovation_sd)
    return Solution(
        time_ns=time_ns,
        position=position,
        velocity_n=_columns(table, VELOCITY),
        mat_nb=mat_nb,
        cov=cov,
        cov_ns=None if cov is None else time_ns[chosen],
        innovation_b=innovation_b,
        innovation_cov=innovation_cov,
    )


def _table_of(data: bytes) -> "pd.DataFrame":
    """Read a table of CSV whose columns are known and whose last line is whole."""
    import pandas as pd  # heavy

    numbers = dict.fromkeys(_NUMBERS, "f8")
    try:
        table = pd.read_csv(io.BytesIO(data), dtype=numbers)
    except (ValueError, OverflowError) as error:  # pandas' own errors are ValueErrors
        why = visible(str(error))[:LONGEST_LINE]
        whole_lines, _, rest = data.rpartition(b"\n")
        if rest:  # a number may end within its exponent
            with suppress(ValueError, OverflowError):
                lines = 1 + len(pd.read_csv(io.BytesIO(whole_lines), dtype=numbers))
                raise CandidateError(
                    f"wrote a solution that is cut off in line {lines + 1}"
                ) from error
        raise CandidateError(f"wrote a solution that is not CSV of numbers: {why}") from error
    if not isinstance(table.index, pd.RangeIndex):
        raise CandidateError(
            "wrote a solution whose rows are longer than its header: are there decimal commas?"
        )
    if table.empty:
        raise CandidateError("wrote a solution without rows")
    for name in map(str, table.columns):
        if name not in _COLUMNS:
            shown = visible(name)[:LONGEST_LINE]
            hint = hint_for(name, _COLUMNS, most=1)
            raise CandidateError(
                f"wrote a solution with the column '{shown}', which is not known ({hint})"
            )
    if "time_ns" not in table:
        raise CandidateError("wrote a solution without the column time_ns")
    if table["time_ns"].dtype.kind != "i":
        raise CandidateError("wrote a solution with times that are not whole nanoseconds")
    if not data.endswith(b"\n") and table.iloc[-1].isna().any():
        raise CandidateError(f"wrote a solution that is cut off in line {len(table) + 1}")
    return table


def _columns(table: "pd.DataFrame", names: tuple[str, ...], end: str = "") -> Floats | None:
    """Return the columns of a quantity, shape (k, 3); None where they are missing. A height may be missing alone."""
    wanted = [f"{name}{end}" for name in names]
    lacking = [name for name in wanted if name not in table]
    if lacking == wanted:
        return None
    if names == POSITION and lacking == wanted[2:]:
        horizontal = table[wanted[:2]].to_numpy(np.float64)
        return np.column_stack([horizontal, np.full(len(table), np.nan)])
    if lacking:
        given = [name for name in wanted if name in table]
        raise CandidateError(
            f"wrote a solution with {given[0]}, but without {' and '.join(lacking)}"
        )
    return table[wanted].to_numpy(np.float64)


def _csv_cov(
    table: "pd.DataFrame",
    position: Floats | None,  # rad, rad, m
    rpy: Floats | None,  # rad
    chosen: slice,
) -> Floats:
    """Return covariances of velocity, misalignment and position at chosen rows; blocks that are not given are NaN."""
    rows = len(table.iloc[chosen])
    cov = np.zeros((rows, 9, 9))
    velocity_sd = _columns(table, VELOCITY, "_sd")
    if velocity_sd is None:
        _leave_out(cov, VELOCITY_BLOCK)
    else:
        cov[:, VELOCITY_BLOCK, VELOCITY_BLOCK] = _diagonal(velocity_sd[chosen])
    attitude_sd = _columns(table, ATTITUDE, "_sd")
    if attitude_sd is None:
        _leave_out(cov, ATTITUDE_BLOCK)
    else:
        heading = np.zeros(rows)
        if rpy is not None:
            heading = rpy[chosen, 2]
        cov[:, ATTITUDE_BLOCK, ATTITUDE_BLOCK] = misalignment_cov(
            attitude_sd[chosen] * DEG, heading
        )
    position_sd = _columns(table, POSITION, "_sd")
    if position_sd is None:
        _leave_out(cov, POSITION_BLOCK)
    else:
        here = np.zeros(3)
        if position is not None:
            here = np.nan_to_num(position[chosen])
        sd_m = np.abs(north_east_down_m(here + position_sd[chosen] * [DEG, DEG, 1.0], here))
        cov[:, POSITION_BLOCK, POSITION_BLOCK] = _diagonal(sd_m)
    return cov


def _leave_out(cov: Floats, block: slice) -> None:
    cov[:, block] = np.nan
    cov[:, :, block] = np.nan


def _diagonal(sd: Floats) -> Floats:
    """Return covariances, shape (k, 3, 3), of components with these standard deviations, shape (k, 3)."""
    return np.asarray(sd[:, :, None] ** 2 * np.eye(3))
