"""The sample logs: small, whole, made again byte for byte, and with the paper's results inside."""

import hashlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from frames import frame

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.states import STATES
from insdvl_replay.evaluation.convergence import mean_over_nine, nearest_over_nine
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.replay import Replay, replay_log
from insdvl_replay.sim.dive import simulate_dive

SAMPLES = Path(__file__).parents[2] / "sample_logs"
SCENARIOS = {"straight.mcap": "straight", "figure_eight.mcap": "figure-eight"}


def checksums() -> dict[str, str]:
    lines = (SAMPLES / "SHA256SUMS").read_text("utf-8").splitlines()
    return {name: digest for digest, name in (line.split() for line in lines)}


@pytest.mark.parametrize("name", SCENARIOS)
def test_sample_log_is_whole_and_small(name: str) -> None:
    data = (SAMPLES / name).read_bytes()
    assert hashlib.sha256(data).hexdigest() == checksums()[name]
    assert len(data) < 4_000_000


@pytest.mark.parametrize("name", SCENARIOS)
def test_sample_log_is_made_again_byte_for_byte(name: str, tmp_path: Path) -> None:
    dive = simulate_dive(SCENARIOS[name], seed=1)
    write_dive(tmp_path / name, dive)
    assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == checksums()[name]


def test_the_command_next_to_the_logs_names_them_all() -> None:
    command = (SAMPLES / "make.sh").read_text("utf-8")
    for name, scenario in SCENARIOS.items():
        assert f'simulate {scenario} --seed 1 --force --output "$folder/{name}"' in command


@pytest.fixture(scope="module")
def straight() -> Replay:
    return replay_log(
        SAMPLES / "straight.mcap", load_config("levy-klein", overrides=["evaluation.starts=1"])
    )


def test_straight_line_improves_as_much_as_the_paper_says(straight: Replay) -> None:
    assert mean_over_nine(straight.tables.improvement, "aided") == pytest.approx(18.8, abs=1.0)


@pytest.mark.parametrize(
    ("state", "baseline_sd", "sd"),
    [("ba_z", 0.99, 0.46), ("bg_x", 1.69, 0.87), ("phi_d", 22.3, 22.3)],  # mg, deg/h, mrad
)
def test_straight_line_ends_as_sure_as_the_paper_says(
    straight: Replay, state: str, baseline_sd: float, sd: float
) -> None:
    row = frame(straight.tables.improvement).set_index("state").loc[state]
    assert row["baseline_sd"] == pytest.approx(baseline_sd, rel=0.05)
    assert row["sd"] == pytest.approx(sd, rel=0.05)


@pytest.mark.parametrize(
    ("state", "reached_s", "within_s"), [("ba_x", 31, 5), ("ba_z", 88, 8), ("bg_x", 256, 8)]
)
def test_straight_line_converges_when_the_paper_says(
    straight: Replay, state: str, reached_s: float, within_s: float
) -> None:
    row = frame(straight.tables.convergence).set_index("state").loc[state]
    assert row["reached_s"] == pytest.approx(reached_s, abs=within_s)


def test_straight_line_has_the_papers_convergence_by_the_nearest_approach(
    straight: Replay, paper: Path
) -> None:
    published = (
        pd.read_csv(paper / "straight.csv").set_index("state")["reached_s"].drop(["phi_d", "bg_z"])
    )
    rows = frame(straight.tables.convergence).set_index("state")
    assert (rows.loc[published.index, "nearest_approach_s"] - published).abs().max() <= 8.0
    assert nearest_over_nine(straight.tables.convergence, "aided") == pytest.approx(56.73, abs=2.0)
    assert straight.verdicts["aided"].mean_nearest_approach_improvement_pct == pytest.approx(
        58.24, abs=0.01
    )


def test_papers_time_of_roll_and_pitch_is_that_of_their_worst_point(straight: Replay) -> None:
    aided, rows = straight.histories[1], frame(straight.tables.convergence).set_index("state")
    for state in STATES[3:5]:
        sd = aided.sd[aided.updated, state.index] / state.factor
        time_s = (aided.time_ns[aided.updated] - aided.time_ns[0]) * 1e-9
        assert rows.loc[state.id, "nearest_approach_s"] == pytest.approx(
            time_s[np.argmax(sd)], abs=1e-6
        )
        assert sd.max() / rows.loc[state.id, "target_sd"] == pytest.approx(1.0 - 0.024, abs=5e-4)


def test_figure_eight_improves_as_much_as_the_paper_says() -> None:
    replay = replay_log(
        SAMPLES / "figure_eight.mcap", load_config("levy-klein", overrides=["evaluation.starts=1"])
    )
    assert mean_over_nine(replay.tables.improvement, "aided") == pytest.approx(40.0, abs=2.0)
    assert nearest_over_nine(replay.tables.convergence, "aided") == pytest.approx(54.0, abs=2.0)
