"""A remotely operated vehicle with a small IMU, straight from its maker's protobuf, against satellite positions."""

from pathlib import Path

import numpy as np
import pytest
from frames import frame

from insdvl_replay.core.config import Config, Dvl, Imu
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs import read_dive
from insdvl_replay.preparation.replay import Replay, replay_log

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "blueye_x3"
CONFIG = Path(__file__).parents[2] / "examples" / "blueye_x3.toml"
GRAVITY_MPS2 = 9.822

pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason="the real logs in ../shared/data are not here"
)


@pytest.fixture(scope="module")
def replay() -> Replay:
    return replay_log(DATA / "auto_square.mcap", load_config(file=CONFIG))


def test_square_stays_within_two_metres_of_the_satellite_track(replay: Replay) -> None:
    rows = frame(replay.tables.reference_error).set_index(["filter", "quantity"])
    position = rows.loc[("aided", "position_h")]
    assert position["samples"] > 400
    assert position["baseline_rmse"] < 2.0
    assert position["rmse"] < 2.0
    assert rows.loc[("aided", "heading"), "status"] == "not in reference"


def test_dive_with_stamps_in_bursts_is_reported_and_consistent_in_the_mean_with_the_settings_of_the_example() -> (
    None
):
    overrides = [
        "initial.heading_deg=112.3",
        "dvl.scale=1.061",
        "initial.gyro_bias_degph=[0,0,412]",
    ]
    overrides += ["dvl.latency_s=0.124"]
    overrides += ["noise.accel_white_mps_rts=0.05", "noise.gyro_white_rad_rts=5e-4"]
    replay = replay_log(
        DATA / "gnss_challenging.mcap", load_config(file=CONFIG, overrides=overrides)
    )
    assert [note.code for note in replay.notes if note.severity == "warning"] == ["imu_bursts"]
    judged = frame(replay.tables.consistency)
    of_all_axes = judged[judged["dof"] == 3]
    assert set(of_all_axes["measurement"]) == {"velocity", "acceleration"}
    assert (of_all_axes["mean_nis"] - 3.0).abs().max() < 0.5
    position = frame(replay.tables.reference_error).set_index("quantity").loc["position_h"]
    assert position["baseline_rmse"] < 1.5
    assert position["rmse"] < 1.4


def test_every_repeat_is_counted(replay: Replay) -> None:
    notes = {note.code: note.count for note in replay.notes}
    pings = len(replay.dive.dvl.time_ns)
    assert notes["dvl_same_values"] + pings == 5425
    assert notes["dvl_same_values"] / 5425 == pytest.approx(0.77, abs=0.02)


def test_beams_add_up_to_the_velocity_next_to_them(replay: Replay) -> None:
    """Solved beams against the maker's own velocity, which no filter here uses."""
    path = DATA / "auto_square.mcap"
    settings = {"topic": "blueye.protocol.DvlVelocityTel"}
    by_velocity = read_dive(
        path,
        Config(
            imu=Imu(topic="blueye.protocol.Imu2Tel"),
            dvl=Dvl(kind="velocity", latency_s=0.138, **settings),
        ),
    )
    beams, vectors_d = replay.dive.dvl.beam_velocity_mps, replay.dive.dvl.beam_vectors_d
    assert beams is not None
    assert vectors_d is not None
    assert by_velocity.dvl.velocity_d is not None
    _, ours, theirs = np.intersect1d(
        replay.dive.dvl.time_ns, by_velocity.dvl.time_ns, return_indices=True
    )
    whole = np.isfinite(beams[ours]).all(axis=1)
    solved_d = beams[ours][whole] @ np.linalg.pinv(vectors_d).T
    apart_mps = np.linalg.norm(solved_d - by_velocity.dvl.velocity_d[theirs][whole], axis=1)
    assert whole.sum() > 1000
    assert np.median(apart_mps) < 0.01


@pytest.mark.parametrize(
    ("topic", "scale"), [("Imu1Tel", 1.0), ("Imu2Tel", 1.0), ("CalibratedImuTel", 0.55)]
)
def test_accelerometers_point_down_whichever_is_named(topic: str, scale: float) -> None:
    settings = Imu(topic=f"blueye.protocol.{topic}", specific_force_scale=scale)
    imu = read_dive(DATA / "auto_square.mcap", Config(imu=settings)).imu
    assert np.median(imu.specific_force_b[:, 2]) == pytest.approx(-GRAVITY_MPS2, rel=0.03)


def test_three_candidates_are_named() -> None:
    with pytest.raises(LogError, match=r"imu\.topic") as raised:
        read_dive(DATA / "auto_square.mcap", Config())
    assert raised.value.hint.startswith('imu.topic = "blueye.protocol.Imu2Tel"')


def test_json_log_is_read_by_field_paths() -> None:
    imu = Imu(
        topic="imu",
        specific_force="accelerometer",
        angular_rate="gyroscope",
        specific_force_unit="g",
        specific_force_axes="-x-y-z",
    )
    dvl = Dvl(topic="dvl", velocity="velocity")
    dive = read_dive(DATA / "car_left_back_json.mcap", Config(imu=imu, dvl=dvl))
    repeats = sum(
        note.count for note in dive.notes if note.code in ("dvl_same_values", "dvl_zero")
    )
    assert repeats + len(dive.dvl.time_ns) == 19272
    assert np.median(dive.imu.specific_force_b[:, 2]) == pytest.approx(-GRAVITY_MPS2, rel=0.1)


def test_log_without_messages_says_so() -> None:
    with pytest.raises(LogError, match=r"no_messages\.mcap"):
        read_dive(DATA / "no_messages.mcap", Config())
