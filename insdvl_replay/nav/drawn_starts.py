"""Starts that err as much as a filter is told they may.

A replay starts on its reference, without the errors that P0 allows for and that aiding exists to find. From one such
start nothing can be learnt of how fast a filter finds them; from several that are drawn, its true errors can be seen to
fall.
"""

from dataclasses import replace

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import BA, BG, DV, PHI
from insdvl_replay.geometry.rotation import mat_from_vector, skew
from insdvl_replay.nav.initial_state import Start


def drawn_starts(start: Start, count: int, seed: int | tuple[int, ...]) -> tuple[Start, ...]:
    """Return a start, and others beside it that err by what is drawn from its covariance.

    Parameters
    ----------
    count : int
        How many, the start itself among them. Of two counts, the smaller gives the first of the larger.
    seed : int
        Of the draws. Filters that start alike meet the same errors.

    Returns
    -------
    tuple of Start
        The first is the start itself. All have its position, which no error state is of, and its covariance.
    """
    # By a triangular factor, which is the same on every processor; eigenvectors of equal variances would not be. The
    # states are scaled by their standard deviations first: in SI units P0 spans some ten decades.
    factor = np.linalg.cholesky(start.cov / np.outer(start.sd, start.sd))
    normal = np.random.default_rng(seed).standard_normal((max(count - 1, 0), len(start.cov)))
    return (start, *(erring(start, start.sd * (factor @ draw)) for draw in normal))


def erring(start: Start, error: Floats) -> Start:
    """Let a start err: the inverse of `correction.correct`, which takes the same errors out.

    The velocity follows from the error that is exact for misalignments of any size, ``dv + v_hat x phi``, which is
    ``v_hat - exp([phi x]) v``: ``(I + [phi x]) v_hat = exp([phi x]) v + dv``.

    Parameters
    ----------
    error : ndarray, shape (12,)
        Estimated minus true, of a bias true minus estimated, in the order of `states.STATES`, SI units.
    """
    turn = mat_from_vector(error[PHI])
    velocity_n = np.linalg.solve(np.eye(3) + skew(error[PHI]), turn @ start.velocity_n + error[DV])
    return replace(
        start,
        velocity_n=np.asarray(velocity_n, dtype=np.float64),
        mat_nb=turn @ start.mat_nb,
        accel_bias_b=start.accel_bias_b - error[BA],
        gyro_bias_b=start.gyro_bias_b - error[BG],
    )
