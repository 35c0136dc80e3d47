"""The update against the textbook's formulae in numpy, and what Joseph's form promises."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.nav.kalman import (
    WINDOW,
    chance_var,
    cholesky,
    innovation_cov,
    normalised_square,
    transposed_gain,
    update_cov,
)


def random_case(seed: int, size: int = 3, n: int = 12) -> tuple[Floats, Floats, Floats, Floats]:
    rng = np.random.default_rng(seed)
    scales = 10.0 ** rng.uniform(-6, 2, n)
    root = rng.normal(size=(n, n)) * scales[:, None]
    noise = rng.normal(size=(size, size))
    return (
        root @ root.T,
        rng.normal(size=(size, n)),
        noise @ noise.T + 1e-3 * np.eye(size),
        rng.normal(size=size),
    )


def updated(P: Floats, H: Floats, R: Floats, z: Floats) -> tuple[Floats, Floats, float, Floats]:
    size = len(z)
    after, (HP, KT, rest), (S, L) = (
        P.copy(),
        np.empty((3, size, len(P))),
        np.empty((2, size, size)),
    )
    innovation_cov(P, H, R, HP, S)
    cholesky(S, L)
    transposed_gain(HP, L, KT)
    update_cov(after, H, R, HP, KT, rest)
    return after, KT.T, normalised_square(L, z, np.empty(size)), S


@pytest.mark.parametrize(("size", "n"), [(1, 12), (2, 15), (3, 12), (3, 17), (4, 15)])
def test_update_is_the_textbooks(size: int, n: int) -> None:
    P, H, R, z = random_case(1, size, n)
    after, K, nis, S = updated(P, H, R, z)
    np.testing.assert_allclose(S, H @ P @ H.T + R, rtol=1e-12)
    np.testing.assert_allclose(K, P @ H.T @ np.linalg.inv(H @ P @ H.T + R), rtol=1e-8)
    np.testing.assert_allclose(
        after, (np.eye(n) - K @ H) @ P, rtol=1e-6, atol=1e-9 * np.abs(P).max()
    )
    np.testing.assert_allclose(nis, z @ np.linalg.solve(S, z), rtol=1e-10)


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 10_000))
def test_covariance_stays_symmetric_positive_and_does_not_grow(seed: int) -> None:
    P, H, R, z = random_case(seed)
    after, *_ = updated(P, H, R, z)
    np.testing.assert_array_equal(after, after.T)
    assert np.linalg.eigvalsh(after).min() > -1e-12 * np.abs(after).max()
    assert (np.diag(after) <= np.diag(P) * (1.0 + 1e-9)).all()


def test_a_covariance_that_is_none_is_not_used() -> None:
    L = np.empty((3, 3))
    cholesky(np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), L)
    assert np.isnan(normalised_square(L, np.ones(3), np.empty(3)))


@pytest.mark.parametrize(
    ("size", "ins_share", "used"), [(3, 0.0, 1.0), (1, 0.0, 2.5), (3, 0.5, 2.5)]
)
def test_chance_of_the_noise_factor_is_that_of_an_exponential_mean_of_squares(
    size: int, ins_share: float, used: float
) -> None:
    """Squares of unit normals have the variance 2, which a mean with the weight a makes a / (2 - a) of."""
    settings_var = 0.02**2
    R = used * settings_var * np.eye(size)
    S = R + ins_share * settings_var * np.eye(size)
    var = 0.0
    for _ in range(1000):
        var = chance_var(var, used, S, R)
    weight = 1.0 / WINDOW
    expected = 2.0 / size * (1.0 + ins_share) ** 2 * weight / (2.0 - weight)
    assert var == pytest.approx(expected, rel=1e-9)
