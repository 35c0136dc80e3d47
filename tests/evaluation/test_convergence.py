"""Measured convergence on errors that fall as a power of time, whose mean squares over a share of it do likewise."""

import numpy as np
import pytest

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.evaluation.convergence import measured_convergence

END_S, STARTS = 400.0, 16
TIME_S = np.arange(0.05, END_S + 0.01, 0.05)
MARGIN = 1.0 + 1.0 / np.sqrt(2.0 * STARTS)


def falling(power: float, scale: float = 1.0) -> Floats:
    """Errors of all starts, squared, that are ``scale`` at the end."""
    sign = np.where(np.arange(STARTS) % 2, 1.0, -1.0)
    squares: Floats = (scale * sign[:, None] * (TIME_S / END_S) ** -power) ** 2
    return squares


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_times_have_the_closed_form(power: float) -> None:
    found = measured_convergence(falling(power), falling(power, 0.5), TIME_S)
    assert found.target == pytest.approx(
        np.sqrt(np.mean(np.arange(0.9005, 1.0, 0.001) ** (-2 * power))), rel=2e-3
    )
    assert found.baseline_s == pytest.approx(END_S * MARGIN ** (-1.0 / power), rel=2e-3)
    assert found.candidate_s == pytest.approx(END_S * (2.0 * MARGIN) ** (-1.0 / power), rel=2e-3)
    assert found.candidate_s / found.baseline_s == pytest.approx(2.0 ** (-1.0 / power), rel=4e-3)
    assert found.status == "reached"


def test_times_are_the_same_in_any_unit_of_time_and_error() -> None:
    found = measured_convergence(falling(1.0), falling(0.8, 0.7), TIME_S)
    other = measured_convergence(1e-8 * falling(1.0), 1e-8 * falling(0.8, 0.7), 60.0 * TIME_S)
    assert other.candidate_s == pytest.approx(60.0 * found.candidate_s, rel=1e-9)
    assert other.baseline_s == pytest.approx(60.0 * found.baseline_s, rel=1e-9)


def test_starts_that_err_differently_count_by_their_mean_square() -> None:
    """Half of the starts err twice as much: a mean square of 2.5 instead of 1."""
    size = np.where(np.arange(STARTS) < STARTS / 2, 1.0, 2.0)
    alike = measured_convergence(falling(1.0), falling(1.0, 0.5), TIME_S)
    found = measured_convergence(falling(1.0), 0.25 * size[:, None] ** 2 * falling(1.0), TIME_S)
    assert found.candidate_s / alike.candidate_s == pytest.approx(np.sqrt(2.5), rel=0.01)


def test_it_is_reached_when_it_stays() -> None:
    """A swing that is over counts until its end, though the error was as small before."""
    swinging = falling(1.0, 0.1)
    swinging[:, (TIME_S > 300.0) & (TIME_S < 320.0)] = 100.0
    found = measured_convergence(falling(1.0), swinging, TIME_S)
    assert 320.0 < found.candidate_s < 320.0 / 0.9 / 0.98
    assert found.status == "reached"


def test_what_is_above_at_the_end_never_converges() -> None:
    found = measured_convergence(falling(1.0), falling(1.0, 2.0), TIME_S)
    assert found.status == "never"
    assert np.isnan(found.candidate_s)
    assert np.isfinite(found.baseline_s)


@pytest.mark.parametrize("power", [0.0, -1.0])
def test_what_does_not_fall_has_nothing_to_converge(power: float) -> None:
    found = measured_convergence(falling(power), falling(1.0, 0.1), TIME_S)
    assert found.status == "at_start"
    assert np.isnan(found.baseline_s)


def test_candidate_that_is_there_at_once_has_nothing_to_bring_down() -> None:
    found = measured_convergence(falling(1.0), falling(0.0, 0.5), TIME_S)
    assert found.status == "at_start"
    assert np.isnan(found.candidate_s)
    assert np.isfinite(found.baseline_s)


def test_one_run_that_breaks_down_is_not_left_out() -> None:
    broken = falling(1.0, 0.5)
    broken[3, TIME_S > 200.0] = np.nan
    assert measured_convergence(falling(1.0), broken, TIME_S).status == "never"


def test_times_that_the_reference_lacks_are_left_out() -> None:
    squares = np.stack([falling(1.0), falling(1.0, 0.5)])
    every = measured_convergence(*squares, TIME_S)
    squares[..., 1::2] = np.nan
    fewer = measured_convergence(*squares, TIME_S)
    assert (fewer.baseline_s, fewer.candidate_s) == pytest.approx(
        (every.baseline_s, every.candidate_s), rel=1e-3
    )
