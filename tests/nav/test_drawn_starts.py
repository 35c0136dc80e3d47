"""Drawn starts err as much as their covariance says, and by what a correction takes out."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import BA, BG, DV, PHI
from insdvl_replay.evaluation.reference_errors import motion_error
from insdvl_replay.nav.algebra import matrix, vector
from insdvl_replay.nav.earth_model import local_earth_at
from insdvl_replay.nav.error_model import layout_of
from insdvl_replay.nav.kalman import correct
from insdvl_replay.nav.levelling import Start, drawn_starts, start_with_error
from insdvl_replay.nav.strapdown import NavState

SD = np.repeat([0.1, 0.01, 0.05, 5e-5], 3)
DRAWS = 500


def start_with(cov: Floats) -> Start:
    attitude = Rotation.from_euler("ZYX", [2.0, -0.1, 0.3]).as_matrix()
    return Start(
        np.array([0.57, 0.6, -20.0]),
        np.array([1.9, -0.4, 0.2]),
        attitude,
        cov,
        np.full(3, 0.01),
        np.ones(3),
    )


def correlated_cov() -> Floats:
    root = np.random.default_rng(4).normal(size=(12, 12)) * SD[:, None]
    cov: Floats = root @ root.T
    return cov


def errors_of(starts: tuple[Start, ...], true: Start) -> Floats:
    """Give how far each start is off, shape (s, 12), as errors against a reference are counted."""
    count = len(starts)
    velocity_error_n, misalignment_n = motion_error(
        np.array([start.velocity_n for start in starts]),
        np.array([start.mat_nb for start in starts]),
        np.tile(true.velocity_n, (count, 1)),
        np.tile(true.mat_nb, (count, 1, 1)),
    )
    accel_bias, gyro_bias = (
        np.array([getattr(true, name) - getattr(start, name) for start in starts])
        for name in ("accel_bias_b", "gyro_bias_b")
    )
    return np.hstack([velocity_error_n, misalignment_n, accel_bias, gyro_bias])


def test_first_is_the_start_itself() -> None:
    start = start_with(np.diag(SD**2))
    starts = drawn_starts(start, 16, seed=3)
    assert starts[0] is start
    assert len(starts) == 16
    for drawn in starts[1:]:
        np.testing.assert_array_equal(drawn.position, start.position)
        np.testing.assert_array_equal(drawn.cov, start.cov)
        assert (drawn.velocity_n != start.velocity_n).all()


def test_a_start_alone_is_no_draw() -> None:
    start = start_with(np.diag(SD**2))
    assert drawn_starts(start, 1, seed=3) == (start,)


def test_fewer_draws_are_the_first_of_more() -> None:
    start = start_with(correlated_cov())
    few, many = (errors_of(drawn_starts(start, count, seed=3), start) for count in (4, 9))
    np.testing.assert_array_equal(few, many[:4])
    assert (errors_of(drawn_starts(start, 4, seed=4), start)[1:] != few[1:]).all()


@pytest.mark.parametrize(
    "cov", [np.diag(SD**2), correlated_cov()], ids=["independent", "correlated"]
)
def test_draws_have_the_covariance_of_the_start(cov: Floats) -> None:
    start = start_with(cov)
    errors = errors_of(drawn_starts(start, DRAWS + 1, seed=1)[1:], start)
    squares = np.sum(errors * np.linalg.solve(cov, errors.T).T, axis=1)
    assert chi2.ppf(0.025, 12 * DRAWS) < squares.sum() < chi2.ppf(0.975, 12 * DRAWS)
    whitened = np.linalg.solve(np.linalg.cholesky(cov), errors.T)
    scatter = whitened @ whitened.T / DRAWS - np.eye(12)
    assert np.abs(scatter).max() < 4.5 * np.sqrt(2.0 / DRAWS), (
        "78 elements, each of standard error sqrt(1 or 2 / n)"
    )


@pytest.mark.parametrize("degrees", [0.5, 20.0, 90.0])
def test_a_correction_takes_out_what_was_drawn(degrees: float) -> None:
    start = start_with(np.diag(SD**2))
    error = np.concatenate(
        [
            [4.0, -3.0, 0.5],
            np.deg2rad(degrees) * np.array([0.48, 0.6, 0.64]),
            np.full(3, 0.05),
            np.full(3, -1e-4),
        ]
    )
    off = start_with_error(start, error)
    state = NavState(
        vector(off.position),
        vector(off.velocity_n),
        matrix(off.mat_nb),
        vector(off.accel_bias_b),
        vector(off.gyro_bias_b),
    )
    corrected = correct(
        state,
        np.empty(0),
        start.cov.copy(),
        error,
        layout_of(()),
        local_earth_at(*off.position[::2]),
    )
    np.testing.assert_allclose(corrected.velocity_n, start.velocity_n, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(corrected.mat_nb, start.mat_nb, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(corrected.accel_bias_b, start.accel_bias_b, rtol=0.0, atol=1e-16)
    np.testing.assert_allclose(corrected.gyro_bias_b, start.gyro_bias_b, rtol=0.0, atol=1e-16)


def test_error_states_are_those_of_the_reference() -> None:
    start, error = start_with(np.diag(SD**2)), np.arange(1.0, 13.0) * SD
    found = errors_of((start_with_error(start, error),), start)[0]
    for part in (DV, PHI, BA, BG):
        np.testing.assert_allclose(found[part], error[part], rtol=1e-9)
