"""One dive in every container and encoding: the commands give the same tables, byte by byte."""

from pathlib import Path

import other_bags
import pytest

from insdvl_replay.cli import run_command_line
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

pytestmark = pytest.mark.slow


def tables(log: Path, output: Path) -> dict[str, bytes]:
    assert run_command_line(["run", str(log), "-o", str(output)]) == 0
    [folder] = [path for path in output.iterdir() if path.is_dir()]
    return {path.name: path.read_bytes() for path in folder.glob("*.csv")}


def test_every_kind_of_log_gives_the_tables_of_its_mcap(tmp_path: Path) -> None:
    log = tmp_path / "mcap" / "dive.mcap"
    log.parent.mkdir()
    write_dive(log, simulate_dive("figure-eight", seed=3, duration_s=60.0))
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


def test_real_dives_give_the_tables_of_their_mcap(snapir: Path, tmp_path: Path) -> None:
    log = snapir / "snapir_01.mcap"
    expected = tables(log, tmp_path / "expected")
    for humble in (False, True):
        bag = other_bags.ros2_bag(tmp_path / f"{humble}" / log.stem, log=log.read_bytes(), humble=humble)
        assert tables(bag, tmp_path / f"found_{humble}") == expected


def test_a_recorded_bag_gives_the_tables_of_its_mcap(ros1: Path, tmp_path: Path) -> None:
    """The vehicle drives one way and the other within seconds: not every table has rows."""
    found = []
    for ending in ("mcap", "bag"):
        log, settings = ros1 / f"rexrov2_simulated.{ending}", tmp_path / "vehicle.toml"
        settings.write_text(
            '[imu]\naxes = "flu"\n[dvl]\ntopic = "/rexrov2/dvl"\nvelocity = "velocity"\n'
            '[reference]\ntopic = "/rexrov2/pose_gt"\n[initial]\nlatitude_deg = 10.0\n'
        )
        assert run_command_line(["run", str(log), "-c", str(settings), "-o", str(tmp_path / ending)]) == 0
        folder = tmp_path / ending / log.stem
        found.append({path.name: path.read_bytes() for path in folder.glob("*.csv")})
    assert found[0] == found[1]
    assert len(found[0]) >= 9
