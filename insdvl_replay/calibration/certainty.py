"""Standard deviations of a calibration, of three kinds, and what is observable.

The formal one assumes white innovations. The second allows for their correlation. The third is the scatter between
dives. The largest counts. Sources: Newey and West, "A simple, positive semi-definite, heteroskedasticity and
autocorrelation consistent covariance matrix", 1987; Birge, "The calculation of errors by the method of least squares",
1932; DerSimonian and Laird, "Meta-analysis in clinical trials", 1986, for the mean of values that differ between dives.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from insdvl_replay.calibration.fit import OWN, SHARED_ROWS, Fit, Linearised
from insdvl_replay.calibration.innovations import DELAY, LATEST_S, NAMES, DiveInnovations
from insdvl_replay.core.dive_columns import Floats, ImuColumns
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.evaluation.notes import readings_scatter
from insdvl_replay.geometry.frames import beam_vectors

FEWEST_DIVES: Final = 2
# Least signal to noise of an estimate: the prior's standard deviation over that of the data.
SEEN: Final = 3.0


@dataclass(frozen=True)
class Certainty:
    """Standard deviations of p parameters, SI, (p,) each; the delay's is that of its mean over dives."""

    prior_sd: Floats  # of the configured values; less for a mean over dives
    formal: Floats  # from the information matrix
    correlated: Floats  # with the correlation of the innovations
    between: Floats  # from the scatter between dives; NaN for fewer than `FEWEST_DIVES`
    birge: Floats  # scatter between dives over the expected one: 1 is expected; NaN for one dive
    beams: Floats  # from errors of single beams
    imu: Floats  # from remaining errors of the IMU

    @property
    def sd(self) -> Floats:
        """The largest of the three, plus the errors of beams and IMU; at most the prior's."""
        return np.asarray(
            np.minimum(np.sqrt(self._largest**2 + self.beams**2 + self.imu**2), self.prior_sd)
        )

    @property
    def _largest(self) -> Floats:
        return np.fmax(np.fmax(self.formal, self.correlated), self.between)

    @property
    def signal_to_noise(self) -> Floats:
        """The prior's sd over that of the data alone."""
        return np.sqrt((self.prior_sd / self.sd) ** 2 - 1.0)

    @property
    def seen(self) -> Floats:
        """The same with perfect beams and IMU."""
        return np.sqrt((self.prior_sd / np.minimum(self._largest, self.prior_sd)) ** 2 - 1.0)


def certainty_of(
    fit: Fit, with_imu_errors: Fit | None = None, pulled_by: Floats | None = None
) -> Certainty:
    """Return the standard deviations of a fit, with the fit of `with_estimated_imu_errors` and the result of `pulled`.

    Without these two, the sensors are taken as perfect.
    """
    mean_of = _means(fit)
    inner = with_imu_errors or fit
    formal = np.sqrt(np.einsum("ij,jk,ik->i", mean_of, inner.cov, mean_of))
    # The prior is one separate measurement, without correlation.
    moved = mean_of @ inner.moved_by_scores
    scores_cov = inner.total(newey_west(near.scores) for near in inner.dives)
    correlated = np.sqrt(np.einsum("ij,jk,ik->i", moved, scores_cov, moved))
    beams = imu = np.zeros(OWN)
    if pulled_by is not None:
        parts = mean_of @ np.column_stack([pulled_by, inner.step])
        by_beams, by_imu = np.split(parts, [BEAM_ERRORS], axis=1)
        beams = np.linalg.norm(by_beams, axis=1)
        imu = np.linalg.norm(by_imu, axis=1)
    # The mean of the dives' delays has one prior for each dive.
    prior_sd = np.sqrt(mean_of**2 @ fit.prior_sd**2)
    between = birge = np.full(OWN, np.nan)
    if len(fit.dives) >= FEWEST_DIVES:
        own, own_sd = one_by_one(fit)
        weights = own_sd**-2.0
        weights[:, DELAY] = delay_weights(*own_delays(fit))
        between, birge = differing(own, own_sd, weights)
    return Certainty(prior_sd, formal, correlated, between, birge, beams, imu)


def differing(own: Floats, own_sd: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return the sd of a mean over dives by how they differ, and the Birge ratio, (p,), of values and weights (n, p).

    A dive without motion has no weight. With equal weights, the first is the scatter over the root of the number of
    dives.
    """
    total = weights.sum(axis=0)
    off = own - np.average(own, axis=0, weights=weights)
    pairs = np.sum(weights * (total - weights), axis=0)
    between = np.sqrt(np.sum((weights * off) ** 2, axis=0) / pairs)
    return between, np.sqrt(np.sum((off / own_sd) ** 2, axis=0) / (len(own) - 1))


def delay_weights(delays_s: Floats, sds_s: Floats) -> Floats:
    """Return the weight of each dive's delay in their mean, from its sd and from the scatter between dives.

    Clocks are set again before a dive, so the most certain delay does not predict the next one better than others. If
    the scatter is larger than the sds, all weigh about the same. A dive without motion has no weight.
    """
    weights = np.asarray(sds_s**-2.0)
    if len(weights) < FEWEST_DIVES:
        return weights
    total = weights.sum()
    chi_square = np.sum(weights * (delays_s - np.average(delays_s, weights=weights)) ** 2)
    beyond_chance = max(0.0, float(chi_square) - (len(weights) - 1))
    apart = total - np.sum(weights**2) / total
    return np.asarray(1.0 / (sds_s**2 + beyond_chance / apart))


def correlations(fit: Fit, at_least: float) -> list[tuple[str, str, float]]:
    """Return the pairs of parameters with a strong correlation."""
    correlation = correlation_matrix(fit)
    rows, columns = np.nonzero(np.triu(np.abs(correlation) >= at_least, 1))
    return [
        (NAMES[i], NAMES[j], float(correlation[i, j])) for i, j in zip(rows, columns, strict=True)
    ]


def correlation_matrix(fit: Fit) -> Floats:
    """Return the correlations of the errors of the parameters, (8, 8); of the delay those of its mean over dives."""
    mean_of = _means(fit)
    cov = mean_of @ fit.cov @ mean_of.T
    sd = np.sqrt(np.diag(cov))
    return np.asarray(cov / np.outer(sd, sd))


def mean_change(fit: Fit) -> Floats:
    """Return the change of each parameter, (8,); of the delay the mean over dives."""
    return np.asarray(_means(fit) @ fit.values)


def _means(fit: Fit) -> Floats:
    """Return the matrix from all unknowns to the eight parameters, (8, count); the delay is a weighted mean."""
    means = np.zeros((OWN, len(fit.values)))
    means[SHARED_ROWS, fit.rows[0][SHARED_ROWS]] = 1.0
    weights = delay_weights(*own_delays(fit))
    for rows, share in zip(fit.rows, weights / weights.sum(), strict=True):
        means[DELAY, rows[DELAY]] += share
    return means


def newey_west(scores: Floats) -> Floats:
    """Return the covariance of the sum of correlated rows, (k, n), with Bartlett's weights."""
    k = len(scores)
    lags = int(4.0 * (k / 100.0) ** (2.0 / 9.0)) + 5
    centred = scores - scores.mean(axis=0)
    total = centred.T @ centred
    for lag in range(1, min(lags, k - 1) + 1):
        product = centred[lag:].T @ centred[:-lag]
        total = total + (1.0 - lag / (lags + 1.0)) * (product + product.T)
    return np.asarray(total)


def one_by_one(fit: Fit) -> tuple[Floats, Floats]:
    """Return the estimate of each dive alone, near the common one, and its formal sds, (n, 8)."""
    alone = [fit.alone(dive) for dive in range(len(fit.dives))]
    own_sd = [np.sqrt(np.diag(dive.cov)) for dive in alone]
    return np.array([dive.values + dive.step for dive in alone]), np.array(own_sd)


def own_delays(fit: Fit) -> tuple[Floats, Floats]:
    """Return the delay of each dive and its formal sd, s, (n,)."""
    delays = [rows[DELAY] for rows in fit.rows]
    return fit.values[delays], np.sqrt(np.diag(fit.cov))[delays]


def autocorrelation(near: Linearised) -> Floats:
    """Return the lag-1 correlation of the residuals of each axis, (3,); outliers have less weight."""
    soft = near.scaled * near.weights
    centred = soft - soft.mean(axis=0)
    return np.asarray(np.sum(centred[1:] * centred[:-1], axis=0) / np.sum(centred**2, axis=0))


# --- The share of the vehicle's motion and of the IMU's noise in a fit.
#
# A trial delay or arm lets noise of accelerometers and gyros into the innovations, even for a vehicle at rest. The
# derivatives from this noise look like information: the delay ends where innovations happen to be smallest, and the
# arm near zero, with more confidence the noisier the IMU is. The share of noise in a derivative is found by adding as
# much noise again ("simulation extrapolation"). If it is not small, the estimate is where innovations are not
# correlated with the derivative of the same dive with an averaged IMU ("instrumental variables").
# Sources: Cook & Stefanski, "Simulation-extrapolation estimation in parametric measurement error models", 1994; Fuller,
# "Measurement error models", 1987.

# Most of what moves a vehicle is slower than this; white noise mostly faster.
MOTION_S: Final = 0.5
# Share of the derivative's squares up to which it is used unchanged. It pulls the estimate to zero by this share.
LITTLE: Final = 0.01
MOSTLY: Final = 0.5  # share above which the derivative is mostly noise
# Limit of the noise, in sample-to-sample scatter of the gyros. The fitted noise also covers changes of the rate
# between samples.
HIDDEN: Final = 2.0
SEED: Final = 1


def noise_share(found: Fit, dives: Sequence[DiveInnovations]) -> Floats:
    """Return the share of the squares of the derivatives that is noise of the IMU, dive by dive, (n, 8).

    A dive without motion determines nothing.
    """
    shares = np.zeros((len(dives), OWN))
    for i, (dive, near) in enumerate(zip(dives, found.dives, strict=True)):
        imu = dive.dive.imu
        noise = dive.filter.inertial_noise
        rng = np.random.default_rng(SEED)
        # The noise is common to all dives; the scatter of the innovations shows a noisier one.
        times = max(1.0, float(np.sqrt(np.mean(near.scatter**2))))
        root_s = np.sqrt(imu.usual_step_s)
        shape = imu.specific_force_b.shape
        shown = HIDDEN * readings_scatter(imu.angular_rate_b, imu.usual_step_s)
        accel_mps2 = times * noise.accel_white_mps_rts / root_s
        gyro_radps = min(times * noise.gyro_white_rad_rts, shown) / root_s
        force_b = imu.specific_force_b + accel_mps2 * rng.standard_normal(shape)
        noisier = _with_imu(
            dive, force_b, imu.angular_rate_b + gyro_radps * rng.standard_normal(shape)
        )
        added = (
            noisier.jacobian(found.change(i), found.free) / near.scatter[:, None] - near.jacobian
        )
        own = np.einsum("ka,kai->i", near.weights, added**2)
        whole = np.einsum("ka,kai->i", near.weights, near.jacobian**2)
        shares[i] = own / np.maximum(whole, np.finfo(float).tiny)
    return shares


def seen_by_motion(smallest: Fit, dives: Sequence[DiveInnovations], noise_shares: Floats) -> Fit:
    """Move the fit from the smallest innovations to those that are not correlated with the vehicle's motion."""
    near_by_motion = []
    for i, (dive, near) in enumerate(zip(dives, smallest.dives, strict=True)):
        imu = dive.dive.imu
        noisy = noise_shares[i] > LITTLE
        slow_force_b = averaged(imu.specific_force_b, imu.usual_step_s)
        slow_rate_b = averaged(imu.angular_rate_b, imu.usual_step_s)
        slow = _with_imu(dive, slow_force_b, slow_rate_b)
        jacobian = slow.jacobian(smallest.change(i), smallest.free & noisy)
        by_motion = np.where(noisy, jacobian / near.scatter[:, None], near.jacobian)
        near_by_motion.append(replace(near, by_motion=by_motion * (noise_shares[i] <= MOSTLY)))
    here = replace(smallest, dives=tuple(near_by_motion))
    values = here.values + here.step
    values[OWN - 1 :] = np.clip(values[OWN - 1 :], -LATEST_S, LATEST_S)
    there = []
    for near, rows, dive in zip(here.dives, smallest.rows, dives, strict=True):
        there.append(replace(near, residuals=dive.residuals(values[rows])))
    return replace(here, values=values, dives=tuple(there))


def _with_imu(dive: DiveInnovations, force_b: Floats, rate_b: Floats) -> DiveInnovations:
    return replace(
        dive, dive=replace(dive.dive, imu=ImuColumns(dive.dive.imu.time_ns, force_b, rate_b))
    )


def averaged(readings: Floats, step_s: float) -> Floats:
    """Average readings over `MOTION_S` around each, (k, 3)."""
    half = int(0.5 * MOTION_S / step_s)
    padded = np.pad(readings, ((half, half), (0, 0)), mode="edge")
    share = np.full(2 * half + 1, 1.0 / (2 * half + 1))
    return np.column_stack([np.convolve(axis, share, mode="valid") for axis in padded.T])


# --- Errors of beams and of the IMU that look like the geometry of the DVL.
#
# A beam with a scale error turns and stretches the velocity, and so does an IMU whose axes are not at right angles.
# These errors are not corrected. Their effect counts in the standard deviations of the estimate. For the IMU, the
# effect is found as if its errors were estimated together with the geometry. Source: Schmidt, "Application of
# state-space methods to navigation problems", 1966 ("consider" parameters).

# of a beam's constant offset. Makers of DVLs give 1 mm/s and 0.2 % or more.
OFFSET_SD_MPS: Final = 0.001
STRETCH_SD: Final = 0.002  # of a beam's scale
# Tactical sensors have 300 to 500 ppm by their data sheets (Sensonor STIM300), smaller ones 0.1 to 0.5 %.
IMU_SCALE_SD: Final = 1.5e-3
# rad, of each axis of a triad towards each other one, by the same data sheet
IMU_MISALIGNMENT_SD: Final = 1e-3
STEP: Final = 3.0  # of differences, in these standard deviations
BEAM_ERRORS: Final = 2 * len(beam_vectors())


def effects_of_errors(fit: Fit, dives: Sequence[DiveInnovations]) -> list[Floats]:
    """Return the change of the residuals with each error of one sd, over their scatter, (k, 3, 26) of each dive.

    First the offsets and the scales of the usual four beams at 30 deg, then the IMU.
    """
    found = []
    for i, (dive, near) in enumerate(zip(dives, fit.dives, strict=True)):
        shaken = parallel_map(
            partial(DiveInnovations.residuals, change=fit.change(i)), _with_errors(dive)
        )
        effects = [(residuals - near.residuals) / (STEP * near.scatter) for residuals in shaken]
        found.append(np.stack(effects, axis=-1))
    return found


def _with_errors(dive: DiveInnovations) -> Iterator[DiveInnovations]:
    """Return the dive with one error after the other, each of `STEP` standard deviations."""
    mat_bd = dive.prepared.mounting.mat_bd
    beams = beam_vectors()
    velocities = dive.prepared.velocities
    seen_mps = velocities.velocity_b @ mat_bd @ beams.T
    per_beam_b = mat_bd @ np.linalg.pinv(beams)
    for errors_mps in (np.full_like(seen_mps, OFFSET_SD_MPS), STRETCH_SD * seen_mps):
        for beam in range(len(beams)):
            moved_b = velocities.velocity_b + STEP * np.outer(
                errors_mps[:, beam], per_beam_b[:, beam]
            )
            yield replace(
                dive,
                prepared=replace(
                    dive.prepared, velocities=replace(velocities, velocity_b=moved_b)
                ),
            )
    # Each axis of the accelerometers reads a part of each axis, then each of the gyros.
    imu = dive.dive.imu
    for name in ("specific_force_b", "angular_rate_b"):
        for row, column in np.ndindex(3, 3):
            sd = IMU_SCALE_SD if row == column else IMU_MISALIGNMENT_SD
            readings = getattr(imu, name).copy()
            readings[:, row] += STEP * sd * getattr(imu, name)[:, column]
            yield replace(dive, dive=replace(dive.dive, imu=replace(imu, **{name: readings})))


def with_estimated_imu_errors(fit: Fit, effects: Sequence[Floats]) -> Fit:
    """Return the fit with the derivatives that remain if the errors of the IMU are estimated with the geometry.

    Its step leads to the result of such an estimate. The step is not taken, because innovations that are correlated for
    another reason look like these errors. It counts in the standard deviations.
    """
    left = []
    for near, moved in zip(fit.dives, effects, strict=True):
        imu = moved[:, :, BEAM_ERRORS:]
        weighted = near.weights[:, :, None] * imu
        information = np.einsum("kai,kaj->ij", weighted, imu) + np.eye(imu.shape[2])
        explained = np.linalg.solve(
            information, np.einsum("kai,kaj->ij", weighted, near.by_motion)
        )
        left.append(replace(near, by_motion=near.by_motion - imu @ explained))
    return replace(fit, dives=tuple(left))


def pulled(fit: Fit, effects: Sequence[Floats]) -> Floats:
    """Return how far each error of one sd, the same in all dives, pulls the answer, (count, 26)."""
    pull = np.zeros((len(fit.values), effects[0].shape[2]))
    for rows, near, moved in zip(fit.rows, fit.dives, effects, strict=True):
        pull[rows] -= np.einsum("ka,kai,kaj->ij", near.weights**3, near.by_motion, moved)
    pull[~fit.is_free] = 0.0
    return np.asarray(fit.moved_by_scores @ pull)


def nis_by_errors(fit: Fit, effects: Sequence[Floats]) -> float:
    """Return the part of the summed NIS of all dives that these errors explain."""
    total = 0.0
    for near, moved in zip(fit.dives, effects, strict=True):
        weighted = near.weights[:, :, None] * moved
        cov = np.linalg.inv(np.einsum("kai,kaj->ij", weighted, moved) + np.eye(moved.shape[2]))
        likeliest = cov @ np.einsum("kai,ka->i", weighted, near.scaled)
        power = (moved @ likeliest) ** 2 + np.einsum("kai,ij,kaj->ka", moved, cov, moved)
        total += float(np.sum(power * near.scatter**2))
    return total
