"""What is said of columns that cannot be true, and of sensors that tell nothing."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from as_text import Cases, noted, refusal

from insdvl_replay.checks.reference import plausibility_notes, reference_notes
from insdvl_replay.checks.reference_delay import with_reference_delay
from insdvl_replay.checks.sensors import contradiction_notes, depth_at_start_notes, sensor_notes
from insdvl_replay.core.config import Config, Depth
from insdvl_replay.core.dive_columns import (
    Dive,
    DvlColumns,
    ImuColumns,
    ReferenceColumns,
    SensorColumns,
)
from insdvl_replay.core.errors import Note
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.sim.dive import START_NS, exact_dive, simulate_dive

SECOND = 1_000_000_000


def notes_of(dive: Dive) -> list[Note]:
    return list(plausibility_notes("a.mcap", dive.imu, dive.dvl, dive.reference, Config()))


def reference_of(dive: Dive) -> ReferenceColumns:
    assert dive.reference is not None
    return dive.reference


def with_imu(dive: Dive, force: Any = 1.0, rate: Any = 1.0) -> Dive:
    imu = dive.imu
    return replace(
        dive, imu=ImuColumns(imu.time_ns, force * imu.specific_force_b, rate * imu.angular_rate_b)
    )


def with_velocity(dive: Dive, heading_deg: float = 0.0, factor: Any = 1.0, zero: Any = ()) -> Dive:
    assert dive.dvl.beam_velocity_mps is not None
    assert dive.dvl.beam_vectors_d is not None
    velocity_d = dive.dvl.beam_velocity_mps @ np.linalg.pinv(dive.dvl.beam_vectors_d).T
    velocity_d = factor * (velocity_d @ mat_from_rpy(np.array([0.0, 0.0, heading_deg * DEG])).T)
    velocity_d[list(zero)] = 0.0
    return replace(dive, dvl=DvlColumns(dive.dvl.time_ns, velocity_d=velocity_d))


def said_by_checks(_: Path) -> Cases:
    """Return what is said of IMU, DVL, reference and sensors."""
    turning = simulate_dive("figure-eight", duration_s=200.0, imu_rate_hz=50.0, seed=5)
    yield from of_the_imu(turning)
    yield from of_the_dvl(turning)
    yield from of_the_reference(turning)
    yield from of_late_references()
    yield from of_sensors(
        reference_of(simulate_dive("figure-eight", seed=1, duration_s=60.0, grade="mems"))
    )


def of_the_imu(turning: Dive) -> Cases:
    slow = simulate_dive("straight", duration_s=60.0, imu_rate_hz=10.0, seed=2)
    for name, dive in (
        ("g for m/s^2", with_imu(turning, force=1.0 / 9.80665)),
        ("half a scale", with_imu(turning, force=0.54)),
        ("no force", with_imu(turning, force=0.0)),
        ("gyros in deg/s", with_imu(turning, rate=1.0 / DEG)),
        ("no rates", with_imu(turning, rate=0.0)),
        ("spinning", with_imu(turning, rate=60.0)),
        ("10 Hz", slow),
    ):
        yield f"an IMU that is refused: {name}", refusal(notes_of, dive)
    rate_b = turning.imu.angular_rate_b.copy()
    rate_b[:, 1] = 0.25
    rows = np.arange(len(turning.imu.time_ns))
    rows[2000:2125] = 2000
    stuck = ImuColumns(
        turning.imu.time_ns, turning.imu.specific_force_b[rows], turning.imu.angular_rate_b[rows]
    )
    for name, dive in (
        ("20 Hz", simulate_dive("straight", duration_s=60.0, imu_rate_hz=20.0, seed=2)),
        ("nine tenths of gravity", with_imu(turning, force=0.9)),
        ("upside down", with_imu(turning, force=-1.0)),
        ("a dead axis", replace(turning, imu=replace(turning.imu, angular_rate_b=rate_b))),
        ("stuck", replace(turning, imu=stuck)),
        ("another scale of the gyros", with_imu(turning, rate=0.6)),
        ("gyros that turn the other way", with_imu(turning, rate=-1.0)),
        (
            "one gyro that turns the other way",
            with_imu(turning, np.array([1, -1, 1]), np.array([1, -1, 1])),
        ),
    ):
        yield f"an IMU: {name}", noted(notes_of(dive))


def of_the_dvl(turning: Dive) -> Cases:
    for name, dive in (
        ("backwards", with_velocity(turning, 180.0)),
        ("another scale", with_velocity(turning, factor=1.3)),
        ("a component that is zero", with_velocity(turning, factor=np.array([1, 0, 1]))),
        ("two pings of zero", with_velocity(turning, zero=[30, 50])),
    ):
        yield f"a DVL: {name}", noted(notes_of(dive))


def of_the_reference(turning: Dive) -> Cases:
    reference = reference_of(turning)
    swapped = replace(reference, position=reference.position[:, [1, 0, 2]])
    yield "a reference: positions swapped", noted(notes_of(replace(turning, reference=swapped)))
    straight = exact_dive("straight", imu_rate_hz=20.0, reference_rate_hz=2.0)
    exact = reference_of(straight)
    position, mat_nb = exact.position.copy(), exact.mat_nb.copy()
    position[exact.time_ns > START_NS + 100 * SECOND, 0] += 5.0 / 6.36e6
    mat_nb[exact.time_ns > START_NS + 50 * SECOND] @= mat_from_rpy(
        np.array([0.0, 0.0, 12.0 * DEG])
    )
    for name, columns in (
        ("a position that jumps", replace(exact, position=position)),
        ("a heading that jumps", replace(exact, mat_nb=mat_nb)),
        ("a velocity of another scale", replace(exact, velocity_n=1.3 * exact.velocity_n)),
    ):
        notes = list(reference_notes(straight.imu, straight.dvl, columns))
        yield f"a reference: {name}", noted(notes)


def of_late_references() -> Cases:
    dive = simulate_dive(
        "calibration", seed=1, duration_s=200.0, grade="fog", reference_rate_hz=20.0
    )
    reference = reference_of(dive)
    late = replace(reference, time_ns=reference.time_ns + SECOND // 5)
    other_clock = replace(reference, time_ns=reference.time_ns - 4 * SECOND)
    rows = 6
    velocity_n = np.roll(reference.velocity_n, rows, axis=0)
    mixed = replace(reference, velocity_n=velocity_n).rows(slice(rows, None))
    references = {"late": late, "of another clock": other_clock, "whose velocity is late": mixed}
    for name, columns in references.items():
        notes = list(
            with_reference_delay(replace(dive, reference=columns, notes=()), Config()).notes
        )
        yield f"a reference: {name}", noted(notes)


def of_sensors(moving: ReferenceColumns) -> Cases:
    time_ns = np.arange(200) * SECOND // 5
    still, swell = np.full(200, -10.36), np.round(np.abs(0.02 * np.sin(0.2 * np.arange(200))), 1)
    for name, values in (("stuck", still), ("coarse", swell)):
        yield (
            f"a depth: {name}",
            noted(
                sensor_notes({"depth": SensorColumns(time_ns, values[:, None])}, None, Config())
            ),
        )
    depth_sensor = {"depth": SensorColumns(moving.time_ns, -moving.position[:, 2:])}
    for surface_m in (10.0, -10.0):
        zero = Depth(surface_height_m=surface_m)
        yield (
            f"a depth of the surface {surface_m:g} m",
            noted(contradiction_notes(depth_sensor, moving, zero)),
        )
    start = moving.rows(np.arange(len(moving.time_ns)) == 0)
    at_start = depth_at_start_notes(
        depth_sensor, None, start, Config(depth=Depth(surface_height_m=10.0))
    )
    yield "a depth at the start", noted(at_start)
    astray = np.deg2rad(np.linspace(-120.0, 120.0, 201) + 30.0)
    nothing = np.zeros((201, 3))
    lying = ReferenceColumns(
        np.arange(201) * SECOND, nothing, nothing, np.tile(np.eye(3), (201, 1, 1))
    )
    heading = {"heading": SensorColumns(lying.time_ns, astray[:, None])}
    yield "a heading astray", noted(contradiction_notes(heading, lying, Depth()))
