"""Faults of published tables: stretched times, tables without a common clock, turned axes. They become settings."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_tables import tables_of

from insdvl_replay.api import replay_log
from insdvl_replay.calibration.found import Given
from insdvl_replay.core.config import Config
from insdvl_replay.geometry.frames import solve_beams
from insdvl_replay.inspection.automatic import find_settings
from insdvl_replay.inspection.proposal import propose_settings
from insdvl_replay.inspection.table_clocks import stretched_rate_hz
from insdvl_replay.sim.dive import simulate_dive

AKIT = Path(__file__).resolve().parents[3] / "shared" / "data" / "akit_csv"
SNAPIR = AKIT.parent / "snapir" / "snapir_01.mcap"
needs_dives = pytest.mark.skipif(
    not AKIT.is_dir(), reason="needs the recorded dives in ../shared/data"
)


def in_equal_steps(end_s: float, rows: int) -> np.ndarray:
    return np.rint(np.linspace(0.0, end_s, rows) * 1e9).astype(np.int64)


def test_equal_steps_to_a_round_end_with_as_many_rows_as_periods_are_stretched() -> None:
    assert stretched_rate_hz(in_equal_steps(400.0, 400)) == 1.0
    assert stretched_rate_hz(in_equal_steps(400.0, 40_000)) == 100.0
    assert stretched_rate_hz(in_equal_steps(120.0, 600)) == 5.0
    assert stretched_rate_hz(in_equal_steps(399.0, 400)) is None
    assert stretched_rate_hz(in_equal_steps(400.0, 401)) is None
    assert stretched_rate_hz(in_equal_steps(100.3, 700)) is None
    assert stretched_rate_hz(in_equal_steps(400.0, 400) + np.arange(400) ** 2) is None
    assert stretched_rate_hz(np.zeros(400, np.int64)) is None


def published(folder: Path) -> Path:
    """Write 200 s of a dive as tables whose times all run from 0 to 200 s, with the IMU's y axes turned.

    The first ping is 0.372 s after the first sample of the IMU, the first row of the reference 0.6 s.
    """
    dive = simulate_dive("calibration", seed=4, duration_s=240.0, imu_rate_hz=50.0)
    tables = tables_of(dive)
    assert dive.dvl.beam_velocity_mps is not None
    assert dive.dvl.beam_vectors_d is not None
    velocity_d = solve_beams(dive.dvl.beam_velocity_mps, dive.dvl.beam_vectors_d)[0]
    tables["dvl"] = {
        f"DVL {axis} [m/s]": column for axis, column in zip("xyz", velocity_d.T, strict=True)
    }
    for name in ("Acc y [m/s^2]", "Gyro y [rad/s]"):
        tables["imu"][name] = -tables["imu"][name]
    for name, first, rows in (("imu", 0, 10_000), ("dvl", 0, 200), ("reference", 3, 1000)):
        tables[name].pop("Time [ns]", None)
        frame = pd.DataFrame(
            {title: column[first : first + rows] for title, column in tables[name].items()}
        )
        frame.insert(0, "Time [s]", np.linspace(0.0, 200.0, rows))
        frame.to_csv(folder / f"{name}.csv", index=False)
    return folder


def test_faults_of_published_tables_become_settings(tmp_path: Path) -> None:
    proposal = propose_settings(published(tmp_path), Config())
    found = {setting.key: setting.value for setting in proposal.settings}
    assert [found[f"{role}.stamp"] for role in ("imu", "dvl", "reference")] == [
        "50 Hz",
        "1 Hz",
        "5 Hz",
    ]
    assert found["reference.angle_unit"] == "rad"
    assert found["reference.latency_s"] == pytest.approx(-0.6, abs=0.01)
    assert found["dvl.latency_s"] == pytest.approx(-0.3717, abs=0.02)
    assert {setting.key for setting in proposal.table_clocks} == {
        "imu.stamp", "dvl.stamp", "reference.stamp", "reference.latency_s", "dvl.latency_s",
    }  # fmt: skip


def test_one_table_may_have_the_columns_of_all_sensors(tmp_path: Path) -> None:
    """Rows of the IMU, of the DVL and of the reference, with empty cells for the others."""
    dive = simulate_dive("calibration", seed=4, duration_s=60.0, imu_rate_hz=50.0)
    tables = tables_of(dive)
    beams = [tables["dvl"][f"Beam {number}"] for number in (1, 2, 3)]
    tables["dvl"] = {
        "Time [ns]": tables["dvl"]["Time [ns]"],
        **dict(zip(("dvl_vx", "dvl_vy", "dvl_vz"), beams, strict=True)),
    }
    joined = pd.concat([pd.DataFrame(table) for table in tables.values()]).sort_values(
        "Time [ns]", kind="stable"
    )
    joined.to_csv(tmp_path / "all.csv", index=False)
    found = {
        setting.key: setting.value
        for setting in propose_settings(tmp_path / "all.csv", Config()).settings
    }
    assert {found[f"{role}.topic"] for role in ("imu", "dvl", "reference")} == {"all.csv"}
    fields = [
        found[key]
        for key in (
            "imu.specific_force",
            "imu.angular_rate",
            "dvl.velocity",
            "reference.velocity_n",
        )
    ]
    assert fields == [
        "acc_x, acc_y, acc_z",
        "gyro_x, gyro_y, gyro_z",
        "dvl_vx, dvl_vy, dvl_vz",
        "v_north, v_east, v_down",
    ]
    assert not [key for key in found if key.endswith(("stamp", "latency_s"))]


@pytest.mark.nightly
@needs_dives
def test_faults_of_a_recorded_dive_are_found() -> None:
    """Its README tells what they are, to some 5 ms."""
    found = {setting.key: setting for setting in propose_settings(AKIT, Config()).settings}
    assert [found[f"{role}.stamp"].value for role in ("imu", "dvl", "reference")] == [
        "100 Hz",
        "1 Hz",
        "1 Hz",
    ]
    assert "0.25 % too slow" in found["dvl.stamp"].seen
    assert found["reference.latency_s"].value == pytest.approx(0.416, abs=0.01)
    assert found["dvl.latency_s"].value == pytest.approx(-1.018, abs=0.02)
    assert found["reference.height"].value == "altitude"
    assert find_settings([[AKIT]], Given(Config())).config.imu.axes == "+x-y+z"


@needs_dives
@pytest.mark.nightly
def test_a_dive_as_published_is_as_good_as_corrected() -> None:
    of_tables, of_log = (replay_log(path, auto=True).tables for path in (AKIT, SNAPIR))
    errors_m = []
    for tables in (of_tables, of_log):
        evidence = tables["evidence"]
        errors_m.append(float(evidence[evidence.quantity == "position"].baseline.iloc[0]))
        assert set(tables["consistency"].verdict) <= {"consistent", "conservative"}
    assert errors_m[0] == pytest.approx(errors_m[1], rel=0.2)
