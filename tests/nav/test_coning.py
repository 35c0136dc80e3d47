"""Turns and forces that go round: coning and sculling in closed form, and what is left of them in a filter."""

from dataclasses import replace
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from coning import Coning
from instants import instants
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Floats, ImuColumns
from insdvl_replay.core.states import DEG, DEG_PER_HOUR, MG
from insdvl_replay.evaluation.ensemble import RunErrors
from insdvl_replay.nav.increments import Readings, bend_weights, increments
from insdvl_replay.nav.timeline import build_timeline
from insdvl_replay.sim.dive import exact_dive
from insdvl_replay.studies.montecarlo import make_setup, run_seed, simulated_run

CONE, FREQUENCY = 3.0 * DEG, 2.0 * np.pi  # once a second
STEADY_N, SWING_N = (
    np.array([0.2, -0.1, -9.8]),
    np.array([0.4, -0.3, 0.2]),
)  # specific force, m/s^2
UNBIASED = (0.0, 0.0, 0.0)
MICRO_G = 1e-3 * MG


def attitude(time_s: Floats) -> Rotation:
    """The axis of the turn goes round, and the axes of the body with it."""
    angle = FREQUENCY * time_s
    return Rotation.from_rotvec(
        CONE * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    )


def coning_rate_b(time_s: Floats) -> Floats:
    """The angular rate of this motion in closed form."""
    angle, turning = FREQUENCY * time_s, FREQUENCY * np.sin(CONE)
    along = np.full_like(angle, -FREQUENCY * (1.0 - np.cos(CONE)))
    return np.column_stack([-turning * np.sin(angle), turning * np.cos(angle), along])


def drifts(time_s: Floats, last_s: float) -> tuple[float, float]:
    """Sum up readings at some times; return how far attitude, rad, and velocity, m/s, are off at the end."""
    force_n = STEADY_N + np.sin(FREQUENCY * time_s + 0.3)[:, None] * SWING_N
    time_ns = np.rint(time_s * 1e9).astype(np.int64)
    imu = ImuColumns(time_ns, attitude(time_s).apply(force_n, inverse=True), coning_rate_b(time_s))
    ping_ns = np.arange(int(0.37e9), int(last_s * 1e9), 1_000_000_000)
    at = instants(build_timeline(imu, ping_ns, np.empty(0, np.int64), 0, int(last_s * 1e9)))
    readings = list(map(Readings, *(map(tuple, column) for column in at[2:6])))  # type: ignore[arg-type]
    turn, velocity_n = attitude(np.zeros(1))[0], np.zeros(3)
    for (before, after), dt in zip(pairwise(readings), np.diff(at.time_s), strict=True):
        summed = increments(before, after, UNBIASED, UNBIASED, dt)
        turned = turn * Rotation.from_rotvec(summed.turn_b)
        velocity_n += (
            0.5 * dt * (turn.apply(summed.mean_force_b) + turned.apply(summed.mean_force_b))
        )
        turn = turned
    swung = (np.cos(0.3) - np.cos(FREQUENCY * last_s + 0.3)) / FREQUENCY
    off = (turn * attitude(np.array([last_s]))[0].inv()).magnitude()
    return float(off), float(np.linalg.norm(velocity_n - last_s * STEADY_N - swung * SWING_N))


def even(rate_hz: float) -> Floats:
    return np.arange(int(12 * rate_hz) + 1) / rate_hz


def test_coning_and_sculling_are_of_fourth_order() -> None:
    """Half the step leaves a sixteenth, in spite of a ping every second inside an interval."""
    (coarse, coarse_mps), (fine, fine_mps) = (
        drifts(even(rate_hz), 10.0) for rate_hz in (20.0, 40.0)
    )
    assert 14.0 < coarse / fine < 18.0
    assert 14.0 < coarse_mps / fine_mps < 20.0
    assert coarse / 10.0 < 1.0 * DEG_PER_HOUR, (
        "58 deg/h by straight lines and without a term for coning"
    )
    assert coarse_mps / 10.0 < 15.0 * MICRO_G, (
        "340 by straight lines and without a term for sculling"
    )


def test_uneven_steps_cost_little() -> None:
    """Steps that are wrong by up to 40 % leave little more than even ones."""
    uneven_s = even(20.0)
    uneven_s[1:-1] += np.random.default_rng(1).uniform(-0.01, 0.01, len(uneven_s) - 2)
    off, off_mps = drifts(uneven_s, 10.0)
    assert off / 10.0 < 2.0 * DEG_PER_HOUR
    assert off_mps / 10.0 < 20.0 * MICRO_G


def test_a_lost_sample_costs_one_long_step() -> None:
    lost_s = np.delete(even(50.0), [100, 230, 231, 300])
    off, off_mps = drifts(lost_s, 10.0)
    assert off < 1e-5
    assert off_mps < 1e-4


def test_bend_of_uneven_steps_is_that_of_the_parabola() -> None:
    before, after = bend_weights(0.01, 0.03)
    time_s = np.array([-0.01, 0.0, 0.03])
    steps = np.diff(np.polynomial.Polynomial([4.0, 3.0, 2.0])(time_s))
    assert after * steps[1] - before * steps[0] == pytest.approx(2.0)
    assert bend_weights(0.01, 0.05) == bend_weights(0.05, 0.01) == (0.0, 0.0)


# What a filter makes of it.


def runs_at(imu_rate_hz: float, duration_s: float, seeds: range) -> list[RunErrors]:
    """Run a FOG's filter on dives whose start and sensors err as it believes, on a cone of 3 deg at 1 s."""
    config = load_config("fog")
    config = msgspec.structs.replace(
        config, filters={config.baseline: config.filters[config.baseline]}
    )
    exact = exact_dive(
        Coning(3.0, 1.0),
        duration_s=duration_s,
        imu_rate_hz=imu_rate_hz,
        reference_at_pings=True,  # type: ignore[arg-type]
    )
    setup = replace(make_setup("straight", config, "matched", 10.0), exact=exact)
    return [simulated_run(setup, run_seed(1, seed))[0] for seed in seeds]


def standardised_heading(runs: list[RunErrors]) -> float:
    """Mean square of the error of the heading at the end, in its variance."""
    return float(np.mean([run.error[-1, 5] ** 2 / run.var[-1, 5] for run in runs]))


def test_coning_leaves_the_heading_as_sure_as_it_says() -> None:
    """The mean over so few runs is below 3 for chi-square of one degree of freedom, all but once in ten thousand."""
    assert standardised_heading(runs_at(20.0, 200.0, range(8))) < 3.0


@pytest.mark.nightly
@pytest.mark.parametrize(("imu_rate_hz", "limit"), [(20.0, 3.0), (50.0, 1.5)])
def test_coning_for_ten_minutes_leaves_the_heading_as_sure_as_it_says(
    imu_rate_hz: float, limit: float
) -> None:
    assert standardised_heading(runs_at(imu_rate_hz, 600.0, range(60))) < limit
