"""Files of instruments in their published layouts replay as the MCAP of the same dive, to the steps of the format."""

from dataclasses import replace
from pathlib import Path
from random import Random

import instrument_logs
import numpy as np
import pytest
from instrument_logs import Told, told
from instrument_writers import (
    FORMATS,
    TITLES,
    Written,
    as_table,
    cerulean_extended,
    nmea,
    nucleus,
    packets,
    wl,
    wru,
    wrz,
)

from insdvl_replay.batch.dive_paths import INSTRUMENT_SUFFIXES
from insdvl_replay.core.config import Config, Filter, Heading, Initial, Solution
from insdvl_replay.core.errors import LogError
from insdvl_replay.geometry.rotation import rpy_from_mat, vector_from_mat
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats import known_formats
from insdvl_replay.logs.formats.recording import Recording, open_recording

KINDS = pytest.mark.parametrize("kind", FORMATS)
PROTECTED = [kind for kind, known in FORMATS.items() if known.is_protected]


def written(folder: Path, kind: str) -> tuple[Written, Told, list[Path]]:
    """Write a file, and the MCAP of what it lacks; return what the dive says with the numbers of the format."""
    known = FORMATS[kind]
    dive = known.said(told())
    path = folder / known.name
    source = dive if known.has_imu else told()
    path.write_bytes(known.write(source))
    return (
        known,
        dive,
        [path, instrument_logs.write_rest(folder, dive.dive, imu=not known.has_imu)],
    )


@pytest.mark.parametrize(
    "kind",
    [
        kind
        if kind in ("nucleus", "water_linked_serial")
        else pytest.param(kind, marks=pytest.mark.nightly)
        for kind in FORMATS
    ],  # one that has an IMU and one that has none; `test_teledyne` replays those of Teledyne each day
)
def test_replay_is_that_of_the_mcap(kind: str, tmp_path: Path) -> None:
    known, dive, paths = written(tmp_path, kind)
    apart_mps, apart_m = instrument_logs.compare(
        paths, dive.dive, tmp_path, atol_mps=known.atol_mps, atol_m=0.02
    )
    assert apart_mps <= known.atol_mps
    assert apart_m <= max(0.1, 10.0 * known.atol_mps)


@KINDS
def test_any_name_will_do(kind: str, tmp_path: Path) -> None:
    """Bytes decide, not endings."""
    known, _, paths = written(tmp_path, kind)
    expected = open_recording(paths[0])
    for name in ("dive.mcap", "dive.BIN", "dive.csv", "dive"):
        (tmp_path / name).write_bytes(paths[0].read_bytes())
        found = open_recording(tmp_path / name)
        assert [channel.messages for channel in found.channels] == [
            channel.messages for channel in expected.channels
        ], known.name


@KINDS
def test_a_file_without_its_end_is_noted(kind: str, tmp_path: Path) -> None:
    _, _, paths = written(tmp_path, kind)
    whole = open_recording(paths[0])
    assert not whole.notes
    content = paths[0].read_bytes()
    paths[0].write_bytes(content[:-20])
    log = open_recording(paths[0])
    assert "log_damaged" in {note.code for note in log.notes}


def read_bytes(log: Recording) -> bytes:
    """Return all that is read of a log."""
    channels = {channel.id for channel in log.channels}
    return b"".join(bytes(block.buffer) for block in log.blocks(channels))


@pytest.mark.parametrize("kind", PROTECTED)
def test_a_changed_byte_changes_no_number_unnoticed(kind: str, tmp_path: Path) -> None:
    """With a checksum every change is noted."""
    _, _, paths = written(tmp_path, kind)
    content = paths[0].read_bytes()
    clean = read_bytes(open_recording(paths[0]))
    for seed in range(40):
        rng = Random(seed)
        place = rng.randrange(len(content))
        changed = bytes([content[place] ^ 1 << rng.randrange(8)])
        paths[0].write_bytes(content[:place] + changed + content[place + 1 :])
        log = open_recording(paths[0])
        assert log.notes or read_bytes(log) == clean, seed


@KINDS
def test_a_dvl_alone_says_how_to_add_the_imu(kind: str, tmp_path: Path) -> None:
    known, _, paths = written(tmp_path, kind)
    if known.has_imu:
        assert len(read_dive(paths[0], Config()).imu.time_ns) > 1000
        return
    with pytest.raises(LogError, match="has no IMU: it has dvl/") as raised:
        read_dive(paths[0], Config())
    assert f"insdvl-replay run --one-dive {paths[0]} imu.csv" in raised.value.hint


def test_a_dvl_next_to_the_only_log_of_a_folder_is_named(tmp_path: Path) -> None:
    """A folder with logs stands for each of them, so that the file of the DVL would go unread."""
    log, dvl = _log_and_dvl(tmp_path)
    with pytest.raises(LogError, match="has no DVL") as raised:
        read_dive(log, Config())
    command = f"`insdvl-replay run --one-dive '{log}' '{dvl}'`"
    assert f"dvl.txt beside it is of a DVL: {command}; for other types" in raised.value.hint
    with pytest.raises(LogError, match="has no IMU") as raised:
        read_dive(dvl, Config())
    assert raised.value.hint == f"if vehicle.mcap beside it has one: {command}"
    (said,) = [note for note in open_recording(log).notes if note.code == "dvl_unread"]
    assert said.hint.endswith(command.strip("`"))
    assert len(read_dive([log, dvl], Config()).dvl.time_ns) == sum(told().is_valid)
    assert "dvl_unread" not in {note.code for note in open_recording([log, dvl]).notes}


@pytest.mark.parametrize("other", ["second.mcap", "dvl2.txt"])
def test_files_that_may_belong_to_others_are_not_named(other: str, tmp_path: Path) -> None:
    log, dvl = _log_and_dvl(tmp_path)
    source = log if other == "second.mcap" else dvl
    (log.parent / other).write_bytes(source.read_bytes())
    with pytest.raises(LogError, match="has no DVL") as raised:
        read_dive(log, Config())
    assert "--one-dive" not in raised.value.hint
    assert "dvl_unread" not in {note.code for note in open_recording(log).notes}


def _log_and_dvl(tmp_path: Path) -> tuple[Path, Path]:
    """Write a log without a DVL and the file of one into a folder whose name has a blank."""
    _, _, (dvl, rest) = written(tmp_path, "water_linked_serial")
    folder = tmp_path / "dive 7"
    folder.mkdir()
    return rest.rename(folder / "vehicle.mcap"), dvl.rename(folder / "dvl.txt")


def test_formats_of_a_dvl_alone_lack_an_imu() -> None:
    for known in known_formats.FORMATS:
        assert known.is_dvl == ("IMU" in known.lacks), known.name


def test_folders_are_searched_for_the_endings_of_all_formats() -> None:
    endings: set[str] = set()
    for known in known_formats.FORMATS:
        endings.update(known.endings)
    assert endings == INSTRUMENT_SUFFIXES


def test_transducers_in_front_of_their_velocity_are_found(tmp_path: Path) -> None:
    dive = told()
    pings = range(len(dive.time_ns))
    rest = instrument_logs.write_rest(tmp_path, dive.dive)
    whole = read_dive(instrument_logs.write_whole(tmp_path, dive.dive), Config())
    (tmp_path / "dvl.txt").write_bytes(b"".join(wru(dive, n) + wrz(dive, n) for n in pings))
    found = read_dive([tmp_path / "dvl.txt", rest], Config())
    instrument_logs.assert_same_dvl(found, whole, 0.000501)


def test_examples_of_the_makers_have_their_checksums() -> None:
    assert wl("wru,0,0.070,1.10,-40,-95") == b"wru,0,0.070,1.10,-40,-95*9c\r\n"
    example = (
        "PNORBT7,1452244916.7508,1.234,-1.234,0.1234,0.1234,0.1234,12.34,23.45,23.45,23.45,23.45"
    )
    assert nmea(example).endswith(b",23.45*39\r\n")


def test_early_velocities_count_from_0_and_give_way_to_later_ones(tmp_path: Path) -> None:
    early = [wl(f"wrx,200.00,0.{n:03d},0.010,0.006,0.000,0.93,y,0") for n in range(100, 160)]
    (tmp_path / "dvl.txt").write_bytes(b"".join(early))
    log = open_recording(tmp_path / "dvl.txt")
    assert [note.code for note in log.notes] == ["times_summed"]
    np.testing.assert_array_equal(log.log_times()[0], 200_000_000 * np.arange(1, 61))

    dive = told()
    both = b"".join(early[n % 60] + wrz(dive, n) for n in range(len(dive.time_ns)))
    (tmp_path / "dvl.txt").write_bytes(both)
    log = open_recording(tmp_path / "dvl.txt")
    assert [note.code for note in log.notes] == ["other_records"]
    np.testing.assert_array_equal(log.log_times()[0], dive.time_ns)


def test_sentences_of_nortek_with_names_and_status(tmp_path: Path) -> None:
    """Those of an even number name their cells; a status without its velocity bits marks a ping as invalid."""
    lines = []
    for n in range(60):
        status = "0x0000000F" if n % 10 == 5 else "0x0000700F"
        cells = f"TIME={1452244916 + n}.7508,DT1=1.2,DT2=-1.2,VX={1 + n * 0.01:.4f},VY=0.1,VZ=0.1,FM=0.1"
        lines.append(
            nmea(
                f"PNORBT8,{cells},D1=2,D2=2,D3=2,D4=2,BV=23.4,SS=1567.8,P=1.2,T=12.3,STAT={status}"
            )
        )
        lines.append(nmea("PNORBT4,1.234,-1.234,1.234,23.4,12.34567,12.3"))
    (tmp_path / "dvl.nmea").write_bytes(b"".join(lines))
    log = open_recording(tmp_path / "dvl.nmea")
    assert log.channels[0].messages == 60
    assert [note.text for note in log.notes] == [
        "dvl.nmea: 60 sentences are of other kinds and are left out: PNORBT4 (60)"
    ]


def test_sentences_without_velocities_are_refused_with_what_there_is(tmp_path: Path) -> None:
    line = nmea("PNORBT7,1452244916.7508,1.2,-1.2,a,b,c,0.1,2,2,2,2")
    other = nmea("PNORBT4,1.234,-1.234,1.234,23.4,12.34567,12.3")
    (tmp_path / "dvl.nmea").write_bytes(line + 3 * other)
    with pytest.raises(LogError, match="has no sentences that can be used") as raised:
        read_dive(tmp_path / "dvl.nmea", Config())
    assert "cells of PNORBT7 are not as they should" in raised.value.message
    assert "PNORBT4" in raised.value.message


def test_displacements_are_valid_in_the_middle_of_their_interval(tmp_path: Path) -> None:
    _, dive, paths = written(tmp_path, "cerulean")
    found = read_dive(paths, Config())
    np.testing.assert_array_equal(found.dvl.time_ns, dive.time_ns)


def test_velocities_of_the_earth_of_a_dvl_75_are_turned_back(tmp_path: Path) -> None:
    dive = told()
    (tmp_path / "dvl.log").write_bytes(cerulean_extended(dive))
    log = open_recording(tmp_path / "dvl.log")
    codes = [note.code for note in log.notes]
    assert codes == ["times_summed", "dvl_turned_back", "dvl_vertical_unsure"]
    found = read_dive([tmp_path / "dvl.log", _imu_since_0(tmp_path, dive)], Config())
    pings = np.flatnonzero(dive.is_valid)
    assert found.dvl.velocity_d is not None
    known = np.isfinite(found.dvl.velocity_d).all(axis=1)
    np.testing.assert_array_equal(found.dvl.time_ns[known], (1 + pings) * 200_000_000)
    np.testing.assert_allclose(
        found.dvl.velocity_d[known], dive.velocity_d[pings], rtol=0, atol=0.0009
    )


def _imu_since_0(folder: Path, dive: Told) -> Path:
    """Write the IMU of a dive by a clock that begins with it."""
    imu = dive.dive.imu
    since_0 = replace(imu, time_ns=imu.time_ns - imu.time_ns[0])
    alone = replace(dive.dive, imu=since_0, reference=None, truth=None)
    return instrument_logs.write_rest(folder, alone)


def test_attitudes_of_a_dvl_75_have_the_bow_up_where_the_pitch_is_positive(tmp_path: Path) -> None:
    dive = told()
    (tmp_path / "dvl.log").write_bytes(cerulean_extended(dive))
    aided = Filter(aiding=("velocity", "heading"))
    settings = Config(
        filters={"aided": aided},
        heading=Heading(topic="dvl/attitude"),
        initial=Initial(source="sensor"),
    )
    paths = [tmp_path / "dvl.log", _imu_since_0(tmp_path, dive)]
    found = read_dive(paths, settings).sensors["heading"].mat_nb
    assert found is not None
    assert dive.dive.reference is not None
    rows = np.searchsorted(dive.dive.reference.time_ns, dive.time_ns, "right") - 1
    off = np.swapaxes(dive.dive.reference.mat_nb[rows], -1, -2) @ found
    assert np.degrees(np.abs(vector_from_mat(off))).max() < 0.08


@pytest.mark.parametrize("lock", ["", "x", "TT"])
def test_a_lock_that_is_neither_t_nor_f_is_damage(lock: str, tmp_path: Path) -> None:
    lines = cerulean_extended(told()).split(b"\r\n")
    cells = lines[7].decode().partition("*")[0].removeprefix("$").split(",")
    cells[1] = lock
    lines[7] = nmea(",".join(cells)).rstrip()
    (tmp_path / "dvl.log").write_bytes(b"\r\n".join(lines))
    said = open_recording(tmp_path / "dvl.log").notes
    (damaged,) = [note for note in said if note.code == "log_damaged"]
    assert "cells of DVEXT are not as they should" in damaged.text


def test_displacements_go_before_velocities_of_the_same_file(tmp_path: Path) -> None:
    dive = told().of_velocities()
    extended = cerulean_extended(dive).split(b"\r\n")
    displacements = FORMATS["cerulean"].write(dive).split(b"\r\n")
    lines = []
    for first, second in zip(extended, displacements, strict=True):
        lines += [first, second]
    (tmp_path / "dvl.log").write_bytes(b"\r\n".join(lines))
    log = open_recording(tmp_path / "dvl.log")
    assert [channel.topic for channel in log.channels] == ["dvl/position_delta"]
    assert [note.code for note in log.notes] == ["other_records"]


@pytest.mark.parametrize("kind", ["PNORBT0", "PNORBT1", "PNORBT3", "PNORBT4"])
def test_sentences_of_nortek_that_are_not_read_are_named(kind: str, tmp_path: Path) -> None:
    (tmp_path / "dvl.log").write_bytes(5 * nmea(f"{kind},1.234,-1.234,1.234,23.4,12.3,12.3"))
    with pytest.raises(
        LogError, match=f"has no sentences that can be used; it has {kind}"
    ) as raised:
        read_dive(tmp_path / "dvl.log", Config())
    assert "$PNORBT7" in raised.value.hint


def test_rows_of_a_nucleus_that_are_damaged_and_texts_between_them(tmp_path: Path) -> None:
    dive = told().single()
    rows = packets(dive)
    rows.insert(40, {**rows[40], "id": 160, "string": 'SETDVL,"a"\r\nOK\r\n'})
    lines = as_table(rows).split(b"\r\n")
    lines[100] += b","
    lines[200] = lines[200][:20] + b"x" + lines[200][20:]
    path = tmp_path / "nucleus_log.csv"
    path.write_bytes(b"\r\n".join(lines))
    log = open_recording(path)
    counts = {note.code: note.count for note in log.notes}
    assert counts["log_damaged"] == 2
    assert counts["other_records"] >= 2
    whole = len(dive.dive.imu.time_ns) + len(dive.time_ns)
    assert sum(channel.messages for channel in log.channels) == whole - 2


def test_rows_of_a_nucleus_with_other_microseconds_than_a_second_has_are_damaged(
    tmp_path: Path,
) -> None:
    dive = told().single()
    rows = packets(dive)
    rows[40]["microSeconds"] = -1
    rows[60]["microSeconds"] = 1_000_000
    path = tmp_path / "nucleus_log.csv"
    path.write_bytes(as_table(rows))
    log = open_recording(path)
    assert {note.code: note.count for note in log.notes}["log_damaged"] == 2
    whole = len(dive.dive.imu.time_ns) + len(dive.time_ns)
    assert sum(channel.messages for channel in log.channels) == whole - 2


def test_water_track_and_broken_samples_of_a_nucleus_are_left_out(tmp_path: Path) -> None:
    dive = told().single()
    rows = packets(dive)
    for row in rows[::50]:
        if row["id"] == 130:
            row["status.isValid"] = False
    pings = [row for row in rows if row["id"] == 180]
    for row in pings[:20]:
        row["id"] = 190
    (tmp_path / "nucleus_log.csv").write_bytes(as_table(rows))
    found = read_dive(tmp_path / "nucleus_log.csv", Config())
    counts = {note.code: note.count for note in found.notes}
    assert counts["dvl_water_track"] == 20
    assert counts["imu_not_finite"] > 40
    assert nucleus(dive).startswith(b"sizeHeader,id,")


def test_a_table_whose_lines_do_not_end_is_refused(tmp_path: Path) -> None:
    content = nucleus(told().single()).replace(b"\r\n", b"\0")
    (tmp_path / "nucleus_log.csv").write_bytes(content * 3)
    with pytest.raises(LogError, match="has no rows that can be used"):
        read_dive(tmp_path / "nucleus_log.csv", Config())


def test_sentences_that_lost_their_ends_and_what_is_in_front_of_them(tmp_path: Path) -> None:
    lines = FORMATS["nortek"].write(told()).split(b"\r\n")
    path = tmp_path / "dvl.nmea"
    stamped = [
        b"2026-05-01 10:%02d:%02d,%03d " % (n // 60, n % 60, n) + line
        for n, line in enumerate(lines[:-1])
    ]
    path.write_bytes(b"\r\n".join([*stamped, b""]))
    assert not open_recording(path).notes

    joined = [lines[0] + lines[1], *lines[2:8], lines[8][30:-3] + lines[9], *lines[10:]]
    path.write_bytes(b"\r\n".join(joined))
    log = open_recording(path)
    assert log.channels[0].messages == len(lines) - 2
    (note,) = log.notes
    assert note.code == "log_damaged"
    assert "something else is in front of a sentence in its line" in note.text


@pytest.mark.parametrize("ending", ["txt", "dat", "asc"])
def test_a_table_may_be_named_as_a_text(ending: str, tmp_path: Path) -> None:
    text = "".join(f"{0.1 * n:.1f} {n} {2 * n}\n" for n in range(50))
    path = tmp_path / f"imu.{ending}"
    path.write_text(f"time_s x y\n{text}")
    (channel,) = open_recording(path).channels
    assert (channel.type_name, channel.messages) == ("table", 50)
    path.write_text("calm sea\nno wind\n")
    with pytest.raises(LogError, match="is no table"):
        open_recording(path)


def test_solution_of_a_nucleus_can_be_judged(tmp_path: Path) -> None:
    dive = told().single()
    reference = dive.dive.reference
    assert reference is not None
    rows = packets(dive)
    rpy_deg = np.rad2deg(rpy_from_mat(reference.mat_nb))
    for number, time_ns in enumerate(reference.time_ns.tolist()):
        latitude, longitude = np.rad2deg(reference.position[number, :2])
        row = {"id": 220, "timeStamp": time_ns // 10**9, "microSeconds": time_ns % 10**9 // 1000}
        row |= {
            "latitude": latitude,
            "longitude": longitude,
            "statusIns.latLonIsValid": number > 4,
        }
        for place, axis in enumerate("XYZ"):
            row[f"velocityNed{axis}"] = reference.velocity_n[number, place]
        for place, angle in enumerate(("roll", "pitch", "heading")):
            row[f"ahrsData.{angle}"] = rpy_deg[number, place]
        rows.append(row)
    path = tmp_path / "nucleus_log.csv"
    path.write_bytes(as_table(rows, [*TITLES, "statusIns.latLonIsValid"]))
    config = Config(filters={"own": Filter(solution=Solution(topic="nucleus/ins"))})
    found = read_dive(path, config).solutions["own"].motion
    np.testing.assert_array_equal(found.time_ns, reference.time_ns)
    assert np.isnan(found.position[:5, :2]).all()
    np.testing.assert_allclose(found.position[5:, :2], reference.position[5:, :2], atol=1e-12)
    np.testing.assert_allclose(found.mat_nb[5:], reference.mat_nb[5:], atol=1e-9)


TEXTS = [kind for kind in FORMATS if kind not in {"ardupilot", "px4", "pd0", "pd4", "pd5"}]


@pytest.mark.parametrize("kind", TEXTS)
def test_byte_order_mark_is_no_content(kind: str, tmp_path: Path) -> None:
    _, _, paths = written(tmp_path, kind)
    expected = open_recording(paths[0])
    paths[0].write_bytes(b"\xef\xbb\xbf" + paths[0].read_bytes())
    found = open_recording(paths[0])
    assert [one.messages for one in found.channels] == [one.messages for one in expected.channels]
    assert not found.notes


def test_byte_order_mark_is_no_part_of_a_title(tmp_path: Path) -> None:
    titles = ["timeStamp", "microSeconds"]
    titles += [title for title in TITLES if title not in titles]
    content = as_table(packets(told().single()), titles)
    (tmp_path / "nucleus_log.csv").write_bytes(b"\xef\xbb\xbf" + content)
    assert len(open_recording(tmp_path / "nucleus_log.csv").channels) == 2


def test_many_beginnings_of_sentences_take_no_time(tmp_path: Path) -> None:
    _, _, paths = written(tmp_path, "water_linked_serial")
    expected = open_recording(paths[0]).channels[0].messages
    content = paths[0].read_bytes()
    paths[0].write_bytes(content + 4 * (b"wra" * 300_000 + b"\r\n") + content)
    assert open_recording(paths[0]).channels[0].messages == 2 * expected


@pytest.mark.parametrize(
    ("count", "said"),
    [(1, "1 line is of other kinds and is left"), (2, "2 lines are of other kinds and are left")],
)
def test_one_of_something_is_no_plural(count: int, said: str, tmp_path: Path) -> None:
    _, _, paths = written(tmp_path, "pd6")
    paths[0].write_bytes(paths[0].read_bytes() + b"calm sea\r\n" * count)
    (note,) = open_recording(paths[0]).notes
    assert said in note.text
