"""Times of tables: days, times of day with and without hour or date, and what is no time of a sensor."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from insdvl_replay.calibration.found import Given
from insdvl_replay.checks.imu import imu_remarks
from insdvl_replay.core.config import Config, Dvl, Imu
from insdvl_replay.core.dive_columns import ImuColumns
from insdvl_replay.core.errors import LogError
from insdvl_replay.inspection.automatic import find_settings
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.recording import Recording, open_recording
from insdvl_replay.logs.formats.table_times import (
    CALENDARS,
    likely_unit,
    shift_ns,
    text_times,
    unwrapped,
    usual_step,
)
from insdvl_replay.preparation.prepared import read_checked_dive

START = datetime(2021, 6, 8, 10, 41, 7, tzinfo=UTC)
IMU = Imu(topic="imu.csv", specific_force="ax, ay, az", angular_rate="gx, gy, gz")
DVL = Dvl(topic="dvl.csv", velocity="vx, vy, vz")
ONE_S = 10**9


def moments(count: int, step_s: float, start: datetime = START) -> list[datetime]:
    return [start + timedelta(seconds=i * step_s) for i in range(count)]


def hms(when: datetime) -> str:
    return when.strftime("%H:%M:%S.") + f"{when.microsecond // 10_000:02d}"


def write(path: Path, times: list[str], names: str, title: str = "Time") -> None:
    """Write a table of small random numbers with these times; an IMU of them feels gravity."""
    rng = np.random.default_rng(3)
    rows = rng.normal(0.0, 0.1, (len(times), names.count(",") + 1))
    if names.startswith("ax"):
        rows[:, 2] -= 9.8
    lines = [
        ",".join([time, *map(repr, row)]) for time, row in zip(times, rows.tolist(), strict=True)
    ]
    path.write_text("\n".join([f"{title},{names}", *lines, ""]))


def dive(
    folder: Path, imu: list[str], dvl: list[str], imu_title: str = "Time", dvl_title: str = "Time"
) -> Path:
    folder.mkdir(exist_ok=True)
    write(folder / "imu.csv", imu, "ax,ay,az,gx,gy,gz", imu_title)
    write(folder / "dvl.csv", dvl, "vx,vy,vz", dvl_title)
    return folder


def times_of(log: Recording) -> dict[str, np.ndarray]:
    times = log.log_times()
    return {channel.topic: times[channel.id] for channel in log.channels}


def codes(log: Recording) -> set[str]:
    return {note.code for note in log.notes}


# --- Days.


@pytest.mark.parametrize("calendar", CALENDARS, ids=lambda calendar: calendar.name)
def test_days_of_every_calendar_are_read_and_said(tmp_path: Path, calendar: object) -> None:
    zero = calendar.zero  # type: ignore[attr-defined]
    since_s = START.timestamp() + 0.02 * np.arange(200)
    folder = dive(
        tmp_path / "dive",
        *([f"{day:.12f}" for day in since_s[::n] / 86_400 + zero] for n in (1, 50)),
    )
    log = open_recording(folder)
    found = times_of(log)["imu.csv"]
    stored_ns = np.spacing(zero + 18_000.0) * 86_400e9
    np.testing.assert_allclose(
        found - START.timestamp() * 1e9, (since_s - START.timestamp()) * 1e9, atol=2 * stored_ns
    )
    texts = [note.text for note in log.notes if note.code == "table_days"]
    assert len(texts) == 2
    assert calendar.name in texts[0]  # type: ignore[attr-defined]


def test_days_with_few_digits_say_to_what_they_are_exact(tmp_path: Path) -> None:
    days = [f"{START.timestamp() / 86_400 + 25_569 + 0.02 * i / 86_400:.7f}" for i in range(200)]
    write(tmp_path / "imu.csv", days, "ax,ay,az,gx,gy,gz")
    (note,) = (
        note for note in open_recording(tmp_path / "imu.csv").notes if note.code == "table_days"
    )
    assert "exact to 0.0086 s, where the rows are" in note.text
    assert note.count == 200


@pytest.mark.parametrize(
    ("step", "first", "unit"),
    [
        (0.01, 0.0, "s"), (0.01, 40_000.0, "s"), (10.0, 1.7e12, "ms"), (1e4, 1.7e15, "us"), (1e7, 1.7e18, "ns"),
        (1.0 / 86_400, 44_000.0, "d"), (0.01 / 86_400, 738_000.0, "d"), (0.01 / 3600, 10.6, ""), (0.01 / 60, 0.0, ""),
        (0.01 / 86_400, 0.0, ""),
    ],
)  # fmt: skip
def test_a_unit_is_told_by_the_step_and_the_calendar(step: float, first: float, unit: str) -> None:
    assert likely_unit(first + step * np.arange(100)) == unit


@pytest.mark.parametrize("factor", [1.0, 1e3, 1e6, 1e9])
def test_rows_in_no_order_do_not_change_the_unit(factor: float) -> None:
    rising = np.rint((1.7e9 + 0.2 * np.arange(900)) * 1e3) / 1e3 * factor
    unit = likely_unit(rising)
    shuffled = np.random.default_rng(8).permutation(rising)
    for times in (shuffled, rising[::-1]):
        assert likely_unit(times) == unit
        assert usual_step(times) == pytest.approx(0.2 * factor, rel=1e-3)


def test_two_runs_or_two_sensors_in_a_table_are_not_sorted_for_their_step() -> None:
    """Sorted, rows of both would be 1e-4 s apart, which no sensor is."""
    at_s = 0.01 * np.arange(1000)
    begun_anew = np.concatenate([at_s, at_s + 1e-4])
    interleaved = np.stack([at_s + 1e-4, at_s], axis=1).ravel()
    for times in (begun_anew, interleaved):
        assert usual_step(times) == pytest.approx(0.01, rel=0.02)
        assert likely_unit(times) == "s"


def test_a_shuffled_table_is_read_as_the_sorted_one_and_its_rows_are_counted(
    tmp_path: Path,
) -> None:
    since_s = START.timestamp() + 0.02 * np.arange(3000)
    imu = [f"{time_s:.6f}" for time_s in since_s]
    pings = imu[::10]
    shuffled = np.random.default_rng(8).permutation(pings).tolist()
    read = read_dive(dive(tmp_path / "dive", imu, shuffled), Config(imu=IMU, dvl=DVL))
    # UNIX seconds are stored to a quarter of a microsecond.
    np.testing.assert_allclose(
        read.dvl.time_ns - read.imu.time_ns[0], 200_000_000 * np.arange(300), atol=1000
    )
    (late,) = (note for note in read.notes if note.code == "dvl_out_of_order")
    assert 250 < late.count < 300


def test_times_in_no_possible_unit_are_an_error_with_the_step_and_a_guess(tmp_path: Path) -> None:
    hours = [f"{10.6 + 0.01 * i / 3600:.12f}" for i in range(200)]
    folder = dive(tmp_path / "dive", hours, [f"{i}" for i in range(20)])
    with pytest.raises(
        LogError, match=r"'time' of imu\.csv step by 2\.78e-06.*it would be 0\.01 s in h"
    ):
        read_dive(folder, Config(imu=IMU, dvl=DVL))
    for title in ("Time [h]", "Time (hours)"):
        write(folder / "imu.csv", hours, "ax,ay,az,gx,gy,gz", title)
        np.testing.assert_allclose(
            np.diff(read_dive(folder, Config(imu=IMU, dvl=DVL)).imu.time_ns), 1e7, atol=1e3
        )
    write(folder / "imu.csv", hours, "ax,ay,az,gx,gy,gz")
    by_stamp = Imu(
        topic="imu.csv", specific_force="ax, ay, az", angular_rate="gx, gy, gz", stamp="time [h]"
    )
    np.testing.assert_allclose(
        np.diff(read_dive(folder, Config(imu=by_stamp, dvl=DVL)).imu.time_ns), 1e7, atol=1e3
    )


def test_an_imu_of_impossible_rate_or_length_is_refused_by_each_way(tmp_path: Path) -> None:
    times = [f"{2e-3 * i:.9f}" for i in range(400)]
    folder = dive(tmp_path / "dive", times, times[::50], "time [s]", "time [s]")
    with pytest.raises(LogError, match="too little for a dive"):
        read_checked_dive(folder, Config(imu=IMU, dvl=DVL))
    with pytest.raises(LogError, match="too little for a dive"):
        find_settings([(folder,)], Given(Config()))
    force = np.tile([0.0, 0.0, -9.8], (400, 1))
    fast = ImuColumns(np.arange(400) * 40_000, force, 0.0 * force)
    assert "more than any" in str(next(imu_remarks("dive", fast, None, Imu())))


# --- Times of day.


@pytest.mark.parametrize(
    ("cell", "seconds", "period_s"),
    [
        ("10:41:07", 38_467.0, 86_400), ("10:41:07.25", 38_467.25, 86_400), ("41:07.50", 2467.5, 3600),
        ("10:41:07,5", 38_467.5, 86_400), ("10:41:07:250", 38_467.25, 86_400), ("10:41:07 PM", 81_667.0, 86_400),
        ("12:00:01 am", 1.0, 86_400), ("2021-06-08 10:41:07", START.timestamp(), 0),
        ("8.6.2021 10:41:07", START.timestamp(), 0), ("28/06/2021 10:41:07", START.timestamp() + 20 * 86_400, 0),
        ("06/28/2021 10:41:07", START.timestamp() + 20 * 86_400, 0),
    ],
)  # fmt: skip
def test_cells_of_times_are_read(cell: str, seconds: float, period_s: int) -> None:
    times = text_times(pd.Series([cell, None, cell]))
    assert times is not None
    assert times.known.tolist() == [True, False, True]
    assert times.time_ns[0] == round(seconds * 1e9)
    assert times.period_ns == period_s * ONE_S


@pytest.mark.parametrize("cell", ["1:2:3:4:5", "10:99:00", "hello", "12.5"])
def test_cells_of_other_text_are_no_times(cell: str) -> None:
    assert text_times(pd.Series([cell] * 3)) is None


def test_times_go_on_over_midnight_and_over_the_hour() -> None:
    for period_s, start in ((86_400, datetime(2021, 6, 8, 23, 59, 59, tzinfo=UTC)), (3600, START)):
        true = start.timestamp() + 0.5 * np.arange(20_000)
        of_day = (np.rint((true % period_s) * 1e9)).astype(np.int64)
        rising = unwrapped(of_day, np.ones(len(of_day), np.bool_), period_s * ONE_S)
        np.testing.assert_array_equal(np.diff(rising), ONE_S // 2)


def test_minutes_of_one_table_are_put_to_the_hour_of_the_other(tmp_path: Path) -> None:
    start = datetime(2021, 6, 8, 10, 58, 0, tzinfo=UTC)  # over the hour
    imu = [hms(when)[3:] for when in moments(10_000, 0.02, start)]
    folder = dive(tmp_path / "dive", imu, [hms(when)[:8] for when in moments(200, 1.0, start)])
    log = open_recording(folder)
    times = times_of(log)
    np.testing.assert_array_equal(
        times["imu.csv"], times["dvl.csv"][0] + 20_000_000 * np.arange(10_000)
    )
    assert times["dvl.csv"][0] == (10 * 3600 + 58 * 60) * ONE_S
    (note,) = (note for note in log.notes if note.code == "table_time_of_day")
    assert "+10 h" in note.text
    read = read_dive(folder, Config(imu=IMU, dvl=DVL))
    assert read.imu.time_ns[0] == read.dvl.time_ns[0]


def test_times_of_day_are_put_to_the_date_of_the_other(tmp_path: Path) -> None:
    iso = [when.isoformat() for when in moments(200, 1.0)]
    folder = dive(tmp_path / "dive", [hms(when) for when in moments(2000, 0.02)], iso)
    assert times_of(open_recording(folder))["imu.csv"][0] == int(START.timestamp()) * ONE_S


def test_an_hour_that_several_could_be_is_an_error(tmp_path: Path) -> None:
    hours = [hms(when)[:8] for when in moments(400, 30.0)]
    folder = dive(tmp_path / "dive", [hms(when)[3:] for when in moments(500, 0.02)], hours)
    with pytest.raises(LogError, match="fit the other tables in several hours"):
        open_recording(folder)
    hour_ns = 3600 * ONE_S
    assert shift_ns((0, ONE_S), hour_ns, (7 * hour_ns, 7 * hour_ns + ONE_S)) == 7 * hour_ns
    assert shift_ns((0, ONE_S), hour_ns, (0, 3 * hour_ns)) is None


@pytest.mark.parametrize("date", ["2021-06-08", "08.06.2021", "20210608"])
def test_a_date_and_a_time_are_columns_of_one_time(tmp_path: Path, date: str) -> None:
    times = [f"{date},{hms(when)}" for when in moments(50, 0.5)]
    write(tmp_path / "imu.csv", times, "ax,ay,az,gx,gy,gz", "Date,Time")
    log = open_recording(tmp_path / "imu.csv")
    np.testing.assert_array_equal(
        log.log_times()[0], int(START.timestamp()) * ONE_S + np.arange(50) * ONE_S // 2
    )
    assert codes(log) == set()


def test_times_that_are_not_read_are_named_and_rows_can_be_counted(tmp_path: Path) -> None:
    folder = dive(tmp_path / "dive", [f"T{i}" for i in range(200)], [f"{i}" for i in range(20)])
    with pytest.raises(
        LogError, match=r"'time' of imu\.csv are not read: 'T0' is no number, date or time of day"
    ):
        read_dive(folder, Config(imu=IMU, dvl=DVL))
    counted = Imu(
        topic="imu.csv", specific_force="ax, ay, az", angular_rate="gx, gy, gz", stamp="100 Hz"
    )
    found = read_dive(folder, Config(imu=counted, dvl=DVL))
    np.testing.assert_array_equal(found.imu.time_ns, 10_000_000 * np.arange(200))
