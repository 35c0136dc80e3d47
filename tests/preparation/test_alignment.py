"""Where a replay starts: at the reference's first attitude, or level from gravity, and what is said otherwise."""

import re
from dataclasses import replace
from typing import Literal

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config import Config, Dvl, Initial, Vector
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats, ImuColumns, ReferenceColumns
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.core.states import DEG, DEG_PER_HOUR, MG
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.nav.dvl import dvl_velocities
from insdvl_replay.nav.levelling import LEVELLING_S
from insdvl_replay.preparation.alignment import Alignment, align
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.preparation.start_sources import initial_sd
from insdvl_replay.sim.dive import FIRST_PING_S, START_NS, exact_dive
from insdvl_replay.sim.trajectories import SCENARIOS, Trajectory

SECOND = 1_000_000_000
LEVEL = Initial(
    source="level", heading_deg=30.0, latitude_deg=32.8, longitude_deg=34.9, height_m=-20.0
)


@pytest.fixture(scope="module")
def dive() -> Dive:
    return exact_dive("figure-eight", duration_s=110.0, imu_rate_hz=50.0)


def reference_of(dive: Dive) -> ReferenceColumns:
    assert dive.reference is not None
    return dive.reference


def aligned(
    dive: Dive,
    reference: ReferenceColumns | None,
    initial: Initial,
    start_s: float = 0.0,
    lever_arm_m: Vector = (0.0, 0.0, 0.0),
) -> Alignment:
    config = Config(initial=initial, dvl=Dvl(lever_arm_m=lever_arm_m))
    start_ns, end_ns = START_NS + round(start_s * SECOND), int(dive.imu.time_ns[-1])
    return align(
        replace(dive, reference=reference), config, dvl_velocities(dive.dvl), start_ns, end_ns
    )


def rows(reference: ReferenceColumns, keep: slice) -> ReferenceColumns:
    return ReferenceColumns(
        reference.time_ns[keep],
        reference.position[keep],
        reference.velocity_n[keep],
        reference.mat_nb[keep],
    )


def without(reference: ReferenceColumns, quantity: str) -> ReferenceColumns:
    return replace(reference, **{quantity: np.full_like(getattr(reference, quantity), np.nan)})


def codes(alignment: Alignment) -> list[str]:
    """Return what was noted besides the uncertainty, of which `test_start_sources` tells."""
    return [note.code for note in alignment.notes if note.code != "start_source"]


# --- From the reference.


@pytest.mark.parametrize(("first_row", "start_s"), [(0, 0.0), (7, 0.0), (7, 1.4), (0, 1.3)])
def test_start_is_the_references_first_attitude_in_the_span(
    dive: Dive, first_row: int, start_s: float
) -> None:
    reference = reference_of(dive)
    found = aligned(dive, rows(reference, slice(first_row, None)), Initial(), start_s)
    row = max(first_row, int(np.ceil(start_s * 5.0)))
    assert found.start_ns == reference.time_ns[row]
    np.testing.assert_array_equal(found.start.mat_nb, reference.mat_nb[row])
    np.testing.assert_allclose(found.start.velocity_n, reference.velocity_n[row], atol=1e-12)
    np.testing.assert_allclose(found.start.position, reference.position[row], rtol=0.0, atol=1e-13)
    assert codes(found) == []


def test_start_waits_for_an_attitude(dive: Dive) -> None:
    reference = reference_of(dive)
    mat_nb = reference.mat_nb.copy()
    mat_nb[:12] = np.nan
    assert (
        aligned(dive, replace(reference, mat_nb=mat_nb), Initial()).start_ns
        == reference.time_ns[12]
    )


@pytest.mark.parametrize("quantity", ["position", "velocity_n"])
def test_what_the_first_attitude_lacks_comes_from_the_rows_next_to_it(
    dive: Dive, quantity: str
) -> None:
    reference = reference_of(dive)
    known = getattr(reference, quantity)
    gappy = known.copy()
    gappy[5] = np.nan
    found = aligned(dive, replace(reference, **{quantity: gappy}), Initial(), start_s=1.0)
    assert found.start_ns == reference.time_ns[5]
    np.testing.assert_allclose(
        getattr(found.start, quantity), (known[4] + known[6]) / 2.0, rtol=0.0, atol=1e-12
    )
    cut = rows(replace(reference, **{quantity: gappy}), slice(5, None))
    np.testing.assert_allclose(
        getattr(aligned(dive, cut, Initial()).start, quantity), known[6], rtol=0.0, atol=1e-12
    )


def test_position_is_interpolated_across_the_antimeridian() -> None:
    time_ns = START_NS + SECOND * np.array([0, 1, 2])
    position = np.array(
        [[-17.0 * DEG, 179.9 * DEG, -5.0], [np.nan] * 3, [-17.0 * DEG, -179.9 * DEG, -7.0]]
    )
    attitude = np.stack([np.full((3, 3), np.nan), np.eye(3), np.eye(3)])
    dive = exact_dive("straight", duration_s=20.0, imu_rate_hz=20.0)
    start = aligned(
        dive, ReferenceColumns(time_ns, position, np.zeros((3, 3)), attitude), Initial()
    ).start
    np.testing.assert_allclose(
        np.abs(start.position / [DEG, DEG, 1.0]), [17.0, 180.0, 6.0], atol=1e-9
    )


def test_reference_without_heights_starts_at_the_configured_one(dive: Dive) -> None:
    reference = reference_of(dive)
    position = reference.position.copy()
    position[:, 2] = np.nan
    found = aligned(dive, replace(reference, position=position), Initial(height_m=-12.0))
    np.testing.assert_allclose(
        found.start.position, [*reference.position[0, :2], -12.0], rtol=0.0, atol=1e-13
    )
    assert codes(found) == ["start_height_configured"]


def test_reference_without_velocity_starts_with_the_nearest_ping() -> None:
    ping_s = FIRST_PING_S + 103.0
    motion = Trajectory(SCENARIOS["figure-eight"], 110.0).at(np.array([ping_s]))
    reference = ReferenceColumns(
        START_NS + np.rint(np.array([ping_s]) * 1e9).astype(np.int64),
        motion.position,
        np.full((1, 3), np.nan),
        motion.mat_nb,
    )
    assert np.linalg.norm(motion.turn_rate_b[0]) > 10.0 * DEG, (
        "the lever arm matters only in a turn"
    )
    arm: Vector = (-1.5, 0.4, 0.3)
    turning = exact_dive("figure-eight", duration_s=110.0, imu_rate_hz=200.0, lever_arm_m=arm)
    found = aligned(turning, reference, Initial(), lever_arm_m=arm)
    np.testing.assert_allclose(found.start.velocity_n, motion.velocity_n[0], atol=1e-4)
    assert codes(found) == ["start_velocity_dvl"]
    assert " 0.00 s " in found.notes[0].text
    assert (
        np.linalg.norm(
            aligned(turning, reference, Initial()).start.velocity_n - motion.velocity_n[0]
        )
        > 0.1
    )


def test_reference_without_attitude_starts_level_at_the_first_sample(dive: Dive) -> None:
    reference = without(reference_of(dive), "mat_nb")
    found = aligned(dive, reference, Initial(heading_deg=30.0), start_s=0.02)
    assert found.start_ns == START_NS + 20_000_000
    assert codes(found) == ["start_levelled"]
    # Of the attitude at the start alone, though the vehicle swings by 1 deg in 17 and 31 s.
    mat_nb = Trajectory(SCENARIOS["figure-eight"], 110.0).at(np.array([0.02])).mat_nb[0]
    np.testing.assert_allclose(
        rpy_from_mat(found.start.mat_nb) / DEG, rpy_from_mat(mat_nb) / DEG, atol=0.01
    )
    np.testing.assert_allclose(found.start.velocity_n, reference.velocity_n[0], atol=1e-3)


def test_reference_without_attitude_needs_a_heading(dive: Dive) -> None:
    with pytest.raises(ConfigError, match="heading") as caught:
        aligned(dive, without(reference_of(dive), "mat_nb"), Initial())
    assert "initial.heading_deg" in caught.value.hint


def test_reference_without_position_starts_at_the_configured_one(dive: Dive) -> None:
    reference = without(reference_of(dive), "position")
    configured = Initial(latitude_deg=-17.0, longitude_deg=178.0, height_m=-12.0)
    found = aligned(dive, reference, configured)
    np.testing.assert_allclose(found.start.position, [-17.0 * DEG, 178.0 * DEG, -12.0], atol=1e-15)
    np.testing.assert_array_equal(found.start.mat_nb, reference.mat_nb[0])
    assert codes(found) == ["start_position_configured"]
    with pytest.raises(ConfigError, match="latitude") as caught:
        aligned(dive, reference, Initial())
    assert "initial.latitude_deg" in caught.value.hint


@pytest.mark.parametrize(
    "keep", [slice(0, 5), slice(300, None)], ids=["ends before", "begins after"]
)
def test_reference_outside_the_span_cannot_start_it(keep: slice) -> None:
    reference = rows(
        reference_of(exact_dive("straight", duration_s=120.0, imu_rate_hz=10.0)), keep
    )
    dive = exact_dive("straight", duration_s=40.0, imu_rate_hz=10.0)
    with pytest.raises(LogError, match="attitude") as caught:
        aligned(dive, reference, Initial(), start_s=1.0)
    assert "reference.stamp" in caught.value.hint


def test_last_sample_is_no_start(dive: Dive) -> None:
    last = rows(reference_of(dive), slice(-1, None))
    assert last.time_ns[0] == dive.imu.time_ns[-1]
    with pytest.raises(LogError, match="attitude"):
        aligned(dive, last, Initial())


def test_no_reference_to_start_from_says_how_to_start_level(dive: Dive) -> None:
    with pytest.raises(LogError, match="reference") as caught:
        aligned(dive, None, Initial())
    for key in (
        "initial.source=level",
        "initial.heading_deg",
        "initial.latitude_deg",
        "reference.topic",
        "source=sensor",
    ):
        assert key in caught.value.hint


# --- Level from gravity.


def tilted(imu: ImuColumns, rpy_deg: Floats, heading_deg: float) -> ImuColumns:
    """Turn a level IMU in its place to another roll and pitch."""
    turn = Rotation.from_euler("ZYX", rpy_deg[::-1], degrees=True).inv() * Rotation.from_euler(
        "Z", heading_deg, degrees=True
    )
    return replace(
        imu,
        specific_force_b=turn.apply(imu.specific_force_b),
        angular_rate_b=turn.apply(imu.angular_rate_b),
    )


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg"),
    [(0.0, 0.0), (3.0, -2.0), (-40.0, 25.0), (170.0, 5.0), (-90.0, 0.0), (10.0, 80.0)],
)
def test_roll_and_pitch_come_from_gravity(roll_deg: float, pitch_deg: float) -> None:
    rpy_deg = np.array([roll_deg, pitch_deg, 75.0])
    static = exact_dive("static", duration_s=20.0, imu_rate_hz=20.0)
    static = replace(static, imu=tilted(static.imu, rpy_deg, heading_deg=30.0))
    found = aligned(static, None, Initial(source="level", heading_deg=75.0, latitude_deg=32.8))
    expected = Rotation.from_euler("ZYX", rpy_deg[::-1], degrees=True)
    error = expected.inv() * Rotation.from_matrix(found.start.mat_nb)
    assert error.magnitude() < 1e-6 * DEG
    assert codes(found) == ["start_position_configured", "start_velocity_dvl", "start_levelled"]


def test_levelling_looks_at_the_first_seconds_alone() -> None:
    static = exact_dive("static", duration_s=40.0, imu_rate_hz=20.0)
    rng = np.random.default_rng(2)
    force_b = tilted(static.imu, np.array([2.0, -1.0, 0.0]), 30.0).specific_force_b
    force_b += 0.05 * rng.standard_normal(force_b.shape)
    later = static.imu.time_ns > START_NS + 5 * SECOND + int(LEVELLING_S * SECOND)
    earlier = static.imu.time_ns < START_NS + 5 * SECOND
    force_b[later | earlier] = [9.0, 0.0, 0.0]
    found = aligned(
        replace(static, imu=replace(static.imu, specific_force_b=force_b)),
        None,
        LEVEL,
        start_s=5.0,
    )
    # 0.05 m/s^2 at 20 Hz are 11 mm/s/sqrt(s), of which 10 s leave 4 mm/s^2, 0.02 deg; four of these.
    np.testing.assert_allclose(
        rpy_from_mat(found.start.mat_nb) / DEG, [2.0, -1.0, 30.0], atol=0.08
    )


def test_level_start_takes_position_and_height_of_the_reference_and_nothing_else(
    dive: Dive,
) -> None:
    reference = reference_of(dive)
    astray = replace(
        reference, velocity_n=reference.velocity_n + 5.0, mat_nb=reference.mat_nb[:, ::-1]
    )
    found = aligned(dive, astray, Initial(source="level", heading_deg=30.0))
    assert found.start_ns == START_NS
    np.testing.assert_allclose(found.start.position, reference.position[0], rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(found.start.velocity_n, reference.velocity_n[0], atol=2e-3)
    np.testing.assert_allclose(rpy_from_mat(found.start.mat_nb) / DEG, [0.0, 0.0, 30.0], atol=0.01)
    assert codes(found) == ["start_velocity_dvl", "start_levelled", "start_heading_contradiction"]


@pytest.mark.parametrize(
    ("heading_deg", "told"), [(30.0, False), (39.0, False), (-319.0, True), (210.0, True)]
)
def test_configured_heading_far_from_the_references_is_a_warning(
    dive: Dive, heading_deg: float, told: bool
) -> None:
    found = aligned(dive, reference_of(dive), Initial(source="level", heading_deg=heading_deg))
    notes = [note for note in found.notes if note.code == "start_heading_contradiction"]
    assert len(notes) == told
    if told:
        assert f" {heading_deg % 360.0:.0f} deg " in notes[0].text
        assert (notes[0].severity, notes[0].hint) == ("warning", "initial.heading_deg = 30.0")


@pytest.mark.parametrize(
    ("heading_deg", "told"),
    [(77.0, True), (37.0, True), (34.0, False), (-330.0, False), (None, False), ("fit", False)],
)
def test_configured_heading_next_to_a_references_attitude_is_a_warning(
    dive: Dive, heading_deg: float | Literal["fit"] | None, told: bool
) -> None:
    found = aligned(dive, reference_of(dive), Initial(heading_deg=heading_deg))
    np.testing.assert_allclose(rpy_from_mat(found.start.mat_nb)[2] / DEG, 30.0, atol=0.01)
    notes = [note for note in found.notes if note.code == "start_heading_idle"]
    assert [note.severity for note in notes] == ["warning"] * told
    for note in notes:
        assert re.match(rf"initial\.heading_deg .*{heading_deg:g}, .*\b30\.0 deg", note.text)


def test_configured_latitude_next_to_a_reference_of_another_is_a_warning(dive: Dive) -> None:
    found = aligned(dive, reference_of(dive), msgspec.structs.replace(LEVEL, latitude_deg=-32.8))
    np.testing.assert_allclose(
        found.start.position, reference_of(dive).position[0], rtol=0.0, atol=1e-13
    )
    (note,) = (note for note in found.notes if note.code == "start_latitude_contradiction")
    assert note.severity == "warning"
    assert re.match(r"initial\.latitude_deg .*-32\.8, .*\b32\.8 deg", note.text)
    assert "start_latitude_contradiction" not in codes(aligned(dive, reference_of(dive), LEVEL))


@pytest.mark.parametrize("quantity", ["position", "velocity_n", "mat_nb"])
def test_rows_that_are_not_finite_start_nothing(dive: Dive, quantity: str) -> None:
    reference = reference_of(dive)
    values = getattr(reference, quantity).copy()
    values[:8] = np.nan
    gappy = replace(reference, **{quantity: values})
    found = aligned(dive, gappy, Initial())
    # The attitude waits for a position near it; a velocity more than a second away is the DVL's matter.
    assert (
        found.start_ns
        == reference.time_ns[{"position": 3, "velocity_n": 0, "mat_nb": 8}[quantity]]
    )
    truth = Trajectory(SCENARIOS["figure-eight"], 110.0).at(
        np.array([(found.start_ns - START_NS) * 1e-9])
    )
    np.testing.assert_allclose(found.start.velocity_n, truth.velocity_n[0], atol=0.02)
    np.testing.assert_array_equal(
        found.start.mat_nb, reference.mat_nb[reference.time_ns == found.start_ns][0]
    )
    assert codes(found) == (["start_velocity_dvl"] if quantity == "velocity_n" else [])


def test_height_that_is_far_from_the_start_is_reported(dive: Dive) -> None:
    reference = reference_of(dive)
    position = reference.position.copy()
    position[:20, 2] = np.nan
    found = aligned(dive, replace(reference, position=position), Initial())
    assert codes(found) == ["start_height_far"]
    assert " 4.0 s" in found.notes[0].text


@pytest.mark.parametrize("key", ["heading_deg", "latitude_deg"])
def test_level_start_needs_heading_and_latitude(dive: Dive, key: str) -> None:
    incomplete = Initial(
        **{"source": "level", "heading_deg": 30.0, "latitude_deg": 32.8, key: None}
    )  # type: ignore[arg-type]
    with pytest.raises(ConfigError) as caught:
        aligned(dive, None, incomplete)
    assert f"--set initial.{key}=" in caught.value.hint


def test_initial_uncertainty_is_in_si_units() -> None:
    initial = Initial(
        velocity_sd_mps=0.3,
        misalignment_sd_deg=(0.1, 0.2, 2.0),
        accel_bias_sd_mg=5.0,
        gyro_bias_sd_degph=7.0,
    )
    expected = (
        [0.3] * 3 + [0.1 * DEG, 0.2 * DEG, 2.0 * DEG] + [5.0 * MG] * 3 + [7.0 * DEG_PER_HOUR] * 3
    )
    np.testing.assert_allclose(initial_sd(initial), expected, rtol=1e-14)


def test_biases_known_beforehand_are_where_the_filter_starts(dive: Dive) -> None:
    assert not aligned(dive, dive.reference, Initial()).start.gyro_bias_b.any()
    start = aligned(
        dive,
        dive.reference,
        Initial(accel_bias_mg=(1.0, 2.0, 3.0), gyro_bias_degph=(4.0, 5.0, 206.0)),
    ).start
    np.testing.assert_allclose(start.accel_bias_b, [1.0 * MG, 2.0 * MG, 3.0 * MG], rtol=1e-15)
    np.testing.assert_allclose(
        start.gyro_bias_b, np.array([4.0, 5.0, 206.0]) * DEG_PER_HOUR, rtol=1e-15
    )


def test_a_bias_that_is_known_costs_nothing(dive: Dive) -> None:
    """A constant error of the gyros that is told beforehand leaves the same dive."""
    bias_b = np.array([0.0, 0.0, 206.0]) * DEG_PER_HOUR
    biased = replace(dive, imu=replace(dive.imu, angular_rate_b=dive.imu.angular_rate_b + bias_b))
    plain, told = (
        load_config("levy-klein"),
        load_config("levy-klein", overrides=["initial.gyro_bias_degph=[0.0, 0.0, 206.0]"]),
    )
    without = replay_dive(dive, plain).histories[0]
    known = replay_dive(biased, told).histories[0]
    np.testing.assert_allclose(known.velocity_n, without.velocity_n, atol=1e-9)  # m/s
    np.testing.assert_allclose(known.gyro_bias_b[0], bias_b, rtol=1e-15)
    np.testing.assert_allclose(
        known.gyro_bias_b - bias_b, without.gyro_bias_b, atol=1e-12
    )  # rad/s
