"""Whether a filter's innovations are as large as it predicts, axis by axis, and white.

The chi-square interval and the verdict of a mean serve NIS here and NEES in `credibility` and `ensemble`. Source:
Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", chapter 5.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np
from scipy.special import betainc, chdtr, chdtri

from insdvl_replay.core.dive_columns import Floats, Mask
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.quantities import axis_of, is_reserved
from insdvl_replay.core.states import MORE_STATES, SENSORS
from insdvl_replay.core.tables import ConsistencyRow
from insdvl_replay.core.words import Consistency, Reason, Whiteness
from insdvl_replay.evaluation.series import samples_in_mean_square

CONFIDENCE: Final = 0.95  # Share of consistent filters whose mean is inside the interval.
# A NIS or NEES that is off by a smaller share means a standard deviation that is off by less than 5 %.
SMALL_EXCESS: Final = 0.1
FEWEST_UPDATES: Final = 10  # With fewer updates the verdict is ``insufficient data``.
MANY_REJECTED: Final = 0.1  # A gate that rejects more does not reject outliers but the DVL.
FEWEST_PAIRS: Final = 10  # With fewer pairs of neighbours: ``insufficient data``.
# A smaller correlation does not matter even if significant: the mean of such noise scatters by less than 11 % more, or
# 10 % less, than that of white noise.
SMALL_AUTOCORRELATION: Final = 0.1
NORMAL_95: Final = 1.96  # 95 % of a normal variable are within this number of standard deviations.
# Beyond these, over its degrees of freedom, a baseline is not fit to judge by. Innovations or errors three times as
# large as predicted come from wrong axes, units, clocks or noise.
LARGEST_PER_DOF: Final = 10.0
# With a noise variance that is ten times too large a filter is not the one that was tuned.
SMALLEST_PER_DOF: Final = 0.1


# --- The mean of a NIS or NEES, its chi-square interval and its verdict.


def chi_square_quantile(probability: float, dof: float) -> float:
    """Return the chi-square quantile of a probability; infinite for probability 1."""
    if probability >= 1.0:
        return float("inf")
    return float(chdtri(dof, 1.0 - probability))


def mean_interval(dof: int, count: float, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the two-sided interval of the mean of ``count`` chi-square variables.

    The sum of independent variables with ``dof`` degrees of freedom has ``count * dof`` of them. Of variables that
    depend on each other the count is the number of effective samples, which need not be whole.
    """
    tail = (1.0 - confidence) / 2.0
    low = chi_square_quantile(tail, count * dof) / count
    high = chi_square_quantile(1.0 - tail, count * dof) / count
    return low, high


def consistency_verdict(
    mean: float,
    low: float,
    high: float,
    dof: int,
) -> tuple[Consistency, Reason]:
    """Return the verdict on a mean NIS or NEES, with the reason if it differs from the interval."""
    if not np.isfinite(mean):
        return Consistency.NOT_FINITE, Reason.NONE
    if low <= mean <= high:
        return Consistency.CONSISTENT, Reason.NONE
    if abs(mean / dof - 1.0) <= SMALL_EXCESS:
        return Consistency.CONSISTENT, Reason.NEAR
    if mean > high:
        return Consistency.OVERCONFIDENT, Reason.NONE
    return Consistency.CONSERVATIVE, Reason.NONE


def probability_beyond_3_sd(share: float, independent: float) -> float:
    """Return a bound of the probability of this share of errors beyond 3 standard deviations in a consistent filter.

    With one independent sample or more it is the binomial probability, continued between whole numbers. With less, an
    excursion that happened to last, it is Markov's bound, however the errors depend on each other. The two meet.
    """
    expected = 1.0 - float(chdtr(1, 9.0))
    count = share * independent
    if count < 1.0:
        return expected / share
    return float(betainc(count, independent - count + 1.0, expected))


class MeanVerdict(NamedTuple):
    """A mean NIS or NEES, the interval of consistent filters, and the verdict that follows."""

    mean: float = math.nan
    low: float = math.nan
    high: float = math.nan
    verdict: Consistency = Consistency.NOT_AVAILABLE
    why: Reason = Reason.NONE


def mean_verdict(squared: Floats, dof: int, samples: float) -> MeanVerdict:
    """Return the verdict on a mean of squares with a number of effective samples.

    Few samples can show that it is too large, but not that it is right.
    """
    mean = float(squared.mean())
    low, high = mean_interval(dof, samples)
    word, why = consistency_verdict(mean, low, high, dof)
    if dof * samples < FEWEST_UPDATES and word in (
        Consistency.CONSISTENT,
        Consistency.CONSERVATIVE,
    ):
        word = Consistency.INSUFFICIENT
        why = Reason.NONE
    return MeanVerdict(mean, low, high, word, why)


# --- The table.


def consistency_table(
    log: str,
    histories: tuple[History, ...],
    sensor_sd: Mapping[str, Floats],  # (s,), noise of one reading of each held-out sensor, SI
) -> list[ConsistencyRow]:
    """Return the consistency of each filter's innovations, by measurement and by axis.

    NIS is that of all innovations; what the gate rejected counts as much as the gate is. Whiteness is that of the
    innovations that were used. After the row of a whole measurement, such as ``velocity``, come those of its axes in b,
    ``velocity_x`` to ``velocity_z``, where NIS is ``z_i^2 / S_ii``. The interval of a held-out sensor is that of its
    independent innovations; a filter without the states that the sensor needs does not tell how far off it may be.
    """
    rows: list[ConsistencyRow] = []
    for history in histories:
        for innovations in history.innovations:
            rows += _rows_of_measurement(log, history, innovations, sensor_sd)
    return rows


def _may_last(
    innovations: Innovations,
    components: slice,
    sensor_sd: Mapping[str, Floats],
) -> bool:
    """Return whether the errors of a held-out sensor may last, which makes them one sample.

    If one is small by chance, or zero after an exact start, the data do not show that it lasts.
    """
    sd = sensor_sd[innovations.held_out_sensor]
    return not _is_below_noise((innovations.innovation / sd)[:, components])


def _rows_of_measurement(
    log: str,
    history: History,
    innovations: Innovations,
    sensor_sd: Mapping[str, Floats],
) -> Iterator[ConsistencyRow]:
    """Yield the row of a whole measurement of one filter, then those of its axes."""
    measurement = innovations.measurement
    has_states = _has_states(history, innovations)
    met = _are_met(history, innovations)
    standardised = innovations.standardised[met]
    paired = innovations.used[met] | innovations.is_held_out
    parts = {measurement: slice(None)}
    for number, axis in enumerate(innovations.axes):
        parts[axis_of(measurement, axis)] = slice(number, number + 1)
    for name, components in parts.items():
        part = standardised[:, components]
        dof = part.shape[1]
        nis = innovations.nis[met] if name == measurement else part[:, 0] ** 2
        correlation, limit = autocorrelation(part, paired)
        mean = MeanVerdict()
        if has_states:
            # The errors of a held-out sensor last, so fewer innovations are independent.
            lasting = part if innovations.is_held_out else None
            mean = _nis_verdict(nis * innovations.weight[met], dof, lasting)
        if mean.verdict == Consistency.CONSERVATIVE:
            if innovations.is_held_out:
                may_last = _may_last(innovations, components, sensor_sd)
            else:
                may_last = measurement in SENSORS and repeats(correlation, limit)
            if may_last:
                mean = mean._replace(verdict=Consistency.INSUFFICIENT, why=Reason.ONE_SAMPLE)
        yield ConsistencyRow(
            log=log,
            filter=history.filter,
            measurement=name,
            dof=dof,
            used=int(innovations.used.sum()),
            rejected=int(rejected(innovations).sum()),
            mean_nis=mean.mean,
            low=mean.low,
            high=mean.high,
            verdict=mean.verdict,
            autocorrelation=correlation,
            autocorrelation_limit=limit,
            whiteness=whiteness(correlation, limit),
            why=mean.why,
        )


def _has_states(history: History, innovations: Innovations) -> bool:
    """Return whether a filter has the states that a held-out sensor needs; other measurements need none."""
    if not innovations.is_held_out:
        return True
    states = {state.id for state in history.states}
    for block in SENSORS[innovations.held_out_sensor].states:
        if any(state.id not in states for state in MORE_STATES[block]):
            return False
    return True


def _are_met(history: History, innovations: Innovations) -> Mask:
    """Find the innovations that count, shape (m,): all, without readings that the user's prediction left out."""
    met = np.isfinite(innovations.nis)
    if is_reserved(innovations.measurement) or not np.isfinite(history.velocity_n[-1]).all():
        return np.ones_like(met)
    return met


def _is_below_noise(by_sensor: Floats) -> bool:
    """Return whether differences, shape (m, n), in the sd of a held-out sensor are too small for its noise alone.

    Only then does the sensor show that a filter is conservative.
    """
    found = _nis_verdict(np.sum(by_sensor**2, axis=1), by_sensor.shape[1], by_sensor)
    return found.verdict == Consistency.CONSERVATIVE


def _nis_verdict(nis: Floats, dof: int, components: Floats | None) -> MeanVerdict:
    """Return the verdict on a mean NIS; correlated components count as fewer samples."""
    if len(nis) < FEWEST_UPDATES:
        return MeanVerdict(verdict=Consistency.INSUFFICIENT)
    samples = float(len(nis))
    if components is not None and np.isfinite(components).all():
        samples = samples_in_mean_square(components)
    return mean_verdict(nis, dof, samples)


def rejected(innovations: Innovations) -> Mask:
    """Find the innovations that the gate rejected, shape (m,)."""
    return ~innovations.used & np.isfinite(innovations.nis)


def autocorrelation(
    standardised: Floats,  # (m, n), innovations in their own standard deviations, in the order of time
    used: Mask,  # (m,), which of them the gate let pass; both of a pair have to
) -> tuple[float, float]:
    """Return the lag-1 correlation of innovations, and its limit for 95 % of white innovations.

    The mean is not subtracted: one that stays is a correlation too. The limit is ``1.96 / sqrt(pairs)``; for n
    components together it is too wide by up to sqrt(n), and never too narrow. NaN with fewer than `FEWEST_PAIRS` pairs,
    or where nothing varies.
    """
    pairs = used[1:] & used[:-1]
    count = int(pairs.sum())
    if count < FEWEST_PAIRS:
        return float("nan"), float("nan")
    earlier = standardised[:-1][pairs]
    later = standardised[1:][pairs]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        value = np.sum(earlier * later) / np.sqrt(np.sum(earlier**2) * np.sum(later**2))
    return float(value), NORMAL_95 / float(np.sqrt(count))


def repeats(value: float, limit: float) -> bool:
    """Return whether innovations are strongly correlated: a lasting error instead of noise."""
    return value > 0.0 and whiteness(value, limit) == Whiteness.CORRELATED


def whiteness(value: float, limit: float) -> Whiteness:
    """Return the whiteness by a lag-1 correlation."""
    if not np.isfinite(limit):
        return Whiteness.INSUFFICIENT
    if not np.isfinite(value):
        return Whiteness.NOT_FINITE
    if abs(value) > max(limit, SMALL_AUTOCORRELATION):
        return Whiteness.CORRELATED
    return Whiteness.WHITE


def log_likelihood(innovations: Innovations) -> float:
    """Return the log-likelihood of all innovations, the sum of ``-(ln det S + z' S^-1 z + d ln 2 pi) / 2``.

    Gated innovations count: leaving them out would reward a filter that rejects what it does not like. Minus infinity
    where an innovation is not finite.
    """
    constant = innovations.dof * np.log(2.0 * np.pi)
    total = -0.5 * float(np.sum(innovations.log_det + innovations.nis + constant))
    if np.isfinite(total):
        return total
    return float("-inf")
