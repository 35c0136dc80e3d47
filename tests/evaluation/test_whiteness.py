"""Autocorrelation of series whose correlation is known, and the share of white ones that stays inside its limit."""

import numpy as np
import pytest

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.evaluation.consistency import FEWEST_PAIRS, autocorrelation, whiteness

EVERY = np.ones(2000, dtype=bool)


def autoregressive(
    rng: np.random.Generator, coefficient: float, k: int = 2000, n: int = 1
) -> Floats:
    """A normal series of unit variance in which each value is so correlated with the one before."""
    series = rng.standard_normal((k, n))
    for row in range(1, k):
        series[row] = coefficient * series[row - 1] + np.sqrt(1.0 - coefficient**2) * series[row]
    return series


@pytest.mark.parametrize("coefficient", [-0.8, -0.2, 0.0, 0.5, 0.95])
@pytest.mark.parametrize("n", [1, 3])
def test_autocorrelation_of_a_series_is_the_one_it_was_made_with(
    coefficient: float, n: int
) -> None:
    value, limit = autocorrelation(
        autoregressive(np.random.default_rng(7), coefficient, n=n), EVERY
    )
    # Scatters by sqrt((1 - r^2) / 2000), 2.2 % at most.
    assert value == pytest.approx(coefficient, abs=0.05)
    assert limit == pytest.approx(1.96 / np.sqrt(1999), rel=1e-12)


def test_limit_holds_19_in_20_white_series() -> None:
    rng, inside = np.random.default_rng(5), []
    for _ in range(1000):
        value, limit = autocorrelation(rng.standard_normal((200, 1)), EVERY[:200])
        inside.append(abs(value) <= limit)
    # 1000 series scatter by 0.7 %; three of these.
    assert np.mean(inside) == pytest.approx(0.95, abs=0.021)


def test_mean_that_stays_is_a_correlation() -> None:
    value, _ = autocorrelation(1.0 + np.random.default_rng(2).standard_normal((2000, 1)), EVERY)
    assert value == pytest.approx(0.5, abs=0.05), "half of the power is the mean's"


def test_only_neighbours_that_were_both_used_are_a_pair() -> None:
    series, used = np.ones((40, 1)), np.arange(40) % 2 == 0
    assert np.isnan(autocorrelation(series, used)).all()
    series[20], used = 1e9, np.arange(40) != 20
    assert autocorrelation(series, used) == (pytest.approx(1.0), pytest.approx(1.96 / np.sqrt(37)))


def test_nothing_that_varies_has_no_autocorrelation() -> None:
    value, limit = autocorrelation(np.zeros((100, 3)), EVERY[:100])
    assert np.isnan(value)
    assert whiteness(value, limit) == "not finite"
    assert (
        whiteness(*autocorrelation(np.zeros((FEWEST_PAIRS, 3)), EVERY[:FEWEST_PAIRS]))
        == "insufficient data"
    )


@pytest.mark.parametrize(
    ("value", "limit", "word"),
    [
        (0.3, 0.2, "correlated"),
        (-0.3, 0.2, "correlated"),
        (0.15, 0.2, "white"),
        (0.09, 0.01, "white"),
        (0.11, 0.01, "correlated"),
    ],
)
def test_word_asks_for_significance_and_size(value: float, limit: float, word: str) -> None:
    assert whiteness(value, limit) == word
