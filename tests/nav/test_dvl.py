"""Beams to velocities and back, and the slopes of past velocities against numpy.polynomial and closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from scipy.spatial.transform import Rotation

from insdvl_replay.core.dive_columns import DvlColumns, Floats
from insdvl_replay.geometry.frames import DvlMounting, beam_vectors, solve_beams
from insdvl_replay.nav.dvl import (
    derivative_weights,
    dvl_beams,
    dvl_velocities,
    slope_windows,
    windowed_sum,
)

REPEATABLE = settings(derandomize=True, deadline=None)
SEEDS = st.integers(0, 10_000)
JANUS = beam_vectors()
VELOCITY_D = np.array([1.2, -0.3, 0.1])
SECOND = 1_000_000_000


def pings(beam_velocity_mps: Floats, vectors_d: Floats = JANUS) -> DvlColumns:
    times = SECOND * np.arange(len(beam_velocity_mps), dtype=np.int64)
    return DvlColumns(times, beam_velocity_mps=beam_velocity_mps, beam_vectors_d=vectors_d)


def irregular_times_s(seed: int, n: int) -> Floats:
    return np.cumsum(np.random.default_rng(seed).uniform(0.1, 2.0, n))


# --- Beams.


@pytest.mark.parametrize(
    ("tilt_deg", "azimuth_deg"), [(30.0, 45.0), (22.5, 0.0), (20.0, 270.0), (60.0, 181.0)]
)
def test_beam_is_the_z_axis_tilted_then_turned(tilt_deg: float, azimuth_deg: float) -> None:
    turned = Rotation.from_euler("ZY", [azimuth_deg, tilt_deg], degrees=True).apply(
        [0.0, 0.0, 1.0]
    )
    made = beam_vectors(tilt_deg, [azimuth_deg])
    np.testing.assert_allclose(made, [turned], atol=1e-15)


@REPEATABLE
@given(
    st.integers(3, 8),
    st.floats(5.0, 80.0),
    st.floats(0.0, 360.0),
    st.tuples(*[st.floats(-10.0, 10.0)] * 3),
)
def test_velocity_to_beams_to_velocity(
    beams: int, tilt_deg: float, first_deg: float, velocity: tuple[float, float, float]
) -> None:
    vectors = beam_vectors(tilt_deg, list(first_deg + 360.0 * np.arange(beams) / beams))
    solved, _, residual = solve_beams((vectors @ velocity)[None], vectors)
    np.testing.assert_allclose(solved, [velocity], atol=1e-10)
    if beams == 3:
        assert np.isnan(residual).all(), "three beams leave nothing over to check with"
    else:
        np.testing.assert_allclose(residual, 0.0, atol=1e-10)


def test_beams_and_velocities_are_divided_by_the_scale() -> None:
    measured, mounting = pings(1.02 * np.tile(JANUS @ VELOCITY_D, (3, 1))), DvlMounting(scale=1.02)
    beams = dvl_beams(measured, mounting, -1, 3 * SECOND)
    assert beams is not None
    np.testing.assert_allclose(
        beams.beam_velocity_mps, np.tile(JANUS @ VELOCITY_D, (3, 1)), rtol=1e-12
    )
    np.testing.assert_allclose(
        dvl_velocities(measured, mounting).velocity_b, np.tile(VELOCITY_D, (3, 1)), rtol=1e-12
    )


def test_one_lost_beam_leaves_the_velocity_and_takes_the_check() -> None:
    beams = np.tile(JANUS @ VELOCITY_D, (4, 1))
    np.fill_diagonal(beams, np.nan)
    solved, shape, residual = solve_beams(beams, JANUS)
    np.testing.assert_allclose(solved, np.tile(VELOCITY_D, (4, 1)), atol=1e-12)
    assert np.isnan(residual).all()
    # The two beams that stand opposite each other still share their axis; across it, only one is left.
    assert (np.linalg.eigvalsh(shape)[:, -1] > 2.0).all()


def test_infinite_beam_is_a_lost_beam() -> None:
    beams = JANUS @ VELOCITY_D
    beams[1] = np.inf
    np.testing.assert_allclose(solve_beams(beams[None], JANUS)[0], [VELOCITY_D], atol=1e-12)


@pytest.mark.parametrize(
    "vectors",
    [
        JANUS[:2],
        np.tile(JANUS[0], (4, 1)),
        beam_vectors(30.0, [0.0, 180.0]).repeat(2, axis=0),
        np.vstack([beam_vectors(30.0, [0.0, 180.0]), [[0.0, 0.0, 1.0]]]),
    ],
    ids=["two", "all alike", "in pairs", "in a plane"],
)
def test_beams_that_do_not_span_space_give_no_velocity(vectors: Floats) -> None:
    solved, shape, residual = solve_beams((vectors @ VELOCITY_D)[None], vectors)
    assert np.isnan(solved).all()
    assert np.isnan(shape).all()
    assert np.isnan(residual).all()
    assert dvl_velocities(pings((vectors @ VELOCITY_D)[None], vectors)).pings_without_velocity == 1


@REPEATABLE
@given(SEEDS)
def test_weights_are_those_of_weighted_least_squares(seed: int) -> None:
    rng = np.random.default_rng(seed)
    measured, weights = JANUS @ VELOCITY_D + rng.normal(0.0, 0.1, 4), rng.uniform(0.1, 10.0, 4)
    root = np.sqrt(weights)
    expected, squares, *_ = np.linalg.lstsq(root[:, None] * JANUS, root * measured)
    solved, shape, residual = solve_beams(measured[None], JANUS, weights)
    np.testing.assert_allclose(solved, [expected], atol=1e-12)
    np.testing.assert_allclose(residual**2, squares, atol=1e-12)
    np.testing.assert_allclose(shape[0] @ (JANUS.T * weights) @ JANUS, np.eye(3), atol=1e-12)


def test_covariance_of_a_janus_has_a_closed_form() -> None:
    sine2, cosine2 = 0.25, 0.75
    _, shape, _ = solve_beams((JANUS @ VELOCITY_D)[None], JANUS)
    np.testing.assert_allclose(
        shape, [np.diag([1 / (2 * sine2), 1 / (2 * sine2), 1 / (4 * cosine2)])], atol=1e-12
    )


@pytest.mark.parametrize("lost", [None, 2])
def test_covariance_is_the_scatter_of_many_pings(lost: int | None) -> None:
    draws, beam_sd_mps = 40_000, 0.01
    beams = JANUS @ VELOCITY_D + beam_sd_mps * np.random.default_rng(7).standard_normal((draws, 4))
    if lost is not None:
        beams[:, lost] = np.nan
    solved, shape, _ = solve_beams(beams, JANUS)
    # The scatter of a variance from 40000 draws is 0.7 %; five of these.
    atol = 0.035 * beam_sd_mps**2 * shape[0].max()
    np.testing.assert_allclose(np.cov(solved.T), beam_sd_mps**2 * shape[0], atol=atol)
    np.testing.assert_allclose(
        solved.mean(axis=0), VELOCITY_D, atol=5.0 * 2.5 * beam_sd_mps / np.sqrt(draws)
    )


# --- Pings to velocities in body axes.


def test_one_bad_beam_shows_in_the_residual_and_is_dropped() -> None:
    beams = np.tile(JANUS @ VELOCITY_D, (3, 1))
    beams[1, 2] += 0.2
    # Opposite beams of a Janus measure the same sum: half of one beam's error cannot be explained by any velocity.
    np.testing.assert_allclose(
        dvl_velocities(pings(beams)).residual_mps, [0.0, 0.1, 0.0], atol=1e-12
    )
    checked = dvl_velocities(pings(beams), max_residual_mps=0.09)
    assert checked.time_ns.tolist() == [0, 2 * SECOND]
    assert (checked.pings_with_bad_residual, checked.pings_without_velocity) == (1, 0)
    assert dvl_velocities(pings(beams), max_residual_mps=0.11).pings_with_bad_residual == 0


def test_three_beams_have_no_residual_to_be_dropped_for() -> None:
    beams = (JANUS @ VELOCITY_D)[None].copy()
    beams[0, :2] = np.nan, beams[0, 1] + 0.5
    kept = dvl_velocities(pings(beams), max_residual_mps=0.01)
    assert kept.beams_used.tolist() == [3]
    assert np.isnan(kept.residual_mps).all()


def test_mounting_turns_velocity_and_covariance_to_the_body() -> None:
    mounting = Rotation.from_euler("ZYX", [135.0, 4.0, -2.0], degrees=True)
    velocity_b = np.array([0.8, 0.1, -0.05])
    beams = (JANUS @ mounting.inv().apply(velocity_b))[None].copy()
    beams[0, 3] = np.nan
    solved = dvl_velocities(pings(beams), DvlMounting(mat_bd=mounting.as_matrix()))
    np.testing.assert_allclose(solved.velocity_b, [velocity_b], atol=1e-12)
    in_d = dvl_velocities(pings(beams)).unit_cov_b[0]
    np.testing.assert_allclose(
        solved.unit_cov_b[0], mounting.as_matrix() @ in_d @ mounting.inv().as_matrix(), atol=1e-12
    )


def test_scale_is_divided_out() -> None:
    beams = np.tile(JANUS @ VELOCITY_D * 1.02, (2, 1))
    beams[1, 0] += 1.02 * 0.2
    solved = dvl_velocities(pings(beams), DvlMounting(scale=1.02))
    np.testing.assert_allclose(solved.velocity_b[0], VELOCITY_D, atol=1e-12)
    np.testing.assert_allclose(solved.residual_mps, [0.0, 0.1], atol=1e-12)


def test_dvl_that_reports_velocities_is_taken_at_its_word() -> None:
    velocity_d = np.tile(VELOCITY_D, (3, 1))
    velocity_d[1, 2] = np.nan
    turn = Rotation.from_euler("Z", 90.0, degrees=True).as_matrix()
    solved = dvl_velocities(
        DvlColumns(SECOND * np.arange(3), velocity_d=velocity_d), DvlMounting(mat_bd=turn)
    )
    assert solved.time_ns.tolist() == [0, 2 * SECOND]
    np.testing.assert_allclose(solved.velocity_b, np.tile([0.3, 1.2, 0.1], (2, 1)), atol=1e-15)
    janus = np.diag([2.0, 2.0, 1.0 / 3.0])  # at 30 deg, which is turned about its own axis
    np.testing.assert_allclose(solved.unit_cov_b, np.tile(janus, (2, 1, 1)), atol=1e-14)
    assert solved.beams_used.tolist() == [0, 0]
    assert solved.pings_without_velocity == 1


def test_dvl_without_readings_is_a_programmers_error() -> None:
    with pytest.raises(ValueError, match="beams"):
        dvl_velocities(DvlColumns(np.arange(3), beam_velocity_mps=np.zeros((3, 4))))


def test_no_pings_are_no_velocities() -> None:
    assert len(dvl_velocities(pings(np.empty((0, 4)))).time_ns) == 0


def test_span_leaves_out_its_start_and_keeps_its_end() -> None:
    beams = np.tile(JANUS @ VELOCITY_D, (5, 1))
    beams[4, :2] = np.nan
    inside = dvl_velocities(pings(beams)).within(SECOND, 3 * SECOND)
    assert inside.time_ns.tolist() == [2 * SECOND, 3 * SECOND]
    assert (
        len(inside.velocity_b)
        == len(inside.unit_cov_b)
        == len(inside.residual_mps)
        == len(inside.beams_used)
        == 2
    )
    assert inside.pings_without_velocity == 1


# --- Velocities to accelerations.


def test_three_velocities_at_1_hz_are_the_papers_slope() -> None:
    c = slope_windows(np.arange(3.0), 3).velocity_weights[-1]
    np.testing.assert_allclose(c, [-0.5, 0.0, 0.5], atol=1e-15)
    velocity_sd_mps = 0.02
    noise = velocity_sd_mps * np.random.default_rng(3).standard_normal((40_000, 3))
    assert (noise @ c).std() == pytest.approx(velocity_sd_mps / np.sqrt(2.0), rel=0.02)


@REPEATABLE
@given(SEEDS, st.integers(2, 12))
def test_straight_line_has_the_closed_form_at_any_times(seed: int, n: int) -> None:
    time_s = irregular_times_s(seed, n)
    from_middle_s = time_s - time_s.mean()
    windows = slope_windows(time_s, n)
    np.testing.assert_allclose(
        windows.velocity_weights[-1], from_middle_s / np.sum(from_middle_s**2), atol=1e-12
    )


@REPEATABLE
@given(SEEDS, st.integers(1, 3), st.integers(1, 6), st.floats(-3.0, 3.0))
def test_derivatives_are_numpys_polynomial_and_its_derivatives(
    seed: int, order: int, spare: int, ahead_s: float
) -> None:
    time_s = irregular_times_s(seed, order + spare)
    velocity = np.random.default_rng(seed).normal(0.0, 1.0, (len(time_s), 3))
    at_s = time_s[-1] + ahead_s
    fits = [Polynomial.fit(time_s, column, order) for column in velocity.T]
    expected = [[fit.deriv(k)(at_s) if k else fit(at_s) for fit in fits] for k in range(order + 1)]
    np.testing.assert_allclose(
        derivative_weights(time_s - at_s, order) @ velocity, expected, rtol=1e-7, atol=1e-7
    )


@pytest.mark.parametrize("order", [1, 2, 3])
def test_motion_of_its_order_is_carried_through_an_outage(order: int) -> None:
    def velocity(time_s: Floats) -> Floats:
        return np.stack(
            [
                sum((k + 1) * 0.1 * time_s**k for k in range(order + 1)) * axis
                for axis in (1, -2, 3)
            ],
            -1,
        )

    time_s = np.array([0.0, 0.9, 2.1, 3.0, 4.2])
    derivatives = derivative_weights(time_s - 9.0, order) @ velocity(time_s)
    np.testing.assert_allclose(derivatives[0], velocity(np.array(9.0)), rtol=1e-10)
    step_s = 1e-4
    slope = (velocity(np.array(9.0 + step_s)) - velocity(np.array(9.0 - step_s))) / (2.0 * step_s)
    np.testing.assert_allclose(derivatives[1], slope, rtol=1e-7)


@pytest.mark.parametrize(("order", "n"), [(0, 3), (2, 2), (3, 2), (1, 1)])
def test_order_below_one_or_without_enough_velocities_is_refused(order: int, n: int) -> None:
    with pytest.raises(ValueError, match=f"order {order} .*{n}"):
        derivative_weights(np.arange(float(n)), order)


@REPEATABLE
@given(SEEDS, st.integers(1, 3), st.integers(1, 4))
def test_slope_of_velocities_is_a_sum_of_their_changes(seed: int, order: int, spare: int) -> None:
    window = order + spare
    time_s = irregular_times_s(seed, window + 5)
    velocity = np.random.default_rng(seed).normal(0.0, 2.0, (len(time_s), 3))
    windows = slope_windows(time_s, window, order)
    change = np.vstack([np.zeros(3), np.diff(velocity, axis=0)])
    from_velocities = windowed_sum(windows.velocity_weights, velocity)
    from_changes = windowed_sum(windows.interval_weights, change)
    np.testing.assert_allclose(
        from_changes[windows.complete], from_velocities[windows.complete], atol=1e-9
    )
    np.testing.assert_allclose(windows.velocity_weights.sum(axis=1), 0.0, atol=1e-9)


def test_slope_is_at_the_middle_of_its_window() -> None:
    time_s = irregular_times_s(5, 4)
    slope = windowed_sum(slope_windows(time_s, 4, 2).velocity_weights, time_s[:, None] ** 2)[-1]
    np.testing.assert_allclose(slope, 2.0 * time_s.mean(), atol=1e-10)


def test_gap_starts_a_new_window() -> None:
    time_s = np.array([0.0, 1.0, 2.0, 3.0, 5.5, 6.5, 7.5, 10.1, 11.1])
    windows = slope_windows(time_s, 3, max_gap_s=2.5)
    assert np.flatnonzero(windows.complete).tolist() == [2, 3, 4, 5, 6], (
        "2.5 s are no gap, 2.6 s are one"
    )
    assert not windows.velocity_weights[~windows.complete].any()
    assert not windows.interval_weights[~windows.complete].any()
    np.testing.assert_allclose(windows.interval_s[4], [1.0, 2.5])


@pytest.mark.parametrize("m", [0, 1, 2, 5, 6, 20])
def test_windowed_sum_is_the_sum_written_out(m: int) -> None:
    rng, n = np.random.default_rng(m), 8
    weights, values = rng.normal(size=(m, n)), rng.normal(size=(m, 3, 3))
    weights[: n - 1] = 0.0
    expected = np.zeros((m, 3, 3))
    for k in range(n - 1, m):
        expected[k] = sum(weights[k, j] * values[k - n + 1 + j] for j in range(n))
    np.testing.assert_allclose(windowed_sum(weights, values), expected, atol=1e-12)


@pytest.mark.parametrize("m", [0, 1, 4])
def test_window_longer_than_the_dive_is_never_complete(m: int) -> None:
    windows = slope_windows(np.arange(float(m)), 5)
    assert not windows.complete.any()
    assert windows.velocity_weights.shape == (m, 5)
    assert windows.interval_weights.shape == windows.interval_s.shape == (m, 4)
