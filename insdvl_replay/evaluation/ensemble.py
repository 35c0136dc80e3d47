"""Many runs of a simulated dive: true errors, NEES, and what they say of the uncertainty that the filters believe in.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", chapter 5.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from insdvl_replay.columns import Floats, ReferenceColumns, TruthColumns, seconds
from insdvl_replay.evaluation.believed import improvement_pct
from insdvl_replay.evaluation.consistency import FEWEST_UPDATES, mean_interval, verdict
from insdvl_replay.history import History
from insdvl_replay.rotation import vector_from_mat
from insdvl_replay.states import STATES

DOF = len(STATES)
"""Degrees of freedom of one NEES."""


@dataclass(frozen=True)
class RunErrors:
    """How far one filter was off in one run, at the start and after each ping.

    Attributes
    ----------
    filter : str
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
        With P.
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
        The history holds no P.
    """
    if history.cov is None:
        raise ValueError("NEES needs all of P")
    time_ns, ours, theirs = np.intersect1d(
        history.time_ns, reference.time_ns, assume_unique=True, return_indices=True
    )
    error = np.hstack(
        [
            history.velocity_n[ours] - reference.velocity_n[theirs],
            vector_from_mat(history.mat_nb[ours] @ np.swapaxes(reference.mat_nb[theirs], 1, 2)),
            truth.accel_bias_b[theirs] - history.accel_bias_b[ours],
            truth.gyro_bias_b[theirs] - history.gyro_bias_b[ours],
        ]
    )
    time_s = seconds(time_ns, history.time_ns[0])
    return RunErrors(history.filter, time_s, error, history.sd[ours] ** 2, nees(error, history.cov[ours]))


def nees(error: Floats, cov: Floats) -> Floats:
    """Give the normalised estimation error squared, ``x' P^-1 x``.

    The states are scaled by their standard deviations first: in SI units P spans some fifteen decades.

    Parameters
    ----------
    error : ndarray, shape (k, n)
    cov : ndarray, shape (k, n, n)

    Returns
    -------
    ndarray, shape (k,)
    """
    sd = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    scaled = error / sd
    correlation = cov / (sd[:, :, None] * sd[:, None, :])
    whitened = np.linalg.solve(correlation, scaled[..., None])[..., 0]
    squared: Floats = np.sum(scaled * whitened, axis=1)
    return squared


@dataclass(frozen=True)
class Ensemble:
    """The runs of one filter, taken together at each time.

    Attributes
    ----------
    filter : str
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
    """

    def __init__(self, first: RunErrors) -> None:
        self._filter, self._time_s, self._runs = first.filter, first.time_s, 0
        self._mean, self._squares, self._var = (np.zeros_like(first.error) for _ in range(3))
        self._nees = np.zeros_like(first.nees)

    def add(self, run: RunErrors) -> None:
        """Add a run that has the same times."""
        self._runs += 1
        off = run.error - self._mean
        self._mean += off / self._runs
        self._squares += off * (run.error - self._mean)
        self._var += run.var
        self._nees += run.nees

    def ensemble(self) -> Ensemble:
        """Give the runs so far; two at least."""
        return Ensemble(
            self._filter,
            self._runs,
            self._time_s,
            sd=np.sqrt(self._var / self._runs),
            error_sd=np.sqrt(self._squares / (self._runs - 1)),
            error_mean=self._mean.copy(),
            nees=self._nees / self._runs,
        )


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

    Parameters
    ----------
    ensembles : sequence of Ensemble

    Returns
    -------
    DataFrame
        Columns filter, runs, dof, mean_nees (over runs and pings), low, high (95 % interval at one time), inside_pct
        (share of pings inside it), final_nees, verdict (``consistent``, ``over-confident``, ``over-cautious``, ``too
        few``, ``not finite``).
    """
    rows = []
    for ensemble in ensembles:
        at_pings = ensemble.nees[1:]
        low, high = mean_interval(DOF, ensemble.runs)
        mean = float(at_pings.mean())
        inside_pct = 100.0 * float(np.mean((at_pings >= low) & (at_pings <= high)))
        word = "too few" if ensemble.runs < FEWEST_UPDATES else verdict(mean, low, high, DOF)
        rows.append((ensemble.filter, ensemble.runs, DOF, mean, low, high, inside_pct, float(at_pings[-1]), word))
    names = ["filter", "runs", "dof", "mean_nees", "low", "high", "inside_pct", "final_nees", "verdict"]
    return pd.DataFrame(rows, columns=names)


def nees_table(ensembles: Sequence[Ensemble]) -> pd.DataFrame:
    """Lay the mean NEES out over time.

    Parameters
    ----------
    ensembles : sequence of Ensemble

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

    Parameters
    ----------
    ensembles : sequence of Ensemble

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
