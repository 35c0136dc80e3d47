"""Many runs of a simulated dive: true errors, NEES, and what they say of the uncertainty that the filters believe in.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", chapter 5.
"""

from dataclasses import dataclass

import numpy as np

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TruthColumns, seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.states import STATES
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
