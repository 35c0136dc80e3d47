"""Whether a filter's errors are as large as it predicts: errors against the reference in its own sigma.

The reference is taken as exact: where it is no better than the filter, its own errors count as the filter's. The worst
of the groups of states represents a filter: all states together may be consistent where some err by far more than the
filter says and others by far less. Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking
and Navigation", chapter 5.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import chdtr

from insdvl_replay.core.dive_columns import (
    Floats,
    Integers,
    Mask,
    ReferenceColumns,
    TimeNs,
    TruthColumns,
    seconds,
)
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import (
    ALL_CREDIBILITY_GROUPS,
    CREDIBILITY_GROUPS,
    CREDIBILITY_QUANTITIES,
    JOINT,
    POSITION_QUANTITIES,
    SETTLED_LEVEL,
    SETTLED_VELOCITY,
)
from insdvl_replay.core.states import BA, DV, PHI
from insdvl_replay.core.tables import CredibilityRow
from insdvl_replay.core.words import Consistency, Reason
from insdvl_replay.evaluation.consistency import (
    CONFIDENCE,
    LARGEST_PER_DOF,
    SMALLEST_PER_DOF,
    MeanVerdict,
    chi_square_quantile,
    mean_verdict,
    probability_beyond_3_sd,
)
from insdvl_replay.evaluation.reference_errors import errors_at
from insdvl_replay.evaluation.series import samples_in_mean_square
from insdvl_replay.geometry.rotation import rpy_from_mat

# Share of the expected NEES, half of the predicted size, below which errors count as small. A filter starts at the
# reference, so the errors of a consistent filter are smaller than its sigma for a while.
FAR_SMALLER: Final = 0.25
# A smaller share of errors beyond three sigma is near enough to the 0.3 % of a consistent filter.
MANY_FAR_OFF: Final = 0.01
LEVEL: Final = slice(PHI.start, PHI.stop - 1)
# A mean NEES of a baseline that is off by less than this factor is sound. Beyond the limits of the baseline, few
# effective samples must be less probable than this in a sound filter.
SOUND: Final = 3.0
UNLIKELY: Final = 1e-3
FEWEST_SETTLED: Final = 10  # times of the reference

States = Integers


# --- Errors in the filter's states, with P.


@dataclass(frozen=True)
class StateErrors:
    """Estimated minus true in the order of the n states that can be compared, with P, at k times of the reference."""

    filter: str
    time_ns: TimeNs  # (k,), at which the history holds P
    error: Floats  # (k, n), SI units, see `reference_errors.errors_at`; NaN where neither reference nor truth has them
    cov: Floats  # (k, n, n), P
    heading: Floats  # (k,), of the reference, rad
    has_sd: Mask  # (n,), states for which the filter has a standard deviation
    # it starts on the reference, so its errors are below sigma for a while
    exact_start: bool = True

    @property
    def is_known(self) -> Mask:
        """Whether the error of a state is known at any time, shape (n,)."""
        known: Mask = np.any(np.isfinite(self.error), axis=0)
        return known

    @property
    def sd(self) -> Floats:
        """Square roots of the diagonal of P, shape (k, n)."""
        with np.errstate(invalid="ignore"):
            return np.sqrt(np.diagonal(self.cov, axis1=1, axis2=2))

    def after(self, time_ns: int) -> "StateErrors":
        """Keep the times after one, such as the start, where a filter is set to the reference."""
        return self.rows(slice(int(np.searchsorted(self.time_ns, time_ns, side="right")), None))

    def rows(self, rows: slice | Mask) -> "StateErrors":
        """Keep some times."""
        kept = {name: getattr(self, name)[rows] for name in ("time_ns", "error", "cov", "heading")}
        return replace(self, **kept)


def state_errors(
    history: History, reference: ReferenceColumns, truth: TruthColumns | None
) -> StateErrors:
    """Compare one filter with the reference, and its biases with the truth, the start included."""
    time_ns, rows, theirs = np.intersect1d(
        history.cov_ns, reference.time_ns, assume_unique=True, return_indices=True
    )
    error = errors_at(time_ns, history, reference, truth)
    n = error.shape[1]
    cov = history.cov[rows, :n, :n]
    if history.is_partial:
        error[~np.isfinite(np.diagonal(cov, axis1=1, axis2=2))] = np.nan
    heading = rpy_from_mat(reference.mat_nb[theirs])[:, 2]
    exact_start = not history.has_own_start
    return StateErrors(
        history.filter, time_ns, error, cov, heading, history.predicted[:n], exact_start
    )


def about_vehicle(errors: StateErrors) -> StateErrors:
    """Turn misalignment from north and east to roll and pitch: about the vehicle's axes, made level."""
    cos = np.cos(errors.heading)
    sin = np.sin(errors.heading)
    turn = np.moveaxis(np.array([[cos, sin], [-sin, cos]]), 2, 0)
    error = errors.error.copy()
    cov = errors.cov.copy()
    error[:, LEVEL] = np.einsum("kij,kj->ki", turn, error[:, LEVEL])
    with np.errstate(invalid="ignore", over="ignore"):
        cov[:, LEVEL] = turn @ cov[:, LEVEL]
        cov[:, :, LEVEL] = cov[:, :, LEVEL] @ np.swapaxes(turn, 1, 2)
    return replace(errors, error=error, cov=cov)


def whitened(
    error: Floats,  # (k, n) or (k, n, m), one error for each P, or m of them
    cov: Floats,  # (k, n, n)
) -> Floats:
    """Return ``L^-1 x`` with ``L L' = P``: errors in standard deviations, uncorrelated if P is right.

    The states are scaled by their standard deviations first: in SI units P spans some fifteen decades. All is NaN if
    one of the P is not positive definite: a filter that broke down has no better rows.
    """
    columns = error if error.ndim == 3 else error[..., None]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        sd = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
        if not (np.isfinite(sd) & (sd > 0.0)).all():
            return np.full_like(error, np.nan)
        scaled: Floats = columns / sd[..., None]
        if sd.shape[1] > 1:
            try:
                factor = np.linalg.cholesky(cov / (sd[:, :, None] * sd[:, None, :]))
            except np.linalg.LinAlgError:
                return np.full_like(error, np.nan)
            scaled = np.asarray(np.linalg.solve(factor, scaled), dtype=np.float64)
    return scaled.reshape(error.shape)


def nees(error: Floats, cov: Floats) -> Floats:
    """Return the normalised estimation error squared, ``x' P^-1 x``, shape (k,); NaN as in `whitened`."""
    squared: Floats = np.sum(whitened(error, cov) ** 2, axis=1)
    return squared


def shared_variance(cov: Floats, states: States, others: States) -> Floats:
    """Return, for each other state, the share of the variance of some states that knowing it would remove.

    It is of one of n whitened states, root mean square over them, in the mean over the time, shape (others,).
    """
    between = whitened(cov[:, states[:, None], others], cov[:, states[:, None], states])
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        other_variance = np.diagonal(cov, axis1=1, axis2=2)[:, others]
        share: Floats = np.mean(np.sum(between**2, axis=1) / other_variance, axis=0) / np.sqrt(
            len(states)
        )
    return share


# --- The table.


def credibility_table(
    log: str, filters: Sequence[str], errors: Mapping[str, StateErrors]
) -> list[CredibilityRow]:
    """Return the credibility of each filter by its errors against the reference; ``errors`` are empty without one.

    There are rows for velocity and attitude, about the vehicle's level axes, for the biases where the log carries the
    true ones; for the groups of these with their block of P, and for ``all`` of them with the whole of P, where shares
    are those inside the ellipsoids of one and three standard deviations.
    """
    rows: list[CredibilityRow] = []
    for name in filters:
        if errors:
            rows += _rows_of_filter(log, errors[name])
        else:
            rows += _rows_without_reference(log, name)
    return rows


def _rows_without_reference(log: str, name: str) -> Iterator[CredibilityRow]:
    """Yield the rows of velocity and attitude, which a filter has always."""
    nothing = MeanVerdict(verdict=Consistency.NO_REFERENCE)
    groups = [group for group, states in CREDIBILITY_GROUPS.items() if states.stop <= BA.start]
    for quantity in (*CREDIBILITY_QUANTITIES[: BA.start], *groups, JOINT):
        yield _row(log, name, quantity, 1, 0, nothing)


def _rows_of_filter(log: str, errors: StateErrors) -> Iterator[CredibilityRow]:
    """Yield the rows of the single states of a filter, of groups of states, and of all together."""
    in_vehicle = about_vehicle(errors)
    states = range(errors.error.shape[1])
    samples = np.array([_samples_of(errors, state) for state in states])
    samples_in_vehicle = samples.copy()
    for state in range(LEVEL.start, LEVEL.stop):
        samples_in_vehicle[state] = _samples_of(in_vehicle, state)
    yield from _rows_of_states(log, in_vehicle, samples_in_vehicle)
    yield from _rows_of_groups(log, errors, samples)


def _rows_of_states(
    log: str, errors: StateErrors, samples_of_each: Floats
) -> Iterator[CredibilityRow]:
    quantities = (*CREDIBILITY_QUANTITIES, *POSITION_QUANTITIES)
    is_known = errors.is_known
    for state, has_sd in enumerate(errors.has_sd):
        if has_sd and (state < BA.start or is_known[state]):
            states = np.array([state])
            yield _compared_row(log, quantities[state], errors, states, samples_of_each)


def _rows_of_groups(
    log: str, errors: StateErrors, samples_of_each: Floats
) -> Iterator[CredibilityRow]:
    """Yield the rows of several states; errors of the attitude are about north, east and down.

    A constant error in n moves from one body axis to another in turns; a group would hide it.
    """
    is_known = errors.is_known
    for group, columns in ALL_CREDIBILITY_GROUPS.items():
        has_error = columns.stop <= BA.start or is_known[columns].any()
        if has_error and errors.has_sd[columns].any():
            states = np.arange(columns.start, columns.stop)
            yield _compared_row(log, group, errors, states, samples_of_each)
    if errors.has_sd.any():
        yield _compared_row(log, JOINT, errors, np.flatnonzero(is_known), samples_of_each)


# --- Whether a baseline is fit to judge by.


def settled_table(
    log: str,
    errors: StateErrors,  # of the baseline
    reference: ReferenceColumns,  # independent of the filters and on time
    start_ns: int,
    settled_s: Mapping[str, float],  # after the start, of velocity_along and level
    *,
    velocity_sd_mps: float,  # of the reference; 0 where nobody said
    attitude_sd_rad: float,
) -> list[CredibilityRow]:
    """Return whether the settled errors of a baseline are of the size that it predicts, by the limits of a fit one.

    The noise of the reference is added to P. Where nobody said how large it is, errors may be the reference's, so that
    there is no upper limit. The level has no lower one: a filter that starts on the reference has a smaller error for
    long. What grows with the speed is an error of the DVL's mounting or scale, and no noise.
    """
    since_s = seconds(errors.time_ns, start_ns)
    rows = []
    for quantity, sd in ((SETTLED_VELOCITY, velocity_sd_mps), (SETTLED_LEVEL, attitude_sd_rad)):
        from_s = settled_s.get("level", 0.0)
        if quantity == SETTLED_VELOCITY:
            from_s = settled_s.get("velocity_along", 0.0)
        own = errors.rows(since_s >= from_s)
        error, cov = _settled_level(own)
        if quantity == SETTLED_VELOCITY:
            error, cov = _settled_velocity(own, reference)
        known = np.isfinite(error).all(axis=1)
        if known.sum() < FEWEST_SETTLED:
            continue
        noise = sd**2 * np.eye(error.shape[1])
        standardised = whitened(error[known], cov[known] + noise)
        if np.isfinite(standardised).all():
            row = _settled_row(log, errors.filter, quantity, standardised, has_noise=sd > 0.0)
            rows.append(row)
    return rows


def _settled_level(errors: StateErrors) -> tuple[Floats, Floats]:
    """Return roll and pitch errors, shape (k, 2), with their P."""
    turned = about_vehicle(errors)
    return turned.error[:, LEVEL], turned.cov[:, LEVEL, LEVEL]


def _settled_velocity(errors: StateErrors, reference: ReferenceColumns) -> tuple[Floats, Floats]:
    """Return velocity errors along, across and down, shape (k, 3), without what grows with the speed, with their P."""
    cos = np.cos(errors.heading)
    sin = np.sin(errors.heading)
    turn = np.zeros((len(cos), 3, 3))
    turn[:, 0, 0] = cos
    turn[:, 0, 1] = sin
    turn[:, 1, 0] = -sin
    turn[:, 1, 1] = cos
    turn[:, 2, 2] = 1.0
    error_mps = np.einsum("kij,kj->ki", turn, errors.error[:, DV])
    cov = turn @ errors.cov[:, DV, DV] @ np.swapaxes(turn, 1, 2)
    rows = np.searchsorted(reference.time_ns, errors.time_ns)
    velocity_n = reference.velocity_n[rows]
    along_mps = cos * velocity_n[:, 0] + sin * velocity_n[:, 1]
    known = np.isfinite(error_mps).all(axis=1) & np.isfinite(along_mps)
    power = float(np.sum(along_mps[known] ** 2))
    if power > 0.0:
        share = along_mps[known] @ error_mps[known] / power
        error_mps = error_mps - along_mps[:, None] * share
    return error_mps, cov


def _settled_row(
    log: str,
    name: str,
    quantity: str,
    standardised: Floats,
    *,
    has_noise: bool,
) -> CredibilityRow:
    samples, dof = standardised.shape
    squared = np.sum(standardised**2, axis=1)
    independent = samples_in_mean_square(standardised)
    low, high = fit_limits(dof, independent)
    if quantity == SETTLED_LEVEL:
        low = np.nan
    if not has_noise:
        high = np.nan
    mean = float(squared.mean())
    word = Consistency.CONSISTENT
    if mean < low:
        word = Consistency.CONSERVATIVE
    elif mean > high:
        word = Consistency.OVERCONFIDENT
    found = MeanVerdict(mean, low, high, word)
    shares_pct = (_within_pct(squared, 1.0, dof), _within_pct(squared, 3.0, dof))
    return _row(log, name, quantity, dof, samples, found, shares_pct, independent)


def fit_limits(dof: int, samples: float) -> tuple[float, float]:
    """Return the limits of the mean NEES of a baseline that is fit to judge by; wider for few effective samples."""
    count = dof * samples
    unlikely_low = chi_square_quantile(UNLIKELY, count) / count / SOUND
    unlikely_high = chi_square_quantile(1.0 - UNLIKELY, count) / count * SOUND
    low = min(SMALLEST_PER_DOF, unlikely_low)
    high = max(LARGEST_PER_DOF, unlikely_high)
    return dof * low, dof * high


def _standardised(errors: StateErrors, states: States) -> tuple[Floats, Floats]:
    """Return errors of some states, whitened, at the times when all are known, shape (t, n), and P at these times."""
    times = np.isfinite(errors.error[:, states]).all(axis=1) & bool(len(states))
    cov = errors.cov if times.all() else errors.cov[times]
    return whitened(errors.error[np.ix_(times, states)], cov[:, states[:, None], states]), cov


def _samples_of(errors: StateErrors, state: int) -> float:
    """Return the effective samples of the errors of a state; NaN where unknown."""
    standardised, _ = _standardised(errors, np.array([state]))
    if len(standardised) and np.isfinite(standardised).all():
        return samples_in_mean_square(standardised)
    return np.nan


def _row(
    log: str,
    name: str,
    quantity: str,
    dof: int,
    samples: int,
    mean: MeanVerdict,
    shares_pct: tuple[float, float] = (np.nan, np.nan),  # within one and three standard deviations
    independent: float = np.nan,
) -> CredibilityRow:
    return CredibilityRow(
        log=log,
        filter=name,
        quantity=quantity,
        dof=dof,
        samples=samples,
        mean_nees=mean.mean,
        low=mean.low,
        high=mean.high,
        within_1sd_pct=shares_pct[0],
        within_3sd_pct=shares_pct[1],
        verdict=mean.verdict,
        effective_samples=independent,
        why=mean.why,
    )


def _compared_row(
    log: str,
    quantity: str,
    errors: StateErrors,
    states: States,
    samples_of_each: Floats,  # (n,), see `_samples_of`
) -> CredibilityRow:
    """Return the credibility of some states together."""
    standardised, cov = _standardised(errors, states)
    samples, dof = standardised.shape
    if not samples:
        nothing = MeanVerdict(verdict=Consistency.NOT_IN_REFERENCE)
        return _row(log, errors.filter, quantity, dof, samples, nothing)
    if not np.isfinite(standardised).all():
        broken = MeanVerdict(verdict=Consistency.NOT_FINITE)
        return _row(log, errors.filter, quantity, dof, samples, broken)

    independent = _independent_samples(standardised, cov, states, samples_of_each)
    squared = np.sum(standardised**2, axis=1)
    mean = mean_verdict(squared, dof, independent)
    near_pct = _within_pct(squared, 1.0, dof)
    far_pct = _within_pct(squared, 3.0, dof)
    if mean.verdict == Consistency.CONSERVATIVE and errors.exact_start:
        # A filter that starts on the reference has no misalignment, nor errors that depend on it: velocity across the
        # track or, on a straight line, a horizontal accelerometer bias. Errors that are too small are compared with
        # the share of the variance that is left if the attitude is known.
        left = 1.0 - _share_of_attitude(cov, states)
        if mean.mean >= FAR_SMALLER * left * dof:
            mean = mean._replace(verdict=Consistency.CONSISTENT, why=Reason.EXACT_START)
    beyond = 1.0 - far_pct / 100.0
    many_far_off = (
        beyond >= MANY_FAR_OFF and probability_beyond_3_sd(beyond, independent) < 1.0 - CONFIDENCE
    )
    if mean.verdict != Consistency.OVERCONFIDENT and many_far_off:
        # More errors exceed 3 standard deviations than chance allows, and by enough to matter.
        mean = mean._replace(verdict=Consistency.OVERCONFIDENT, why=Reason.BEYOND_3_SD)
    return _row(log, errors.filter, quantity, dof, samples, mean, (near_pct, far_pct), independent)


def _independent_samples(
    standardised: Floats,  # (t, n), errors of some states, whitened
    cov: Floats,  # of all states at these times
    states: States,
    samples_of_each: Floats,  # effective samples of each state alone
) -> float:
    """Return the effective samples of errors that depend on other states, which may be slower.

    A share s of the variance depends on the other state, which is constant within one of its samples. So s^2 of the
    squared correlations are those of the other state, the rest those of the errors. P gives s. An unknown bias hardly
    changes, so it counts as slow as the slowest known state.
    """
    independent = float(samples_of_each[states[0]])
    if len(states) > 1:
        independent = samples_in_mean_square(standardised)
    others = np.setdiff1d(np.arange(len(samples_of_each)), states)
    if not len(others):
        return independent
    slowest = 1.0
    if np.isfinite(samples_of_each).any():
        slowest = np.nanmin(samples_of_each)
    of_others = np.nan_to_num(samples_of_each, nan=slowest)[others]
    share = shared_variance(cov, states, others) ** 2
    repeated = share / of_others + (1.0 - share) / independent
    most = np.max(repeated, where=np.isfinite(repeated), initial=1.0 / independent)
    return float(1.0 / most)


def _within_pct(squared: Floats, sigmas: float, dof: int) -> float:
    """Return how many errors are in the ellipsoid that has the probability of some sigma of a normal variable."""
    probability = float(chdtr(1, sigmas**2))
    return 100.0 * float(np.mean(squared <= chi_square_quantile(probability, dof)))


def _share_of_attitude(cov: Floats, states: States) -> float:
    """Return the share of the variance of some states that knowing the attitude would remove; 0 for the attitude."""
    attitude = np.arange(PHI.start, PHI.stop)
    if np.isin(states, attitude).any():
        return 0.0
    between = whitened(cov[:, states[:, None], attitude], cov[:, states[:, None], states])
    both = whitened(np.swapaxes(between, 1, 2), cov[:, PHI, PHI])
    return float(np.nan_to_num(np.mean(np.sum(both**2, axis=(1, 2))) / len(states)))
