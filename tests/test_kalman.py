"""The update against the textbook's formulae in numpy, and what Joseph's form promises."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from insdvl_replay.columns import Floats
from insdvl_replay.nav.kalman import cholesky, innovation_cov, standardised, transposed_gain, update_cov


def random_case(seed: int, n: int = 12, m: int = 3) -> tuple[Floats, Floats, Floats, Floats]:
    rng = np.random.default_rng(seed)
    scales = 10.0 ** rng.uniform(-6, 2, n)
    root = rng.normal(size=(n, n)) * scales[:, None]
    noise = rng.normal(size=(m, m))
    return root @ root.T, rng.normal(size=(m, n)), noise @ noise.T + 1e-3 * np.eye(m), rng.normal(size=m)


def updated(P: Floats, H: Floats, R: Floats, z: Floats) -> tuple[Floats, Floats, float, Floats]:
    HP, S, L = np.empty((len(z), len(P))), np.empty((len(z), len(z))), np.zeros((len(z), len(z)))
    innovation_cov(P, H, R, HP, S)
    cholesky(S, L)
    KT = transposed_gain(HP, L)
    after = P.copy()
    update_cov(after, H, R, HP, KT)
    return after, KT.T, float(np.sum(standardised(L, z) ** 2)), S


def test_update_is_the_textbooks() -> None:
    P, H, R, z = random_case(1)
    after, K, nis, S = updated(P, H, R, z)
    np.testing.assert_allclose(S, H @ P @ H.T + R, rtol=1e-12)
    np.testing.assert_allclose(K, P @ H.T @ np.linalg.inv(H @ P @ H.T + R), rtol=1e-8)
    np.testing.assert_allclose(after, (np.eye(12) - K @ H) @ P, rtol=1e-6, atol=1e-9 * np.abs(P).max())
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
    L = np.zeros((2, 2))
    cholesky(np.array([[1.0, 2.0], [2.0, 1.0]]), L)
    assert np.isnan(standardised(L, np.ones(2))).any()
