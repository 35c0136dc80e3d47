"""What a solution of a user's filter must be, whether a class returns it or a program writes it."""

from typing import Any, Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats, Integers, TimeNs
from insdvl_replay.nav.user_candidate import CandidateError, Solution

NO_ROTATION: Final = 0.01  # largest error of C C^T
_SHAPES: Final = {
    "position": (3,), "velocity_n": (3,), "mat_nb": (3, 3), "cov": (9, 9),
    "innovation_b": (3,), "innovation_cov": (3, 3),
}  # fmt: skip
MOTION: Final = {"position": "positions", "velocity_n": "velocities", "mat_nb": "attitudes"}


def checked_solution(solution: Solution) -> Solution:
    """Require increasing times, and finite numbers of the right shapes; a `CandidateError` says what is wrong."""
    if np.ndim(solution.time_ns) != 1 or not len(solution.time_ns):
        raise _wrong("no row")
    time_ns = _increasing("times", solution.time_ns)
    cov_ns = None
    if solution.cov_ns is not None:
        cov_ns = _increasing("cov_ns", solution.cov_ns)
    columns: dict[str, Floats] = {}
    for name in _SHAPES:
        given = getattr(solution, name)
        if given is None:
            continue
        rows = len(time_ns)
        if name == "cov" and cov_ns is not None:
            rows = len(cov_ns)
        columns[name] = _checked_column(name, given, rows)
    if "mat_nb" in columns:
        _require_rotations(columns["mat_nb"])
    if not set(columns) & set(MOTION):
        raise _wrong("no position, no velocity and no attitude")
    if "innovation_b" in columns and "innovation_cov" not in columns:
        raise _wrong(
            "innovations without their covariance; in CSV these are innovation_x_mps_sd and so on"
        )
    return Solution(time_ns, cov_ns=cov_ns, **columns)


def _wrong(text: str) -> CandidateError:
    return CandidateError(f"gives a solution with {text}")


def _increasing(name: str, given: Any) -> TimeNs:
    times = np.asarray(given)
    if times.ndim == 1 and times.dtype.kind in "iu":
        whole = times.astype(np.int64)
        if np.all(np.diff(whole) > 0):
            return whole
    raise _wrong(f"{name} that are not increasing whole nanoseconds")


def _checked_column(name: str, given: Any, rows: int) -> Floats:
    """Return a column of `_SHAPES` as numbers; those of the motion must be finite, but for a height."""
    try:
        values = np.asarray(given, np.float64)
    except (TypeError, ValueError) as error:
        raise _wrong(f"{name} that is not an array of numbers") from error
    shape = (rows, *_SHAPES[name])
    if values.shape != shape:
        raise _wrong(f"{name} of shape {values.shape}, not {shape}")
    if name in MOTION:
        needed = values.reshape(rows, -1)
        if name == "position":
            needed = values[:, :2]
        bad = np.flatnonzero(~np.isfinite(needed).all(axis=1))
        if len(bad):
            raise _wrong(f"{MOTION[name]} that are not finite in {_rows(bad, rows)}")
    if name.endswith("cov") and np.any(np.diagonal(values, axis1=1, axis2=2) < 0.0):
        raise _wrong(f"{name} with negative variances")
    return values


def _require_rotations(mat_nb: Floats) -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(mat_nb @ np.swapaxes(mat_nb, 1, 2) - np.eye(3)).max(axis=(1, 2))
        bad = np.flatnonzero(~(off <= NO_ROTATION) | (np.linalg.det(mat_nb) < 0.0))
    if len(bad):
        raise _wrong(f"attitudes that are no rotations in {_rows(bad, len(mat_nb))}")


def _rows(bad: Integers, rows: int) -> str:
    return f"{len(bad)} of {rows} rows, the first is row {bad[0]}"
