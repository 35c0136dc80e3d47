"""The update against the textbook's formulae in numpy, and what Joseph's form promises."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.nav.kalman import cholesky, innovation_cov, standardised, transposed_gain, update_cov
from insdvl_replay.nav.vector_algebra import matrix, vector


def random_case(seed: int, n: int = 12) -> tuple[Floats, Floats, Floats, Floats]:
    rng = np.random.default_rng(seed)
    scales = 10.0 ** rng.uniform(-6, 2, n)
    root = rng.normal(size=(n, n)) * scales[:, None]
    noise = rng.normal(size=(3, 3))
    return root @ root.T, rng.normal(size=(3, n)), noise @ noise.T + 1e-3 * np.eye(3), rng.normal(size=3)


def updated(P: Floats, H: Floats, R: Floats, z: Floats) -> tuple[Floats, Floats, float, Floats]:
    after, (HP, KT, rest) = P.copy(), np.empty((3, 3, len(P)))
    S = innovation_cov(P, H, matrix(R), HP)
    L = cholesky(S)
    transposed_gain(HP, L, KT)
    update_cov(after, H, matrix(R), HP, KT, rest)
    return after, KT.T, float(np.sum(np.square(standardised(L, vector(z))))), np.array(S)


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
    L = cholesky(((1.0, 2.0, 0.0), (2.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    assert np.isnan(standardised(L, (1.0, 1.0, 1.0))).any()
