"""The DVL outage test: the drift of a filter without the DVL, measured by the held-out velocities themselves.

This needs no reference. It does not see heading, scale and a constant turn about down, which prediction and measurement
share; it measures levels, accelerometer biases, gyro biases through gravity, lever arm, time stamps and noise.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Floats,
    Integers,
    Mask,
    TimeNs,
    is_new,
    seconds,
)
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import OUTAGE_WINDOWS_S
from insdvl_replay.core.tables import OutageRow, finite
from insdvl_replay.evaluation.consistency import chi_square_quantile
from insdvl_replay.evaluation.reference_errors import SHORTEST_M

BURN_IN_S: Final = 100  # No windows while the filters still converge.
SHORTEST_S: Final = BURN_IN_S + 2 * int(OUTAGE_WINDOWS_S[0])  # of a dive that has the test
SHOWN_S: Final = 60
SHOWN_EVERY_S: Final = 30  # Windows for a picture of the drift over time may overlap.
# Of one length. More tell hardly more of a dive, which counts once, but take several times as long as
# the filters themselves: in nine hours those of all lengths would be three dives long.
MOST_WINDOWS: Final = 100
# A gap of this many usual intervals is an outage; a single missing ping is not.
OUTAGE: Final = 2.5
# With fewer pings in a window, the trapezoidal rule makes the drift over 1 % too large.
FEWEST_PINGS: Final = 6
NAN: Final = float("nan")
GEOMETRY: Final = 10.0  # mean NIS per degree of freedom that no noise of the sensors explains
ALARM: Final = 2.0  # A smaller mean NIS per degree of freedom is no alarm: sigma is too small by less than 30 %.
SURELY: Final = 0.999  # Probability of no alarm by chance, for each filter and length.

Rows = Integers
# Whether the IMU has a long gap between some times and others, as `nav.timeline.Gaps.overlap`.
InGap = Callable[[TimeNs, TimeNs], Mask]


# --- The windows of a dive.


@dataclass(frozen=True)
class Windows:
    """The windows of one length, each from the last used ping to the last held-out one."""

    window_s: int  # length; from ping to ping it differs by less than two intervals
    first: Rows  # (w,), rows of these pings
    last: Rows
    left_out: int  # windows in which the DVL or the IMU has a gap of its own


@dataclass(frozen=True)
class OutagePlan:
    """All windows of a dive."""

    ping_ns: TimeNs  # (m,), times of the pings with a velocity
    by_length: tuple[Windows, ...]  # lengths that fit the dive; those of one do not overlap
    shown: Windows  # overlapping, for the drift over time

    @cached_property
    def runs(self) -> tuple[Rows, Rows]:
        """First and last ping of each run, shape (r,): from each first ping the longest window that begins there."""
        every = (*self.by_length, self.shown)
        first = np.concatenate([w.first for w in every])
        last = np.concatenate([w.last for w in every])
        order = np.lexsort((-last, first))
        longest = order[is_new(first[order])]
        return first[longest], last[longest]

    @property
    def start_ns(self) -> TimeNs:
        """Times at which a history has to hold P for the runs to start there, shape (r,)."""
        return self.ping_ns[self.runs[0]]

    @property
    def windows_ns(self) -> Iterator[tuple[int, int]]:
        """Times of the last used and of the last held-out ping of each run."""
        first, last = self.runs
        return zip(self.ping_ns[first].tolist(), self.ping_ns[last].tolist(), strict=True)


def plan_outages(
    ping_ns: TimeNs,
    in_gap: InGap,
    start_ns: int,
    end_ns: int,
) -> OutagePlan:
    """Place windows over a dive, after the filters have settled.

    They follow one upon the other, or in long dives at equal distances, see MOST_WINDOWS.
    """
    usual_ns = np.inf
    if len(ping_ns) > 1:
        usual_ns = float(np.median(np.diff(ping_ns)))
    middle_ns = ping_ns[:-1] + np.diff(ping_ns) // 2
    outages_before = np.cumsum(np.diff(ping_ns, prepend=ping_ns[:1]) > OUTAGE * usual_ns)

    def is_too_short(window_s: int) -> bool:
        is_dive_short = end_ns - start_ns < (BURN_IN_S + 2 * window_s) * NS_PER_S
        return is_dive_short or window_s * NS_PER_S < FEWEST_PINGS * usual_ns

    def last_end_ns() -> int:
        if end_ns - ping_ns[-1] > OUTAGE * usual_ns:
            return end_ns  # The DVL has a gap: the windows in it are counted as left out.
        return min(end_ns, int(ping_ns[-1] + 0.5 * usual_ns))

    def windows(window_s: int, every_s: int) -> Windows:
        if is_too_short(window_s):
            return Windows(window_s, np.empty(0, np.int64), np.empty(0, np.int64), 0)
        latest_s = (last_end_ns() - start_ns) // NS_PER_S - window_s
        places = (latest_s - BURN_IN_S) // every_s + 1
        step_s = every_s * max(1, math.ceil(places / MOST_WINDOWS))
        begun_ns = start_ns + np.arange(BURN_IN_S, latest_s + 1, step_s) * NS_PER_S
        # The nearest pings. Without some near its ends, or with an outage inside, a window is left out.
        first = np.searchsorted(middle_ns, begun_ns)
        ended_ns = ping_ns[first] + window_s * NS_PER_S
        last = np.searchsorted(middle_ns, ended_ns)
        away_ns = np.maximum(abs(ping_ns[first] - begun_ns), abs(ping_ns[last] - ended_ns))
        is_far = away_ns > 0.5 * OUTAGE * usual_ns
        is_whole = ~is_far & (outages_before[first] == outages_before[last])
        if len(first):
            is_whole &= ~in_gap(ping_ns[first], ping_ns[last])
        return Windows(window_s, first[is_whole], last[is_whole], int(np.sum(~is_whole)))

    lengths = [windows(int(length_s), int(length_s)) for length_s in OUTAGE_WINDOWS_S]
    by_length = tuple(found for found in lengths if len(found.first) + found.left_out)
    return OutagePlan(ping_ns, by_length, windows(SHOWN_S, SHOWN_EVERY_S))


# --- The filters in these windows.


@dataclass(frozen=True)
class OutageRun:
    """One filter in one run: at the last used ping, and at the held-out pings."""

    time_s: Floats  # (k,), from the last used ping on
    # (k, 3), m/s, predicted minus measured at the DVL; zero at the last used ping
    velocity_error_n: Floats
    drift_n: Floats  # (k, 3), m, its integral
    nis: Floats  # (k,), of each held-out ping; NaN at the last used one
    minus_log_score: Floats  # (k,), nat, of each held-out ping; NaN at the last used one


@dataclass(frozen=True)
class OutageRuns:
    """All runs of all filters of a dive."""

    plan: OutagePlan
    distance_m: Floats  # (m,), travelled up to each ping of the plan, by the DVL's velocities
    # by filter, the baseline first; one for each of the plan's runs
    runs: Mapping[str, tuple[OutageRun, ...]]


def outage_run(history: History) -> OutageRun:
    """Turn the innovations of held-out velocities to n; the first row of the history has none."""
    innovations, *_ = history.innovations
    time_s = seconds(history.time_ns, history.time_ns[0])
    velocity_error_n = np.zeros((len(time_s), 3))
    nis = np.full(len(time_s), np.nan)
    minus_log_score = np.full(len(time_s), np.nan)
    with np.errstate(over="ignore", invalid="ignore"):
        velocity_error_n[1:] = np.einsum("kij,kj->ki", history.mat_nb[1:], innovations.innovation)
        nis[1:] = innovations.nis
        constant = innovations.dof * math.log(2.0 * math.pi)
        minus_log_score[1:] = 0.5 * (innovations.nis + innovations.log_det + constant)
        return OutageRun(
            time_s, velocity_error_n, _integral(time_s, velocity_error_n), nis, minus_log_score
        )


def drift_run(time_ns: TimeNs, velocity_error_n: Floats) -> OutageRun:
    """Integrate errors of the velocity from the last used ping on, whose row is the first and counts as zero."""
    time_s = seconds(time_ns, time_ns[0])
    error_n = np.concatenate([np.zeros((1, 3)), velocity_error_n[1:]])
    unknown = np.full(len(time_s), np.nan)
    return OutageRun(time_s, error_n, _integral(time_s, error_n), unknown, unknown)


def distance_along_m(time_ns: TimeNs, velocity_b: Floats) -> Floats:
    """Integrate the speed that a DVL measures, m/s, from the first ping on."""
    return _integral(seconds(time_ns, time_ns[0]), np.linalg.norm(velocity_b, axis=1))


def _integral(time_s: Floats, rate: Floats) -> Floats:
    """Integrate along the first axis by trapezoids, from zero on."""
    steps = np.diff(time_s).reshape(-1, *[1] * (rate.ndim - 1)) * 0.5 * (rate[1:] + rate[:-1])
    return np.concatenate([np.zeros_like(rate[:1]), np.cumsum(steps, axis=0)])


class WindowEnds(NamedTuple):
    """Errors of a filter at the end of each window of one length, shape (w,)."""

    drift_ne_m: Floats  # (w, 2), north and east
    drift_m: Floats  # horizontal
    down_m: Floats  # absolute
    velocity_mps: Floats  # horizontal error
    nis: Floats  # of the last held-out ping


def window_ends(outages: OutageRuns, name: str, windows: Windows) -> WindowEnds:
    """Return the ends of a filter's windows; those of two filters are pairs."""
    rows = np.searchsorted(outages.plan.runs[0], windows.first)
    steps = windows.last - windows.first
    drift_n = np.empty((len(rows), 3))
    velocity_error_n = np.empty((len(rows), 3))
    nis = np.empty(len(rows))
    for window, (row, step) in enumerate(zip(rows, steps, strict=True)):
        run = outages.runs[name][row]
        drift_n[window] = run.drift_n[step]
        velocity_error_n[window] = run.velocity_error_n[step]
        nis[window] = run.nis[step]
    with np.errstate(over="ignore", invalid="ignore"):
        return WindowEnds(
            drift_ne_m=drift_n[:, :2],
            drift_m=np.hypot(drift_n[:, 0], drift_n[:, 1]),
            down_m=np.abs(drift_n[:, 2]),
            velocity_mps=np.hypot(velocity_error_n[:, 0], velocity_error_n[:, 1]),
            nis=nis,
        )


def window_drifts(outages: OutageRuns) -> dict[str, dict[str, Floats]]:
    """Return the drift, (w, 2) north and east, in each window that does not overlap, by filter and length, m."""
    drifts: dict[str, dict[str, Floats]] = {}
    for name in outages.runs:
        drifts[name] = {}
        for windows in outages.plan.by_length:
            ends = window_ends(outages, name, windows)
            drifts[name][f"{windows.window_s}s"] = ends.drift_ne_m
    return drifts


class OutageCurve(NamedTuple):
    """The horizontal drift of one filter over the time without DVL, for the windows that are drawn."""

    time_s: Floats  # (k,), from the last used ping on
    median_m: Floats  # (k,)
    p95_m: Floats  # (k,)
    begin_ns: TimeNs  # (w,), last used ping before each window
    drift_m: Floats  # (w,), horizontal drift at the end of each


def outage_curves(outages: OutageRuns) -> dict[str, OutageCurve]:
    """Return the drift of each filter in the windows that are shown, at whole seconds; empty without windows."""
    shown = outages.plan.shown
    if not len(shown.first):
        return {}
    at_s = np.arange(SHOWN_S + 1.0)
    begin_ns = outages.plan.ping_ns[shown.first]
    rows = np.searchsorted(outages.plan.runs[0], shown.first)
    curves = {}
    for name, runs in outages.runs.items():
        drift_m = np.array([_horizontal_drift_m(runs[row], at_s) for row in rows])
        known = np.isfinite(drift_m).all(axis=0)
        median_m = np.full(len(at_s), np.nan)
        p95_m = np.full(len(at_s), np.nan)
        if known.any():
            median_m[known], p95_m[known] = np.quantile(drift_m[:, known], [0.5, 0.95], axis=0)
        ends_m = window_ends(outages, name, shown).drift_m
        curves[name] = OutageCurve(at_s, median_m, p95_m, begin_ns, ends_m)
    return curves


def _horizontal_drift_m(run: OutageRun, at_s: Floats) -> Floats:
    """Return the drift of a run at some times after the last used ping."""
    with np.errstate(over="ignore", invalid="ignore"):
        drift_m = np.hypot(run.drift_n[:, 0], run.drift_n[:, 1])
        return np.interp(at_s, run.time_s, drift_m)


# --- The table, and the alarm.


def outage_test_table(log: str, outages: OutageRuns) -> list[OutageRow]:
    """Return the drift of each filter in windows of each length that fits the dive."""
    if not outages.runs:
        return []
    baseline, *candidates = outages.runs
    rows = []
    for windows in outages.plan.by_length:
        baseline_m = window_ends(outages, baseline, windows).drift_m
        with np.errstate(over="ignore", invalid="ignore"):
            rows.append(_outage_row(log, outages, baseline, windows, np.empty(0)))
            for name in candidates:
                rows.append(_outage_row(log, outages, name, windows, baseline_m))
    return rows


def _outage_row(
    log: str,
    outages: OutageRuns,
    name: str,
    windows: Windows,
    baseline_m: Floats,  # (w,), the drifts of the baseline; none of it in its own row
) -> OutageRow:
    """Return the drift of a filter in windows of one length."""
    ends = window_ends(outages, name, windows)
    distance_m = outages.distance_m[windows.last] - outages.distance_m[windows.first]
    moved = distance_m >= SHORTEST_M
    ratio = NAN
    won_pct = NAN
    if len(baseline_m) > 1 and np.isfinite([baseline_m, ends.drift_m]).all():
        won = np.mean(ends.drift_m < baseline_m) + np.mean(ends.drift_m <= baseline_m)
        won_pct = 50.0 * float(won)
        if _rms(baseline_m) > 0.0:
            ratio = _rms(ends.drift_m) / _rms(baseline_m)
    nis = NAN
    if len(ends.nis):
        nis = float(np.mean(ends.nis))
    return OutageRow(
        log=log,
        filter=name,
        window_s=str(windows.window_s),
        windows=len(windows.first),
        left_out=windows.left_out,
        drift_median_m=_quantile(ends.drift_m, 0.5),
        drift_rms_m=_rms(ends.drift_m),
        drift_p95_m=_quantile(ends.drift_m, 0.95),
        drift_of_distance_pct=_quantile(100.0 * ends.drift_m[moved] / distance_m[moved], 0.5),
        end_velocity_mps=_quantile(ends.velocity_mps, 0.5),
        vertical_median_m=_quantile(ends.down_m, 0.5),
        ratio_to_baseline=ratio,
        windows_won_pct=won_pct,
        nis_per_dof=nis / 3.0,
    )


def _rms(values: Floats) -> float:
    """Return the root mean square; NaN for no values."""
    if len(values):
        return float(np.sqrt(np.mean(values**2)))
    return NAN


def _quantile(values: Floats, q: float) -> float:
    """Return a quantile; NaN for no values, or if one is not finite."""
    if len(values) and np.isfinite(values).all():
        return float(np.quantile(values, q))
    return NAN


def outage_alarm(
    rows: Sequence[OutageRow],
    names: Collection[str],
    under_way: Mapping[str, float] = MappingProxyType({}),
) -> str:
    """Say that the sigma of a filter grows too slowly without the DVL; empty if it does not.

    The NIS at the ends of windows of one length are chi-square and nearly independent. The window length that exceeds
    its limit most is reported. No noise makes it this large where the innovations under way, as NIS / dof of each
    filter, are consistent: then the geometry is wrong.
    """
    known = [row for row in rows if row.filter in names and row.nis_per_dof is not None]
    worst = max(known, key=_excess, default=None)
    if worst is None or _excess(worst) <= 1.0:
        return ""
    shown = [row for row in known if row.window_s == worst.window_s]
    sizes = [f"{row.filter} {row.nis_per_dof:.3g}" for row in shown]
    cure = "Raise [noise]."
    for row in shown:
        if finite(row.nis_per_dof) > GEOMETRY > 5.0 * under_way.get(row.filter, np.inf):
            cure = (
                "The geometry is wrong: check dvl.mounting_rpy_deg, imu.axes and dvl.lever_arm_m."
            )
    return (
        f" NIS / dof after {worst.window_s} s without DVL: {', '.join(sizes)}, expected 1. {cure}"
    )


def _excess(row: OutageRow) -> float:
    """Return the mean NIS at the ends of windows over the limit of the alarm; 0 below `ALARM`."""
    size = finite(row.nis_per_dof)
    dof = 3 * row.windows
    if not dof or not size > ALARM:
        return 0.0
    return size / max(ALARM, chi_square_quantile(SURELY, dof) / dof)
