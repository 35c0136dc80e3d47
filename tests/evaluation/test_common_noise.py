"""White noise that two series share."""

import numpy as np
import pytest

from insdvl_replay.evaluation.series import common_noise


def test_common_noise_is_that_of_the_reference() -> None:
    rng = np.random.default_rng(6)
    noise = rng.normal(0.0, 0.7, (4000, 2))
    first = np.cumsum(rng.normal(0.0, 0.02, (4000, 2)), axis=0) - noise
    second = np.cumsum(rng.normal(0.0, 0.02, (4000, 2)), axis=0) - noise
    assert common_noise(first, second) == pytest.approx(0.7, rel=0.05)
    # Noise of their own is not common.
    first += noise
    second += noise
    own = rng.normal(0.0, 0.7, (2, 4000, 2))
    assert common_noise(first + own[0], second + own[1]) < 0.15
    assert common_noise(first[:5], second[:5]) == 0.0
