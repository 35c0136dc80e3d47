"""One dive in every container and encoding: the commands give the same tables, byte by byte."""

import csv
from pathlib import Path

import other_bags
import pytest

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config_file import load_config
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

# With the paper's settings, for which nothing has to be fitted.
SETTINGS = ("--preset", "levy-klein", "--starts", "1")


def tables(log: Path, output: Path) -> dict[str, bytes]:
    assert run_command_line(["run", str(log), "-o", str(output), *SETTINGS]) == 0
    [folder] = [path for path in output.iterdir() if path.is_dir()]
    return {path.name: path.read_bytes() for path in folder.glob("*.csv")}


@pytest.mark.nightly
def test_every_kind_of_log_gives_the_tables_of_its_mcap(tmp_path: Path) -> None:
    log = tmp_path / "mcap" / "dive.mcap"
    log.parent.mkdir()
    write_dive(log, simulate_dive("figure-eight", seed=3, duration_s=30.0, imu_rate_hz=50.0))
    data = log.read_bytes()
    for name in ("ros1", "plain", "bz2", "lz4", "humble", "alone"):
        (tmp_path / name).mkdir()
    (tmp_path / "alone" / "dive").mkdir()
    part = other_bags.ros2_bag(tmp_path / "alone" / "dive" / "bag", log=data) / "bag.db3"
    same = [
        other_bags.ros1_mcap(tmp_path / "ros1" / "dive.mcap", data),
        other_bags.bag(tmp_path / "plain" / "dive.bag", "", data),
        other_bags.bag(tmp_path / "bz2" / "dive.bag", "bz2", data),
        other_bags.bag(tmp_path / "lz4" / "dive.bag", "lz4", data),
        other_bags.ros2_bag(tmp_path / "humble" / "dive", log=data, humble=True),
        part.rename(tmp_path / "alone" / "dive.db3"),
    ]
    expected = tables(log, tmp_path / "expected")
    assert len(expected) >= 9
    for number, one in enumerate(same):
        assert tables(one, tmp_path / f"found_{number}") == expected, one


@pytest.mark.nightly
@pytest.mark.parametrize("number", ["01", "02", "05", "07", "08", "09", "11", "12"])
def test_real_dives_give_the_tables_of_their_mcap(
    number: str, snapir: Path, tmp_path: Path
) -> None:
    log = snapir / f"snapir_{number}.mcap"
    expected = tables(log, tmp_path / "expected")
    for humble in (False, True):
        bag = other_bags.ros2_bag(
            tmp_path / f"{humble}" / log.stem, log=log.read_bytes(), humble=humble
        )
        assert tables(bag, tmp_path / f"found_{humble}") == expected


@pytest.mark.nightly
def test_a_recorded_bag_leads_to_a_drift_below_a_hundredth_of_the_way_as_its_mcap_does(
    ros1: Path, tmp_path: Path
) -> None:
    """Nothing is known of this vehicle but where it was: two commands find how IMU and DVL are built in."""
    arm_m = [0.301, -0.500, 0.689]
    """By least squares of the DVL's velocities on the simulator's own, 0.6 mm/s away from them."""
    found = []
    for ending in ("mcap", "bag"):
        log = str(ros1 / f"rexrov2_simulated.{ending}")
        first, out = (str(tmp_path / f"{name}_{ending}") for name in ("first.toml", "out"))
        place = ["--set", "initial.latitude_deg=38.0"]
        assert run_command_line(["inspect", log, *place, "--propose", first]) == 0
        proposed = load_config(file=Path(first))
        assert (proposed.imu.axes, proposed.dvl.axes) == ("flu", "+z-y+x")
        assert (proposed.reference.topic, proposed.reference.velocity_n) == (
            "/rexrov2/pose_gt",
            "twist.twist.linear",
        )
        assert proposed.dvl.lever_arm_m == pytest.approx(arm_m, abs=0.01)
        assert run_command_line(["run", log, "-c", first, "-o", out]) == 0
        found.append({path.name: path.read_bytes() for path in Path(out).glob("*/*.csv")})
    assert found[0] == found[1]
    assert len(found[0]) >= 9
    rows = list(csv.DictReader(found[0]["reference_error.csv"].decode().splitlines()))
    [way] = [row for row in rows if row["quantity"] == "position_h_pct"]
    assert way["status"] == "compared"
    # The last position is the furthest away.
    assert (
        max(abs(float(way[name])) for name in ("baseline_rmse", "rmse", "baseline_final", "final"))
        < 1.0
    )
