"""Losses against the reference: errors put in come out squared, in their units, and only where they are known."""

from dataclasses import replace

import numpy as np
import pytest

from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns
from insdvl_replay.core.states import DEG
from insdvl_replay.evaluation.evidence import FEWEST_STARTS, ReferenceNoise, accuracy_errors
from insdvl_replay.evaluation.reference_errors import DrawnErrors
from insdvl_replay.sim.dive import exact_dive

NOISE = ReferenceNoise(0.1, 0.02, 0.3)
DRIFT_MPS, SCALE_MPS, ROLL_DEG, HEADING_DEG = 0.05, 0.02, 0.4, 0.7
ALL = [
    "drift_30s", "drift_60s", "drift_100m", "velocity_along", "velocity_across", "depth_60s", "level", "heading"
]  # fmt: skip


@pytest.fixture(scope="module")
def dive() -> Dive:
    return exact_dive("straight", duration_s=300.0, imu_rate_hz=10.0, reference_rate_hz=1.0)


def reference_of(dive: Dive) -> ReferenceColumns:
    assert dive.reference is not None
    return dive.reference


def drawn(dive: Dive, starts: int = FEWEST_STARTS, unknown: slice = slice(0, 0)) -> DrawnErrors:
    """Runs that drift north, are too fast by their course, and lean; nothing is known of some of the times."""
    reference = reference_of(dive)
    time_ns = reference.time_ns[1:]
    time_s = (time_ns - reference.time_ns[0]) * 1e-9
    course = reference.velocity_n[1:] / np.linalg.norm(reference.velocity_n[1:], axis=1, keepdims=True)
    position_m = np.outer(time_s, [DRIFT_MPS, 0.0, 0.01])
    velocity_mps = SCALE_MPS * course
    position_m[unknown], velocity_mps[unknown] = np.nan, np.nan
    error = np.zeros((starts, len(time_s), 12))
    error[1:, :, 3], error[1:, :, 5] = ROLL_DEG * DEG, HEADING_DEG * DEG
    error[:, unknown] = np.nan
    position_m, velocity_mps = (np.tile(column, (starts, 1, 1)) for column in (position_m, velocity_mps))
    return DrawnErrors(
        "aided", time_ns, time_s, position_m, velocity_mps, error, np.ones((len(time_s), 12)), position_m
    )


def rms(squared: Floats) -> float:
    return float(np.sqrt(np.nanmean(squared)))


def test_each_quantity_is_the_square_of_what_was_put_in(dive: Dive) -> None:
    found = accuracy_errors(drawn(dive), reference_of(dive), NOISE, bridged_gaps=False)
    assert list(found) == ALL
    speed_mps = float(np.linalg.norm(reference_of(dive).velocity_n[0]))
    expected = {
        "drift_30s": 30.0 * DRIFT_MPS,
        "drift_60s": 60.0 * DRIFT_MPS,
        "drift_100m": 100.0 / speed_mps * DRIFT_MPS,
        "velocity_along": SCALE_MPS,
        "velocity_across": 0.0,
        "depth_60s": 60.0 * 0.01,
        "level": ROLL_DEG / np.sqrt(2.0),
        "heading": HEADING_DEG,
    }
    units = {"m": {"drift_30s", "drift_60s", "drift_100m", "depth_60s"}, "deg": {"level", "heading"}}
    for quantity, squared_errors in found.items():
        assert rms(squared_errors.squared) == pytest.approx(expected[quantity], rel=0.02, abs=1e-9), quantity
        assert squared_errors.unit == next((unit for unit, names in units.items() if quantity in names), "m/s")
        assert len(squared_errors.squared) == FEWEST_STARTS - (quantity in units["deg"])


def test_floors_are_what_the_reference_itself_errs_by(dive: Dive) -> None:
    """A drift is the difference of two positions, horizontal ones with two components."""
    found = accuracy_errors(drawn(dive), reference_of(dive), NOISE, bridged_gaps=False)
    floors = {quantity: squared_errors.floor for quantity, squared_errors in found.items()}
    assert floors == pytest.approx(
        {
            **dict.fromkeys(ALL[:3], 2.0 * NOISE.position_m),
            **dict.fromkeys(ALL[3:5], NOISE.velocity_mps),
            "depth_60s": np.sqrt(2.0) * NOISE.position_m,
            **dict.fromkeys(ALL[6:], NOISE.attitude_deg),
        }
    )
    rng = np.random.default_rng(1)
    noise_m = NOISE.position_m * rng.standard_normal((2, 100_000, 3))
    assert np.sqrt(np.mean(np.sum(np.diff(noise_m, axis=0)[0, :, :2] ** 2, axis=1))) == pytest.approx(
        floors["drift_30s"], rel=0.01
    )


def test_segments_share_what_their_neighbours_are_made_of(dive: Dive) -> None:
    found = accuracy_errors(drawn(dive), reference_of(dive), NOISE, bridged_gaps=False)
    assert found["drift_60s"].least_block == 2 * found["drift_30s"].least_block > 2
    assert found["velocity_along"].least_block == 1


def test_positions_through_a_long_gap_of_the_imu_are_no_evidence(dive: Dive) -> None:
    found = accuracy_errors(drawn(dive), reference_of(dive), NOISE, bridged_gaps=True)
    assert list(found) == ["velocity_along", "velocity_across", "level", "heading"]


@pytest.mark.parametrize(("unknown", "left"), [(slice(0, 20), ALL), (slice(100, 200), [])])
def test_what_the_reference_does_not_cover_is_left_out(dive: Dive, unknown: slice, left: list[str]) -> None:
    assert list(accuracy_errors(drawn(dive, unknown=unknown), reference_of(dive), NOISE, bridged_gaps=False)) == left


def test_attitude_from_few_starts_is_no_evidence(dive: Dive) -> None:
    few = accuracy_errors(drawn(dive, FEWEST_STARTS - 1), reference_of(dive), NOISE, bridged_gaps=False)
    assert list(few) == ALL[:6]


def test_reference_without_positions_has_velocities(dive: Dive) -> None:
    whole = drawn(dive)
    nothing = np.full_like(whole.position_error_ned_m, np.nan)
    nowhere = replace(whole, position_error_ned_m=nothing, drifting_ned_m=nothing)
    found = accuracy_errors(nowhere, reference_of(dive), NOISE, bridged_gaps=False)
    assert list(found) == ["velocity_along", "velocity_across", "level", "heading"]
