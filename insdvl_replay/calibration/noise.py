"""How noisy the sensors are, by the innovations that are left once it is known how the DVL is built in.

Of three numbers, the white noise of accelerometers, gyros and DVL, those are taken under which the innovations of the
baseline are most likely. What the innovations do not tell stays near what is configured, which is a measurement, too: a
noise of `PRIOR_FACTOR` times as much lies one standard deviation away. The gate is the baseline's own, and one beyond
it counts as much as the gate is, as `evaluation.consistency` has it. Source: Schweppe, "Evaluation of likelihood
functions for Gaussian signals", 1965.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import msgspec
import numpy as np

from insdvl_replay.calibration.certainty import newey_west
from insdvl_replay.calibration.innovations import SKIPPED, DiveInnovations
from insdvl_replay.calibration.rows import NoiseRow
from insdvl_replay.core.config import Filter
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.history import Innovations
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.core.words import Estimated
from insdvl_replay.evaluation.notes import beyond_the_sensor, readings_scatter, sensor_class
from insdvl_replay.preparation.filters import DvlNoise, ResolvedFilter

# What is fitted of the inertial sensors, and the readings in which it is.
INERTIAL: Final = {"accel_white_mps_rts": "specific_force_b", "gyro_white_rad_rts": "angular_rate_b"}
# Of each axis of a velocity, or of one beam.
DVL: Final[tuple[Literal["velocity_sd_mps", "beam_sd_mps"], ...]] = ("velocity_sd_mps", "beam_sd_mps")
UNITS: Final = {
    "accel_white_mps_rts": "m/s/sqrt(s)",
    "gyro_white_rad_rts": "rad/sqrt(s)",
    "velocity_sd_mps": "m/s",
    "beam_sd_mps": "m/s",
}
PRIOR_FACTOR: Final = 3.0
LARGEST_FACTOR: Final = 1e3
# Factors of which the likeliest is the start, for a search from one place finds the nearest cause; order as of
# `noise_of`.
STARTS: Final = ((1.0, 1.0, 1.0), (0.1, 1.0, 0.3), (0.02, 1.0, 0.3), (0.1, 10.0, 0.3), (1.0, 10.0, 0.3))
FIRST_STEP: Final = -0.7
DIGITS: Final = 3  # of a noise; none is known so well, and further ones would differ from processor to processor
LIKELIHOOD_DIGITS: Final = 2
LEVELLINGS: Final = 3
ALL_FREE: Final = np.ones(3)
SCORE_STEP: Final = 0.2  # of differences, in the logarithm of a noise
RIDGE: Final = 1e-6  # of the information on a logarithm: it is known to be below a thousand
# Standard deviation of the logarithm of a noise from which it is not determined: two of them are a factor of two.
UNSURE: Final = 0.35
# Share of the NIS that slow errors of beams and IMU explain, beyond which noise of the IMU is not told from them.
MOST_BY_ERRORS: Final = 0.1
UNBOUNDED: Final = 3.0  # standard deviation of the logarithm beyond which none is given
# Minus twice the log-likelihood by which a noise that is kept may be less likely: three standard deviations.
CONTRADICTED: Final = 9.0
AS_IT_WAS: Final = "not determined by these dives, and stays as it was"
AT_MOST: Final = "not determined by these dives: at most this, for what is configured contradicts them"
OWN_NOISE: Final = "the baseline has noise of its own, which no other file can change"
NO_GEOMETRY: Final = "nothing showed how the DVL is built in, and what is wrong there would be taken for noise"


@dataclass(frozen=True)
class FittedNoise:
    """Noise by its keys, SI: as the baseline has it, and as its innovations are likeliest."""

    before: Mapping[str, float]
    after: Mapping[str, float]

    def applied(self, dive: DiveInnovations) -> DiveInnovations:
        """Let the filter of a dive take its sensors to be so noisy."""
        return replace(dive, filter=_with_noise(dive.filter, self.after))


def noise_row(fitted: FittedNoise, key: str, status: Estimated, why: str = "", sd: float | None = None) -> NoiseRow:
    """Return what becomes of one noise; the sd is None where the innovations do not bound it."""
    before, after = fitted.before[key], fitted.after[key]
    return NoiseRow(
        key, UNITS[key], before, after, sd, sensor_class(key, after) if key in INERTIAL else "", status, why
    )


def noise_of(baseline: ResolvedFilter) -> dict[str, float]:
    """Return what is fitted, by key, as a filter has it. The DVL's noise stands in one of two keys."""
    dvl = baseline.dvl_noise
    return {key: getattr(baseline.inertial_noise, key) for key in INERTIAL} | {dvl.key: dvl.sd_mps}


def _with_noise(baseline: ResolvedFilter, noise: Mapping[str, float]) -> ResolvedFilter:
    inertial = msgspec.structs.replace(baseline.inertial_noise, **{key: noise[key] for key in INERTIAL})
    (dvl,) = (DvlNoise(key, noise[key]) for key in DVL if key in noise)
    return replace(baseline, inertial_noise=inertial, dvl_noise=dvl)


@dataclass(frozen=True)
class _Search:
    """A search for the logarithms, (3,), of factors of the noise that was configured."""

    filter: ResolvedFilter
    before: Mapping[str, float]
    runs: Sequence[Callable[[ResolvedFilter], Innovations]]  # of each dive

    @staticmethod
    def of(before: Mapping[str, float], dives: Sequence[DiveInnovations], changes: Sequence[Floats]) -> "_Search":
        """Search around a noise, with dives whose geometries are changed, (8,) each."""
        runs = [dive.runner(change) for dive, change in zip(dives, changes, strict=True)]
        return _Search(dives[0].gated, before, runs)

    def noise(self, logarithms: Floats) -> dict[str, float]:
        factors = np.exp(np.clip(logarithms, -np.log(LARGEST_FACTOR), np.log(LARGEST_FACTOR)))
        return {key: float(value * factor) for (key, value), factor in zip(self.before.items(), factors, strict=True)}

    def innovations(self, noise: Mapping[str, float]) -> list[Innovations]:
        tried = _with_noise(self.filter, noise)
        return list(parallel_map(lambda run: run(tried), self.runs))

    def likelihood(self, noise: Mapping[str, float]) -> float:
        """Return minus twice the log-likelihood, but for a constant."""
        total = sum(float(np.sum(_costs(innovations))) for innovations in self.innovations(noise))
        return total if np.isfinite(total) else np.finfo(float).max

    def cost(self, logarithms: Floats) -> float:
        prior = float(np.sum((logarithms / np.log(PRIOR_FACTOR)) ** 2))
        return round(self.likelihood(self.noise(logarithms)) + prior, LIKELIHOOD_DIGITS)


def fit_noise(dives: Sequence[DiveInnovations], changes: Sequence[Floats]) -> FittedNoise:
    """Find the noise under which the innovations of all dives together are likeliest.

    The DVL may have the noise of one beam in place of one that is alike along all axes, if that is likelier.
    """
    from scipy.optimize import minimize  # a third of a second

    baseline = dives[0].filter
    first = _Search.of(noise_of(baseline), dives, changes)
    searches = [first]
    if baseline.dvl_noise.key != "beam_sd_mps":
        inertial = {key: first.before[key] for key in INERTIAL}
        of_beam = baseline.beam_sd_mps(dives[0].prepared.velocities)
        searches.append(replace(first, before=inertial | {"beam_sd_mps": of_beam}))
    pairs = [(search, np.log(start)) for search in searches for start in STARTS]
    search, start = min(pairs, key=lambda pair: pair[0].cost(pair[1]))
    simplex = start + np.vstack([np.zeros(3), FIRST_STEP * np.eye(3)])
    found = minimize(
        search.cost,
        start,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 0.05, "fatol": 0.2, "maxfev": 120},
    )
    return FittedNoise(search.before, search.noise(found.x))


def levelled(
    fitted: FittedNoise, dives: Sequence[DiveInnovations], changes: Sequence[Floats], free: Floats = ALL_FREE
) -> FittedNoise:
    """Scale all noise that is free alike, until the mean NIS is its degrees of freedom.

    What a gate rejects is constant in the likelihood, and counts in the mean NIS. The result has `DIGITS`.
    """
    search = _Search.of(fitted.after, dives, changes)
    factor = 0.0
    for _ in range(LEVELLINGS):
        innovations = search.innovations(search.noise(factor * free))
        factor += 0.5 * float(np.log(np.mean(np.concatenate([_sizes(found) for found in innovations]))))
    after = {
        key: float(f"{value:.{DIGITS}g}") if is_free else fitted.after[key]
        for (key, value), is_free in zip(search.noise(factor * free).items(), free, strict=True)
    }
    return FittedNoise(fitted.before, after)


def relative_sds(
    fitted: FittedNoise, dives: Sequence[DiveInnovations], changes: Sequence[Floats], nis_by_errors: float = 0.0
) -> Floats:
    """Return the standard deviation of the logarithm of each noise, (3,).

    The squares of the scores of the pings are the curvature of the likelihood; their sum scatters by their correlation.
    Errors of beams and of the IMU change slowly and look like noise, which falls as the noise of the filter grows.
    """
    search = _Search.of(fitted.after, dives, changes)
    steps = [sign * SCORE_STEP * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    beside = [search.innovations(search.noise(step)) for step in steps]
    information, scatter = RIDGE * np.eye(3), np.zeros((3, 3))
    for i in range(len(dives)):
        costs = np.array([_costs(innovations[i]) for innovations in beside])
        scores = (costs[1::2] - costs[::2]).T / (4.0 * SCORE_STEP)
        information += scores.T @ scores
        scatter += newey_west(scores)
    inverse = np.linalg.inv(information)
    by_chance = np.sqrt(np.maximum(np.diag(inverse @ scatter @ inverse), np.diag(inverse)))
    return np.asarray(np.hypot(by_chance, 0.5 * nis_by_errors * np.diag(inverse)))


def determined_noise(
    fitted: FittedNoise,
    dives: Sequence[DiveInnovations],
    changes: Sequence[Floats],
    nis_by_errors: float,
    own: Filter,  # the baseline as it is configured
) -> tuple[FittedNoise, tuple[NoiseRow, ...]]:
    """Propose the noise that the dives determine, and keep what is configured of the rest if they do not contradict it.

    A noise that no sensor has is held: something else is in it. The others are then scaled until the mean NIS is its
    degrees of freedom, and are limits.
    """
    sds = dict(zip(fitted.after, relative_sds(fitted, dives, changes, nis_by_errors), strict=True))
    scatter = {
        key: max(readings_scatter(getattr(dive.dive.imu, INERTIAL[key]), dive.dive.imu.usual_step_s) for dive in dives)
        if key in INERTIAL
        else 0.0
        for key in fitted.after
    }
    impossible = {key: beyond_the_sensor(key, value, scatter[key]) for key, value in fitted.after.items()}
    any_impossible = any(impossible.values())
    drowned = nis_by_errors > MOST_BY_ERRORS * 3 * sum(dive.count for dive in dives)
    statuses = dict.fromkeys(fitted.after, (Estimated.ESTIMATED, ""))
    for key, value in fitted.after.items():
        # The keys of a filter go before these of the common sections.
        if any(getattr(own, name) is not None for name in ((key,) if key in INERTIAL else DVL)):
            statuses[key] = Estimated.HELD, OWN_NOISE
        elif impossible[key]:
            statuses[key] = Estimated.IMPLAUSIBLE, f"{value:g} {UNITS[key]} was found, which is {impossible[key]}"
        elif any_impossible or not sds[key] < UNSURE or (drowned and key in INERTIAL):
            statuses[key] = Estimated.NOT_DETERMINED, AS_IT_WAS
    # Level what is proposed, beside the others as they are configured.
    levelled_status = Estimated.NOT_DETERMINED if any_impossible else Estimated.ESTIMATED
    free = np.array([float(status == levelled_status) for status, _ in statuses.values()])
    held = {key: fitted.after[key] if statuses[key][0] == levelled_status else fitted.before[key] for key in statuses}
    proposed = fitted if free.all() else levelled(FittedNoise(fitted.before, held), dives, changes, free)
    is_bad = any(
        beyond_the_sensor(key, value, scatter[key]) and value != fitted.before[key]
        for key, value in proposed.after.items()
    )
    if any_impossible:
        is_limit, kept = not is_bad, FittedNoise(fitted.before, fitted.before) if is_bad else proposed
    else:
        search = _Search.of(fitted.before, dives, changes)
        is_limit = not free.all() and (
            is_bad or search.likelihood(proposed.after) > search.likelihood(fitted.after) + CONTRADICTED
        )
        kept = fitted if is_limit else proposed
    rows = []
    for key, (status, why) in statuses.items():
        is_bound = is_limit and status == Estimated.NOT_DETERMINED
        sd = float(f"{sds[key] * fitted.after[key]:.2g}") if sds[key] < UNBOUNDED else None
        rows.append(noise_row(kept, key, status, AT_MOST if is_bound else why, sd))
    return kept, tuple(rows)


def nis_per_dof(dive: DiveInnovations, change: Floats) -> float:
    """Return the mean NIS over degrees of freedom with a changed geometry, behind the gate that is configured."""
    return float(np.mean(_sizes(dive.runner(change)(dive.gated))))


def _costs(innovations: Innovations) -> Floats:
    """Return minus twice the log-likelihood of each ping, but for a constant."""
    return np.asarray(innovations.log_det[SKIPPED:-SKIPPED] + innovations.dof * _sizes(innovations))


def _sizes(innovations: Innovations) -> Floats:
    """Return NIS over degrees of freedom, as much of each as counts."""
    weighted = (innovations.nis * innovations.weight)[SKIPPED:-SKIPPED]
    return np.asarray(weighted / innovations.dof)
