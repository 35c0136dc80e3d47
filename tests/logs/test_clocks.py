"""Every topic's clock is measured against the recorder's, and clocks that have nothing in common are not mixed."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap_ros2.writer import Writer

from insdvl_replay.core.config import Clocks, Config, Dvl, Imu
from insdvl_replay.core.dive_columns import Floats, TimeNs
from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.columns.tables import clock_notes, measure_clock, stamp_unit
from insdvl_replay.logs.formats.definitions import definition_text

START_NS = 1_700_000_000_000_000_000
DAY_S = 86_400.0
DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"


def ns(at_s: Floats) -> TimeNs:
    return START_NS + np.rint(at_s * 1e9).astype(np.int64)


def clock(role: str, log_minus_stamp_s: float, spread_s: float = 0.0) -> Clock:
    return Clock(role, f"/{role}", "header", 100, log_minus_stamp_s, spread_s, 0, 0, 10.0)


# Measured


def test_offset_spread_steps_and_rate_are_measured() -> None:
    log_s = np.arange(101) * 0.1
    late_s = np.linspace(0.0, 0.1, 101)
    stamps_s = log_s - 5.96 * DAY_S - late_s
    stamps_s[50] = stamps_s[49]
    stamps_s[70], stamps_s[71] = stamps_s[71], stamps_s[70]
    found = measure_clock("imu", "/imu", "header", ns(stamps_s), ns(log_s))
    assert found.log_minus_stamp_s == pytest.approx(5.96 * DAY_S + 0.05, abs=2e-3)
    assert found.spread_s == pytest.approx(0.09, abs=5e-3)
    assert (found.messages, found.back_steps, found.repeats) == (101, 1, 1)
    assert found.rate_hz == pytest.approx(99 / 9.9, rel=1e-6), "a repeat is no stamp of its own"


def test_rate_of_messages_that_come_in_pairs_is_that_of_all() -> None:
    stamps_s = np.repeat(np.arange(11) * 0.1, 2)
    stamps_s[1::2] += 0.0002
    found = measure_clock("", "/leak", "header", ns(stamps_s), ns(stamps_s))
    assert found.rate_hz == pytest.approx(21 / 1.0002, rel=1e-6)


@given(st.lists(st.integers(-(10**12), 10**12), min_size=1, max_size=60))
def test_offset_and_spread_are_the_percentiles_of_numpy(behind: list[int]) -> None:
    time_ns = START_NS + 10_000_000 * np.arange(len(behind))
    log_time_ns = time_ns + np.array(behind)
    unchanged = time_ns.copy(), log_time_ns.copy()
    found = measure_clock("imu", "/imu", "header", time_ns, log_time_ns)
    low, median, high = np.percentile(np.array(behind), (5, 50, 95)) * 1e-9
    assert found.log_minus_stamp_s == pytest.approx(median, abs=1e-9)
    assert found.spread_s == pytest.approx(high - low, abs=1e-9)
    np.testing.assert_array_equal((time_ns, log_time_ns), unchanged)


def test_offset_of_decades_keeps_its_nanoseconds() -> None:
    uptime_ns = np.arange(5, dtype=np.int64) * 10_000_000
    found = measure_clock("imu", "/imu", "header", uptime_ns, START_NS + uptime_ns + 7)
    assert found.log_minus_stamp_s == pytest.approx(1.7e9, abs=1e-6)
    assert found.spread_s == 0.0
    assert measure_clock("imu", "/imu", "header", uptime_ns[:1], uptime_ns[:1]).rate_hz is None


# Mixed


@pytest.mark.parametrize("other", ["dvl", "reference"])
def test_clocks_that_have_nothing_in_common_are_refused(other: str) -> None:
    with pytest.raises(
        LogError, match=rf"a\.mcap: /imu and /{other} are stamped by different clocks"
    ) as refusal:
        clock_notes("a.mcap", [clock("imu", 0.0), clock(other, 5.96 * DAY_S)], 1.0)
    assert f"--set imu.stamp=log_time --set {other}.stamp=log_time" in refusal.value.hint
    assert "514944.000 s" in refusal.value.message


def test_one_topic_with_two_roles_and_clocks_is_reported_by_its_roles() -> None:
    """The attitude of an IMU that is stamped by the recorder: only one key is left to be set."""
    imu, heading = (
        replace(clock("imu", 0.0), stamp="log_time"),
        replace(clock("heading", 1e9), topic="/imu"),
    )
    with pytest.raises(
        LogError, match=r"imu and heading of /imu are stamped by different clocks"
    ) as refusal:
        clock_notes("a.mcap", [imu, heading], 1.0)
    assert "both: --set heading.stamp=log_time; " in refusal.value.hint


def test_spread_of_both_excuses_an_offset() -> None:
    notes = clock_notes("a.mcap", [clock("imu", 0.0, 0.5), clock("dvl", 1.9, 0.5)], 1.0)
    assert "clocks_apart" not in {note.code for note in notes}
    with pytest.raises(LogError):
        clock_notes("a.mcap", [clock("imu", 0.0, 0.5), clock("dvl", 2.1, 0.5)], 1.0)


def test_what_the_configuration_allows_is_reported() -> None:
    notes = clock_notes("a.mcap", [clock("imu", 0.0), clock("dvl", 30.0)], 60.0)
    assert [(note.code, note.severity) for note in notes] == [
        ("dvl_clock_offset", "info"),
        ("clocks_apart", "warning"),
    ]


def test_common_clock_that_is_not_the_recorders_is_reported_and_used() -> None:
    notes = clock_notes(
        "a.mcap", [clock("imu", 5.96 * DAY_S), clock("dvl", 5.96 * DAY_S + 0.2)], 1.0
    )
    assert [note.code for note in notes] == ["imu_clock_offset", "dvl_clock_offset"]


@pytest.mark.parametrize("fix_s", [3.0, 0.0], ids=["stamped late", "mended"])
def test_latency_makes_no_other_clock(fix_s: float) -> None:
    fix = replace(clock("position", -18.0 + fix_s - 3.0), latency_s=3.0)
    notes = clock_notes("a.mcap", [clock("imu", -18.0), fix], 1.0)
    assert "clocks_apart" not in {note.code for note in notes}
    with pytest.raises(LogError, match="different clocks"):
        clock_notes("a.mcap", [clock("imu", -18.0), replace(fix, log_minus_stamp_s=-15.0)], 1.0)


# Units


UNITS = [(1.0, "seconds"), (1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")]


@pytest.mark.parametrize(("factor", "unit"), UNITS)
def test_unit_of_a_number_is_reported_by_how_it_runs(factor: float, unit: str) -> None:
    """Since zero, power-up, half an hour and 1970."""
    at_s = np.arange(200) * 0.05
    for since_s in (0.0, 3.0, 2000.0, 1.7e9):
        assert stamp_unit((since_s + at_s) * factor, ns(at_s)) == (round(1e9 / factor), unit), (
            since_s
        )


@pytest.mark.parametrize(("factor", "unit"), UNITS)
def test_unit_of_a_log_written_later_is_reported_by_its_size(factor: float, unit: str) -> None:
    at_s = np.arange(200) * 0.05
    assert stamp_unit((1.7e9 + at_s) * factor, ns(at_s / 400.0))[1] == unit
    assert stamp_unit(np.array([1.7e9 * factor]), ns(np.zeros(1)))[1] == unit


@pytest.mark.parametrize(("factor", "unit"), UNITS)
def test_unit_of_a_number_is_told_where_the_last_row_is_earlier_than_the_first(
    factor: float, unit: str
) -> None:
    at_s = np.arange(200)[::-1] * 0.05
    assert stamp_unit((3.0 + at_s) * factor, ns(at_s))[1] == unit


# In logs


def write(path: Path, imu_behind_s: float, dvl_behind_s: float) -> Path:
    def stamp(time_ns: int) -> dict[str, Any]:
        return {"stamp": {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}, "frame_id": ""}

    imu_type, dvl_type = "sensor_msgs/msg/Imu", "geometry_msgs/msg/TwistStamped"
    with path.open("wb") as stream:
        writer = Writer(stream)
        imu, dvl = (
            writer.register_msgdef(name, definition_text(name)) for name in (imu_type, dvl_type)
        )
        for i in range(100):
            log_ns = START_NS + 10_000_000 * i
            message: dict[str, Any] = {
                "header": stamp(log_ns - round(imu_behind_s * 1e9)),
                "linear_acceleration": {"x": 0.01 * i, "y": 0.0, "z": -9.8},
                "angular_velocity": {"x": 0.0, "y": 0.0, "z": 0.01},
            }
            writer.write_message("/imu", imu, message, log_time=log_ns, publish_time=log_ns)
            if i % 10 == 0:
                twist = {"linear": {"x": 1.0 + 0.01 * i, "y": 0.0, "z": 0.0}}
                message = {"header": stamp(log_ns - round(dvl_behind_s * 1e9)), "twist": twist}
                writer.write_message("/dvl", dvl, message, log_time=log_ns, publish_time=log_ns)
        writer.finish()
    return path


def test_log_with_two_clocks_is_refused_until_reported_how_to_stamp(tmp_path: Path) -> None:
    path = write(tmp_path / "dive.mcap", imu_behind_s=1.69e9, dvl_behind_s=0.0)
    with pytest.raises(LogError, match="stamped by different clocks"):
        read_dive(path, Config())
    with pytest.raises(LogError, match="different clocks"):
        read_dive(path, Config(dvl=Dvl(stamp="log_time")))
    dive = read_dive(path, Config(imu=Imu(stamp="log_time"), dvl=Dvl(stamp="log_time")))
    assert dive.imu.time_ns[0] == dive.dvl.time_ns[0] == START_NS
    allowed = read_dive(path, Config(clocks=Clocks(max_disagreement_s=2e9)))
    assert "clocks_apart" in {note.code for note in allowed.notes}


def test_configured_latency_puts_two_clocks_right(tmp_path: Path) -> None:
    path = write(tmp_path / "dive.mcap", imu_behind_s=0.0, dvl_behind_s=-40.0)
    with pytest.raises(LogError, match="stamped by different clocks"):
        read_dive(path, Config())
    dive = read_dive(path, Config(dvl=Dvl(latency_s=40.0)))
    assert dive.imu.time_ns[0] == dive.dvl.time_ns[0]
    assert not dive.notes


def test_what_is_stamped_seconds_late_is_on_the_same_clock(tmp_path: Path) -> None:
    dive = read_dive(
        write(tmp_path / "dive.mcap", imu_behind_s=0.0, dvl_behind_s=0.0),
        Config(dvl=Dvl(latency_s=3.0)),
    )
    assert dive.dvl.time_ns[0] == dive.imu.time_ns[0] - 3 * 10**9
    assert not dive.notes


def test_an_offset_is_reported_as_the_log_has_it(tmp_path: Path) -> None:
    """By which an engineer finds it there, whatever latency was told."""
    path = write(tmp_path / "dive.mcap", imu_behind_s=40.0, dvl_behind_s=40.0)
    settings = Config(dvl=Dvl(latency_s=3.0), clocks=Clocks(max_disagreement_s=100.0))
    told = {note.code: note.text for note in read_dive(path, settings).notes}
    assert told["imu_clock_offset"].startswith(
        "/imu: log time minus stamp 'header' is 40.000 s (median; 0.000 s"
    )
    assert told["dvl_clock_offset"].startswith(
        "/dvl: log time minus stamp 'header' is 40.000 s (median; 0.000 s"
    )
    assert told["dvl_clock_offset"].endswith("; dvl.latency_s subtracts 3 s from the stamps")
    assert "latency" not in told["imu_clock_offset"]


def test_two_clocks_are_reported_as_the_log_has_them(tmp_path: Path) -> None:
    path = write(tmp_path / "dive.mcap", imu_behind_s=0.0, dvl_behind_s=40.0)
    with pytest.raises(LogError, match=r"is 0\.000 s and 40\.000 s; dvl\.latency_s subtracts 3 s"):
        read_dive(path, Config(dvl=Dvl(latency_s=3.0)))


@pytest.mark.skipif(not DATA.is_dir(), reason="needs ../shared/data (real logs)")
def test_uptime_and_unix_time_of_a_real_log_are_not_mixed() -> None:
    config = Config(dvl=Dvl(topic="/dvl", velocity="velocity.mean", kind="velocity"))
    with pytest.raises(
        LogError,
        match=r"/imu and /dvl are stamped by different clocks: .* 17403835\d\d\.\d+ s and ",
    ):
        read_dive(DATA / "stanford_auv" / "rotation_z_1.mcap", config)
