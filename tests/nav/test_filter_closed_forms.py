"""The paper's setting on a straight line: formulae that fit on a line, and the numbers of the paper's tables.

Straight and level, the DVL's velocities observe the acceleration with the accelerometer's white noise N. Its mean gives
the vertical bias, its slope the gyro bias times g; the acceleration aiding makes N smaller.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from frames import frames

from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.states import DEG, DEG_PER_HOUR, MG, MRAD, PHI
from insdvl_replay.evaluation.convergence import mean_over_nine
from insdvl_replay.geometry.earth import EARTH_RATE
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.sim.dive import exact_dive
from insdvl_replay.studies.montecarlo import make_setup, run_seed, simulated_run

T, G = 424.0, 9.795  # s, m/s^2
LATITUDE, HEADING = 32.8 * DEG, 30.0 * DEG
N_A, N_G = 0.20, 3.7e-5  # m/s/sqrt(s), rad/sqrt(s)
PHI_0, BG_0 = 0.5 * DEG, 10.0 * DEG_PER_HOUR  # sd at the start
N_EFF = (
    1.0 / N_A**2 + 1.0 / (0.103**2 * 1.0)
) ** -0.5  # acceleration of 0.103 m/s^2 once a second beside N_A


@pytest.fixture(scope="module")
def straight() -> Replay:
    return replay_dive(exact_dive("straight"), load_config("levy-klein"))


@pytest.fixture(scope="module")
def published(paper: Path) -> pd.DataFrame:
    return pd.read_csv(paper / "straight.csv").set_index("state")


def table_of(replay: Replay, name: str) -> pd.DataFrame:
    return frames(replay.tables)[name].set_index("state")


def horizontal_gyro_bias_sd(noise: float, share_of_east: float) -> float:
    """Give the sd of a slope of white noise, N sqrt(12) / (g T^1.5), with what else turns the vehicle, and the prior.

    A random walk of the angle adds 6/5 N_g^2 / T to the variance of a slope. The heading's error, in the mean that of
    half-time, turns some of the Earth's rate about north into a rate about east.
    """
    earth_rate = EARTH_RATE * np.cos(LATITUDE) * np.hypot(PHI_0, BG_0 * T / 2.0) * share_of_east
    slope_var = 12.0 * noise**2 / (G**2 * T**3) + 1.2 * N_G**2 / T + earth_rate**2
    return float((1.0 / slope_var + 1.0 / BG_0**2) ** -0.5)


def test_vertical_accelerometer_bias_is_a_mean(straight: Replay) -> None:
    row = table_of(straight, "improvement").loc["ba_z"]
    assert row.baseline_sd == pytest.approx(N_A / np.sqrt(T) / MG, rel=0.02)
    assert row.sd == pytest.approx(N_EFF / np.sqrt(T) / MG, rel=0.02)


@pytest.mark.parametrize(
    ("state", "share_of_east"),
    [("bg_x", np.sin(HEADING)), ("bg_y", np.cos(HEADING))],
    ids=["bg_x", "bg_y"],
)
def test_horizontal_gyro_bias_is_a_slope(
    straight: Replay, state: str, share_of_east: float
) -> None:
    row = table_of(straight, "improvement").loc[state]
    closed_forms = [
        horizontal_gyro_bias_sd(noise, share_of_east) / DEG_PER_HOUR for noise in (N_A, N_EFF)
    ]
    assert [row.baseline_sd, row.sd] == pytest.approx(closed_forms, rel=0.02)


def test_heading_drifts_with_the_gyro_bias_about_down(straight: Replay) -> None:
    drifted = np.hypot(PHI_0, BG_0 * T) / MRAD
    row = table_of(straight, "improvement").loc["phi_d"]
    assert [row.baseline_sd, row.sd] == pytest.approx([drifted, drifted], rel=0.02)


@pytest.mark.parametrize("run", [1, 2, 3])
def test_noise_does_not_show_the_heading(run: int) -> None:
    """Readings as noisy as the filter is told make for large corrections; heading drifts as if there were none."""
    baseline, aided = simulated_run(make_setup("straight", Config(), "matched"), run_seed(1, run))
    sd = [np.sqrt(errors.var[-1, PHI][2]) for errors in (baseline, aided)]
    assert sd == pytest.approx([np.hypot(PHI_0, BG_0 * T)] * 2, rel=0.02)


@pytest.mark.parametrize(
    ("state", "power"), [("ba_z", 2.0), ("bg_x", 2.0 / 3.0), ("bg_y", 2.0 / 3.0)]
)
def test_time_to_reach_the_baseline_scales_with_the_noise(
    straight: Replay, state: str, power: float
) -> None:
    reached_s = table_of(straight, "convergence").loc[state, "reached_s"]
    assert reached_s == pytest.approx(T * (N_EFF / N_A) ** power, rel=0.02)


# --- The paper's tables.


def test_mean_improvement_is_the_papers(straight: Replay, published: pd.DataFrame) -> None:
    papers_pct = published.improvement_pct.fillna(0.0).mean()
    assert papers_pct == pytest.approx(18.76, abs=0.01)
    assert mean_over_nine(straight.tables.improvement, "aided") == pytest.approx(
        papers_pct, abs=1.0
    )


@pytest.mark.parametrize("state", ["ba_z", "bg_x", "phi_d"])
def test_sd_is_the_papers(straight: Replay, published: pd.DataFrame, state: str) -> None:
    row = table_of(straight, "improvement").loc[state]
    assert row.baseline_sd == pytest.approx(published.loc[state, "baseline_sd"], rel=0.05)
    assert row.sd == pytest.approx(published.loc[state, "aided_sd"], rel=0.05)


@pytest.mark.parametrize(("state", "within_s"), [("ba_x", 5.0), ("ba_z", 8.0), ("bg_x", 8.0)])
def test_time_to_reach_the_baseline_is_the_papers(
    straight: Replay, published: pd.DataFrame, state: str, within_s: float
) -> None:
    reached_s = table_of(straight, "convergence").loc[state, "reached_s"]
    assert reached_s == pytest.approx(published.loc[state, "reached_s"], abs=within_s)
