"""Reports of Water Linked's DVLs over TCP, in the published layout, replay as the MCAP of the same dive does."""

import json
from collections.abc import Callable
from pathlib import Path

import instrument_logs
import msgspec
import numpy as np
import pytest
from instrument_logs import Told, told
from instrument_writers import Report, as_lines, velocity_reports
from made_tables import settings, tables_of, write_tables

from insdvl_replay.batch.dive_paths import find_dives
from insdvl_replay.core.config import Config, Dvl
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.recording import open_recording


def position_report(time_s: float) -> Report:
    return {
        "ts": time_s, "x": 1.0, "y": 2.0, "z": 3.0, "std": 0.1, "roll": 0.6, "pitch": 0.7, "yaw": 8.0,
        "type": "position_local", "status": 0, "format": "json_v3.1",
    }  # fmt: skip


def with_times(reports: list[Report]) -> str:
    lines = [
        f"2026-05-01 10:00:00,{n % 1000:03} {json.dumps(one)}\n" for n, one in enumerate(reports)
    ]
    return "".join(lines)


def indented(reports: list[Report]) -> str:
    return "".join(json.dumps(report, indent=2) + "\n" for report in reports)


def as_list(reports: list[Report]) -> str:
    return json.dumps(reports)


def mixed(reports: list[Report]) -> str:
    """Begun in the midst of a report, with dead reckoning and answers between."""
    answer = {
        "response_to": "get_config",
        "success": True,
        "result": {"range_mode": "auto"},
        "type": "response",
    }
    lines = [json.dumps(reports[0])[300:], json.dumps(answer)]
    for number, report in enumerate(reports):
        lines.append(json.dumps(report))
        if number % 3 == 0:
            lines.append(json.dumps(position_report(report["time_of_validity"] * 1e-6)))
    return "\n".join(lines) + "\n"


def write(folder: Path, dive: Told, form: Callable[[list[Report]], str], name: str) -> list[Path]:
    """Write the reports, and the MCAP of the rest of the dive."""
    (folder / name).write_text(form(velocity_reports(dive)))
    return [folder / name, instrument_logs.write_rest(folder, dive.dive)]


@pytest.mark.parametrize(
    ("form", "name"),
    [
        (as_lines, "dvl.json"), (with_times, "dvl.log"), (indented, "dvl.txt"), (as_list, "dvl.jsonl"),
        (mixed, "dvl.csv"),
    ],
)  # fmt: skip
def test_every_form_of_the_reports_has_the_pings_of_the_mcap(
    form: Callable[[list[Report]], str], name: str, tmp_path: Path
) -> None:
    dive = told()
    found = read_dive(write(tmp_path, dive, form, name), Config())
    whole = read_dive(instrument_logs.write_whole(tmp_path, dive.dive), Config())
    instrument_logs.assert_same_dvl(found, whole, 1e-12)


def test_folder_of_an_imu_as_table_and_reports_is_one_dive(tmp_path: Path) -> None:
    dive = told()
    folder = tmp_path / "dive"
    tables = tables_of(dive.dive)
    del tables["dvl"]
    _, topics = write_tables(folder, tables, "csv")
    (folder / "notes.txt").write_text("calm sea\n")
    (folder / "dvl.txt").write_text(as_lines(velocity_reports(dive)))
    (only,) = find_dives([str(folder)])
    config = settings({**topics, "dvl": ""})
    found = read_dive(only.path, msgspec.structs.replace(config, dvl=Dvl()))
    assert sorted(path.name for path in found.paths) == ["dvl.txt", "imu.csv", "reference.csv"]
    whole = read_dive(instrument_logs.write_whole(tmp_path, dive.dive), Config())
    instrument_logs.assert_same_dvl(found, whole, 1e-12)


def test_dead_reckoning_is_listed_and_plays_no_role(tmp_path: Path) -> None:
    write(tmp_path, told(), mixed, "dvl.json")
    log = open_recording(tmp_path / "dvl.json")
    channels = {channel.topic: channel for channel in log.channels}
    assert channels["dvl/position_local"].messages == (len(told().time_ns) + 2) // 3
    assert {note.code for note in log.notes} == {"log_damaged", "other_records"}


def test_water_track_is_left_out(tmp_path: Path) -> None:
    reports = velocity_reports(told())
    for report in reports[:50]:
        report["type"] = "velocity_water"
    for report in reports[50:60]:
        report["tracking_mode"] = "water"
    (tmp_path / "dvl.json").write_text(as_lines(reports))
    rest = instrument_logs.write_rest(tmp_path, told().dive)
    found = read_dive([tmp_path / "dvl.json", rest], Config())
    notes = {note.code: note.count for note in found.notes}
    assert notes["dvl_water_track"] == 60


def test_early_reports_without_a_clock_count_from_0(tmp_path: Path) -> None:
    reports = velocity_reports(told())
    for report in reports:
        for key in ("time_of_validity", "time_of_transmission", "type", "format"):
            del report[key]
        report["time"] = 200.0
    (tmp_path / "dvl.json").write_text(as_lines(reports))
    log = open_recording(tmp_path / "dvl.json")
    (times,) = log.log_times().values()
    np.testing.assert_array_equal(times, 200_000_000 * np.arange(1, len(reports) + 1))
    assert [note.code for note in log.notes] == ["times_summed"]


def test_dvl_alone_says_what_is_missing_and_how_to_add_it(tmp_path: Path) -> None:
    path = write(tmp_path, told(), as_lines, "my dvl.json")[0]
    with pytest.raises(
        LogError, match="has no IMU: it has dvl/velocity of an instrument"
    ) as raised:
        read_dive(path, Config())
    assert f"insdvl-replay run --one-dive '{path}' imu.csv" in raised.value.hint


def test_single_damaged_reports_are_a_note_and_many_are_refused(tmp_path: Path) -> None:
    lines = as_lines(velocity_reports(told())).splitlines()
    rest = instrument_logs.write_rest(tmp_path, told().dive)
    path = tmp_path / "dvl.json"
    lines[7] = lines[7][:120]
    lines[9] = lines[9].replace('"vx"', '"v,x"')
    path.write_text("\n".join(lines) + "\n")
    found = read_dive([path, rest], Config())
    (note,) = [note for note in found.notes if note.code == "log_damaged"]
    assert note.count == 2
    assert f"byte {sum(map(len, lines[:7])) + 7}:" in note.text
    assert "2 reports are lost" in note.text

    for number in range(20, 120):
        lines[number] = lines[number][:-90]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(
        LogError, match=r"102 of \d+ reports are damaged, the first at byte"
    ) as raised:
        read_dive([path, rest], Config())
    assert "--allow-damaged uses" in raised.value.hint
    assert len(read_dive([path, rest], Config(), allow_damaged=True).dvl.time_ns) > 100


def test_a_broken_clock_in_a_report_is_noted(tmp_path: Path) -> None:
    reports = velocity_reports(told())
    reports[30]["time_of_validity"] *= 2
    (tmp_path / "dvl.json").write_text(as_lines(reports))
    log = open_recording(tmp_path / "dvl.json")
    assert [note.code for note in log.notes] == ["clock_set"]
    assert log.channels[0].messages == len(reports) - 1


def early_reports(count: int) -> list[Report]:
    """Reports of the first firmware, which have no clock."""
    report = {"time": 125.0, "vx": 0.1, "vy": 0.0, "vz": 0.0, "velocity_valid": True}
    return [dict(report) for _ in range(count)]


def test_report_without_the_time_since_the_last_one_is_lost_alone(tmp_path: Path) -> None:
    reports = early_reports(100)
    reports[50]["time"] = None
    (tmp_path / "dvl.json").write_text(as_lines(reports))
    log = open_recording(tmp_path / "dvl.json")
    (times,) = log.log_times().values()
    assert len(times) == 99
    assert times[-1] == 99 * 125_000_000
    assert {note.code for note in log.notes} == {"times_summed", "log_damaged"}


def test_list_with_a_byte_order_mark_and_without_its_end(tmp_path: Path) -> None:
    text = as_list(early_reports(100))
    (tmp_path / "dvl.json").write_bytes(b"\xef\xbb\xbf" + text[:-20].encode())
    log = open_recording(tmp_path / "dvl.json")
    assert log.channels[0].messages == 99
    begin = 3 + text.rfind("{")
    damaged = [note.text for note in log.notes if note.code == "log_damaged"]
    assert f"1 report is lost (byte {begin}: an element of the list is cut" in damaged[0]


def test_many_empty_lines_take_no_time(tmp_path: Path) -> None:
    text = as_lines(early_reports(10))
    (tmp_path / "dvl.json").write_text(text + "\n" * 900_000 + text)
    assert open_recording(tmp_path / "dvl.json").channels[0].messages == 20
