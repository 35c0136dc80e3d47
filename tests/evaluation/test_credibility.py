"""Errors drawn from P are credible, whichever way the vehicle heads; errors that are not are found out."""

import re
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from frames import frame
from matched_sensors import MATCHED
from scipy import signal, stats

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import CREDIBILITY_GROUPS, CREDIBILITY_QUANTITIES, SETTLED
from insdvl_replay.core.states import BA, DEG, PHI, STATES
from insdvl_replay.core.words import Reason
from insdvl_replay.evaluation.consistency import mean_interval, probability_beyond_3_sd
from insdvl_replay.evaluation.credibility import (
    FAR_SMALLER,
    MANY_FAR_OFF,
    StateErrors,
    about_vehicle,
    credibility_table,
    nees,
    state_errors,
    whitened,
)
from insdvl_replay.evaluation.series import samples_in_mean_square
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.sim.dive import add_errors, exact_dive, simulate_dive
from insdvl_replay.studies.montecarlo import matched_errors

K = 4000
SD = np.repeat([0.02, 2e-3, 1e-2, 1e-6], 3)


def covariance(seed: int = 1) -> Floats:
    """A covariance with the standard deviations `SD` and correlations of any size."""
    factor = np.random.default_rng(seed).normal(size=(12, 12))
    cov = factor @ factor.T
    scale = SD / np.sqrt(np.diagonal(cov))
    made: Floats = cov * np.outer(scale, scale)
    return made


def drawn(factor: float = 1.0, seed: int = 2, k: int = K) -> StateErrors:
    """Independent errors that are by a factor larger than P says, of a vehicle that heads anywhere."""
    rng, cov = np.random.default_rng(seed), covariance()
    error = factor * rng.multivariate_normal(np.zeros(12), cov, size=k, method="cholesky")
    heading = rng.uniform(-np.pi, np.pi, k)
    return StateErrors(
        "aided",
        np.arange(k, dtype=np.int64),
        error,
        np.tile(cov, (k, 1, 1)),
        heading,
        np.ones(12, np.bool_),
    )


def judged(errors: StateErrors) -> Any:
    return frame(credibility_table("dive", ["aided"], {"aided": errors})).set_index("quantity")


def without(errors: StateErrors, states: slice) -> StateErrors:
    error = errors.error.copy()
    error[:, states] = np.nan
    return replace(errors, error=error)


# --- The table.


def test_errors_drawn_from_p_are_credible_in_every_row() -> None:
    table = judged(drawn())
    assert table.index.tolist() == [*CREDIBILITY_QUANTITIES, *CREDIBILITY_GROUPS, "all"]
    assert (table["verdict"] == "consistent").all()
    assert table["dof"].tolist() == [1] * 12 + [3] * 4 + [12]
    # The mean of 4000 squares scatters by 2.2 %, shares of 4000 by 0.7 % and 0.1 %; five of these.
    np.testing.assert_allclose(table["mean_nees"] / table["dof"], 1.0, atol=0.11)
    np.testing.assert_allclose(table["within_1sd_pct"], 68.27, atol=3.7)
    np.testing.assert_allclose(table["within_3sd_pct"], 99.73, atol=0.5)
    np.testing.assert_allclose(table["effective_samples"], K, rtol=0.02)


@pytest.mark.parametrize(
    ("factor", "word"), [(1.2, "overconfident"), (0.8, "consistent"), (0.2, "conservative")]
)
def test_errors_of_another_size_are_found_out_in_every_row(factor: float, word: str) -> None:
    table = judged(drawn(factor))
    assert (table["verdict"] == word).all()
    np.testing.assert_allclose(table["mean_nees"] / table["dof"], factor**2, rtol=0.11)
    expected_pct = 100.0 * stats.chi2(1).cdf(1.0 / factor**2)
    np.testing.assert_allclose(table.loc["velocity_n", "within_1sd_pct"], expected_pct, atol=3.7)


def test_columns_are_those_of_the_contract() -> None:
    assert frame(credibility_table("dive", ["aided"], {})).columns.tolist() == [
        "log", "filter", "quantity", "dof", "samples", "mean_nees", "low", "high", "within_1sd_pct",
        "within_3sd_pct", "verdict", "effective_samples", "why",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("heading_deg", "quantity"), [(0.0, "roll"), (90.0, "pitch"), (180.0, "roll")]
)
def test_misalignment_about_north_is_the_roll_of_who_heads_north(
    heading_deg: float, quantity: str
) -> None:
    errors = drawn()
    error = np.zeros_like(errors.error)
    error[:, PHI.start] = 3.0 * SD[PHI.start]
    table = judged(replace(errors, error=error, heading=np.full(K, heading_deg * DEG)))
    for other in ("roll", "pitch", "heading"):
        assert table.loc[other, "mean_nees"] == pytest.approx(
            9.0 if other == quantity else 0.0, abs=1e-9
        )


@pytest.mark.parametrize("heading_deg", [30.0, 120.0, -130.0])
def test_misalignment_about_the_track_is_roll_with_its_variance(heading_deg: float) -> None:
    """A lean about the vehicle's own axis, which P knows to be all that is wrong, and nothing about the other axis."""
    ahead_n = np.array([np.cos(heading_deg * DEG), np.sin(heading_deg * DEG)])
    errors = drawn(k=2)
    error = np.zeros((2, 12))
    error[:, PHI.start : PHI.start + 2] = 2e-3 * ahead_n
    level = slice(PHI.start, PHI.start + 2)
    cov = np.zeros((2, 12, 12))
    cov[:, level, level] = 1e-6 * np.outer(ahead_n, ahead_n)
    found = about_vehicle(
        replace(errors, error=error, cov=cov, heading=np.full(2, heading_deg * DEG))
    )
    np.testing.assert_allclose(found.error[:, level], [[2e-3, 0.0]] * 2, atol=1e-15)
    np.testing.assert_allclose(
        found.cov[:, level, level], [[[1e-6, 0.0], [0.0, 0.0]]] * 2, atol=1e-18
    )


def at_one_time() -> tuple[History, ReferenceColumns]:
    """A filter and a reference of one row, which agree."""
    mat_nb = mat_from_rpy(np.array([[0.1, -0.2, -2.0]]))
    time_ns = np.zeros(1, np.int64)
    nothing = np.zeros((1, 3))
    history = History(
        "aided",
        time_ns,
        np.ones(1, np.bool_),
        nothing,
        nothing,
        mat_nb,
        nothing,
        nothing,
        np.ones((1, 12)),
        time_ns,
        np.eye(12)[None],
        (),
    )
    return history, ReferenceColumns(time_ns, nothing, nothing, mat_nb)


def test_heading_of_the_errors_is_that_of_the_reference() -> None:
    errors = state_errors(*at_one_time(), None)
    assert errors.heading.tolist() == pytest.approx([-2.0])


@pytest.mark.parametrize("has_own_start", [False, True])
def test_errors_are_small_by_the_start_alone_where_it_is_on_the_reference(
    has_own_start: bool,
) -> None:
    history, reference = at_one_time()
    history = replace(history, has_own_start=has_own_start)
    is_exact = state_errors(history, reference, None).exact_start
    assert is_exact is not has_own_start
    row = judged(replace(drawn(0.8), exact_start=is_exact)).loc["all"]
    assert (row["verdict"] == "conservative") is has_own_start


def test_interval_is_that_of_the_independent_samples() -> None:
    row = judged(replace(drawn(), error=np.tile(SD, (K, 1)))).loc["velocity_d"]
    assert row["effective_samples"] == pytest.approx(1.0, abs=1e-6)
    assert (row["low"], row["high"]) == pytest.approx(mean_interval(1, 1.0), rel=1e-6)
    assert row["samples"] == K


@pytest.mark.parametrize(
    ("sigmas", "word"),
    [(0.01, "insufficient data"), (1.5, "insufficient data"), (4.0, "overconfident")],
)
def test_error_that_stays_can_only_be_too_large(sigmas: float, word: str) -> None:
    """One sample within 1.5 sigma proves nothing, however often it is looked at; at 4 sigma it does."""
    table = judged(replace(drawn(), error=np.tile(sigmas * SD, (K, 1))))
    assert (table["verdict"].drop(["roll", "pitch", *CREDIBILITY_GROUPS, "all"]) == word).all()


@pytest.mark.parametrize(("times", "word"), [(1.0, "consistent"), (10.0, "overconfident")])
def test_rare_large_errors_are_found_though_their_mean_square_is_as_predicted(
    times: float, word: str
) -> None:
    """Every twentieth error is ``times`` as large as the others."""
    errors = drawn()
    error = errors.error * np.where(np.arange(K) % 20 == 0, times, 1.0)[:, None]
    table = judged(replace(errors, error=error * SD / np.sqrt(np.mean(error**2, axis=0))))
    rows = [quantity for quantity in CREDIBILITY_QUANTITIES if quantity not in {"roll", "pitch"}]
    np.testing.assert_allclose(table.loc[rows, "mean_nees"], 1.0, rtol=1e-9)
    assert (table.loc[rows, "verdict"] == word).all()


@pytest.mark.parametrize("independent", [5.0, 20.0, 200.0])
def test_share_of_large_errors_is_as_improbable_as_scipys_binomial_says(
    independent: float,
) -> None:
    expected = 2.0 * float(stats.norm.sf(3.0))
    for count in (1, 2, 4):
        found = probability_beyond_3_sd(count / independent, independent)
        assert found == pytest.approx(
            stats.binom(int(independent), expected).sf(count - 1), rel=1e-9
        )
    assert probability_beyond_3_sd(0.5 / independent, independent) == pytest.approx(
        2.0 * independent * expected
    )


def test_correlated_errors_drawn_from_p_are_seldom_called_far_off() -> None:
    """Each error resembles the one before by 0.98: the few excursions of a series last, and prove little."""
    rng, flagged, runs = np.random.default_rng(5), 0, 300
    for _ in range(runs):
        series = signal.lfilter([np.sqrt(1.0 - 0.98**2)], [1.0, -0.98], rng.standard_normal(1200))[
            200:
        ]
        far_off = float(np.mean(np.abs(series) > 3.0))
        flagged += (
            far_off >= MANY_FAR_OFF
            and probability_beyond_3_sd(far_off, samples_in_mean_square(series[:, None])) < 0.05
        )
    assert flagged / runs < 0.05


def hanging_on_heading(sigmas: float) -> StateErrors:
    """A velocity whose variance is nine tenths the heading's, which is exact; the rest errs as drawn, by a factor."""
    correlation = np.eye(12)
    correlation[0, 5] = correlation[5, 0] = np.sqrt(0.9)
    cov = correlation * np.outer(SD, SD)
    error = np.random.default_rng(7).normal(size=(K, 12)) * SD
    error[:, 0] *= sigmas * np.sqrt(0.1)
    return replace(drawn(), error=error, cov=np.tile(cov, (K, 1, 1)))


@pytest.mark.parametrize(("sigmas", "word"), [(1.0, "consistent"), (0.4, "conservative")])
def test_velocity_that_hangs_on_the_heading_is_evaluated_by_what_is_its_own(
    sigmas: float, word: str
) -> None:
    row = judged(hanging_on_heading(sigmas)).loc["velocity_n"]
    assert row["mean_nees"] == pytest.approx(0.1 * sigmas**2, rel=0.11)
    assert row["verdict"] == word


def test_what_the_reference_lacks_is_said_and_not_counted() -> None:
    velocity_alone = without(drawn(), slice(PHI.start, 12))
    table = judged(velocity_alone)
    assert table.index.tolist() == [*CREDIBILITY_QUANTITIES[:6], "velocity", "attitude", "all"], (
        "no biases without the truth"
    )
    assert table.loc["roll":"heading", "verdict"].tolist() == ["not in reference"] * 3
    assert (
        table.loc["roll":"heading", ["mean_nees", "low", "high", "within_1sd_pct"]]
        .isna()
        .all(axis=None)
    )
    assert table.loc["all", "dof"] == 3
    assert table.loc["all", "verdict"] == "consistent"
    nothing = judged(without(drawn(), slice(0, 12)))
    assert set(nothing["verdict"]) == {"not in reference"}
    assert (nothing["samples"] == 0).all()


def test_joint_row_takes_the_times_when_everything_is_known() -> None:
    errors = drawn()
    errors.error[::2, BA] = np.nan
    table = judged(errors)
    assert table["samples"].tolist() == [K] * 6 + [K // 2] * 3 + [K] * 3 + [
        K,
        K,
        K // 2,
        K,
        K // 2,
    ]


def test_dive_without_a_reference_says_so() -> None:
    table = frame(credibility_table("dive", ["baseline", "aided"], {}))
    assert (
        table["quantity"].tolist()
        == [*CREDIBILITY_QUANTITIES[:6], "velocity", "attitude", "all"] * 2
    )
    assert set(table["verdict"]) == {"no reference"}
    assert table["mean_nees"].isna().all()


def test_filter_that_broke_down_is_not_finite() -> None:
    errors = drawn()
    errors.cov[100, 0, 1] = errors.cov[100, 1, 0] = 2.0 * SD[0] * SD[1]
    assert judged(errors).loc["all", "verdict"] == "not finite"
    errors.cov[100], errors.cov[101] = np.inf, np.nan
    assert set(judged(errors)["verdict"]) == {"not finite"}


def test_times_up_to_the_start_are_left_out() -> None:
    later = drawn(k=100).after(9)
    assert later.time_ns.tolist() == list(range(10, 100))
    assert {len(later.error), len(later.sd), len(later.cov), len(later.heading)} == {90}


def test_whitened_errors_have_scipys_mahalanobis_distance() -> None:
    errors = drawn(k=50)
    expected = [e @ np.linalg.inv(errors.cov[0] / np.outer(SD, SD)) @ e for e in errors.error / SD]
    np.testing.assert_allclose(nees(errors.error, errors.cov), expected, rtol=1e-9)
    np.testing.assert_allclose(
        np.sum(whitened(errors.error, errors.cov) ** 2, axis=1), expected, rtol=1e-9
    )


@pytest.mark.parametrize(("group", "states"), CREDIBILITY_GROUPS.items())
def test_group_has_the_nees_of_its_block_of_p(group: str, states: slice) -> None:
    errors = drawn()
    inverse = np.linalg.inv(errors.cov[0, states, states] / np.outer(SD[states], SD[states]))
    expected = [e @ inverse @ e for e in errors.error[:, states] / SD[states]]
    row = judged(errors).loc[group]
    assert (row["dof"], row["samples"]) == (3, K)
    assert row["mean_nees"] == pytest.approx(np.mean(expected), rel=1e-9)


def test_groups_show_what_all_states_together_hide() -> None:
    """Velocities that hardly err, above an attitude that errs by half more than it says."""
    cov, error = np.diag(SD**2), np.random.default_rng(9).normal(size=(K, 12)) * SD
    error[:, :3] *= 0.1
    error[:, 3:6] *= 1.4
    table = judged(replace(drawn(), error=error, cov=np.tile(cov, (K, 1, 1))))
    assert table.loc[["velocity", "attitude", "all"], "verdict"].tolist() == [
        "conservative", "overconfident", "consistent",
    ]  # fmt: skip
    assert table.loc["all", "mean_nees"] == pytest.approx(3.0 * (0.1**2 + 1.4**2 + 2.0), rel=0.05)


@pytest.mark.parametrize(
    ("factor", "why"),
    [
        (1.0, ""),
        (0.97, Reason.NEAR),
        (1.04, Reason.NEAR),
        (0.8, Reason.EXACT_START),
        (0.2, ""),
        (1.2, ""),
    ],
)
def test_consistent_is_not_said_outside_the_interval_without_the_reason(
    factor: float, why: str
) -> None:
    row = judged(drawn(factor)).loc["all"]
    outside = not row["low"] <= row["mean_nees"] <= row["high"]
    assert row["why"] == why
    assert (row["verdict"] == "consistent" and outside) == bool(why)


def test_rare_large_errors_are_the_reason_for_over_confident_inside_the_interval() -> None:
    errors = drawn()
    error = errors.error * np.where(np.arange(K) % 20 == 0, 10.0, 1.0)[:, None]
    row = judged(replace(errors, error=error * SD / np.sqrt(np.mean(error**2, axis=0)))).loc[
        "velocity_d"
    ]
    assert row["low"] < row["mean_nees"] < row["high"]
    assert (row["verdict"], row["why"]) == ("overconfident", Reason.BEYOND_3_SD)


def on_a_slow_error(share: float, slow: float, seed: int) -> StateErrors:
    """A velocity of which some share hangs on a heading error that stays; the rest, and all else, is white."""
    correlation, rng = np.eye(12), np.random.default_rng(seed)
    correlation[0, 5] = correlation[5, 0] = np.sqrt(share)
    error = rng.normal(size=(K, 12))
    error[:, 5] = slow
    error[:, 0] = np.sqrt(share) * slow + np.sqrt(1.0 - share) * error[:, 0]
    cov = correlation * np.outer(SD, SD)
    return replace(drawn(), error=error * SD, cov=np.tile(cov, (K, 1, 1)))


@pytest.mark.parametrize("share", [0.3, 0.7])
@pytest.mark.parametrize("slow", [0.05, 1.0])
def test_velocity_on_a_slow_heading_error_is_worth_few_samples_however_small_that_is(
    share: float, slow: float
) -> None:
    """Its mean square varies with that of the heading error, which is one sample, by the square of the share."""
    row = judged(on_a_slow_error(share, slow, 3)).loc["velocity_n"]
    assert 0.45 / share**2 < row["effective_samples"] <= 1.05 / share**2


@pytest.mark.nightly
def test_interval_holds_the_mean_of_velocities_on_a_slow_heading_error() -> None:
    rng, inside = np.random.default_rng(10), 0
    for seed in range(60):
        row = judged(on_a_slow_error(0.6, rng.standard_normal(), seed)).loc["velocity_n"]
        inside += row["low"] <= row["mean_nees"] <= row["high"]
    # By the errors alone it would be 38.
    assert inside >= 54


# --- Filters on simulated dives.


@pytest.fixture(scope="module")
def exact() -> Dive:
    return exact_dive("figure-eight", imu_rate_hz=50.0)


def rows(replay: Replay) -> Any:
    return frame(replay.tables.credibility).set_index(["filter", "quantity"])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_filter_that_knows_its_noise_is_credible_and_the_published_model_is_not(
    exact: Dive, seed: int
) -> None:
    replay = replay_dive(add_errors(exact, *matched_errors(MATCHED), seed), MATCHED)
    table = rows(replay)
    baseline = table.loc[("baseline", "all")]
    assert baseline["verdict"] == "consistent"
    # Below 12, since the filter starts at the reference.
    assert 6.0 < baseline["mean_nees"] < baseline["high"]
    assert table.loc[("published", "all"), "verdict"] == "overconfident"
    for quantity in ("roll", "pitch"):
        assert table.loc[("published", quantity), "verdict"] == "overconfident", (
            "it leaves out w x v"
        )
    verdict = replay.verdicts["published"]
    assert verdict.credibility == "overconfident"
    assert re.search(r"published .*overconfident.*baseline .*consistent", verdict.sentence)


def test_straight_line_gives_no_false_words_on_what_its_heading_hides() -> None:
    """The heading starts exact and is never seen, so that the velocity across the track errs by less than P allows."""
    alone = msgspec.structs.replace(MATCHED, filters={"baseline": MATCHED.filters["baseline"]})
    straight = exact_dive("straight", imu_rate_hz=50.0)
    for seed in (1, 2, 5):
        table = rows(replay_dive(add_errors(straight, *matched_errors(alone), seed), alone)).loc[
            "baseline"
        ]
        assert table.loc["velocity_e", "mean_nees"] < FAR_SMALLER
        assert table.loc["velocity_e", "verdict"] in {"consistent", "insufficient data"}
        assert table.loc["velocity", "verdict"] == "consistent"


def test_settings_of_the_paper_are_conservative_for_a_fibre_optic_imu() -> None:
    replay = replay_dive(
        simulate_dive("figure-eight", duration_s=200.0, imu_rate_hz=50.0), Config()
    )
    assert set(rows(replay).xs("all", level="quantity")["verdict"]) == {"conservative"}


def test_biases_are_evaluated_where_the_truth_is_known(exact: Dive) -> None:
    dive = add_errors(exact, *matched_errors(MATCHED), 1)
    with_truth, without_truth = (
        rows(replay_dive(d, MATCHED)) for d in (dive, replace(dive, truth=None))
    )
    biases = [state.id for state in STATES[BA.start :]]
    assert [quantity for name, quantity in with_truth.index if name == "baseline"] == [
        *CREDIBILITY_QUANTITIES, *CREDIBILITY_GROUPS, "all", *SETTLED,
    ]  # fmt: skip
    assert not set(biases) & {quantity for _, quantity in without_truth.index}
    assert without_truth.loc[("baseline", "all"), "dof"] == 6
