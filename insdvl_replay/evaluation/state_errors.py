"""Errors of a filter in its own states, where a reference or the truth knows them, and how large P lets them be.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", chapter 5.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs, TruthColumns
from insdvl_replay.core.history import History
from insdvl_replay.core.states import BA, BG, DV, PHI, POSITION
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import rpy_from_mat, vector_from_mat


@dataclass(frozen=True)
class StateErrors:
    """Estimated minus true in the order of the n states that can be compared, with what the filter believes of it.

    These are `states.STATES`, and the position where a filter estimates it.

    Attributes
    ----------
    time_ns : ndarray, shape (k,)
        Times at which there is a reference and the history holds P.
    error : ndarray, shape (k, n)
        SI units, velocity and attitude as in `motion_error`; a bias is what is left in the compensated readings. NaN
        where neither reference nor truth knows.
    sd : ndarray, shape (k, n)
        Square roots of the diagonal of P.
    cov : ndarray, shape (k, n, n)
        P.
    heading : ndarray, shape (k,)
        Of the reference, rad.
    believed : ndarray of bool, shape (n,)
        Of which states the filter says how sure it is.
    exact_start : bool
        Whether it starts on the reference, so that for a while it errs less than it says.
    """

    filter: str
    time_ns: TimeNs
    error: Floats
    sd: Floats
    cov: Floats
    heading: Floats
    believed: NDArray[np.bool_]
    exact_start: bool = True

    def after(self, time_ns: int) -> "StateErrors":
        """Keep the times after one, such as the start, where a filter is set to the reference."""
        rows = slice(int(np.searchsorted(self.time_ns, time_ns, side="right")), None)
        return replace(
            self,
            time_ns=self.time_ns[rows],
            error=self.error[rows],
            sd=self.sd[rows],
            cov=self.cov[rows],
            heading=self.heading[rows],
        )


def state_errors(history: History, reference: ReferenceColumns, truth: TruthColumns | None) -> StateErrors:
    """Compare one filter with the reference, and its biases with the truth.

    Parameters
    ----------
    truth : TruthColumns or None
        The biases, at any of the reference's times.

    Returns
    -------
    StateErrors
        At the times of the history's P that the reference has, the start included.
    """
    time_ns, of_cov, theirs = np.intersect1d(history.cov_ns, reference.time_ns, assume_unique=True, return_indices=True)
    ours, error = np.searchsorted(history.time_ns, time_ns), errors_at(time_ns, history, reference, truth)
    heading = rpy_from_mat(reference.mat_nb[theirs])[:, 2]
    n = error.shape[1]
    sd, cov = history.sd[ours, :n], history.cov[of_cov, :n, :n]
    if history.is_read:
        error[~np.isfinite(np.diagonal(cov, axis1=1, axis2=2))] = np.nan
    believed, exact_start = history.believed[:n], not history.is_read
    return StateErrors(history.filter, time_ns, error, sd, cov, heading, believed, exact_start)


def errors_at(time_ns: TimeNs, history: History, reference: ReferenceColumns, truth: TruthColumns | None) -> Floats:
    """Return how far a filter is off in its states, as in `StateErrors`.

    Parameters
    ----------
    time_ns : ndarray, shape (k,)
        Times that both history and reference have.
    truth : TruthColumns or None
        The biases, at any of the reference's times.

    Returns
    -------
    ndarray, shape (k, n)
    """
    ours, theirs = np.searchsorted(history.time_ns, time_ns), np.searchsorted(reference.time_ns, time_ns)
    error = np.full((len(time_ns), POSITION.stop if history.estimates_position else POSITION.start), np.nan)
    error[:, DV], error[:, PHI] = motion_error(
        history.velocity_n[ours], history.mat_nb[ours], reference.velocity_n[theirs], reference.mat_nb[theirs]
    )
    if truth is not None:
        _, rows, of_truth = np.intersect1d(time_ns, truth.time_ns, assume_unique=True, return_indices=True)
        error[rows, BA] = truth.accel_bias_b[of_truth] - history.accel_bias_b[ours][rows]
        error[rows, BG] = truth.gyro_bias_b[of_truth] - history.gyro_bias_b[ours][rows]
    if history.estimates_position:
        error[:, POSITION] = north_east_down_m(history.position[ours], reference.position[theirs])
    return error


def motion_error(
    velocity_n: Floats, mat_nb: Floats, true_velocity_n: Floats, true_mat_nb: Floats
) -> tuple[Floats, Floats]:
    """Return the errors of velocity and attitude of which P speaks.

    What the filter is exact for is the invariant error ``xi = v_hat - C_hat C' v``, and to first order that is
    ``dv + v_hat x phi``. The dv of this relation is the difference of the velocities where the misalignment is small;
    with a heading that is off by 20 deg the difference would also hold the second order, 6 % of the speed, which has no
    place in P.

    Parameters
    ----------
    velocity_n, true_velocity_n : ndarray, shape (k, 3)
        m/s
    mat_nb, true_mat_nb : ndarray, shape (k, 3, 3)
        Attitudes. Where one is not known, the velocity error is the difference.

    Returns
    -------
    velocity_error_n : ndarray, shape (k, 3)
        m/s
    misalignment_n : ndarray, shape (k, 3)
        rad; NaN where it is not known.
    """
    known = np.isfinite(true_mat_nb).all(axis=(1, 2)) & np.isfinite(mat_nb).all(axis=(1, 2))
    velocity_error_n, misalignment_n = velocity_n - true_velocity_n, np.full_like(velocity_n, np.nan)
    turned = mat_nb[known] @ np.swapaxes(true_mat_nb[known], 1, 2)
    misalignment_n[known] = vector_from_mat(turned)
    invariant_error_n = velocity_n[known] - np.einsum("kij,kj->ki", turned, true_velocity_n[known])
    velocity_error_n[known] = invariant_error_n - np.cross(velocity_n[known], misalignment_n[known])
    return velocity_error_n, misalignment_n


def about_vehicle(errors: StateErrors) -> StateErrors:
    """Turn misalignment from north and east to roll and pitch: about the vehicle's axes, made level."""
    cos, sin = np.cos(errors.heading), np.sin(errors.heading)
    level, turn = slice(PHI.start, PHI.stop - 1), np.moveaxis(np.array([[cos, sin], [-sin, cos]]), 2, 0)
    error, cov = errors.error.copy(), errors.cov.copy()
    error[:, level] = np.einsum("kij,kj->ki", turn, error[:, level])
    with np.errstate(invalid="ignore", over="ignore"):
        cov[:, level] = turn @ cov[:, level]
        cov[:, :, level] = cov[:, :, level] @ np.swapaxes(turn, 1, 2)
        sd = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    return replace(errors, error=error, cov=cov, sd=sd)


def shared_variance(cov: Floats, states: NDArray[np.int64]) -> tuple[Floats, float]:
    """Return what of the variance of some states would not be there if others were known, in the mean over time.

    Parameters
    ----------
    cov : ndarray, shape (k, 12, 12)
    states : ndarray, shape (n,)
        Whitened, so that together they have a variance of n.

    Returns
    -------
    of_each : ndarray, shape (12,)
        The share that hangs on each state, as one of n whitened ones: root mean square over the dimensions.
    of_attitude : float
        The share that hangs on the whole attitude; 0 for states that are of the attitude themselves.
    """
    n, block = len(states), cov[:, states[:, None], states]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        between = whitened(cov[:, states], block)
        of_each = np.mean(np.sum(between**2, axis=1) / np.diagonal(cov, axis1=1, axis2=2), axis=0) / np.sqrt(n)
        both = whitened(np.swapaxes(between[:, :, PHI], 1, 2), cov[:, PHI, PHI])
        of_attitude = np.mean(np.sum(both**2, axis=(1, 2)))
    own = np.any((states >= PHI.start) & (states < PHI.stop))
    return of_each, 0.0 if own else float(np.nan_to_num(of_attitude / n))


def nees(error: Floats, cov: Floats) -> Floats:
    """Return the normalised estimation error squared, ``x' P^-1 x``.

    Parameters
    ----------
    error : ndarray, shape (k, n)
    cov : ndarray, shape (k, n, n)

    Returns
    -------
    ndarray, shape (k,)
        NaN as in `whitened`.
    """
    squared: Floats = np.sum(whitened(error, cov) ** 2, axis=1)
    return squared


def whitened(error: Floats, cov: Floats) -> Floats:
    """Return ``L^-1 x`` with ``L L' = P``: errors in standard deviations, uncorrelated if P is right.

    The states are scaled by their standard deviations first: in SI units P spans some fifteen decades.

    Parameters
    ----------
    error : ndarray, shape (k, n) or (k, n, m)
        One error for each P, or m of them.
    cov : ndarray, shape (k, n, n)

    Returns
    -------
    ndarray, of the shape of the errors
        All NaN if one of the P is not positive definite: a filter that broke down has no better rows.
    """
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        sd = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
        correlation = cov / (sd[:, :, None] * sd[:, None, :])
        try:
            factor = np.linalg.cholesky(correlation)
        except np.linalg.LinAlgError:
            return np.full_like(error, np.nan)
        columns = (error if error.ndim == 3 else error[..., None]) / sd[..., None]
        return np.asarray(np.linalg.solve(factor, columns).reshape(error.shape))
