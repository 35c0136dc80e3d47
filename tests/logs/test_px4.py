"""Logs of PX4 in the published layout replay as the MCAP of the same dive does, and damage is told."""

import struct
from pathlib import Path

import autopilot_logs
import instrument_logs
import numpy as np
import pytest
from autopilot_logs import Ulog, flipped, message
from instrument_logs import Told, told

from insdvl_replay.core.config import Config, Imu, Reference
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.recording import open_recording

VELOCITY_MPS = 2e-7  # of 32 bits
FORCE_MPS2 = 1e-6


def dive() -> Told:
    return told().of_velocities()


def write(folder: Path, log: Ulog) -> list[Path]:
    """Write a log, and the MCAP of the reference."""
    path = folder / "log_7.ulg"
    path.write_bytes(log.content())
    return [path, instrument_logs.write_rest(folder, log.told.dive, imu=False)]


def without_solution(told: Told) -> Ulog:
    log = Ulog(told)
    log.add_samples()
    log.add_velocities()
    log.add_fixes()
    log.add_loads()
    return log


def test_replay_is_that_of_the_mcap(tmp_path: Path) -> None:
    log = without_solution(dive())
    apart_mps, apart_m = instrument_logs.compare(
        write(tmp_path, log), log.told.dive, tmp_path, atol_mps=VELOCITY_MPS, atol_m=1e-5
    )
    assert 0.0 < apart_mps < VELOCITY_MPS
    assert apart_m < 1e-5


def test_increments_count_where_they_are_more_often(tmp_path: Path) -> None:
    log = Ulog(dive())
    log.add_increments()
    log.add_velocities()
    log.add_fixes()
    paths = write(tmp_path, log)
    found = read_dive(paths, Config())
    imu = log.told.dive.imu
    np.testing.assert_array_equal(found.imu.time_ns, imu.time_ns)
    np.testing.assert_allclose(
        found.imu.specific_force_b, imu.specific_force_b, rtol=0, atol=FORCE_MPS2
    )
    other = read_dive(paths, Config(imu=Imu(topic="vehicle_imu/1")))
    force = 0.5 * imu.specific_force_b
    np.testing.assert_allclose(other.imu.specific_force_b, force, rtol=0, atol=FORCE_MPS2)


def test_seldom_increments_do_not_count(tmp_path: Path) -> None:
    log = without_solution(dive())
    types = {
        channel.topic: channel.type_name
        for channel in open_recording(write(tmp_path, log)[0]).channels
    }
    assert types["sensor_combined"] == "px4_msgs/msg/SensorCombined"
    assert types["vehicle_imu/0"] == "px4.vehicle_imu_other"


def test_filter_of_the_vehicle_and_its_receiver_are_the_reference(tmp_path: Path) -> None:
    log = Ulog(dive())
    log.whole()
    found = read_dive(write(tmp_path, log)[0], Config()).reference
    assert found is not None
    truth = log.truth
    np.testing.assert_array_equal(found.time_ns, truth.time_ns)
    np.testing.assert_allclose(
        found.position[:, :2], np.radians(truth.position[:, :2]), rtol=0, atol=1e-12
    )
    velocity_n = 1.01 * truth.velocity_n
    np.testing.assert_allclose(found.velocity_n, velocity_n, rtol=0, atol=VELOCITY_MPS)
    assert log.told.dive.reference is not None
    np.testing.assert_allclose(found.mat_nb, log.told.dive.reference.mat_nb, rtol=0, atol=1e-6)


def test_velocities_in_another_frame_are_left_out(tmp_path: Path) -> None:
    log = Ulog(dive())
    log.add_samples()
    log.add_velocities(frame=1)
    log.add_fixes()
    with pytest.raises(LogError, match="pings are in other coordinates"):
        read_dive(write(tmp_path, log), Config())


def test_older_fixes_are_whole_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fields = (
        "uint64_t timestamp;uint64_t time_utc_usec;int32_t lat;int32_t lon;int32_t alt;int32_t alt_ellipsoid;"
        "uint8_t fix_type;uint8_t[7] _padding0;"
    )
    monkeypatch.setitem(autopilot_logs.LAYOUTS, "vehicle_gps_position", (fields, "<QQiiiiB"))
    log = Ulog(dive())
    log.add_samples()
    log.add_velocities()
    for time_ns, place in zip(log.truth.time_ns.tolist(), log.truth.position, strict=True):
        latitude, longitude = np.rint(place[:2] * 1e7).astype(int).tolist()
        height_mm = round(1000 * place[2])
        values = [time_ns // 1000, latitude, longitude, 0, height_mm, 3]
        log.add(time_ns, "vehicle_gps_position", *values)
    found = read_dive(write(tmp_path, log)[0], Config()).reference
    assert found is not None
    np.testing.assert_array_equal(found.time_ns, log.truth.time_ns)
    degrees = np.degrees(found.position[:, :2])
    np.testing.assert_allclose(degrees, log.truth.position[:, :2], rtol=0, atol=6e-8)
    np.testing.assert_allclose(found.position[:, 2], log.truth.position[:, 2], rtol=0, atol=6e-4)


def test_older_solutions_have_single_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fields = (
        "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;float[4] q;"
        "float vx;float vy;float vz;uint8_t local_frame;uint8_t velocity_frame;uint8_t[6] _padding0;"
    )
    monkeypatch.setitem(autopilot_logs.LAYOUTS, "vehicle_odometry", (fields, "<QQ3f4f3fBB"))
    log = without_solution(dive())
    truth = log.truth
    for time_ns, moved, velocity, rpy in zip(
        truth.time_ns.tolist(), truth.moved_n, truth.velocity_n, truth.rpy_deg, strict=True
    ):
        quaternion = autopilot_logs.quaternion_of(np.radians(rpy))
        values = [*moved, *quaternion, *velocity]
        log.add(time_ns, "vehicle_odometry", log.us(time_ns), *values, 1, 1)
    found = read_dive(write(tmp_path, log)[0], Config()).reference
    assert found is not None
    np.testing.assert_array_equal(found.time_ns, truth.time_ns)
    np.testing.assert_allclose(found.velocity_n, truth.velocity_n, rtol=0, atol=VELOCITY_MPS)


def test_what_the_recorder_dropped_is_noted(tmp_path: Path) -> None:
    log = without_solution(dive())
    for ping in (3, 40):
        log.add_raw(int(log.told.time_ns[ping]), message("O", struct.pack("<H", 62)))
    (note,) = [
        note
        for note in open_recording(write(tmp_path, log)[0]).notes
        if note.code == "recorder_dropouts"
    ]
    assert note.count == 2
    assert "0.124 s" in note.text


def test_appended_data_begin_behind_a_message_that_is_cut(tmp_path: Path) -> None:
    log = without_solution(dive())
    content = log.content()
    place = len(content) - 5
    head = 16 + 3
    appended = content[:head] + bytes(8) + b"\x01" + bytes(7) + struct.pack("<3Q", place, 0, 0)
    appended += content[len(appended) : place] + message("M", b"\x00\x0achar[3] hfabc")
    path = write(tmp_path, log)[0]
    path.write_bytes(appended)
    opened = open_recording(path)
    (note,) = [note for note in opened.notes if note.code == "log_damaged"]
    assert note.count == 1


def test_a_cut_log_is_read_up_to_the_cut(tmp_path: Path) -> None:
    log = without_solution(dive())
    content = log.content()
    paths = write(tmp_path, log)
    paths[0].write_bytes(content[: 2 * len(content) // 3])
    found = read_dive(paths, Config())
    assert [note.count for note in found.notes if note.code == "log_damaged"] == [1]
    assert len(found.dvl.time_ns) == pytest.approx(2 * len(log.told.time_ns) / 3, abs=9)


def test_garbage_and_turned_bits_lose_the_messages_around_them(tmp_path: Path) -> None:
    log = without_solution(dive())
    content = log.content()
    paths = write(tmp_path, log)
    whole = read_dive(paths, Config())
    begin = len(log.definitions())
    heads = []
    place = begin
    while place < len(content):
        heads.append(place)
        place += 3 + struct.unpack_from("<H", content, place)[0]
    middle = heads[len(heads) // 2] + 7
    garbage = np.random.default_rng(3).integers(0, 256, 700, np.uint8).tobytes()
    turned = flipped(content, np.array(heads[300:1500:300]))
    paths[0].write_bytes(turned[:middle] + garbage + turned[middle:])
    found = read_dive(paths, Config())
    (note,) = [note for note in found.notes if note.code == "log_damaged"]
    assert f"byte {heads[300]}:" in note.text
    assert len(whole.imu.time_ns) - len(found.imu.time_ns) < 20
    same = np.isin(whole.imu.time_ns, found.imu.time_ns)
    assert np.count_nonzero(same) >= len(found.imu.time_ns) - 1


def test_more_than_few_damaged_messages_are_refused(tmp_path: Path) -> None:
    log = without_solution(dive())
    content = log.content()
    paths = write(tmp_path, log)
    rng = np.random.default_rng(3)
    paths[0].write_bytes(
        flipped(content, rng.integers(len(log.definitions()), len(content), 9000))
    )
    with pytest.raises(LogError, match=r"messages are damaged, the first at byte \d+: \d+ bytes"):
        read_dive(paths, Config(reference=Reference(ignore=True)))


@pytest.mark.parametrize(
    "fields",
    ["", "float", "float[99999] x;float[99999] y;", "loop x;", "what x;", "float x;float x;"],
)
def test_a_layout_that_cannot_be_is_of_no_known_topic(fields: str, tmp_path: Path) -> None:
    log = without_solution(dive())
    content = log.content()
    begin = 16 + 3 + 40
    definitions = message("F", b"loop:loop a;loop b;") + message(
        "F", f"sensor_baro:{fields}".encode()
    )
    subscription = message("A", struct.pack("<BH", 0, 77) + b"sensor_baro")
    rest = content[begin:] + message("D", struct.pack("<H", 77) + bytes(20))
    path = write(tmp_path, log)[0]
    path.write_bytes(content[:begin] + definitions + subscription + rest)
    opened = open_recording(path)
    assert {note.code for note in opened.notes} == {"other_records"}
    assert any("sensor_baro (1)" in note.text for note in opened.notes)


@pytest.mark.parametrize(
    ("name", "fields", "size", "can_be_used"),
    [
        ("sensor_combined", "float[2] timestamp;float[3] gyro_rad;", 20, False),
        ("sensor_combined", "part timestamp;float[3] gyro_rad;", 20, False),
        ("sensor_combined", "int64_t timestamp;float[3] gyro_rad;", 20, False),
        ("vehicle_imu", "uint64_t timestamp;uint64_t[2] timestamp_sample;float x;", 28, True),
        ("vehicle_imu", "uint64_t timestamp;part timestamp_sample;float x;", 20, True),
        ("sensor_gps", "uint64_t timestamp;uint64_t time_utc_usec;uint8_t[2] fix_type;", 18, True),
        ("vehicle_odometry", "uint64_t timestamp;float x;float[2] y;float z;", 24, True),
    ],
)
def test_layouts_of_other_shapes(
    name: str, fields: str, size: int, can_be_used: bool, tmp_path: Path
) -> None:
    content = autopilot_logs.ULOG_MAGIC + bytes(8) + message("F", b"part:uint64_t x;")
    content += message("F", f"{name}:{fields}".encode())
    content += message("A", bytes(3) + name.encode())
    for number in range(20):
        content += message("D", struct.pack("<HQ", 0, 1000 * number) + bytes(size - 8))
    (tmp_path / "log_7.ulg").write_bytes(content)
    if can_be_used:
        log = open_recording(tmp_path / "log_7.ulg")
        assert log.log_times()[0].tolist() == [1_000_000 * number for number in range(20)]
    else:
        with pytest.raises(LogError, match="it has sensor_combined without a time"):
            open_recording(tmp_path / "log_7.ulg")


@pytest.mark.parametrize(
    ("kind", "packed", "value"),
    [
        ("int8_t", "b", -3),
        ("uint8_t", "B", 253),
        ("int16_t", "h", -300),
        ("uint16_t", "H", 40_000),
        ("int32_t", "i", -70_000),
        ("uint32_t", "I", 3_000_000_000),
        ("int64_t", "q", -5_000_000_000),
        ("uint64_t", "Q", 5_000_000_000),
        ("float", "f", -0.75),
        ("double", "d", 1e-9),
    ],
)
def test_numbers_have_the_published_types(
    kind: str, packed: str, value: float, tmp_path: Path
) -> None:
    content = autopilot_logs.ULOG_MAGIC + bytes(8)
    content += message("F", f"vehicle_odometry:uint64_t timestamp;{kind} x;".encode())
    content += message("A", bytes(3) + b"vehicle_odometry")
    content += message("D", struct.pack(f"<HQ{packed}", 0, 1000, value))
    (tmp_path / "log_7.ulg").write_bytes(content)
    log = open_recording(tmp_path / "log_7.ulg")
    (channel,) = log.channels
    (block,) = log.blocks({channel.id})
    assert np.frombuffer(block.buffer, np.float64).tolist()[-1] == value
