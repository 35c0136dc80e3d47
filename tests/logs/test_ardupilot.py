"""Logs of ArduSub in the published layout replay as the MCAP of the same dive does, and damage is told."""

import re
import struct
from pathlib import Path

import autopilot_logs
import instrument_logs
import numpy as np
import pytest
from autopilot_logs import Dataflash, flipped, format_records, record
from instrument_logs import Told, told

from insdvl_replay import replay_log
from insdvl_replay.batch.dive_paths import find_dives
from insdvl_replay.calibration.found import Given, as_given
from insdvl_replay.core.config import Config, Depth, Dvl, Filter, Imu, Reference, Solution
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.inspection.automatic import find_settings, with_flown
from insdvl_replay.inspection.proposal import propose_settings
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.dataflash import Records, layout_of
from insdvl_replay.logs.formats.recording import open_recording

# Of 32 bits: of a pressure, and of a specific force near gravity.
FORCE_MPS2 = 5e-7
RATE_RADPS = 5e-8
VELOCITY_MPS = 2e-7


def dive() -> Told:
    return told().of_velocities()


def write(folder: Path, log: Dataflash) -> list[Path]:
    """Write a log, and the MCAP of the reference."""
    path = folder / "00000042.BIN"
    path.write_bytes(log.content())
    return [path, instrument_logs.write_rest(folder, log.told.dive, imu=False)]


def whole_log(told: Told) -> Dataflash:
    log = Dataflash(told)
    log.whole()
    return log


def heads_in(content: bytes) -> list[int]:
    """Where the records behind the formats begin."""
    begin = len(format_records())
    return [head.start() for head in re.finditer(rb"\xa3\x95", content) if head.start() >= begin]


@pytest.mark.nightly
def test_replay_of_the_increments_is_that_of_the_mcap(tmp_path: Path) -> None:
    log = whole_log(dive())
    apart_mps, apart_m = instrument_logs.compare(
        write(tmp_path, log), log.told.dive, tmp_path, atol_mps=VELOCITY_MPS, atol_m=1e-5
    )
    assert 0.0 < apart_mps < VELOCITY_MPS
    assert apart_m < 1e-5


@pytest.mark.parametrize(
    ("imu", "dvl", "late_ns"),
    [("add_increments", "RBOH", 1_000_000), ("add_deltas", "VISO", 0), ("add_samples", "VISO", 0)],
)
def test_every_kind_of_record_has_the_readings_of_the_mcap(
    imu: str, dvl: str, late_ns: int, tmp_path: Path
) -> None:
    log = Dataflash(dive())
    getattr(log, imu)()
    log.add_displacements(dvl)
    log.add_fixes()
    found = read_dive(write(tmp_path, log), Config())
    whole = read_dive(instrument_logs.write_whole(tmp_path, log.told.dive), Config())
    instrument_logs.assert_same_dvl(found, whole, VELOCITY_MPS, late_ns)
    np.testing.assert_allclose(found.imu.time_ns, whole.imu.time_ns, rtol=0, atol=1)
    np.testing.assert_allclose(
        found.imu.specific_force_b, whole.imu.specific_force_b, rtol=0, atol=2 * FORCE_MPS2
    )
    np.testing.assert_allclose(
        found.imu.angular_rate_b, whole.imu.angular_rate_b, rtol=0, atol=RATE_RADPS
    )


def test_each_log_of_a_folder_is_a_dive(tmp_path: Path) -> None:
    content = autopilot_logs.ardupilot(dive())
    for name in ("00000041.BIN", "00000042.BIN"):
        (tmp_path / name).write_bytes(content)
    (tmp_path / "log_7.ulg").write_bytes(autopilot_logs.px4(dive()))
    found = [one.path.name for one in find_dives([str(tmp_path)])]
    assert found == ["00000041.BIN", "00000042.BIN", "log_7.ulg"]


def test_pings_without_confidence_are_left_out(tmp_path: Path) -> None:
    log = Dataflash(told())
    log.add_increments()
    log.add_displacements("VISO")
    found = read_dive(write(tmp_path, log), Config())
    lost = int(np.count_nonzero(~np.isfinite(log.told.velocity_d).all(axis=1)))
    notes = {note.code: note.count for note in found.notes}
    assert notes["dvl_invalid"] == lost


def test_the_ekf_that_was_flown_is_a_row(tmp_path: Path) -> None:
    log = whole_log(dive())
    solution = Filter(solution=Solution(topic="ekf3"))
    config = Config(filters={"baseline": Filter(aiding=("velocity",)), "onboard": solution})
    result = replay_log(write(tmp_path, log), config)
    rows = result.tables["reference_error"].set_index(["filter", "quantity"])
    # It is stretched by 1 %, and the dive is some tens of metres long.
    assert 0.1 < rows.loc[("onboard", "position_h"), "rmse"] < 1.0


def test_the_ekf_is_added_where_no_filters_are_given(tmp_path: Path) -> None:
    log = whole_log(dive())
    path = write(tmp_path, log)[0]
    without = Given(load_config())
    notes: list[Note] = []
    found = with_flown([path], without.config, without, notes)
    assert list(found.filters) == [*without.config.filters, "onboard"]
    assert found.filters["onboard"].solution == Solution(topic="ekf3")
    assert [note.code for note in notes] == ["found_flown"]
    assert as_given(found, without) == found
    given = Given(load_config(), ["filters.baseline.aiding"])
    assert with_flown([path], given.config, given, notes) == given.config
    log = Dataflash(dive())
    log.add_samples()
    assert with_flown(write(tmp_path, log), without.config, without, notes) == without.config


def test_the_ekf_is_not_proposed_as_reference(tmp_path: Path) -> None:
    log = Dataflash(dive())
    log.add_increments()
    log.add_displacements("VISO")
    log.add_solution()
    path = write(tmp_path, log)[0]
    proposed = {
        setting.key: setting.value for setting in propose_settings(path, Config()).settings
    }
    assert proposed["initial.source"] == "level"
    assert "reference.topic" not in proposed
    named = Config(reference=Reference(topic="ekf3"))
    given = Given(named, ["reference.topic"])
    assert with_flown([path], named, given, []) == named
    assert read_dive(path, named).reference is not None


@pytest.mark.nightly
def test_a_search_adds_the_ekf(tmp_path: Path) -> None:
    path = write(tmp_path, whole_log(dive()))[0]
    found = find_settings([[path]], Given(load_config()))
    assert found.config.filters["onboard"].solution == Solution(topic="ekf3")
    assert [note.code for note in found.notes].count("found_flown") == 1


@pytest.mark.parametrize("primary", [0, 1])
def test_solution_is_that_of_the_primary_core(primary: int, tmp_path: Path) -> None:
    log = Dataflash(dive())
    log.add_increments()
    log.add_displacements("VISO")
    log.add_fixes()
    log.add_solution(stretch=1.0, primary=primary)
    solution = Filter(solution=Solution(topic="ekf3"))
    config = Config(filters={"baseline": Filter(aiding=("velocity",)), "onboard": solution})
    found = read_dive(write(tmp_path, log), config)
    reference = found.reference
    assert reference is not None
    motion = found.solutions["onboard"].motion
    np.testing.assert_array_equal(motion.time_ns, reference.time_ns)
    np.testing.assert_allclose(motion.velocity_n, reference.velocity_n, rtol=0, atol=1e-6)
    # Angles in hundredths of a degree; places in 1e-7 deg, 11 mm, and hundredths of a metre.
    np.testing.assert_allclose(motion.mat_nb, reference.mat_nb, rtol=0, atol=3e-4)
    np.testing.assert_allclose(
        motion.position[:, :2], reference.position[:, :2], rtol=0, atol=2e-9
    )
    np.testing.assert_allclose(motion.position[:, 2], reference.position[:, 2], rtol=0, atol=6e-3)


def test_fixes_pressure_and_attitude_are_found(tmp_path: Path) -> None:
    log = whole_log(dive())
    path = write(tmp_path, log)[0]
    config = Config(
        filters={"baseline": Filter(aiding=("velocity", "depth", "heading", "position"))}
    )
    found = read_dive([path], config)
    truth = log.truth
    reference = found.reference
    assert reference is not None
    np.testing.assert_array_equal(reference.time_ns, truth.time_ns)
    degrees = np.degrees(reference.position[:, :2])
    np.testing.assert_allclose(degrees, truth.position[:, :2], rtol=0, atol=6e-8)
    depth_m = found.sensors["depth"].values[:, 0]
    expected_m = -1025.0 / Depth().density_kgpm3 * truth.position[:, 2]
    np.testing.assert_allclose(depth_m - depth_m[0], expected_m - expected_m[0], rtol=0, atol=0.01)
    heading = np.degrees(found.sensors["heading"].values[:, 0]) % 360.0
    apart = (heading - truth.rpy_deg[:, 2] + 180.0) % 360.0 - 180.0
    assert np.abs(apart).max() < 0.0051


def test_imu_in_use_is_that_of_the_header(tmp_path: Path) -> None:
    log = Dataflash(dive())
    log.add_increments(primary=2, others=(0, 1))
    log.add_displacements("VISO")
    found = read_dive(write(tmp_path, log), Config())
    force = log.told.dive.imu.specific_force_b
    np.testing.assert_allclose(found.imu.specific_force_b, force, rtol=0, atol=2 * FORCE_MPS2)
    topics = {channel.topic for channel in found.channels}
    assert {"imu/increments/0", "imu/increments/1", "imu/increments"} <= topics


def test_another_imu_can_be_named(tmp_path: Path) -> None:
    log = Dataflash(dive())
    log.add_samples()
    log.add_displacements("VISO")
    imu = Imu(topic="imu/samples/1", specific_force="specific_force", angular_rate="angular_rate")
    found = read_dive(write(tmp_path, log), Config(imu=imu))
    force = 0.5 * log.told.dive.imu.specific_force_b
    np.testing.assert_allclose(found.imu.specific_force_b, force, rtol=0, atol=2 * FORCE_MPS2)


def test_times_without_a_fix_are_since_the_start(tmp_path: Path) -> None:
    log = Dataflash(dive())
    log.add_samples()
    log.add_displacements("VISO")
    path = write(tmp_path, log)[0]
    times = open_recording(path).log_times()
    first_ns = int(log.told.dive.imu.time_ns[0]) - log.start_ns
    assert min(int(of_topic[0]) for of_topic in times.values()) == first_ns


def test_a_cut_log_is_read_up_to_the_cut(tmp_path: Path) -> None:
    log = whole_log(dive())
    content = log.content()
    paths = write(tmp_path, log)
    paths[0].write_bytes(content[: 2 * len(content) // 3 - 5])
    found = read_dive(paths, Config())
    (note,) = [note for note in found.notes if note.code == "log_damaged"]
    assert note.count == 1
    assert len(found.dvl.time_ns) == pytest.approx(2 * len(log.told.time_ns) / 3, abs=5)


def test_garbage_and_turned_bits_lose_the_records_around_them(tmp_path: Path) -> None:
    log = whole_log(dive())
    content = log.content()
    paths = write(tmp_path, log)
    whole = read_dive(paths, Config())
    middle = len(content) // 2
    garbage = np.random.default_rng(3).integers(0, 256, 700, np.uint8).tobytes()
    heads = heads_in(content)
    turned = flipped(content, np.array(heads[400:2400:400]))
    paths[0].write_bytes(turned[:middle] + garbage + turned[middle:])
    found = read_dive(paths, Config())
    (note,) = [note for note in found.notes if note.code == "log_damaged"]
    # Five heads and the garbage, and increments whose frame is lost.
    assert note.count == 7
    assert f"byte {heads[400 - 1]}:" in note.text
    assert len(whole.imu.time_ns) - len(found.imu.time_ns) < 20
    # What is left is what was written.
    same = np.isin(whole.imu.time_ns, found.imu.time_ns)
    assert np.count_nonzero(same) == len(found.imu.time_ns)
    np.testing.assert_array_equal(whole.imu.specific_force_b[same], found.imu.specific_force_b)


def test_more_than_few_damaged_records_are_refused(tmp_path: Path) -> None:
    log = Dataflash(dive())
    log.add_samples()
    log.add_displacements("VISO")
    content = log.content()
    paths = write(tmp_path, log)
    paths[0].write_bytes(flipped(content, np.array(heads_in(content)[::15])))
    with pytest.raises(LogError, match=r"records are damaged, the first at byte \d+: \d+ bytes"):
        read_dive(paths, Config())


def test_a_log_without_formats_has_nothing_that_can_be_used(tmp_path: Path) -> None:
    content = record("FMT", 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    path = tmp_path / "00000042.BIN"
    path.write_bytes(content + bytes(500))
    with pytest.raises(LogError, match="has no records that can be used"):
        read_dive(path, Config())


@pytest.mark.parametrize(
    ("letter", "packed", "raw", "value"),
    [
        ("b", "b", -3, -3.0),
        ("B", "B", 253, 253.0),
        ("h", "h", -300, -300.0),
        ("H", "H", 40_000, 40_000.0),
        ("i", "i", -70_000, -70_000.0),
        ("I", "I", 3_000_000_000, 3e9),
        ("q", "q", -5_000_000_000, -5e9),
        ("Q", "Q", 5_000_000_000, 5e9),
        ("g", "e", 0.5, 0.5),
        ("f", "f", -0.75, -0.75),
        ("d", "d", 1e-9, 1e-9),
        ("c", "h", -1234, -12.34),
        ("C", "H", 35_999, 359.99),
        ("e", "i", -123_456, -1234.56),
        ("E", "I", 3_000_000_000, 3e7),
        ("L", "i", 471_234_567, 47.1234567),
        ("M", "B", 19, 19.0),
    ],
)
def test_letters_of_a_format_are_the_published_types_and_units(
    letter: str, packed: str, raw: float, value: float
) -> None:
    """By the table of the letters in README.md of ArduPilot's AP_Logger."""
    content = bytes([0xA3, 0x95, 200]) + struct.pack(f"<{packed}", raw)
    kind = [200, len(content), b"KIND", letter.encode(), b"Value"]
    found = layout_of(record("FMT", *kind))
    assert found is not None
    number, layout = found
    assert number == 200
    rows = np.frombuffer(content, layout.dtype)
    records = Records(np.zeros(1, np.int64), rows, layout.factors)
    assert records.values("Value")[0] == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("size", "letters", "labels"),
    [
        (15, b"QB", b"TimeUS,I"),  # another size than the letters have
        (12, b"QB", b"TimeUS"),  # fewer labels than letters
        (12, b"QB", b"TimeUS,TimeUS"),
        (12, b"Q?", b"TimeUS,I"),
        (3, b"", b""),
    ],
)
def test_a_format_that_cannot_be_is_lost(
    size: int, letters: bytes, labels: bytes, tmp_path: Path
) -> None:
    log = Dataflash(dive())
    log.add_samples()
    content = record("FMT", 200, size, b"BAD", letters, labels) + log.content()
    first = record("FMT", 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    path = tmp_path / "00000042.BIN"
    path.write_bytes(first + content)
    (note,) = [note for note in open_recording(path).notes if note.code == "log_damaged"]
    assert f"byte {len(first)}: a record FMT tells no layout" in note.text


def test_bytes_of_a_head_within_values_are_no_record(tmp_path: Path) -> None:
    log = Dataflash(dive())
    log.add_samples()
    number = autopilot_logs.FORMATS["MAG"][0]
    # The error counts of an IMU, so chosen that they look like the head of a record.
    inside = struct.unpack("<I", bytes([0xA3, 0x95, number, 0]))[0]
    for place in range(100):
        time_ns = int(log.told.dive.imu.time_ns[0]) + place * 10**8 + 1000
        values = [log.us(time_ns), 0, *[0.1] * 6, inside, inside]
        log.add(time_ns, record("IMU", *values, 30.0, 1, 1, 1000, 1000))
    path = tmp_path / "00000042.BIN"
    path.write_bytes(log.content())
    opened = open_recording(path)
    counts = {channel.topic: channel.messages for channel in opened.channels}
    assert counts["imu/samples"] == len(log.told.dive.imu.time_ns) + 100
    assert not opened.notes


def test_the_other_displacements_can_be_named(tmp_path: Path) -> None:
    log = whole_log(dive())
    paths = write(tmp_path, log)
    found = read_dive(paths, Config(dvl=Dvl(topic="dvl/odometry/0")))
    whole = read_dive(instrument_logs.write_whole(tmp_path, log.told.dive), Config())
    instrument_logs.assert_same_dvl(found, whole, VELOCITY_MPS, 1_000_000)


def samples(count: int) -> list[bytes]:
    """Records of an IMU, a hundred each second."""
    found = []
    for number in range(count):
        rest = [0, 0, 30.0, 1, 1, 1000, 1000]
        found.append(record("IMU", 10_000 * number, 0, *[0.0] * 5, -9.8, *rest))
    return found


@pytest.mark.parametrize("week", [0, 65_535])
def test_impossible_week_is_no_date(week: int, tmp_path: Path) -> None:
    fix = record("GPS", 0, 0, 3, 1000, week, 12, 80, 10, 10, 100, 0.0, 0.0, 0.0, 0.0, 1)
    (tmp_path / "a.BIN").write_bytes(format_records() + b"".join(samples(100)) + fix)
    times = open_recording(tmp_path / "a.BIN").log_times()
    assert int(times[0][-1]) == 990_000_000


def test_what_looks_like_a_head_hides_no_other_record(tmp_path: Path) -> None:
    records = samples(20)
    # As long as to the end of the record behind it.
    kind = autopilot_logs.FORMATS["UNIT"][0]
    size = 3 + struct.calcsize("<Qb64s")
    at = 2 * len(records[0]) - size
    damaged = bytearray(records[5])
    damaged[at : at + 3] = bytes([0xA3, 0x95, kind])
    records[5] = bytes(damaged)
    (tmp_path / "a.BIN").write_bytes(format_records() + b"".join(records))
    log = open_recording(tmp_path / "a.BIN")
    assert [channel.messages for channel in log.channels] == [20]
    assert not log.notes
