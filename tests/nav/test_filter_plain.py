"""The filter, made for speed, against the same equations as plain matrices."""

from dataclasses import replace

import numpy as np
import pytest
from plain_filter import baseline_inputs, run_plain_filter

from insdvl_replay.core.config import Config, Filter
from insdvl_replay.nav.filter import run_filter
from insdvl_replay.sim.dive import simulate_dive

DURATION_S = 150.0  # to the end of the second turn


@pytest.mark.parametrize("grade", ["fog", "mems"])
def test_filter_is_what_the_matrices_say(grade: str) -> None:
    dive = simulate_dive(
        "figure-eight", seed=4, duration_s=DURATION_S, imu_rate_hz=20.0, grade=grade
    )
    inputs = baseline_inputs(dive, Config(filters={"baseline": Filter(aiding=("velocity",))}))
    plain = run_plain_filter(inputs)
    timeline, start, noise_density, velocity = inputs
    history = run_filter(
        "fast", timeline, start, noise_density, (velocity,), np.zeros(3), cov_ns=timeline.event_ns
    )
    sd = np.sqrt(np.diag(plain.P))
    np.testing.assert_allclose(history.sd[-1], sd, rtol=1e-7)
    # What is off comes of the Earth's gravity, which is computed anew every 0.6 m.
    np.testing.assert_allclose(
        history.cov[-1] / np.outer(sd, sd), plain.P / np.outer(sd, sd), rtol=0.0, atol=1e-6
    )
    np.testing.assert_allclose(history.velocity_n[-1], plain.velocity_n, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(history.mat_nb[-1], plain.mat_nb, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(history.accel_bias_b[-1], plain.accel_bias_b, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(history.gyro_bias_b[-1], plain.gyro_bias_b, rtol=0.0, atol=1e-10)
    metres = np.array([6.4e6, 6.4e6, 1.0])
    np.testing.assert_allclose(
        history.position[-1] * metres, plain.position * metres, rtol=0.0, atol=1e-5
    )


def test_a_reading_is_used_if_its_nis_is_within_the_gate() -> None:
    dive = simulate_dive("straight", seed=4, duration_s=60.0, imu_rate_hz=20.0)
    timeline, start, noise_density, velocity = baseline_inputs(
        dive, Config(filters={"a": Filter(aiding=("velocity",))})
    )
    (open_,) = run_filter(
        "open", timeline, start, noise_density, (velocity,), np.zeros(3)
    ).innovations
    gated = replace(velocity, gate=float(np.median(open_.nis)), reopen_after=0)
    (found,) = run_filter(
        "gated", timeline, start, noise_density, (gated,), np.zeros(3)
    ).innovations
    assert 5 < found.used.sum() < len(found.used) - 5
    np.testing.assert_array_equal(found.used, found.nis <= gated.gate)
