"""Noise of the sensors, from the innovations that remain after the DVL is calibrated.

The white noise of accelerometers, gyros and DVL is chosen for the highest likelihood of the baseline's innovations.
The configured noise is a prior: `PRIOR_FACTOR` times as much is one standard deviation away. So a noise that the
innovations do not determine stays near it. The gate is the baseline's; an innovation outside it counts as much as the
gate, as in `evaluation.consistency`. Source: Schweppe, "Evaluation of likelihood
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
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Floats, ImuColumns
from insdvl_replay.core.history import Innovations
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.core.words import Estimated
from insdvl_replay.evaluation.notes import beyond_the_sensor, readings_scatter, sensor_class
from insdvl_replay.preparation.filters import DvlNoise, ResolvedFilter

# Noise keys of the inertial sensors, and their readings.
INERTIAL: Final = {
    "accel_white_mps_rts": "specific_force_b",
    "gyro_white_rad_rts": "angular_rate_b",
}
GRADES: Final = ("fog", "tactical", "mems")  # presets from the quietest IMU to the noisiest
# For each axis of a velocity, or for one beam.
DVL: Final[tuple[Literal["velocity_sd_mps", "beam_sd_mps"], ...]] = (
    "velocity_sd_mps",
    "beam_sd_mps",
)
UNITS: Final = {
    "accel_white_mps_rts": "m/s/sqrt(s)",
    "gyro_white_rad_rts": "rad/sqrt(s)",
    "velocity_sd_mps": "m/s",
    "beam_sd_mps": "m/s",
}
PRIOR_FACTOR: Final = 3.0
LARGEST_FACTOR: Final = 1e3
# Start factors; the likeliest starts the search, since a search finds the nearest optimum. Order as in `noise_of`.
STARTS: Final = (
    (1.0, 1.0, 1.0),
    (0.1, 1.0, 0.3),
    (0.02, 1.0, 0.3),
    (0.1, 10.0, 0.3),
    (1.0, 10.0, 0.3),
)
FIRST_STEP: Final = -0.7
DIGITS: Final = 3  # of a noise; more would differ between processors
LIKELIHOOD_DIGITS: Final = 2
LEVELLINGS: Final = 3
ALL_FREE: Final = np.ones(3)
SCORE_STEP: Final = 0.2  # of differences, in the logarithm of a noise
RIDGE: Final = 1e-6  # of the information on a logarithm: it is known to be below a thousand
# Standard deviation of the logarithm from which a noise is not determined: two sds are a factor of two.
UNSURE: Final = 0.35
# Share of the NIS from slow errors of beams and IMU above which the noise of the IMU is not determined.
MOST_BY_ERRORS: Final = 0.1
UNBOUNDED: Final = 3.0  # standard deviation of the logarithm beyond which none is given
# Minus twice the log-likelihood by which a noise that is kept may be less likely: three standard deviations.
CONTRADICTED: Final = 9.0
AS_IT_WAS: Final = "cannot be determined from these dives; unchanged"
OF_CLASS: Final = (
    "cannot be determined from these dives; that of preset {preset}, the class of this IMU, as the configured value "
    "does not fit them"
)
AT_MOST: Final = (
    "cannot be determined from these dives; upper limit, as the configured value does not fit them"
)
OWN_NOISE: Final = (
    "[filters.NAME] of the baseline sets its own noise, which overrides [noise] and [dvl]"
)
NO_GEOMETRY: Final = (
    "the geometry of the DVL cannot be determined, and its errors would count as noise"
)


def imu_class(imu: ImuColumns) -> str:
    """Return the preset of the class of sensors that the readings of an IMU may come from, by their scatter."""
    names = []
    for key, field in INERTIAL.items():
        scatter = readings_scatter(getattr(imu, field), imu.usual_step_s)
        names.append((scatter > 0.0 and sensor_class(key, scatter)) or GRADES[-1])
    return max(names, key=GRADES.index)


def noise_class(key: str, value: float) -> str:
    """Name the class of sensors with a noise: the preset that has just this value, else by `sensor_class`.

    The presets cover more than the noise of their sensors.
    """
    for preset in GRADES:
        if getattr(load_config(preset).noise, key) == value:
            return preset
    return sensor_class(key, value)


@dataclass(frozen=True)
class FittedNoise:
    """Noise by its keys, SI: as configured, and with the highest likelihood of the innovations."""

    before: Mapping[str, float]
    after: Mapping[str, float]

    def applied(self, dive: DiveInnovations) -> DiveInnovations:
        """Return the dive with this noise in its filter."""
        return replace(dive, filter=_with_noise(dive.filter, self.after))


def noise_row(
    fitted: FittedNoise, key: str, status: Estimated, why: str = "", sd: float | None = None
) -> NoiseRow:
    """Return the row of one noise; the sd is None if the innovations do not bound it."""
    before = fitted.before[key]
    after = fitted.after[key]
    return NoiseRow(
        key,
        UNITS[key],
        before,
        after,
        sd,
        noise_class(key, after) if key in INERTIAL else "",
        status,
        why,
    )


def noise_of(baseline: ResolvedFilter) -> dict[str, float]:
    """Return the fitted noise of a filter by key. The DVL's noise has one of two keys."""
    dvl = baseline.dvl_noise
    return {key: getattr(baseline.inertial_noise, key) for key in INERTIAL} | {dvl.key: dvl.sd_mps}


def _with_noise(baseline: ResolvedFilter, noise: Mapping[str, float]) -> ResolvedFilter:
    inertial = msgspec.structs.replace(
        baseline.inertial_noise, **{key: noise[key] for key in INERTIAL}
    )
    (dvl,) = (DvlNoise(key, noise[key]) for key in DVL if key in noise)
    return replace(baseline, inertial_noise=inertial, dvl_noise=dvl)


@dataclass(frozen=True)
class _Search:
    """A search for the logarithms, (3,), of factors of the noise that was configured."""

    filter: ResolvedFilter
    before: Mapping[str, float]
    runs: Sequence[Callable[[ResolvedFilter], Innovations]]  # of each dive

    @staticmethod
    def of(
        before: Mapping[str, float], dives: Sequence[DiveInnovations], changes: Sequence[Floats]
    ) -> "_Search":
        """Search around a noise, with dives whose geometries are changed, (8,) each."""
        runs = [dive.runner(change) for dive, change in zip(dives, changes, strict=True)]
        return _Search(dives[0].gated, before, runs)

    def noise(self, logarithms: Floats) -> dict[str, float]:
        factors = np.exp(np.clip(logarithms, -np.log(LARGEST_FACTOR), np.log(LARGEST_FACTOR)))
        return {
            key: float(value * factor)
            for (key, value), factor in zip(self.before.items(), factors, strict=True)
        }

    def innovations(self, noise: Mapping[str, float]) -> list[Innovations]:
        tried = _with_noise(self.filter, noise)
        return list(parallel_map(lambda run: run(tried), self.runs))

    def likelihood(self, noise: Mapping[str, float]) -> float:
        """Return minus twice the log-likelihood, but for a constant."""
        total = sum(float(np.sum(_costs(innovations))) for innovations in self.innovations(noise))
        if np.isfinite(total):
            return total
        return np.finfo(float).max

    def cost(self, logarithms: Floats) -> float:
        prior = float(np.sum((logarithms / np.log(PRIOR_FACTOR)) ** 2))
        return round(self.likelihood(self.noise(logarithms)) + prior, LIKELIHOOD_DIGITS)


def fit_noise(dives: Sequence[DiveInnovations], changes: Sequence[Floats]) -> FittedNoise:
    """Find the noise under which the innovations of all dives together are likeliest.

    The DVL's noise may become that of one beam, if that is likelier than the same noise on all axes.
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
    fitted: FittedNoise,
    dives: Sequence[DiveInnovations],
    changes: Sequence[Floats],
    free: Floats = ALL_FREE,
) -> FittedNoise:
    """Scale all free noise by one factor, until the mean NIS is its degrees of freedom.

    Rejected innovations are constant in the likelihood, but count in the mean NIS. The result has `DIGITS` digits.
    """
    search = _Search.of(fitted.after, dives, changes)
    factor = 0.0
    for _ in range(LEVELLINGS):
        innovations = search.innovations(search.noise(factor * free))
        factor += 0.5 * float(
            np.log(np.mean(np.concatenate([_sizes(found) for found in innovations])))
        )
    after = {
        key: float(f"{value:.{DIGITS}g}") if is_free else fitted.after[key]
        for (key, value), is_free in zip(search.noise(factor * free).items(), free, strict=True)
    }
    return FittedNoise(fitted.before, after)


def relative_sds(
    fitted: FittedNoise,
    dives: Sequence[DiveInnovations],
    changes: Sequence[Floats],
    nis_by_errors: float = 0.0,
) -> Floats:
    """Return the standard deviation of the logarithm of each noise, (3,).

    The squares of the scores of the pings are the curvature of the likelihood; their sum scatters by their correlation.
    Errors of beams and of the IMU change slowly and look like noise, which falls as the noise of the filter grows.
    """
    search = _Search.of(fitted.after, dives, changes)
    steps = [sign * SCORE_STEP * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    stepped = [search.innovations(search.noise(step)) for step in steps]
    information = RIDGE * np.eye(3)
    scatter = np.zeros((3, 3))
    for i in range(len(dives)):
        costs = np.array([_costs(innovations[i]) for innovations in stepped])
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
    """Propose the noise that the dives determine; keep the configured noise otherwise, unless they contradict it.

    A noise that no sensor has is held: it has another cause. The others are then scaled until the mean NIS is its
    degrees of freedom. Noise that the dives contradict but do not determine is that of the class of the IMU, and of a
    DVL an upper limit.
    """
    sds = dict(zip(fitted.after, relative_sds(fitted, dives, changes, nis_by_errors), strict=True))
    scatter = {key: _scatter(key, dives) for key in fitted.after}
    impossible = {
        key: beyond_the_sensor(key, value, scatter[key]) for key, value in fitted.after.items()
    }
    any_impossible = any(impossible.values())
    drowned = nis_by_errors > MOST_BY_ERRORS * 3 * sum(dive.count for dive in dives)
    statuses = dict.fromkeys(fitted.after, (Estimated.ESTIMATED, ""))
    for key, value in fitted.after.items():
        # The keys of a filter override those of the common sections.
        if any(getattr(own, name) is not None for name in ((key,) if key in INERTIAL else DVL)):
            statuses[key] = Estimated.HELD, OWN_NOISE
        elif impossible[key]:
            statuses[key] = (
                Estimated.IMPLAUSIBLE,
                f"{value:g} {UNITS[key]} was found, which is {impossible[key]}",
            )
        elif any_impossible or not sds[key] < UNSURE or (drowned and key in INERTIAL):
            statuses[key] = Estimated.NOT_DETERMINED, AS_IT_WAS
    # Scale the proposed noise, with the others as configured.
    levelled_status = Estimated.NOT_DETERMINED if any_impossible else Estimated.ESTIMATED
    free = np.array([float(status == levelled_status) for status, _ in statuses.values()])
    held = {
        key: fitted.after[key] if statuses[key][0] == levelled_status else fitted.before[key]
        for key in statuses
    }
    proposed = (
        fitted if free.all() else levelled(FittedNoise(fitted.before, held), dives, changes, free)
    )
    is_bad = any(
        beyond_the_sensor(key, value, scatter[key]) and value != fitted.before[key]
        for key, value in proposed.after.items()
    )
    if any_impossible:
        is_limit = not is_bad
        kept = FittedNoise(fitted.before, fitted.before) if is_bad else proposed
    else:
        search = _Search.of(fitted.before, dives, changes)
        is_limit = not free.all() and (
            is_bad
            or search.likelihood(proposed.after) > search.likelihood(fitted.after) + CONTRADICTED
        )
        kept = fitted if is_limit else proposed
    unknown = [key for key, (status, _) in statuses.items() if status == Estimated.NOT_DETERMINED]
    if not is_limit:
        return kept, _noise_rows(kept, fitted, statuses, sds)
    for key in unknown:
        statuses[key] = Estimated.NOT_DETERMINED, AT_MOST
    of_imu = [key for key in unknown if key in INERTIAL]
    if of_imu:
        preset = _class_of(kept, of_imu, dives)
        kept = _with_class(kept, of_imu, preset, dives, changes)
        for key in of_imu:
            if kept.after[key] == kept.before[key]:
                statuses[key] = Estimated.NOT_DETERMINED, AS_IT_WAS
            else:
                statuses[key] = Estimated.OF_CLASS, OF_CLASS.format(preset=preset)
    return kept, _noise_rows(kept, fitted, statuses, sds)


def _scatter(key: str, dives: Sequence[DiveInnovations]) -> float:
    """Return the largest scatter of the readings that a noise is of; 0 for that of the DVL."""
    if key not in INERTIAL:
        return 0.0
    imus = [dive.dive.imu for dive in dives]
    return max(readings_scatter(getattr(imu, INERTIAL[key]), imu.usual_step_s) for imu in imus)


def _noise_rows(
    kept: FittedNoise,
    fitted: FittedNoise,
    statuses: Mapping[str, tuple[Estimated, str]],
    sds: Mapping[str, float],
) -> tuple[NoiseRow, ...]:
    """Return a row for each noise, with its standard deviation where the dives show one."""
    rows = []
    for key, (status, why) in statuses.items():
        sd = float(f"{sds[key] * fitted.after[key]:.2g}") if sds[key] < UNBOUNDED else None
        rows.append(noise_row(kept, key, status, why, sd))
    return tuple(rows)


def _class_of(found: FittedNoise, keys: Sequence[str], dives: Sequence[DiveInnovations]) -> str:
    """Return the preset of the class of an IMU by upper limits of its noise, and by the scatter of its readings."""
    by_readings = max((imu_class(dive.dive.imu) for dive in dives), key=GRADES.index)
    by_limits = max(
        (sensor_class(key, found.after[key]) or by_readings for key in keys), key=GRADES.index
    )
    return min(by_readings, by_limits, key=GRADES.index)


def _with_class(
    found: FittedNoise,
    keys: Sequence[str],
    preset: str,
    dives: Sequence[DiveInnovations],
    changes: Sequence[Floats],
) -> FittedNoise:
    """Give some noise of the IMU the values of its class, and the DVL more if the innovations are too large for them.

    The presets cover more than the sensors, so that a DVL fitted to what they leave would be too good.
    """
    usual = load_config(preset).noise
    of_class = {key: getattr(usual, key) for key in keys}
    with_class = FittedNoise(found.before, {**found.after, **of_class})
    raised = levelled(
        with_class, dives, changes, np.array([float(key in DVL) for key in found.after])
    )
    after = dict(with_class.after)
    for key in DVL:
        if key in after:
            after[key] = max(after[key], raised.after[key])
    return replace(with_class, after=after)


def nis_per_dof(dive: DiveInnovations, change: Floats) -> float:
    """Return the mean NIS over degrees of freedom with a changed geometry, with the configured gate."""
    return float(np.mean(_sizes(dive.runner(change)(dive.gated))))


def _costs(innovations: Innovations) -> Floats:
    """Return minus twice the log-likelihood of each ping, but for a constant."""
    return np.asarray(innovations.log_det[SKIPPED:-SKIPPED] + innovations.dof * _sizes(innovations))


def _sizes(innovations: Innovations) -> Floats:
    """Return NIS over degrees of freedom, weighted."""
    weighted = (innovations.nis * innovations.weight)[SKIPPED:-SKIPPED]
    return np.asarray(weighted / innovations.dof)
