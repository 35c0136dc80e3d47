"""PD0, PD4, PD5 and PD6 of Teledyne's DVLs, in the published layouts, replay as the MCAP of the same dive does."""

import struct
from dataclasses import replace
from pathlib import Path

import instrument_logs
import numpy as np
import pytest
import teledyne_logs
from instrument_logs import Told
from teledyne_logs import BEAM, EARTH, INSTRUMENT, SHIP, Setup

from insdvl_replay.core.config import Config, Filter, Heading
from insdvl_replay.core.dive_columns import Dive, DvlColumns
from insdvl_replay.core.errors import LogError
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.recording import open_recording

HALF_STEP_MPS = 0.0005001  # of mm/s
# A velocity that was turned is rounded along other axes.
TURNED_MPS = HALF_STEP_MPS * np.sqrt(3.0)


def read_with(folder: Path, name: str, content: bytes, dive: Dive) -> Dive:
    """Write a file of a DVL, and read it with the MCAP of the rest of the dive."""
    (folder / name).write_bytes(content)
    return read_dive([folder / name, instrument_logs.write_rest(folder, dive)], Config())


def largest_mps(found: DvlColumns, dive: Told) -> float:
    """Return the largest difference between the velocities of a DVL and those of a dive."""
    assert found.velocity_d is not None
    np.testing.assert_array_equal(found.time_ns, dive.time_ns)
    return float(np.abs(found.velocity_d - dive.velocity_d).max())


def codes(dive: Dive) -> dict[str, int]:
    return {note.code: note.count for note in dive.notes}


# --- PD0.


@pytest.mark.parametrize(
    "setup",
    [
        Setup(),
        Setup(alignment_deg=45.0),
        Setup(alignment_deg=-135.0, beam_angle=1),
        Setup(beam_angle=3),
        Setup(has_century=False),
    ],
)
def test_beams_of_pd0_are_those_of_the_mcap(setup: Setup, tmp_path: Path) -> None:
    tilt_deg = {1: 20.0, 2: 30.0, 3: 25.0}[setup.beam_angle]
    dive = teledyne_logs.dvl_told(setup.alignment_deg, tilt_deg)
    content = b"".join(teledyne_logs.pd0(dive, setup))
    found = read_with(tmp_path, "dvl.pd0", content, dive.dive)
    whole = read_dive(instrument_logs.write_whole(tmp_path, dive.dive), Config())
    apart_mps = instrument_logs.assert_same_dvl(found, whole, HALF_STEP_MPS)
    assert apart_mps > 0.0003
    assert codes(found).get("dvl_alignment", 0) == (
        len(dive.time_ns) if setup.alignment_deg else 0
    )


@pytest.mark.parametrize(
    ("setup", "azimuths_deg", "down"),
    [
        (Setup(looks_up=True), [90.0, 270.0, 0.0, 180.0], -1.0),
        (Setup(is_convex=False), [90.0, 270.0, 180.0, 0.0], 1.0),
        (Setup(is_convex=False, alignment_deg=45.0), [135.0, 315.0, 225.0, 45.0], 1.0),
    ],
)
def test_beams_of_other_heads_point_elsewhere(
    setup: Setup, azimuths_deg: list[float], down: float, tmp_path: Path
) -> None:
    dive = teledyne_logs.dvl_told()
    content = b"".join(teledyne_logs.pd0(dive, setup))
    found = read_with(tmp_path, "dvl.pd0", content, dive.dive)
    sine = np.sin(np.radians(30.0))
    azimuths = np.radians(azimuths_deg)
    cosines = np.full(4, down * np.cos(np.radians(30.0)))
    expected = np.column_stack([sine * np.cos(azimuths), sine * np.sin(azimuths), cosines])
    np.testing.assert_allclose(found.dvl.beam_vectors_d, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("setup", "atol_mps"),
    [
        (Setup(INSTRUMENT), HALF_STEP_MPS),
        (Setup(INSTRUMENT, uses_tilts=True), HALF_STEP_MPS),
        (Setup(INSTRUMENT, looks_up=True), HALF_STEP_MPS),
        (Setup(INSTRUMENT, alignment_deg=45.0), TURNED_MPS),
        (Setup(INSTRUMENT, alignment_deg=-30.0, looks_up=True), TURNED_MPS),
        (Setup(SHIP), HALF_STEP_MPS),
        (Setup(SHIP, uses_tilts=True), TURNED_MPS),
        (Setup(EARTH), TURNED_MPS),
        (Setup(EARTH, uses_tilts=True), TURNED_MPS),
    ],
)
def test_velocities_of_pd0_are_the_vehicles_in_all_coordinates(
    setup: Setup, atol_mps: float, tmp_path: Path
) -> None:
    dive = teledyne_logs.dvl_told().of_velocities()
    content = b"".join(teledyne_logs.pd0(dive, setup))
    found = read_with(tmp_path, "dvl.pd0", content, dive.dive)
    assert 0.0003 < largest_mps(found.dvl, dive) < atol_mps
    is_turned = setup.coordinates == EARTH or (setup.coordinates == SHIP and setup.uses_tilts)
    assert ("dvl_turned_back" in codes(found)) == is_turned


def test_lost_pings_have_no_velocity(tmp_path: Path) -> None:
    dive = teledyne_logs.dvl_told()
    content = b"".join(teledyne_logs.pd0(dive, Setup(SHIP)))
    found = read_with(tmp_path, "dvl.pd0", content, dive.dive)
    lost = len(dive.time_ns) - len(dive.of_velocities().time_ns)
    assert lost > 5
    assert len(found.dvl.time_ns) == len(dive.time_ns) - lost


def test_replay_of_pd0_is_that_of_the_mcap(tmp_path: Path) -> None:
    dive = teledyne_logs.dvl_told()
    (tmp_path / "dvl.pd0").write_bytes(b"".join(teledyne_logs.pd0(dive)))
    paths = [tmp_path / "dvl.pd0", instrument_logs.write_rest(tmp_path, dive.dive)]
    _, apart_m = instrument_logs.compare(
        paths, dive.dive, tmp_path, atol_mps=HALF_STEP_MPS, atol_m=0.004
    )
    assert apart_m > 0.0


def test_attitude_and_depth_of_pd0_aid_a_filter(tmp_path: Path) -> None:
    dive = teledyne_logs.dvl_told()
    (tmp_path / "dvl.pd0").write_bytes(b"".join(teledyne_logs.pd0(dive)))
    paths = [tmp_path / "dvl.pd0", instrument_logs.write_rest(tmp_path, dive.dive)]
    aided = Filter(aiding=("velocity", "depth", "heading"), states=("position",))
    config = Config(filters={"aided": aided}, heading=Heading(topic="dvl/attitude"))
    found = read_dive(paths, config)
    reference = dive.dive.reference
    assert reference is not None
    rows = np.searchsorted(reference.time_ns, dive.time_ns, "right") - 1
    heading = rpy_from_mat(reference.mat_nb[rows])[:, 2]
    apart = found.sensors["heading"].values[:, 0] - heading
    assert np.abs(np.angle(np.exp(1j * apart))).max() < np.radians(0.0051)
    depth_m = found.sensors["depth"].values[:, 0]
    np.testing.assert_allclose(depth_m, -reference.position[rows, 2], rtol=0, atol=0.0006)


def test_depth_in_decimetres_is_read_where_there_is_no_pressure(tmp_path: Path) -> None:
    dive = teledyne_logs.dvl_told()
    content = b"".join(teledyne_logs.pd0(dive, Setup(has_century=False)))
    (tmp_path / "dvl.pd0").write_bytes(content)
    log = open_recording(tmp_path / "dvl.pd0")
    kinds = {channel.topic: channel.schema_data for channel in log.channels}
    assert kinds.keys() == {"dvl/velocity", "dvl/attitude", "dvl/depth"}
    assert kinds["dvl/depth"] == b'[["depth",1]]'
    (channel,) = [one for one in log.channels if one.topic == "dvl/depth"]
    (block,) = log.blocks({channel.id})
    depth_m = np.frombuffer(block.buffer, np.float64).reshape(channel.messages, -1)[:, 1]
    poses = teledyne_logs.poses(dive)
    np.testing.assert_allclose(depth_m, [pose.depth_m for pose in poses], rtol=0, atol=0.0501)


def test_what_a_person_has_set_is_no_sensor(tmp_path: Path) -> None:
    dive = teledyne_logs.dvl_told()
    content = bytearray()
    for ensemble in teledyne_logs.pd0(dive):
        sound = bytearray(ensemble[:-2])
        leader = struct.unpack_from("<H", sound, 8)[0]
        sound[leader + 16 : leader + 24] = bytes(8)  # depth, heading, pitch, roll
        sound[leader + 48 : leader + 52] = bytes(4)  # pressure
        content += teledyne_logs.summed(bytes(sound))
    (tmp_path / "dvl.pd0").write_bytes(content)
    log = open_recording(tmp_path / "dvl.pd0")
    assert [channel.topic for channel in log.channels] == ["dvl/velocity"]


def test_single_damaged_ensembles_are_a_note_and_many_are_refused(tmp_path: Path) -> None:
    dive = teledyne_logs.dvl_told()
    ensembles = teledyne_logs.pd0(dive)
    sound = list(ensembles)
    ensembles[7] = ensembles[7][:90] + bytes([ensembles[7][90] ^ 1]) + ensembles[7][91:]
    ensembles[20] = ensembles[20][:100]
    ensembles[40] += b"[ALERT] wakeup\r\n\x7f"
    ensembles[-1] = ensembles[-1][:-5]
    path = tmp_path / "dvl.pd0"
    path.write_bytes(b"\x00\x7f" + b"".join(ensembles))
    rest = instrument_logs.write_rest(tmp_path, dive.dive)
    found = read_dive([path, rest], Config())
    notes = {note.code: note for note in found.notes}
    assert notes["log_damaged"].count == 3
    assert f"byte {2 + sum(map(len, sound[:7]))}:" in notes["log_damaged"].text
    assert "3 ensembles are lost" in notes["log_damaged"].text
    assert notes["other_records"].count == 2
    assert len(found.dvl.time_ns) == len(teledyne_logs.dvl_told().time_ns) - 3 - lost_pings(dive)

    for number in range(50, 100):
        ensembles[number] = sound[number][:-1] + b"\x00"
    path.write_bytes(b"".join(ensembles))
    with pytest.raises(LogError, match=r"\d+ of \d+ ensembles are damaged, the first at byte"):
        read_dive([path, rest], Config())
    usable = read_dive([path, rest], Config(), allow_damaged=True)
    assert len(usable.dvl.time_ns) > 200


def lost_pings(dive: Told) -> int:
    """Return how many pings have no beam at all."""
    return int(np.count_nonzero(np.isnan(dive.beams_mps).all(axis=1)))


def test_ensembles_without_bottom_track_or_with_impossible_times_are_left_out(
    tmp_path: Path,
) -> None:
    dive = teledyne_logs.dvl_told()
    ensembles = teledyne_logs.pd0(dive)
    pose = teledyne_logs.poses(dive)[0]
    leaders = [
        teledyne_logs.fixed_leader(Setup()),
        teledyne_logs.variable_leader(int(dive.time_ns[0]), 1, pose, Setup()),
    ]
    ensembles.insert(3, teledyne_logs.pd0_ensemble(leaders))
    sound = bytearray(ensembles[9][:-2])
    leader = struct.unpack_from("<H", sound, 8)[0]
    sound[leader + 59 : leader + 61] = bytes([2, 30])  # 30 February
    ensembles[9] = teledyne_logs.summed(bytes(sound))
    (tmp_path / "dvl.pd0").write_bytes(b"".join(ensembles))
    log = open_recording(tmp_path / "dvl.pd0")
    said = {note.code: note.text for note in log.notes}
    assert "ensembles without bottom track (1)" in said["other_records"]
    assert "its date and time are none" in said["log_damaged"]


def test_pieces_of_a_large_file_are_joined(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from insdvl_replay.logs.formats import instrument_file

    dive = teledyne_logs.dvl_told()
    (tmp_path / "dvl.pd0").write_bytes(b"".join(teledyne_logs.pd0(dive)))
    whole = open_recording(tmp_path / "dvl.pd0").log_times()
    monkeypatch.setattr(instrument_file, "_PIECE", 1009)
    log = open_recording(tmp_path / "dvl.pd0")
    assert log.notes == ()
    for channel_id, time_ns in log.log_times().items():
        np.testing.assert_array_equal(time_ns, whole[channel_id])


# --- PD4 and PD5.


@pytest.mark.parametrize(
    ("setup", "is_pd5", "atol_mps"),
    [
        (Setup(INSTRUMENT), False, HALF_STEP_MPS),
        (Setup(SHIP), False, HALF_STEP_MPS),
        (Setup(SHIP), True, HALF_STEP_MPS),
        (Setup(SHIP, uses_tilts=True), True, TURNED_MPS),
        (Setup(EARTH, uses_tilts=True), True, TURNED_MPS),
    ],
)
def test_velocities_of_pd4_and_pd5(
    setup: Setup, is_pd5: bool, atol_mps: float, tmp_path: Path
) -> None:
    dive = teledyne_logs.dvl_told().of_velocities()
    content = b"".join(teledyne_logs.pd45(dive, setup, is_pd5=is_pd5))
    found = read_with(tmp_path, "dvl.pd4", content, dive.dive)
    assert 0.0003 < largest_mps(found.dvl, dive) < atol_mps
    assert "times_without_date" in codes(found)


@pytest.mark.parametrize("is_pd5", [False, True])
def test_replay_of_pd4_and_pd5_is_that_of_the_mcap(is_pd5: bool, tmp_path: Path) -> None:
    dive = teledyne_logs.dvl_told().of_velocities()
    setup = Setup(EARTH if is_pd5 else SHIP, uses_tilts=is_pd5)
    content = b"".join(teledyne_logs.pd45(dive, setup, is_pd5=is_pd5))
    (tmp_path / "dvl.pd5").write_bytes(content)
    paths = [tmp_path / "dvl.pd5", instrument_logs.write_rest(tmp_path, dive.dive)]
    _, apart_m = instrument_logs.compare(
        paths, dive.dive, tmp_path, atol_mps=TURNED_MPS, atol_m=0.004
    )
    assert apart_m > 0.0


def test_times_of_day_go_on_after_midnight(tmp_path: Path) -> None:
    dive = teledyne_logs.dvl_told().of_velocities()
    # The dive begins at midnight: 30 s earlier, half of it is on the day before.
    early = replace(dive, time_ns=dive.time_ns - 30_000_000_000)
    content = b"".join(teledyne_logs.pd45(early, Setup(SHIP), is_pd5=False))
    (tmp_path / "dvl.pd4").write_bytes(content)
    (times,) = open_recording(tmp_path / "dvl.pd4").log_times().values()
    np.testing.assert_array_equal(np.diff(times), np.diff(dive.time_ns))


@pytest.mark.parametrize(
    ("setup", "words"),
    [
        (Setup(EARTH), "ensembles in earth coordinates, without the attitude"),
        (Setup(BEAM), "ensembles in beam coordinates, without the angle of the beams"),
    ],
)
def test_coordinates_that_pd4_does_not_explain_are_refused(
    setup: Setup, words: str, tmp_path: Path
) -> None:
    dive = teledyne_logs.dvl_told().of_velocities()
    content = b"".join(teledyne_logs.pd45(dive, setup, is_pd5=False))
    (tmp_path / "dvl.pd4").write_bytes(content)
    with pytest.raises(LogError, match=f"has nothing but {words}") as raised:
        open_recording(tmp_path / "dvl.pd4")
    assert "record PD0" in raised.value.hint


def test_levelled_velocities_without_tilts_are_a_warning(tmp_path: Path) -> None:
    dive = teledyne_logs.dvl_told().of_velocities()
    content = b"".join(teledyne_logs.pd45(dive, Setup(SHIP, uses_tilts=True), is_pd5=False))
    found = read_with(tmp_path, "dvl.pd4", content, dive.dive)
    assert codes(found)["dvl_levelled"] == len(dive.time_ns)


def test_damaged_ensembles_of_pd5(tmp_path: Path) -> None:
    dive = teledyne_logs.dvl_told().of_velocities()
    ensembles = teledyne_logs.pd45(dive, Setup(SHIP), is_pd5=True)
    ensembles[3] = ensembles[3][:50] + b"\xff" + ensembles[3][51:]
    ensembles[8] = ensembles[8][:30]
    bad = bytearray(ensembles[12][:-2])
    bad[35] = 24
    ensembles[12] = teledyne_logs.summed(bytes(bad))
    (tmp_path / "dvl.pd5").write_bytes(b"".join(ensembles))
    log = open_recording(tmp_path / "dvl.pd5")
    assert {note.code: note.count for note in log.notes} == {"log_damaged": 3}
    assert log.channels[0].messages == len(ensembles) - 3


# --- PD6.


@pytest.mark.parametrize(
    ("setups", "atol_mps", "code"),
    [
        ([Setup(INSTRUMENT)], HALF_STEP_MPS, ""),
        ([Setup(INSTRUMENT), Setup(SHIP, uses_tilts=True)], HALF_STEP_MPS, ""),
        ([Setup(SHIP)], HALF_STEP_MPS, "dvl_levelled"),
        ([Setup(EARTH, uses_tilts=True)], TURNED_MPS, "dvl_turned_back"),
    ],
)
def test_velocities_of_pd6(
    setups: list[Setup], atol_mps: float, code: str, tmp_path: Path
) -> None:
    dive = teledyne_logs.dvl_told().of_velocities()
    content = "".join(teledyne_logs.pd6(dive, setups)).encode()
    found = read_with(tmp_path, "dvl.txt", content, dive.dive)
    assert 0.0003 < largest_mps(found.dvl, dive) < atol_mps
    assert codes(found)["other_records"] == 2 * len(dive.time_ns)
    own = codes(found).keys() & {"dvl_levelled", "dvl_turned_back", "dvl_ship_axes"}
    assert own == ({code} if code else set())


def test_replay_of_pd6_is_that_of_the_mcap(tmp_path: Path) -> None:
    dive = teledyne_logs.dvl_told().of_velocities()
    content = "".join(teledyne_logs.pd6(dive, [Setup(INSTRUMENT)]))
    (tmp_path / "dvl.pd6").write_text(content)
    paths = [tmp_path / "dvl.pd6", instrument_logs.write_rest(tmp_path, dive.dive)]
    _, apart_m = instrument_logs.compare(
        paths, dive.dive, tmp_path, atol_mps=HALF_STEP_MPS, atol_m=0.004
    )
    assert apart_m > 0.0


def test_lines_of_pd6_may_have_their_time_of_arrival_in_front(tmp_path: Path) -> None:
    dive = teledyne_logs.dvl_told().of_velocities()
    lines = "".join(teledyne_logs.pd6(dive, [Setup(INSTRUMENT)], has_others=False)).splitlines()
    content = "".join(f"2026-05-01 10:00:00.123 {line}\n" for line in lines)
    found = read_with(tmp_path, "dvl.log", content.encode(), dive.dive)
    assert largest_mps(found.dvl, dive) < HALF_STEP_MPS


def test_bad_velocities_and_other_axes_of_pd6_are_noted(tmp_path: Path) -> None:
    dive = teledyne_logs.dvl_told()
    setups = [Setup(INSTRUMENT, alignment_deg=45.0), Setup(SHIP)]
    content = "".join(teledyne_logs.pd6(dive, setups)).encode()
    found = read_with(tmp_path, "dvl.txt", content, dive.dive)
    assert len(found.dvl.time_ns) == len(dive.of_velocities().time_ns)
    (note,) = [note for note in found.notes if note.code == "dvl_ship_axes"]
    assert "dvl.mounting_rpy_deg = [0, 0, 45]" in note.hint


def test_damaged_lines_of_pd6(tmp_path: Path) -> None:
    dive = teledyne_logs.dvl_told().of_velocities()
    ensembles = teledyne_logs.pd6(dive, [Setup(INSTRUMENT)])
    ensembles[2] = ensembles[2].replace(":BI,", ":BI,x")
    ensembles[4] = ensembles[4].replace(":TS", "TS")
    ensembles[6] = "\n".join(["> cs", ensembles[6]])
    ensembles[9] = ensembles[9].replace(":TS,2401", ":TS,2413")
    ensembles[-1] = ensembles[-1][: ensembles[-1].index(":BI") + 9]
    path = tmp_path / "dvl.log"
    path.write_text("".join(ensembles))
    found = read_dive([path, instrument_logs.write_rest(tmp_path, dive.dive)], Config())
    assert codes(found)["log_damaged"] == 4
    assert len(found.dvl.time_ns) == len(ensembles) - 4


def test_pressure_above_the_water_is_negative(tmp_path: Path) -> None:
    """Less than that of the air, as the number of 32 bits has it."""
    ensembles = []
    for number, ensemble in enumerate(teledyne_logs.pd0(teledyne_logs.dvl_told())):
        changed = bytearray(ensemble[:-2])
        leader = struct.unpack_from("<4H", changed, 6)[1]
        struct.pack_into("<i", changed, leader + 48, number - 50)
        ensembles.append(teledyne_logs.summed(bytes(changed)))
    (tmp_path / "dvl.pd0").write_bytes(b"".join(ensembles))
    log = open_recording(tmp_path / "dvl.pd0")
    (channel,) = [one for one in log.channels if one.topic == "dvl/depth"]
    (block,) = log.blocks({channel.id})
    pressure_pa = np.frombuffer(block.buffer, np.float64).reshape(channel.messages, -1)[:, 1]
    np.testing.assert_array_equal(pressure_pa[:3], [-500.0, -490.0, -480.0])
    assert pressure_pa[60] == 100.0
