"""Many runs of a simulated dive: true errors and NEES, next to the uncertainty that the filters predict.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", chapter 5.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TruthColumns, seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.states import STATES
from insdvl_replay.core.words import Consistency, Reason
from insdvl_replay.evaluation.consistency import FEWEST_UPDATES, consistency_verdict, mean_interval
from insdvl_replay.evaluation.credibility import nees, state_errors
from insdvl_replay.evaluation.reference_errors import improvement_pct

DOF: Final = len(STATES)  # Degrees of freedom of one NEES.
SOON_S: Final = 1.5  # After an outage: with pings each second, after the second of them.
LATER_S: Final = 60.0  # After an outage: time for the effects of a large correction.
FACTORS: Final = np.array([state.factor for state in STATES])


@dataclass(frozen=True)
class RunErrors:
    """Errors of one filter in one run, at the start and after each ping."""

    filter: str
    time_s: Floats  # (k,), from the start
    error: Floats  # (k, 12), estimated minus true; a bias error is the rest in the compensated readings
    var: Floats  # (k, 12), diagonal of P
    nees: Floats  # (k,), x' P^-1 x; 12 in the mean of a consistent filter


def run_errors(history: History, reference: ReferenceColumns, truth: TruthColumns) -> RunErrors:
    """Compare one filter with the exact motion and the true biases, at the times of P that all three have."""
    errors = state_errors(history, reference, truth)
    if not len(errors.time_ns):
        raise ValueError("NEES needs all of P")
    time_s = seconds(errors.time_ns, history.time_ns[0])
    error = errors.error[:, :DOF]
    cov = errors.cov[:, :DOF, :DOF]
    return RunErrors(
        history.filter, time_s, error, np.diagonal(cov, axis1=1, axis2=2).copy(), nees(error, cov)
    )


@dataclass(frozen=True)
class Ensemble:
    """Statistics over the runs of one filter, at each time."""

    filter: str
    runs: int
    time_s: Floats  # (k,), from the start
    sd: Floats  # (k, 12), what the filter predicts: root of the mean of P's diagonal over the runs
    error_sd: Floats  # (k, 12), standard deviation and mean of the true errors over the runs
    error_mean: Floats  # (k, 12)
    nees: Floats  # (k,), mean over the runs

    @property
    def error_rms(self) -> Floats:
        """Root mean square of the true errors over the runs, shape (k, 12)."""
        rms: Floats = np.sqrt(self.error_mean**2 + self.error_sd**2 * (self.runs - 1) / self.runs)
        return rms


class Tally:
    """Running sums over the runs of one filter, so that memory does not grow with their number.

    Mean and squares are updated after Welford: a mean far from zero costs no digits. The first run gives the filter's
    name and the times; it is not yet added. ``nees_by_run`` holds NEES in the mean over pings and after the last.
    """

    def __init__(self, first: RunErrors) -> None:
        self.filter = first.filter
        self._time_s = first.time_s
        self._runs = 0
        self._mean = np.zeros_like(first.error)
        self._squares = np.zeros_like(first.error)
        self._var = np.zeros_like(first.error)
        self._nees = np.zeros_like(first.nees)
        self.nees_by_run: list[tuple[float, float]] = []

    def add(self, run: RunErrors) -> None:
        """Add a run that has the same times."""
        self._runs += 1
        off = run.error - self._mean
        self._mean += off / self._runs
        self._squares += off * (run.error - self._mean)
        self._var += run.var
        self._nees += run.nees
        self.nees_by_run.append((float(run.nees[1:].mean()), float(run.nees[-1])))

    def ensemble(self) -> Ensemble:
        """Return the statistics so far; needs at least two runs."""
        return Ensemble(
            self.filter,
            self._runs,
            self._time_s,
            sd=np.sqrt(self._var / self._runs),
            error_sd=np.sqrt(self._squares / (self._runs - 1)),
            error_mean=self._mean.copy(),
            nees=self._nees / self._runs,
        )


# --- Tables of a Monte Carlo study. The first filter is the baseline.

Columns = Mapping[str, Any]  # of a table, each an array or one value for all rows


def _stacked(tables: Iterable[Columns]) -> pd.DataFrame:
    return pd.concat([pd.DataFrame(columns) for columns in tables], ignore_index=True)


def _states(name: str, **shown: Floats) -> Columns:
    """Return columns of a filter's states, each (12,) in SI units and shown in those of the states."""
    columns = {column: values / FACTORS for column, values in shown.items()}
    return {
        "filter": name,
        "state": [state.id for state in STATES],
        "unit": [state.unit for state in STATES],
    } | columns


def montecarlo_table(ensembles: Sequence[Ensemble]) -> pd.DataFrame:
    """Return predicted and true errors of each filter at the end; ``ratio`` is rms_error over final_sd."""
    table = _stacked(
        _states(
            ensemble.filter,
            final_sd=ensemble.sd[-1],
            ensemble_sd=ensemble.error_sd[-1],
            ensemble_mean=ensemble.error_mean[-1],
            rms_error=ensemble.error_rms[-1],
        )
        for ensemble in ensembles
    )
    table["ratio"] = table["rms_error"] / table["final_sd"]
    table["predicted_improvement_pct"] = _improvements_pct(table["final_sd"])
    table["true_improvement_pct"] = _improvements_pct(table["rms_error"])
    return table


def _improvements_pct(sizes: "pd.Series[float]") -> list[float]:
    """Return how much smaller the sizes of each filter's states are than the baseline's, which come first.

    They are NaN for the baseline itself.
    """
    of_baseline = sizes.tolist()[:DOF]
    changes = [math.nan] * DOF
    for row, size in enumerate(sizes.tolist()[DOF:]):
        changes.append(improvement_pct(of_baseline[row % DOF], size))
    return changes


def verdict_table(ensembles: Sequence[Ensemble]) -> pd.DataFrame:
    """Return the consistency of each filter by its NEES; ``inside_pct`` is the share of pings inside the interval.

    NEES at neighbouring times are nearly equal. The mean over the dive is therefore compared with the
    interval of a single time, which is too wide for it and never too narrow.
    """
    rows = []
    for ensemble in ensembles:
        at_pings = ensemble.nees[1:]
        low, high = mean_interval(DOF, ensemble.runs)
        word, why = consistency_verdict(float(at_pings.mean()), low, high, DOF)
        if ensemble.runs < FEWEST_UPDATES:
            word = Consistency.INSUFFICIENT
            why = Reason.NONE
        rows.append(
            {
                "filter": ensemble.filter,
                "runs": ensemble.runs,
                "dof": DOF,
                "mean_nees": float(at_pings.mean()),
                "low": low,
                "high": high,
                "inside_pct": 100.0 * float(np.mean((at_pings >= low) & (at_pings <= high))),
                "final_nees": float(at_pings[-1]),
                "verdict": word,
                "why": why,
            }
        )
    return pd.DataFrame(rows)


def outage_table(
    ensembles: Sequence[Ensemble], outages: Sequence[tuple[float, float]]
) -> pd.DataFrame:
    """Return the mean NEES around DVL outages, given by start and end in seconds.

    At the last time before the outage, its last time, `SOON_S` and `LATER_S` after it, and at the end; NaN beyond the
    dive.
    """
    rows = []
    for ensemble in ensembles:
        for start_s, end_s in outages:
            at_s = np.array([start_s, end_s, end_s + SOON_S, end_s + LATER_S])
            found = np.searchsorted(ensemble.time_s, at_s) - 1
            reached = (found >= 0) & (at_s <= ensemble.time_s[-1] + SOON_S)
            sizes = np.where(reached, ensemble.nees[found], np.nan)
            rows.append(
                (ensemble.filter, start_s, end_s, *sizes.tolist(), float(ensemble.nees[-1]))
            )
    names = [
        "filter",
        "start_s",
        "end_s",
        "nees_before",
        "nees_last",
        "nees_soon",
        "nees_later",
        "nees_final",
    ]
    return pd.DataFrame(rows, columns=names)


def runs_table(seeds: Sequence[int], tallies: Sequence[Tally]) -> pd.DataFrame:
    """List the runs of each filter with their seeds, so that a single run can be repeated."""
    rows = []
    for run, seed in enumerate(seeds, 1):
        for tally in tallies:
            mean_nees, final_nees = tally.nees_by_run[run - 1]
            rows.append((run, seed, tally.filter, mean_nees, final_nees))
    return pd.DataFrame(rows, columns=["run", "seed", "filter", "mean_nees", "final_nees"])


def run_table(errors: Sequence[RunErrors]) -> pd.DataFrame:
    """Return the true errors of one run next to what each filter predicts, after the last ping."""
    tables = []
    for run in errors:
        ends = _states(run.filter, error=run.error[-1], sd=np.sqrt(run.var[-1]))
        tables.append(
            {
                **ends,
                "ratio": ends["error"] / ends["sd"],
                "mean_nees": float(run.nees[1:].mean()),
                "final_nees": float(run.nees[-1]),
            }
        )
    return _stacked(tables)


def nees_table(ensembles: Sequence[Ensemble]) -> pd.DataFrame:
    """Return the mean NEES over time with its 95 % interval."""
    tables = []
    for ensemble in ensembles:
        low, high = mean_interval(DOF, ensemble.runs)
        tables.append(
            {
                "filter": ensemble.filter,
                "time_s": ensemble.time_s,
                "mean_nees": ensemble.nees,
                "low": low,
                "high": high,
            }
        )
    return _stacked(tables)


def ensemble_table(ensembles: Sequence[Ensemble]) -> pd.DataFrame:
    """Return sigma, ensemble sigma and ensemble mean over time, in shown units."""
    tables = []
    for ensemble in ensembles:
        for state in STATES:
            tables.append(
                {
                    "filter": ensemble.filter,
                    "state": state.id,
                    "unit": state.unit,
                    "time_s": ensemble.time_s,
                    "sd": ensemble.sd[:, state.index] / state.factor,
                    "ensemble_sd": ensemble.error_sd[:, state.index] / state.factor,
                    "ensemble_mean": ensemble.error_mean[:, state.index] / state.factor,
                }
            )
    return _stacked(tables)
