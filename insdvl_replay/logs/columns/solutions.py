"""Solutions of the vehicle's own, read as a reference is, with what they say of their errors.

Sources: the definitions of nav_msgs/Odometry (the pose in its own frame, the twist in that of the child) and of
geometry_msgs/PoseWithCovariance (x, y, z, then rotations about these fixed axes, row by row).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from insdvl_replay.core.config import Initial, Solution
from insdvl_replay.core.dive_columns import Floats, SolutionColumns, TimeNs
from insdvl_replay.core.errors import Note
from insdvl_replay.core.states import DV, PHI
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import MAT_ENU_NED, MAT_FRD_FLU
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.logs.columns.reference import Part, local_way_n, read_part, union
from insdvl_replay.logs.columns.tables import Table

SIZE: Final = 9
"""Velocity error, misalignment and position error."""
DP: Final = slice(6, 9)
LARGEST: Final = 1e30
"""Nobody is less sure than this; powers of what is larger are no numbers."""
_ROLE: Final = ("filters.", ".solution")


def solution_role(name: str) -> str:
    """Return the role of the topics of a filter's solution: its section in the settings."""
    return name.join(_ROLE)


def solution_name(role: str) -> str | None:
    """Return which filter's solution plays a role; None where none does."""
    return role.removeprefix(_ROLE[0]).removesuffix(_ROLE[1]) if role.startswith(_ROLE[0]) else None


def decode_solution(tables: Sequence[Table], settings: Solution) -> tuple[SolutionColumns, list[Note]]:
    """Make the columns of a solution.

    Parameters
    ----------
    tables : sequence of Table
        Of its topic, and of the one with its geographic positions if there is one.

    Raises
    ------
    LogError
        No message can be used.
    """
    # Positions in metres are laid where the filters start, not where [initial] says.
    parts = [read_part(table, settings, Initial()) for table in tables]
    for part in parts:
        part.cleaner.require_rows()
    motion, table, part = union(parts), tables[0], parts[0]
    completed, notes = table.source.completed(settings), [note for one in parts for note in one.cleaner.notes]
    way_n = None
    if "local_position" in table and not motion.has_position:
        way_n = part.cleaner.kept(local_way_n(table, completed))
    table = replace(table, sampled=table.sampled.among(part.cleaner.rows, len(table)))
    cov, wrong = _covariances(table, completed, part)
    if wrong:
        text = f"{table.source.role}: {wrong} covariances are none (not positive definite), and count as not told"
        hint = "whoever writes them can tell; without them the solution is not judged honest or not"
        notes.append(Note("solution_covariance", text, wrong, Severity.WARNING, hint))
    return SolutionColumns(motion, way_n, part.time_ns[table.sampled.rows], cov), notes


def no_covariances() -> tuple[TimeNs, Floats]:
    """Return the times and covariances of a solution that says nothing of its errors."""
    return np.empty(0, np.int64), np.empty((0, SIZE, SIZE))


def _covariances(table: Table, settings: Solution, part: Part) -> tuple[Floats, int]:
    """Return the covariance of the sampled rows in n, shape (c, 9, 9), and count matrices that are none.

    A velocity in the body errs by what its own covariance says, and in n by a misalignment, too: with
    ``v_n = C v_b`` the error is ``dv = C dv_b - v x phi``.
    """
    rows = table.sampled.rows
    cov, wrong = np.full((len(rows), SIZE, SIZE), np.nan), 0
    turn_n = np.eye(3) if settings.axes == "ned_frd" else MAT_ENU_NED
    if "pose_cov" in table:
        pose, wrong = _told(_whole(table.values("pose_cov", 21), 6))
        for one, of_one in ((DP, slice(0, 3)), (PHI, slice(3, 6))):
            for other, of_other in ((DP, slice(0, 3)), (PHI, slice(3, 6))):
                cov[:, one, other] = turn_n @ pose[:, of_one, of_other] @ turn_n.T
    if "twist_cov" in table and part.velocity_n is not None:
        twist, more = _told(_whole(table.values("twist_cov", 6), 3))
        wrong += more
        in_body = "velocity_b" in table and settings.velocity_n is None
        if in_body and part.mat_nb is not None:
            turn_b = np.eye(3) if settings.axes == "ned_frd" else MAT_FRD_FLU
            mat, velocity_x = part.mat_nb[rows] @ turn_b, skew(part.velocity_n[rows])
            by_phi = -velocity_x @ cov[:, PHI]
            cov[:, DV, DV] = mat @ twist @ mat.swapaxes(1, 2) - by_phi[:, :, PHI] @ velocity_x.swapaxes(1, 2)
            cov[:, DV, PHI], cov[:, DV, DP] = by_phi[:, :, PHI], by_phi[:, :, DP]
            cov[:, PHI, DV], cov[:, DP, DV] = (cov[:, DV, at].swapaxes(1, 2) for at in (PHI, DP))
        elif not in_body:
            cov[:, DV, DV] = turn_n @ twist @ turn_n.T
            cov[:, DV, PHI] = cov[:, DV, DP] = cov[:, PHI, DV] = cov[:, DP, DV] = 0.0
    return cov, wrong


def _whole(upper: Floats, size: int) -> Floats:
    """Make matrices of their upper triangles, row by row."""
    whole = np.empty((len(upper), size, size))
    row, column = np.triu_indices(size)
    whole[:, row, column] = whole[:, column, row] = upper
    return whole


def _told(cov: Floats) -> tuple[Floats, int]:
    """Return covariances, shape (c, n, n), with NaN in the blocks of three that are not told, and count what is none.

    A variance of 0 or less, such as the -1 in front of a matrix that stands for none, says nothing.
    """
    variances = np.diagonal(cov, axis1=1, axis2=2)
    told_of = (variances > 0.0) & np.isfinite(variances)
    of_blocks = np.asarray(told_of.reshape(len(cov), -1, 3).all(axis=2))
    of_blocks[cov[:, 0, 0] == -1.0] = False
    of_rows = np.repeat(of_blocks, 3, axis=1)
    told = np.where(of_rows[:, :, None] & of_rows[:, None, :], cov, 0.0)
    # What is not told stands for itself alone, so that it does not hide the rest.
    diagonal = np.arange(cov.shape[1])
    told[:, diagonal, diagonal] += ~of_rows
    wrong = np.asarray(~(np.abs(told) < LARGEST).all(axis=(1, 2)))
    possible = np.flatnonzero(~wrong)
    wrong[possible] = np.linalg.eigvalsh(told[possible])[:, 0] <= 0.0
    of_rows[wrong] = False
    return np.where(of_rows[:, :, None] & of_rows[:, None, :], told, np.nan), int(np.count_nonzero(wrong))
