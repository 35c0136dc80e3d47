"""The number of independent samples against closed forms, and against what a mean square really scatters by."""

import numpy as np
import pytest
from scipy.signal import lfilter

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.evaluation.series import samples_in_mean, samples_in_mean_square


def autoregressive(rng: np.random.Generator, coefficient: float, runs: int, k: int) -> Floats:
    """Stationary normal series of unit variance, shape (runs, k); the first thousand values are thrown away."""
    noise = rng.standard_normal((runs, k + 1000)) * np.sqrt(1.0 - coefficient**2)
    series: Floats = lfilter([1.0], [1.0, -coefficient], noise, axis=1)[:, 1000:]
    return series


# --- For a mean.


@pytest.mark.parametrize("coefficient", [0.0, 0.5, 0.9])
def test_mean_of_an_autoregressive_series_has_the_closed_form(coefficient: float) -> None:
    k = 10_000
    series = autoregressive(np.random.default_rng(1), coefficient, 40, k)
    found = np.median([samples_in_mean(run) for run in series])
    assert found == pytest.approx(k * (1.0 - coefficient) / (1.0 + coefficient), rel=0.1)


def test_bias_of_short_series_is_taken_off() -> None:
    series = autoregressive(np.random.default_rng(2), 0.8, 400, 100)
    found = np.median([samples_in_mean(run) for run in series])
    assert found == pytest.approx(100.0 / 9.0, rel=0.25)


@pytest.mark.parametrize(
    ("values", "worth"), [([], 0.0), ([3.0], 1.0), ([2.0] * 50, 1.0), ([1.0, -1.0] * 25, 50.0)]
)
def test_effective_samples_of_a_mean_at_the_edges(values: list[float], worth: float) -> None:
    assert samples_in_mean(np.array(values)) == worth


def test_trend_is_worth_next_to_nothing() -> None:
    assert samples_in_mean(np.arange(200.0)) < 6.0


def test_fast_noise_does_not_hide_a_slow_part_of_a_mean() -> None:
    """Half of the variance is white, half is correlated over 50 values; the mean scatters by the slow half."""
    rng, k = np.random.default_rng(17), 2000
    series = autoregressive(rng, 0.98, 100, k) + rng.standard_normal((100, k))
    found = np.median([samples_in_mean(run) for run in series])
    # A variance of 2 over that of the mean, (99 + 1) / k.
    assert found == pytest.approx(2.0 / (100.0 / k), rel=0.3)


# --- For a mean square.


@pytest.mark.parametrize("coefficient", [0.0, 0.6, -0.6, 0.9])
def test_autoregressive_series_has_the_closed_form(coefficient: float) -> None:
    k = 20_000
    (series,) = autoregressive(np.random.default_rng(1), coefficient, 1, k)
    expected = k * (1.0 - coefficient**2) / (1.0 + coefficient**2)
    assert samples_in_mean_square(series[:, None]) == pytest.approx(expected, rel=0.15)


def test_mean_square_scatters_as_that_of_so_many_independent_samples() -> None:
    series = autoregressive(np.random.default_rng(2), 0.95, 400, 1000)
    # The mean of N independent squares has the variance 2 / N.
    scatter = 2.0 / np.var(np.mean(series**2, axis=1))
    found = np.median([samples_in_mean_square(run[:, None]) for run in series])
    assert found == pytest.approx(scatter, rel=0.25)


@pytest.mark.parametrize("value", [3.0, 0.0])
def test_error_that_stays_is_one_sample(value: float) -> None:
    assert samples_in_mean_square(np.full((500, 1), value)) == pytest.approx(1.0, abs=1e-6)


def test_error_that_swings_is_as_few_samples_as_one_that_stays() -> None:
    swing = np.sqrt(2.0) * np.cos(2.0 * np.pi * np.arange(1000) / 100.0)
    assert samples_in_mean_square(swing[:, None]) < 4.0


@pytest.mark.parametrize("share", [0.5, 0.8])
def test_slow_part_is_seen_below_fast_noise(share: float) -> None:
    """White noise over an error that stays: the mean square scatters by the square of the share that stays."""
    rng, k = np.random.default_rng(4), 1500
    found = [
        samples_in_mean_square(
            (np.sqrt(share) + np.sqrt(1.0 - share) * rng.standard_normal(k))[:, None]
        )
        for _ in range(50)
    ]
    assert np.median(found) == pytest.approx(1.0 / share**2, rel=0.1)


def test_components_count_by_the_mean_of_their_times() -> None:
    white = np.random.default_rng(3).standard_normal((2000, 1))
    both = np.hstack([white, np.ones((2000, 1))])
    assert samples_in_mean_square(both) == pytest.approx(2.0, rel=0.05), "tau is (1 + 2000) / 2"
