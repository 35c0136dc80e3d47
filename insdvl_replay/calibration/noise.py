"""How noisy the sensors are, by the innovations that are left once it is known how the DVL is built in.

Of three numbers, the white noise of accelerometers, gyros and DVL, those are taken under which the innovations of the
baseline are most likely. What the innovations do not tell stays near what is configured, which is a measurement, too: a
noise of `PRIOR_FACTOR` times as much lies one standard deviation away. The gate is the baseline's own, and one beyond
it counts as much as the gate is, as `evaluation.consistency` has it. Source: Schweppe, "Evaluation of likelihood
functions for Gaussian signals", 1965.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import msgspec
import numpy as np

from insdvl_replay.calibration.certainty import newey_west
from insdvl_replay.calibration.innovations import SKIPPED, DiveInnovations
from insdvl_replay.calibration.rows import NoiseRow
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.history import Innovations
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.core.words import Estimated
from insdvl_replay.evaluation.consistency import CLASSES, beyond_the_sensor, readings_scatter, sensor_class
from insdvl_replay.preparation.filters import DvlNoise, ResolvedFilter

INERTIAL: Final = ("accel_white_mps_rts", "gyro_white_rad_rts")
"""What is fitted of the inertial sensors."""
DVL: Final[tuple[Literal["velocity_sd_mps", "beam_sd_mps"], ...]] = ("velocity_sd_mps", "beam_sd_mps")
"""Of each axis of a velocity, or of one beam."""
UNITS: Final = {
    "accel_white_mps_rts": "m/s/sqrt(s)",
    "gyro_white_rad_rts": "rad/sqrt(s)",
    "velocity_sd_mps": "m/s",
    "beam_sd_mps": "m/s",
}
PRIOR_FACTOR: Final = 3.0
LARGEST_FACTOR: Final = 1e3
STARTS: Final = ((1.0, 1.0, 1.0), (0.1, 1.0, 0.3), (0.02, 1.0, 0.3), (0.1, 10.0, 0.3), (1.0, 10.0, 0.3))
"""Factors of which the likeliest is the start, for a search from one place finds the nearest cause; order as of
`noise_of`."""
FIRST_STEP: Final = -0.7
DIGITS: Final = 3
"""Of a noise; none is known so well, and further ones would differ from processor to processor."""
LIKELIHOOD_DIGITS: Final = 2
LEVELLINGS: Final = 3
ALL_FREE: Final = np.ones(3)
SCORE_STEP: Final = 0.2
"""Of differences, in the logarithm of a noise."""
RIDGE: Final = 1e-6
"""Of the information on a logarithm: it is known to be below a thousand."""
UNSURE: Final = 0.35
"""Standard deviation of the logarithm of a noise from which it is not determined: two of them are a factor of two."""
MOST_BY_ERRORS: Final = 0.1
"""Share of the NIS that slow errors of beams and IMU explain, beyond which noise of the IMU is not told from them."""
UNBOUNDED: Final = 3.0
"""Standard deviation of the logarithm beyond which none is given."""
CONTRADICTED: Final = 9.0
"""Minus twice the log-likelihood by which a noise that is kept may be less likely: three standard deviations."""
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


def noise_of(baseline: ResolvedFilter) -> dict[str, float]:
    """Return what is fitted, by key, as a filter has it. The DVL's noise stands in one of two keys."""
    dvl = baseline.dvl_noise
    return {key: getattr(baseline.inertial_noise, key) for key in INERTIAL} | {dvl.key: dvl.sd_mps}


def _with_noise(baseline: ResolvedFilter, noise: Mapping[str, float]) -> ResolvedFilter:
    inertial = msgspec.structs.replace(baseline.inertial_noise, **{key: noise[key] for key in INERTIAL})
    (dvl,) = (DvlNoise(key, noise[key]) for key in DVL if key in noise)
    return replace(baseline, inertial_noise=inertial, dvl_noise=dvl)


def fit_noise(dives: Sequence[DiveInnovations], changes: Sequence[Floats]) -> FittedNoise:
    """Find the noise under which the innovations of all dives together are likeliest.

    The DVL may have the noise of one beam in place of one that is alike along all axes, if that is likelier.
    """
    runs = _runs(dives, changes)
    searches = [_Search(dives[0].gated, before, runs) for before in _sayable(dives)]
    search, start = min(
        ((search, np.log(start)) for search in searches for start in STARTS), key=lambda pair: pair[0].cost(pair[1])
    )
    found = search.likeliest(start)
    return FittedNoise(search.before, search.noise(found))


def levelled(
    fitted: FittedNoise, dives: Sequence[DiveInnovations], changes: Sequence[Floats], free: Floats = ALL_FREE
) -> FittedNoise:
    """Scale all noise that is free alike, until the mean NIS is its degrees of freedom.

    What a gate rejects is constant in the likelihood, and counts in the mean NIS. The result has `DIGITS`.
    """
    search = _Search(dives[0].gated, fitted.after, _runs(dives, changes))
    factor = 0.0
    for _ in range(LEVELLINGS):
        sizes = np.concatenate([_sizes(of_dive) for of_dive in search.innovations(factor * free)])
        factor += 0.5 * float(np.log(np.mean(sizes)))
    after = {
        key: float(f"{value:.{DIGITS}g}") if is_free else fitted.after[key]
        for (key, value), is_free in zip(search.noise(factor * free).items(), free, strict=True)
    }
    return FittedNoise(fitted.before, after)


def relative_sds(
    fitted: FittedNoise, dives: Sequence[DiveInnovations], changes: Sequence[Floats], nis_by_errors: float = 0.0
) -> Floats:
    """Return the standard deviation of the logarithm of each noise, shape (3,).

    The squares of the scores of the pings are the curvature of the likelihood; their sum scatters by their correlation.
    Errors of beams and of the IMU change slowly and look like noise, which falls as the noise of the filter grows.
    """
    search = _Search(dives[0].gated, fitted.after, _runs(dives, changes))
    beside = [search.innovations(sign * SCORE_STEP * axis) for axis in np.eye(3) for sign in (1.0, -1.0)]
    information, scatter = RIDGE * np.eye(3), np.zeros((3, 3))
    for i in range(len(dives)):
        costs = np.array([_costs(innovations[i]) for innovations in beside])
        scores = (costs[1::2] - costs[::2]).T / (4.0 * SCORE_STEP)
        information += scores.T @ scores
        scatter += newey_west(scores)
    inverse = np.linalg.inv(information)
    by_chance = np.sqrt(np.maximum(np.diag(inverse @ scatter @ inverse), np.diag(inverse)))
    return np.asarray(np.hypot(by_chance, 0.5 * nis_by_errors * np.diag(inverse)))


def judged_noise(
    fitted: FittedNoise,
    dives: Sequence[DiveInnovations],
    changes: Sequence[Floats],
    nis_by_errors: float,
    config: Config,
) -> tuple[FittedNoise, tuple[NoiseRow, ...]]:
    """Propose the noise that the dives determine, and keep what is configured of the rest if they do not contradict it.

    A noise that no sensor has is held: something else is in it. The others are then scaled until the mean NIS is its
    degrees of freedom, and are limits.
    """
    own, search = config.filters[config.baseline], _Search(dives[0].gated, fitted.before, _runs(dives, changes))
    sds = dict(zip(fitted.after, relative_sds(fitted, dives, changes, nis_by_errors), strict=True))
    scatter = {key: max(_scatter(key, dive) for dive in dives) for key in fitted.after}
    impossible = {key: beyond_the_sensor(key, value, scatter[key]) for key, value in fitted.after.items()}
    drowned = nis_by_errors > MOST_BY_ERRORS * 3 * sum(dive.count for dive in dives)
    told = dict.fromkeys(fitted.after, (Estimated.ESTIMATED, ""))
    for key, value in fitted.after.items():
        # The keys of a filter go before these of the common sections.
        if any(getattr(own, name) is not None for name in ((key,) if key in INERTIAL else DVL)):
            told[key] = Estimated.HELD, OWN_NOISE
        elif impossible[key]:
            told[key] = Estimated.DOUBTFUL, f"{value:g} {UNITS[key]} was found, which is {impossible[key]}"
        elif any(impossible.values()) or not sds[key] < UNSURE or (drowned and key in INERTIAL):
            told[key] = Estimated.NOT_DETERMINED, AS_IT_WAS
    is_doubtful = any(impossible.values())
    fitted_alone = Estimated.NOT_DETERMINED if is_doubtful else Estimated.ESTIMATED
    free = np.array([float(status == fitted_alone) for status, _ in told.values()])
    of_each = zip(fitted.after.items(), free, strict=True)
    held = {key: value if is_free else fitted.before[key] for (key, value), is_free in of_each}
    proposed = fitted if free.all() else levelled(FittedNoise(fitted.before, held), dives, changes, free)
    is_bad = any(
        beyond_the_sensor(key, value, scatter[key]) and value != fitted.before[key]
        for key, value in proposed.after.items()
    )
    if is_doubtful:
        is_limit, kept = not is_bad, FittedNoise(fitted.before, fitted.before) if is_bad else proposed
    else:
        is_limit = not free.all() and (
            is_bad or search.likelihood(proposed.after) > search.likelihood(fitted.after) + CONTRADICTED
        )
        kept = fitted if is_limit else proposed
    if is_limit:
        limit = Estimated.NOT_DETERMINED, AT_MOST
        told = {key: limit if status == limit[0] else (status, why) for key, (status, why) in told.items()}
    return kept, noise_rows(kept, told, {key: sd * fitted.after[key] for key, sd in sds.items() if sd < UNBOUNDED})


def noise_rows(
    noise: FittedNoise, told: Mapping[str, tuple[Estimated, str]], sds: Mapping[str, float]
) -> tuple[NoiseRow, ...]:
    """Lay out the noise, with what is told of each key and its standard deviation."""
    return tuple(
        NoiseRow(
            key,
            UNITS[key],
            noise.before[key],
            value,
            float(f"{sds[key]:.2g}") if key in sds else None,
            sensor_class(key, value) if key in INERTIAL else "",
            *told[key],
        )
        for key, value in noise.after.items()
    )


def _runs(dives: Sequence[DiveInnovations], changes: Sequence[Floats]) -> list[Callable[[ResolvedFilter], Innovations]]:
    return [dive.runner(change) for dive, change in zip(dives, changes, strict=True)]


def _sayable(dives: Sequence[DiveInnovations]) -> Iterator[dict[str, float]]:
    """Return the noise as the baseline has it, with that of the DVL in each key that can hold it."""
    baseline = dives[0].filter
    before = noise_of(baseline)
    yield before
    if baseline.dvl_noise.key != "beam_sd_mps":
        of_beam = baseline.beam_sd_mps(dives[0].prepared.velocities)
        yield {key: before[key] for key in INERTIAL} | {"beam_sd_mps": of_beam}


@dataclass(frozen=True)
class _Search:
    """A search for the logarithms, shape (3,), of factors of the noise that was configured."""

    filter: ResolvedFilter
    before: Mapping[str, float]
    runs: Sequence[Callable[[ResolvedFilter], Innovations]]

    def noise(self, logarithms: Floats) -> dict[str, float]:
        factors = np.exp(np.clip(logarithms, -np.log(LARGEST_FACTOR), np.log(LARGEST_FACTOR)))
        return {key: float(value * factor) for (key, value), factor in zip(self.before.items(), factors, strict=True)}

    def innovations(self, logarithms: Floats) -> list[Innovations]:
        tried = _with_noise(self.filter, self.noise(logarithms))
        return list(parallel_map(lambda run: run(tried), self.runs))

    def likelihood(self, noise: Mapping[str, float]) -> float:
        """Return minus twice the log-likelihood, but for a constant."""
        tried = _with_noise(self.filter, noise)
        total = sum(float(np.sum(_costs(of_dive))) for of_dive in parallel_map(lambda run: run(tried), self.runs))
        return total if np.isfinite(total) else np.finfo(float).max

    def cost(self, logarithms: Floats) -> float:
        prior = float(np.sum((logarithms / np.log(PRIOR_FACTOR)) ** 2))
        return round(self.likelihood(self.noise(logarithms)) + prior, LIKELIHOOD_DIGITS)

    def likeliest(self, start: Floats) -> Floats:
        from scipy.optimize import minimize  # a third of a second

        simplex = start + np.vstack([np.zeros(3), FIRST_STEP * np.eye(3)])
        found: Floats = minimize(
            self.cost,
            start,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": 0.05, "fatol": 0.2, "maxfev": 120},
        ).x
        return found


def nis_per_dof(dive: DiveInnovations, change: Floats) -> float:
    """Return the mean NIS over degrees of freedom with a geometry, shape (8,), behind the gate that is configured."""
    return float(np.mean(_sizes(dive.runner(change)(dive.gated))))


def _costs(innovations: Innovations) -> Floats:
    """Return minus twice the log-likelihood of each ping, but for a constant."""
    return np.asarray(innovations.log_det[SKIPPED:-SKIPPED] + innovations.dof * _sizes(innovations))


def _sizes(innovations: Innovations) -> Floats:
    """Return NIS over degrees of freedom, as much of each as counts."""
    weighted = (innovations.nis * innovations.weight)[SKIPPED:-SKIPPED]
    return np.asarray(weighted / innovations.dof)


def _scatter(key: str, dive: DiveInnovations) -> float:
    imu = dive.dive.imu
    if key not in INERTIAL:
        return 0.0
    readings = imu.specific_force_b if key == INERTIAL[0] else imu.angular_rate_b
    return readings_scatter(readings, imu.usual_step_s)


def noise_doubts(rows: Sequence[NoiseRow]) -> Iterator[str]:
    """State which noise stands for something else than its sensor's."""
    for row in rows:
        if row.status == Estimated.DOUBTFUL:
            yield (
                f"{row.parameter}: {row.why}: vibration, stamps that jitter, or what is left of geometry and time "
                f"stands in it for the {CLASSES[row.parameter].name}' own; it is not proposed"
            )
