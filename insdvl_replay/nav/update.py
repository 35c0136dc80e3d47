"""One update: an innovation is judged by its gate, and what passes changes P and the errors that are estimated.

`filter` corrects the state by them once all of a reading is told.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import inlined
from insdvl_replay.nav.correction import locks_out, note_used, open_state
from insdvl_replay.nav.initial_state import Start
from insdvl_replay.nav.innovation import InsAtPing, linearise
from insdvl_replay.nav.kalman import cholesky, innovation_cov, normalised_square, transposed_gain, update_cov
from insdvl_replay.nav.measurement_noise import (
    ADAPTIVE,
    STUDENT_T,
    believed_factor,
    chance_var,
    found_factor,
    outlier_factor,
)
from insdvl_replay.nav.measurements import BEAM, Stack
from insdvl_replay.nav.own_measurement import Predicts
from insdvl_replay.nav.state_layout import StateLayout
from insdvl_replay.nav.state_log import Updates, write_update

BEAMS_TO_AXES: Final = 4.0
"""The square of a velocity error is at most so many times the sum of its squares along the beams of a Janus at 20 deg
or more."""


class Matrices(NamedTuple):
    """The covariance, the same memory row by row, what an update is worked out in, see `kalman`, and P0's diagonal."""

    P: Floats
    P_by_row: Floats
    H: Floats
    HP: Floats
    KT: Floats
    rest: Floats
    R: Floats
    S: Floats
    L: Floats
    z: Floats
    standardised: Floats
    dx: Floats
    start_var: Floats
    constants: Floats


def new_matrices(start: Start, size: int) -> Matrices:
    """Make room for measurements of up to so many components, at least three, with P as at the start."""
    cov, n, constants = start.cov, len(start.cov), start.constants.copy()
    P, (H, HP, KT, rest) = np.array(cov, order="C"), np.zeros((4, size, n))
    (R, S, L), (z, standardised) = np.zeros((3, size, size)), np.zeros((2, size))
    return Matrices(
        P, P.ravel(), H, HP, KT, rest, R, S, L, z, standardised, np.zeros(n), np.diag(cov).copy(), constants
    )


@inlined
def update(
    measurements: Stack,
    m: int,
    row: int,
    time_s: float,
    ins: InsAtPing,
    layout: StateLayout,
    own: Predicts | None,
    goes_on: bool,
    is_again: bool,
    matrices: Matrices,
    updates: Updates,
) -> tuple[bool, float]:
    """Judge an innovation by its gate, use it if it passes, and write down both.

    What is used changes P and the estimated errors ``dx``, to which those of the measurements before it are added if it
    goes on with their reading. The state is corrected by all of them. A beam that is met again, since its ping has
    opened the velocity, keeps the innovation that it had before, and tells nothing of the noise.

    Returns
    -------
    used : bool
    square : float
        Of an innovation that was not used; else 0.
    """
    P, dx, size = matrices.P, matrices.dx, measurements.size[m]
    H, HP, KT, rest = matrices.H[:size], matrices.HP[:size], matrices.KT[:size], matrices.rest[:size]
    R, S, L = matrices.R[:size, :size], matrices.S[:size, :size], matrices.L[:size, :size]
    z, standardised = matrices.z[:size], matrices.standardised[:size]
    linearise(measurements, m, row, ins, layout, own, z, matrices.H[: max(size, 3)])
    if goes_on:
        _take_off(H, dx, z)
    for i in range(size):
        for j in range(size):
            R[i, j] = updates.noise_factor[m] * measurements.cov[m, row, i, j]
    innovation_cov(P, H, R, HP, S)
    cholesky(S, L)
    nis = normalised_square(L, z, standardised)
    # Of a velocity that was opened, innovations tell of that alone.
    is_followed = measurements.noise[m] == ADAPTIVE and not is_again
    if (is_followed or measurements.noise[m] == STUDENT_T) and nis <= measurements.gate[m]:
        _scale(R, _noise_factor(measurements.noise[m], m, nis, z, S, R, updates))
        innovation_cov(P, H, R, HP, S)
        cholesky(S, L)
        nis = normalised_square(L, z, standardised)
    used = nis <= measurements.gate[m]
    alone = measurements.kind[m] != BEAM
    reopened = not used and alone and locks_out(updates, m, nis, time_s, measurements.reopen_after[m])
    write_update(updates, m, row, z, S, L, nis, used or reopened, reopened, is_again)
    if reopened:
        open_state(P, _square(z), matrices.start_var, layout.position, updates, m, time_s)
        innovation_cov(P, H, R, HP, S)
        cholesky(S, L)
    elif used:
        note_used(updates, m, time_s)
    else:
        _learn_of_rejected(is_followed, measurements.gate[m], m, nis, z, S, R, updates)
        return False, _square(z)
    transposed_gain(HP, L, KT)
    for i in range(len(dx)):
        estimate = KT[0, i] * z[0]
        for k in range(1, size):
            estimate += KT[k, i] * z[k]
        dx[i] = dx[i] + estimate if goes_on else estimate
    update_cov(P, H, R, HP, KT, rest)
    return True, 0.0


@inlined
def _take_off(H: Floats, dx: Floats, z: Floats) -> None:
    """Take off an innovation what errors that are estimated already leave of it, ``z <- z - H dx``."""
    for i in range(len(z)):
        for j in range(len(dx)):
            z[i] -= H[i, j] * dx[j]


@inlined
def _noise_factor(kind: int, m: int, nis: float, z: Floats, S: Floats, R: Floats, updates: Updates) -> float:
    """Return by how much larger an innovation says that R is, and remember it where the noise is followed."""
    if kind == STUDENT_T:
        return outlier_factor(nis, len(z))
    return _follow_noise(m, 1.0, z, S, R, updates)


@inlined
def _learn_of_rejected(
    is_followed: bool, gate: float, m: int, nis: float, z: Floats, S: Floats, R: Floats, updates: Updates
) -> None:
    """Let an innovation that the gate has rejected tell of the noise as much as one would that had just passed."""
    if is_followed and 0.0 < gate < nis and math.isfinite(nis):
        _follow_noise(m, gate / nis, z, S, R, updates)


@inlined
def _follow_noise(m: int, share: float, z: Floats, S: Floats, R: Floats, updates: Updates) -> float:
    """Remember how large R is by an innovation more, and return by how much larger that is than until now."""
    before: float = updates.noise_factor[m]
    updates.noise_found[m] = found_factor(updates.noise_found[m], before, z, S, R, share)
    updates.noise_var[m] = chance_var(updates.noise_var[m], before, S, R)
    updates.noise_factor[m] = believed_factor(updates.noise_found[m], updates.noise_var[m])
    after: float = updates.noise_factor[m]
    return after / before


@inlined
def _scale(R: Floats, factor: float) -> None:
    for i in range(len(R)):
        for j in range(len(R)):
            R[i, j] *= factor


@inlined
def _square(z: Floats) -> float:
    total = 0.0
    for i in range(len(z)):
        total += z[i] * z[i]
    return total


@inlined
def count_lost_ping(
    square: float,
    measurements: Stack,
    m: int,
    time_s: float,
    layout: StateLayout,
    matrices: Matrices,
    updates: Updates,
) -> bool:
    """Count a ping of which no beam passed, and tell whether after so many in a row the velocity was opened for it."""
    lost = locks_out(updates, m, square, time_s, measurements.reopen_after[m])
    if lost:
        open_state(matrices.P, BEAMS_TO_AXES * square, matrices.start_var, layout.position, updates, m, time_s)
    return lost
