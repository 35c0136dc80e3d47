"""Logs of MOOS replay as the MCAP of the same dive does, by settings that name their variables."""

from pathlib import Path

import instrument_logs
import msgspec
import numpy as np
import pytest
from moos_logs import alog, told_dive, whole

from insdvl_replay.core.config import Config, Dvl, Imu, Reference
from insdvl_replay.core.errors import LogError
from insdvl_replay.inspection.proposal import propose_settings
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.moos_alog import TYPE
from insdvl_replay.logs.formats.recording import open_recording

SETTINGS = Config(
    imu=Imu(
        topic="IMU",
        specific_force="IMU_ACC_X, IMU_ACC_Y, IMU_ACC_Z",
        angular_rate="IMU_GYRO_X, IMU_GYRO_Y, IMU_GYRO_Z",
    ),
    dvl=Dvl(topic="DVL", velocity="DVL_VEL_X, DVL_VEL_Y, DVL_VEL_Z"),
    reference=Reference(
        topic="NAV", latitude="NAV_LAT", longitude="NAV_LONG", height="NAV_HEIGHT",
        velocity_n="NAV_VN, NAV_VE, NAV_VD", roll="NAV_ROLL", pitch="NAV_PITCH", heading="NAV_YAW",
        angle_unit="rad",
    ),
)  # fmt: skip


def with_others(lines: list[str]) -> list[str]:
    """Put what other applications publish between the lines."""
    found = list(lines)
    found.insert(20, "0.10000 DEPLOY pMarineViewer false")
    found.insert(30, "0.20000 NODE_REPORT_LOCAL pNodeReporter NAME=alpha,X=1,Y=2")
    found.insert(40, "0.30000 MODE pHelmIvP:AUX ")
    found.insert(50, "0.40000 USBL_FIX iUSBL [3x1]{1.5,2.5,-3.5}")
    found.insert(60, "0.50000 NAV_X pNodeReporter 12.5")
    return found


@pytest.mark.parametrize(("marked", "whole_times"), [(False, False), (True, False), (False, True)])
def test_log_has_the_readings_of_the_mcap(marked: bool, whole_times: bool, tmp_path: Path) -> None:
    dive = told_dive()
    (tmp_path / "m.alog").write_text(whole(alog(dive, marked=marked, whole_times=whole_times)))
    found = read_dive(tmp_path / "m.alog", SETTINGS)
    expected = read_dive(instrument_logs.write_whole(tmp_path, dive), Config())
    atol_ns = 1_000 if whole_times else 510
    instrument_logs.assert_same_dvl(found, expected, 1e-12, atol_ns)
    np.testing.assert_allclose(found.imu.time_ns, expected.imu.time_ns, rtol=0, atol=atol_ns)
    np.testing.assert_array_equal(found.imu.specific_force_b, dive.imu.specific_force_b)
    assert found.reference is not None
    assert expected.reference is not None
    assert len(found.reference.time_ns) == len(expected.reference.time_ns)


def test_replay_is_that_of_the_mcap(tmp_path: Path) -> None:
    dive = told_dive()
    (tmp_path / "m.alog").write_text(whole(with_others(alog(dive))))
    log = instrument_logs.write_whole(tmp_path, dive)
    settings = msgspec.structs.replace(
        SETTINGS, reference=msgspec.structs.replace(SETTINGS.reference, topic="NAV/pNavTruth")
    )
    apart_m = instrument_logs.assert_same_replay([tmp_path / "m.alog"], log, 1e-4, settings)
    assert apart_m > 0.0


def test_tables_are_those_of_applications_and_the_rest_is_counted(tmp_path: Path) -> None:
    (tmp_path / "m.alog").write_text(whole(with_others(alog(told_dive()))))
    log = open_recording(tmp_path / "m.alog")
    topics = {channel.topic: channel for channel in log.channels}
    assert topics.keys() == {"IMU", "DVL", "NAV/pNavTruth", "NAV/pNodeReporter", "USBL"}
    assert {channel.type_name for channel in log.channels} == {TYPE}
    assert topics["USBL"].schema_data == b'[["usbl_fix",3]]'
    (note,) = log.notes
    assert note.code == "other_records"
    assert "texts (2), empty texts (1)" in note.text


def test_settings_are_proposed(tmp_path: Path) -> None:
    (tmp_path / "m.alog").write_text(whole(alog(told_dive())))
    proposal = propose_settings(tmp_path / "m.alog", Config())
    found = {setting.key: setting.value for setting in proposal.settings}
    assert found["imu.topic"] == "IMU"
    assert found["dvl.topic"] == "DVL"


def test_slow_variables_leave_gaps_and_no_wrong_rows(tmp_path: Path) -> None:
    lines = ["%% LOGSTART 1000.0"]
    for number in range(6):
        lines.append(f"{0.1 * number:.5f} A_X app {number}")
        if number % 3 == 0:
            lines.append(f"{0.1 * number + 0.0001:.5f} A_Y app {10 * number}")
        lines.append(f"{0.1 * number + 0.05:.5f} A_Z app {100 * number}")
    (tmp_path / "m.alog").write_text(whole(lines))
    log = open_recording(tmp_path / "m.alog")
    (times,) = log.log_times().values()
    assert len(times) == 12
    assert times[0] == 1_000_000_000_000
    (block,) = log.blocks({log.channels[0].id})
    rows = np.frombuffer(block.buffer, np.float64).reshape(12, -1)
    np.testing.assert_array_equal(rows[0, 1:], [0.0, 0.0, np.nan])
    np.testing.assert_array_equal(rows[1, 1:], [np.nan, np.nan, 0.0])
    np.testing.assert_array_equal(rows[6, 1:], [3.0, 30.0, np.nan])


def test_damaged_lines(tmp_path: Path) -> None:
    lines = alog(told_dive())
    lines[100] = lines[100][10:]
    lines[200] = "12.5 IMU"
    lines[300] = lines[300].replace(".", ",", 1)
    (tmp_path / "m.alog").write_text(whole(lines)[:-5])
    log = open_recording(tmp_path / "m.alog")
    (note,) = log.notes
    assert note.code == "log_damaged"
    assert note.count == 4


def test_log_of_texts_alone_is_refused(tmp_path: Path) -> None:
    (tmp_path / "m.alog").write_text("%% LOGSTART 1000.0\n1.0 DEPLOY app true\n")
    with pytest.raises(LogError, match=r"has no lines that can be used; it has texts"):
        open_recording(tmp_path / "m.alog")


def lines_of(start: str, count: int) -> list[str]:
    """A log of one variable."""
    lines = [f"%% LOGSTART {start}"]
    for number in range(count):
        lines.append(f"{0.1 * number:.5f} A_X app {number}")
    return lines


def test_logs_in_a_row_have_their_own_starts(tmp_path: Path) -> None:
    lines = [*lines_of("1000000000", 10), *lines_of("1000003600", 5)]
    (tmp_path / "m.alog").write_text(whole(lines))
    (times,) = open_recording(tmp_path / "m.alog").log_times().values()
    since_s = (times - 10**18) / 1e9
    expected = [*(0.1 * np.arange(10)), *(3600.0 + 0.1 * np.arange(5))]
    np.testing.assert_allclose(since_s, expected, rtol=0, atol=1e-6)


def test_start_that_is_no_time_is_noted(tmp_path: Path) -> None:
    (tmp_path / "m.alog").write_text(whole(lines_of("today", 10)))
    (note,) = open_recording(tmp_path / "m.alog").notes
    assert "the start of the log is 'today', which is no time in s" in note.text


def test_byte_order_mark_and_other_line_ends(tmp_path: Path) -> None:
    text = whole(lines_of("1000000000", 10)).replace("\n", "\r\n")
    (tmp_path / "m.alog").write_bytes(b"\xef\xbb\xbf" + text.encode())
    log = open_recording(tmp_path / "m.alog")
    assert log.log_times()[0][0] == 10**18
    assert not log.notes


def test_values_of_a_reading_are_a_row_in_any_order(tmp_path: Path) -> None:
    lines = ["%% LOGSTART 1000.0"]
    for number in range(6):
        for place, axis in reversed(list(enumerate("XYZ"))):
            lines.append(f"{0.1 * number + 1e-4 * place:.5f} A_{axis} app {number}")
    (tmp_path / "m.alog").write_text(whole(lines))
    log = open_recording(tmp_path / "m.alog")
    (block,) = log.blocks({log.channels[0].id})
    rows = np.frombuffer(block.buffer, np.float64).reshape(6, -1)
    np.testing.assert_array_equal(rows[:, 1:], np.repeat(np.arange(6.0)[:, None], 3, axis=1))


def test_variables_without_a_prefix_are_a_table(tmp_path: Path) -> None:
    text = whole(lines_of("1000000000", 10)).replace("A_X", "_X")
    (tmp_path / "m.alog").write_text(text)
    assert [channel.topic for channel in open_recording(tmp_path / "m.alog").channels] == ["X"]


@pytest.mark.nightly
def test_table_that_is_too_wide_is_refused_before_it_is_made(tmp_path: Path) -> None:
    lines = ["%% LOGSTART 1000000000"]
    for number in range(40_000):
        lines.append(f"{0.1 * number:.1f} A_{number % 2000} app [1x36]{{{'0,' * 35}0}}")
    (tmp_path / "m.alog").write_text(whole(lines))
    with pytest.raises(LogError, match="has more than 268435456 numbers"):
        open_recording(tmp_path / "m.alog")
