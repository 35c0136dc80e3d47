"""Curves of convergence: rms of errors whose answer is known, and the same times as the table has."""

from dataclasses import replace

import numpy as np
import pytest

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.evaluation.convergence import convergence_curves, measured_convergences
from insdvl_replay.evaluation.reference_errors import DrawnErrors, squared_errors

STARTS, END_S = 9, 400.0
TIME_S = np.arange(0.2, END_S + 0.1, 0.2)


def drawn(name: str, size: float, *, heading: bool = True, starts: int = STARTS) -> DrawnErrors:
    """Errors that fall as 1 / t to a size at the end, but for those of the dive's own start, which are huge."""
    k, sign = len(TIME_S), np.where(np.arange(starts) % 2, 1.0, -1.0)
    error = np.tile(size * sign[:, None, None] * (END_S / TIME_S)[None, :, None], (1, 1, 12))
    error[0] = 1e6
    error[..., 5] *= 1.0 if heading else np.nan
    velocity: Floats = error[..., :3]
    return DrawnErrors(
        name,
        np.arange(k),
        TIME_S,
        velocity,
        velocity,
        error,
        np.full((k, 12), 3.0 * size),
        velocity,
    )


def test_rms_is_of_the_drawn_starts_over_the_last_tenth_of_the_time() -> None:
    curves = convergence_curves([drawn("baseline", 0.5), drawn("aided", 0.1)])
    assert list(curves) == ["velocity", "level", "heading"]
    level = curves["level"]
    mean_square = 1.0 / 0.9  # of (t / u) ** 2 over u from 0.9 t to t
    late = level.time_s > 20.0
    for name, size in (("baseline", 0.5), ("aided", 0.1)):
        expected = size * END_S / level.time_s[late] * np.sqrt(mean_square)
        np.testing.assert_allclose(level.rms[name][late], expected, rtol=0.02)
        np.testing.assert_allclose(level.predicted[name], 3.0 * size)
    np.testing.assert_allclose(
        curves["velocity"].rms["aided"], np.sqrt(2.0) * curves["heading"].rms["aided"]
    )
    np.testing.assert_allclose(curves["velocity"].predicted["aided"], np.sqrt(2.0) * 0.3)


def test_curves_fall_below_the_limit_at_the_times_of_the_table() -> None:
    baseline, aided = drawn("baseline", 0.5), drawn("aided", 0.1)
    found, curves = (
        measured_convergences(baseline, aided)["phi_d"],
        convergence_curves([baseline, aided])["heading"],
    )
    for name, reached_s in (("baseline", found.baseline_s), ("aided", found.candidate_s)):
        assert np.interp(reached_s, curves.time_s, curves.rms[name]) == pytest.approx(
            curves.limit, rel=1e-3
        )
        assert (curves.rms[name][curves.time_s > reached_s] < curves.limit).all()
        assert (curves.rms[name][curves.time_s < reached_s] > curves.limit).all()


def test_what_is_not_known_has_no_curve() -> None:
    assert list(
        convergence_curves([drawn("baseline", 0.5), drawn("aided", 0.1, heading=False)])
    ) == [
        "velocity",
        "level",
    ]
    assert convergence_curves([drawn("baseline", 0.5, starts=2)]) == {}
    assert convergence_curves([]) == {}


def test_a_long_dive_has_hardly_more_points_than_a_short_one() -> None:
    """Nine hours at 5 Hz, as thinned as drawn runs are, take 40 KB for two filters."""
    curves = convergence_curves([drawn("baseline", 0.5), drawn("aided", 0.1)]).values()
    held = sum(
        one.time_s.nbytes
        + sum(of_one.nbytes for of_one in (*one.rms.values(), *one.predicted.values()))
        for one in curves
    )
    assert held < 50_000


def test_level_is_the_mean_square_of_roll_and_pitch() -> None:
    errors = drawn("aided", 1.0)
    error = np.zeros_like(errors.error)
    error[..., 3], error[..., 4] = 3.0, 5.0
    assert np.unique(squared_errors(replace(errors, error=error))["level"]).tolist() == [17.0]
