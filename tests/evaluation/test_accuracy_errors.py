"""Errors against the reference: what is put in comes out in its unit, after settling, and only where it is known."""

from dataclasses import replace

import numpy as np
import pytest
from made_histories import history

from insdvl_replay.core.dive_columns import NS_PER_S, Dive, Floats, ReferenceColumns
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG, DV, PHI
from insdvl_replay.evaluation.evidence import (
    ErrorSeries,
    ReferenceNoise,
    accuracy_errors,
    compared,
    covered_errors,
    settling_times,
)
from insdvl_replay.evaluation.reference_errors import ReferenceErrors
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


def errors_of(dive: Dive, unknown: slice = slice(0, 0)) -> ReferenceErrors:
    """A run that drifts north, is too fast by its course, and leans; nothing is known of some of the times."""
    reference = reference_of(dive)
    time_ns = reference.time_ns[1:]
    time_s = (time_ns - reference.time_ns[0]) * 1e-9
    course = reference.velocity_n[1:] / np.linalg.norm(
        reference.velocity_n[1:], axis=1, keepdims=True
    )
    position_m = np.outer(time_s, [DRIFT_MPS, 0.0, 0.01])
    velocity_mps = SCALE_MPS * course
    attitude_rad = np.tile([ROLL_DEG * DEG, 0.0, HEADING_DEG * DEG], (len(time_s), 1))
    for column in (position_m, velocity_mps, attitude_rad):
        column[unknown] = np.nan
    return ReferenceErrors(time_ns, position_m, velocity_mps, attitude_rad, 600.0, position_m)


def found_in(
    dive: Dive,
    errors: ReferenceErrors | None = None,
    settled_s: dict[str, float] | None = None,
    *,
    bridged_gaps: bool = False,
) -> dict[str, ErrorSeries]:
    reference = reference_of(dive)
    return accuracy_errors(
        errors_of(dive) if errors is None else errors,
        reference,
        NOISE,
        settled_s or {},
        start_ns=int(reference.time_ns[0]),
        bridged_gaps=bridged_gaps,
    )


def rms(errors: Floats) -> float:
    return float(np.sqrt(np.nanmean(np.sum(errors**2, axis=1))))


def known(series: dict[str, ErrorSeries]) -> list[str]:
    """Return the quantities with a number."""
    return [name for name, one in series.items() if np.isfinite(one.errors).any()]


# --- Each quantity.


def test_each_quantity_is_what_was_put_in(dive: Dive) -> None:
    found = found_in(dive)
    assert list(found) == [
        "drift_30s",
        "drift_60s",
        "drift_100m",
        "depth_60s",
        *ALL[3:5],
        *ALL[6:],
    ]
    assert sorted(found) == sorted(ALL)
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
    units = {
        "m": {"drift_30s", "drift_60s", "drift_100m", "depth_60s"},
        "deg": {"level", "heading"},
    }
    for quantity, series in found.items():
        assert rms(series.errors) == pytest.approx(expected[quantity], rel=0.02, abs=1e-9), (
            quantity
        )
        assert series.unit == next(
            (unit for unit, names in units.items() if quantity in names), "m/s"
        )


def test_noise_is_what_the_reference_itself_errs_by(dive: Dive) -> None:
    """A drift is the difference of two positions with two components each; level is the rms of roll and pitch."""
    rng = np.random.default_rng(1)
    reference, k = reference_of(dive), len(reference_of(dive).time_ns) - 1
    squares = dict.fromkeys(ALL, 0.0)
    for _ in range(60):
        position_m = NOISE.position_m * rng.standard_normal((k, 3))
        velocity_mps = NOISE.velocity_mps * rng.standard_normal((k, 3))
        attitude_rad = NOISE.attitude_deg * DEG * rng.standard_normal((k, 3))
        errors = ReferenceErrors(
            reference.time_ns[1:], position_m, velocity_mps, attitude_rad, 600.0, position_m
        )
        found = found_in(dive, errors)
        for quantity in ALL:
            squares[quantity] += rms(found[quantity].errors) ** 2 / 60
    for quantity, square in squares.items():
        assert found[quantity].noise == pytest.approx(np.sqrt(square), rel=0.04), quantity


# --- What is left out.


def test_only_velocity_and_attitude_leave_out_the_time_of_settling(dive: Dive) -> None:
    whole, settled = (
        found_in(dive),
        found_in(dive, None, {"velocity_along": 50.0, "level": 100.0, "heading": 20.5}),
    )
    lost = {name: len(whole[name].errors) - len(settled[name].errors) for name in whole}
    # Errors begin one second after the start.
    expected = {"velocity_along": 49, "level": 99, "heading": 20}
    assert lost == {name: expected.get(name, 0) for name in whole}
    assert (settled["level"].from_s, settled["velocity_across"].from_s) == (100.0, 0.0)


def test_positions_through_a_long_gap_of_the_imu_are_no_evidence(dive: Dive) -> None:
    found = found_in(dive, bridged_gaps=True)
    assert list(found) == ["velocity_along", "velocity_across", "level", "heading"]


@pytest.mark.parametrize(("unknown", "left"), [(slice(0, 20), ALL), (slice(100, 200), [])])
def test_what_the_reference_covers_for_too_little_is_no_evidence(
    dive: Dive, unknown: slice, left: list[str]
) -> None:
    start_ns, *_, end_ns = (int(time) for time in reference_of(dive).time_ns)
    covered = covered_errors(errors_of(dive, unknown), start_ns, end_ns)
    assert sorted(known(found_in(dive, covered))) == sorted(left)


def test_reference_without_positions_has_velocities(dive: Dive) -> None:
    whole = errors_of(dive)
    nothing = np.full_like(whole.position_error_ned_m, np.nan)
    nowhere = replace(whole, position_error_ned_m=nothing, drifting_ned_m=nothing)
    assert known(found_in(dive, nowhere)) == [
        "velocity_along",
        "velocity_across",
        "level",
        "heading",
    ]


# --- Settling.


def with_sigma(sigma: Floats) -> History:
    """A filter whose sigmas of level, once a second; its heading and velocity are steady."""
    k = len(sigma)
    sd = np.ones((k, 12))
    sd[:, PHI][:, :2] = sigma[:, None]
    time_ns = NS_PER_S * np.arange(k, dtype=np.int64)
    return replace(history("baseline", np.full(k, 3.0)), time_ns=time_ns, sd=sd)


def settled_level_s(sigma: Floats) -> float:
    baseline = with_sigma(sigma)
    found = settling_times(baseline, baseline.time_ns)
    assert [found[name] for name in ("velocity_along", "velocity_across", "heading")] == [0.0] * 3
    return found["level"]


def test_sigma_has_settled_when_it_stays_within_a_fifth_of_its_last_value() -> None:
    """1 + exp(-t / 20 s) falls to 1.2 at 20 ln 5 = 32.2 s."""
    time_s = np.arange(200.0)
    assert settled_level_s(1.0 + np.exp(-time_s / 20.0)) == 33.0
    bumped = 1.0 + np.exp(-time_s / 20.0)
    bumped[60] = 1.5
    assert settled_level_s(bumped) == pytest.approx(61.0), "from when it stays"


def test_at_most_half_of_a_dive_is_left_out() -> None:
    """A sigma that falls until the end never settles."""
    assert settled_level_s(1.0 / np.arange(1.0, 202.0)) == 100.0


def test_sigma_that_grows_or_stays_has_settled_at_once() -> None:
    assert settled_level_s(np.ones(100)) == 0.0
    assert settled_level_s(np.sqrt(np.arange(1.0, 101.0))) == 0.0


def test_solution_without_sigma_settles_at_once() -> None:
    assert settled_level_s(np.full(100, np.nan)) == 0.0
    assert settling_times(with_sigma(np.ones(3)), np.empty(0, np.int64)) == {}


def test_velocity_and_heading_have_settling_times_of_their_own() -> None:
    baseline = with_sigma(np.ones(200))
    falling = 1.0 + np.exp(-np.arange(200.0) / 20.0)
    sd = baseline.sd.copy()
    sd[:, DV][:, 0], sd[:, DV][:, 1] = falling, falling
    sd[:, PHI][:, 2] = 1.0 + np.exp(-np.arange(200.0) / 25.0)
    found = settling_times(replace(baseline, sd=sd), baseline.time_ns)
    # 25 ln 5 = 40.2 s
    expected = {"velocity_along": 33.0, "velocity_across": 33.0, "level": 0.0, "heading": 41.0}
    assert found == pytest.approx(expected)


def test_vertical_velocity_does_not_keep_the_horizontal_one_from_settling() -> None:
    baseline = with_sigma(np.ones(200))
    sd = baseline.sd.copy()
    sd[:, DV][:, 2] = 1.0 + 10.0 * np.exp(-np.arange(200.0) / 50.0)
    assert settling_times(replace(baseline, sd=sd), baseline.time_ns)["velocity_along"] == 0.0


# --- How far a candidate acts.


def series(errors: Floats, noise: float = 0.0) -> ErrorSeries:
    return ErrorSeries("m", errors, noise)


@pytest.mark.parametrize("size", [1e-3, 0.05, 0.5, 3.0])
def test_no_ratio_differs_from_one_by_more_than_a_candidate_acts(size: float) -> None:
    """By the triangle inequality, for whatever errors and differences, and whatever the reference errs by."""
    rng = np.random.default_rng(3)
    for number in range(400):
        columns = 1 + number % 3
        before = rng.standard_normal((rng.integers(1, 30), columns)) * rng.lognormal(0.0, 2.0)
        size_of = rng.lognormal(0.0, 1.0) * size * np.sqrt(np.mean(before**2))
        # A third of them are as bad as they can be: they stretch or shrink the error itself.
        difference = (
            size_of * rng.standard_normal(before.shape)
            if number % 3
            else rng.choice([-1, 1]) * size * before
        )
        noise = rng.uniform(0.0, 2.0) * np.sqrt(np.mean(before**2))
        found = compared(series(before, noise), series(before + difference, noise))
        assert abs(found.value / found.baseline - 1.0) <= found.acts * (1.0 + 1e-9)


def test_the_bound_is_reached_by_a_difference_along_the_error() -> None:
    before = np.random.default_rng(4).standard_normal((50, 2))
    found = compared(series(before), series(0.9 * before))
    assert (found.value / found.baseline, found.acts) == (pytest.approx(0.9), pytest.approx(0.1))
    assert found.moves == pytest.approx(0.1 * found.baseline)


def test_a_copy_acts_by_nothing_however_noisy_the_reference_is() -> None:
    before = np.random.default_rng(5).standard_normal((50, 2))
    for noise in (0.0, 1.0, 100.0):
        assert compared(series(before, noise), series(before.copy(), noise)).acts == 0.0
    exact = np.zeros((50, 2))
    assert compared(series(exact), series(exact)).acts == 0.0
    assert np.isnan(compared(series(exact), series(exact + 1.0)).acts), (
        "of an error of nothing there is no share"
    )


def test_noise_of_the_reference_is_no_error_of_the_baseline() -> None:
    """Of a squared error of 5, 4 are noise, so that a difference of 0.1 is 0.1 of what is left."""
    before = np.full((40, 1), np.sqrt(5.0))
    found = compared(series(before, 2.0), series(before + 0.1, 2.0))
    assert (found.acts, found.noise_share) == (pytest.approx(0.1), pytest.approx(0.8))
    whole = compared(series(before, 9.0), series(before + 0.1, 9.0))
    assert whole.noise_share == 1.0
    assert whole.acts == pytest.approx(0.1 / np.sqrt(0.5)), (
        "a tenth of the squared error counts at least"
    )


def test_filters_are_compared_where_both_are_known() -> None:
    before, after = np.ones((4, 2)), np.full((4, 2), 2.0)
    before[0, 1], after[3] = np.nan, np.nan
    found = compared(series(before), series(after))
    assert found.samples == 2
    assert (found.baseline, found.value) == (
        pytest.approx(np.sqrt(2.0)),
        pytest.approx(2.0 * np.sqrt(2.0)),
    )
