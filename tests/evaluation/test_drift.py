"""Drift and course errors of worlds whose answer is known, and the table of both."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns
from insdvl_replay.core.quantities import DRIFT_QUANTITIES, TRACK_FIT_QUANTITIES
from insdvl_replay.core.tables import DriftRow
from insdvl_replay.evaluation.drift import (
    course_errors,
    distance_segments,
    drift_table,
    segment_change,
    time_segments,
    track_fit_table,
)
from insdvl_replay.evaluation.reference_errors import ReferenceErrors, reference_distance_m
from insdvl_replay.geometry.frames import moved_position

SECOND = 1_000_000_000
TIME_NS = SECOND * np.arange(1, 401, dtype=np.int64)
TIME_S = np.arange(1.0, 401.0)
START = np.array([0.57, 0.61, -20.0])


def errors_of(
    position_ned_m: Floats, velocity_n: Floats | None = None, step_s: float = 1.0
) -> ReferenceErrors:
    k = len(position_ned_m)
    return ReferenceErrors(
        (1_700_000_000 * SECOND + np.arange(1, k + 1) * step_s * SECOND).astype(np.int64),
        position_ned_m,
        np.zeros((k, 3)) if velocity_n is None else velocity_n,
        np.zeros((k, 3)),
        100.0,
        position_ned_m,
    )


def growing(k: int, per_s: tuple[float, float, float]) -> Floats:
    return np.outer(np.arange(1, k + 1), per_s)


def going(k: int, velocity_n: Floats) -> ReferenceColumns:
    """A reference whose positions are the sum of its velocities, once a second."""
    moved_m = np.cumsum(np.broadcast_to(velocity_n, (k, 3)), axis=0)
    return ReferenceColumns(
        errors_of(moved_m).time_ns,
        moved_position(np.tile(START, (k, 1)), moved_m),
        np.array(np.broadcast_to(velocity_n, (k, 3))),
        np.full((k, 3, 3), np.nan),
    )


def horizontal_m(change_ned_m: Floats) -> Floats:
    """Return the lengths of horizontal changes, shape (m,)."""
    return np.asarray(np.hypot(change_ned_m[:, 0], change_ned_m[:, 1]))


# --- Segments and what is lost inside them.


def test_error_that_grows_evenly_drifts_alike_over_every_segment() -> None:
    errors = errors_of(growing(400, (0.03, -0.04, 0.01)))
    drift = segment_change(errors, time_segments(errors.time_ns))
    assert len(horizontal_m(drift)) == 68, "starts every 5 s, as long as 60 s are left"
    np.testing.assert_allclose(horizontal_m(drift), 3.0, atol=1e-9)
    np.testing.assert_allclose(drift[:, 2], 0.6, atol=1e-9)
    segments = time_segments(errors.time_ns)
    np.testing.assert_array_equal(
        errors.time_ns[segments.last] - errors.time_ns[segments.first], 60 * SECOND
    )


def test_error_that_stays_is_no_drift() -> None:
    errors = errors_of(np.full((200, 3), 7.0))
    assert not segment_change(errors, time_segments(errors.time_ns)).any()


def test_correction_of_the_position_is_no_drift() -> None:
    """Half of the error is taken out halfway; the positions of the vehicle move on as before."""
    dead_reckoned = growing(400, (0.03, -0.04, 0.01))
    corrected = dead_reckoned - np.where(
        np.arange(400)[:, None] < 200, 0.0, 0.5 * dead_reckoned[200]
    )
    errors = replace(errors_of(corrected), drifting_ned_m=dead_reckoned)
    drift = segment_change(errors, time_segments(errors.time_ns))
    np.testing.assert_allclose(horizontal_m(drift), 3.0, atol=1e-9)


def test_random_walk_drifts_by_the_root_of_the_time() -> None:
    walk = np.cumsum(0.1 * np.random.default_rng(1).standard_normal((40_000, 3)), axis=0)
    drift = segment_change(errors_of(walk), time_segments(errors_of(walk).time_ns))
    assert np.mean(horizontal_m(drift) ** 2) == pytest.approx(2.0 * 60.0 * 0.01, rel=0.1)
    assert np.mean(drift[:, 2] ** 2) == pytest.approx(60.0 * 0.01, rel=0.1)


def test_worst_segment_is_found_with_its_time() -> None:
    position_m = np.zeros((300, 3))
    position_m[150:, 0] = 5.0
    position_m[150:155, 0] = 6.0
    errors = errors_of(position_m)
    start_ns = int(errors.time_ns[0]) - SECOND
    rows = drift_table("dive", {"aided": errors}, going(300, np.array([2.0, 0.0, 0.0])), start_ns)
    (worst,) = (row for row in rows if row.quantity == "drift_60s")
    assert worst.worst == pytest.approx(6.0)
    assert worst.worst_from_s is not None
    assert worst.worst_to_s == pytest.approx(worst.worst_from_s + 60.0)
    assert worst.worst_from_s < 151.0 <= worst.worst_to_s < 156.0


@pytest.mark.parametrize("k", [0, 1, 2, 50])
def test_dive_shorter_than_a_segment_has_none(k: int) -> None:
    errors = errors_of(np.zeros((k, 3)))
    drift = segment_change(errors, time_segments(errors.time_ns))
    assert drift.shape == (0, 3)


def test_segments_do_not_reach_across_a_hole_where_they_end() -> None:
    errors = errors_of(growing(400, (0.1, 0.0, 0.0)))
    kept = np.r_[0:100, 200:400]
    holed = replace(
        errors,
        time_ns=errors.time_ns[kept],
        position_error_ned_m=errors.position_error_ned_m[kept],
        drifting_ned_m=errors.drifting_ned_m[kept],
        velocity_error_n=errors.velocity_error_n[kept],
    )
    drift = segment_change(holed, time_segments(holed.time_ns))
    assert 30 < len(horizontal_m(drift)) < 60
    assert np.all(np.abs(horizontal_m(drift) - 6.0) <= 0.6 + 1e-9), "of 54 to 66 s"


def test_reference_that_is_slower_than_the_step_gives_fewer_segments() -> None:
    errors = errors_of(growing(30, (3.0, 4.0, 0.0)), step_s=20.0)
    drift = segment_change(errors, time_segments(errors.time_ns))
    np.testing.assert_allclose(horizontal_m(drift), 15.0, atol=1e-9)
    np.testing.assert_array_equal(np.diff(time_segments(errors.time_ns).first), 1)


def test_what_is_not_known_stays_in_its_place() -> None:
    position_m = growing(200, (0.1, 0.0, 0.0))
    position_m[:40] = np.nan
    errors, full = errors_of(position_m), errors_of(growing(200, (0.2, 0.0, 0.0)))
    segments = time_segments(errors.time_ns)
    drift, other = segment_change(errors, segments), segment_change(full, segments)
    assert np.isnan(horizontal_m(drift)[:8]).all()
    assert np.isfinite(horizontal_m(drift)[8:]).all()
    np.testing.assert_allclose(horizontal_m(other)[8:] / horizontal_m(drift)[8:], 2.0)


# --- Distance.


def test_distance_segments_are_as_long_as_they_say() -> None:
    reference = going(400, np.array([1.2, -1.6, 0.5]))
    errors = errors_of(growing(400, (0.02, 0.0, 0.01)))
    distance_m = reference_distance_m(reference, errors.time_ns)
    assert distance_m[-1] == pytest.approx(399 * 2.0)
    drift = segment_change(errors, distance_segments(errors.time_ns, distance_m))
    np.testing.assert_allclose(horizontal_m(drift), 50 * 0.02, atol=1e-9)


def test_vehicle_that_stops_drifts_over_the_way_and_not_over_the_time() -> None:
    velocity_n = np.zeros((600, 3))
    velocity_n[:, 0] = np.where((np.arange(600) >= 200) & (np.arange(600) < 300), 0.0, 1.0)
    reference, errors = going(600, velocity_n), errors_of(growing(600, (0.1, 0.0, 0.0)))
    drift = segment_change(
        errors, distance_segments(errors.time_ns, reference_distance_m(reference, errors.time_ns))
    )
    assert horizontal_m(drift).min() == pytest.approx(10.0, abs=0.2)
    assert horizontal_m(drift).max() == pytest.approx(20.0, abs=0.2)


def test_distance_of_positions_alone_does_not_add_up_their_noise() -> None:
    reference = going(600, np.array([1.0, 0.0, 0.0]))
    noise_m = 0.5 * np.random.default_rng(2).standard_normal((600, 3))
    noisy = replace(
        reference,
        position=moved_position(reference.position, noise_m),
        velocity_n=np.full((600, 3), np.nan),
    )
    assert reference_distance_m(noisy, reference.time_ns)[-1] == pytest.approx(599.0, rel=0.02)
    nothing = replace(noisy, position=np.full((600, 3), np.nan))
    assert np.isnan(reference_distance_m(nothing, reference.time_ns)).all()
    assert len(distance_segments(reference.time_ns, np.full(600, np.nan)).first) == 0


# --- Velocity.


@pytest.mark.parametrize("course_deg", [0.0, 37.0, 90.0, 200.0, 300.0])
def test_scale_errs_along_and_heading_across_the_course(course_deg: float) -> None:
    course = np.deg2rad(course_deg)
    velocity_n = 1.5 * np.array([np.cos(course), np.sin(course), 0.0])
    to_starboard = 1.5 * np.array([-np.sin(course), np.cos(course), 0.0])
    errors = errors_of(
        np.zeros((50, 3)), np.tile(0.01 * velocity_n + 0.02 * to_starboard, (50, 1))
    )
    found = course_errors(errors, going(50, velocity_n))
    np.testing.assert_allclose(found.along_mps, 0.015, atol=1e-12)
    np.testing.assert_allclose(found.across_mps, 0.030, atol=1e-12)


def test_vehicle_at_rest_has_no_course() -> None:
    velocity_n = np.zeros((50, 3))
    velocity_n[10:, 1] = 1.0
    velocity_n[20] = np.nan
    found = course_errors(
        errors_of(np.zeros((50, 3)), np.full((50, 3), 0.1)), going(50, velocity_n)
    )
    assert np.flatnonzero(np.isnan(found.along_mps)).tolist() == [*range(10), 20]
    np.testing.assert_array_equal(np.isnan(found.along_mps), np.isnan(found.across_mps))


# --- The table.


def table(
    reference: ReferenceColumns, *, bridged_gaps: bool = False, **errors: ReferenceErrors
) -> list[DriftRow]:
    start_ns = int(reference.time_ns[0]) - SECOND
    return drift_table("dive", errors, reference, start_ns, bridged_gaps=bridged_gaps)


def row_of(rows: list[DriftRow], name: str, quantity: str) -> DriftRow:
    (found,) = (row for row in rows if (row.filter, row.quantity) == (name, quantity))
    return found


def test_circles_of_a_normal_error_have_the_radii_of_rayleigh() -> None:
    position_m = 2.0 * np.random.default_rng(3).standard_normal((20_000, 3))
    row = row_of(
        table(going(20_000, np.array([1.0, 0.0, 0.0])), aided=errors_of(position_m)),
        "aided",
        "position_h",
    )
    assert row.p50 == pytest.approx(2.0 * np.sqrt(chi2.ppf(0.50, 2)), rel=0.02)
    assert row.p95 == pytest.approx(2.0 * np.sqrt(chi2.ppf(0.95, 2)), rel=0.02)
    assert row.rms == pytest.approx(2.0 * np.sqrt(2.0), rel=0.02)
    largest_m = np.hypot(position_m[:, 0], position_m[:, 1])
    assert (row.samples, row.worst, row.worst_from_s) == (
        20_000,
        largest_m.max(),
        float(np.argmax(largest_m) + 1),
    )


def test_final_error_is_in_percent_of_the_distance_travelled() -> None:
    reference = going(400, np.array([0.0, 2.0, 0.0]))
    steady = replace(errors_of(growing(400, (0.003, -0.004, 0.1))), distance_m=800.0)
    rows = table(reference, baseline=steady, aided=replace(steady, distance_m=9.9))
    row, moored = (row_of(rows, name, "position_h") for name in ("baseline", "aided"))
    assert (row.final, row.distance_m) == (pytest.approx(2.0), 800.0)
    assert row.final_of_distance_pct == pytest.approx(0.25)
    assert moored.final == row.final
    assert np.isnan(moored.final_of_distance_pct), "percent of less than 10 m says nothing"
    assert np.isnan(row_of(rows, "baseline", "drift_60s").final_of_distance_pct)


def test_each_filter_has_a_row_of_each_quantity_that_is_known() -> None:
    reference = going(400, np.array([0.0, 2.0, 0.0]))
    steady = errors_of(growing(400, (0.03, -0.04, 0.0)), np.tile([0.01, -0.03, 0.0], (400, 1)))
    rows = table(
        reference,
        baseline=steady,
        aided=errors_of(np.full((400, 3), np.nan), np.full((400, 3), np.nan)),
    )
    assert [(row.filter, row.quantity) for row in rows] == [
        (name, quantity) for name in ("baseline", "aided") for quantity in DRIFT_QUANTITIES
    ]
    assert row_of(rows, "baseline", "drift_60s").p50 == pytest.approx(3.0)
    assert row_of(rows, "baseline", "drift_100m").p95 == pytest.approx(2.5), "50 s at 2 m/s"
    assert row_of(rows, "baseline", "velocity_along").p50 == pytest.approx(0.03), (
        "sizes, whichever way"
    )
    assert row_of(rows, "baseline", "velocity_across").worst == pytest.approx(0.01)
    dead = row_of(rows, "aided", "position_h")
    assert dead.samples == 0
    assert np.isnan([dead.p50, dead.p95, dead.rms, dead.worst, dead.worst_from_s]).all()


def test_what_the_reference_or_a_gap_leaves_unknown_has_no_row() -> None:
    reference, errors = (
        going(400, np.array([1.0, 0.0, 0.0])),
        errors_of(growing(400, (0.1, 0.0, 0.0))),
    )
    unlocated = replace(reference, position=np.full((400, 3), np.nan))
    of_velocity = ["velocity_along", "velocity_across"]
    nothing = np.full((400, 3), np.nan)
    blind = replace(errors, position_error_ned_m=nothing, drifting_ned_m=nothing)
    assert [row.quantity for row in table(unlocated, aided=blind)] == of_velocity
    assert [
        row.quantity for row in table(reference, aided=errors, bridged_gaps=True)
    ] == of_velocity
    short = table(
        going(30, np.array([1.0, 0.0, 0.0])), aided=errors_of(growing(30, (0.1, 0.0, 0.0)))
    )
    assert [row.quantity for row in short] == ["position_h", *of_velocity]


def test_track_fit_of_each_filter_is_two_rows_and_none_where_nothing_moves() -> None:
    velocity_n = np.array([1.0, 0.5, 0.0])
    reference, small = going(400, velocity_n), errors_of(growing(400, (-0.02, -0.01, 0.0)))
    rows = track_fit_table(
        "dive", {"baseline": small, "aided": errors_of(np.zeros((400, 3)))}, reference
    )
    assert [(row.filter, row.quantity, row.unit) for row in rows] == [
        (name, *unit) for name in ("baseline", "aided") for unit in TRACK_FIT_QUANTITIES.items()
    ]
    values = [row.fitted for row in rows]
    assert values == pytest.approx([100.0 / 0.98 - 100.0, 0.0, 0.0, 0.0], abs=1e-3)
    far = errors_of(np.full((400, 3), 1e300))
    assert track_fit_table("dive", {"baseline": far}, reference) == []
    assert track_fit_table("dive", {"baseline": small}, going(400, np.zeros(3))) == []
