"""`inspect --propose`: from a log that nobody knows to a replay, by what is written in a file and nothing else."""

import json
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import unknown_logs
from mcap.writer import Writer

from insdvl_replay.calibration.found import Given
from insdvl_replay.calibration.noise import imu_class
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import given_keys, load_config
from insdvl_replay.core.dive_columns import Dive, nanoseconds
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.states import DEG
from insdvl_replay.core.words import Consistency
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.inspection.automatic import SettingsFile, settings_file
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.replay import replay_log
from insdvl_replay.sim.dive import simulate_dive

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"

# Noise that a dive cannot determine is that of the class of its IMU, which is wider than most sensors.
AS_GOOD_AS_SAID = (Consistency.CONSISTENT, Consistency.CONSERVATIVE)


def proposed(log: Path, *overrides: str) -> SettingsFile:
    return settings_file([[log]], Given(load_config(overrides=overrides)))


def loaded(log: Path, folder: Path, *overrides: str) -> Config:
    file = folder / "proposed.toml"
    file.write_text(proposed(log, *overrides).text)
    return load_config(file=file)


def word(report: Path) -> str:
    rows = json.loads(report.read_text())["tables"]["consistency"]
    return next(
        row["verdict"]
        for row in rows
        if (row["filter"], row["measurement"]) == ("baseline", "velocity")
    )


# --- Real logs that nobody has written settings for.


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "typed_in", "mounting_rpy_deg"),
    [
        ("blueye_x3/auto_square.mcap", (), (0.0, 0.0, 0.0)),
        ("ufmil/run_1.mcap", ("--set", "initial.latitude_deg=29.65"), (0.0, 0.0, 90.0)),
    ],
)
def test_two_commands_lead_from_an_unknown_log_to_a_consistent_replay(
    name: str, typed_in: tuple[str, ...], mounting_rpy_deg: tuple[float, ...], tmp_path: Path
) -> None:
    log = real(name)
    file, out = tmp_path / "vehicle.toml", tmp_path / "out"
    assert run_command_line(["inspect", str(log), "--propose", str(file), *typed_in]) == 0
    assert load_config(file=file).dvl.mounting_rpy_deg == pytest.approx(mounting_rpy_deg, abs=3.0)
    assert run_command_line(["run", str(log), "-c", str(file), "-o", str(out)]) == 0
    assert word(out / log.stem / "report.json") in AS_GOOD_AS_SAID


def real(name: str) -> Path:
    if not (DATA / name).is_file():
        pytest.skip(f"needs ../shared/data/{name} (a real log)")
    return DATA / name


@pytest.mark.nightly
def test_unit_and_scale_of_an_imu_that_is_wrong_are_found_and_another_one_is_preferred(
    tmp_path: Path,
) -> None:
    """Its gyros show 1 / 1.6645 of the truth, and its accelerometers m/s^2 where the type says g."""
    log = real("blueye_x3/grid_gyro_scale_wrong.mcap")
    assert loaded(log, tmp_path).imu.topic != "blueye.protocol.Imu2Tel"
    imu = loaded(log, tmp_path, "imu.topic=blueye.protocol.Imu2Tel").imu
    assert imu.specific_force_unit == "m/s2"
    assert imu.angular_rate_scale == pytest.approx(1.0 / 1.6645, abs=0.02)


# --- Simulated ones, of which the truth is known.


@pytest.mark.nightly
@pytest.mark.parametrize(
    "put_in", [(), ("--lever-arm", "0.3,-0.1,0.2", "--mounting", "0,0,1.5", "--dvl-delay", "0.12")]
)
@pytest.mark.parametrize("grade", ["fog", "tactical", "mems"])
@pytest.mark.parametrize("seed", ["1", "2"])
def test_two_commands_lead_to_a_consistent_replay_whatever_the_sensors(
    seed: str, grade: str, put_in: tuple[str, ...], tmp_path: Path
) -> None:
    log, file, out = (tmp_path / name for name in ("dive.mcap", "vehicle.toml", "out"))
    assert (
        run_command_line(
            ["simulate", "calibration", "--imu", grade, "--seed", seed, "-o", str(log), *put_in]
        )
        == 0
    )
    assert run_command_line(["inspect", str(log), "--propose", str(file)]) == 0
    assert (
        run_command_line(["run", str(log), "-c", str(file), "-o", str(out), "--starts", "1"]) == 0
    )
    assert word(out / "dive" / "report.json") in AS_GOOD_AS_SAID


@pytest.mark.nightly
def test_an_arm_and_a_delay_that_nobody_knows_are_not_taken_for_a_turned_dvl(
    tmp_path: Path,
) -> None:
    """On the figure-eight a DVL that is rolled by 90 deg left less of the innovations, with no arm and no delay."""
    log = tmp_path / "dive.mcap"
    put_in = ["--lever-arm", "0.3,-0.1,0.2", "--dvl-delay", "0.12"]
    assert run_command_line(["simulate", "figure-eight", "-o", str(log), *put_in]) == 0
    assert loaded(log, tmp_path).dvl.mounting_rpy_deg == pytest.approx((0.0, 0.0, 0.0), abs=1.0)


@pytest.fixture(scope="module")
def turning() -> Dive:
    return unknown_logs.plain_dive("figure-eight", imu_rate_hz=50.0)


def first_minute(dive: Dive) -> Dive:
    first_ns = dive.imu.time_ns[0]
    last_ns = first_ns + nanoseconds(60.0)
    return replace(
        dive, imu=dive.imu.within(first_ns, last_ns), dvl=dive.dvl.within(first_ns, last_ns)
    )


def turned_dvl(dive: Dive, rpy_deg: tuple[float, float, float]) -> Dive:
    """Build the DVL in turned: what it measures in its own axes changes, and nothing else."""
    assert dive.dvl.velocity_d is not None
    velocity_d = dive.dvl.velocity_d @ mat_from_rpy(np.array(rpy_deg) * DEG)
    return replace(dive, dvl=replace(dive.dvl, velocity_d=velocity_d))


@pytest.mark.parametrize(
    "rpy_deg",
    [
        (0.0, 0.0, 90.0),
        *(
            pytest.param(one, marks=pytest.mark.nightly)
            for one in ((0.0, 0.0, -90.0), (180.0, 0.0, 90.0), (0.0, 0.0, 0.0))
        ),
    ],
)
def test_mounting_is_reported_by_the_innovations(
    rpy_deg: tuple[float, float, float], turning: Dive, tmp_path: Path
) -> None:
    log = tmp_path / "log.mcap"
    write_dive(log, replace(turned_dvl(turning, rpy_deg), reference=None))
    given = ("initial.source=level", "initial.latitude_deg=32.8")
    file = tmp_path / "proposed.toml"
    file.write_text(proposed(log, *given).text)
    config = load_config(file=file)
    # This vehicle never slips sideways: a DVL on its back measures the same, and the file says so.
    is_named = f"[{', '.join(f'{angle:g}' for angle in rpy_deg)}]" in file.read_text()
    assert is_named or config.dvl.mounting_rpy_deg == pytest.approx(rpy_deg, abs=1.0)
    assert rpy_deg[0] or config.dvl.mounting_rpy_deg == pytest.approx(rpy_deg, abs=1.0)
    assert (config.initial.source, config.initial.latitude_deg) == ("level", 32.8)


@pytest.mark.parametrize(
    "write",
    [
        pytest.param(unknown_logs.nested_cdr, marks=pytest.mark.nightly),
        unknown_logs.nameless_json,
        pytest.param(unknown_logs.bare_json, marks=pytest.mark.nightly),
        pytest.param(unknown_logs.protobuf, marks=pytest.mark.nightly),
    ],
)
def test_file_is_readable_even_where_the_log_is_not(
    write: Callable[[Path, Dive], None], turning: Dive, tmp_path: Path
) -> None:
    log = tmp_path / "unknown.mcap"
    write(log, turning)
    found = proposed(log)
    loaded(log, tmp_path)
    told = {
        line.partition(" =")[0].removeprefix("# ")
        for line in found.text.splitlines()
        if " =" in line
    }
    assert {key.partition(".")[2] for key in found.missing} <= told


def test_log_with_nothing_in_it_gives_a_file_that_says_so(tmp_path: Path) -> None:
    log = tmp_path / "empty.mcap"
    with log.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.register_channel('to"pic\n[imu]', "json", 0)
        writer.finish()
    found = proposed(log)
    loaded(log, tmp_path)
    assert found.failure is not None
    assert "# decide: " in found.text


def positions_alone(dive: Dive) -> Dive:
    assert dive.reference is not None
    nothing = {
        name: np.full_like(getattr(dive.reference, name), np.nan)
        for name in ("mat_nb", "velocity_n")
    }
    return replace(dive, reference=replace(dive.reference, **nothing))


@pytest.mark.nightly
def test_heading_at_the_start_is_that_under_which_the_tracks_agree(tmp_path: Path) -> None:
    """A reference of positions alone, and a vehicle that starts neither north nor along an axis."""
    log = tmp_path / "log.mcap"
    dive = simulate_dive("lawnmower", seed=5, grade="fog")
    assert dive.reference is not None
    write_dive(log, positions_alone(dive))
    config = loaded(log, tmp_path)
    assert config.initial.heading_deg == "fit"
    start = dive.reference.mat_nb[0]
    truth_deg = np.rad2deg(np.arctan2(start[1, 0], start[0, 0]))
    mat_nb = replay_log(log, config).histories[0].mat_nb[0]
    found_deg = np.rad2deg(np.arctan2(mat_nb[1, 0], mat_nb[0, 0]))
    assert abs((found_deg - truth_deg + 180.0) % 360.0 - 180.0) < 1.0


@pytest.mark.nightly
def test_dives_share_their_mounting_and_not_their_heading(turning: Dive, tmp_path: Path) -> None:
    logs = [tmp_path / f"{number}.mcap" for number in (1, 2)]
    for log in logs:
        write_dive(log, positions_alone(turned_dvl(turning, (0.0, 0.0, -90.0))))
    found = settings_file([[log] for log in logs], Given(load_config()))
    file = tmp_path / "vehicle.toml"
    file.write_text(found.text)
    config = load_config(file=file)
    assert config.dvl.mounting_rpy_deg == pytest.approx((0.0, 0.0, -90.0), abs=1.0)
    assert config.initial.heading_deg == "fit"
    assert found.missing == ()
    assert {"found_heading", "found_dives"} <= {note.code for note in found.notes}


@pytest.mark.parametrize("grade", ["fog", "tactical", "mems"])
def test_class_of_the_sensors_is_that_of_their_noise(grade: str) -> None:
    assert imu_class(simulate_dive("lawnmower", seed=2, grade=grade, duration_s=60.0).imu) == grade


def test_readings_that_never_change_are_of_no_class(turning: Dive) -> None:
    assert (
        imu_class(replace(turning.imu, angular_rate_b=np.zeros_like(turning.imu.angular_rate_b)))
        == "mems"
    )


def test_what_was_given_stays(turning: Dive, tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    write_dive(log, turning)
    geometry = [
        "dvl.lever_arm_m=[1.0, 0.0, 0.5]",
        "dvl.mounting_rpy_deg=[0, 0, 2.0]",
        "dvl.latency_s=0.05",
    ]
    turn_rate = ['topics.turning.topic="/imu"', 'topics.turning.values="angular_velocity.z"']
    given = load_config("tactical", overrides=[*geometry, *turn_rate])
    file = tmp_path / "proposed.toml"
    file.write_text(settings_file([[log]], Given(given)).text)
    found = load_config(file=file)
    assert (found.noise, found.filters, found.topics) == (given.noise, given.filters, given.topics)
    assert (found.dvl.lever_arm_m, found.dvl.mounting_rpy_deg) == (
        (1.0, 0.0, 0.5),
        (0.0, 0.0, 2.0),
    )


def test_what_was_given_stays_where_no_settings_are_found(tmp_path: Path) -> None:
    log, file = tmp_path / "log.mcap", tmp_path / "proposed.toml"
    write_dive(log, replace(simulate_dive("static", duration_s=60.0), truth=None))
    turn_rate = ['topics.turning.topic="/imu"', 'topics.turning.values="angular_velocity.z"']
    given = load_config(
        "mems", overrides=["dvl.latency_s=0.05", "filters.aided.velocity_sd_mps=0.01", *turn_rate]
    )
    proposed = settings_file([[log]], Given(given))
    assert proposed.failure is not None
    file.write_text(proposed.text)
    found = load_config(file=file)
    assert (found.noise, found.dvl, found.filters) == (given.noise, given.dvl, given.filters)
    assert found.topics == given.topics


# --- As a command.


def test_file_is_not_replaced_unasked_and_the_screen_stays_as_it_was(
    turning: Dive, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, file = tmp_path / "log.mcap", tmp_path / "vehicle.toml"
    write_dive(log, first_minute(turning))
    assert run_command_line(["inspect", str(log), "--deep", "--format", "json"]) == 0
    deep = capsys.readouterr().out
    assert run_command_line(["inspect", str(log), "--format", "json", "--propose", str(file)]) == 0
    written = capsys.readouterr()
    assert written.out == deep
    assert f"wrote {file}" in written.err
    assert "found: IMU" in written.err
    assert tomllib.loads(file.read_text())["noise"]
    file.write_text("mine")
    assert run_command_line(["inspect", str(log), "--propose", str(file)]) == 2
    assert file.read_text() == "mine"
    assert run_command_line(["inspect", str(log), "--propose", str(file), "--force"]) == 0
    assert file.read_text() != "mine"


def test_file_that_could_not_be_read_back_is_not_put_in_place(
    turning: Dive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, file = tmp_path / "log.mcap", tmp_path / "vehicle.toml"
    write_dive(log, turning)
    broken = SettingsFile("[dvl]\nscale = -1.0\n", ())
    monkeypatch.setattr(
        "insdvl_replay.inspection.automatic.settings_file", lambda *_, **__: broken
    )
    with pytest.raises(ConfigError):
        load_config(overrides=["dvl.scale=-1.0"])
    assert run_command_line(["inspect", str(log), "--propose", str(file)]) == 2
    assert list(tmp_path.iterdir()) == [log]


def test_the_start_of_a_dive_without_settings_is_not_given() -> None:
    assert Given(load_config()).keys == []
    assert Given(load_config("levy-klein")).has("noise.gyro_white_rad_rts", "initial.uncertainty")
    as_set = ["initial.uncertainty=settings"]
    assert Given(load_config(overrides=as_set), given_keys(None, (), as_set)).keys == [
        "initial.uncertainty"
    ]
