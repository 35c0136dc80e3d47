"""Whether the mean of squares is what it should be: its chi-square interval, and what the mean says beside it.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", chapter 5.
"""

from typing import Final

import numpy as np
from scipy.special import chdtri

from insdvl_replay.core.words import Consistency, Reason

CONFIDENCE: Final = 0.95
"""Share of consistent filters whose mean lies inside the interval."""
SMALL_EXCESS: Final = 0.1
"""A NIS or NEES that is off by a smaller share stands for a standard deviation that is off by less than 5 %."""


def chi_square_quantile(probability: float, dof: float) -> float:
    """Return the value below which a chi-square variable lies with a probability; infinite for probability 1."""
    return float("inf") if probability >= 1.0 else float(chdtri(dof, 1.0 - probability))


def mean_interval(dof: int, count: float, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the interval in which the mean of chi-square variables lies.

    The sum of ``count`` independent variables with ``dof`` degrees of freedom has ``count * dof`` of them.

    Parameters
    ----------
    dof : int
        Of one variable.
    count : float
        How many are averaged; of variables that depend on each other the effective number, which need not be whole.
    confidence : float
        Probability of the interval, two-sided.
    """
    tail = (1.0 - confidence) / 2.0
    return (
        chi_square_quantile(tail, count * dof) / count,
        chi_square_quantile(1.0 - tail, count * dof) / count,
    )


def consistency_word(mean: float, low: float, high: float, dof: int) -> Consistency:
    """Judge a mean NIS or NEES: consistent in its interval or near ``dof``, over-confident above, or over-cautious."""
    if not np.isfinite(mean):
        return Consistency.NOT_FINITE
    if low <= mean <= high or abs(mean / dof - 1.0) <= SMALL_EXCESS:
        return Consistency.CONSISTENT
    return Consistency.OVER_CONFIDENT if mean > high else Consistency.OVER_CAUTIOUS


def reason(word: Consistency, mean: float, low: float, high: float) -> Reason:
    """State why the mean of a filter that is called consistent is outside its interval; nothing where it is inside."""
    return Reason.NEAR if word == Consistency.CONSISTENT and not low <= mean <= high else Reason.NONE
