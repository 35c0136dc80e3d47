"""Whether a filter's innovations are as large as it says, axis by axis, and white: a filter that is right has used all
that a measurement could tell, and what remains is new each time.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", chapter 5.
"""

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import NS_PER_S, Floats
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.quantities import WITHHELD, axis_of, is_reserved
from insdvl_replay.core.sensors import SENSORS
from insdvl_replay.core.states import MORE_STATES
from insdvl_replay.core.tables import ConsistencyRow
from insdvl_replay.core.words import Consistency, Reason, Severity, Whiteness
from insdvl_replay.evaluation.chi_square import chi_square_quantile, consistency_word, mean_interval, reason
from insdvl_replay.evaluation.effective_samples import samples_in_mean_square

FEWEST_UPDATES = 10
"""With fewer updates the verdict is ``too few``."""
MANY_REJECTED = 0.1
"""A gate that rejects a larger share does not keep outliers out but the DVL."""
CONTRADICTED: Final = 9.0
"""Median NIS over that of chi-square at which a sensor errs by three times what its settings say, or is misread."""
SLOW: Final = 0.3
"""Correlation of neighbouring headings from which their error is slow."""
FEWEST_PAIRS: Final = 10
"""With fewer neighbours the word is ``too few``."""
SMALL_AUTOCORRELATION: Final = 0.1
"""A smaller one, however significant, does not matter: the mean of noise that is so correlated scatters by less than
11 % more, or 10 % less, than that of white noise."""
NORMAL_95: Final = 1.96
"""Within so many standard deviations lie 95 % of a normal variable."""


NO_SENSORS: Final[Mapping[str, Floats]] = MappingProxyType({})


def consistency_table(
    log: str, histories: tuple[History, ...], sensor_sd: Mapping[str, Floats] = NO_SENSORS
) -> list[ConsistencyRow]:
    """Judge each filter's innovations, measurement by measurement and axis by axis.

    Parameters
    ----------
    log : str
        Name of the dive.
    histories : tuple of History
        All filters; the baseline has rows of its own.
    sensor_sd : mapping of str to ndarray, shape (s,)
        Noise of the components of one reading of each sensor that was withheld, by its name in `core.sensors`, SI.

    Returns
    -------
    list of ConsistencyRow
        NIS is that of all innovations; what the gate rejected counts as much as the gate is, see
        `history.Innovations.weight`. Whiteness is that of the innovations that were used, autocorrelation that with the
        innovation before. After the row of a whole measurement, such as ``velocity``, stand those of its axes in b,
        ``velocity_x`` to ``velocity_z``, where NIS is ``z_i^2 / S_ii``. The interval of a sensor that was withheld is
        that of its independent innovations, as they repeat themselves, and its whiteness that of all; a filter without
        the states that the sensor needs does not tell how far off it may be. ``why`` tells where the word is
        not the interval's.
    """
    return [
        row
        for history in histories
        for innovations in history.innovations
        for row in _rows(log, history, innovations, sensor_sd)
    ]


def _goes_on(history: History, measurement: str) -> bool:
    """Whether a filter lives on where a prediction of one's own gives no number: such readings are not used."""
    return not is_reserved(measurement) and bool(np.isfinite(history.velocity_n[-1]).all())


class _Mean(NamedTuple):
    """A mean NIS, the interval of consistent filters, and the word that follows."""

    nis: float
    low: float
    high: float
    word: Consistency
    why: Reason = Reason.NONE


def _rows(
    log: str, history: History, innovations: Innovations, sensor_sd: Mapping[str, Floats]
) -> Iterator[ConsistencyRow]:
    """Return the row of a whole measurement, then those of its axes."""
    measurement = innovations.measurement
    met = np.isfinite(innovations.nis) | (not _goes_on(history, measurement))
    standardised, weight, used = innovations.standardised[met], innovations.weight[met], innovations.used[met]
    parts = [(measurement, slice(None), innovations.nis[met])]
    for i, axis in enumerate(innovations.axes):
        parts.append((axis_of(measurement, axis), slice(i, i + 1), standardised[:, i] ** 2))
    withheld, counts = innovations.is_withheld, (int(innovations.used.sum()), rejections(innovations))
    compared = np.ones(len(used), np.bool_) if withheld else used
    for name, components, nis in parts:
        part = standardised[:, components]
        correlation, dof = autocorrelation(part, compared), part.shape[1]
        if not withheld:
            mean = _judged(nis * weight, dof, len(nis))
            if mean.word == Consistency.OVER_CAUTIOUS and measurement in SENSORS and repeats(*correlation):
                mean = mean._replace(word=Consistency.TOO_FEW, why=Reason.ONE_SAMPLE)
        elif _is_told(history, measurement):
            own_sd = sensor_sd[measurement.removeprefix(WITHHELD)]
            mean = _judged_withheld(nis, part, (innovations.innovation / own_sd)[:, components])
        else:
            mean = _NOT_TOLD
        judged = *counts, mean.nis, mean.low, mean.high, mean.word
        yield ConsistencyRow(
            *(log, history.filter, name, dof, *judged), *correlation, whiteness(*correlation), mean.why
        )


def _judged(nis: Floats, dof: int, independent: float) -> _Mean:
    """Judge a mean NIS; few that are independent prove that it is too large, but not that it is as it should be."""
    if len(nis) < FEWEST_UPDATES:
        return _NOT_TOLD._replace(word=Consistency.TOO_FEW)
    mean_nis = float(nis.mean())
    low, high = mean_interval(dof, independent)
    word = consistency_word(mean_nis, low, high, dof)
    if dof * independent < FEWEST_UPDATES and word in (Consistency.CONSISTENT, Consistency.OVER_CAUTIOUS):
        word = Consistency.TOO_FEW
    return _Mean(mean_nis, low, high, word, reason(word, mean_nis, low, high))


_NOT_TOLD: Final = _Mean(math.nan, math.nan, math.nan, Consistency.NOT_TOLD)


def _is_told(history: History, measurement: str) -> bool:
    """Whether a filter has the states that a withheld sensor needs: else it does not say how far off that may be."""
    needed = {state.id for block in SENSORS[measurement.removeprefix(WITHHELD)].states for state in MORE_STATES[block]}
    return needed <= {state.id for state in history.states}


def _judged_withheld(nis: Floats, standardised: Floats, in_own_sd: Floats) -> _Mean:
    """Judge what stays in the next innovation, too, since no filter is told of it: fewer are independent.

    An error that stays is one sample, and where it happens to be small, or is none at an exact start, nothing shows
    that it stays. A filter is over-cautious only where differences are too small for the noise of the sensor alone, in
    whose standard deviations they are given, too.
    """
    mean = _judged(nis, standardised.shape[1], _independent(standardised))
    if mean.word != Consistency.OVER_CAUTIOUS:
        return mean
    by_sensor = _judged(np.sum(in_own_sd**2, axis=1), in_own_sd.shape[1], _independent(in_own_sd))
    if by_sensor.word == Consistency.OVER_CAUTIOUS:
        return mean
    return mean._replace(word=Consistency.TOO_FEW, why=Reason.ONE_SAMPLE)


def _independent(components: Floats) -> float:
    if not (len(components) and np.isfinite(components).all()):
        return float(len(components))
    return samples_in_mean_square(components)


def log_likelihood(innovations: Innovations) -> float:
    """Return the logarithm of the probability density of all innovations under the filter that met them.

    Innovations of a filter that is right are independent and normal, so that it is the sum of
    ``-(ln det S + z' S^-1 z + d ln 2 pi) / 2``. Gated innovations count: leaving them out would reward a filter that
    rejects what it does not like.

    Returns
    -------
    float
        Minus infinity where an innovation is not finite.
    """
    constant = innovations.dof * np.log(2.0 * np.pi)
    total = -0.5 * float(np.sum(innovations.log_det + innovations.nis + constant))
    return total if np.isfinite(total) else float("-inf")


def update_notes(histories: tuple[History, ...]) -> tuple[Note, ...]:
    """Warn of filters whose aiding did not happen as configured: their tables say less than they seem to.

    Returns
    -------
    tuple of Note
        Aiding without any update, innovations that are not finite, and gates that reject more than outliers.
    """
    notes = []
    for history in histories:
        for innovations in history.innovations:
            notes += _judged_updates(history, innovations)
        notes += _reopening_notes(history)
    return tuple(notes)


def _judged_updates(history: History, innovations: Innovations) -> list[Note]:
    name, kind, total = history.filter, innovations.measurement, len(innovations.used)
    if total == 0:
        hint = f"filters.{name}.acceleration.max_window_gap_s or window" if kind == "acceleration" else ""
        return [Note("aiding_without_updates", f"filter {name} had no {kind} to use", 0, Severity.WARNING, hint)]
    if innovations.is_withheld:
        return []
    lost = int(np.sum(~np.isfinite(innovations.nis)))
    if lost:
        first = int(np.argmax(~np.isfinite(innovations.nis)))
        are_lost = f"{lost} of {total} {kind} innovations are not finite, from number {first + 1} on"
        if _goes_on(history, kind):
            text, hint = f"filter {name} goes on without some: {are_lost}", "arithmetic fails in what predicts them"
            return [Note("innovations_not_finite", text, lost, Severity.WARNING, hint)]
        text = f"filter {name} broke down: {are_lost}"
        sizes = "check the units and sizes of [noise], [initial] and what aids it"
        hint = f'{sizes}; after long IMU gaps, imu.long_gaps = "split"'
        return [Note("filter_not_finite", text, lost, Severity.WARNING, hint)]
    return [
        *_rejection_notes(name, innovations),
        *_contradiction_notes(name, innovations),
        *_slow_heading_notes(history, innovations),
    ]


def _slow_heading_notes(history: History, innovations: Innovations) -> list[Note]:
    """Warn of a heading whose error is slow: its innovations are small, since the filter follows the error."""
    alike, limit = autocorrelation(innovations.standardised, innovations.used)
    is_estimated = any(state.id == "heading_bias" for state in history.states)
    if innovations.measurement != "heading" or is_estimated or alike < SLOW or not repeats(alike, limit):
        return []
    text = (
        f"filter {history.filter} follows a slow error of the heading: neighbouring innovations have a correlation of "
        f"{alike:.2f}, and its heading is less sure than it says"
    )
    hint = (
        f'filters.{history.filter}.states = ["heading_bias"], with heading.bias_sd_deg and bias_time_s; a smaller '
        "heading.sd_deg makes it worse"
    )
    return [Note("heading_slow_error", text, len(innovations.used), Severity.WARNING, hint)]


def _gate_hint(name: str) -> str:
    return f"check lever arm and mounting, raise [noise], or --set filters.{name}.gate_probability=1.0"


def _contradiction_notes(name: str, innovations: Innovations) -> list[Note]:
    """Warn of a sensor beside the DVL that says something else than all others: the filter is none the worse for it.

    By the median: readings that are wild are few, and the gate's affair.
    """
    sensor, total = innovations.measurement, len(innovations.used)
    size = float(np.median(innovations.nis)) / chi_square_quantile(0.5, innovations.dof)
    if sensor not in SENSORS or total < FEWEST_UPDATES or size <= CONTRADICTED:
        return []
    text = (
        f"filter {name} and its {sensor} contradict each other: the median NIS of {sensor} is {size:.3g} times "
        "what is expected"
    )
    hint = f"units, axes, stamp and delay in [{sensor}], or a larger sd there; evaluation.withheld judges without it"
    return [Note(f"{sensor}_disagrees", text, total, Severity.WARNING, hint)]


def _rejection_notes(name: str, innovations: Innovations) -> list[Note]:
    rejected, total = rejections(innovations), len(innovations.used)
    if rejected <= MANY_REJECTED * total:
        return []
    text = f"filter {name} rejected {rejected} of {total} {innovations.measurement} innovations"
    return [Note("gate_rejects_many", text, rejected, Severity.WARNING, _gate_hint(name))]


def _reopening_notes(history: History) -> list[Note]:
    name, count = history.filter, len(history.reopened_ns)
    if not count:
        return []
    first_ns = min(int(one.time_ns[0]) for one in history.innovations if len(one.time_ns))
    first_s = (int(history.reopened_ns[0]) - first_ns) / NS_PER_S
    text = (
        f"filter {name} was set to the DVL again after runs of rejected velocities ({count} in all, the first "
        f"{first_s:.1f} s after the first reading)"
    )
    return [Note("gate_reopened", text, count, Severity.WARNING, _gate_hint(name))]


def rejections(innovations: Innovations) -> int:
    """Count the innovations that the gate rejected."""
    return int(refusals(innovations).sum())


def refusals(innovations: Innovations) -> NDArray[np.bool_]:
    """Find the innovations that the gate rejected, shape (m,)."""
    return ~innovations.used & np.isfinite(innovations.nis)


def autocorrelation(standardised: Floats, used: NDArray[np.bool_]) -> tuple[float, float]:
    """Correlate innovations with the ones before them.

    The mean is not taken off: innovations have none, and one that stays is a correlation too.

    Parameters
    ----------
    standardised : ndarray, shape (m, n)
        Innovations in their own standard deviations, in the order of time. The n components are taken together.
    used : ndarray of bool, shape (m,)
        Which of them the gate let pass; both of a pair have to.

    Returns
    -------
    value : float
        Between -1 and 1; NaN with fewer than `FEWEST_PAIRS` pairs, or where nothing varies.
    limit : float
        Its size is smaller for 95 % of white innovations, ``1.96 / sqrt(pairs)``. For n above 1 it is too wide by up to
        sqrt(n), and never too narrow, however the components hang together. NaN with too few pairs.
    """
    pairs = used[1:] & used[:-1]
    count = int(pairs.sum())
    if count < FEWEST_PAIRS:
        return float("nan"), float("nan")
    earlier, later = standardised[:-1][pairs], standardised[1:][pairs]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        value = np.sum(earlier * later) / np.sqrt(np.sum(earlier**2) * np.sum(later**2))
    return float(value), NORMAL_95 / float(np.sqrt(count))


def repeats(value: float, limit: float) -> bool:
    """Return whether innovations repeat themselves: what they hold is an error that stays, and no noise."""
    return value > 0.0 and whiteness(value, limit) == Whiteness.CORRELATED


def whiteness(value: float, limit: float) -> Whiteness:
    """State what an autocorrelation means."""
    if not np.isfinite(limit):
        return Whiteness.TOO_FEW
    if not np.isfinite(value):
        return Whiteness.NOT_FINITE
    return Whiteness.CORRELATED if abs(value) > max(limit, SMALL_AUTOCORRELATION) else Whiteness.WHITE
