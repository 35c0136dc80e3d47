"""Whether a filter's innovations are as large as it says, axis by axis, and white; and what they say of its settings.

First the table, then the notes on updates that did not happen as configured, the hints on settings, and which white
noise can be a sensor's. Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and
Navigation", chapter 5.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import NS_PER_S, Floats
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.quantities import AXES, HELD_OUT, axis_of, is_reserved
from insdvl_replay.core.states import DEG, MORE_STATES, PHI, SENSORS
from insdvl_replay.core.tables import ConsistencyRow, Tables, finite
from insdvl_replay.core.words import Consistency, Reason, Severity, Whiteness
from insdvl_replay.evaluation.chi_square import FEWEST_UPDATES, chi_square_quantile, consistency_verdict, mean_interval
from insdvl_replay.evaluation.series import samples_in_mean_square

MANY_REJECTED: Final = 0.1  # A gate that rejects a larger share does not keep outliers out but the DVL.
CONTRADICTED: Final = 9.0
"""Median NIS over that of chi-square at which a sensor errs by three times what its settings say, or is misread."""
SLOW: Final = 0.3  # Correlation of neighbouring headings from which their error is slow.
FEWEST_PAIRS: Final = 10  # With fewer neighbours the word is ``insufficient data``.
SMALL_AUTOCORRELATION: Final = 0.1
"""A smaller one, however significant, does not matter: the mean of noise that is so correlated scatters by less than
11 % more, or 10 % less, than that of white noise."""
NORMAL_95: Final = 1.96  # Within so many standard deviations are 95 % of a normal variable.
NO_SENSORS: Final[Mapping[str, Floats]] = MappingProxyType({})


# --- The table.


class _Mean(NamedTuple):
    """A mean NIS, the interval of consistent filters, and the verdict that follows."""

    nis: float = math.nan
    low: float = math.nan
    high: float = math.nan
    verdict: Consistency = Consistency.NOT_AVAILABLE
    why: Reason = Reason.NONE


def consistency_table(
    log: str,
    histories: tuple[History, ...],
    sensor_sd: Mapping[str, Floats] = NO_SENSORS,  # (s,), noise of one reading of each held-out sensor, SI
) -> list[ConsistencyRow]:
    """Judge each filter's innovations, measurement by measurement and axis by axis.

    NIS is that of all innovations; what the gate rejected counts as much as the gate is. Whiteness is that of the
    innovations that were used. After the row of a whole measurement, such as ``velocity``, come those of its axes in b,
    ``velocity_x`` to ``velocity_z``, where NIS is ``z_i^2 / S_ii``. The interval of a held-out sensor is that of its
    independent innovations; a filter without the states that the sensor needs does not tell how far off it may be.
    """
    rows = []
    for history, innovations in [(met_by, met) for met_by in histories for met in met_by.innovations]:
        measurement, held_out = innovations.measurement, innovations.is_held_out
        # A filter lives on where a user's prediction gives no number: such readings are not used.
        goes_on = not is_reserved(measurement) and np.isfinite(history.velocity_n[-1]).all()
        met = np.isfinite(innovations.nis) | (not goes_on)
        standardised, used = innovations.standardised[met], innovations.used[met]
        weighted = innovations.nis[met] * innovations.weight[met]
        in_own_sd, told = np.empty(0), True
        if held_out:
            sensor = measurement.removeprefix(HELD_OUT)
            needed = {state.id for block in SENSORS[sensor].states for state in MORE_STATES[block]}
            told = needed <= {state.id for state in history.states}
            in_own_sd = innovations.innovation / sensor_sd[sensor] if told else in_own_sd
        parts = [(measurement, slice(None), weighted)]
        for i, axis in enumerate(innovations.axes):
            nis = standardised[:, i] ** 2 * innovations.weight[met]
            parts.append((axis_of(measurement, axis), slice(i, i + 1), nis))
        for name, components, nis in parts:
            part = standardised[:, components]
            dof, correlation = part.shape[1], autocorrelation(part, used | held_out)
            mean = _Mean()
            if not held_out:
                mean = _judged(nis, dof)
                if mean.verdict == Consistency.CONSERVATIVE and measurement in SENSORS and repeats(*correlation):
                    mean = mean._replace(verdict=Consistency.INSUFFICIENT, why=Reason.ONE_SAMPLE)
            elif told:
                # No filter is told of it, so that what is off stays in the next innovation: fewer are independent. An
                # error that stays is one sample, and where it happens to be small, or is none at an exact start,
                # nothing shows that it stays. A filter is conservative only where differences are too small for the
                # noise of the sensor alone.
                mean, sensor_part = _judged(nis, dof, part), in_own_sd[:, components]
                if mean.verdict == Consistency.CONSERVATIVE:
                    by_sensor = _judged(np.sum(sensor_part**2, axis=1), dof, sensor_part)
                    if by_sensor.verdict != Consistency.CONSERVATIVE:
                        mean = mean._replace(verdict=Consistency.INSUFFICIENT, why=Reason.ONE_SAMPLE)
            counts = int(innovations.used.sum()), int(rejected(innovations).sum())
            judged = *counts, mean.nis, mean.low, mean.high, mean.verdict
            word = whiteness(*correlation)
            rows.append(ConsistencyRow(log, history.filter, name, dof, *judged, *correlation, word, mean.why))
    return rows


def _judged(nis: Floats, dof: int, components: Floats | None = None) -> _Mean:
    """Judge a mean NIS; few that are independent prove that it is too large, but not that it is as it should be.

    Components in their own standard deviations that repeat themselves count as their independent samples.
    """
    if len(nis) < FEWEST_UPDATES:
        return _Mean(verdict=Consistency.INSUFFICIENT)
    repeated = components is not None and np.isfinite(components).all()
    independent = samples_in_mean_square(components) if components is not None and repeated else float(len(nis))
    mean_nis, (low, high) = float(nis.mean()), mean_interval(dof, independent)
    word, why = consistency_verdict(mean_nis, low, high, dof)
    if dof * independent < FEWEST_UPDATES and word in (Consistency.CONSISTENT, Consistency.CONSERVATIVE):
        word, why = Consistency.INSUFFICIENT, Reason.NONE
    return _Mean(mean_nis, low, high, word, why)


def rejected(innovations: Innovations) -> NDArray[np.bool_]:
    """Find the innovations that the gate rejected, shape (m,)."""
    return ~innovations.used & np.isfinite(innovations.nis)


def autocorrelation(
    standardised: Floats,  # (m, n), innovations in their own standard deviations, in the order of time
    used: NDArray[np.bool_],  # (m,), which of them the gate let pass; both of a pair have to
) -> tuple[float, float]:
    """Return the correlation of innovations with the ones before them, and what 95 % of white innovations stay below.

    The mean is not subtracted: one that stays is a correlation too. The limit is ``1.96 / sqrt(pairs)``; for n
    components together it is too wide by up to sqrt(n), and never too narrow. NaN with fewer than `FEWEST_PAIRS` pairs,
    or where nothing varies.
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
    """Return what an autocorrelation means."""
    if not np.isfinite(limit):
        return Whiteness.INSUFFICIENT
    if not np.isfinite(value):
        return Whiteness.NOT_FINITE
    return Whiteness.CORRELATED if abs(value) > max(limit, SMALL_AUTOCORRELATION) else Whiteness.WHITE


def log_likelihood(innovations: Innovations) -> float:
    """Return the log-likelihood of all innovations, the sum of ``-(ln det S + z' S^-1 z + d ln 2 pi) / 2``.

    Gated innovations count: leaving them out would reward a filter that rejects what it does not like. Minus infinity
    where an innovation is not finite.
    """
    constant = innovations.dof * np.log(2.0 * np.pi)
    total = -0.5 * float(np.sum(innovations.log_det + innovations.nis + constant))
    return total if np.isfinite(total) else float("-inf")


# --- Notes on updates that did not happen as configured.


def update_notes(histories: tuple[History, ...]) -> tuple[Note, ...]:
    """Warn of filters whose tables say less than they seem to.

    Their aiding had no update, innovations are not finite, gates reject more than outliers, or a sensor contradicts.
    """
    notes: list[Note] = []

    def warn(code: str, text: str, count: int, hint: str) -> None:
        notes.append(Note(code, text, count, Severity.WARNING, hint))

    for history in histories:
        name = history.filter
        gate_hint = f"check lever arm and mounting, raise [noise], or --set filters.{name}.gate_probability=1.0"
        for innovations in history.innovations:
            kind, total = innovations.measurement, len(innovations.used)
            lost, many = ~np.isfinite(innovations.nis), int(rejected(innovations).sum())
            if total == 0:
                hint = f"filters.{name}.acceleration.max_window_gap_s or window" if kind == "acceleration" else ""
                warn("aiding_without_updates", f"filter {name} had no {kind} to use", 0, hint)
            if total == 0 or innovations.is_held_out:
                continue
            if lost.any():
                count = int(lost.sum())
                are_lost = f"{count} of {total} {kind} innovations are not finite, from number {np.argmax(lost) + 1} on"
                if not is_reserved(kind) and np.isfinite(history.velocity_n[-1]).all():
                    text, hint = (
                        f"filter {name} goes on without some: {are_lost}",
                        "arithmetic fails in what predicts them",
                    )
                    warn("innovations_not_finite", text, count, hint)
                    continue
                sizes = "check the units and sizes of [noise], [initial] and what aids it"
                hint = f'{sizes}; after long IMU gaps, imu.long_gaps = "split"'
                warn("filter_not_finite", f"filter {name} broke down: {are_lost}", count, hint)
                continue
            if many > MANY_REJECTED * total:
                warn(
                    "gate_rejects_many", f"filter {name} rejected {many} of {total} {kind} innovations", many, gate_hint
                )
            # A sensor next to the DVL that says something else than all others: the filter is none the worse for it.
            # By the median, since readings that are wild are few, and the gate's affair.
            size = float(np.median(innovations.nis)) / chi_square_quantile(0.5, innovations.dof)
            if kind in SENSORS and total >= FEWEST_UPDATES and size > CONTRADICTED:
                text = (
                    f"filter {name} and its {kind} contradict each other: the median NIS of {kind} is {size:.3g} times "
                    "what is expected"
                )
                hint = f"units, axes, stamp and delay in [{kind}], or a larger sd there"
                hint += "; evaluation.held_out judges without it"
                warn(f"{kind}_disagrees", text, total, hint)
            # Innovations of a heading whose error is slow are small, since the filter follows the error.
            if kind == "heading" and all(state.id != "heading_bias" for state in history.states):
                value, limit = autocorrelation(innovations.standardised, innovations.used)
                if value >= SLOW and repeats(value, limit):
                    text = (
                        f"filter {name} follows a slow error of the heading: neighbouring innovations have a "
                        f"correlation of {value:.2f}, and its heading is less sure than it says"
                    )
                    hint = (
                        f'filters.{name}.states = ["heading_bias"], with heading.bias_sd_deg and bias_time_s; a '
                        "smaller heading.sd_deg makes it worse"
                    )
                    warn("heading_slow_error", text, total, hint)
        if count := len(history.reopened_ns):
            first_ns = min(int(found.time_ns[0]) for found in history.innovations if len(found.time_ns))
            first_s = (int(history.reopened_ns[0]) - first_ns) / NS_PER_S
            text = (
                f"filter {name} was set to the DVL again after runs of rejected velocities ({count} in all, "
                f"the first {first_s:.1f} s after the first reading)"
            )
            warn("gate_reopened", text, count, gate_hint)
    return tuple(notes)


def constants_notes(histories: tuple[History, ...]) -> tuple[Note, ...]:
    """Note what filters take the sensors' constants, and adaptive noise, to be at the end."""
    notes = []
    for history in histories:
        found, count = [], history.constants.shape[1]
        for column, state in enumerate(history.states[len(history.states) - count :]):
            value, start = (history.constants[row, column] / state.factor for row in (-1, 0))
            sd, start_sd = (history.sd[row, state.index] / state.factor for row in (-1, 0))
            found.append(
                f"{state.label} {value:+.3g} {state.unit} (sd {sd:.2g} {state.unit}; "
                f"at the start {start:+.3g}, sd {start_sd:.2g})"
            )
        found += [
            f"noise of {innovations.measurement} {math.sqrt(innovations.noise_factor):.3g} times what it is told"
            for innovations in history.innovations
            if innovations.noise_factor != 1.0
        ]
        if found:
            notes.append(Note("constants_estimated", f"{history.filter} estimates: {'; '.join(found)}", len(found)))
    return tuple(notes)


# --- Hints: what the tables say on the settings, and which command follows it up.

APART: Final = 5.0
"""Times by which the NIS of one axis is above another's: what a DVL is built in otherwise does not reach all alike."""
TOO_LARGE: Final = 1.5
"""NIS over degrees of freedom from which an axis is compared with down, too: beams 30 deg off the vertical measure with
six times less variance down, of which a filter that takes all axes for alike knows nothing."""
TELLING_PCT, TELLING_DEG = 0.5, 0.5
CERTAIN_SDS: Final = 5.0
"""Standard errors by which a track has to be off; those of a turn hold what the filter knows of its heading, too."""
LEAST, MOST = 0.2, 5.0  # Mean NIS over degrees of freedom outside which noise is set far off.
NOISE_FAR_OFF: Final = "noise_far_off"
_CALIBRATE: Final = (
    "`insdvl-replay calibrate` with the same settings estimates arm, mounting, delay and scale of the DVL"
)
_CONTROL: Final = "`insdvl-replay run --control` adds a baseline whose noise is fitted to the dive"


def settings_hints(tables: Tables, baseline: History) -> tuple[Note, ...]:
    """Say what the baseline's innovations and track show of how the DVL is built in, and of the noise."""
    name, notes = baseline.filter, []
    nis = {row.measurement: finite(row.mean_nis) / row.dof for row in tables.consistency if row.filter == name}

    sizes = {axis: nis[part] for axis in AXES if (part := axis_of("velocity", axis)) in nis}
    high = max(sizes, key=sizes.__getitem__, default="")
    compared = {axis: size for axis, size in sizes.items() if axis != AXES[-1] or sizes[high] > TOO_LARGE}
    low = min(compared, key=compared.__getitem__, default="")
    if low and sizes[low] > 0.0 and sizes[high] > APART * sizes[low]:
        listed = ", ".join(f"{axis} {size:.2g}" for axis, size in sizes.items())
        text = (
            f"the innovations of {name} are not alike along the axes: mean NIS / dof {listed}, along {high} "
            f"{sizes[high] / sizes[low]:.3g} times that along {low}; arm, mounting or delay of the DVL may be off"
        )
        notes.append(Note("innovations_apart", text, 1, hint=_CALIBRATE))

    heading_sd_deg = float(np.max(baseline.sd[[0, -1], PHI.stop - 1])) / DEG
    telling, off = {"scale": (TELLING_PCT, 0.0), "turn": (TELLING_DEG, heading_sd_deg)}, []
    for row in tables.track_fit:
        size, (least, known_sd) = abs(finite(row.fitted)), telling[row.quantity]
        sd = math.hypot(finite(row.fitted_sd), known_sd)
        if row.filter == name and size > least and size > CERTAIN_SDS * sd:
            off.append(f"a {row.quantity} of {finite(row.fitted):+.2f} {row.unit} (sd {sd:.2g} {row.unit})")
    if off:
        text = (
            f"{' and '.join(off)} would lay the track of {name} on the reference's: dvl.scale, "
            "dvl.mounting_rpy_deg or initial.heading_deg may be off"
        )
        notes.append(Note("track_off", text, len(off), hint=_CALIBRATE))

    if is_noise_far_off(tables, name):
        text = (
            f"the innovations of {name} are far {'smaller' if nis['velocity'] < LEAST else 'larger'} than it says: "
            f"mean NIS / dof of velocity is {nis['velocity']:.2g}, 1 is expected"
        )
        notes.append(Note(NOISE_FAR_OFF, text, 1, hint=_CONTROL))
    return tuple(notes)


def is_noise_far_off(tables: Tables, baseline: str) -> bool:
    """Return whether the size of the innovations tells that the noise is set far off.

    Small ones that repeat themselves do not: they are an error that stays, which less noise would make worse.
    """
    row = next((row for row in tables.consistency if (row.filter, row.measurement) == (baseline, "velocity")), None)
    if row is None or row.mean_nis is None:
        return False
    size = row.mean_nis / row.dof
    return size > MOST or (size < LEAST and not repeats(finite(row.autocorrelation), finite(row.autocorrelation_limit)))


# --- Whether a white noise can be its sensor's: a filter that fits noise to its innovations has nowhere else to put
# what a wrong lever arm or delay does to them.

FILTERED: Final = 10.0
"""An IMU that smooths its readings shows less of its noise from sample to sample than it has over a second: by up to
this factor."""
RESTLESS: Final = 2.0  # Vibration that comes and goes scatters the readings by as much more than in the usual block.
BLOCK: Final = 50  # Samples of a block; turns and single wrong readings spoil few of them.


class SensorClasses(NamedTuple):
    """The classes that one kind of sensor comes in."""

    name: str
    worst: Mapping[str, float]  # the worst white noise of each class, SI units, best class first; as of the presets
    least: float  # less than the best sensors have


CLASSES: Final[Mapping[str, SensorClasses]] = MappingProxyType(
    {
        # Servo accelerometers have 1 to 10 ug/sqrt(Hz), good micromechanical ones 100; cheap ones reach 1000.
        "accel_white_mps_rts": SensorClasses("accelerometers", {"fog": 5e-4, "tactical": 1.8e-3, "mems": 1e-2}, 1e-5),
        # Navigators have 0.003 deg/sqrt(h) or less, tactical gyros 0.15; the cheapest reach 0.05 deg/s/sqrt(Hz).
        "gyro_white_rad_rts": SensorClasses("gyros", {"fog": 1e-5, "tactical": 6e-5, "mems": 1e-3}, 1e-8),
        # From 3 mm/s of a ping at 1 MHz to 3 cm/s at 150 kHz, which reaches furthest.
        "velocity_sd_mps": SensorClasses("DVLs", {"DVL": 0.1}, 3e-4),
        "beam_sd_mps": SensorClasses("DVLs", {"DVL": 0.1}, 3e-4),
    }
)
"""By the key of the settings."""


def readings_scatter(readings: Floats, step_s: float) -> float:
    """Bound the white noise density of a sensor by how its readings, shape (k, 3), scatter from sample to sample.

    What is left of three readings after a straight line is noise, vibration, and what the vehicle does within two
    steps: at least the sensor's noise, unless it smooths. The largest of the axes, each the median over blocks; NaN of
    fewer than three readings.
    """
    bends = np.diff(readings, n=2, axis=0) / np.sqrt(6.0)  # of white noise: 1, -2 and 1 times it, squared and added
    if not len(bends):
        return np.nan
    length = min(BLOCK, len(bends))
    blocks = bends[: len(bends) // length * length].reshape(-1, length, 3)
    power = np.median(np.mean(blocks**2, axis=1), axis=0)
    return float(np.sqrt(power.max() * step_s))


def sensor_class(key: str, noise: float) -> str:
    """Name the best class of `CLASSES` that may be so noisy; empty where none is."""
    return next((name for name, worst in CLASSES[key].worst.items() if noise <= worst), "")


def beyond_the_sensor(key: str, noise: float, scatter: float = 0.0) -> str:
    """Say why a white noise cannot be its sensor's; empty where it may be.

    The scatter is that of `readings_scatter`; 0 where the readings show nothing of the noise alone, as those of a DVL.
    """
    sensors, reasons = CLASSES[key], []
    best, worst = min(sensors.worst.values()), max(sensors.worst.values())
    if scatter and noise > best and noise > FILTERED * scatter:
        reasons.append(f"{noise / scatter:.0f} times what the readings scatter by ({scatter:.2g})")
    if noise > worst and noise > RESTLESS * scatter:
        reasons.append(f"more than any {sensors.name} have ({worst:g})")
    if noise < sensors.least:
        reasons.append(f"less than any {sensors.name} have ({sensors.least:g})")
    return " and ".join(reasons)
