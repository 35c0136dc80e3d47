"""What cannot be is found and told with the key that puts it right; what is in order stays unremarked."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from insdvl_replay.checks.dvl import dvl_by_velocity
from insdvl_replay.checks.imu import gyro_by_attitude, gyro_by_gravity
from insdvl_replay.checks.reference import plausibility_notes, track_by_positions, without_frozen
from insdvl_replay.core.config import Config, Dvl, Imu, Initial
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import (
    Dive,
    DvlColumns,
    Floats,
    ImuColumns,
    Mask,
    ReferenceColumns,
    TimeNs,
    seconds,
)
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat, wrap_angle
from insdvl_replay.preparation.prepared import read_checked_dive
from insdvl_replay.sim.dive import simulate_dive

PROJECT = Path(__file__).resolve().parents[2]
DATA = PROJECT.parent / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="needs ../shared/data (real logs)")
Change = Callable[[ImuColumns], ImuColumns]
IGNORE = "; if the reference is wrong: reference.ignore = true"


@pytest.fixture(scope="module")
def turning() -> Dive:
    return simulate_dive("figure-eight", duration_s=200.0, imu_rate_hz=50.0, seed=5)


def reference_of(dive: Dive) -> ReferenceColumns:
    assert dive.reference is not None
    return dive.reference


def positions_only(dive: Dive) -> Dive:
    reference = reference_of(dive)
    bare = replace(
        reference,
        velocity_n=np.full_like(reference.velocity_n, np.nan),
        mat_nb=np.full_like(reference.mat_nb, np.nan),
    )
    return replace(dive, reference=bare)


def notes_of(dive: Dive, config: Config | None = None) -> dict[str, Note]:
    notes = plausibility_notes("a.mcap", dive.imu, dive.dvl, dive.reference, config or Config())
    return {note.code: note for note in notes}


def changed(dive: Dive, force: float = 1.0, rate: float = 1.0) -> Dive:
    imu = dive.imu
    return replace(
        dive, imu=ImuColumns(imu.time_ns, force * imu.specific_force_b, rate * imu.angular_rate_b)
    )


def hinted_scale(hint: str) -> float:
    """Return the scale of the gyros in a hint that also says what to do if the reference is the one that errs."""
    assert hint.endswith(IGNORE)
    return float(hint.removeprefix("imu.angular_rate_scale = ").removesuffix(IGNORE))


def heading_at_start(dive: Dive) -> float:
    return float(rpy_from_mat(reference_of(dive).mat_nb[0])[2])


# In order


@pytest.mark.parametrize("scenario", ["straight", "figure-eight", "lawnmower", "static"])
@pytest.mark.parametrize("grade", ["fog", "mems"])
def test_simulated_dives_are_in_order(scenario: str, grade: str) -> None:
    dive = simulate_dive(scenario, duration_s=120.0, imu_rate_hz=50.0, seed=8, grade=grade)
    assert not notes_of(dive)
    assert not notes_of(positions_only(dive))
    assert not notes_of(replace(dive, reference=None))


@needs_data
@pytest.mark.parametrize("run", ["01", "02", "05", "07", "08", "09", "11", "12"])
def test_real_dives_are_in_order(run: str) -> None:
    config = load_config(file=PROJECT / "examples" / "snapir.toml")
    dive = read_checked_dive(DATA / "snapir" / f"snapir_{run}.mcap", config)
    assert set(notes_of(dive, config)) == ({"reference_scale"} if run in ("11", "12") else set())
    assert not notes_of(positions_only(dive), config)
    assert not notes_of(replace(dive, reference=None), config)


# The IMU by itself


@pytest.mark.parametrize(
    ("factor", "hint"),
    [
        (1.0 / 9.80665, 'imu.specific_force_unit = "g"'),
        (1000.0 / 9.80665, 'imu.specific_force_unit = "mg"'),
        (9.80665, 'imu.specific_force_unit = "m/s2"'),
        (0.54, "imu.specific_force_scale = 0.5"),
        (2.0, "imu.specific_force_scale = 2"),
    ],
    ids=["g taken for m/s2", "mg taken for m/s2", "m/s2 taken for g", "half scale", "twice"],
)
def test_force_in_another_unit_is_refused_with_the_right_one(
    factor: float, hint: str, turning: Dive
) -> None:
    with pytest.raises(LogError, match=r"a\.mcap: .*specific force .*[\d.]+ m/s\^2") as refusal:
        notes_of(changed(turning, force=factor))
    assert refusal.value.hint.startswith(hint)


def test_hinted_scale_counts_the_configured_one(turning: Dive) -> None:
    with pytest.raises(LogError) as refusal:
        notes_of(changed(turning, force=0.5), Config(imu=Imu(specific_force_scale=3.0)))
    assert refusal.value.hint.startswith("imu.specific_force_scale = 1.5")


def test_force_that_is_a_tenth_off_is_a_warning_with_its_first_time(turning: Dive) -> None:
    note = notes_of(changed(turning, force=0.9))["imu_gravity"]
    assert note.severity == "warning"
    assert note.count >= 90, "of some 100 quiet seconds"
    first_s = float(note.text.rsplit(" at ", 1)[1].removesuffix(" s"))
    assert 0.0 <= first_s < 5.0
    assert "imu_gravity" not in notes_of(changed(turning, force=0.97))


def test_force_of_the_opposite_sign_is_reported(turning: Dive) -> None:
    note = notes_of(changed(turning, force=-1.0))["imu_upside_down"]
    assert "imu.axes" in note.hint
    assert "imu.specific_force_axes" in note.hint


def test_imu_of_10_hz_is_refused_unless_allowed_and_of_20_hz_a_warning() -> None:
    slow = simulate_dive("straight", duration_s=60.0, imu_rate_hz=10.0, seed=2)
    with pytest.raises(LogError, match=r"IMU .*\b10\.0 ") as refusal:
        notes_of(slow)
    assert "imu.min_rate_hz = 10" in refusal.value.hint
    assert set(notes_of(slow, Config(imu=Imu(min_rate_hz=10.0)))) == {"imu_slow"}
    medium = simulate_dive("straight", duration_s=60.0, imu_rate_hz=20.0, seed=2)
    assert set(notes_of(medium)) == {"imu_slow"}


@pytest.mark.parametrize("silent", [[(40.0, 70.0)], [(20.0, 27.0), (60.0, 85.0), (140.0, 152.0)]])
def test_fixes_in_a_pause_of_the_dvl_do_not_count_against_the_reference(
    silent: list[tuple[float, float]], turning: Dive
) -> None:
    """Nobody knows how the vehicle moved in a pause, so pairs of fixes with an end inside it compare nothing."""
    ping_s = seconds(turning.dvl.time_ns, turning.dvl.time_ns[0])
    heard = np.ones(len(ping_s), np.bool_)
    for from_s, to_s in silent:
        heard &= (ping_s < from_s) | (ping_s > to_s)
    dive = replace(positions_only(turning), dvl=turning.dvl.rows(heard))
    track = track_by_positions(dive.imu, dive.dvl, reference_of(dive), Config())
    assert track is not None
    assert track.coherence > 0.9999
    assert wrap_angle(np.array(track.heading - heading_at_start(turning))) == pytest.approx(
        0.0, abs=1.0 * DEG
    )
    assert not notes_of(dive)


@pytest.mark.parametrize(
    ("from_s", "to_s", "is_first"), [(120.0, 150.0, True), (50.0, 80.0, False)]
)
def test_a_turn_that_nobody_saw_does_not_count_against_the_reference(
    from_s: float, to_s: float, is_first: bool, turning: Dive
) -> None:
    """A recorder that pauses hides how far the vehicle turned: one rotation fits one side of the pause alone."""

    def recorded(time_ns: TimeNs) -> Mask:
        time_s = seconds(time_ns, turning.imu.time_ns[0])
        return np.asarray((time_s < from_s) | (time_s > to_s))

    reference = reference_of(positions_only(turning))
    dive = replace(
        turning,
        imu=turning.imu.rows(recorded(turning.imu.time_ns)),
        dvl=turning.dvl.rows(recorded(turning.dvl.time_ns)),
        reference=reference.rows(recorded(reference.time_ns)),
    )
    track = track_by_positions(dive.imu, dive.dvl, reference_of(dive), Config())
    assert track is not None
    assert track.coherence > 0.9999
    assert (track.heading is not None) == is_first
    assert "track_contradiction" not in notes_of(dive)


def test_radians_that_are_read_as_degrees_are_refused(turning: Dive) -> None:
    reference = reference_of(positions_only(turning))
    misread = reference.position.copy()
    misread[:, :2] *= DEG
    dive = replace(turning, reference=replace(reference, position=misread))
    with pytest.raises(LogError, match="57 times too little") as refused:
        notes_of(dive)
    assert refused.value.hint == 'reference.angle_unit = "rad"'


def test_a_fix_that_stays_is_not_taken_for_radians(turning: Dive) -> None:
    """Its noise of 0.2 m moves it by about as little, but not as the DVL says."""
    reference = reference_of(positions_only(turning))
    noise = 0.2 / 6.37e6 * np.random.default_rng(1).standard_normal(reference.position.shape)
    still = reference.position[:1] + noise * [1.0, 1.0, 0.0]
    dive = replace(turning, reference=replace(reference, position=still))
    assert track_by_positions(dive.imu, dive.dvl, reference_of(dive), Config()) is None
    notes_of(dive)


def test_positions_that_freeze_under_way_count_as_missing(turning: Dive) -> None:
    reference = reference_of(turning)
    time_s = seconds(reference.time_ns, reference.time_ns[0])
    is_frozen = (time_s > 60.0) & (time_s < 100.0)
    position = reference.position.copy()
    position[is_frozen] = position[np.flatnonzero(is_frozen)[0] - 1]
    found, (note,) = without_frozen(
        turning.imu, turning.dvl, replace(reference, position=position)
    )
    np.testing.assert_array_equal(np.isnan(found.position[:, 0]), is_frozen)
    np.testing.assert_array_equal(found.mat_nb, reference.mat_nb)
    assert (note.code, note.count) == ("reference_frozen", np.count_nonzero(is_frozen))
    assert "reference.ignore" in note.hint
    bare = replace(
        positions_only(turning),
        reference=replace(reference_of(positions_only(turning)), position=found.position),
    )
    assert not notes_of(bare)


def test_an_attitude_that_freezes_in_a_turn_counts_as_missing_and_one_at_rest_stays(
    turning: Dive,
) -> None:
    reference = reference_of(turning)
    mat_nb = reference.mat_nb.copy()
    mat_nb[540:640] = mat_nb[540]
    found, (note,) = without_frozen(turning.imu, turning.dvl, replace(reference, mat_nb=mat_nb))
    assert np.flatnonzero(np.isnan(found.mat_nb[:, 0, 0])).tolist() == list(range(541, 640))
    assert note.count == 99
    still = simulate_dive("static", duration_s=60.0, imu_rate_hz=50.0, seed=8)
    kept, notes = without_frozen(still.imu, still.dvl, reference_of(still))
    assert notes == ()
    np.testing.assert_array_equal(kept.position, reference_of(still).position)


def test_turns_in_a_pause_of_the_imu_do_not_count_against_the_gyros(turning: Dive) -> None:
    sample_s = seconds(turning.imu.time_ns, turning.imu.time_ns[0])
    dive = replace(turning, imu=turning.imu.rows((sample_s < 90.0) | (sample_s > 130.0)))
    found = gyro_by_attitude(dive.imu, reference_of(dive))
    assert found is not None
    assert found.scale == pytest.approx(1.0, abs=0.01)
    assert found.correlation > 0.999
    assert not notes_of(dive)


def test_long_gap_does_not_make_an_imu_slow(turning: Dive) -> None:
    late = np.where(seconds(turning.imu.time_ns, turning.imu.time_ns[0]) > 100.0, 7200 * 10**9, 0)
    imu = replace(turning.imu, time_ns=turning.imu.time_ns + late)
    assert not notes_of(replace(turning, imu=imu, reference=None))


def test_dead_axis_is_named_and_dead_gyros_are_refused(turning: Dive) -> None:
    rate_b = turning.imu.angular_rate_b.copy()
    rate_b[:, 1] = 0.25
    note = notes_of(replace(turning, imu=replace(turning.imu, angular_rate_b=rate_b)))[
        "imu_constant"
    ]
    assert re.search(r"starboard .*0\.25 rad/s", note.text)
    assert note.count == len(rate_b)
    with pytest.raises(LogError, match=r"a\.mcap: .*angular rate") as refusal:
        notes_of(changed(turning, rate=0.0))
    assert "imu.angular_rate" in refusal.value.hint


def test_imu_that_is_still_is_reported_with_its_first_time(turning: Dive) -> None:
    imu = turning.imu
    rows = np.arange(len(imu.time_ns))
    rows[2000:2125] = 2000
    stuck = ImuColumns(imu.time_ns, imu.specific_force_b[rows], imu.angular_rate_b[rows])
    note = notes_of(replace(turning, imu=stuck, reference=None))["imu_stuck"]
    assert note.count == 124
    assert re.search(r"\b40\.0 s.*\b2\.5 s", note.text)


# Gyros


@pytest.mark.parametrize("whose", ["attitude", "positions"])
def test_gyros_in_deg_per_s_are_refused(whose: str, turning: Dive) -> None:
    dive = changed(turning if whose == "attitude" else positions_only(turning), rate=1.0 / DEG)
    with pytest.raises(LogError, match=f"angular rate .* {whose}") as refusal:
        notes_of(dive)
    assert refusal.value.hint == f'imu.angular_rate_unit = "deg/s"{IGNORE}'
    with pytest.raises(LogError) as opposite:
        notes_of(changed(turning, rate=DEG), Config(imu=Imu(angular_rate_unit="deg/s")))
    assert opposite.value.hint == f'imu.angular_rate_unit = "rad/s"{IGNORE}'


def test_a_unit_that_is_set_already_is_not_hinted(turning: Dive) -> None:
    with pytest.raises(LogError) as refusal:
        notes_of(changed(turning, rate=DEG))
    assert hinted_scale(refusal.value.hint) == pytest.approx(DEG, rel=0.03)


@pytest.mark.parametrize("whose", ["attitude", "positions"])
def test_gyros_of_another_scale_are_reported_with_it(whose: str, turning: Dive) -> None:
    dive = changed(turning if whose == "attitude" else positions_only(turning), rate=0.6)
    note = notes_of(dive, Config(imu=Imu(angular_rate_scale=2.0)))["imu_gyro_scale"]
    assert note.severity == "warning"
    assert hinted_scale(note.hint) == pytest.approx(1.2, rel=0.03)


def test_gyros_that_turn_the_other_way_are_reported(turning: Dive) -> None:
    note = notes_of(changed(turning, rate=-1.0))["imu_gyro_sign"]
    assert "imu.axes" in note.hint


def test_gyros_that_do_not_follow_the_reference_are_reported(turning: Dive) -> None:
    swapped = turning.imu.angular_rate_b[:, [2, 1, 0]]
    assert "imu_gyro_contradiction" in notes_of(
        replace(turning, imu=replace(turning.imu, angular_rate_b=swapped))
    )


def test_imu_that_is_built_in_obliquely_is_not_blamed(turning: Dive) -> None:
    """The gyros follow the attitude in turned axes: a constant rotation, which the hint names."""
    turn = mat_from_rpy(np.array([10.0, 30.0, 0.0]) * DEG)
    imu = turning.imu
    oblique = ImuColumns(imu.time_ns, imu.specific_force_b @ turn, imu.angular_rate_b @ turn)
    notes = notes_of(replace(turning, imu=oblique))
    assert "imu_gyro_contradiction" not in notes
    found = re.findall(r"imu.mounting_rpy_deg = \[(.*?)\]", notes["imu_turned"].hint)[0]
    assert list(map(float, found.split(","))) == pytest.approx([10.0, 30.0, 0.0], abs=1.0)


def test_single_gyro_that_turns_the_other_way_is_reported(turning: Dive) -> None:
    mirrored = ImuColumns(
        turning.imu.time_ns,
        turning.imu.specific_force_b * [1, -1, 1],
        turning.imu.angular_rate_b * [1, -1, 1],
    )
    note = notes_of(replace(turning, imu=mirrored))["imu_gyro_axis"]
    assert "angular rate starboard" in note.text


def codes_of_swings(rpy: Floats, at_s: Floats, gyros: Floats) -> set[str]:
    """Return the codes of notes on a vehicle of such attitudes, whose gyros give their rates times a matrix."""
    mat_nb = mat_from_rpy(rpy)
    skewed = np.swapaxes(mat_nb, 1, 2) @ np.gradient(mat_nb, at_s, axis=0)
    rate_b = np.stack([skewed[:, 2, 1], skewed[:, 0, 2], skewed[:, 1, 0]], axis=1)
    time_ns = np.rint(at_s * 1e9).astype(np.int64)
    imu = ImuColumns(time_ns, mat_nb[:, 2] * -9.8, rate_b @ gyros.T)
    rows = slice(None, None, 10)
    unknown = np.full((len(time_ns[rows]), 3), np.nan)
    reference = ReferenceColumns(time_ns[rows], unknown, unknown, mat_nb[rows])
    ping_ns = time_ns[::50]
    ahead = np.tile([1.0, 0.0, 0.0], (len(ping_ns), 1))
    dvl = DvlColumns(ping_ns, None, None, ahead, None)
    return {note.code for note in plausibility_notes("a.mcap", imu, dvl, reference, Config())}


@pytest.mark.parametrize(("swing_deg", "reported"), [(2.8, False), (3.2, True)])
def test_gyro_is_held_against_attitudes_that_swing_by_three_degrees_about_its_axis(
    swing_deg: float, reported: bool
) -> None:
    """A vehicle that turns to both sides, and pitches a little, with a starboard gyro of the wrong sign."""
    at_s = np.arange(0.0, 60.0, 0.02)
    pitch = 0.5 * swing_deg * DEG * np.sin(0.7 * at_s)
    yaw = 0.8 * np.sin(0.3 * at_s)
    rpy = np.stack([np.zeros_like(at_s), pitch, yaw], axis=1)
    found = codes_of_swings(rpy, at_s, np.diag([1.0, -1.0, 1.0]))
    assert ("imu_gyro_axis" in found) is reported


@pytest.mark.parametrize(("swing_deg", "reported"), [(2.8, False), (3.2, True)])
def test_gyros_are_held_against_attitudes_that_swing_by_three_degrees_about_any_axis(
    swing_deg: float, reported: bool
) -> None:
    """A vehicle that rocks a little about each axis, whose gyros of roll and yaw are swapped."""
    at_s = np.arange(0.0, 60.0, 0.02)
    rpy = 0.5 * swing_deg * DEG * np.sin(np.outer(at_s, [1.1, 0.7, 0.3]))
    found = codes_of_swings(rpy, at_s, np.eye(3)[[2, 1, 0]])
    assert ("imu_gyro_contradiction" in found) is reported


def test_positions_that_contradict_the_velocity_next_to_them_are_reported(turning: Dive) -> None:
    reference = reference_of(turning)
    swapped = replace(reference, position=reference.position[:, [1, 0, 2]])
    assert "reference_contradiction" in notes_of(replace(turning, reference=swapped))
    rng = np.random.default_rng(9)
    noise_m = rng.normal(0.0, 1.0, (len(reference.time_ns), 2))
    noisy = reference.position + np.pad(noise_m / 6.4e6, ((0, 0), (0, 1)))
    assert "reference_contradiction" not in notes_of(
        replace(turning, reference=replace(reference, position=noisy))
    )


def test_noise_of_a_vehicle_that_is_still_contradicts_nobody() -> None:
    still = simulate_dive("static", duration_s=60.0, imu_rate_hz=50.0, seed=6)
    reference, rng = reference_of(still), np.random.default_rng(7)
    noise = mat_from_rpy(rng.normal(0.0, 0.3 * DEG, (len(reference.time_ns), 3)))
    noisy = replace(still, reference=replace(reference, mat_nb=reference.mat_nb @ noise))
    assert "imu_gyro_contradiction" not in notes_of(noisy)


def test_spinning_faster_than_any_vehicle_is_refused(turning: Dive) -> None:
    rate_b = turning.imu.angular_rate_b + 2.0
    with pytest.raises(LogError, match=r"rad/s .*19\d deg/s"):
        notes_of(replace(turning, imu=replace(turning.imu, angular_rate_b=rate_b)))


@pytest.mark.parametrize("scale", [0.5, 1.0, 3.0])
def test_swing_of_gravity_shows_the_scale_of_the_gyros(scale: float) -> None:
    """A vehicle at rest that rolls and pitches: du/dt = -w x u exactly."""
    at_s = np.arange(0.0, 60.0, 0.02)
    rpy = np.stack([0.2 * np.sin(1.1 * at_s), 0.1 * np.sin(0.7 * at_s), 0.05 * at_s], axis=1)
    mat_nb = mat_from_rpy(rpy)
    between_s = np.gradient(mat_nb, at_s, axis=0)
    skewed = np.swapaxes(mat_nb, 1, 2) @ between_s
    rate_b = np.stack([skewed[:, 2, 1], skewed[:, 0, 2], skewed[:, 1, 0]], axis=1)
    imu = ImuColumns(np.rint(at_s * 1e9).astype(np.int64), mat_nb[:, 2] * -9.8, scale * rate_b)
    assert gyro_by_gravity(imu) == pytest.approx(scale, rel=0.02)


# The DVL


def turned(dvl: DvlColumns, heading_deg: float, scale: float = 1.0) -> DvlColumns:
    assert dvl.beam_velocity_mps is not None
    assert dvl.beam_vectors_d is not None
    velocity_d = dvl.beam_velocity_mps @ np.linalg.pinv(dvl.beam_vectors_d).T
    mat = mat_from_rpy(np.array([0.0, 0.0, heading_deg * DEG]))
    return DvlColumns(dvl.time_ns, velocity_d=scale * velocity_d @ mat.T)


@pytest.mark.parametrize("heading_deg", [180.0, 92.0, -45.0])
def test_dvl_that_looks_another_way_is_reported_how_to_mount_it(
    heading_deg: float, turning: Dive
) -> None:
    dive = replace(turning, dvl=turned(turning.dvl, heading_deg))
    note = notes_of(dive)["dvl_direction"]
    hinted_deg = float(note.hint.split("]")[0].rsplit(",", 1)[1])
    assert abs(wrap_angle(np.array((hinted_deg + heading_deg) * DEG))) < 2.0 * DEG
    config = Config(dvl=Dvl(mounting_rpy_deg=(0.0, 0.0, hinted_deg)))
    assert not notes_of(dive, config)


def test_dvl_of_another_scale_is_reported(turning: Dive) -> None:
    note = notes_of(replace(turning, dvl=turned(turning.dvl, 0.0, scale=1.3)))["dvl_scale"]
    assert "dvl.scale = 1.3" in note.hint
    note = notes_of(positions_only(replace(turning, dvl=turned(turning.dvl, 0.0, scale=1.3))))[
        "dvl_scale"
    ]
    assert "dvl.scale = 1.3" in note.hint


def swaying(dive: Dive) -> Dive:
    """Give the vehicle a sideslip and a heave that DVL and reference both see; no position tells of another way."""
    reference = reference_of(dive)
    velocity_b = np.einsum("kji,kj->ki", reference.mat_nb, reference.velocity_n)
    at_s = seconds(reference.time_ns, dive.imu.time_ns[0])
    velocity_b += np.stack(
        [0.0 * at_s, 0.2 * np.sin(at_s / 9.0), 0.1 * np.cos(at_s / 7.0)], axis=1
    )
    ping_s = seconds(dive.dvl.time_ns, dive.imu.time_ns[0])
    velocity_d = np.stack([np.interp(ping_s, at_s, column) for column in velocity_b.T], axis=1)
    velocity_n = np.einsum("kij,kj->ki", reference.mat_nb, velocity_b)
    dvl = DvlColumns(dive.dvl.time_ns, velocity_d=velocity_d)
    nowhere = np.full_like(reference.position, np.nan)
    return replace(
        dive, dvl=dvl, reference=replace(reference, velocity_n=velocity_n, position=nowhere)
    )


@pytest.mark.parametrize(
    ("signs", "named"),
    [
        ((1, -1, -1), ["starboard", "down"]),
        ((1, -1, 1), ["starboard"]),
        ((1, 1, -1), ["down"]),
    ],
)
def test_axis_of_the_dvl_that_is_turned_is_named(
    signs: tuple[int, int, int], named: list[str], turning: Dive
) -> None:
    dive = swaying(turning)
    assert not notes_of(dive)
    assert dive.dvl.velocity_d is not None
    other = replace(dive, dvl=replace(dive.dvl, velocity_d=dive.dvl.velocity_d * np.array(signs)))
    note = notes_of(other)["dvl_axes"]
    assert re.findall(r"forward|starboard|down", note.text) == named
    assert 'dvl.axes = "flu"' in note.hint


@needs_data
@pytest.mark.parametrize("run", ["01", "07", "11"])
def test_turned_axes_of_a_real_dvl_are_named(run: str) -> None:
    config = load_config(file=PROJECT / "examples" / "snapir.toml", overrides=["dvl.axes=flu"])
    dive = read_checked_dive(DATA / "snapir" / f"snapir_{run}.mcap", config)
    named = re.findall(r"forward|starboard|down", notes_of(dive, config)["dvl_axes"].text)
    assert named == ["starboard", "down"]


def test_component_of_the_dvl_that_never_changes_is_named(turning: Dive) -> None:
    dvl = turned(turning.dvl, 0.0)
    assert dvl.velocity_d is not None
    note = notes_of(
        replace(turning, dvl=replace(dvl, velocity_d=dvl.velocity_d * np.array([1, 0, 1])))
    )["dvl_constant"]
    assert re.search(r"starboard .*\b0 m/s .*\b200 ", note.text)
    assert turning.dvl.beam_velocity_mps is not None
    beams = turning.dvl.beam_velocity_mps.copy()
    beams[:, 2], beams[50:, 3] = 0.25, np.nan
    note = notes_of(replace(turning, dvl=replace(turning.dvl, beam_velocity_mps=beams)))[
        "dvl_constant"
    ]
    assert re.search(r"beam 3 .*\b0\.25 m/s .*\b200 ", note.text)


def test_beams_in_another_order_contradict_the_reference(turning: Dive) -> None:
    assert turning.dvl.beam_velocity_mps is not None
    beams = turning.dvl.beam_velocity_mps[:, [1, 0, 2, 3]]
    note = notes_of(replace(turning, dvl=replace(turning.dvl, beam_velocity_mps=beams)))[
        "dvl_contradiction"
    ]
    assert "dvl.beam_azimuth_deg" in note.hint


def test_reference_that_never_moves_is_reported(turning: Dive) -> None:
    reference = reference_of(turning)
    still = replace(
        reference,
        position=np.tile(reference.position[0], (len(reference.time_ns), 1)),
        mat_nb=np.tile(reference.mat_nb[0], (len(reference.time_ns), 1, 1)),
    )
    found = plausibility_notes("a.mcap", turning.imu, turning.dvl, still, Config())
    texts = [note.text for note in found if note.code == "reference_constant"]
    assert [text.split()[1] for text in texts] == ["position", "attitude"]


def test_reversed_dvl_shows_in_the_track_where_the_heading_is_known(turning: Dive) -> None:
    heading_deg = heading_at_start(turning) / DEG
    config = Config(initial=Initial(source="level", heading_deg=heading_deg))
    assert not notes_of(positions_only(turning), config)
    reversed_ = positions_only(replace(turning, dvl=turned(turning.dvl, 180.0)))
    assert "dvl_direction" in notes_of(reversed_, config)
    assert not notes_of(reversed_), (
        "without a heading, a reversed DVL and a reversed vehicle are the same"
    )


def test_track_that_cannot_be_is_reported(turning: Dive) -> None:
    biased = replace(
        turning.imu, angular_rate_b=turning.imu.angular_rate_b + np.array([0.0, 0.0, 0.2])
    )
    note = notes_of(positions_only(replace(turning, imu=biased)))["track_contradiction"]
    assert "initial.gyro_bias_degph" in note.hint


def test_pings_of_exactly_zero_are_reported(turning: Dive) -> None:
    dvl = turned(turning.dvl, 0.0)
    assert dvl.velocity_d is not None
    velocity_d = dvl.velocity_d.copy()
    velocity_d[[30, 50]] = 0.0
    note = notes_of(replace(turning, dvl=replace(dvl, velocity_d=velocity_d)))["dvl_zero"]
    assert note.count == 2
    assert "30.0 s" in note.text


# Where nothing can be said, nothing is


def test_few_samples_are_not_evaluated() -> None:
    dive = simulate_dive("straight", duration_s=3.0, imu_rate_hz=50.0, seed=1)
    short = replace(dive.imu, time_ns=dive.imu.time_ns[:3])
    one = ImuColumns(short.time_ns[:1], dive.imu.specific_force_b[:1], dive.imu.angular_rate_b[:1])
    nothing = DvlColumns(np.empty(0, np.int64), velocity_d=np.empty((0, 3)))
    assert not notes_of(replace(dive, imu=one, dvl=nothing))
    assert gyro_by_attitude(one, reference_of(dive)) is None
    assert gyro_by_gravity(one) is None
    assert dvl_by_velocity(nothing, reference_of(dive), Config()) is None
    assert track_by_positions(one, nothing, reference_of(dive), Config()) is None


# Real faults


def blueye(file: str, *overrides: str) -> tuple[Dive, Config]:
    config = load_config(file=PROJECT / "examples" / "blueye_x3.toml", overrides=overrides)
    return read_checked_dive(DATA / "blueye_x3" / f"{file}.mcap", config), config


@needs_data
def test_real_gyro_scale_fault_is_found_from_positions_alone() -> None:
    with pytest.raises(LogError, match=r"specific force .* 95") as refusal:
        blueye("grid_gyro_scale_wrong")
    assert refusal.value.hint == 'imu.specific_force_unit = "m/s2"'
    dive, _ = blueye("grid_gyro_scale_wrong", "imu.specific_force_unit=m/s2")
    note = {note.code: note for note in dive.notes}["imu_gyro_scale"]
    assert hinted_scale(note.hint) == pytest.approx(1.0 / 1.6645, rel=0.02)
    by_gravity = gyro_by_gravity(dive.imu)
    assert by_gravity is not None
    assert by_gravity < 1.0 / 1.7, "found without any reference too"


@needs_data
def test_real_dive_of_the_same_vehicle_has_no_gyro_fault() -> None:
    dive, config = blueye("auto_square")
    assert not [note for note in dive.notes if note.severity == "warning"]
    assert not notes_of(replace(dive, reference=None), config)


@needs_data
def test_real_accelerometer_of_half_scale_is_refused() -> None:
    with pytest.raises(LogError) as refusal:
        blueye("auto_square", "imu.topic=blueye.protocol.CalibratedImuTel")
    assert refusal.value.hint.startswith("imu.specific_force_scale = 0.54")


@needs_data
def test_real_imu_that_is_too_slow_and_not_in_rad_per_s() -> None:
    overrides = [f"{role}.stamp=log_time" for role in ("imu", "dvl", "reference")]
    overrides += ["imu.topic=/coug2/modem_imu", "reference.topic=/coug2/odom"]
    path = DATA / "cougars" / "so_lastbag.mcap"
    with pytest.raises(LogError) as spinning:
        read_checked_dive(path, load_config(overrides=overrides))
    assert 'imu.angular_rate_unit = "deg/s"' in spinning.value.hint
    with pytest.raises(LogError, match=r"IMU .*\b10\.0 "):
        read_checked_dive(path, load_config(overrides=[*overrides, "imu.angular_rate_unit=deg/s"]))
