"""Whether a filter's innovations are as large as it says, axis by axis, and white: a filter that is right has used all
that a measurement could tell, and what remains is new each time.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", chapter 5.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import NS_PER_S, Floats
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.quantities import AXES, WITHHELD, axis_of, is_reserved
from insdvl_replay.core.states import DEG, MORE_STATES, PHI, SENSORS
from insdvl_replay.core.table import finite
from insdvl_replay.core.tables import ConsistencyRow, Tables
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


APART: Final = 5.0
"""Times by which the NIS of one axis is above another's: what a DVL is built in otherwise does not reach all alike."""
TOO_LARGE: Final = 1.5
"""NIS over degrees of freedom from which an axis is compared with down, too: beams 30 deg off the vertical measure with
six times less variance down, of which a filter that takes all axes for alike knows nothing."""
TELLING_PCT, TELLING_DEG = 0.5, 0.5
CERTAIN_SDS: Final = 5.0
"""Standard errors by which a track has to be off; those of a turn hold what the filter knows of its heading, too."""
LEAST, MOST = 0.2, 5.0
"""Mean NIS over degrees of freedom outside which noise is set far off."""
NOISE_FAR_OFF: Final = "noise_far_off"
_CALIBRATE: Final = (
    "`insdvl-replay calibrate` with the same settings estimates arm, mounting, delay and scale of the DVL"
)
_CONTROL: Final = "`insdvl-replay run --control` adds a baseline whose noise is fitted to the dive"


def settings_hints(tables: Tables, history: History) -> tuple[Note, ...]:
    """Point at what the baseline's innovations and track say on how the DVL is built in, and on the noise.

    Parameters
    ----------
    history : History
        Of the baseline.

    Returns
    -------
    tuple of Note
        For information; empty where nothing is far off, or there is nothing to tell it by.
    """
    heading_sd_deg = float(np.max(history.sd[[0, -1], PHI.stop - 1])) / DEG
    name = history.filter
    return (*_axes_apart(tables, name), *_track_off(tables, name, heading_sd_deg), *_noise_far_off(tables, name))


def constants_notes(histories: tuple[History, ...]) -> tuple[Note, ...]:
    """Note what filters take the constants of the sensors to be at the end: scale and yaw of the DVL, the gauge's zero.

    Of adaptive noise, too, by how much it is larger than said.

    Returns
    -------
    tuple of Note
        For information, one for each filter that estimates any.
    """
    return tuple(
        Note("constants_estimated", f"{history.filter} estimates: {'; '.join(found)}", len(found))
        for history in histories
        if (found := [*_constants(history), *_noise_found(history)])
    )


def _constants(history: History) -> Iterator[str]:
    count = history.constants.shape[1]
    for column, state in enumerate(history.states[len(history.states) - count :]):
        value, start = (history.constants[row, column] / state.factor for row in (-1, 0))
        sd, start_sd = (history.sd[row, state.index] / state.factor for row in (-1, 0))
        yield (
            f"{state.label} {value:+.3g} {state.unit} (sd {sd:.2g} {state.unit}; "
            f"at the start {start:+.3g}, sd {start_sd:.2g})"
        )


def _noise_found(history: History) -> Iterator[str]:
    for innovations in history.innovations:
        if innovations.noise_factor != 1.0:
            yield f"noise of {innovations.measurement} {math.sqrt(innovations.noise_factor):.3g} times what it is told"


def _nis_per_dof(tables: Tables, baseline: str) -> dict[str, float]:
    return {row.measurement: finite(row.mean_nis) / row.dof for row in tables.consistency if row.filter == baseline}


def _axes_apart(tables: Tables, baseline: str) -> Iterator[Note]:
    known = _nis_per_dof(tables, baseline)
    sizes = {axis: known[name] for axis in AXES if (name := axis_of("velocity", axis)) in known}
    high = max(sizes, key=sizes.__getitem__, default="")
    compared = {axis: size for axis, size in sizes.items() if axis != AXES[-1] or sizes[high] > TOO_LARGE}
    low = min(compared, key=compared.__getitem__, default="")
    if low and sizes[low] > 0.0 and sizes[high] > APART * sizes[low]:
        listed = ", ".join(f"{axis} {size:.2g}" for axis, size in sizes.items())
        text = (
            f"the innovations of {baseline} are not alike along the axes: mean NIS / dof {listed}, along {high} "
            f"{sizes[high] / sizes[low]:.3g} times that along {low}; arm, mounting or delay of the DVL may be off"
        )
        yield Note("innovations_apart", text, 1, hint=_CALIBRATE)


def _track_off(tables: Tables, baseline: str, heading_sd_deg: float) -> Iterator[Note]:
    telling = {"scale": (TELLING_PCT, 0.0), "turn": (TELLING_DEG, heading_sd_deg)}
    off = []
    for row in tables.track_fit:
        size, (least, known_sd) = abs(finite(row.fitted)), telling[row.quantity]
        sd = math.hypot(finite(row.fitted_sd), known_sd)
        if row.filter == baseline and size > least and size > CERTAIN_SDS * sd:
            off.append(f"a {row.quantity} of {finite(row.fitted):+.2f} {row.unit} (sd {sd:.2g} {row.unit})")
    if off:
        text = (
            f"{' and '.join(off)} would lay the track of {baseline} on the reference's: dvl.scale, "
            "dvl.mounting_rpy_deg or initial.heading_deg may be off"
        )
        yield Note("track_off", text, len(off), hint=_CALIBRATE)


def is_noise_far_off(tables: Tables, baseline: str) -> bool:
    """Return whether the size of the innovations tells that the noise is set far off.

    Small ones that repeat themselves do not: they are an error that stays, which less noise would make worse.
    """
    row = next((row for row in tables.consistency if (row.filter, row.measurement) == (baseline, "velocity")), None)
    if row is None or row.mean_nis is None:
        return False
    size = row.mean_nis / row.dof
    return size > MOST or (size < LEAST and not repeats(finite(row.autocorrelation), finite(row.autocorrelation_limit)))


def _noise_far_off(tables: Tables, baseline: str) -> Iterator[Note]:
    if is_noise_far_off(tables, baseline):
        size = _nis_per_dof(tables, baseline)["velocity"]
        text = (
            f"the innovations of {baseline} are far {'smaller' if size < LEAST else 'larger'} than it says: mean NIS / "
            f"dof of velocity is {size:.2g}, 1 is expected"
        )
        yield Note(NOISE_FAR_OFF, text, 1, hint=_CONTROL)


@dataclass(frozen=True)
class Sensors:
    """The classes that one kind of sensor comes in.

    Attributes
    ----------
    worst : mapping of str to float
        The worst white noise of each class, in SI units, best class first.
    least : float
        Less than the best sensors have.
    """

    name: str
    worst: Mapping[str, float]
    least: float


CLASSES: Final[Mapping[str, Sensors]] = MappingProxyType(
    {
        # Servo accelerometers have 1 to 10 ug/sqrt(Hz), good micromechanical ones 100; cheap ones reach 1000.
        "accel_white_mps_rts": Sensors("accelerometers", {"fog": 5e-4, "tactical": 1.8e-3, "mems": 1e-2}, 1e-5),
        # Navigators have 0.003 deg/sqrt(h) or less, tactical gyros 0.15; the cheapest reach 0.05 deg/s/sqrt(Hz).
        "gyro_white_rad_rts": Sensors("gyros", {"fog": 1e-5, "tactical": 6e-5, "mems": 1e-3}, 1e-8),
        # From 3 mm/s of a ping at 1 MHz to 3 cm/s at 150 kHz, which reaches furthest.
        "velocity_sd_mps": Sensors("DVLs", {"DVL": 0.1}, 3e-4),
        "beam_sd_mps": Sensors("DVLs", {"DVL": 0.1}, 3e-4),
    }
)
"""By the key of the settings; names of classes as of the presets."""
FILTERED: Final = 10.0
"""An IMU that smooths its readings shows less of its noise from sample to sample than it has over a second: by up to
this factor."""
RESTLESS: Final = 2.0
"""Vibration that comes and goes scatters the readings by as much more than in the usual block."""
BLOCK: Final = 50
"""Samples of a block; turns and single wrong readings spoil few of them."""


def readings_scatter(readings: Floats, step_s: float) -> float:
    """Bound the white noise of a sensor by how its readings scatter from sample to sample.

    What is left of three readings after a straight line through them is noise, vibration, and what the vehicle does
    within two steps: at least the sensor's noise, unless it smooths its readings.

    Parameters
    ----------
    readings : ndarray, shape (k, 3)
    step_s : float
        From one to the next.

    Returns
    -------
    float
        White noise density, in the readings' unit times sqrt(s): the largest of the three axes, each the median over
        blocks. NaN of fewer than three readings.
    """
    bends = np.diff(readings, n=2, axis=0) / np.sqrt(6.0)  # of white noise: 1, -2 and 1 times it, squared and added
    if not len(bends):
        return np.nan
    length = min(BLOCK, len(bends))
    blocks = bends[: len(bends) // length * length].reshape(-1, length, 3)
    power = np.median(np.mean(blocks**2, axis=1), axis=0)
    return float(np.sqrt(power.max() * step_s))


def sensor_class(key: str, noise: float) -> str:
    """Name the best class of sensors that may be so noisy; empty where none is.

    Parameters
    ----------
    key : str
        Of `CLASSES`.
    """
    return next((name for name, worst in CLASSES[key].worst.items() if noise <= worst), "")


def beyond_the_sensor(key: str, noise: float, scatter: float = 0.0) -> str:
    """State why a white noise cannot be its sensor's.

    Parameters
    ----------
    key : str
        Of `CLASSES`.
    scatter : float
        From `readings_scatter`; 0 where the readings show nothing of the noise alone, as those of a DVL.

    Returns
    -------
    str
        Empty where it may be.
    """
    sensors = CLASSES[key]
    best, worst = min(sensors.worst.values()), max(sensors.worst.values())
    reasons = []
    if scatter and noise > best and noise > FILTERED * scatter:
        reasons.append(f"{noise / scatter:.0f} times what the readings scatter by ({scatter:.2g})")
    if noise > worst and noise > RESTLESS * scatter:
        reasons.append(f"more than any {sensors.name} have ({worst:g})")
    if noise < sensors.least:
        reasons.append(f"less than any {sensors.name} have ({sensors.least:g})")
    return " and ".join(reasons)
