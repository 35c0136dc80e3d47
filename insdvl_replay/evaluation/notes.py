"""Notes and hints on filters, settings and the reference.

First updates that did not happen as configured, then hints on settings, limits of a sensor's white noise, and limits of
the reference.
"""

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Dive, Floats, TimeNs, seconds
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.notes import note
from insdvl_replay.core.quantities import AXES, axis_of, is_reserved
from insdvl_replay.core.states import DEG, PHI, SENSORS
from insdvl_replay.core.tables import Tables, finite
from insdvl_replay.core.words import Severity
from insdvl_replay.evaluation.consistency import (
    FEWEST_UPDATES,
    MANY_REJECTED,
    autocorrelation,
    chi_square_quantile,
    rejected,
    repeats,
)
from insdvl_replay.evaluation.reference_errors import WELL_COVERED, Known, covered_share

# Median NIS over that of chi-square: the sensor's error is three times its sd, or the sensor is misread.
CONTRADICTED: Final = 9.0
SLOW: Final = 0.3  # Lag-1 correlation of heading innovations from which their error is slow.
# In a smaller turn, a straight line between two samples misses less than 0.4 % of the speed, 1 - cos(5 deg).
SMALL_TURN: Final = 10.0 * DEG
# In a larger turn it misses more than 7 %, 1 - cos(22.5 deg), and a turn and its return may be missed.
LARGE_TURN: Final = 45.0 * DEG
# Ratio of the NIS of two axes: wrong mounting, arm or delay of a DVL does not affect all axes equally.
APART: Final = 5.0
# NIS/dof from which an axis is also compared with down. Beams 30 deg off the vertical have six times less variance
# along down, and the filter assumes equal variance on all axes.
TOO_LARGE: Final = 1.5
TELLING_PCT = 0.5
TELLING_DEG = 0.5
FAR_OFF: Final = {"scale": 20.0, "turn": 10.0}  # %, deg: no result of such a replay is worth much
# Standard errors by which a track has to be off; those of a turn include the sigma of the heading.
CERTAIN_SDS: Final = 5.0
# Mean NIS/dof outside which the noise settings are far off.
LEAST = 0.2
MOST = 5.0
NOISE_FAR_OFF: Final = "noise_far_off"
# An IMU that smooths its readings has up to this factor less noise from sample to sample than over a second.
FILTERED: Final = 10.0
# Vibration that comes and goes makes the scatter this many times larger than in the median block.
RESTLESS: Final = 2.0
BLOCK: Final = 50  # Samples of a block; turns and outliers affect few blocks.


# --- Notes on updates that did not happen as configured.


def update_notes(histories: tuple[History, ...]) -> tuple[Note, ...]:
    """Warn of filters without updates of an aiding, with innovations that are not finite, with many rejections, or with
    a sensor that contradicts them.
    """
    notes: list[Note] = []
    for history in histories:
        for met in history.innovations:
            notes += _warnings_on(history, met)
        if len(history.reopened_ns):
            notes.append(_reopened(history))
    return tuple(notes)


def _warnings_on(history: History, met: Innovations) -> list[Note]:
    """Warn of the updates of a filter by one measurement."""
    if not len(met.used):
        return [_without_updates(history, met)]
    if met.is_held_out:
        return []
    if not np.isfinite(met.nis).all():
        return [_not_finite(history, met)]
    found = [
        _many_rejected(history, met),
        _contradicting(history, met),
        _slow_heading_error(history, met),
    ]
    return [warning for warning in found if warning is not None]


def _without_updates(history: History, met: Innovations) -> Note:
    code = "aiding_without_updates"
    if met.measurement == "acceleration":
        code = "aiding_without_updates acceleration"
    return note(
        code,
        0,
        filter=history.filter,
        measurement=met.measurement,
    )


def _not_finite(history: History, met: Innovations) -> Note:
    """Warn of a filter that diverged, or of a user's measurement whose prediction is not always a number."""
    lost = ~np.isfinite(met.nis)
    code = "filter_not_finite"
    if not is_reserved(met.measurement) and np.isfinite(history.velocity_n[-1]).all():
        code = "innovations_not_finite"
    return note(
        code,
        int(lost.sum()),
        filter=history.filter,
        measurement=met.measurement,
        all_count=len(lost),
        first=np.argmax(lost) + 1,
    )


def _many_rejected(history: History, met: Innovations) -> Note | None:
    total = len(met.used)
    many = int(rejected(met).sum())
    if not many > MANY_REJECTED * total:
        return None
    return note(
        "gate_rejects_many",
        many,
        filter=history.filter,
        measurement=met.measurement,
        all_count=total,
    )


def _contradicting(history: History, met: Innovations) -> Note | None:
    """Warn of a sensor other than the DVL that contradicts all others.

    The median is used, since outliers are few and the gate rejects them.
    """
    kind = met.measurement
    if kind not in SENSORS or len(met.used) < FEWEST_UPDATES:
        return None
    size = float(np.median(met.nis)) / chi_square_quantile(0.5, met.dof)
    if not size > CONTRADICTED:
        return None
    count = len(met.used)
    return note(
        f"{kind}_disagrees",
        count,
        filter=history.filter,
        sensor=kind,
        size=size,
    )


def _slow_heading_error(history: History, met: Innovations) -> Note | None:
    """Warn of a heading sensor whose error is slow, where the filter has no state for it.

    Its innovations are small, since the filter follows the error.
    """
    estimates_bias = any(state.id == "heading_bias" for state in history.states)
    if met.measurement != "heading" or estimates_bias:
        return None
    value, limit = autocorrelation(met.standardised, met.used)
    if not (value >= SLOW and repeats(value, limit)):
        return None
    count = len(met.used)
    return note(
        "heading_slow_error",
        count,
        filter=history.filter,
        correlation=value,
    )


def _reopened(history: History) -> Note:
    """Warn of a filter that was set to the DVL again."""
    count = len(history.reopened_ns)
    first_ns = min(int(met.time_ns[0]) for met in history.innovations if len(met.time_ns))
    first_s = (int(history.reopened_ns[0]) - first_ns) / NS_PER_S
    return note(
        "gate_reopened",
        count,
        filter=history.filter,
        first_s=first_s,
    )


def constants_notes(histories: tuple[History, ...]) -> tuple[Note, ...]:
    """Note the filters' final estimates of sensor constants and of adaptive noise."""
    notes = []
    for history in histories:
        found = []
        count = history.constants.shape[1]
        for column, state in enumerate(history.states[len(history.states) - count :]):
            start = history.constants[0, column] / state.factor
            end = history.constants[-1, column] / state.factor
            start_sd = history.sd[0, state.index] / state.factor
            end_sd = history.sd[-1, state.index] / state.factor
            found.append(
                f"{state.label} {end:+.3g} {state.unit} (sd {end_sd:.2g} {state.unit}; "
                f"at the start {start:+.3g}, sd {start_sd:.2g})"
            )
        found += [
            f"noise of {innovations.measurement} {math.sqrt(innovations.noise_factor):.3g} times the setting"
            for innovations in history.innovations
            if innovations.noise_factor != 1.0
        ]
        if found:
            estimates = "; ".join(found)
            notes.append(
                note(
                    "constants_estimated",
                    len(found),
                    filter=history.filter,
                    estimates=estimates,
                )
            )
    return tuple(notes)


# --- Hints on settings, each with a command to run next.


def settings_hints(tables: Tables, baseline: History) -> tuple[Note, ...]:
    """Return hints on DVL geometry and noise, by the baseline's innovations and track."""
    name = baseline.filter
    sizes = {
        row.measurement: finite(row.mean_nis) / row.dof
        for row in tables.consistency
        if row.filter == name
    }
    found = [_hint_on_axes(name, sizes), _hint_on_track(tables, baseline)]
    if is_noise_far_off(tables, name):
        found.append(_hint_on_noise(name, sizes["velocity"]))
    return tuple(hint for hint in found if hint is not None)


def _hint_on_axes(name: str, sizes: Mapping[str, float]) -> Note | None:
    """Hint at the DVL's geometry where the mean NIS / dof, by measurement, differs between the axes of the velocity."""
    by_axis = {}
    for axis in AXES:
        part = axis_of("velocity", axis)
        if part in sizes:
            by_axis[axis] = sizes[part]
    if not by_axis:
        return None
    high = max(by_axis, key=by_axis.__getitem__)
    compared = dict(by_axis)
    if not by_axis[high] > TOO_LARGE:
        compared.pop(AXES[-1], None)
    if not compared:
        return None
    low = min(compared, key=compared.__getitem__)
    if not (by_axis[low] > 0.0 and by_axis[high] > APART * by_axis[low]):
        return None
    listed = ", ".join(f"{axis} {size:.2g}" for axis, size in by_axis.items())
    ratio = by_axis[high] / by_axis[low]
    return note(
        "innovations_apart",
        filter=name,
        sizes=listed,
        high=high,
        low=low,
        ratio=ratio,
    )


def _hint_on_track(tables: Tables, baseline: History) -> Note | None:
    """Hint at the DVL's geometry and the heading where the baseline's track has another scale or direction."""
    heading_sd_deg = float(np.max(baseline.sd[[0, -1], PHI.stop - 1])) / DEG
    least = {"scale": TELLING_PCT, "turn": TELLING_DEG}
    known_sd = {"scale": 0.0, "turn": heading_sd_deg}
    off = []
    severity = Severity.INFO
    for row in tables.track_fit:
        size = abs(finite(row.fitted))
        sd = math.hypot(finite(row.fitted_sd), known_sd[row.quantity])
        is_telling = size > least[row.quantity] and size > CERTAIN_SDS * sd
        if row.filter != baseline.filter or not is_telling:
            continue
        fitted = f"{finite(row.fitted):+.2f} {row.unit} (sd {sd:.2g} {row.unit})"
        off.append(f"a {row.quantity} of {fitted}")
        if size > FAR_OFF[row.quantity]:
            severity = Severity.WARNING
    if not off:
        return None
    changes = " and ".join(off)
    return note(
        "track_off",
        len(off),
        severity,
        filter=baseline.filter,
        changes=changes,
    )


def _hint_on_noise(name: str, size: float) -> Note:
    """Hint at the noise settings of a filter whose velocities have this mean NIS / dof."""
    word = "smaller" if size < LEAST else "larger"
    return note(
        NOISE_FAR_OFF,
        filter=name,
        smaller=word,
        size=size,
    )


def is_noise_far_off(tables: Tables, baseline: str) -> bool:
    """Return whether the size of the innovations shows that the noise settings are far off.

    Small but correlated innovations do not show it: they are a lasting error, which less noise would make worse.
    """
    for row in tables.consistency:
        if row.filter != baseline or row.measurement != "velocity":
            continue
        if row.mean_nis is None:
            return False
        size = row.mean_nis / row.dof
        lasts = repeats(finite(row.autocorrelation), finite(row.autocorrelation_limit))
        return size > MOST or (size < LEAST and not lasts)
    return False


# --- Whether a sensor can have a given white noise. A filter that fits its noise also fits the effects of a wrong lever
# arm or delay.


class SensorClasses(NamedTuple):
    """The classes of one kind of sensor."""

    name: str
    # the worst white noise of each class, SI units, best class first; as of the presets
    worst: Mapping[str, float]
    least: float  # below the noise of the best sensors


# By the key of the settings.
CLASSES: Final[Mapping[str, SensorClasses]] = MappingProxyType(
    {
        # Servo accelerometers have 1 to 10 ug/sqrt(Hz), good micromechanical ones 100; cheap ones reach 1000.
        "accel_white_mps_rts": SensorClasses(
            "accelerometers", {"fog": 5e-4, "tactical": 1.8e-3, "mems": 1e-2}, 1e-5
        ),
        # Navigators have 0.003 deg/sqrt(h) or less, tactical gyros 0.15; the cheapest reach 0.05 deg/s/sqrt(Hz).
        "gyro_white_rad_rts": SensorClasses(
            "gyros", {"fog": 1e-5, "tactical": 6e-5, "mems": 1e-3}, 1e-8
        ),
        # From 3 mm/s of a ping at 1 MHz to 3 cm/s at 150 kHz, which reaches furthest.
        "velocity_sd_mps": SensorClasses("DVLs", {"DVL": 0.1}, 3e-4),
        "beam_sd_mps": SensorClasses("DVLs", {"DVL": 0.1}, 3e-4),
    }
)


def readings_scatter(readings: Floats, step_s: float) -> float:
    """Return an upper bound of a sensor's white noise density, by the scatter of its readings, shape (k, 3).

    Three readings minus a straight line leave noise, vibration and the vehicle's motion within two steps. This is at
    least the sensor's noise, unless the sensor smooths. Returns the largest axis, each the median over blocks; NaN for
    fewer than three readings.
    """
    # of white noise: 1, -2 and 1 times it, squared and added
    bends = np.diff(readings, n=2, axis=0) / np.sqrt(6.0)
    if not len(bends):
        return np.nan
    length = min(BLOCK, len(bends))
    blocks = bends[: len(bends) // length * length].reshape(-1, length, 3)
    power = np.median(np.mean(blocks**2, axis=1), axis=0)
    return float(np.sqrt(power.max() * step_s))


def sensor_class(key: str, noise: float) -> str:
    """Name the best class of `CLASSES` that can have this noise; empty if none can."""
    for name, worst in CLASSES[key].worst.items():
        if noise <= worst:
            return name
    return ""


def beyond_the_sensor(key: str, noise: float, scatter: float = 0.0) -> str:
    """Say why a sensor cannot have this white noise; empty if it can.

    ``scatter`` is from `readings_scatter`; 0 if the readings do not show the noise, as with a DVL.
    """
    sensors = CLASSES[key]
    reasons = []
    best = min(sensors.worst.values())
    worst = max(sensors.worst.values())
    if scatter and noise > best and noise > FILTERED * scatter:
        reasons.append(f"{noise / scatter:.0f} times the scatter of the readings ({scatter:.2g})")
    if noise > worst and noise > RESTLESS * scatter:
        reasons.append(f"more than {sensors.name} can have ({worst:g})")
    if noise < sensors.least:
        reasons.append(f"less than {sensors.name} can have ({sensors.least:g})")
    return " and ".join(reasons)


# --- Limits of the reference.


def reference_notes(
    dive: Dive,
    start_ns: int,
    end_ns: int,
    history: History,
    evaluated_ns: TimeNs,
    *,
    independent: bool,
) -> tuple[Note, ...]:
    """Note the limits of the reference: errors that it shares, and parts of the dive that it does not cover."""
    reference = dive.reference
    truth = dive.truth
    if reference is None:
        return ()
    notes = []
    if not independent:
        notes.append(note("reference_not_independent"))
    known = {quantity: rows for quantity, rows in reference.known.items() if rows.any()}
    notes += _coverage_notes("reference", reference.time_ns, known, start_ns, end_ns)
    if truth is not None:
        known = {
            "accelerometer biases": np.asarray(np.isfinite(truth.accel_bias_b).all(axis=1)),
            "gyro biases": np.asarray(np.isfinite(truth.gyro_bias_b).all(axis=1)),
        }
        notes += _coverage_notes("truth", truth.time_ns, known, start_ns, end_ns)
    count = int(np.sum((reference.time_ns >= start_ns) & (reference.time_ns <= end_ns)))
    if left_out := count - len(evaluated_ns):
        thinned = note(
            "credibility_thinned",
            left_out,
            evaluated=len(evaluated_ns),
            all_count=count,
        )
        notes.append(thinned)
    return (*notes, *reference_rate_notes(history, reference.time_ns))


def _coverage_notes(
    source: str,
    time_ns: TimeNs,
    known: Mapping[str, Known],
    start_ns: int,
    end_ns: int,
) -> Iterator[Note]:
    """Warn of quantities that cover little of the replay: one note for each percentage, with all that have it."""
    by_percent: dict[str, list[str]] = {}
    for quantity, rows in known.items():
        share = covered_share(time_ns, rows, start_ns, end_ns)
        if share < WELL_COVERED:
            by_percent.setdefault(f"{100.0 * share:.0f}", []).append(quantity)
    inside = (time_ns >= start_ns) & (time_ns <= end_ns)
    for percent, quantities in by_percent.items():
        *others, last = quantities
        joined = f"{', '.join(others)} and {last}" if others else last
        count = min(int(np.sum(known[quantity] & inside)) for quantity in quantities)
        yield note(
            f"{source}_coverage",
            count,
            quantities=joined,
            source=source,
            percent=percent,
        )


def reference_rate_notes(history: History, reference_ns: TimeNs) -> tuple[Note, ...]:
    """Note that the reference is too slow for the turns of the dive; the history of any filter shows the motion.

    The note counts the intervals with more than `SMALL_TURN`, and is a warning above `LARGE_TURN`.
    """
    sampled = np.flatnonzero(np.isin(history.time_ns, reference_ns))
    if len(sampled) < 2:
        return ()
    # Turn and change of velocity since the last sample before each recorded time.
    rows = np.arange(sampled[0] + 1, sampled[-1] + 1)
    last = sampled[np.searchsorted(sampled, rows, side="left") - 1]
    # of a rotation: 1 + 2 cos(angle)
    trace = np.einsum("kij,kij->k", history.mat_nb[rows], history.mat_nb[last])
    turn = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    change_mps = np.linalg.norm(history.velocity_n[rows] - history.velocity_n[last], axis=1)
    since = history.time_ns[last]
    turning = turn > SMALL_TURN
    if not turning.any():
        return ()
    # A filter that broke down turns by no number.
    worst = int(np.nanargmax(turn))
    apart_s = float(
        seconds(
            reference_ns[np.searchsorted(reference_ns, since[worst], side="right")], since[worst]
        )
    )
    count = len(np.unique(since[turning]))
    severity = Severity.WARNING if turn[worst] > LARGE_TURN else Severity.INFO
    slow = note(
        "reference_slow",
        count,
        severity,
        apart_s=apart_s,
        turn_deg=turn[worst] / DEG,
        change_mps=np.nanmax(change_mps),
        enough_hz=turn[worst] / SMALL_TURN / apart_s,
    )
    return (slow,)
