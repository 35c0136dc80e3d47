"""A start from the attitude of an AHRS (``initial.source = "sensor"``): as it was written, and as sure as it says."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config import Config, Filter, Heading, Initial
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats, SensorColumns
from insdvl_replay.core.errors import ConfigError, LogError, Note
from insdvl_replay.core.states import DEG, PHI
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat, vector_from_mat
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.preparation.prepared import Prepared, prepare_dive
from insdvl_replay.preparation.replay import replay_dive, replay_log
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import SensorErrors

SD_DEG = 1.0
AHRS = Heading(sd_deg=SD_DEG, level_sd_deg=SD_DEG)
BY_SENSOR = Initial(source="sensor", misalignment_sd_deg=(0.1, 0.1, 0.1), accel_bias_sd_mg=2.0)


def simulated(seed: int = 1, sd_deg: float = SD_DEG, duration_s: float = 40.0) -> Dive:
    """A dive that turns, rolls and pitches."""
    ahrs = {"heading": SensorErrors(sd_deg, 4.0)}
    return simulate_dive(
        "calibration", seed=seed, duration_s=duration_s, grade="mems", sensors=ahrs
    )


def config(initial: Initial = BY_SENSOR, heading: Heading = AHRS) -> Config:
    return msgspec.structs.replace(load_config("mems"), initial=initial, heading=heading)


def ahrs_of(dive: Dive) -> tuple[SensorColumns, Floats]:
    """Return the readings, and roll, pitch and heading of their attitudes."""
    columns = dive.sensors["heading"]
    assert columns.mat_nb is not None
    return columns, rpy_from_mat(columns.mat_nb)


def with_latitude(settings: Config, heading_deg: float | None = None) -> Config:
    initial = msgspec.structs.replace(settings.initial, latitude_deg=32.8, heading_deg=heading_deg)
    return msgspec.structs.replace(settings, initial=initial)


def truth_at(dive: Dive, at_ns: int) -> Floats:
    reference = dive.reference
    assert reference is not None
    return np.asarray(reference.mat_nb[int(np.searchsorted(reference.time_ns, at_ns))])


def codes(prepared: Prepared) -> set[str]:
    return {note.code for note in prepared.notes if note.code.startswith("start_")}


# --- As it was written.


@pytest.mark.parametrize("mounting_rpy_deg", [(0.0, 0.0, 0.0), (3.0, -2.0, 90.0)])
def test_an_attitude_of_the_log_is_that_of_the_dive(
    tmp_path: Path, mounting_rpy_deg: tuple[float, float, float]
) -> None:
    """scipy turns it to true north, and to the axes of the IMU."""
    dive = simulated()
    write_dive(tmp_path / "dive.mcap", dive)
    turned = Heading(declination_deg=4.5, mounting_rpy_deg=mounting_rpy_deg)
    read = read_dive(tmp_path / "dive.mcap", config(heading=turned)).sensors["heading"]
    written, _ = ahrs_of(dive)
    assert read.mat_nb is not None
    assert written.mat_nb is not None
    to_true = Rotation.from_euler("z", 4.5, degrees=True)
    to_imu = Rotation.from_euler("ZYX", mounting_rpy_deg[::-1], degrees=True).inv()
    expected = (to_true * Rotation.from_matrix(written.mat_nb) * to_imu).as_matrix()
    np.testing.assert_allclose(read.mat_nb, expected, atol=1e-11)
    heading = np.arctan2(expected[:, 1, 0], expected[:, 0, 0])
    np.testing.assert_allclose(np.exp(1j * (read.values[:, 0] - heading)), 1.0, atol=1e-11)


def test_an_attitude_that_nobody_starts_from_is_not_kept(tmp_path: Path) -> None:
    write_dive(tmp_path / "dive.mcap", simulated())
    aided = {
        "baseline": Filter(aiding=("velocity",)),
        "held": Filter(aiding=("velocity", "heading")),
    }
    read = read_dive(tmp_path / "dive.mcap", Config(filters=aided)).sensors["heading"]
    assert read.mat_nb is None


def test_three_angles_of_a_message_are_an_attitude(tmp_path: Path) -> None:
    """The project's own solution has roll, pitch and heading in degrees; it plays the AHRS here."""
    dive = simulated(sd_deg=1e-9)
    write_dive(tmp_path / "dive.mcap", dive)
    names = {name: f"{name}_deg" for name in ("roll", "pitch", "heading")}
    angles = Heading(topic="/reference", **names)  # type: ignore[arg-type]
    read = read_dive(tmp_path / "dive.mcap", config(heading=angles)).sensors["heading"]
    assert dive.reference is not None
    assert read.mat_nb is not None
    np.testing.assert_allclose(read.mat_nb, dive.reference.mat_nb, atol=1e-9)


@pytest.mark.parametrize("alone", ["roll", "pitch"])
def test_a_roll_says_nothing_without_a_pitch(tmp_path: Path, alone: str) -> None:
    write_dive(tmp_path / "dive.mcap", simulated())
    angles = Heading(topic="/reference", heading="heading_deg", **{alone: f"{alone}_deg"})  # type: ignore[arg-type]
    with pytest.raises(LogError, match=f"has {alone}, but no"):
        read_dive(tmp_path / "dive.mcap", config(heading=angles))


def test_a_quaternion_has_no_unit(tmp_path: Path) -> None:
    write_dive(tmp_path / "dive.mcap", simulated())
    with pytest.raises(ConfigError, match=r"heading\.angle_unit"):
        read_dive(tmp_path / "dive.mcap", config(heading=Heading(angle_unit="rad")))


def test_roll_and_pitch_are_no_attitude_without_a_heading(tmp_path: Path) -> None:
    """Though the type of the topic has a quaternion, which would have been read had nothing been named."""
    write_dive(tmp_path / "dive.mcap", simulated())
    angles = Heading(roll="quaternion.x", pitch="quaternion.y")
    with pytest.raises(LogError, match=r"heading\.roll and heading\.pitch") as caught:
        read_dive(tmp_path / "dive.mcap", config(heading=angles))
    assert 'heading.heading = "field.path"' in caught.value.hint


def test_a_compass_gives_no_start_and_has_no_axes(tmp_path: Path) -> None:
    write_dive(tmp_path / "dive.mcap", simulated())
    compass = Heading(topic="/reference", heading="heading_deg")
    with pytest.raises(LogError, match=r"heading\.roll and heading\.pitch") as caught:
        replay_log(tmp_path / "dive.mcap", config(heading=compass))
    assert "initial.source=level" in str(caught.value.hint)
    turned = msgspec.structs.replace(compass, mounting_rpy_deg=(0.0, 0.0, 90.0))
    with pytest.raises(ConfigError, match="mounting_rpy_deg"):
        read_dive(tmp_path / "dive.mcap", config(heading=turned))


# --- As it is used.


def test_filters_start_at_the_first_attitude_in_the_span() -> None:
    dive = simulated()
    settings = msgspec.structs.replace(
        config(), span=msgspec.structs.replace(config().span, start_s=10.3)
    )
    columns, rpy = ahrs_of(dive)
    prepared = prepare_dive(replace(dive, reference=None), with_latitude(settings))
    first = int(np.searchsorted(columns.time_ns, dive.imu.time_ns[0] + round(10.3e9)))
    assert prepared.alignment.start_ns == columns.time_ns[first]
    np.testing.assert_allclose(
        rpy_from_mat(prepared.alignment.start.mat_nb), rpy[first], atol=1e-12
    )
    assert {"start_attitude_sensor", "start_velocity_dvl"} <= codes(prepared)
    assert not codes(prepared) & {
        "start_levelled",
        "start_tilt_contradiction",
        "start_heading_sensor",
    }


def test_an_ahrs_needs_no_samples_to_level_by() -> None:
    """The IMU falls silent 0.2 s after the first attitude, for a second."""
    dive = simulated()
    columns, rpy = ahrs_of(dive)
    since_s = (dive.imu.time_ns - columns.time_ns[0]) * 1e-9
    heard = (since_s < 0.2) | (since_s > 1.2)
    imu = replace(
        dive.imu,
        time_ns=dive.imu.time_ns[heard],
        specific_force_b=dive.imu.specific_force_b[heard],
        angular_rate_b=dive.imu.angular_rate_b[heard],
    )
    few = replace(
        imu,
        **{
            name: getattr(imu, name)[::3]
            for name in ("time_ns", "specific_force_b", "angular_rate_b")
        },
    )
    prepared = prepare_dive(replace(dive, imu=few), config())
    np.testing.assert_allclose(rpy_from_mat(prepared.alignment.start.mat_nb), rpy[0], atol=1e-12)
    level = msgspec.structs.replace(BY_SENSOR, source="level", heading_deg=0.0)
    with pytest.raises(LogError, match="level"):
        prepare_dive(replace(dive, imu=few), config(initial=level))


def test_a_reference_gives_its_position_alone() -> None:
    dive = simulated()
    assert dive.reference is not None
    prepared = prepare_dive(dive, config())
    start = prepared.alignment.start
    at = int(np.searchsorted(dive.reference.time_ns, prepared.alignment.start_ns))
    np.testing.assert_allclose(start.position[:2], dive.reference.position[at, :2], atol=1e-7)
    _, rpy = ahrs_of(dive)
    np.testing.assert_allclose(rpy_from_mat(start.mat_nb), rpy[0], atol=1e-12)


def test_a_heading_in_numbers_goes_before_that_of_the_sensor() -> None:
    dive = simulated()
    prepared = prepare_dive(dive, with_latitude(config(), heading_deg=123.0))
    _, rpy = ahrs_of(dive)
    expected = mat_from_rpy(np.array([*rpy[0, :2], 123.0 * DEG]))
    np.testing.assert_allclose(prepared.alignment.start.mat_nb, expected, atol=1e-12)
    north_deg, east_deg, down_deg = np.sqrt(np.diagonal(prepared.alignment.start.cov)[PHI]) / DEG
    # The gyros show the scatter of its noise once more.
    assert (north_deg, east_deg) == pytest.approx((SD_DEG, SD_DEG), rel=0.3)
    assert min(north_deg, east_deg) >= SD_DEG
    assert down_deg == pytest.approx(0.1)


@pytest.mark.nightly
def test_a_start_is_off_by_what_it_says() -> None:
    """The squares of 200 starts' three misalignments over their variances: their mean is 1 within 4 of its sd."""
    squares = []
    for seed in range(200):
        dive = simulated(seed, duration_s=12.0)
        prepared = prepare_dive(dive, config())
        start = prepared.alignment.start
        misalignment = vector_from_mat(
            start.mat_nb @ truth_at(dive, prepared.alignment.start_ns).T
        )
        squares.append(misalignment**2 / np.diagonal(start.cov)[PHI])
    per_axis = np.mean(squares, axis=0)
    bound = 4.0 * np.sqrt(2.0 / 200)
    assert np.all(np.abs(per_axis - 1.0) < bound), per_axis


def test_a_vehicle_that_no_dvl_sees_is_levelled_better_by_its_ahrs() -> None:
    """A vehicle that pitches while no DVL sees it: gravity misleads by degrees, the AHRS does not."""
    sensed_deg, levelled_deg = [], []
    for seed in range(8):
        dive = simulated(seed, sd_deg=0.3)
        blind_s = 1e-9 * (dive.dvl.time_ns - dive.dvl.time_ns[0])
        dvl = replace(
            dive.dvl,
            beam_velocity_mps=np.where(
                blind_s[:, None] < 25.0, np.nan, dive.dvl.beam_velocity_mps
            ),
        )
        blind = replace(dive, dvl=dvl)
        settings = msgspec.structs.replace(
            config(), span=msgspec.structs.replace(config().span, start_s=10.0)
        )
        for source, found in (("sensor", sensed_deg), ("level", levelled_deg)):
            initial = msgspec.structs.replace(
                settings.initial, source=source, heading_deg="sensor"
            )
            start = prepare_dive(
                blind, msgspec.structs.replace(settings, initial=initial)
            ).alignment
            truth = rpy_from_mat(truth_at(dive, start.start_ns))
            found.append(np.abs(rpy_from_mat(start.start.mat_nb) - truth)[:2].max() / DEG)
    assert np.median(sensed_deg) < 0.5
    assert np.median(levelled_deg) > 2.0 * np.median(sensed_deg)


# --- What is odd about it.


def test_an_ahrs_on_its_back_contradicts_gravity_until_its_mounting_is_said(
    tmp_path: Path,
) -> None:
    dive = simulated()
    columns, _ = ahrs_of(dive)
    on_its_back = replace(
        columns, mat_nb=columns.mat_nb @ mat_from_rpy(np.array([np.pi, 0.0, 0.0]))
    )
    write_dive(tmp_path / "dive.mcap", replace(dive, sensors={"heading": on_its_back}))
    [said] = [note for note in contradictions(tmp_path / "dive.mcap", AHRS) if "tilt" in note.code]
    assert said.severity is Severity.WARNING
    assert "heading.mounting_rpy_deg" in said.hint
    mounted = msgspec.structs.replace(AHRS, mounting_rpy_deg=(180.0, 0.0, 0.0))
    assert not contradictions(tmp_path / "dive.mcap", mounted)


def test_axes_taken_for_others_contradict_the_heading_of_the_reference(tmp_path: Path) -> None:
    """East-north-up read as north-east-down leaves a level vehicle level."""
    write_dive(tmp_path / "dive.mcap", simulated())
    wrong = msgspec.structs.replace(AHRS, axes="ned_frd")
    found = {note.code for note in contradictions(tmp_path / "dive.mcap", wrong)}
    assert found == {"start_heading_contradiction", "heading_contradiction"}


def contradictions(log: Path, heading: Heading) -> list[Note]:
    return [
        note
        for note in replay_log(log, config(heading=heading)).notes
        if note.code.endswith("_contradiction")
    ]


def test_an_ahrs_that_begins_after_the_dive_is_an_error() -> None:
    dive = simulated()
    columns = dive.sensors["heading"]
    late = replace(columns, time_ns=columns.time_ns + 100_000_000_000)
    with pytest.raises(LogError, match="attitude"):
        replay_dive(replace(dive, sensors={"heading": late}), config())


def test_rows_without_an_attitude_are_ignored() -> None:
    dive = simulated()
    columns, rpy = ahrs_of(dive)
    assert columns.mat_nb is not None
    mat_nb = columns.mat_nb.copy()
    mat_nb[:3] = np.nan
    prepared = prepare_dive(
        replace(dive, sensors={"heading": replace(columns, mat_nb=mat_nb)}), config()
    )
    np.testing.assert_allclose(rpy_from_mat(prepared.alignment.start.mat_nb), rpy[3], atol=1e-12)


def test_the_ahrs_of_a_recorded_bag_starts_a_vehicle_as_its_truth_would(ros1: Path) -> None:
    """Orientation of an IMU message against the simulator's own pose: within 0.05 deg, and so is the dive after it."""
    overrides = [
        "reference.topic=/rexrov2/pose_gt",
        'reference.velocity_n="twist.twist.linear"',
        "imu.axes=flu",
        "dvl.axes=+z-y+x",
        "dvl.lever_arm_m=[0.301,-0.5,0.689]",
        "initial.latitude_deg=38.0",
    ]
    log, errors_deg = ros1 / "rexrov2_simulated.bag", {}
    for source in ("reference", "sensor"):
        replay = replay_log(
            log, load_config("mems", overrides=[*overrides, f"initial.source={source}"])
        )
        errors_deg[source] = replay.errors["baseline"].attitude_error_rad / DEG
        assert not [note for note in replay.notes if note.code.endswith("_contradiction")]
    np.testing.assert_allclose(errors_deg["sensor"][0], 0.0, atol=0.05)
    rms_deg = {
        source: np.sqrt(np.nanmean(errors**2, axis=0)) for source, errors in errors_deg.items()
    }
    np.testing.assert_allclose(rms_deg["sensor"], rms_deg["reference"], atol=0.01)
