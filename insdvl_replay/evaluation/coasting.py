"""How far a filter goes astray while the DVL is withheld from it, by the withheld velocities themselves.

This needs no reference. It says nothing of heading, of a DVL that is turned about down or reads too much everywhere:
prediction and measurement share these. It measures levels, accelerometer biases, gyro biases through gravity, lever
arm, time stamps and noise.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Floats, TimeNs, seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.table import finite
from insdvl_replay.core.tables import CoastingRow
from insdvl_replay.evaluation.chi_square import chi_square_quantile
from insdvl_replay.evaluation.coasting_windows import SHOWN_S, CoastingPlan, Windows
from insdvl_replay.evaluation.paired_statistics import windows_ratio
from insdvl_replay.evaluation.reference import SHORTEST_M

NAN: Final = float("nan")
ALARM: Final = 2.0
"""A smaller mean NIS per degree of freedom is no alarm: sigma is too small by less than 30 %."""
SURELY: Final = 0.999
"""So rarely is there an alarm by chance, of each filter and length."""


@dataclass(frozen=True)
class Coast:
    """One filter in one run: at the ping that it used last, and at those that were withheld."""

    time_s: Floats  # (k,), from the last used ping on
    velocity_error_n: Floats  # (k, 3), m/s, predicted minus measured at the DVL; zero at the last used ping
    drift_n: Floats  # (k, 3), m, its integral
    nis: Floats  # (k,), of each withheld ping; NaN at the last used one


@dataclass(frozen=True)
class Coasts:
    """All runs of all filters of a dive."""

    plan: CoastingPlan
    distance_m: Floats  # (m,), travelled up to each ping of the plan, by the DVL's velocities
    runs: Mapping[str, tuple[Coast, ...]]  # by filter, the baseline first; one for each of the plan's runs


class DriftOverTime(NamedTuple):
    """How the horizontal drift of a filter grows after the last velocity: shape (k,), over the windows."""

    time_s: Floats  # from the last used ping on
    median_m: Floats  # NaN without windows, as the next
    p95_m: Floats


def coast_of(history: History) -> Coast:
    """Turn the innovations of withheld velocities to n; the first row of the history has none."""
    innovations, *_ = history.innovations
    time_s = seconds(history.time_ns, history.time_ns[0])
    velocity_error_n, nis = np.zeros((len(time_s), 3)), np.full(len(time_s), np.nan)
    with np.errstate(over="ignore", invalid="ignore"):
        velocity_error_n[1:] = np.einsum("kij,kj->ki", history.mat_nb[1:], innovations.innovation)
        nis[1:] = innovations.nis
        return Coast(time_s, velocity_error_n, _integral(time_s, velocity_error_n), nis)


def distance_along_m(time_ns: TimeNs, velocity_b: Floats) -> Floats:
    """Integrate the speed that a DVL measures, m/s, from the first ping on."""
    return _integral(seconds(time_ns, time_ns[0]), np.linalg.norm(velocity_b, axis=1))


def _integral(time_s: Floats, rate: Floats) -> Floats:
    """Integrate along the first axis by trapezoids, from zero on."""
    steps = np.diff(time_s).reshape(-1, *[1] * (rate.ndim - 1)) * 0.5 * (rate[1:] + rate[:-1])
    return np.concatenate([np.zeros_like(rate[:1]), np.cumsum(steps, axis=0)])


class WindowEnds(NamedTuple):
    """What a filter has come to at the end of each window of one length, shape (w,)."""

    drift_m: Floats  # horizontal
    down_m: Floats  # either way
    velocity_mps: Floats  # horizontal error
    nis: Floats  # of the last withheld ping


def coasting_table(log: str, coasts: Coasts) -> list[CoastingRow]:
    """State how far each filter drifts in windows of each length that the dive has room for."""
    with np.errstate(over="ignore", invalid="ignore"):
        return [row for windows in coasts.plan.judged for row in _rows(log, coasts, windows)]


def _rows(log: str, coasts: Coasts, windows: Windows) -> Iterator[CoastingRow]:
    distance_m = coasts.distance_m[windows.last] - coasts.distance_m[windows.first]
    of_filters = [window_ends(coasts, name, windows) for name in coasts.runs]
    for i, (name, ends) in enumerate(zip(coasts.runs, of_filters, strict=True)):
        yield CoastingRow(
            log,
            name,
            str(windows.window_s),
            len(windows.first),
            windows.left_out,
            *_drifts(ends, distance_m),
            *(_against(of_filters[0], ends) if i else (NAN, NAN, NAN, NAN)),
            _mean(ends.nis) / 3.0,
        )


def window_ends(coasts: Coasts, name: str, windows: Windows) -> WindowEnds:
    """Gather what a filter has come to in windows of the plan; those of two filters are pairs."""
    runs = np.searchsorted(coasts.plan.runs[0], windows.first)
    ends = [(coasts.runs[name][run], step) for run, step in zip(runs, windows.last - windows.first, strict=True)]
    drift_n = np.array([run.drift_n[step] for run, step in ends]).reshape(-1, 3)
    velocity_error_n = np.array([run.velocity_error_n[step] for run, step in ends]).reshape(-1, 3)
    nis = np.array([run.nis[step] for run, step in ends])
    return WindowEnds(_horizontal(drift_n), np.abs(drift_n[:, 2]), _horizontal(velocity_error_n), nis)


def _drifts(ends: WindowEnds, distance_m: Floats) -> tuple[float, float, float, float, float, float]:
    moved = distance_m >= SHORTEST_M
    return (
        _median(ends.drift_m),
        float(np.sqrt(_mean(ends.drift_m**2))),
        _quantile(ends.drift_m, 0.95),
        _median(100.0 * ends.drift_m[moved] / distance_m[moved]),
        _median(ends.velocity_mps),
        _median(ends.down_m),
    )


def _against(baseline: WindowEnds, candidate: WindowEnds) -> tuple[float, float, float, float]:
    """Return ratio, its interval and the per cent of windows won; NaN where fewer than two windows can be compared."""
    before, after = baseline.drift_m, candidate.drift_m
    if len(before) < 2 or not np.isfinite([before, after]).all():
        return NAN, NAN, NAN, NAN
    interval = windows_ratio(before, after)
    won_pct = 50.0 * float(np.mean(after < before) + np.mean(after <= before))
    return interval.ratio, interval.low, interval.high, won_pct


def drift_over_time(coasts: Coasts, name: str) -> DriftOverTime:
    """Gather the horizontal drift of a filter in the windows that are shown, at whole seconds."""
    at_s = np.arange(SHOWN_S + 1.0)
    rows = np.searchsorted(coasts.plan.runs[0], coasts.plan.shown.first)
    runs = [coasts.runs[name][row] for row in rows]
    with np.errstate(over="ignore", invalid="ignore"):
        drift_m = [np.interp(at_s, run.time_s, _horizontal(run.drift_n)) for run in runs]
        columns = np.array(drift_m).reshape(-1, len(at_s))
    quantiles, finite = np.full((2, len(at_s)), np.nan), np.isfinite(columns).all(axis=0)
    if len(columns) and finite.any():
        quantiles[:, finite] = np.quantile(columns[:, finite], [0.5, 0.95], axis=0)
    return DriftOverTime(at_s, *quantiles)


def _horizontal(vector_n: Floats) -> Floats:
    return np.asarray(np.hypot(vector_n[:, 0], vector_n[:, 1]))


def _mean(values: Floats) -> float:
    return float(np.mean(values)) if len(values) else NAN


def _median(values: Floats) -> float:
    return _quantile(values, 0.5)


def _quantile(values: Floats, q: float) -> float:
    """Return a quantile, linear between values; NaN of none, and where one is not finite."""
    return float(np.quantile(values, q)) if len(values) and np.isfinite(values).all() else NAN


def outage_alarm(rows: Sequence[CoastingRow], names: Collection[str]) -> str:
    """Say where the withheld velocities show that the sigma of filters grows too slowly; nothing where it does not.

    NIS at the ends of windows of one length are chi-square, and nearly independent. The length that is furthest above
    its limit speaks.
    """
    excess = {
        (row.window_s, row.filter): finite(row.nis_per_dof) / max(ALARM, chi_square_quantile(SURELY, dof) / dof)
        for row in rows
        if row.filter in names and (dof := 3 * row.windows) and finite(row.nis_per_dof) > ALARM
    }
    window_s, _ = max(excess, key=excess.__getitem__, default=("", ""))
    if not window_s or max(excess.values()) <= 1.0:
        return ""
    sizes = [f"{row.filter} {row.nis_per_dof:.3g}" for row in rows if row.window_s == window_s and row.filter in names]
    return f" NIS / dof after {window_s} s without DVL: {', '.join(sizes)}, expected 1: raise [noise]."


def window_drifts(coasts: Coasts) -> dict[str, dict[str, Floats]]:
    """Return the horizontal drift of each filter in each window that does not overlap, by filter and length, m."""
    with np.errstate(over="ignore", invalid="ignore"):
        return {
            name: {f"{windows.window_s}s": window_ends(coasts, name, windows).drift_m for windows in coasts.plan.judged}
            for name in coasts.runs
        }
