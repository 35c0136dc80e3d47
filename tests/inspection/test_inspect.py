"""`inspect`: what it says of real logs, of damaged ones, and of topics that nobody has told the tool about."""

import json
import re
import time
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer as RawWriter
from mcap_ros2.writer import Writer
from rich.console import Console
from unknown_logs import decided

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, DvlColumns, ImuColumns
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.core.report import as_json
from insdvl_replay.core.states import DEG
from insdvl_replay.document.render import document
from insdvl_replay.document.text import for_terminal
from insdvl_replay.inspection.inventory import Inventory, inspection_result
from insdvl_replay.inspection.probed_topics import vector_paths
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.preparation.replay import replay_log
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import SensorErrors

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
BLUEYE = "blueye.protocol."
UNUSED = "sensors_unused"
IMU2 = f"imu.topic={BLUEYE}Imu2Tel"


def inspected(name: str, *overrides: str, deep: bool = False) -> Inventory:
    path = DATA / name
    if not path.is_file():
        pytest.skip(f"needs ../shared/data/{name} (a real log)")
    return inspect_log(path, load_config(overrides=overrides), deep=deep)


def roles(inventory: Inventory) -> dict[str, str | None]:
    return {role.role: role.topic for role in inventory.roles}


def blockers(inventory: Inventory) -> str:
    return "\n".join(f"{blocker.message} | {blocker.hint}" for blocker in inventory.blockers)


def warnings(inventory: Inventory) -> str:
    return "\n".join(
        f"{note.text} | {note.hint}" for note in inventory.notes if note.severity == "warning"
    )


# --- Real logs, as the README of the data describes them.


@pytest.mark.parametrize(
    ("name", "expected", "rates_hz"),
    [
        (
            "snapir/snapir_01.mcap",
            {"imu": "/imu", "dvl": "/dvl/velocity", "reference": "/ins/odometry, /ins/fix"},
            {"/imu": 100.0, "/dvl/velocity": 1.0, "/ins/odometry": 1.0, "/ins/fix": 1.0},
        ),
        (
            "blueye_x3/auto_square.mcap",
            {
                "imu": None,
                "dvl": f"{BLUEYE}DvlVelocityTel",
                "reference": f"{BLUEYE}PositionEstimateTel",
            },
            {f"{BLUEYE}Imu1Tel": 89.0, f"{BLUEYE}Imu2Tel": 45.0, f"{BLUEYE}DvlVelocityTel": 23.0},
        ),
        (
            "blueye_x3/car_left_back_json.mcap",
            {"imu": None, "dvl": None, "reference": None},
            {"imu": 85.0, "dvl": 85.0},
        ),
        (
            "ufmil/run_1.mcap",
            {"imu": "/imu/data", "dvl": None, "reference": "/dvl/odom"},
            {"/imu/data": 20.0, "/dvl/odom": 9.0, "/depth/pose": 16.0},
        ),
        (
            "stanford_auv/x_1.mcap",
            {"imu": "/imu", "dvl": "/dvl", "reference": "/odometry/filtered"},
            {"/imu": 100.0},
        ),
        (
            "cougars/so_lastbag.mcap",
            {"imu": "/coug2/modem_imu", "dvl": "/coug2/dvl/data", "reference": None},
            {"/coug2/modem_imu": 10.0, "/coug2/dvl/data": 5.5},
        ),
        ("misc/evo_nav2_turtlebot.mcap", {"imu": None, "dvl": None, "reference": "/odom"}, {}),
    ],
)
def test_roles_and_rates_of_real_logs(
    name: str, expected: dict[str, str | None], rates_hz: dict[str, float]
) -> None:
    inventory = inspected(name)
    assert roles(inventory) == expected
    found = {topic.topic: topic.rate_hz for topic in inventory.topics}
    for topic, rate_hz in rates_hz.items():
        assert found[topic] == pytest.approx(rate_hz, rel=0.04)


@pytest.mark.parametrize("number", ["01", "02", "05", "07", "08", "09", "11", "12"])
def test_good_dives_are_reported_to_be_good(number: str) -> None:
    for deep in (False, True):
        inventory = inspected(f"snapir/snapir_{number}.mcap", deep=deep)
        assert blockers(inventory) == ""
        # The positions of two do not go as far as their velocity says.
        assert ("reference_scale" in {note.code for note in inventory.notes}) == (
            number in ("11", "12")
        )
        assert warnings(inventory).count(" | ") == (number in ("11", "12"))
        assert inventory.configuration == ""


def test_reference_coverage_and_velocities_without_beams() -> None:
    inventory = inspected("snapir/snapir_01.mcap", deep=True)
    assert inventory.reference is not None
    assert inventory.pings is not None
    shares_pct = [
        inventory.reference.position_pct,
        inventory.reference.velocity_pct,
        inventory.reference.attitude_pct,
    ]
    assert shares_pct == pytest.approx([99.5, 99.5, 99.5], abs=0.5)
    assert (inventory.pings.pings, inventory.pings.four_or_more, inventory.pings.fewer) == (
        400,
        0,
        0,
    )


def test_three_imus_are_named_with_the_key_to_set() -> None:
    inventory = inspected("blueye_x3/auto_square.mcap")
    for name in ("Imu1Tel", "Imu2Tel", "CalibratedImuTel"):
        assert f'imu.topic = "{BLUEYE}{name}"' in blockers(inventory)
        assert f'"{BLUEYE}{name}"' in inventory.configuration
    assert inventory.conventions[f"{BLUEYE}Imu1Tel"]["specific_force_axes"] == "-x-y-z"
    assert re.search(rf"{BLUEYE}CalibratedImuTel: .* 5\.3", warnings(inventory))
    assert "imu.topic" in inspected("blueye_x3/auto_square.mcap", IMU2).roles[0].reason


def test_sign_of_a_turned_accelerometer() -> None:
    turned = [f"imu.topic={BLUEYE}Imu1Tel", "imu.specific_force_axes=frd"]
    inventory = inspected("blueye_x3/auto_square.mcap", *turned)
    assert re.search(r"along down .*\+9\.6", warnings(inventory))
    assert 'imu.specific_force_axes = "-x-y-z"' in warnings(inventory)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("auto_square", marks=pytest.mark.nightly),
        "gnss_challenging",
        "grid_gyro_scale_wrong",
    ],
)
def test_repeats_of_a_dvl_that_is_published_faster_than_it_pings(name: str) -> None:
    pings = inspected(f"blueye_x3/{name}.mcap", IMU2, deep=True).pings
    assert pings is not None
    assert 0.70 < pings.repeats / pings.messages < 0.83
    assert pings.rate_hz == pytest.approx(5.0, abs=0.7)
    assert (
        pings.four_or_more + pings.three + pings.fewer
        == pings.pings
        == pings.messages - pings.repeats
    )


def test_wrong_unit_of_an_accelerometer_stops_a_replay_and_the_hint_settles_it() -> None:
    found = blockers(inspected("blueye_x3/grid_gyro_scale_wrong.mcap", IMU2))
    assert re.search(r"specific force .* 95\.", found)
    assert 'imu.specific_force_unit = "m/s2"' in found
    settled = [IMU2, "imu.specific_force_unit=m/s2", "initial.heading_deg=36"]
    inventory = inspected("blueye_x3/grid_gyro_scale_wrong.mcap", *settled, deep=True)
    assert blockers(inventory) == ""
    # The true factor is 1.6645: the gyros show 0.6 of the turning.
    assert re.search(r"angular rate .* 0\.(59|60|61)", warnings(inventory))
    assert "imu.angular_rate_scale = 0." in warnings(inventory)


def test_first_messages_give_no_scale_to_copy() -> None:
    settings = [IMU2, "imu.specific_force_unit=m/s2"]
    found = warnings(inspected("blueye_x3/grid_gyro_scale_wrong.mcap", *settings))
    assert re.search(r"angular rate .* 0\.5", found)
    assert "`inspect --deep`" in found
    assert "angular_rate_scale" not in found


@pytest.mark.parametrize("deep", [False, True])
def test_clocks_of_topics_without_a_role_tell_how_much_was_read(deep: bool) -> None:
    inventory = inspected("cougars/so_lastbag.mcap", deep=deep)
    rates_hz = {topic.topic: topic.rate_hz for topic in inventory.topics}
    others = [
        clock
        for clock in inventory.clocks
        if not clock.role and clock.rate_hz and clock.messages > 200
    ]
    assert "/coug2/leak/data" in [clock.topic for clock in others]
    for clock in others:
        assert clock.rate_hz == pytest.approx(rates_hz[clock.topic], rel=0.3), clock.topic
    (leak,) = [line for line in shown(inventory, 100) if line.startswith("/coug2/leak/data")][1:]
    assert " 493 " in leak, "not all of its 2494 messages were read"


def test_imu_that_is_too_slow_and_clocks_that_are_days_apart() -> None:
    inventory = inspected("cougars/so_lastbag.mcap")
    found = blockers(inventory)
    assert re.search(r"IMU .*\b10\.0 ", found)
    assert re.search(r"/coug2/odom .*/coug2/gps_odom .*reference\.topic", found)
    assert 'imu.stamp = "log_time"' in found
    clocks = {clock.topic: clock for clock in inventory.clocks}
    assert clocks["/coug2/dvl/data"].log_minus_stamp_s / 86400.0 == pytest.approx(5.96, abs=0.005)


def test_sensors_are_stamped_as_the_other_roles_are() -> None:
    """What was proposed is no news, and what a filter asks beside it is."""
    stamped = [
        "imu.stamp=log_time",
        "dvl.stamp=log_time",
        "reference.stamp=log_time",
        "initial.latitude_deg=37.4",
    ]
    settings = ['filters.with_sensors.aiding=["velocity","heading"]']
    found = inspected("stanford_auv/x_1.mcap", *stamped, *settings)
    assert re.search(r": imu .*heading .*/imu .*clocks", blockers(found))
    proposed = msgspec.toml.decode(found.configuration)
    assert {section: of["stamp"] for section, of in proposed.items() if "stamp" in of} == {
        "heading": "log_time"
    }
    assert not found.remaining


def test_three_clocks_in_one_file() -> None:
    inventory = inspected("stanford_auv/x_1.mcap")
    clocks = {clock.topic: clock for clock in inventory.clocks}
    assert clocks["/imu"].log_minus_stamp_s > 1.7e9, "stamped by the time since power-up"
    assert clocks["/dvl"].log_minus_stamp_s == pytest.approx(0.0, abs=0.1)
    assert any(
        re.search(r"/depth: .*'header' .*0\.000000000 s", note.text) for note in inventory.notes
    )
    assert re.search(r"/imu .*/dvl .*clocks", blockers(inventory))


def test_vehicle_that_is_still_contradicts_nobody() -> None:
    still, turning = (
        inspected(f"stanford_auv/{name}.mcap").notes for name in ("static", "rotation_z_1")
    )
    assert not [note for note in still if note.code.endswith("_contradiction")]
    assert "imu_turned" in {note.code for note in turning}, (
        "its gyros follow the reference with the IMU upside down"
    )


def test_log_without_messages() -> None:
    inventory = inspected("blueye_x3/no_messages.mcap", deep=True)
    assert inventory.log.messages == 0
    assert len(inventory.topics) == 5
    assert all(f"has no {role}" in blockers(inventory) for role in ("IMU", "DVL"))
    assert inventory.log.start_utc is None


@pytest.mark.parametrize(
    "name",
    [
        "ufmil/run_1", "ufmil/run_2", "stanford_auv/x_1", "stanford_auv/rotation_z_1", "stanford_auv/static",
        pytest.param("blueye_x3/car_left_back_json", marks=pytest.mark.nightly), "blueye_x3/auto_square",
        "blueye_x3/grid_gyro_scale_wrong",
    ],
)  # fmt: skip
def test_proposal_is_a_file_that_replays_a_real_log_once_the_start_is_known(
    name: str, tmp_path: Path
) -> None:
    inventory = inspected(f"{name}.mcap")
    assert inventory.remaining == ()
    start = {"initial.heading_deg": "10.0", "initial.latitude_deg": "37.0"}
    file = tmp_path / "vehicle.toml"
    file.write_text(
        decided(inventory, {key: start[key] for key in start.keys() & set(inventory.decisions)})
    )
    assert blockers(inspect_log(DATA / f"{name}.mcap", load_config(file=file), deep=True)) == ""


@pytest.mark.parametrize(
    "name", ["stanford_auv/static.mcap", "cougars/so_lastbag.mcap", "ufmil/run_2.mcap"]
)
def test_the_hints_lead_step_by_step_to_a_replay(name: str, tmp_path: Path) -> None:
    """Do what the obstacles and the proposal say, and nothing else, until nothing is left."""
    overrides: dict[str, str] = {}
    file = tmp_path / "vehicle.toml"
    for _ in range(6):
        config = load_config(
            file=file if file.is_file() else None, overrides=[*overrides.values()]
        )
        inventory = (
            inspect_log(DATA / name, config) if (DATA / name).is_file() else inspected(name)
        )
        if not inventory.blockers:
            break
        if inventory.configuration:
            file.write_text(
                (file.read_text() if file.is_file() else "")
                + merged(file, inventory.configuration)
            )
        for blocker in inventory.blockers:
            overrides |= settings_in(blocker.hint)
    assert not inventory.blockers, blockers(inventory)


def merged(file: Path, proposal: str) -> str:
    """Keep the sections that the file does not have yet."""
    have = file.read_text() if file.is_file() else ""
    sections = re.split(r"(?m)^(?=\[)", proposal)
    return "".join(section for section in sections if section.partition("\n")[0] not in have)


def settings_in(hint: str) -> dict[str, str]:
    """Take the settings of a hint; what only a person can know is made up."""
    found = (
        re.findall(r"--set (\S+?)=([^\s;]+)", hint)
        or re.findall(r"([a-z]+\.\w+) = ([\w./\"]+)", hint)[:1]
    )
    unknown = {'"/topic"', '"field.path"'}
    meant = [
        (key, value) for key, value in found if value not in unknown and key != "reference.topic"
    ]
    return {key: f"{key}={'10' if value == '...' else value}" for key, value in meant}


# --- Topics that nobody has seen before.

STRAPDOWN = (
    "std_msgs/Header header\nfloat64 ax\nfloat64 ay\nfloat64 az\n"
    "acme_msgs/Triple turning\nfloat32 temperature\n"
)
STRAPDOWN += f"{'=' * 80}\nMSG: acme_msgs/Triple\nfloat64 x\nfloat64 y\nfloat64 z\n"
SPEED = "float64[3] velocity_over_ground\nfloat64[9] velocity_covariance\nuint8 quality\n"
HEADER = f"{'=' * 80}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
HEADER += f"{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate_dive("straight", seed=3, duration_s=60.0, grade="tactical")


@pytest.fixture(scope="module")
def unknown(dive: Dive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dive in message types of nobody: g, deg/s, forward-port-up, a DVL without header."""
    path = tmp_path_factory.mktemp("unknown") / "acme.mcap"
    imu, velocity_d = dive.imu, velocities(dive)
    with path.open("wb") as stream:
        writer = Writer(stream)
        strapdown = writer.register_msgdef("acme_msgs/msg/Strapdown", STRAPDOWN + HEADER)
        speed = writer.register_msgdef("acme_msgs/msg/Speed", SPEED)
        flu = np.array([1.0, -1.0, -1.0])
        for time_ns, force_b, rate_b in zip(
            imu.time_ns, imu.specific_force_b, imu.angular_rate_b, strict=True
        ):
            stamp = {"sec": int(time_ns) // 10**9, "nanosec": int(time_ns) % 10**9}
            axes = dict(zip("xyz", flu * rate_b / DEG, strict=True))
            force = dict(zip(("ax", "ay", "az"), flu * force_b / 9.80665, strict=True))
            message = {
                "header": {"stamp": stamp, "frame_id": "box"},
                **force,
                "turning": axes,
                "temperature": 11.0,
            }
            writer.write_message(
                "/box/raw", strapdown, message, log_time=int(time_ns), publish_time=int(time_ns)
            )
        for time_ns, velocity in zip(dive.dvl.time_ns, velocity_d, strict=True):
            message = {
                "velocity_over_ground": (flu * velocity).tolist(),
                "velocity_covariance": [0.0] * 9,
                "quality": 9,
            }
            writer.write_message(
                "/box/ground", speed, message, log_time=int(time_ns), publish_time=int(time_ns)
            )
        writer.finish()
    return path


def velocities(dive: Dive) -> np.ndarray:
    beams, vectors = dive.dvl.beam_velocity_mps, dive.dvl.beam_vectors_d
    assert beams is not None
    assert vectors is not None
    return beams @ np.linalg.pinv(vectors).T


def test_unknown_topics_are_replayed_from_what_inspect_proposes(
    unknown: Path, dive: Dive, tmp_path: Path
) -> None:
    inventory = inspect_log(unknown, load_config())
    assert roles(inventory) == {"imu": None, "dvl": None, "reference": None}
    # What a person adds: the unit and the axes that a straight line does not show, and where the dive began.
    start = {"initial.heading_deg": "0.0", "initial.latitude_deg": "32.0"}
    known = {"imu.angular_rate_unit": '"deg/s"', "imu.axes": '"flu"', "dvl.axes": '"flu"'}
    file = tmp_path / "acme.toml"
    file.write_text(decided(inventory, start | known))
    config = load_config(file=file)
    assert (config.imu.specific_force, config.imu.angular_rate) == ("ax, ay, az", "turning")
    assert (config.dvl.velocity, config.dvl.stamp) == ("velocity_over_ground", "log_time")
    read = read_dive(unknown, config)
    np.testing.assert_allclose(
        read.imu.specific_force_b, dive.imu.specific_force_b, rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(
        read.imu.angular_rate_b, dive.imu.angular_rate_b, rtol=0, atol=1e-12
    )
    assert read.dvl.velocity_d is not None
    np.testing.assert_allclose(read.dvl.velocity_d, velocities(dive), rtol=0, atol=1e-12)
    assert not inspect_log(unknown, config, deep=True).blockers


def test_vectors_are_found_by_structure() -> None:
    known = {
        "header": "std_msgs/msg/Header", "header.stamp": "builtin_interfaces/msg/Time", "header.stamp.sec": "int32",
        "force": "V", "force.x": "float64", "force.y": "float64", "force.z": "float64",
        "orientation": "Q", "orientation.x": "float64", "orientation.y": "float64", "orientation.z": "float64",
        "orientation.w": "float64",
        "gx": "float32", "gy": "float32", "gz": "float32", "x": "float64", "y": "float64", "z": "float64",
        "beams": "B", "beams[*]": "B", "beams[*].v": "float64", "beams[*].name": "string", "covariance": "float64",
        "covariance[*]": "float64",
    }  # fmt: skip
    assert vector_paths(known) == ["beams[*].v", "covariance", "force", "gx, gy, gz", "x, y, z"]


# --- The file itself.


@pytest.fixture
def log(dive: Dive, tmp_path: Path) -> Path:
    path = tmp_path / "dive.mcap"
    write_dive(path, dive)
    return path


def test_deep_notes_are_those_of_a_run(log: Path) -> None:
    config = load_config(overrides=["imu.max_gap_s=0.001"])
    assert (
        inspect_log(log, config, deep=True).notes[: len(read_dive(log, config).notes)]
        == read_dive(log, config).notes
    )


def test_damage_is_an_blocker_and_no_reason_to_stop(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = bytearray(log.read_bytes())
    log.write_bytes(data[: len(data) * 2 // 3])
    with pytest.raises(LogError) as refused:
        read_dive(log, load_config())
    assert run_command_line(["inspect", str(log), "--format", "json"]) == 0
    inventory = json.loads(capsys.readouterr().out)
    assert inventory["blockers"][0] == {
        "message": refused.value.message,
        "hint": refused.value.hint,
    }
    assert "log_damaged" in [note["code"] for note in inventory["notes"]]
    assert inventory["log"]["has_summary"] is False
    assert inventory["log"]["messages"] > 0


def test_first_pings_without_a_bottom_are_a_warning_and_no_blocker(
    dive: Dive, tmp_path: Path
) -> None:
    log = tmp_path / "dive.mcap"
    beams = dive.dvl.beam_velocity_mps
    assert beams is not None
    write_dive(
        log, replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=np.full_like(beams, np.nan)))
    )
    sample = inspect_log(log, load_config())
    assert "/dvl: " in warnings(sample)
    assert blockers(sample) == ""
    assert "/dvl: " in blockers(inspect_log(log, load_config(), deep=True))


def test_reference_that_cannot_be_moved_to_the_imu_is_the_blocker_that_it_is_to_a_replay(
    dive: Dive, tmp_path: Path
) -> None:
    log, reference = tmp_path / "dive.mcap", dive.reference
    assert reference is not None
    unturned = replace(reference, mat_nb=np.full_like(reference.mat_nb, np.nan))
    write_dive(log, replace(dive, reference=unturned))
    config = load_config(
        overrides=["initial.heading_deg=30", "reference.lever_arm_m=[1.0, 0.0, 0.0]"]
    )
    with pytest.raises(ConfigError) as refused:
        replay_log(log, config)
    assert "reference.lever_arm_m" in refused.value.message
    assert (
        blockers(inspect_log(log, config, deep=True))
        == f"{refused.value.message} | {refused.value.hint}"
    )


def test_allowed_damage_is_reported_and_is_no_blocker(log: Path) -> None:
    data = log.read_bytes()
    log.write_bytes(data[: len(data) * 2 // 3])
    for deep in (False, True):
        inventory = inspect_log(log, load_config(), deep=deep, allow_damaged=True)
        assert blockers(inventory) == ""
        assert "log_damaged" in [note.code for note in inventory.notes]


def test_several_logs_and_bags_are_one_array_in_json(
    log: Path, dive: Dive, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = log.parent / "bag"
    bag.mkdir()
    write_dive(bag / "part.mcap", dive)
    (bag / "metadata.yaml").write_text(
        "rosbag2_bagfile_information: {relative_file_paths: [part.mcap]}"
    )
    logs = [str(log), str(log.parent / "nowhere.mcap"), str(bag)]
    assert run_command_line(["inspect", *logs, "--format", "json"]) == 3
    captured = capsys.readouterr()
    assert [inventory["log"]["name"] for inventory in json.loads(captured.out)] == [
        "dive.mcap",
        "bag",
    ]
    assert "nowhere.mcap: " in captured.err
    assert run_command_line(["inspect", *logs[::2]]) == 0
    assert re.findall(r"(?m)^(\S+): .* written by", capsys.readouterr().out) == [
        "dive.mcap",
        "bag",
    ]


def test_a_bag_is_one_log(dive: Dive, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    half = len(dive.imu.time_ns) // 2
    for name, rows in (("a", slice(0, half)), ("b", slice(half, None))):
        imu = ImuColumns(*(column[rows] for column in vars(dive.imu).values()))
        write_dive(bag / f"{name}.mcap", replace(dive, imu=imu))
    inventory = inspect_log(bag, load_config())
    (imu_topic,) = [topic for topic in inventory.topics if topic.role == "imu"]
    assert (inventory.log.parts, imu_topic.channels, imu_topic.messages) == (
        2,
        2,
        len(dive.imu.time_ns),
    )


def test_files_are_the_same_dives_as_for_a_run(
    dive: Dive, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "dives"
    folder.mkdir()
    write_dive(folder / "sensors.mcap", replace(dive, reference=None))
    write_dive(folder / "solution.mcap", dive)
    named = {"sensors.mcap": "", "solution.mcap": "/reference"}
    assert run_command_line(["inspect", str(folder), "--format", "json"]) == 0
    inventories = json.loads(capsys.readouterr().out)
    assert {one["log"]["name"]: one["roles"][2]["topic"] or "" for one in inventories} == named
    assert (
        run_command_line(["inspect", str(folder / "*.mcap"), "--one-dive", "--format", "json"])
        == 0
    )
    inventory = json.loads(capsys.readouterr().out)
    assert (inventory["log"]["name"], inventory["log"]["parts"]) == ("sensors.mcap", 2)
    assert inventory["roles"][2]["topic"] == "/reference"


def test_json_is_complete_and_reads_back(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["inspect", str(log), "--deep", "--format", "json"]) == 0
    captured = capsys.readouterr()
    inventory = inspect_log(log, load_config(), deep=True)
    assert msgspec.json.decode(captured.out, type=Inventory) == inventory
    assert as_json(inventory).decode() == captured.out
    assert captured.err == ""


def shown(inventory: Inventory, width: int) -> list[str]:
    console = Console(width=width, highlight=False)
    with console.capture() as capture:
        console.print(for_terminal(document(inspection_result(inventory))), crop=False)
    return capture.get().splitlines()


def test_a_narrow_terminal_leaves_out_columns_and_folds_no_number() -> None:
    sample = Path(__file__).resolve().parents[2] / "sample_logs" / "figure_eight.mcap"
    inventory = inspect_log(sample, load_config(), deep=False)
    wide, narrow = ([line.rstrip() for line in shown(inventory, width)] for width in (80, 40))
    assert max(map(len, narrow)) <= 40
    assert any(re.search(r"^/imu +imu +39401 +100 +0.01 +0 +394$", line) for line in wide)
    assert any(re.search(r"^/imu +imu +39401$", line) for line in narrow)
    assert [line.split()[-1] for line in narrow if re.match("/(imu|dvl) +header", line)] == [
        "100.0",
        "1.000",
    ]


@pytest.mark.parametrize(
    "name", ["blueye_x3/auto_square", "cougars/so_lastbag", "stanford_auv/x_1", "snapir/snapir_01"]
)
def test_tables_fit_a_terminal_and_are_whole_in_a_pipe(name: str) -> None:
    inventory = inspected(f"{name}.mcap")
    assert max(map(len, shown(inventory, 80))) <= 80
    piped = "\n".join(shown(inventory, 1000))
    assert all(
        topic.topic in piped and topic.type_name in piped
        for topic in inventory.topics
        if topic.messages
    )
    assert "…" not in piped


def test_table_is_printed_with_settings_that_can_be_copied(
    unknown: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_line(["inspect", str(unknown)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("acme.mcap cannot be replayed")
    assert inspect_log(unknown, load_config()).configuration.rstrip("\n") in out


@pytest.mark.nightly
def test_two_million_messages_are_surveyed_in_a_second(tmp_path: Path) -> None:
    count = 2_000_000
    time_ns = np.arange(count, dtype=np.int64) * 2_500_000
    force_b = np.random.default_rng(1).normal(0.0, 0.01, (count, 3)) - [0.0, 0.0, 9.81]
    dvl = DvlColumns(time_ns[::80], velocity_d=np.ones((count // 80, 3)))
    write_dive(
        tmp_path / "long.mcap", Dive("long", ImuColumns(time_ns, force_b, force_b * 1e-4), dvl)
    )
    needed_s = []
    for _ in range(3):
        start_s = time.process_time()
        inventory = inspect_log(tmp_path / "long.mcap", load_config())
        needed_s.append(time.process_time() - start_s)
    assert min(needed_s) < 1.0
    assert inventory.log.messages == count + count // 80


# --- What has no answer.


@pytest.mark.parametrize("deep", [False, True])
def test_an_imu_of_zeros_is_reported_and_no_axes_are_proposed(deep: bool, tmp_path: Path) -> None:
    dive = simulate_dive("straight", seed=1, duration_s=20.0)
    none = np.zeros_like(dive.imu.specific_force_b)
    write_dive(
        tmp_path / "dive.mcap",
        replace(dive, imu=replace(dive.imu, specific_force_b=none, angular_rate_b=none)),
    )
    inventory = inspect_log(tmp_path / "dive.mcap", load_config(), deep=deep)
    assert "specific force" in blockers(inventory)
    assert "\naxes =" not in inventory.configuration


@pytest.mark.parametrize("deep", [False, True])
def test_two_topics_of_true_biases_are_an_blocker(deep: bool, tmp_path: Path) -> None:
    dive = simulate_dive("straight", seed=1, duration_s=5.0)
    for name in ("a", "b"):
        write_dive(tmp_path / f"{name}.mcap", dive)
    with (tmp_path / "dive.mcap").open("wb") as file:
        writer = RawWriter(file)
        writer.start(profile="ros2", library="tests")
        for name in ("a", "b"):
            channels: dict[str, int] = {}
            with (tmp_path / f"{name}.mcap").open("rb") as source:
                for schema, channel, message in make_reader(source).iter_messages():
                    assert schema is not None
                    if name == "b" and not channel.topic.startswith("/truth"):
                        continue
                    if channel.topic not in channels:
                        known = writer.register_schema(schema.name, schema.encoding, schema.data)
                        topic = channel.topic + ("/again" if name == "b" else "")
                        channels[channel.topic] = writer.register_channel(topic, "cdr", known)
                    number = channels[channel.topic]
                    writer.add_message(
                        number, message.log_time, message.data, message.publish_time
                    )
        writer.finish()
    inventory = inspect_log(tmp_path / "dive.mcap", load_config(), deep=deep)
    assert re.search(r"/truth/biases .*/truth/biases/again .*truth \| ", blockers(inventory))


# --- Sensors that could aid.


def test_sensors_that_no_filter_asks_for_are_named(tmp_path: Path) -> None:
    sensors = {"depth": SensorErrors(0.05, 4.0), "heading": SensorErrors(1.0)}
    write_dive(tmp_path / "dive.mcap", simulate_dive("straight", duration_s=60.0, sensors=sensors))
    for deep in (False, True):
        (note,) = (
            one
            for one in inspect_log(tmp_path / "dive.mcap", Config(), deep=deep).notes
            if one.code == UNUSED
        )
        assert re.search(r": depth .*/pressure; heading .*/ahrs$", note.text)
        assert 'aiding = ["velocity", "depth", "heading"]' in note.hint
    told = load_config(overrides=['filters.with_sensors.aiding=["velocity", "depth", "heading"]'])
    assert UNUSED not in {one.code for one in inspect_log(tmp_path / "dive.mcap", told).notes}


def test_a_topic_that_plays_a_role_is_no_idle_sensor() -> None:
    """The reference's fixes, and the IMU's own message with its orientation."""
    assert UNUSED not in {note.code for note in inspected("snapir/snapir_01.mcap").notes}
