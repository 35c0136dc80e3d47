"""Baselines that predict errors of another size than they have: by limits, by drawn errors, and on whole dives."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config import Config, Filter, InertialNoise
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns, nanoseconds
from insdvl_replay.core.quantities import SETTLED, SETTLED_LEVEL, SETTLED_VELOCITY
from insdvl_replay.core.states import DEG
from insdvl_replay.core.tables import CredibilityRow
from insdvl_replay.core.words import Consistency, Verdict
from insdvl_replay.evaluation.credibility import StateErrors, fit_limits, settled_table
from insdvl_replay.evaluation.verdicts import misfit
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.studies.montecarlo import matched_errors

COUNT = 2000
VELOCITY_SD = 0.004
LEVEL_SD = 0.02 * DEG
TIME_NS = nanoseconds(1.0) * np.arange(COUNT)
DOWN = np.array([0.0, 0.0, 1.0])
SPEED_MPS = 1.0 + 0.3 * np.sin(0.01 * np.arange(COUNT))


def reference() -> ReferenceColumns:
    """Go north."""
    velocity_n = np.column_stack([SPEED_MPS, np.zeros((COUNT, 2))])
    mat_nb = np.broadcast_to(np.eye(3), (COUNT, 3, 3)).copy()
    return ReferenceColumns(TIME_NS, np.zeros((COUNT, 3)), velocity_n, mat_nb)


def drawn(times: float, more_mps: Floats | float = 0.0, noise_deg: float = 0.0) -> StateErrors:
    """Draw white errors whose standard deviation is that of P, times a factor."""
    draw = np.random.default_rng(3)
    sd = np.array([VELOCITY_SD] * 3 + [LEVEL_SD] * 3)
    error = times * sd * draw.standard_normal((COUNT, 6))
    error[:, :3] += np.asarray(more_mps)
    error[:, 3:] += noise_deg * DEG * draw.standard_normal((COUNT, 3))
    cov = np.broadcast_to(np.diag(sd**2), (COUNT, 6, 6)).copy()
    return StateErrors("baseline", TIME_NS, error, cov, np.zeros(COUNT), np.ones(6, np.bool_))


def turned(errors: StateErrors, heading: Floats) -> StateErrors:
    """Turn errors and P about down, by another heading at each time."""
    turn = Rotation.from_rotvec(np.outer(heading, DOWN)).as_matrix()
    both = np.zeros((COUNT, 6, 6))
    both[:, :3, :3] = turn
    both[:, 3:, 3:] = turn
    error = np.einsum("kij,kj->ki", both, errors.error)
    cov = both @ errors.cov @ np.swapaxes(both, 1, 2)
    return replace(errors, error=error, cov=cov, heading=heading)


def rows_of(
    errors: StateErrors,
    noise_deg: float = 1e-4,
    track: ReferenceColumns | None = None,
) -> dict[str, CredibilityRow]:
    rows = settled_table(
        "dive",
        errors,
        track or reference(),
        0,
        {"level": 100.0},
        velocity_sd_mps=1e-5 * (noise_deg > 0.0),
        attitude_sd_rad=noise_deg * DEG,
    )
    return {row.quantity: row for row in rows}


def said_of(errors: StateErrors, noise_deg: float = 1e-4) -> str:
    tables: Any = SimpleNamespace(
        consistency=[], credibility=[*rows_of(errors, noise_deg).values()]
    )
    return misfit("baseline", tables)


def test_limits_are_a_tenth_and_ten_and_wider_for_few_effective_samples() -> None:
    assert fit_limits(3, 500.0) == pytest.approx((0.3, 30.0))
    low, high = fit_limits(2, 1.0)
    assert low < 2.0 * 0.001
    assert high > 2.0 * 20.0


@pytest.mark.parametrize("times", [0.4, 1.0, 2.5])
def test_a_sound_baseline_is_fit(times: float) -> None:
    rows = rows_of(drawn(times))
    assert list(rows) == list(SETTLED)
    for row in rows.values():
        assert row.verdict == Consistency.CONSISTENT
        assert row.mean_nees == pytest.approx(row.dof * times**2, rel=0.1)
    assert rows[SETTLED_LEVEL].samples == COUNT - 100
    assert said_of(drawn(times)) == ""


@pytest.mark.parametrize(
    ("times", "word"), [(0.2, "25 times too large"), (4.0, "16 times too small")]
)
def test_errors_of_another_size_are_named_with_their_value(times: float, word: str) -> None:
    said = said_of(drawn(times))
    assert word in said
    assert "NEES / dof of its velocity against the reference is" in said
    assert said.endswith("--control fits it")


def test_a_baseline_without_any_error_is_no_misfit() -> None:
    rows = rows_of(drawn(0.0))
    assert rows[SETTLED_VELOCITY].verdict == Consistency.CONSERVATIVE
    assert rows[SETTLED_VELOCITY].mean_nees == 0.0
    assert said_of(drawn(0.0)) == ""


def test_a_level_that_is_better_than_predicted_does_not_count() -> None:
    rows = rows_of(drawn(0.2))
    assert rows[SETTLED_LEVEL].mean_nees == pytest.approx(2.0 * 0.2**2, rel=0.1)
    assert rows[SETTLED_LEVEL].verdict == Consistency.CONSISTENT
    assert rows[SETTLED_VELOCITY].verdict == Consistency.CONSERVATIVE


def test_what_grows_with_the_speed_is_no_noise() -> None:
    mounted = SPEED_MPS[:, None] * np.array([0.02, 0.05, 0.03])
    assert said_of(drawn(1.0, mounted)) == ""
    assert "velocity" in said_of(drawn(1.0, 0.05 * np.sin(np.arange(COUNT))[:, None]))


def test_on_a_circle_errors_of_the_vehicles_axes_are_those_on_a_straight_line() -> None:
    errors = drawn(1.0, SPEED_MPS[:, None] * np.array([0.02, 0.05, 0.03]))
    # Across the track errors and P are larger than along it.
    wide = np.array([1.0, 3.0, 1.0, 1.0, 3.0, 1.0])
    errors = replace(errors, error=wide * errors.error, cov=np.outer(wide, wide) * errors.cov)
    heading = 0.01 * np.arange(COUNT)
    course = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(COUNT)])
    mat_nb = Rotation.from_rotvec(np.outer(heading, DOWN)).as_matrix()
    circle = replace(reference(), velocity_n=SPEED_MPS[:, None] * course, mat_nb=mat_nb)
    straight = rows_of(errors)
    turning = rows_of(turned(errors, heading), track=circle)
    assert list(turning) == list(SETTLED)
    for quantity, row in turning.items():
        assert row.mean_nees == pytest.approx(straight[quantity].mean_nees, rel=1e-9)
        assert row.effective_samples == pytest.approx(straight[quantity].effective_samples)
        assert row.mean_nees == pytest.approx(row.dof, rel=0.1)


def test_noise_of_the_reference_is_not_that_of_the_filter() -> None:
    errors = drawn(1.0, noise_deg=0.1)
    assert "level" in said_of(errors)
    assert said_of(errors, noise_deg=0.1) == ""
    # Where nobody said how large it is, it may be as large as the errors.
    unknown = rows_of(errors, noise_deg=0.0)
    assert unknown[SETTLED_LEVEL].high is None or np.isnan(unknown[SETTLED_LEVEL].high)
    assert said_of(errors, noise_deg=0.0) == ""
    assert "too large" in said_of(drawn(0.2), noise_deg=0.0)


def settings(times: float, **reference_keys: object) -> Config:
    """Tell the baseline the noise of tactical sensors times a factor, and a copy of it the same."""
    config = load_config("tactical", overrides=["evaluation.starts=1"])
    noise = {key: times * getattr(config.noise, key) for key in InertialNoise.__struct_fields__}
    baseline = Filter(aiding=("velocity",), **noise)
    keys = {"velocity_sd_mps": 1e-4, "attitude_sd_deg": 1e-3, **reference_keys}
    return msgspec.structs.replace(
        config,
        filters={"baseline": baseline, "copy": baseline},
        reference=msgspec.structs.replace(config.reference, **keys),
    )


@pytest.fixture(scope="module")
def dive() -> Dive:
    imu_errors, dvl_errors = matched_errors(load_config("tactical"))
    return simulate_dive(
        "figure-eight", seed=2, duration_s=300.0, imu_errors=imu_errors, dvl_errors=dvl_errors
    )


def reason_of(replay: Replay) -> str:
    return replay.verdicts["copy"].reason


def test_process_noise_that_is_far_too_small_is_named_where_the_innovations_are_fine(
    dive: Dive,
) -> None:
    sound = replay_dive(dive, settings(1.0))
    assert sound.verdicts["copy"].verdict == Verdict.NO_EFFECT
    found = replay_dive(dive, settings(1.0 / 7.0))
    (innovations,) = (
        row
        for row in found.tables.consistency
        if (row.filter, row.measurement) == ("baseline", "velocity")
    )
    assert innovations.mean_nis is not None
    assert 1.0 < innovations.mean_nis / innovations.dof < 5.0
    assert found.verdicts["copy"].verdict == Verdict.NOT_EVALUATED
    assert "NEES / dof of its" in reason_of(found)


def test_a_dependent_or_late_reference_does_not_tell(dive: Dive) -> None:
    dependent = replay_dive(dive, settings(1.0 / 7.0, independent=False))
    assert not {row.quantity for row in dependent.tables.credibility} & set(SETTLED)
    assert dive.reference is not None
    late = replace(dive.reference, time_ns=dive.reference.time_ns + nanoseconds(0.3))
    later = replay_dive(replace(dive, reference=late), settings(1.0))
    assert not {row.quantity for row in later.tables.credibility} & set(SETTLED)


def test_rows_of_a_fit_are_of_velocity_and_level() -> None:
    assert SETTLED == (SETTLED_VELOCITY, SETTLED_LEVEL)
