"""`run` without settings: what is found for logs that cannot be replayed as they are, and how it is reported."""

import json
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import damaged
import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from insdvl_replay import replay_log
from insdvl_replay.calibration.found import Given
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, nanoseconds
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.misfit import LEAST_NIS, MOST_NIS
from insdvl_replay.inspection.automatic import find_settings
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.replay import replay_log as replayed
from insdvl_replay.sim.dive import simulate_dive


@pytest.fixture(scope="module")
def good() -> Dive:
    return damaged.velocities_alone(
        simulate_dive("calibration", duration_s=200.0, imu_rate_hz=50.0, seed=4, grade="tactical")
    )


def written(dive: Dive, damage: str, folder: Path) -> Path:
    log = folder / "dive.mcap"
    write_dive(log, damaged.DAMAGES[damage](dive))
    return log


@pytest.mark.nightly
def test_a_damaged_log_is_replayed_and_the_found_settings_repeat_it(
    good: Dive, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = written(good, "mg, flu and deg/s", tmp_path)
    first, second = tmp_path / "first", tmp_path / "second"
    assert run_command_line(["run", str(log), "-o", str(first), "--starts", "1"]) == 0
    lines = [
        line
        for line in capsys.readouterr().err.splitlines()
        if line.startswith(("found:", "assumed:"))
    ]
    assert 3 <= len(lines) < 8
    report = json.loads((first / "dive" / "report.json").read_text())
    nis = next(row for row in report["tables"]["consistency"] if row["measurement"] == "velocity")
    assert LEAST_NIS < nis["mean_nis"] / nis["dof"] < MOST_NIS
    assert report["config"]["imu"]["axes"] == "flu"
    assert report["config"]["imu"]["specific_force_unit"] == "mg"
    assert report["config"]["imu"]["angular_rate_unit"] == "deg/s"
    assert {"found_imu", "found_dvl", "found_calibration"} <= {
        note["code"] for note in report["notes"]
    }
    vehicle = str(first / "dive" / "vehicle.toml")
    assert run_command_line(["run", str(log), "-o", str(second), "-c", vehicle]) == 0
    assert json.loads((second / "dive" / "report.json").read_text())["tables"] == report["tables"]
    # The stored settings are used again, and found again if that is wanted.
    assert run_command_line(["run", str(log), "-o", str(first), "--starts", "1"]) == 0
    assert "unchanged" in capsys.readouterr().err
    assert run_command_line(["run", str(log), "-o", str(first), "--starts", "1", "--rerun"]) == 0
    assert "found: IMU" in capsys.readouterr().err
    assert (first / "dive" / "vehicle.toml").is_file()


@pytest.mark.nightly
def test_dives_that_fit_or_cannot_be_read_do_not_decide_for_the_others(
    good: Dive, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, broken = written(good, "deg/s", tmp_path), tmp_path / "broken.mcap"
    broken.write_bytes(b"no log" * 100)
    for place, first in enumerate((Path("sample_logs/straight.mcap").absolute(), broken)):
        out = tmp_path / f"out{place}"
        code = run_command_line(["run", str(first), str(log), "-o", str(out), "--starts", "1"])
        assert (code == 0) == (first != broken)
        assert "found: IMU" in capsys.readouterr().err
        assert (out / "dive" / "vehicle.toml").is_file()
        if first != broken:  # it fits as it is, but for its noise
            own = load_config(file=out / "straight" / "vehicle.toml")
            assert (own.imu, own.initial.source) == (Config().imu, Config().initial.source)


def test_no_auto_stops(good: Dive, tmp_path: Path) -> None:
    log = written(good, "deg/s", tmp_path)
    assert (
        run_command_line(["run", str(log), "-o", str(tmp_path / "out"), "--no-auto"])
        == LogError.exit_code
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.nightly
def test_python_finds_the_same_settings(good: Dive, tmp_path: Path) -> None:
    log = written(good, "DVL 90.0", tmp_path)
    result = replay_log(log, load_config(overrides=["evaluation.starts=1"]), auto=True)
    assert result.report.config["dvl"]["mounting_rpy_deg"][2] == pytest.approx(90.0, abs=0.5)


@pytest.mark.parametrize(
    "damage", ["accelerometers -x+y+z", "gyros +x+y-z", "gyro scale 0.6", "IMU 0.3 s late"]
)
@pytest.mark.nightly
def test_signs_scales_and_late_stamps_are_found(damage: str, good: Dive, tmp_path: Path) -> None:
    log = written(good, damage, tmp_path)
    config = load_config(overrides=["evaluation.starts=1"])
    size, drift_m = damaged.measured(replayed(log, find_settings([[log]], Given(config)).config))
    assert LEAST_NIS < size < MOST_NIS
    assert drift_m < 1.5


def test_a_vehicle_at_rest_is_refused(tmp_path: Path) -> None:
    log = tmp_path / "static.mcap"
    write_dive(log, damaged.velocities_alone(simulate_dive("static", duration_s=60.0)))
    with pytest.raises(LogError, match="too slow to find settings"):
        find_settings([[log]], Given(load_config()))


def wandering(dive: Dive, folder: Path) -> Path:
    """Write a dive with a reference that moves otherwise than IMU and DVL."""
    reference, log = dive.reference, folder / "dive.mcap"
    assert reference is not None
    rng = np.random.default_rng(1)
    velocity_n = np.cumsum(rng.normal(scale=0.3, size=reference.velocity_n.shape), axis=0)
    write_dive(log, replace(dive, reference=replace(reference, velocity_n=velocity_n)))
    return log


def test_a_value_that_is_given_stays_also_where_it_is_the_default(
    good: Dive, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["run", str(wandering(good, tmp_path)), "-o", str(tmp_path / "out"), "--starts", "1"]
    command += [
        "--preset",
        "levy-klein",
        "--set",
        "dvl.lever_arm_m=[0,0,0]",
        "--set",
        "reference.ignore=false",
    ]
    assert run_command_line(command) == 0
    assert "found: IMU" in capsys.readouterr().err
    config = json.loads((tmp_path / "out" / "dive" / "report.json").read_text())["config"]
    default = json.loads(msgspec.json.encode(load_config("levy-klein")))
    assert (config["noise"], config["filters"]) == (default["noise"], default["filters"])
    assert (config["dvl"]["lever_arm_m"], config["reference"]["ignore"]) == (
        [0.0, 0.0, 0.0],
        False,
    )
    assert run_command_line(command) == 0
    assert "unchanged" in capsys.readouterr().err


def test_a_reference_that_moves_otherwise_is_not_used(good: Dive, tmp_path: Path) -> None:
    log = wandering(good, tmp_path)
    found = find_settings([[log]], Given(load_config()))
    assert found.config.reference.ignore
    assert "found_reference" in {note.code for note in found.notes}
    assert replayed(log, found.config).dive.reference is None


def test_a_reference_that_moves_otherwise_gives_way_to_another(good: Dive, tmp_path: Path) -> None:
    folder = tmp_path / "other"
    folder.mkdir()
    log = tmp_path / "dive.mcap"
    write_dive(log, good)
    both = with_its_reference(log, wandering(good, folder), "/a_wrong")
    found = find_settings([[both]], Given(load_config()))
    assert found.config.reference.topic == "/reference"
    assert not found.config.reference.ignore
    (left_out,) = [note for note in found.notes if note.code == "found_left_out"]
    assert "/a_wrong is not used as reference: " in left_out.text
    assert "while IMU and DVL agree" in left_out.text
    assert replayed(both, found.config).dive.reference is not None


def test_latitudes_in_radians_are_found_by_the_track(good: Dive, tmp_path: Path) -> None:
    found = find_settings([[tables_with(good, 1.0, tmp_path)]], Given(load_config()))
    assert found.config.reference.angle_unit == "rad"
    assert "the reference's angles are in radians" in " ".join(note.text for note in found.notes)


@pytest.mark.nightly
def test_latitudes_in_degrees_stay(good: Dive, tmp_path: Path) -> None:
    folder = tables_with(good, np.rad2deg(1.0), tmp_path)
    found = find_settings([[folder]], Given(load_config()))
    assert found.config.reference.angle_unit != "rad"


def tables_with(dive: Dive, angle_size: float, folder: Path) -> Path:
    """Write a dive as tables whose titles say nothing of the unit of positions, each radian as so many of it."""
    reference = dive.reference
    velocity = dive.dvl.velocity_d
    assert reference is not None
    assert velocity is not None
    readings = {
        "imu": (dive.imu.time_ns, [dive.imu.specific_force_b, dive.imu.angular_rate_b]),
        "dvl": (dive.dvl.time_ns, [velocity]),
        "gps": (reference.time_ns, [angle_size * reference.position[:, :2]]),
    }
    titles = {"imu": "time,ax,ay,az,gx,gy,gz", "dvl": "time,vx,vy,vz", "gps": "time,lat,lon"}
    target = folder / f"tables_{angle_size:.0f}"
    target.mkdir()
    for name, (time_ns, columns) in readings.items():
        rows = np.column_stack([(time_ns - dive.imu.time_ns[0]) * 1e-9, *columns])
        np.savetxt(target / f"{name}.csv", rows, "%.10f", ",", header=titles[name], comments="")
    return target


def with_its_reference(log: Path, other: Path, topic: str) -> Path:
    """Add the reference of another log to a log, in front of its own."""
    stream = BytesIO()
    writer = Writer(stream)
    writer.start(profile="ros2")
    for path, is_other in ((other, True), (log, False)):
        ids: dict[str, int] = {}
        for schema, channel, message in make_reader(BytesIO(path.read_bytes())).iter_messages():
            assert schema
            if is_other and channel.topic != "/reference":
                continue
            if channel.topic not in ids:
                name = topic if is_other else channel.topic
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.topic] = writer.register_channel(name, "cdr", schema_id)
            writer.add_message(
                ids[channel.topic], message.log_time, message.data, message.publish_time
            )
    writer.finish()
    target = log.with_name("both.mcap")
    target.write_bytes(stream.getvalue())
    return target


def test_defaults_are_used_with_a_warning_where_nothing_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "static.mcap"
    write_dive(log, replace(simulate_dive("static", duration_s=60.0), truth=None))
    assert run_command_line(["run", str(log), "-o", str(tmp_path / "out"), "--starts", "1"]) == 0
    said = capsys.readouterr().err
    assert "assumed: no settings were found: " in said
    assert "noise fitted to these dives, class fog: " in said


@pytest.mark.nightly
def test_tracks_are_added_with_the_settings_that_were_found(
    good: Dive, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = written(good, "deg/s", tmp_path), tmp_path / "out"
    command = ["run", str(log), "-o", str(out), "--starts", "1", "--set", "dvl.scale=1.001"]
    assert run_command_line(command) == 0
    report = json.loads((out / "dive" / "report.json").read_text())
    assert report["config"]["dvl"]["scale"] == 1.001
    assert run_command_line(["run", str(log), "-o", str(out), "--starts", "1", "--force"]) == 0
    assert json.loads((out / "dive" / "report.json").read_text())["config"]["dvl"]["scale"] == 1.0
    capsys.readouterr()
    assert (
        run_command_line(["run", str(log), "-o", str(out), "--starts", "1", "--tum", "--force"])
        == 0
    )
    assert "found: IMU" in capsys.readouterr().err
    assert (out / "dive" / "reference.tum").is_file()


@pytest.mark.nightly
def test_a_late_reference_is_found_beside_a_late_dvl(good: Dive, tmp_path: Path) -> None:
    log = tmp_path / "dive.mcap"
    assert good.reference is not None
    late = replace(good.reference, time_ns=good.reference.time_ns + nanoseconds(0.2))
    pings = replace(good.dvl, time_ns=good.dvl.time_ns + nanoseconds(0.12))
    write_dive(log, replace(good, reference=late, dvl=pings))
    found = find_settings([[log]], Given(Config()))
    assert found.config.reference.latency_s == pytest.approx(0.2, abs=0.005)
    assert found.config.dvl.latency_s == pytest.approx(0.12, abs=0.02)
    assert "found_reference_delay" in [note.code for note in found.notes]
    replay = replayed(log, found.config)
    assert "reference_late" not in [note.code for note in replay.notes]
    assert replay.dive.reference_delay is not None
    assert replay.dive.reference_delay.is_checked
    given = load_config(None, [], ["reference.latency_s=0.1"])
    kept = find_settings([[log]], Given(given))
    assert kept.config.reference.latency_s == 0.1
