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

from insdvl_replay.calibration.innovations import SKIPPED, DiveInnovations
from insdvl_replay.calibration.rows import NoiseRow
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.history import Innovations
from insdvl_replay.core.runtime import each
from insdvl_replay.core.words import Estimated
from insdvl_replay.evaluation.sensor_classes import CLASSES, beyond_the_sensor, readings_scatter, sensor_class
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

    A DVL that gives its beams may have the noise of one beam in place of one that is alike along all axes, if that is
    likelier.

    Parameters
    ----------
    dives : sequence of DiveInnovations
        Of one vehicle.
    changes : sequence of ndarray, shape (8,)
        How the DVL is built in, dive by dive.
    """
    runs = _runs(dives, changes)
    searches = [_Search(dives[0].gated, before, runs) for before in _sayable(dives)]
    search, start = min(
        ((search, np.log(start)) for search in searches for start in STARTS), key=lambda pair: pair[0].cost(pair[1])
    )
    found = search.likeliest(start)
    return FittedNoise(search.before, search.noise(found))


def levelled(fitted: FittedNoise, dives: Sequence[DiveInnovations], changes: Sequence[Floats]) -> FittedNoise:
    """Make all noise larger or smaller alike, until the innovations are as large as it says, as it is judged.

    What a gate keeps out is constant in the likelihood, and counts in the mean NIS. Parameters are those of
    `fit_noise`; what is returned has `DIGITS`.
    """
    search = _Search(dives[0].gated, fitted.after, _runs(dives, changes))
    factor = 0.0
    for _ in range(LEVELLINGS):
        sizes = np.concatenate([_sizes(of_dive) for of_dive in search.innovations(np.full(3, factor))])
        factor += 0.5 * float(np.log(np.mean(sizes)))
    after = search.noise(np.full(3, factor))
    return FittedNoise(fitted.before, {key: float(f"{value:.{DIGITS}g}") for key, value in after.items()})


def _runs(dives: Sequence[DiveInnovations], changes: Sequence[Floats]) -> list[Callable[[ResolvedFilter], Innovations]]:
    return [dive.runner(change) for dive, change in zip(dives, changes, strict=True)]


def _sayable(dives: Sequence[DiveInnovations]) -> Iterator[dict[str, float]]:
    """Return the noise as the baseline has it, with that of the DVL in each key that can hold it."""
    baseline = dives[0].filter
    before = noise_of(baseline)
    yield before
    if baseline.dvl_noise.key != "beam_sd_mps" and all(dive.prepared.velocities.from_beams for dive in dives):
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
        return list(each(lambda run: run(tried), self.runs))

    def cost(self, logarithms: Floats) -> float:
        likelihood = sum(_cost(of_dive) for of_dive in self.innovations(logarithms))
        return round(likelihood + float(np.sum((logarithms / np.log(PRIOR_FACTOR)) ** 2)), LIKELIHOOD_DIGITS)

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


def _cost(innovations: Innovations) -> float:
    """Return minus twice the log-likelihood, but for a constant."""
    log_det = innovations.log_det[SKIPPED:-SKIPPED]
    total = float(np.sum(log_det) + innovations.dof * np.sum(_sizes(innovations)))
    return total if np.isfinite(total) else np.finfo(float).max


def _sizes(innovations: Innovations) -> Floats:
    """Return NIS over degrees of freedom, as much of each as counts."""
    weighted = (innovations.nis * innovations.weight)[SKIPPED:-SKIPPED]
    return np.asarray(weighted / innovations.dof)


def noise_rows(
    fitted: FittedNoise, dives: Sequence[DiveInnovations], config: Config, *, asked: bool, held: str = ""
) -> Iterator[NoiseRow]:
    """Lay out what is proposed of the noise, and whether it can be a sensor's.

    Parameters
    ----------
    held : str
        Why none of it is proposed; empty where it may be.
    """
    own = config.filters[config.baseline]
    for key, value in fitted.after.items():
        is_own = any(getattr(own, name) is not None for name in _hiding(key))
        why_held = held or (OWN_NOISE if is_own else "")
        proposed = Estimated.HELD if why_held else Estimated.ESTIMATED
        scatter = max(_scatter(key, dive) for dive in dives)
        yield NoiseRow(
            key,
            UNITS[key],
            fitted.before[key],
            value,
            sensor_class(key, value) if key in INERTIAL else "",
            proposed if asked else Estimated.NOT_ASKED,
            why_held or beyond_the_sensor(key, value, scatter),
        )


def _hiding(key: str) -> tuple[str, ...]:
    """Name the keys of a filter that go before this one of the common sections."""
    return (key,) if key in INERTIAL else ("velocity_sd_mps", "beam_sd_mps")


def _scatter(key: str, dive: DiveInnovations) -> float:
    imu = dive.dive.imu
    if key not in INERTIAL:
        return 0.0
    readings = imu.specific_force_b if key == INERTIAL[0] else imu.angular_rate_b
    return readings_scatter(readings, imu.usual_step_s)


def noise_doubts(rows: Sequence[NoiseRow]) -> Iterator[str]:
    """State which noise stands for something else than its sensor's."""
    for row in rows:
        if row.status == Estimated.ESTIMATED and row.why:
            yield (
                f"{row.parameter} = {row.after:g} is {row.why}: vibration, stamps that jitter, or what is left of "
                f"geometry and time stands in it for the {CLASSES[row.parameter].name}' own"
            )
