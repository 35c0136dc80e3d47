"""A second start with a heading of the vehicle: who runs from it, and what else turns with it."""

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from baseline_as_candidate import FITTING

from insdvl_replay.checks.fingerprint import imu_fingerprint
from insdvl_replay.core.config import Config, Evaluation, Filter
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.quantities import DRAWN_HEADING
from insdvl_replay.core.states import DEG, DV, PHI
from insdvl_replay.geometry.rotation import mat_from_vector, rpy_from_mat, vector_from_mat
from insdvl_replay.nav.levelling import Start, start_cov
from insdvl_replay.preparation.heading_draw import HEADING, HeadingDraw, heading_draw, turned_start
from insdvl_replay.preparation.prepared import prepare_dive
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.preparation.run import plan_runs, run_candidates
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import SensorErrors

SD_DEG = 3.0
BASELINE = 'filters.baseline={aiding = ["velocity"]}'
FILTERS = {
    "slopes": 'aiding = ["velocity", "acceleration"], acceleration = {model = "windowed", window = 3}',
    "depth": 'aiding = ["velocity", "depth"]',
    "compass": 'aiding = ["velocity", "heading"]',
    "fixes": 'aiding = ["velocity", "position"]',
    "placed": 'aiding = ["velocity"], states = ["position"]',
}
SENSORS = {
    "heading": SensorErrors(0.5, 1.0),
    "depth": SensorErrors(0.05, 1.0),
    "position": SensorErrors(2.0, 0.1),
}


def simulated(seed: int) -> Dive:
    dive = simulate_dive(
        "lawnmower",
        seed=seed,
        duration_s=60.0,
        grade="tactical",
        imu_rate_hz=20.0,
        sensors=SENSORS,
    )
    return replace(dive, imu_fingerprint=imu_fingerprint(dive.imu))


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulated(1)


def settings(*names: str, **initial: Any) -> Config:
    filters = [f"filters.{name}={{{FILTERS[name]}}}" for name in names]
    config = load_config("tactical", overrides=[BASELINE, *filters, "evaluation.starts=1"])
    start = msgspec.structs.replace(
        config.initial, misalignment_sd_deg=(0.5, 0.5, SD_DEG), **initial
    )
    return msgspec.structs.replace(config, initial=start)


def draw_of(dive: Dive, config: Config, seed: int = 0) -> HeadingDraw | None:
    return heading_draw(dive, prepare_dive(dive, config), config, seed)


def test_those_that_use_heading_or_position_run_from_the_drawn_heading(dive: Dive) -> None:
    draw = draw_of(dive, settings(*FILTERS))
    assert draw is not None
    assert draw.filters == {"baseline", "compass", "fixes", "placed"}


def test_nothing_runs_twice_where_nobody_depends_on_the_heading(dive: Dive) -> None:
    config = settings("slopes", "depth")
    prepared = prepare_dive(dive, config)
    assert heading_draw(dive, prepared, config, 0) is None
    assert run_candidates(dive, prepared, plan_runs(dive, prepared, config), config).turned == ()


def test_a_heading_of_the_vehicle_is_not_drawn_again(dive: Dive) -> None:
    assert draw_of(dive, settings("compass", source="level")) is None
    assert draw_of(dive, settings("compass", source="level", heading_deg=30.0)) is None
    assert draw_of(dive, settings("compass")) is not None


def test_the_heading_errs_by_the_sd_of_the_settings_to_a_side_that_dive_and_seed_choose(
    dive: Dive,
) -> None:
    """Dives of equal length differ, and a renamed dive does not."""
    config = settings("compass")
    own = prepare_dive(dive, config).alignment.start
    first, renamed = draw_of(dive, config), draw_of(replace(dive, name="other"), config)
    assert first is not None
    assert renamed is not None
    assert abs(first.error_deg) == pytest.approx(SD_DEG)
    assert renamed.error_deg == first.error_deg
    turn_deg = vector_from_mat(first.start.mat_nb @ own.mat_nb.T) / DEG
    np.testing.assert_allclose(turn_deg, [0.0, 0.0, first.error_deg], atol=1e-9)
    assert first.start.sd[HEADING] == pytest.approx(SD_DEG * DEG)
    np.testing.assert_allclose(first.start.sd[PHI][:2], own.sd[PHI][:2])
    by_seed = {
        draw.error_deg > 0.0
        for seed in range(12)
        if (draw := draw_of(dive, config, seed)) is not None
    }
    by_dive = {
        draw.error_deg > 0.0
        for number in range(8)
        if (draw := draw_of(simulated(number), config)) is not None
    }
    assert by_seed == by_dive == {False, True}


def start_with(velocity_by_dvl: bool) -> Start:
    velocity_n = np.array([1.0, 0.5, 0.0])
    sd = np.repeat([0.01, 0.05 * DEG, 1e-3, 1e-6], 3)
    cov = start_cov(sd, np.eye(3), None, velocity_n if velocity_by_dvl else None)
    return Start(np.array([0.9, 0.1, -5.0]), velocity_n, np.eye(3), cov)


def test_a_velocity_of_the_dvl_turns_with_the_heading_and_one_of_the_reference_stays() -> None:
    error, sd = 1.0 * DEG, 1.0 * DEG
    turn = mat_from_vector(np.array([0.0, 0.0, error]))
    by_dvl, by_reference = (start_with(velocity_by_dvl) for velocity_by_dvl in (True, False))
    turned = turned_start(by_dvl, error, sd)
    np.testing.assert_allclose(turned.velocity_n, turn @ by_dvl.velocity_n, atol=5e-4)
    stayed = turned_start(by_reference, error, sd)
    np.testing.assert_allclose(stayed.velocity_n, by_reference.velocity_n, atol=5e-4)
    for start in (turned, stayed):
        assert float(rpy_from_mat(start.mat_nb)[2]) == pytest.approx(error)
        assert start.sd[HEADING] == pytest.approx(sd)
    # In P as well: across the way, the velocity of the DVL is as uncertain as the heading makes it.
    np.testing.assert_allclose(stayed.sd[DV], by_reference.sd[DV])
    assert turned.sd[1] == pytest.approx(np.hypot(0.01, 1.0 * sd), rel=1e-3)


def test_a_filter_that_is_less_sure_of_its_heading_than_the_draw_stays_so() -> None:
    start = start_with(velocity_by_dvl=True)
    turned = turned_start(start, 0.01 * DEG, 0.01 * DEG)
    np.testing.assert_allclose(turned.cov, start.cov)


def test_all_filters_start_from_the_same_drawn_heading(dive: Dive) -> None:
    config = settings("compass", "slopes", "fixes")
    prepared = prepare_dive(dive, config)
    plan = plan_runs(dive, prepared, config)
    runs = run_candidates(dive, prepared, plan, config)
    assert plan.heading is not None
    assert [history.filter for history in runs.turned] == ["baseline", "compass", "fixes"]
    for history in runs.turned:
        np.testing.assert_array_equal(history.mat_nb[0], plan.heading.start.mat_nb)
        assert history.innovations == ()
    # The other runs are those of a replay without a second start.
    alone = run_candidates(dive, prepared, replace(plan, heading=None), config)
    for own, other in zip(runs.histories, alone.histories, strict=True):
        np.testing.assert_array_equal(own.position, other.position)


@pytest.mark.nightly
def test_a_filter_of_the_user_s_runs_from_the_drawn_heading_of_the_baseline() -> None:
    """The baseline as a class has the errors of the baseline from both starts, which differ."""
    dive = simulate_dive("lawnmower", seed=3, duration_s=120.0, imu_rate_hz=20.0)
    mine = Filter(candidate="baseline_as_candidate:Baseline")
    filters = {"baseline": Filter(aiding=("velocity",)), "mine": mine}
    config = Config(
        noise=FITTING.noise, dvl=FITTING.dvl, filters=filters, evaluation=Evaluation(starts=1)
    )
    replay = replay_dive(dive, config)
    rows = {row.quantity: row for row in replay.tables.evidence}
    own, drawn = rows["position"], rows[DRAWN_HEADING]
    assert own.value == pytest.approx(own.baseline, rel=1e-3)
    assert drawn.value == pytest.approx(drawn.baseline, rel=1e-3)
    assert drawn.baseline != pytest.approx(own.baseline, rel=0.05)
