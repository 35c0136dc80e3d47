"""TUM files, as evo and this program write them: a line for each time, with position and attitude.

Source: "File formats - ground-truth trajectories" of the TUM RGB-D benchmark: ``timestamp tx ty tz qx qy qz qw``,
seconds and metres, the quaternion from the body to the frame of the positions; lines that begin with # are comments.
"""

import hashlib
from decimal import Decimal
from pathlib import Path
from typing import Final

import numpy as np

from insdvl_replay.core.config import MOST_BYTES, Solution
from insdvl_replay.core.dive_columns import NS_PER_S, ReferenceColumns, SolutionColumns, TimeNs, is_new
from insdvl_replay.core.errors import LogError, Note, read_regular
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import MAT_ENU_NED, MAT_FRD_FLU
from insdvl_replay.geometry.rotation import mat_from_quat
from insdvl_replay.logs.columns.solutions import no_covariances

_COLUMNS: Final = 8
_FORMAT: Final = "time x y z qx qy qz qw: seconds on the log's clock, m, and the attitude"
_LATEST: Final = Decimal(2**63) / NS_PER_S


def read_tum(path: Path, settings: Solution, role: str) -> tuple[SolutionColumns, list[Note]]:
    """Read a solution from a file.

    Parameters
    ----------
    role : str
        Its section of the settings.

    Raises
    ------
    LogError
        It cannot be read, is not the file that the settings mean, or a line of it holds other than eight numbers.
    """
    try:
        content = read_regular(path, MOST_BYTES)
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}", f"{role}.file names it", path) from error
    sha256 = hashlib.sha256(content).hexdigest()
    if settings.sha256 not in (None, sha256):
        raise LogError(f"has changed since the settings were read: its SHA-256 is {sha256}", "run again", path)
    time_ns, numbers = _lines(path, content.decode("utf-8", "replace"))
    notes = list(_order_notes(role, time_ns))
    order = np.argsort(time_ns, kind="stable")
    rows = order[is_new(time_ns[order])]
    way, mat = numbers[rows, :3], mat_from_quat(numbers[rows, 3:])
    if settings.axes != "ned_frd":
        way, mat = way @ MAT_ENU_NED, np.asarray(MAT_ENU_NED @ mat @ MAT_FRD_FLU)
    nothing = np.full_like(way, np.nan)
    latency_ns = round(settings.latency_s * NS_PER_S)
    motion = ReferenceColumns(time_ns[rows] - latency_ns, nothing, nothing.copy(), mat)
    return SolutionColumns(motion, way, *no_covariances()), notes


def _lines(path: Path, text: str) -> tuple[TimeNs, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    """Return the times, shape (k,), and the other seven numbers, shape (k, 7); "nan" where one is missing."""
    times, rows = [], []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            time_s, *others = (Decimal(words[0]), *map(float, words[1:]))
            if len(words) != _COLUMNS or not (time_s.is_finite() and abs(time_s) < _LATEST):
                raise ValueError
        except (ArithmeticError, ValueError) as error:  # of what is in it nothing is shown: it may be any file
            raise LogError(f"line {number} is no pose: it needs {_COLUMNS} numbers", _FORMAT, path) from error
        times.append(round(time_s * NS_PER_S))
        rows.append(others)
    if not rows:
        raise LogError("has no line with a pose", _FORMAT, path)
    values = np.array(rows, np.float64)
    if not np.isfinite(values).any():
        raise LogError(f"has no number in any of its {len(rows)} poses", _FORMAT, path)
    return np.array(times, np.int64), np.where(np.isfinite(values), values, np.nan)


def _order_notes(role: str, time_ns: TimeNs) -> list[Note]:
    steps_ns, notes = np.diff(time_ns), []
    if back := int(np.count_nonzero(steps_ns < 0)):
        text = f"{role}: {back} lines have a time before that of the line above; sorted"
        hint = "a file of one run has rising times; two of them in one file are two solutions"
        notes.append(Note("solution_out_of_order", text, back, Severity.WARNING, hint))
    if repeats := len(time_ns) - len(np.unique(time_ns)):
        text = f"{role}: {repeats} lines repeat the time of another; of each time the first is taken"
        notes.append(Note("solution_repeats", text, repeats))
    return notes
