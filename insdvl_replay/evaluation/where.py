"""Where a candidate helped: its drift over that of the baseline, by what the vehicle does.

The drift is the one of the row *drift in 30 s*: the change of the horizontal position error over 30 s, from the start
that the dive had. Each of these windows is sorted into bins by what the vehicle does in it. A window may be in several
bins, or in none. What the vehicle does comes from the reference, or from the baseline where the reference does not give
it, and from the stream of the DVL. It never comes from a candidate.

A bin is **notable** if two intervals are wholly beyond the band of a factor 1.05, on the same side: that of the ratio
in the bin, and that of this ratio over the ratio in the rest of the dive. So a candidate that is worse everywhere has
no notable bin, and a bin that is only less good than the rest is not notable either. Both intervals are those of a
verdict: one sample is one dive, and Holm's method widens them for the number of bins. No verdict depends on them.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from msgspec.structs import replace

from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    DvlColumns,
    Floats,
    Mask,
    ReferenceColumns,
    TimeNs,
    seconds,
)
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import BINS, DRIFT_STRETCHES
from insdvl_replay.core.states import DEG
from insdvl_replay.core.tables import WhereRow, finite
from insdvl_replay.evaluation.answers import DECIDED, EVERY_DIVE, median_of
from insdvl_replay.evaluation.drift import Segments, time_segments
from insdvl_replay.evaluation.interval import (
    LEVEL,
    Interval,
    holm_levels,
    log_ratio_interval,
    word_of_interval,
)
from insdvl_replay.evaluation.reference_errors import SHORT_S, USUAL_STEPS
from insdvl_replay.geometry.rotation import rpy_from_mat

QUANTITY: Final = "drift_30s"  # the shortest drift of the evidence
WINDOW_S: Final = DRIFT_STRETCHES[QUANTITY].length

# --- What the vehicle does in a window of 30 s. All thresholds are here.

# The range of the heading. Waves and a loose autopilot yaw by some degrees to each side. A turn to the next leg has 90
# or 180 deg, and half of the smaller one is a turn. Between the limits a window is neither.
STRAIGHT_DEG: Final = 15.0
TURN_DEG: Final = 45.0
# A slower vehicle has no course, as in `drift.SLOWEST_MPS`: it moves by less than 3 m.
HOVER_MPS: Final = 0.1
# The mean vertical speed. Keeping a depth, or following a flat bottom, is slower; a glider or a diving AUV is faster.
CLIMB_MPS: Final = 0.1
# Time without a velocity, a third of the window. Shorter losses hardly drift.
LOST_S: Final = 10.0
# The mean altitude. Inspections are below it, where beams meet slopes and the limits of the DVL; surveys are above.
NEAR_BOTTOM_M: Final = 3.0
# The mean speed over the median of the moving windows of the dive: vehicles differ too much for speeds in m/s.
FAST: Final = 1.25
SLOW: Final = 0.8

# Windows of a bin, and of the rest, that make a ratio. They begin every 5 s, so that one loss of 10 s makes four.
FEWEST_WINDOWS: Final = 4
FEWEST_BEAMS: Final = 3  # that make a velocity


class Motion(NamedTuple):
    """What the vehicle does at k times."""

    time_ns: TimeNs  # (k,)
    heading_rad: Floats  # (k,), without jumps by a full turn
    velocity_n: Floats  # (k, 3), over ground, m/s


class Windows(NamedTuple):
    """Which of m windows are in each bin, and in which windows it is known whether they are; (m,) each."""

    inside: Mapping[str, Mask]
    known: Mapping[str, Mask]


def motion_of(time_ns: TimeNs, reference: ReferenceColumns, baseline: History) -> Motion:
    """Return how the vehicle moves at times that the reference and the baseline share.

    Heading and velocity are the reference's if it has them at all of the times, else the baseline's.
    """
    theirs = np.searchsorted(reference.time_ns, time_ns)
    ours = np.searchsorted(baseline.time_ns, time_ns)
    velocity_n = reference.velocity_n[theirs]
    if not np.isfinite(velocity_n).all():
        velocity_n = baseline.velocity_n[ours]
    mat_nb = reference.mat_nb[theirs]
    if not np.isfinite(mat_nb).all():
        mat_nb = baseline.mat_nb[ours]
    heading_rad = np.unwrap(rpy_from_mat(mat_nb)[:, 2])
    return Motion(time_ns, heading_rad, velocity_n)


def windows_by_bin(motion: Motion, dvl: DvlColumns, segments: Segments) -> Windows:
    """Sort windows into bins by the thresholds of this module.

    Parameters
    ----------
    motion : Motion
        At the k compared times.
    dvl : DvlColumns
        All pings, for bottom lock and altitude.
    segments : Segments
        First and last row of each of the m windows.
    """
    time_s = seconds(motion.time_ns, motion.time_ns[:1])
    length_s = time_s[segments.last] - time_s[segments.first]
    speed_mps = np.hypot(motion.velocity_n[:, 0], motion.velocity_n[:, 1])
    mean_speed_mps = _integral(time_s, speed_mps, segments) / length_s
    mean_down_mps = _integral(time_s, motion.velocity_n[:, 2], segments) / length_s
    turned_deg = _range(motion.heading_rad, segments) / DEG
    lost_s = _lost_s(motion.time_ns, dvl, segments)
    altitude_m = _mean_altitude_m(motion.time_ns, dvl, segments)
    moves = mean_speed_mps >= HOVER_MPS
    usual_mps = np.nan
    if moves.any():
        usual_mps = float(np.median(mean_speed_mps[moves]))
    inside = {
        "straight": moves & (turned_deg <= STRAIGHT_DEG),
        "turns": turned_deg >= TURN_DEG,
        "hover": mean_speed_mps < HOVER_MPS,
        "climbs": np.abs(mean_down_mps) >= CLIMB_MPS,
        "no_bottom_lock": lost_s >= LOST_S,
        "near_bottom": altitude_m <= NEAR_BOTTOM_M,
        "fast": mean_speed_mps >= FAST * usual_mps,
        "slow": moves & (mean_speed_mps <= SLOW * usual_mps),
    }
    known = dict.fromkeys(BINS, np.isfinite(mean_speed_mps + mean_down_mps + turned_deg))
    known["near_bottom"] = np.isfinite(altitude_m)
    return Windows(inside, known)


def _integral(time_s: Floats, values: Floats, segments: Segments) -> Floats:
    """Integrate values, shape (k,), over each window."""
    steps = np.diff(time_s) * (values[1:] + values[:-1]) / 2.0
    until = np.append(0.0, np.cumsum(steps))
    return np.asarray(until[segments.last] - until[segments.first])


def _range(values: Floats, segments: Segments) -> Floats:
    """Return the largest minus the smallest value, of shape (k,), in each window."""
    if not len(segments.first):
        return np.empty(0)
    # Every other slice is a window, those between them are not asked for.
    edges = np.stack([segments.first, segments.last + 1], axis=1).ravel()
    padded = np.append(values, values[-1:])
    largest = np.maximum.reduceat(padded, edges)[::2]
    smallest = np.minimum.reduceat(padded, edges)[::2]
    return np.asarray(largest - smallest)


def _lost_s(time_ns: TimeNs, dvl: DvlColumns, segments: Segments) -> Floats:
    """Return for how long each window has no velocity of the DVL."""
    valid_ns = dvl.time_ns[has_velocity(dvl)]
    # Before the first velocity and after the last one there is none, too.
    edges_ns = np.concatenate([time_ns[:1], valid_ns, time_ns[-1:]])
    edges_ns = np.unique(np.clip(edges_ns, time_ns[0], time_ns[-1]))
    steps_s = np.diff(edges_ns) / NS_PER_S
    longest_s = SHORT_S
    if len(valid_ns) > 1:
        usual_s = float(np.median(np.diff(valid_ns))) / NS_PER_S
        longest_s = max(USUAL_STEPS * usual_s, SHORT_S)
    lost_s = np.append(0.0, np.cumsum(np.where(steps_s > longest_s, steps_s, 0.0)))
    until_s = np.interp(seconds(time_ns, time_ns[0]), seconds(edges_ns, time_ns[0]), lost_s)
    return np.asarray(until_s[segments.last] - until_s[segments.first])


def has_velocity(dvl: DvlColumns) -> Mask:
    """Return which pings have a velocity, or beams enough for one, shape (p,)."""
    if dvl.velocity_d is not None:
        return np.asarray(np.isfinite(dvl.velocity_d).all(axis=1))
    if dvl.beam_velocity_mps is not None:
        beams = np.isfinite(dvl.beam_velocity_mps).sum(axis=1)
        return np.asarray(beams >= FEWEST_BEAMS)
    return np.zeros(len(dvl.time_ns), np.bool_)


def _mean_altitude_m(time_ns: TimeNs, dvl: DvlColumns, segments: Segments) -> Floats:
    """Return the mean altitude of the pings of each window, NaN without any."""
    if dvl.altitude_m is None:
        return np.full(len(segments.first), np.nan)
    known = np.isfinite(dvl.altitude_m)
    until_m = np.append(0.0, np.cumsum(dvl.altitude_m[known]))
    ping_ns = dvl.time_ns[known]
    first = np.searchsorted(ping_ns, time_ns[segments.first])
    last = np.searchsorted(ping_ns, time_ns[segments.last], side="right")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((until_m[last] - until_m[first]) / (last - first))


# --- The table of a dive.


def where_table(
    log: str,
    histories: Sequence[History],  # the first is the baseline
    drifts: Mapping[
        str, Floats
    ],  # by filter: its drift over each window, (m, 2), m; NaN if unknown
    time_ns: TimeNs,  # (k,), the compared times
    reference: ReferenceColumns,
    dvl: DvlColumns,
) -> list[WhereRow]:
    """Return the drift of each filter by bin, with the ratio of a candidate to the baseline.

    A candidate and the baseline are compared in the windows in which both have a drift. A bin has a row if it and the
    rest of the dive have `FEWEST_WINDOWS`.
    """
    baseline = histories[0].filter
    segments = time_segments(time_ns, WINDOW_S)
    if baseline not in drifts or len(drifts[baseline]) != len(segments.first):
        return []
    with np.errstate(invalid="ignore", over="ignore"):
        windows = windows_by_bin(motion_of(time_ns, reference, histories[0]), dvl, segments)
        squares = {name: (drift_m**2).sum(axis=1) for name, drift_m in drifts.items()}
        rows = []
        for history in histories:
            own = squares.get(history.filter)
            if own is not None and len(own) == len(segments.first):
                rows += _rows_of_filter(log, history.filter, (squares[baseline], own), windows)
    return [_alone(row) if row.filter == baseline else row for row in rows]


def _alone(row: WhereRow) -> WhereRow:
    """Return a row of the baseline, which is compared with nothing."""
    return replace(row, ratio=None, to_rest=None)


def _rows_of_filter(
    log: str,
    name: str,
    squares: tuple[Floats, Floats],  # (m,), squared drifts of the baseline and of the filter, m^2
    windows: Windows,
) -> list[WhereRow]:
    """Return the rows of a filter."""
    before, after = squares
    both = np.isfinite(before) & np.isfinite(after)
    rows = []
    for bin_ in BINS:
        known = windows.known[bin_] & both
        inside = windows.inside[bin_] & known
        rest = known & ~inside
        if min(np.count_nonzero(inside), np.count_nonzero(rest)) < FEWEST_WINDOWS:
            continue
        baseline_m = _rms(before[inside])
        value_m = _rms(after[inside])
        rest_m = _rms(after[rest])
        ratio = _quotient(value_m, baseline_m)
        row = WhereRow(
            log=log,
            filter=name,
            bin=bin_,
            unit="m",
            baseline=baseline_m,
            value=value_m,
            rest_value=rest_m,
            ratio=ratio,
            to_rest=_quotient(ratio, _quotient(rest_m, _rms(before[rest]))),
            windows=int(np.count_nonzero(inside)),
        )
        rows.append(row)
    return rows


def _rms(squares: Floats) -> float:
    return math.sqrt(float(np.mean(squares)))


def _quotient(new: float, old: float) -> float:
    """Return a ratio, NaN where it is not known or not finite."""
    if new == old and new >= 0.0:
        return 1.0
    if old > 0.0:
        return finite(new / old)
    return math.nan


# --- Over dives.


def where_between(old: WhereRow, new: WhereRow) -> WhereRow | None:
    """Return the drift of one filter in two runs of a dive, new over old; None where the windows are not the same."""
    if old.windows != new.windows:
        return None
    ratio = _quotient(finite(new.value), finite(old.value))
    rest = _quotient(finite(new.rest_value), finite(old.rest_value))
    return replace(new, baseline=old.value, ratio=ratio, to_rest=_quotient(ratio, rest))


def pooled_where(
    dives: Sequence[Sequence[WhereRow]],  # rows of one candidate, by dive
    *,
    level: float = LEVEL,
    vehicles: Sequence[str] | None = None,  # of each dive
) -> list[WhereRow]:
    """Pool the rows of one candidate over dives, and find the notable bins.

    Parameters
    ----------
    dives : sequence of sequence of WhereRow
        The rows of the candidate on each dive on which it is evaluated.
    level : float
        Confidence of all bins together; above 95 % where several candidates share it.
    vehicles : sequence of str, optional
        The vehicle of each dive, as of `interval.log_ratio_interval`.
    """
    if vehicles is None:
        vehicles = [""] * len(dives)
    having = _dives_by_bin(dives, vehicles)
    ratios = _intervals(having, "ratio", level)
    to_rest = _intervals(having, "to_rest", level)
    adjusted = _adjusted([interval.p for interval in to_rest], level)
    pooled = []
    for own, ratio, difference, p in zip(having, ratios, to_rest, adjusted, strict=True):
        pooled.append(_pooled_row(own.rows, ratio, difference, p))
    return pooled


class _DivesOfBin(NamedTuple):
    """The dives that have a ratio in one bin."""

    rows: list[WhereRow]
    vehicles: list[str]

    def logs(self, column: str) -> Floats:
        """The logarithms of a column, one of each dive."""
        return np.log([finite(getattr(row, column)) for row in self.rows])


def _dives_by_bin(
    dives: Sequence[Sequence[WhereRow]], vehicles: Sequence[str]
) -> list[_DivesOfBin]:
    """Return the dives of each bin that has any."""
    by_bin = {bin_: _DivesOfBin([], []) for bin_ in BINS}
    for rows, vehicle in zip(dives, vehicles, strict=True):
        for row in rows:
            if finite(row.ratio) > 0.0 and finite(row.to_rest) > 0.0:
                by_bin[row.bin].rows.append(row)
                by_bin[row.bin].vehicles.append(vehicle)
    return [own for own in by_bin.values() if own.rows]


def _intervals(having: Sequence[_DivesOfBin], column: str, level: float) -> list[Interval]:
    """Return the interval of each bin, so that all of them together err as seldom as one."""
    p_values = []
    for own in having:
        alone = log_ratio_interval(own.logs(column), level=level, vehicles=own.vehicles)
        p_values.append(alone.p)
    found = []
    for own, share in zip(having, holm_levels(p_values, level), strict=True):
        interval = log_ratio_interval(own.logs(column), level=share, vehicles=own.vehicles)
        found.append(interval)
    return found


def _adjusted(p_values: Sequence[float], level: float) -> list[float]:
    """Return p of each bin, for both sides and adjusted for all bins, to be compared with 0.05; NaN stays."""
    allowed = (1.0 - LEVEL) / (1.0 - level)
    known = [number for number, p in enumerate(p_values) if p == p]
    adjusted = [math.nan] * len(p_values)
    largest = 0.0
    left = len(known)
    for number in sorted(known, key=lambda number: p_values[number]):
        largest = max(largest, min(1.0, 2.0 * p_values[number] * left * allowed))
        adjusted[number] = largest
        left -= 1
    return adjusted


def _pooled_row(
    rows: Sequence[WhereRow], ratio: Interval, to_rest: Interval, p_adjusted: float
) -> WhereRow:
    word = word_of_interval(ratio.low, ratio.high)
    is_other = word == word_of_interval(to_rest.low, to_rest.high)
    return WhereRow(
        log=EVERY_DIVE,
        filter=rows[0].filter,
        bin=rows[0].bin,
        unit=rows[0].unit,
        baseline=median_of(finite(row.baseline) for row in rows),
        value=median_of(finite(row.value) for row in rows),
        rest_value=median_of(finite(row.rest_value) for row in rows),
        ratio=ratio.ratio,
        low=ratio.low,
        high=ratio.high,
        to_rest=to_rest.ratio,
        to_rest_low=to_rest.low,
        to_rest_high=to_rest.high,
        p_adjusted=p_adjusted,
        stands_out=is_other and word in DECIDED,
        dives=ratio.dives,
        windows=sum(row.windows for row in rows),
    )


def notable(rows: Sequence[WhereRow]) -> list[WhereRow]:
    """Return the notable rows, the surest first."""
    found = [row for row in rows if row.stands_out]
    return sorted(
        found, key=lambda row: (finite(row.p_adjusted), -abs(math.log(row.to_rest or 1.0)))
    )
