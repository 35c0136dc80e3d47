"""Sensors beside IMU and DVL that tell nothing."""

import re
from collections.abc import Mapping

import numpy as np
import pytest

from insdvl_replay.checks.sensors import (
    contradiction_notes,
    depth_at_start_notes,
    sensor_notes,
    solution_notes,
)
from insdvl_replay.core.config import Config, Depth, Filter, Position, Reference, Solution
from insdvl_replay.core.dive_columns import ReferenceColumns, SensorColumns, SolutionColumns
from insdvl_replay.sim.dive import simulate_dive

SECOND = 1_000_000_000


def read(values: list[float], rate_hz: float) -> Mapping[str, SensorColumns]:
    time_ns = np.arange(len(values)) * round(SECOND / rate_hz)
    return {"depth": SensorColumns(time_ns, np.array(values)[:, None])}


@pytest.mark.parametrize(
    ("values", "rate_hz", "stuck"),
    [
        ([-10.36] * 200, 5.0, 200),
        ([-10.36] * 199 + [-10.35], 5.0, None),  # it moved
        ([-10.36] * 100, 5.0, None),  # for 20 s a vehicle may hover
        ([-10.36] * 19, 0.1, None),  # too few to say so
    ],
)
def test_a_sensor_whose_readings_are_all_the_same_is_stuck(
    values: list[float], rate_hz: float, stuck: int | None
) -> None:
    notes = sensor_notes(read(values, rate_hz), None, Config())
    assert [note.count for note in notes] == ([] if stuck is None else [stuck])
    assert all(note.code == "depth_stuck" and "depth.topic" in note.hint for note in notes)


def test_a_receiver_without_heights_is_stuck_all_the_same() -> None:
    fixes = SensorColumns(np.arange(200) * SECOND, np.tile([0.5, 0.6, np.nan], (200, 1)))
    assert [note.code for note in sensor_notes({"position": fixes}, None, Config())] == [
        "position_stuck"
    ]


# --- Made of one message, read with another latency each.


@pytest.fixture(scope="module")
def moving() -> ReferenceColumns:
    """Of 5 Hz."""
    reference = simulate_dive("figure-eight", seed=1, duration_s=60.0, grade="mems").reference
    assert reference is not None
    return reference


def behind(columns: ReferenceColumns, latency_s: float) -> ReferenceColumns:
    return ReferenceColumns(
        columns.time_ns - round(latency_s * SECOND),
        columns.position,
        columns.velocity_n,
        columns.mat_nb,
    )


@pytest.mark.parametrize(("ours_s", "theirs_s"), [(0.0, 0.7), (1.1, 0.0), (3.0, 2.5)])
def test_readings_of_the_reference_are_known_behind_any_latency(
    moving: ReferenceColumns, ours_s: float, theirs_s: float
) -> None:
    config = Config(
        position=Position(latency_s=ours_s),
        reference=Reference(latency_s=theirs_s),
        filters={"told": Filter(solution=Solution(topic="/odometry", latency_s=ours_s))},
    )
    ours, theirs = behind(moving, ours_s), behind(moving, theirs_s)
    fixes = SensorColumns(ours.time_ns, ours.position)
    assert [note.code for note in sensor_notes({"position": fixes}, theirs, config)] == [
        "position_is_reference"
    ]
    none = np.empty(0, dtype=np.int64)
    solutions = {"told": SolutionColumns(ours, None, none, np.empty((0, 9, 9)))}
    assert [note.code for note in solution_notes(solutions, theirs, config)] == [
        "solution_told_is_reference"
    ]


# --- What a heading that follows nothing is said to be.


def test_a_heading_astray_is_reported_by_what_was_computed() -> None:
    """Spread evenly over 240 deg, half of it is more than 60 deg off the middle."""
    time_ns = np.arange(201) * SECOND
    off = np.deg2rad(np.linspace(-120.0, 120.0, 201) + 30.0)
    still = ReferenceColumns(
        time_ns, *(np.zeros((201, 3)) for _ in range(2)), np.tile(np.eye(3), (201, 1, 1))
    )
    (note,) = contradiction_notes(
        {"heading": SensorColumns(time_ns, off[:, None])}, still, Depth()
    )
    assert note.code == "heading_contradiction"
    assert re.findall(r"\d+", note.text) == ["30", "201", "60"]


# --- A gauge whose zero is told.


@pytest.mark.parametrize(
    ("surface_m", "told"),
    [(None, []), (1.5, []), (-0.5, []), (10.0, ["above"]), (-10.0, ["below"])],
)
def test_a_depth_sensor_with_another_zero_than_the_references_is_reported(
    moving: ReferenceColumns, surface_m: float | None, told: list[str]
) -> None:
    """It reads absolute pressure, or its zero is that of another surface."""
    depth_sensor = {"depth": SensorColumns(moving.time_ns, 0.4 - moving.position[:, 2:])}
    arm = Depth(surface_height_m=surface_m, lever_arm_m=(0.0, 0.0, 0.4))
    notes = contradiction_notes(depth_sensor, moving, arm)
    assert [(note.code, note.severity) for note in notes] == [
        ("depth_contradiction", "warning")
    ] * len(told)
    for note, where in zip(notes, told, strict=True):
        assert re.search(rf"\b10\.00 m {where} .*\b301 ", note.text)
        assert "depth.surface_height_m" in (note.hint or "")


@pytest.mark.parametrize(
    ("surface_m", "late_s", "told"),
    [(None, 0.0, 0), (4.0, 0.0, 0), (-10.0, 0.0, 1), (10.0, 0.0, 1), (10.0, 3.0, 0)],
)
def test_first_depth_is_held_against_the_height_at_the_start_without_a_reference(
    moving: ReferenceColumns, surface_m: float | None, late_s: float, told: int
) -> None:
    depth_sensor = {
        "depth": SensorColumns(moving.time_ns + round(late_s * SECOND), -moving.position[:, 2:])
    }
    start = moving.rows(np.arange(len(moving.time_ns)) == 0)
    config = Config(depth=Depth(surface_height_m=surface_m))
    notes = depth_at_start_notes(depth_sensor, None, start, config)
    assert [note.code for note in notes] == ["depth_contradiction"] * told
    assert all(
        f"m {'above' if (surface_m or 0.0) > 0.0 else 'below'} " in note.text for note in notes
    )
    assert depth_at_start_notes(depth_sensor, moving, start, config) == (), "the reference tells"
