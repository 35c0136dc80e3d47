"""Whether the mean of a NIS or NEES is what a consistent filter has: its chi-square interval and its verdict.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", chapter 5.
"""

from typing import Final

import numpy as np
from scipy.special import betainc, chdtr, chdtri

from insdvl_replay.core.words import Consistency, Reason

CONFIDENCE: Final = 0.95  # Share of consistent filters whose mean lies inside the interval.
SMALL_EXCESS: Final = 0.1
"""A NIS or NEES that is off by a smaller share stands for a standard deviation that is off by less than 5 %."""
FEWEST_UPDATES: Final = 10  # With fewer updates the verdict is ``insufficient data``.


def chi_square_quantile(probability: float, dof: float) -> float:
    """Return the value below which a chi-square variable lies with a probability; infinite for probability 1."""
    return float("inf") if probability >= 1.0 else float(chdtri(dof, 1.0 - probability))


def mean_interval(dof: int, count: float, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the two-sided interval in which the mean of ``count`` chi-square variables lies.

    The sum of independent variables with ``dof`` degrees of freedom has ``count * dof`` of them. Of variables that
    depend on each other the count is the number of effective samples, which need not be whole.
    """
    tail = (1.0 - confidence) / 2.0
    low, high = (chi_square_quantile(probability, count * dof) / count for probability in (tail, 1.0 - tail))
    return low, high


def consistency_verdict(mean: float, low: float, high: float, dof: int) -> tuple[Consistency, Reason]:
    """Judge a mean NIS or NEES, and say why if the verdict is not what the interval says."""
    if not np.isfinite(mean):
        return Consistency.NOT_FINITE, Reason.NONE
    if low <= mean <= high:
        return Consistency.CONSISTENT, Reason.NONE
    if abs(mean / dof - 1.0) <= SMALL_EXCESS:
        return Consistency.CONSISTENT, Reason.NEAR
    return Consistency.OVERCONFIDENT if mean > high else Consistency.CONSERVATIVE, Reason.NONE


def probability_beyond_3_sd(share: float, independent: float) -> float:
    """Bound how probable so large a share of errors beyond 3 standard deviations is in a consistent filter.

    With one independent sample or more it is the binomial probability, continued between whole numbers. With less, an
    excursion that happened to last, it is Markov's bound, however the errors depend on each other. The two meet.
    """
    expected = 1.0 - float(chdtr(1, 9.0))
    count = share * independent
    return expected / share if count < 1.0 else float(betainc(count, independent - count + 1.0, expected))
