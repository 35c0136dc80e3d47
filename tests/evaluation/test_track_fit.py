"""Scale and turn of tracks against what was put in, and their standard errors against how they scatter."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns
from insdvl_replay.evaluation.drift import filter_track_fit, track_fit
from insdvl_replay.evaluation.reference_errors import ReferenceErrors
from insdvl_replay.geometry.frames import moved_position

SECOND = 1_000_000_000
TIME_NS = SECOND * np.arange(400, dtype=np.int64)


def figure_eight() -> Floats:
    turn = (
        np.where(TIME_NS // (60 * SECOND) % 2 == 0, 1.0, -1.0)
        * 2.0
        * np.pi
        * np.arange(400)
        / 60.0
    )
    return np.cumsum(np.stack([np.cos(turn), np.sin(turn)], axis=1), axis=0)


def lawn_mower() -> Floats:
    north = np.where(TIME_NS // (100 * SECOND) % 2 == 0, 1.0, -1.0)
    return np.cumsum(np.stack([north, np.full(400, 0.1)], axis=1), axis=0)


def straight() -> Floats:
    return np.outer(np.arange(400.0), [0.6, 0.8])


def shrunk_and_turned_back(track_m: Floats, scale_pct: float, turn_deg: float) -> Floats:
    turned: Floats = (
        Rotation.from_euler("z", -turn_deg, degrees=True).as_matrix()[:2, :2] @ track_m.T
    )
    return turned.T / (1.0 + scale_pct / 100.0)


@pytest.mark.parametrize("track", [figure_eight, lawn_mower, straight])
def test_scale_and_turn_are_those_put_in(track: Callable[[], Floats]) -> None:
    fit = track_fit(
        TIME_NS, np.array([3.0, -2.0]) + shrunk_and_turned_back(track(), 0.18, -1.5), track()
    )
    assert fit.scale_pct == pytest.approx(0.18, abs=1e-9)
    assert fit.turn_deg == pytest.approx(-1.5, abs=1e-9)
    assert (fit.scale_sd_pct, fit.turn_sd_deg) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_turn_is_clockwise_from_above() -> None:
    fit = track_fit(
        TIME_NS, np.outer(np.arange(400.0), [1.0, 0.0]), np.outer(np.arange(400.0), [0.0, 1.0])
    )
    assert fit.turn_deg == pytest.approx(90.0), "from north to east"


def noise_of_fixes(rng: np.random.Generator) -> Floats:
    return rng.standard_normal((400, 2))


def random_walk(rng: np.random.Generator) -> Floats:
    return np.cumsum(0.02 * rng.standard_normal((400, 2)), axis=0)


@pytest.mark.parametrize("track", [figure_eight, lawn_mower, straight])
@pytest.mark.parametrize(
    ("wander", "least", "most"),
    [(random_walk, 0.8, 1.4), (noise_of_fixes, 0.1, 1.2)],
    ids=["walk", "fixes"],
)
def test_standard_errors_are_those_of_the_scatter(
    track: Callable[[], Floats],
    wander: Callable[[np.random.Generator], Floats],
    least: float,
    most: float,
) -> None:
    rng, standardised = np.random.default_rng(1), []
    for _ in range(200):
        fit = track_fit(TIME_NS, shrunk_and_turned_back(track(), 0.2, 0.3), track() + wander(rng))
        standardised.append(
            [(fit.scale_pct - 0.2) / fit.scale_sd_pct, (fit.turn_deg - 0.3) / fit.turn_sd_deg]
        )
    rms = np.sqrt(np.mean(np.square(standardised), axis=0))
    assert np.all((least < rms) & (rms < most)), (
        "the noise of fixes makes them too large, and never too small"
    )


def test_error_along_a_straight_track_makes_the_scale_unsure_and_not_the_turn() -> None:
    wander_m = random_walk(np.random.default_rng(3))[:, :1]
    along = track_fit(TIME_NS, straight() + wander_m * [0.6, 0.8], straight())
    assert along.scale_sd_pct > 0.01
    assert along.turn_sd_deg == pytest.approx(0.0, abs=1e-9)
    across = track_fit(TIME_NS, straight() + wander_m * [-0.8, 0.6], straight())
    assert across.turn_sd_deg == pytest.approx(np.rad2deg(along.scale_sd_pct / 100.0), rel=0.05)
    assert across.scale_sd_pct < 0.01 * along.scale_sd_pct


def test_filter_is_fitted_at_the_times_that_both_have() -> None:
    track_m = figure_eight() * 20.0
    start = np.array([0.57, 0.61, -20.0])
    position = moved_position(
        np.tile(start, (400, 1)), np.column_stack([track_m - track_m[0], np.zeros(400)])
    )
    position[7] = np.nan
    reference = ReferenceColumns(
        TIME_NS, position, np.full((400, 3), np.nan), np.full((400, 3, 3), np.nan)
    )
    estimated_m = shrunk_and_turned_back(track_m - track_m[0], -0.5, 0.7)
    error_m = np.column_stack([estimated_m - (track_m - track_m[0]), np.zeros(400)])[1:]
    error_m[20] = np.nan
    errors = ReferenceErrors(TIME_NS[1:], error_m, error_m, error_m, 100.0, error_m)
    fit = filter_track_fit(errors, reference)
    assert (fit.scale_pct, fit.turn_deg) == pytest.approx((-0.5, 0.7), abs=0.01)
    empty = ReferenceErrors(TIME_NS[:0], error_m[:0], error_m[:0], error_m[:0], 0.0, error_m[:0])
    assert np.isnan(filter_track_fit(empty, reference).scale_pct)


def test_what_cannot_be_reported_is_not_reported() -> None:
    rest = track_fit(TIME_NS, random_walk(np.random.default_rng(2)), np.zeros((400, 2)))
    assert np.isnan([rest.scale_pct, rest.scale_sd_pct, rest.turn_deg, rest.turn_sd_deg]).all()
    assert np.isnan(track_fit(TIME_NS, np.zeros((400, 2)), straight()).scale_pct)
    short = track_fit(TIME_NS[:90], straight()[:90] * 0.99, straight()[:90])
    assert short.scale_pct == pytest.approx(100.0 / 99.0)
    assert np.isnan(short.scale_sd_pct), "of five averages"
