"""Many runs of a simulated dive: true errors, NEES, and what they say of the uncertainty that the filters believe in.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", chapter 5.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TruthColumns, seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.states import STATES
from insdvl_replay.core.words import Consistency
from insdvl_replay.evaluation.believed import improvement_pct
from insdvl_replay.evaluation.chi_square import consistency_word, mean_interval, reason
from insdvl_replay.evaluation.consistency import FEWEST_UPDATES
from insdvl_replay.evaluation.state_errors import nees, state_errors


@dataclass(frozen=True)
class RunErrors:
    """How far one filter was off in one run, at the start and after each ping.

    Attributes
    ----------
    time_s : ndarray, shape (k,)
        From the start.
    error : ndarray, shape (k, 12)
        Estimated minus true, in the order of `states.STATES`; a bias is what is left in the compensated readings.
    var : ndarray, shape (k, 12)
        Diagonal of P.
    nees : ndarray, shape (k,)
        Normalised error squared, x' P^-1 x; 12 in the mean of a consistent filter.
    """

    filter: str
    time_s: Floats
    error: Floats
    var: Floats
    nees: Floats


def run_errors(history: History, reference: ReferenceColumns, truth: TruthColumns) -> RunErrors:
    """Compare one filter with the truth.

    Parameters
    ----------
    history : History
        With P at the times to compare.
    reference : ReferenceColumns
        The exact motion.
    truth : TruthColumns
        The biases at the same times.

    Returns
    -------
    RunErrors
        At the times that all three have.

    Raises
    ------
    ValueError
        There is no such time.
    """
    errors = state_errors(history, reference, truth)
    if not len(errors.time_ns):
        raise ValueError("NEES needs all of P")
    time_s = seconds(errors.time_ns, history.time_ns[0])
    error, cov = errors.error[:, : len(STATES)], errors.cov[:, : len(STATES), : len(STATES)]
    return RunErrors(history.filter, time_s, error, errors.sd[:, : len(STATES)] ** 2, nees(error, cov))


@dataclass(frozen=True)
class Ensemble:
    """The runs of one filter, taken together at each time.

    Attributes
    ----------
    runs : int
        How many.
    time_s : ndarray, shape (k,)
        From the start.
    sd : ndarray, shape (k, 12)
        What the filter believes: root of the mean of P's diagonal over the runs.
    error_sd, error_mean : ndarray, shape (k, 12)
        Standard deviation and mean of the true errors over the runs.
    nees : ndarray, shape (k,)
        Mean over the runs.
    """

    filter: str
    runs: int
    time_s: Floats
    sd: Floats
    error_sd: Floats
    error_mean: Floats
    nees: Floats

    @property
    def error_rms(self) -> Floats:
        """Root mean square of the true errors over the runs, shape (k, 12)."""
        rms: Floats = np.sqrt(self.error_mean**2 + self.error_sd**2 * (self.runs - 1) / self.runs)
        return rms


class Tally:
    """The runs of one filter, added up one after the other, so that memory does not grow with their number.

    Mean and squares are updated run by run, after Welford: a mean far from zero costs no digits.

    Parameters
    ----------
    first : RunErrors
        Gives the filter's name and the times; not yet added.

    Attributes
    ----------
    nees_by_run : list of tuple of float
        Of each run, NEES in the mean over its pings and after the last.
    """

    def __init__(self, first: RunErrors) -> None:
        self.filter, self._time_s, self._runs = first.filter, first.time_s, 0
        self._mean, self._squares, self._var = (np.zeros_like(first.error) for _ in range(3))
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
        """Return the runs so far; two at least."""
        return Ensemble(
            self.filter,
            self._runs,
            self._time_s,
            sd=np.sqrt(self._var / self._runs),
            error_sd=np.sqrt(self._squares / (self._runs - 1)),
            error_mean=self._mean.copy(),
            nees=self._nees / self._runs,
        )


DOF: Final = len(STATES)
"""Degrees of freedom of one NEES."""
SOON_S: Final = 1.5
"""After an outage: with pings each second, after the second of them."""
LATER_S: Final = 60.0
"""After an outage: what a correction of large errors leaves behind has had time to show."""


def montecarlo_table(ensembles: Sequence[Ensemble]) -> pd.DataFrame:
    """Set what each filter believes at the end beside what is so, state by state.

    Parameters
    ----------
    ensembles : sequence of Ensemble
        The first is the baseline.

    Returns
    -------
    DataFrame
        Columns filter, state, unit, final_sd (from P), ensemble_sd, ensemble_mean, rms_error, ratio (rms_error over
        final_sd), believed_improvement_pct and true_improvement_pct (of final_sd and rms_error against the baseline's;
        NaN for itself); 12 rows for each filter. All of them after the last ping.
    """
    baseline, rows = ensembles[0], []
    for ensemble in ensembles:
        for state in STATES:
            sd, error_sd, mean, rms, *before = (
                float(column[-1, state.index]) / state.factor
                for column in (
                    ensemble.sd,
                    ensemble.error_sd,
                    ensemble.error_mean,
                    ensemble.error_rms,
                    baseline.sd,
                    baseline.error_rms,
                )
            )
            changes = [improvement_pct(old, new) for old, new in zip(before, (sd, rms), strict=True)]
            changes = [float("nan")] * 2 if ensemble is baseline else changes
            rows.append((ensemble.filter, state.id, state.unit, sd, error_sd, mean, rms, rms / sd, *changes))
    names = [
        "filter", "state", "unit", "final_sd", "ensemble_sd", "ensemble_mean", "rms_error", "ratio",
        "believed_improvement_pct", "true_improvement_pct",
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=names)


def verdict_table(ensembles: Sequence[Ensemble]) -> pd.DataFrame:
    """Judge each filter by its NEES.

    NEES at neighbouring times are nearly the same number. The mean over the dive is therefore held against the interval
    of a single time, which is too wide for it and never too narrow.

    Returns
    -------
    DataFrame
        Columns filter, runs, dof, mean_nees (over runs and pings), low, high (95 % interval at one time), inside_pct
        (share of pings inside it), final_nees, verdict (``consistent``, ``over-confident``, ``over-cautious``, ``too
        few``, ``not finite``), why (it is consistent outside the interval).
    """
    rows = []
    for ensemble in ensembles:
        at_pings = ensemble.nees[1:]
        low, high = mean_interval(DOF, ensemble.runs)
        mean = float(at_pings.mean())
        inside_pct = 100.0 * float(np.mean((at_pings >= low) & (at_pings <= high)))
        word = Consistency.TOO_FEW if ensemble.runs < FEWEST_UPDATES else consistency_word(mean, low, high, DOF)
        judged = inside_pct, float(at_pings[-1]), word, reason(word, mean, low, high)
        rows.append((ensemble.filter, ensemble.runs, DOF, mean, low, high, *judged))
    names = ["filter", "runs", "dof", "mean_nees", "low", "high", "inside_pct", "final_nees", "verdict", "why"]
    return pd.DataFrame(rows, columns=names)


def outage_table(ensembles: Sequence[Ensemble], outages: Sequence[tuple[float, float]]) -> pd.DataFrame:
    """Follow the mean NEES through outages of the DVL: what an INS alone did, and how a filter comes back from it.

    Parameters
    ----------
    outages : sequence of (start_s, end_s)
        Seconds from the start.

    Returns
    -------
    DataFrame
        Columns filter, start_s, end_s, and the mean NEES over the runs nees_before, nees_last (at the last time of the
        outage), nees_soon (`SOON_S` after it), nees_later (`LATER_S` after it), nees_final (at the end of the dive);
        NaN where the dive does not reach so far.
    """
    rows = [
        (ensemble.filter, start_s, end_s, *_through(ensemble, start_s, end_s))
        for ensemble in ensembles
        for start_s, end_s in outages
    ]
    names = ["filter", "start_s", "end_s", "nees_before", "nees_last", "nees_soon", "nees_later", "nees_final"]
    return pd.DataFrame(rows, columns=names)


def _through(ensemble: Ensemble, start_s: float, end_s: float) -> Iterator[float]:
    for time_s in (start_s, end_s, end_s + SOON_S, end_s + LATER_S):
        row = int(np.searchsorted(ensemble.time_s, time_s)) - 1
        reached = row >= 0 and time_s <= ensemble.time_s[-1] + SOON_S
        yield float(ensemble.nees[row]) if reached else float("nan")
    yield float(ensemble.nees[-1])


def runs_table(seeds: Sequence[int], tallies: Sequence[Tally]) -> pd.DataFrame:
    """List the runs, so that an odd one can be found and repeated.

    Parameters
    ----------
    seeds : sequence of int
        Of each run.
    tallies : sequence of Tally
        One for each filter, with all runs.

    Returns
    -------
    DataFrame
        Columns run (from 1), seed, filter, mean_nees (over pings), final_nees.
    """
    rows = [
        (run, seed, tally.filter, *tally.nees_by_run[run - 1]) for run, seed in enumerate(seeds, 1) for tally in tallies
    ]
    return pd.DataFrame(rows, columns=["run", "seed", "filter", "mean_nees", "final_nees"])


def run_table(errors: Sequence[RunErrors]) -> pd.DataFrame:
    """Lay the true errors of one run beside what each filter believes, after the last ping.

    Parameters
    ----------
    errors : sequence of RunErrors
        One for each filter.

    Returns
    -------
    DataFrame
        Columns filter, state, unit, error, sd, ratio (error over sd), mean_nees, final_nees; 12 rows for each filter.
    """
    rows = []
    for run in errors:
        for state in STATES:
            error = float(run.error[-1, state.index]) / state.factor
            sd = float(np.sqrt(run.var[-1, state.index])) / state.factor
            whole = (float(run.nees[1:].mean()), float(run.nees[-1]))
            rows.append((run.filter, state.id, state.unit, error, sd, error / sd, *whole))
    names = ["filter", "state", "unit", "error", "sd", "ratio", "mean_nees", "final_nees"]
    return pd.DataFrame(rows, columns=names)


def nees_table(ensembles: Sequence[Ensemble]) -> pd.DataFrame:
    """Lay the mean NEES out over time.

    Returns
    -------
    DataFrame
        Columns filter, time_s, mean_nees, low, high (95 % interval).
    """
    tables = []
    for ensemble in ensembles:
        low, high = mean_interval(DOF, ensemble.runs)
        columns = {"time_s": ensemble.time_s, "mean_nees": ensemble.nees, "low": low, "high": high}
        tables.append(pd.DataFrame({"filter": ensemble.filter, **columns}))
    return pd.concat(tables, ignore_index=True)


def ensemble_table(ensembles: Sequence[Ensemble]) -> pd.DataFrame:
    """Lay sigma, ensemble sigma and ensemble mean out over time, in shown units.

    Returns
    -------
    DataFrame
        Columns filter, state, unit, time_s, sd, ensemble_sd, ensemble_mean.
    """
    tables = []
    for ensemble in ensembles:
        for state in STATES:
            columns = {
                "sd": ensemble.sd[:, state.index] / state.factor,
                "ensemble_sd": ensemble.error_sd[:, state.index] / state.factor,
                "ensemble_mean": ensemble.error_mean[:, state.index] / state.factor,
            }
            labels = {"filter": ensemble.filter, "state": state.id, "unit": state.unit, "time_s": ensemble.time_s}
            tables.append(pd.DataFrame({**labels, **columns}))
    return pd.concat(tables, ignore_index=True)
