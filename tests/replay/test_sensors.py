"""Sensors beside IMU and DVL, from the log to the tables, in worlds whose truth is known."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from matched_sensors import MATCHED
from true_errors import mean_squares

from insdvl_replay.core.config import (
    Config,
    Depth,
    Dvl,
    Evaluation,
    Filter,
    Heading,
    Initial,
    Position,
    Span,
)
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats, SensorColumns
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.history import History
from insdvl_replay.core.words import Severity
from insdvl_replay.document.time_axis import Clock
from insdvl_replay.geometry.frames import moved_position, north_east_m
from insdvl_replay.geometry.rotation import rpy_from_mat, wrap_angle
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.write import write_dive
from insdvl_replay.preparation.prepared import prepare_dive
from insdvl_replay.preparation.replay import Replay, replay_dive, replay_log
from insdvl_replay.preparation.run import prepared_timeline, run_one
from insdvl_replay.show.plots.errors import nis_figure
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import DvlErrors, ImuErrors, SensorErrors

MATCHED_IMU = ImuErrors(5e-3, 4.4e-5, 0.01, 0.0, 2e-5, 8e-8)
MATCHED_DVL = DvlErrors(
    beam_sd_mps=0.0,
    beam_bias_sd_mps=0.0,
    beam_scale_sd=0.0,
    beam_quantum_mps=0.0,
    velocity_sd_mps=0.01,
)
MEMS = load_config("mems")
FITTING = {
    "noise": MEMS.noise,
    "dvl": Dvl(velocity_sd_mps=0.005),
    "initial": MEMS.initial,
}  # of simulated sensors
POSITION_SD_M = (2.0, 2.0, 1.0)


def simulated(
    seed: int = 1, duration_s: float = 400.0, grade: str = "mems", **sensors: SensorErrors
) -> Dive:
    return simulate_dive(
        "lawnmower", seed=seed, duration_s=duration_s, grade=grade, sensors=sensors
    )


def config(*aiding: str, **changes: object) -> Config:
    filters = {
        "baseline": Filter(aiding=("velocity",)),
        "candidate": Filter(aiding=("velocity", *aiding)),
    }
    return Config(**{"filters": filters, **changes})  # type: ignore[arg-type]


def rms(replay: Replay, filter_: str, axis: int) -> float:
    return float(np.sqrt(np.nanmean(replay.errors[filter_].position_error_ned_m[:, axis] ** 2)))


def used(history: History, measurement: str) -> int:
    return next(
        int(one.used.sum()) for one in history.innovations if one.measurement == measurement
    )


def test_a_log_with_a_pressure_depth_sensor_is_read_as_it_was_simulated(tmp_path: Path) -> None:
    dive = simulated(duration_s=30.0, depth=SensorErrors(0.05, 4.0))
    write_dive(tmp_path / "dive.mcap", dive)
    read = read_dive(tmp_path / "dive.mcap", config("depth"))
    np.testing.assert_array_equal(read.sensors["depth"].time_ns, dive.sensors["depth"].time_ns)
    apart_m = read.sensors["depth"].values - dive.sensors["depth"].values
    np.testing.assert_allclose(
        apart_m - apart_m[0], 0.0, atol=2e-5
    )  # the atmosphere stands on it, too
    assert not read_dive(tmp_path / "dive.mcap", config()).sensors  # nobody asked


def test_depth_holds_the_height() -> None:
    replay = replay_dive(
        simulated(depth=SensorErrors(0.05, 4.0)), config("depth", depth=Depth(sd_m=0.05))
    )
    assert used(replay.histories[1], "depth") == 1600
    assert rms(replay, "candidate", 2) < 0.1
    assert rms(replay, "baseline", 2) > 0.2
    assert [note.code for note in replay.notes if note.code.startswith("depth")] == ["depth_zero"]


def test_a_sensor_that_is_held_out_is_met_and_not_used() -> None:
    settings = config("depth", evaluation=Evaluation(held_out=("depth",)))
    replay = replay_dive(simulated(depth=SensorErrors(0.05, 4.0)), settings)
    for history in replay.histories:
        met = next(one for one in history.innovations if one.measurement == "held_out_depth")
        assert len(met.nis) == 1600
        assert not met.used.any()
    drawn = nis_figure(replay.histories, Clock(0, 10**12), lambda dof: (0.0, 1.0)).panels
    for panel in drawn:  # what no gate has rejected is not marked so
        assert np.isnan(panel.curves[1].y).all()
    assert re.fullmatch("candidate: .*held_out_depth", drawn[-1].title)
    np.testing.assert_array_equal(replay.histories[0].velocity_n, replay.histories[1].velocity_n)
    (note,) = (note for note in replay.notes if note.code == "depth_held_out")
    assert "candidate" in note.text
    rows = [row for row in replay.tables.consistency if row.measurement == "held_out_depth"]
    assert [(row.used, row.rejected) for row in rows] == [(0, 1600)] * 2
    assert {row.verdict for row in rows} == {"not available"}
    assert not [note for note in replay.notes if note.code == "gate_rejects_many"]


@pytest.mark.parametrize(
    ("kept", "told"),
    [
        (slice(None), None),
        (slice(None, 200), ["60", "110", "50"]),
        (slice(200, None), ["50", "110", "0"]),
        (slice(None, None, 100), None),  # a reading every 25 s is a slow sensor
        (slice(200, 201), ["60", "110", "50"]),
    ],
    ids=["whole", "ends", "begins late", "slow", "once"],
)
def test_a_sensor_that_falls_silent_is_reported(kept: slice, told: str | None) -> None:
    dive = simulated(duration_s=110.0, depth=SensorErrors(0.05, 4.0))
    notes = replay_dive(
        replace(dive, sensors={"depth": dive.sensors["depth"].rows(kept)}), config("depth")
    ).notes
    found = [
        (re.findall(r"\d+", note.text), note.severity)
        for note in notes
        if note.code == "depth_silent"
    ]
    assert found == ([] if told is None else [(told, Severity.WARNING)])


def test_a_log_without_the_sensor_says_so(tmp_path: Path) -> None:
    write_dive(tmp_path / "dive.mcap", simulated(duration_s=30.0))
    with pytest.raises(LogError, match=r"dive\.mcap: .*depth") as refusal:
        read_dive(tmp_path / "dive.mcap", config("depth"))
    assert refusal.value.hint.endswith("; for a list of topics: `insdvl-replay inspect`")


@pytest.mark.parametrize(
    ("settings", "fields"),
    [
        (
            Position("/pressure"),
            'position.latitude = "field.path" and position.longitude = "field.path"',
        ),
        (
            Heading("/pressure"),
            'heading.heading = "field.path" or heading.quaternion = "field.path"',
        ),
    ],
    ids=["both", "either"],
)
def test_a_topic_of_another_type_is_reported_with_the_fields_that_it_takes(
    tmp_path: Path, settings: Heading | Position, fields: str
) -> None:
    write_dive(tmp_path / "dive.mcap", simulated(duration_s=30.0, depth=SensorErrors(1.0, 1.0)))
    name = type(settings).__name__.lower()
    with pytest.raises(LogError, match=f"{name}.topic") as refusal:
        read_dive(tmp_path / "dive.mcap", config(name, **{name: settings}))
    assert re.search(f'{name}.topic = "/topic" .*{fields};', refusal.value.hint)


def test_a_latitude_in_another_unit_is_reported_by_its_number(tmp_path: Path) -> None:
    write_dive(tmp_path / "dive.mcap", simulated(duration_s=30.0, position=SensorErrors(1.0)))
    with pytest.raises(LogError, match=r"31 of 31 latitudes .*32\.8\d* rad") as refusal:
        read_dive(tmp_path / "dive.mcap", config("position", position=Position(angle_unit="rad")))
    assert refusal.value.hint.startswith('position.angle_unit = "deg"')


def test_wrong_latitudes_of_both_signs_are_reported_by_the_furthest(tmp_path: Path) -> None:
    """Their median is a latitude that many places have."""
    dive = simulated(duration_s=30.0, position=SensorErrors(1.0))
    fixes = dive.sensors["position"]
    both = fixes.values * np.where(np.arange(31) % 2, 1.0, -1.0)[:, None]
    both[0, 0] = 0.0
    write_dive(
        tmp_path / "dive.mcap", replace(dive, sensors={"position": replace(fixes, values=both)})
    )
    with pytest.raises(LogError, match=r"30 of 31 latitudes .*32\.8\d* rad"):
        read_dive(tmp_path / "dive.mcap", config("position", position=Position(angle_unit="rad")))


def test_fixes_that_are_none_are_not_called_wrong_numbers(tmp_path: Path) -> None:
    """A receiver under water says 0, 0, which are numbers."""
    dive = simulated(duration_s=30.0, position=SensorErrors(1.0))
    fixes = dive.sensors["position"]
    values = fixes.values.copy()
    values[5:15] = 0.0
    write_dive(
        tmp_path / "dive.mcap",
        replace(dive, sensors={"position": SensorColumns(fixes.time_ns, values)}),
    )
    notes = read_dive(tmp_path / "dive.mcap", config("position")).notes
    (text,) = (note.text for note in notes if note.code == "position_not_finite")
    assert text.startswith("position: 10 ")


@pytest.mark.nightly
def test_a_heading_of_one_degree_holds_a_vehicle_of_small_sensors_for_an_hour() -> None:
    dive = simulated(seed=3, duration_s=3600.0, heading=SensorErrors(1.0, 1.0))
    replay = replay_dive(
        dive,
        config("heading", heading=Heading(sd_deg=1.0), noise=MEMS.noise, initial=MEMS.initial),
    )
    off_deg = {
        name: np.rad2deg(errors.attitude_error_rad[:, 2]) for name, errors in replay.errors.items()
    }
    assert np.abs(off_deg["candidate"]).max() < 1.0
    assert np.abs(off_deg["baseline"]).max() > 5.0
    met = next(one for one in replay.histories[1].innovations if one.measurement == "heading")
    assert met.used.all()
    assert 0.9 < met.nis.mean() < 1.1


def test_a_heading_is_read_as_it_was_simulated(tmp_path: Path) -> None:
    dive = simulated(duration_s=60.0, heading=SensorErrors(1.0, 4.0))
    write_dive(tmp_path / "dive.mcap", dive)
    read = read_dive(
        tmp_path / "dive.mcap", config("heading", heading=Heading(declination_deg=4.5))
    )
    apart = read.sensors["heading"].values - dive.sensors["heading"].values - np.deg2rad(4.5)
    np.testing.assert_allclose(np.exp(1j * apart), 1.0, atol=1e-9)


def test_an_imu_that_has_no_orientation_gives_no_heading(tmp_path: Path) -> None:
    """orientation_covariance[0] = -1 says so."""
    write_dive(tmp_path / "dive.mcap", simulated(duration_s=30.0))
    with pytest.raises(LogError, match=r"/imu: .*orientation"):
        read_dive(tmp_path / "dive.mcap", config("heading"))


@pytest.mark.nightly
def test_fixes_hold_the_position_and_are_read_as_they_were_simulated(tmp_path: Path) -> None:
    dive = simulated(duration_s=1500.0, position=SensorErrors(2.0, 0.1))
    write_dive(tmp_path / "dive.mcap", dive)
    settings = config(
        "position", position=Position(sd_m=2.0), noise=MEMS.noise, initial=MEMS.initial
    )
    read = read_dive(tmp_path / "dive.mcap", settings)
    np.testing.assert_allclose(
        read.sensors["position"].values, dive.sensors["position"].values, atol=1e-4
    )
    replay = replay_dive(dive, settings)
    met = next(one for one in replay.histories[1].innovations if one.measurement == "position")
    assert met.dof == 2
    assert met.used.all()
    assert rms(replay, "candidate", 0) < 1.5
    assert np.hypot(rms(replay, "candidate", 0), rms(replay, "candidate", 1)) < 1.5


def test_a_fix_without_height_is_none_where_heights_are_used(tmp_path: Path) -> None:
    dive = simulated(duration_s=30.0, position=SensorErrors(2.0, 1.0))
    fixes = dive.sensors["position"]
    values = fixes.values.copy()
    values[10:, 2] = np.nan
    write_dive(
        tmp_path / "dive.mcap", replace(dive, sensors={"position": replace(fixes, values=values)})
    )
    for height_sd_m, count in ((None, 31), (3.0, 10)):
        read = read_dive(
            tmp_path / "dive.mcap", config("position", position=Position(height_sd_m=height_sd_m))
        )
        assert len(read.sensors["position"].time_ns) == count


@pytest.mark.parametrize("arm_m", [(0.0, 0.0, 0.0), (3.0, 0.0, -5.0)])
def test_a_fix_without_height_starts_a_dive_at_the_configured_one(
    tmp_path: Path, arm_m: tuple[float, float, float]
) -> None:
    """Which is the IMU's, wherever the antenna is."""
    dive = simulated(duration_s=30.0, position=SensorErrors(2.0, 1.0))
    fixes = dive.sensors["position"]
    flat = replace(fixes, values=fixes.values * [1.0, 1.0, np.nan])
    write_dive(
        tmp_path / "dive.mcap",
        replace(dive, reference=None, truth=None, sensors={"position": flat}),
    )
    initial = msgspec.structs.replace(
        MEMS.initial, source="level", heading_deg=0.0, height_m=-250.0
    )
    settings = config(
        "position", initial=initial, noise=MEMS.noise, position=Position(lever_arm_m=arm_m)
    )
    # A log's own fixes are its reference, too, where it has no other.
    replay = replay_dive(
        replace(read_dive(tmp_path / "dive.mcap", settings), reference=None), settings
    )
    assert replay.histories[0].position[0, 2] == -250.0
    by_fix, by_height = (
        note for note in replay.notes if note.code.startswith(("start_position", "start_height"))
    )
    assert " 0.00 s" in by_fix.text
    assert " -250 m" in by_height.text
    apart_m = north_east_m(replay.histories[0].position[0], fixes.values[0], fixes.values[0])
    assert np.hypot(*apart_m) == pytest.approx(np.hypot(*arm_m[:2]), abs=0.2)


def test_a_dive_over_180_deg_of_longitude_is_as_any_other() -> None:
    """Through outage, too, which takes the positions up that were written down."""
    dive = simulated(duration_s=300.0, position=SensorErrors(1.0, 1.0))
    assert dive.reference is not None
    east = np.pi - 1e-7 - dive.reference.position[0, 1]  # 0.5 m from there

    def moved(position: Floats) -> Floats:
        return np.column_stack(
            [position[:, :1], wrap_angle(position[:, 1:2] + east), position[:, 2:]]
        )

    fixes = dive.sensors["position"]
    there = replace(
        dive,
        reference=replace(dive.reference, position=moved(dive.reference.position)),
        sensors={"position": replace(fixes, values=moved(fixes.values))},
    )
    assert np.ptp(there.sensors["position"].values[:, 1]) > 6.0
    settings = config(
        "position", position=Position(sd_m=1.0), noise=MEMS.noise, initial=MEMS.initial
    )
    here, there_too = (replay_dive(one, settings).tables for one in (dive, there))
    for ours, theirs in zip(here.evidence, there_too.evidence, strict=True):
        assert (ours.quantity, ours.role) == (theirs.quantity, theirs.role)
        assert theirs.value == pytest.approx(ours.value, rel=1e-3, nan_ok=True)


# --- Position as a state.


def started_off(dive: Dive, seed: int) -> Dive:
    """Let a filter start from a position that errs as it is told that it may: a reference that is moved as a whole."""
    assert dive.reference is not None
    off_m = np.array(POSITION_SD_M) * np.random.default_rng(seed).standard_normal(3)
    off = moved_position(dive.reference.position, np.tile(off_m, (len(dive.reference.time_ns), 1)))
    return replace(dive, reference=replace(dive.reference, position=off))


def position_nees(
    seed: int,
    depth_sensor: Depth,
    *,
    late_s: float = 0.0,
    height_sd_m: float | None = None,
    **sensors: SensorErrors,
) -> Floats:
    """NEES of the position over a dive of which the filter is told the truth, shape (k,); sensors may begin late."""
    dive = simulate_dive(
        "lawnmower",
        seed=seed,
        duration_s=400.0,
        imu_errors=MATCHED_IMU,
        dvl_errors=MATCHED_DVL,
        sensors=sensors,
    )
    settings = Config(
        noise=MATCHED.noise,
        initial=Initial(
            accel_bias_sd_mg=1.02,
            gyro_bias_sd_degph=0.1,
            position_sd_m=POSITION_SD_M,
            uncertainty="settings",
        ),
        dvl=MATCHED.dvl,
        depth=depth_sensor,
        position=Position(sd_m=1.0, height_sd_m=height_sd_m),
        filters={"aided": Filter(aiding=("velocity", *sensors), states=("position",))},
    )
    assert dive.reference is not None
    begun_ns = dive.reference.time_ns[0] + int(late_s * 1e9)
    late = {
        name: columns.rows(columns.time_ns >= begun_ns) for name, columns in dive.sensors.items()
    }
    prepared = prepare_dive(started_off(replace(dive, sensors=late), seed), settings)
    history = run_one(
        prepared.filters[0],
        prepared,
        prepared_timeline(dive, prepared),
        cov_ns=dive.reference.time_ns[1:],
    )
    replayed = np.isin(history.time_ns, history.cov_ns)
    reference = dive.reference.rows(np.isin(dive.reference.time_ns, history.cov_ns))
    apart = history.position[replayed] - reference.position
    error_m = apart * np.array([6.37e6, 6.38e6 * np.cos(reference.position[0, 0]), -1.0])
    cov = history.cov[:, 12:15, 12:15]
    return np.einsum("ki,kij,kj->k", error_m, np.linalg.inv(cov), error_m)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("surface_m", "late_s", "height_sd_m"),
    [(0.0, 0.0, None), (None, 0.0, None), (None, 100.0, None), (None, 0.0, 1.0)],
    ids=["zero is known", "zero by the first reading", "by one that comes late", "and by fixes"],
)
def test_position_is_as_far_off_as_the_filter_says(
    surface_m: float | None, late_s: float, height_sd_m: float | None
) -> None:
    """The mean NEES of 3 over independent runs; each run is one sample, since a position error stays."""
    sensors = {"depth": SensorErrors(0.05, 1.0)} | (
        {"position": SensorErrors(1.0, 1.0)} if height_sd_m else {}
    )
    depth_sensor = Depth(sd_m=0.05, surface_height_m=surface_m)
    runs = np.array([
        position_nees(seed, depth_sensor, late_s=late_s, height_sd_m=height_sd_m, **sensors).mean()
        for seed in range(24)
    ])  # fmt: skip
    assert (
        3.0 - 2.5 * runs.std() / np.sqrt(24) < runs.mean() < 3.0 + 2.5 * runs.std() / np.sqrt(24)
    )
    assert 1.8 < runs.mean() < 4.4


@pytest.mark.nightly
@pytest.mark.parametrize(("told_right", "least", "most"), [(True, 0.5, 0.9), (False, 1.05, 1.4)])
def test_a_track_that_is_moved_with_the_velocity_drifts_less_where_the_noise_is_right(
    told_right: bool, least: float, most: float
) -> None:
    """Velocities are the same; what the position is corrected by presupposes the noise that the filter was told."""
    initial = MEMS.initial
    if told_right:
        initial = Initial(accel_bias_sd_mg=1.02, gyro_bias_sd_degph=0.1)
    settings = Config(
        noise=MATCHED.noise if told_right else MEMS.noise,
        initial=msgspec.structs.replace(initial, uncertainty="settings"),
        dvl=MATCHED.dvl if told_right else MEMS.dvl,
        filters={
            name: Filter(aiding=("velocity",), states=states)
            for name, states in _WITH_AND_WITHOUT.items()
        },
    )
    errors = (
        {"imu_errors": MATCHED_IMU, "dvl_errors": MATCHED_DVL} if told_right else {"grade": "mems"}
    )
    dives = [simulate_dive("lawnmower", seed=seed, duration_s=600.0, **errors) for seed in (1, 2)]  # type: ignore[arg-type]
    for dive in dives:
        baseline, placed = (
            mean_squares(errors) for errors in replay_dive(dive, settings).errors.values()
        )
        assert least < np.sqrt(placed.drift_m2 / baseline.drift_m2) < most
        assert placed.velocity_m2ps2 == pytest.approx(baseline.velocity_m2ps2, rel=0.02)


_WITH_AND_WITHOUT = {"baseline": (), "placed": ("position",)}


# --- The DVL's scale and yaw as states.


WHITE = 5e-4
"""m/s/sqrt(s), of tactical accelerometers."""


def with_wrong_dvl(scenario: str, seed: int, scale: float, yaw_deg: float) -> History:
    """A dive with fixes whose DVL reads too much and is turned, through a filter that estimates both."""
    dive = simulate_dive(
        scenario,
        seed=seed,
        duration_s=900.0,
        imu_rate_hz=25.0,
        imu_errors=replace(MATCHED_IMU, accel_white_mps_rts=WHITE),
        dvl_errors=MATCHED_DVL,
        mounting_rpy_deg=(0.0, 0.0, yaw_deg),
        sensors={"position": SensorErrors(1.0, 1.0), "heading": SensorErrors(0.5, 1.0)},
    )
    assert dive.dvl.beam_velocity_mps is not None
    dive = replace(
        dive, dvl=replace(dive.dvl, beam_velocity_mps=dive.dvl.beam_velocity_mps * (1.0 + scale))
    )
    aided = Filter(aiding=("velocity", "position", "heading"), states=("dvl_scale", "dvl_yaw"))
    settings = Config(
        noise=msgspec.structs.replace(MATCHED.noise, accel_white_mps_rts=WHITE),
        initial=Initial(
            accel_bias_sd_mg=1.02, gyro_bias_sd_degph=0.1, dvl_scale_sd_pct=1.0, dvl_yaw_sd_deg=2.0
        ),
        dvl=MATCHED.dvl,
        position=Position(sd_m=1.0),
        heading=Heading(sd_deg=0.5),
        filters={"aided": aided},
    )
    prepared = prepare_dive(dive, settings)
    return run_one(prepared.filters[0], prepared, prepared_timeline(dive, prepared))


def test_a_scale_of_one_percent_and_a_yaw_are_found_in_turns_with_fixes() -> None:
    off = []
    for seed in range(8):
        history = with_wrong_dvl("lawnmower", seed, 0.01, 1.5)
        np.testing.assert_array_less(history.sd[-1, 15:], [4e-3, 4e-3])
        off.append((history.constants[-1] - [0.01, np.deg2rad(1.5)]) / history.sd[-1, 15:])
    assert (np.sqrt(np.mean(np.square(off), axis=0)) < 1.5).all(), off


@pytest.mark.nightly
@pytest.mark.parametrize("grade", ["fog", "tactical", "mems"])
def test_without_fixes_a_straight_line_leaves_the_scale_alone(grade: str) -> None:
    dive = simulate_dive("straight", seed=2, duration_s=400.0, grade=grade)
    assert dive.dvl.beam_velocity_mps is not None
    dive = replace(
        dive, dvl=replace(dive.dvl, beam_velocity_mps=dive.dvl.beam_velocity_mps * 1.01)
    )
    unsure = ["initial.velocity_sd_mps=1.0", "initial.uncertainty=settings"]
    settings = load_config(grade, None, unsure)
    scaled = {"scaled": Filter(aiding=("velocity",), states=("dvl_scale",))}
    prepared = prepare_dive(dive, msgspec.structs.replace(settings, filters=scaled))
    history = run_one(prepared.filters[0], prepared, prepared_timeline(dive, prepared))
    start_sd = history.sd[0, 12]
    assert abs(history.constants[-1, 0]) < 0.1 * start_sd
    assert history.sd[-1, 12] > 0.99 * start_sd


# --- A sensor that is the reference.


@pytest.mark.parametrize(
    ("seconds_late", "off_m", "told"),
    [(0.0, 0.0, True), (0.05, 0.0, True), (0.0, 0.05, False), (0.05, 0.05, False)],
)
def test_a_filter_that_is_reported_the_reference_is_not_evaluated_by_it(
    tmp_path: Path, seconds_late: float, off_m: float, told: bool
) -> None:
    """Stamped late it is the reference all the same; 5 cm away it is another receiver, that is good."""
    dive = simulated(duration_s=120.0)
    assert dive.reference is not None
    position = dive.reference.position + np.array([off_m / 6.4e6, 0.0, 0.0])
    fixes = SensorColumns(dive.reference.time_ns + int(seconds_late * 1e9), position)
    write_dive(tmp_path / "dive.mcap", replace(dive, sensors={"position": fixes}))
    replay = replay_log(
        tmp_path / "dive.mcap", config("position", position=Position(sd_m=0.5), **FITTING)
    )
    notes = [note.code for note in replay.notes if note.code.endswith("_is_reference")]
    assert notes == ["position_is_reference"] * told
    assert (replay.verdicts["candidate"].verdict == "not evaluated") == told
    judged = Evaluation(held_out=("position",))
    held_out = config("position", position=Position(sd_m=0.5), evaluation=judged, **FITTING)
    assert (
        replay_log(tmp_path / "dive.mcap", held_out).verdicts["candidate"].verdict
        != "not evaluated"
    )


FOOT_M = 0.3048


def _held(fixes: Floats) -> Floats:
    return np.concatenate([fixes[:50], np.repeat(fixes[50:51], 100, axis=0), fixes[150:]])


@pytest.mark.parametrize(
    ("sensor", "misread", "told"),
    [
        ("depth", lambda depth_m: depth_m / FOOT_M, ["depth_contradiction", "depth_disagrees"]),
        ("depth", lambda depth_m: -depth_m, ["depth_contradiction", "depth_disagrees"]),
        ("heading", np.deg2rad, ["heading_contradiction", "heading_disagrees", "heading_slow_error"]),
        (
            "heading",
            lambda heading: 0.5 * np.pi - heading,
            ["heading_contradiction", "heading_disagrees", "heading_slow_error"],
        ),
        ("heading", lambda heading: heading + np.deg2rad(10.0), ["heading_contradiction", "heading_slow_error"]),
        ("position", lambda fixes: fixes[:, [1, 0, 2]], ["position_contradiction", "position_disagrees"]),
        ("position", lambda fixes: fixes + np.array([0.1, 1.0, 0.0]), ["position_contradiction", "position_disagrees"]),
        ("position", _held, ["position_disagrees"]),
        *[(sensor, lambda values: values, []) for sensor in ("depth", "heading", "position")],
    ],
    ids=["feet", "upwards", "rad for deg", "from east over north", "declination", "longitude first",
         "another continent", "fixes that stand still", "depth", "heading", "position"],
)  # fmt: skip
def test_a_sensor_that_is_misread_is_reported(
    sensor: str, misread: Callable[[Floats], Floats], told: list[str]
) -> None:
    """Else the tables would have the filter err that trusts it."""
    noise = {
        "depth": SensorErrors(0.05, 4.0),
        "heading": SensorErrors(0.5, 2.0),
        "position": SensorErrors(1.0, 1.0),
    }
    dive = simulate_dive(
        "calibration", duration_s=250.0, grade="tactical", sensors={sensor: noise[sensor]}
    )
    right = dive.sensors[sensor]
    dive = replace(dive, sensors={sensor: replace(right, values=misread(right.values))})
    given = [
        "dvl.velocity_sd_mps=0.005",
        "evaluation.starts=1",
        "heading.sd_deg=0.5",
        "position.sd_m=1",
    ]
    settings = load_config("tactical", None, given)
    settings = msgspec.structs.replace(settings, filters=config(sensor).filters)
    replay = replay_dive(dive, settings)
    warnings = {note.code for note in replay.notes if note.severity == "warning"}
    assert sorted(warnings - {"not_evaluated"}) == told
    # What trusts such a sensor is not evaluated.
    assert ("not_evaluated" in warnings) == bool(told)


@pytest.mark.parametrize(("end_s", "told"), [(50.0, []), (110.0, ["heading_contradiction"])])
def test_a_sensor_is_held_against_the_reference_in_the_span_alone(
    end_s: float, told: list[str]
) -> None:
    dive = simulated(duration_s=110.0, heading=SensorErrors(0.5, 4.0))
    right = dive.sensors["heading"]
    late = right.time_ns > right.time_ns[0] + 55 * 10**9
    turned = replace(right, values=right.values + np.deg2rad(30.0) * late[:, None])
    settings = config("heading", span=Span(end_s=end_s))
    replay = replay_dive(replace(dive, sensors={"heading": turned}), settings)
    assert [note.code for note in replay.notes if note.code == "heading_contradiction"] == told


@pytest.mark.parametrize(
    ("sensor", "misread", "told"),
    [
        ("depth", lambda depth_m: depth_m / FOOT_M, ["depth_contradiction"]),
        ("depth", lambda depth_m: -depth_m, ["depth_contradiction"]),
        ("depth", lambda depth_m: 1.025 * depth_m, []),
        ("heading", np.deg2rad, ["heading_contradiction"]),
        ("heading", lambda heading: 0.5 * np.pi - heading, ["heading_contradiction"]),
        (
            "heading",
            lambda heading: heading + np.deg2rad(10.0),
            [],
        ),  # the start's heading may be off by as much
    ],
    ids=["feet", "upwards", "salt water", "rad for deg", "from east over north", "declination"],
)
def test_a_held_out_sensor_that_is_misread_is_reported_without_a_reference(
    sensor: str, misread: Callable[[Floats], Floats], told: list[str]
) -> None:
    """Else both filters would be as far off it, and *equivalent*."""
    noise = {"depth": SensorErrors(0.05, 4.0), "heading": SensorErrors(0.5, 2.0)}
    dive = simulate_dive(
        "calibration", duration_s=250.0, grade="tactical", sensors={sensor: noise[sensor]}
    )
    right = dive.sensors[sensor]
    dive = replace(
        dive, reference=None, sensors={sensor: replace(right, values=misread(right.values))}
    )
    initial = Initial(source="level", heading_deg=0.0, latitude_deg=32.8)
    settings = config(initial=initial, evaluation=Evaluation(held_out=(sensor,)))
    replay = replay_dive(dive, settings)
    assert [
        note.code
        for note in replay.notes
        if note.code.startswith(sensor) and note.severity == "warning"
    ] == told


@pytest.mark.nightly
def test_what_a_filter_estimates_of_its_sensors_is_noted() -> None:
    dive = simulated(duration_s=300.0, position=SensorErrors(1.0, 1.0))
    scaled = Filter(aiding=("velocity", "position"), states=("dvl_scale",))
    replay = replay_dive(
        dive, Config(filters={"baseline": Filter(aiding=("velocity",)), "scaled": scaled})
    )
    history = replay.histories[1]
    (note,) = (note for note in replay.notes if note.code == "constants_estimated")
    value, sd = 100.0 * history.constants[-1, 0], 100.0 * history.sd[-1, 15]
    assert note.text.startswith("scaled ")
    assert f"{value:+.3g} % (sd {sd:.2g} %; " in note.text


# --- Started by sensors.


def started(dive: Dive, **changes: object) -> Replay:
    level = msgspec.structs.replace(MEMS.initial, source="level", **changes)
    settings = config(
        "heading", "position", initial=level, noise=MEMS.noise, heading=Heading(sd_deg=1.0)
    )
    return replay_dive(replace(dive, reference=None), settings)


def test_a_dive_without_a_reference_starts_by_its_sensors() -> None:
    dive = simulated(
        duration_s=120.0, heading=SensorErrors(1.0, 1.0), position=SensorErrors(2.0, 1.0)
    )
    assert dive.reference is not None
    replay = started(dive)
    start = replay.histories[0]
    truth = rpy_from_mat(dive.reference.mat_nb[0])
    assert abs(
        float(wrap_angle(np.asarray(rpy_from_mat(start.mat_nb[0])[2] - truth[2])))
    ) < np.deg2rad(3.0)
    assert (
        np.hypot(
            *north_east_m(
                start.position[0], dive.reference.position[0], dive.reference.position[0]
            )
        )
        < 8.0
    )
    codes = {note.code for note in replay.notes}
    assert {"start_heading_sensor", "start_position_sensor"} <= codes
    np.testing.assert_allclose(replay.histories[1].sd[0, 12:14], 2.0)


def test_a_start_by_sensors_errs_as_the_filter_says() -> None:
    """The readings next to the start lie behind it, and make it: a filter that met them again would think of two."""
    arm_m, off = (4.0, 2.0, -1.0), []
    for seed in range(24):
        dive = simulate_dive(
            "lawnmower", seed=seed, duration_s=6.0, imu_errors=MATCHED_IMU, dvl_errors=MATCHED_DVL,
            sensors={"heading": SensorErrors(2.0, 0.1), "position": SensorErrors(2.0, 0.1)},
        )  # fmt: skip
        assert dive.reference is not None
        fixes, truth = dive.sensors["position"], dive.reference
        fixes = replace(
            fixes, values=moved_position(fixes.values, truth.mat_nb[:1] @ np.array(arm_m))
        )
        late = {name: replace(one, time_ns=one.time_ns + 400_000_000)
                for name, one in {**dive.sensors, "position": fixes}.items()}  # fmt: skip
        settings = Config(
            noise=MATCHED.noise,
            initial=Initial(
                source="level",
                accel_bias_sd_mg=1.02,
                gyro_bias_sd_degph=0.1,
                position_sd_m=(0.1, 0.1, 0.1),
            ),
            dvl=MATCHED.dvl,
            heading=Heading(sd_deg=2.0),
            position=Position(sd_m=2.0, lever_arm_m=arm_m),
            filters={"aided": Filter(aiding=("velocity", "heading", "position"))},
        )
        dive = replace(dive, sensors=late, reference=None)
        prepared = prepare_dive(dive, settings)
        history = run_one(prepared.filters[0], prepared, prepared_timeline(dive, prepared))
        apart_m = np.array(
            north_east_m(history.position[-1], truth.position[-1], truth.position[-1])
        )
        turned = rpy_from_mat(history.mat_nb[-1])[2] - rpy_from_mat(truth.mat_nb[-1])[2]
        off.append(
            np.append(apart_m, wrap_angle(np.asarray(turned))) / history.sd[-1, [12, 13, 5]]
        )
    nees = np.mean(np.square(off), axis=0)
    assert 0.6 < nees[:2].mean() < 1.5, nees  # 95 %: 0.64 to 1.44
    assert 0.5 < nees[2] < 1.7, nees  # 0.52 to 1.64


def test_what_is_configured_goes_before_a_sensor() -> None:
    dive = simulated(
        duration_s=120.0, heading=SensorErrors(1.0, 1.0), position=SensorErrors(2.0, 1.0)
    )
    replay = started(dive, heading_deg=10.0, latitude_deg=60.0)
    assert rpy_from_mat(replay.histories[0].mat_nb[0])[2] == pytest.approx(np.deg2rad(10.0))
    assert replay.histories[0].position[0, 0] == pytest.approx(np.deg2rad(60.0))


def test_a_heading_that_begins_late_is_no_start() -> None:
    dive = simulated(
        duration_s=120.0, heading=SensorErrors(1.0, 1.0), position=SensorErrors(2.0, 1.0)
    )
    late = dive.sensors["heading"]
    late = SensorColumns(late.time_ns[10:], late.values[10:])
    with pytest.raises(LogError, match=r"10\.0 s"):
        started(replace(dive, sensors={**dive.sensors, "heading": late}))


def test_a_sensor_s_heading_is_read_though_no_filter_is_aided_by_it(tmp_path: Path) -> None:
    write_dive(tmp_path / "dive.mcap", simulated(duration_s=60.0, heading=SensorErrors(1.0, 4.0)))
    level = msgspec.structs.replace(MEMS.initial, source="level", heading_deg="sensor")
    replay = replay_log(tmp_path / "dive.mcap", config(initial=level, noise=MEMS.noise))
    assert "start_heading_sensor" in {note.code for note in replay.notes}
    facts = inspect_log(tmp_path / "dive.mcap", config(initial=level, noise=MEMS.noise))
    assert not facts.blockers
