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
from insdvl_replay.core.units import unit_of_name
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
    fitted: FittedNoise,
    key: str,
    status: Estimated,
    why: str = "",
    sd: float | None = None,
) -> NoiseRow:
    """Return the row of one noise; the sd is None if the innovations do not bound it."""
    before = fitted.before[key]
    after = fitted.after[key]
    return NoiseRow(
        key,
        unit_of_name(key),
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
    [dvl_key] = [key for key in DVL if key in noise]
    dvl = DvlNoise(dvl_key, noise[dvl_key])
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
        noise = {}
        for (key, value), factor in zip(self.before.items(), factors, strict=True):
            noise[key] = float(value * factor)
        return noise

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
    pairs = []
    for search in searches:
        for factors in STARTS:
            pairs.append((search, np.log(factors)))
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
        sizes = np.concatenate([_sizes(found) for found in innovations])
        factor += 0.5 * float(np.log(np.mean(sizes)))
    after = dict(fitted.after)
    scaled = search.noise(factor * free)
    for key, is_free in zip(scaled, free, strict=True):
        if is_free:
            after[key] = float(f"{scaled[key]:.{DIGITS}g}")
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
    information = RIDGE * np.eye(3)
    scatter = np.zeros((3, 3))
    for scores in _scores(search):
        information += scores.T @ scores
        scatter += newey_west(scores)
    inverse = np.linalg.inv(information)
    by_chance = np.sqrt(np.maximum(np.diag(inverse @ scatter @ inverse), np.diag(inverse)))
    return np.asarray(np.hypot(by_chance, 0.5 * nis_by_errors * np.diag(inverse)))


def _scores(search: _Search) -> list[Floats]:
    """Return for each dive the scores of its pings, (k, 3): minus half the derivative of their costs."""
    by_noise = []
    for step in SCORE_STEP * np.eye(3):
        louder = search.innovations(search.noise(step))
        quieter = search.innovations(search.noise(-step))
        of_dives = []
        for after, before in zip(louder, quieter, strict=True):
            of_dives.append((_costs(before) - _costs(after)) / (4.0 * SCORE_STEP))
        by_noise.append(of_dives)
    return [np.array(of_dive).T for of_dive in zip(*by_noise, strict=True)]


@dataclass(frozen=True)
class _Status:
    """What becomes of one noise, and why."""

    word: Estimated
    why: str = ""


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
    impossible = _impossible(fitted.after, dives)
    is_drowned = nis_by_errors > MOST_BY_ERRORS * 3 * sum(dive.count for dive in dives)
    statuses = {
        key: _status_of(key, fitted, sds[key], impossible, own, is_drowned=is_drowned)
        for key in fitted.after
    }
    # Where one noise is impossible, nothing is determined: what is left is scaled, with the others as configured.
    scaled_status = Estimated.NOT_DETERMINED if impossible else Estimated.ESTIMATED
    scaled = [key for key, status in statuses.items() if status.word == scaled_status]
    proposed = fitted
    if len(scaled) < len(statuses):
        proposed = _scaled_alone(fitted, scaled, dives, changes)
    kept = proposed
    if impossible:
        is_limit = not _changes_impossibly(proposed, dives)
        if not is_limit:
            kept = FittedNoise(fitted.before, fitted.before)
    else:
        is_limit = proposed is not fitted and _contradicts(proposed, fitted, dives, changes)
        if is_limit:
            kept = fitted
    if is_limit:
        kept, limits = _limits(kept, statuses, dives, changes)
        statuses |= limits
    return kept, _noise_rows(kept, fitted, statuses, sds)


def _status_of(
    key: str,
    fitted: FittedNoise,
    sd: float,  # of its logarithm
    impossible: Mapping[str, str],
    own: Filter,
    *,
    is_drowned: bool,  # by errors of beams and IMU
) -> _Status:
    """Judge one noise, and the others by which it would be pulled."""
    if _has_own(own, key):
        return _Status(Estimated.HELD, OWN_NOISE)
    if key in impossible:
        why = f"{fitted.after[key]:g} {unit_of_name(key)} was found, which is {impossible[key]}"
        return _Status(Estimated.IMPLAUSIBLE, why)
    is_sure = sd < UNSURE and not (is_drowned and key in INERTIAL)
    if impossible or not is_sure:
        return _Status(Estimated.NOT_DETERMINED, AS_IT_WAS)
    return _Status(Estimated.ESTIMATED)


def _impossible(noise: Mapping[str, float], dives: Sequence[DiveInnovations]) -> dict[str, str]:
    """Return for each noise that no sensor has what it is."""
    found = {}
    for key, value in noise.items():
        what = beyond_the_sensor(key, value, _scatter(key, dives))
        if what:
            found[key] = what
    return found


def _has_own(own: Filter, key: str) -> bool:
    """Return whether a filter sets a noise itself: its keys override those of the common sections."""
    names = (key,) if key in INERTIAL else DVL
    return any(getattr(own, name) is not None for name in names)


def _scaled_alone(
    fitted: FittedNoise,
    keys: Sequence[str],
    dives: Sequence[DiveInnovations],
    changes: Sequence[Floats],
) -> FittedNoise:
    """Scale some noise, with the others as configured."""
    noise = dict(fitted.before)
    for key in keys:
        noise[key] = fitted.after[key]
    free = np.array([float(key in keys) for key in noise])
    return levelled(FittedNoise(fitted.before, noise), dives, changes, free)


def _changes_impossibly(proposed: FittedNoise, dives: Sequence[DiveInnovations]) -> bool:
    """Return whether a noise would become one that no sensor has."""
    impossible = _impossible(proposed.after, dives)
    return any(proposed.after[key] != proposed.before[key] for key in impossible)


def _contradicts(
    proposed: FittedNoise,
    fitted: FittedNoise,
    dives: Sequence[DiveInnovations],
    changes: Sequence[Floats],
) -> bool:
    """Return whether the dives contradict a noise that keeps some as configured."""
    if _changes_impossibly(proposed, dives):
        return True
    search = _Search.of(fitted.before, dives, changes)
    return search.likelihood(proposed.after) > search.likelihood(fitted.after) + CONTRADICTED


def _limits(
    kept: FittedNoise,
    statuses: Mapping[str, _Status],
    dives: Sequence[DiveInnovations],
    changes: Sequence[Floats],
) -> tuple[FittedNoise, dict[str, _Status]]:
    """Make noise that is not determined an upper limit, and that of the IMU the noise of its class."""
    unknown = [key for key, status in statuses.items() if status.word == Estimated.NOT_DETERMINED]
    limits = dict.fromkeys(unknown, _Status(Estimated.NOT_DETERMINED, AT_MOST))
    of_imu = [key for key in unknown if key in INERTIAL]
    if of_imu:
        preset = _class_of(kept, of_imu, dives)
        kept = _with_class(kept, of_imu, preset, dives, changes)
        of_class = _Status(Estimated.OF_CLASS, OF_CLASS.format(preset=preset))
        for key in of_imu:
            if kept.after[key] == kept.before[key]:
                limits[key] = _Status(Estimated.NOT_DETERMINED, AS_IT_WAS)
            else:
                limits[key] = of_class
    return kept, limits


def _scatter(key: str, dives: Sequence[DiveInnovations]) -> float:
    """Return the largest scatter of the readings that a noise is of; 0 for that of the DVL."""
    if key not in INERTIAL:
        return 0.0
    imus = [dive.dive.imu for dive in dives]
    return max(readings_scatter(getattr(imu, INERTIAL[key]), imu.usual_step_s) for imu in imus)


def _noise_rows(
    kept: FittedNoise,
    fitted: FittedNoise,
    statuses: Mapping[str, _Status],
    sds: Mapping[str, float],
) -> tuple[NoiseRow, ...]:
    """Return a row for each noise, with its standard deviation where the dives show one."""
    rows = []
    for key, status in statuses.items():
        sd = None
        if sds[key] < UNBOUNDED:
            sd = float(f"{sds[key] * fitted.after[key]:.2g}")
        rows.append(noise_row(kept, key, status.word, status.why, sd))
    return tuple(rows)


def _class_of(found: FittedNoise, keys: Sequence[str], dives: Sequence[DiveInnovations]) -> str:
    """Return the preset of the class of an IMU by upper limits of its noise, and by the scatter of its readings."""
    by_readings = max((imu_class(dive.dive.imu) for dive in dives), key=GRADES.index)
    limits = [sensor_class(key, found.after[key]) or by_readings for key in keys]
    by_limits = max(limits, key=GRADES.index)
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
    are_of_dvl = np.array([float(key in DVL) for key in found.after])
    raised = levelled(with_class, dives, changes, are_of_dvl)
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
    return np.asarray(
        innovations.log_det[SKIPPED:-SKIPPED] + innovations.dof * _sizes(innovations)
    )


def _sizes(innovations: Innovations) -> Floats:
    """Return NIS over degrees of freedom, weighted."""
    weighted = (innovations.nis * innovations.weight)[SKIPPED:-SKIPPED]
    return np.asarray(weighted / innovations.dof)
