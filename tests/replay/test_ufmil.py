"""A vehicle without any solution to compare with: what is replayed is relative, and the tables say what is missing."""

import re
from pathlib import Path

import numpy as np
import pytest
from frames import frame

from insdvl_replay.core.config_file import load_config
from insdvl_replay.logs import read_dive
from insdvl_replay.preparation.replay import Replay, replay_log

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "ufmil"
CONFIG = Path(__file__).parents[2] / "examples" / "ufmil.toml"

pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason="the real logs in ../shared/data are not here"
)


@pytest.fixture(scope="module", params=["run_1", "run_2"])
def replay(request: pytest.FixtureRequest) -> Replay:
    return replay_log(DATA / f"{request.param}.mcap", load_config(file=CONFIG))


def test_tables_say_that_there_is_no_reference(replay: Replay) -> None:
    assert set(frame(replay.tables.reference_error)["status"]) == {"no reference"}
    assert frame(replay.tables.reference_error)["rmse"].isna().all()


def test_dvl_and_imu_agree_with_the_mounting_of_the_example(replay: Replay) -> None:
    rows = frame(replay.tables.consistency).set_index(["filter", "measurement"])
    velocity = rows.loc[("baseline", "velocity")]
    assert velocity["mean_nis"] < 3.5
    assert velocity["used"] > 0.95 * (velocity["used"] + velocity["rejected"])


def test_another_mounting_does_not(replay: Replay) -> None:
    turned = load_config(file=CONFIG, overrides=["dvl.mounting_rpy_deg=[0.0, 0.0, 0.0]"])
    other = replay_log(DATA / f"{replay.dive.name}.mcap", turned)
    velocity = (
        frame(other.tables.consistency)
        .set_index(["filter", "measurement"])
        .loc[("baseline", "velocity")]
    )
    assert velocity["verdict"] == "overconfident"
    assert velocity["mean_nis"] > 4.0
    assert other.verdicts["aided"].verdict == "not evaluated"
    assert re.search(r"baseline \w+ \d+ of \d+", other.verdicts["aided"].sentence)


def test_gravity_is_read_as_such(replay: Replay) -> None:
    imu = read_dive(DATA / f"{replay.dive.name}.mcap", load_config(file=CONFIG)).imu
    assert np.median(np.linalg.norm(imu.specific_force_b, axis=1)) == pytest.approx(9.8, abs=0.15)
