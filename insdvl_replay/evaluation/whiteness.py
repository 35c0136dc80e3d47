"""Whether innovations are white: how much each resembles the one before.

A filter that is right has used all that a measurement could tell; what remains is new each time. Source: Bar-Shalom, Li
and Kirubarajan, "Estimation with Applications to Tracking and Navigation", section 5.4.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.columns import Floats
from insdvl_replay.core.words import Whiteness

FEWEST_PAIRS: Final = 10
"""With fewer neighbours the word is ``too few``."""
SMALL_AUTOCORRELATION: Final = 0.1
"""A smaller one, however significant, does not matter: the mean of noise that is so correlated scatters by less than
11 % more, or 10 % less, than that of white noise."""
NORMAL_95: Final = 1.96
"""Within so many standard deviations lie 95 % of a normal variable."""


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


def whiteness(value: float, limit: float) -> Whiteness:
    """Say what an autocorrelation means.

    Parameters
    ----------
    value, limit : float
        From `autocorrelation`.

    Returns
    -------
    Whiteness
        ``correlated`` where it is significant and larger than `SMALL_AUTOCORRELATION`.
    """
    if not np.isfinite(limit):
        return Whiteness.TOO_FEW
    if not np.isfinite(value):
        return Whiteness.NOT_FINITE
    return Whiteness.CORRELATED if abs(value) > max(limit, SMALL_AUTOCORRELATION) else Whiteness.WHITE
