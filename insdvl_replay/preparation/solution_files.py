"""Files of solutions: what a program writes as CSV, MCAP or TUM, and a class that is run as a program as npz.

The first bytes of a file determine its format, not its name.
"""

import io
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NoReturn

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

MOST_COVARIANCES: Final = 20_000  # of one solution, evenly chosen
NO_ROTATION: Final = 0.01  # largest error of C C^T
SAME_TIME_NS: Final = NS_PER_S  # from the start within which a solution begins there
LONGEST_LINE: Final = 200  # letters of what others wrote in a message
VELOCITY: Final = ("velocity_n_mps", "velocity_e_mps", "velocity_d_mps")
ATTITUDE: Final = ("roll_deg", "pitch_deg", "heading_deg")
POSITION: Final = ("latitude_deg", "longitude_deg", "height_m")
INNOVATION: Final = ("innovation_x_mps", "innovation_y_mps", "innovation_z_mps")
_GROUPS: Final = (POSITION, VELOCITY, ATTITUDE, INNOVATION)
_COLUMNS: Final = (
    "time_ns",
    *(f"{name}{end}" for group in _GROUPS for name in group for end in ("", "_sd")),
)
_SHAPES: Final = {
    "position": (3,), "velocity_n": (3,), "mat_nb": (3, 3), "cov": (9, 9),
    "innovation_b": (3,), "innovation_cov": (3, 3),
}  # fmt: skip
MOTION: Final = {"position": "positions", "velocity_n": "velocities", "mat_nb": "attitudes"}


def checked_solution(solution: Solution) -> Solution:
    """Require increasing times, and finite numbers of the right shapes; a `CandidateError` says what is wrong."""

    def wrong(text: str) -> NoReturn:
        raise CandidateError(f"gives a solution with {text}")

    def increasing(name: str, given: Any) -> TimeNs:
        times = np.asarray(given)
        whole = times.astype(np.int64) if times.dtype.kind in "iu" else None
        if times.ndim != 1 or whole is None or np.any(np.diff(whole) <= 0):
            wrong(f"{name} that are not increasing whole nanoseconds")
        return whole

    if np.ndim(solution.time_ns) != 1 or not len(solution.time_ns):
        wrong("no row")
    time_ns = increasing("times", solution.time_ns)
    cov_ns = None if solution.cov_ns is None else increasing("cov_ns", solution.cov_ns)
    columns = dict[str, Any]()
    for name, shape in _SHAPES.items():
        if (given := getattr(solution, name)) is None:
            continue
        try:
            values = columns[name] = np.asarray(given, np.float64)
        except (TypeError, ValueError):
            wrong(f"{name} that is not an array of numbers")
        count = len(cov_ns) if name == "cov" and cov_ns is not None else len(time_ns)
        if values.shape != (count, *shape):
            wrong(f"{name} of shape {values.shape}, not {(count, *shape)}")
        needed = (
            values[:, :2] if name == "position" else values.reshape(count, -1)
        )  # a position may lack its height
        bad = np.flatnonzero(~np.isfinite(needed).all(axis=1))
        if name in MOTION and len(bad):
            wrong(
                f"{MOTION[name]} that are not finite in {len(bad)} of {len(time_ns)} rows, the first is row {bad[0]}"
            )
        if name.endswith("cov") and np.any(np.diagonal(values, axis1=1, axis2=2) < 0.0):
            wrong(f"{name} with negative variances")
    if (mat_nb := columns.get("mat_nb")) is not None:
        with np.errstate(over="ignore", invalid="ignore"):
            off = np.abs(mat_nb @ np.swapaxes(mat_nb, 1, 2) - np.eye(3)).max(axis=(1, 2))
            bad = np.flatnonzero(~(off <= NO_ROTATION) | (np.linalg.det(mat_nb) < 0.0))
        if len(bad):
            wrong(
                f"attitudes that are no rotations in {len(bad)} of {len(time_ns)} rows, the first is row {bad[0]}"
            )
    if not set(columns) & set(MOTION):
        wrong("no position, no velocity and no attitude")
    if "innovation_b" in columns and "innovation_cov" not in columns:
        wrong(
            "innovations without their covariance; in CSV these are innovation_x_mps_sd and so on"
        )
    return Solution(time_ns, cov_ns=cov_ns, **columns)


def read_solution(path: Path, start: CandidateStart) -> Solution:
    """Read the solution of a program; a `CandidateError` says why it cannot be used."""
    try:
        data = read_regular(path, MOST_BYTES)
    except OSError as error:
        text = (
            "wrote no solution"
            if isinstance(error, FileNotFoundError)
            else f"wrote a solution: {error.strerror}"
        )
        raise CandidateError(text) from error
    if not data.strip():
        raise CandidateError("wrote an empty solution")
    if data.startswith(b"PK"):
        try:
            with np.load(io.BytesIO(data)) as columns:
                return checked_solution(Solution(**columns))
        except (
            TypeError, ValueError, KeyError, EOFError, OSError, NotImplementedError, zipfile.BadZipFile, zlib.error,
        ) as error:  # fmt: skip
            raise CandidateError(
                f"wrote a solution that is not of run_as_program: {error}"
            ) from error
    if not data.startswith(MAGIC) and data.lstrip()[:1] not in b"#+-.0123456789":
        return checked_solution(_read_csv(data))
    try:
        read, notes = read_solution_of_log(path)
    except LogError as error:
        raise CandidateError(
            f"wrote a solution that cannot be read: {visible(error.inside(path))}"
        ) from error
    if wrong := next((note for note in notes if note.severity == Severity.WARNING), None):
        raise CandidateError(f"wrote a solution that cannot be used: {visible(wrong.text)}")
    motion = read.motion
    position = read.motion.position
    if read.moved_n is not None:
        # From the start; a solution that begins there may have an origin of its own.
        first = int(np.argmax(np.isfinite(read.moved_n).all(axis=1)))
        begins = abs(int(motion.time_ns[first]) - start.time_ns) <= SAME_TIME_NS
        from_start = read.moved_n - (read.moved_n[first] if begins else 0.0)
        position = moved_position(np.broadcast_to(start.position, from_start.shape), from_start)
    cov_ns = read.cov_ns if np.isfinite(read.cov).any() else None
    given = position, motion.velocity_n, motion.mat_nb, read.cov
    placed, velocity_n, mat_nb, cov = (
        values if np.isfinite(values).any() else None for values in given
    )
    return Solution(motion.time_ns, placed, velocity_n, mat_nb, cov, cov_ns)


def _read_csv(data: bytes) -> Solution:
    """Read a solution as CSV; columns may be missing."""
    import pandas as pd  # heavy

    numbers = dict.fromkeys(_COLUMNS[1:], "f8")
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
    unknown = next((name for name in map(str, table.columns) if name not in _COLUMNS), None)
    if unknown is not None:
        name = visible(unknown)[:LONGEST_LINE]
        hint = hint_for(unknown, _COLUMNS, most=1)
        raise CandidateError(
            f"wrote a solution with the column '{name}', which is not known ({hint})"
        )
    if "time_ns" not in table:
        raise CandidateError("wrote a solution without the column time_ns")
    if table["time_ns"].dtype.kind != "i":
        raise CandidateError("wrote a solution with times that are not whole nanoseconds")
    if not data.endswith(b"\n") and table.iloc[-1].isna().any():
        raise CandidateError(f"wrote a solution that is cut off in line {len(table) + 1}")

    def group(names: tuple[str, ...], end: str = "") -> Floats | None:
        """Return the columns of a quantity; None where they are missing."""
        wanted = [f"{name}{end}" for name in names]
        lacking = [name for name in wanted if name not in table]
        if names == POSITION and lacking == wanted[2:]:
            table[wanted[2]], lacking = np.nan, []
        if lacking and len(lacking) < len(wanted):
            given = next(name for name in wanted if name in table)
            raise CandidateError(
                f"wrote a solution with {given}, but without {' and '.join(lacking)}"
            )
        if lacking:
            return None
        return table[wanted].to_numpy(np.float64)

    time_ns = table["time_ns"].to_numpy(np.int64)
    position = group(POSITION)
    rpy = group(ATTITUDE)
    if position is not None:
        position = position * [DEG, DEG, 1.0]
    # Covariances at evenly chosen rows. The blocks that are not given are NaN.
    chosen = slice(None, None, 1 + len(table) // MOST_COVARIANCES)
    cov = np.zeros((len(time_ns[chosen]), 9, 9))
    for block, names in enumerate((VELOCITY, ATTITUDE, POSITION)):
        rows = slice(3 * block, 3 * block + 3)
        sd = group(names, "_sd")
        if sd is None:
            cov[:, rows] = cov[:, :, rows] = np.nan
            continue
        sd = sd[chosen]
        if names == ATTITUDE:
            cov[:, rows, rows] = misalignment_cov(
                sd * DEG, np.zeros(len(sd)) if rpy is None else rpy[chosen, 2] * DEG
            )
            continue
        if names == POSITION:
            here = np.zeros(3) if position is None else np.nan_to_num(position[chosen])
            sd = np.abs(north_east_down_m(here + sd * [DEG, DEG, 1.0], here))
        cov[:, rows, rows] = sd[:, :, None] ** 2 * np.eye(3)
    innovation = group(INNOVATION)
    innovation_sd = group(INNOVATION, "_sd")
    has_cov = bool(np.isfinite(cov).any())
    return Solution(
        time_ns,
        position,
        group(VELOCITY),
        None if rpy is None else mat_from_rpy(rpy * DEG),
        cov if has_cov else None,
        time_ns[chosen] if has_cov else None,
        innovation,
        None if innovation_sd is None else innovation_sd[:, :, None] ** 2 * np.eye(3),
    )
