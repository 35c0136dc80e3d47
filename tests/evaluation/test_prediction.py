"""Log scores and CRPS of filters that predict the DVL, against densities and integrals of scipy."""

from dataclasses import replace

import numpy as np
import pytest
from made_histories import GATE, history
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from insdvl_replay.core.dive_columns import NS_PER_S, Floats
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.evaluation.outage_test import (
    OutagePlan,
    OutageRun,
    OutageRuns,
    Windows,
    outage_run,
)
from insdvl_replay.evaluation.prediction import Score, crps, prediction_of

PINGS = 40
NO_ROWS = np.empty(0, np.int64)
NO_WINDOWS = Windows(60, NO_ROWS, NO_ROWS, 0)
NO_RUNS = OutageRuns(OutagePlan(NO_ROWS, (), NO_WINDOWS), np.empty(0), {})


def covariance(seed: int) -> Floats:
    root = np.random.default_rng(seed).normal(0.0, 0.1, (3, 3))
    return np.asarray(root @ root.T + 1e-4 * np.eye(3))


def predicted(
    name: str, innovation: Floats, S: Floats, measurement: str = "velocity", gate: float = np.inf
) -> History:
    """A filter that met one ping a second, with these innovations, shape (m, 3), and their covariance."""
    m = len(innovation)
    nis = np.einsum("ki,ij,kj->k", innovation, np.linalg.inv(S), innovation)
    time_ns = NS_PER_S * np.arange(1, m + 1, dtype=np.int64)
    made = history(name, nis, measurement=measurement)
    [met] = made.innovations
    log_det = np.full(m, np.linalg.slogdet(S)[1])
    met = replace(
        met, time_ns=time_ns, valid_ns=time_ns, innovation=innovation, log_det=log_det, gate=gate
    )
    return replace(made, innovations=(met,))


def score_of(
    before: History, after: History, settled_s: float = 0.0, outages: OutageRuns = NO_RUNS
) -> Score:
    score = prediction_of(before, after, outages, settled_s)
    assert score is not None
    return score


def innovations(seed: int, m: int = PINGS) -> Floats:
    return np.random.default_rng(seed).normal(0.0, 0.1, (m, 3))


def per_component(innovation: Floats, S: Floats) -> float:
    """Return minus the mean log density of scipy for each component, nat."""
    return float(-multivariate_normal(np.zeros(3), S).logpdf(innovation).mean()) / 3.0


# --- One step ahead.


def test_log_score_is_that_of_a_normal_density() -> None:
    S, new_S = covariance(1), covariance(2)
    score = score_of(
        predicted("baseline", innovations(3), S), predicted("aided", innovations(4), new_S)
    )
    assert score.baseline == pytest.approx(per_component(innovations(3), S), rel=1e-12)
    assert score.value == pytest.approx(per_component(innovations(4), new_S), rel=1e-12)
    assert score.pings == PINGS
    assert score.ratio == pytest.approx(np.exp(score.value - score.baseline))


@pytest.mark.parametrize("factor", [0.3, 0.8, 1.25, 3.0])
def test_honest_sigma_scores_best(factor: float) -> None:
    """The score is proper: a sigma that is too small loses, and so does one that is too large."""
    S = covariance(1)
    z = np.random.default_rng(5).multivariate_normal(np.zeros(3), S, 4000)
    score = score_of(predicted("baseline", z, S), predicted("aided", z, factor**2 * S))
    # The expected difference for each component is ln f + (1 / f^2 - 1) / 2.
    assert np.log(score.ratio) == pytest.approx(
        np.log(factor) + 0.5 * (factor**-2 - 1.0), abs=0.15
    )
    assert score.ratio > 1.0


def test_pings_before_the_baseline_has_settled_do_not_count() -> None:
    S, z = covariance(1), innovations(3)
    wild = z.copy()
    wild[:9] *= 1000.0
    score = score_of(predicted("baseline", z, S), predicted("aided", wild, S), settled_s=10.0)
    assert (score.baseline, score.value) == (pytest.approx(per_component(z[9:], S)),) * 2
    assert score.pings == PINGS - 9


def test_outlier_counts_as_much_as_the_gate_is() -> None:
    S = np.eye(3)
    z = np.zeros((2, 3))
    z[1, 0] = 1000.0
    score = score_of(predicted("baseline", z, S, gate=GATE), predicted("aided", z, S))
    constant = 1.5 * np.log(2.0 * np.pi)
    assert score.baseline == pytest.approx((constant + 0.25 * GATE) / 3.0)
    assert score.value == pytest.approx((constant + 0.25e6) / 3.0), (
        "of a filter without a gate all of it"
    )


def test_pings_that_one_of_two_lacks_are_left_out_of_both() -> None:
    S, z = covariance(1), innovations(3)
    fewer = predicted("aided", z, S)
    [met] = fewer.innovations
    fewer = replace(fewer, innovations=(rows_of(met, np.arange(PINGS) % 2 == 0),))
    score = score_of(predicted("baseline", z, S), fewer)
    assert (score.baseline, score.pings) == (score.value, PINGS // 2)
    assert score.baseline == pytest.approx(per_component(z[::2], S))


def rows_of(met: Innovations, rows: np.ndarray) -> Innovations:
    columns = ("time_ns", "valid_ns", "innovation", "nis", "log_det")
    return replace(met, **{name: getattr(met, name)[rows] for name in columns})


def test_filters_of_different_measurements_are_not_compared() -> None:
    """The densities of a velocity and of a beam have different units."""
    S, z = covariance(1), innovations(3)
    of_beams = predicted("aided", z, S, measurement="beam 1")
    assert prediction_of(predicted("baseline", z, S), of_beams, NO_RUNS, 0.0) is None
    held_out = predicted("baseline", z, S, gate=-1.0)
    assert prediction_of(held_out, held_out, NO_RUNS, 0.0) is None


# --- In outages.


def outages(scores: dict[str, float], window_s: int = 60, windows: int = 2) -> OutageRuns:
    """Windows of a minute, in which each filter has a score of its own at every ping, nat."""
    first = np.arange(windows) * window_s
    ends = Windows(window_s, first, first + window_s, 0)
    plan = OutagePlan(NS_PER_S * np.arange(windows * window_s + 1), (ends,), ends)
    runs = {
        name: tuple(coasting(window_s, score) for _ in range(windows))
        for name, score in scores.items()
    }
    return OutageRuns(plan, np.arange(windows * window_s + 1.0), runs)


def coasting(pings: int, score: float) -> OutageRun:
    nothing = np.zeros((pings + 1, 3))
    of_pings = np.concatenate([[np.nan], np.full(pings, score)])
    return OutageRun(np.arange(pings + 1.0), nothing, nothing, of_pings, of_pings)


def test_one_step_and_outages_have_equal_weight() -> None:
    """However many more pings there are one step ahead."""
    S, z = covariance(1), innovations(3, 500)
    before, after = predicted("baseline", z, S), predicted("aided", 0.5 * z, S)
    score = score_of(before, after, outages=outages({"baseline": 6.0, "aided": 3.0}))
    assert score.baseline == pytest.approx(0.5 * (per_component(z, S) + 2.0))
    assert score.value == pytest.approx(0.5 * (per_component(0.5 * z, S) + 1.0))
    assert score.pings == 500 + 2 * 60


@pytest.mark.parametrize("window_s", [60, 30])
def test_outages_alone_are_a_score(window_s: int) -> None:
    """A solution that is read has no innovations; here both lack them."""
    nothing = replace(predicted("baseline", innovations(3), covariance(1)), innovations=())
    other = replace(nothing, filter="aided")
    score = score_of(nothing, other, outages=outages({"baseline": 6.0, "aided": 9.0}, window_s))
    assert score == Score(2.0, 3.0, 2 * window_s)
    assert score.ratio == pytest.approx(np.e)
    assert prediction_of(nothing, other, outages({"baseline": 6.0}, window_s), 0.0) is None
    assert prediction_of(nothing, other, NO_RUNS, 0.0) is None


def test_score_of_held_out_velocities_is_that_of_a_normal_density() -> None:
    S, z = covariance(1), innovations(3)
    held_out = predicted("baseline", z, S, gate=-1.0)
    k = PINGS + 1
    whole = replace(
        held_out,
        time_ns=NS_PER_S * np.arange(k, dtype=np.int64),
        mat_nb=np.tile(np.eye(3), (k, 1, 1)),
    )
    run = outage_run(whole)
    assert np.isnan(run.minus_log_score[0])
    assert run.minus_log_score[1:] == pytest.approx(-multivariate_normal(np.zeros(3), S).logpdf(z))


# --- CRPS.


@pytest.mark.parametrize(("error", "sigma"), [(0.0, 1.0), (0.7, 0.2), (-3.0, 2.0), (5.0, 0.01)])
def test_crps_is_the_integral_of_squared_differences_of_distributions(
    error: float, sigma: float
) -> None:
    """Between the predicted distribution, about zero, and the step at what came."""
    before, _ = quad(
        lambda x: norm.cdf(x, 0.0, sigma) ** 2,
        -9.0 * sigma - abs(error),
        error,
        points=[0.0],
        limit=500,
    )
    after, _ = quad(
        lambda x: norm.sf(x, 0.0, sigma) ** 2,
        error,
        9.0 * sigma + abs(error),
        points=[0.0],
        limit=500,
    )
    assert crps(np.array([error]), np.array([sigma])) == pytest.approx(before + after, rel=1e-6)


def test_crps_is_a_mean_over_what_is_known() -> None:
    alone = [
        crps(np.array([error]), np.array([sigma])) for error, sigma in ((0.7, 0.2), (-3.0, 2.0))
    ]
    found = crps(np.array([0.7, np.nan, -3.0, 1.0]), np.array([0.2, 1.0, 2.0, np.nan]))
    assert found == pytest.approx(np.mean(alone))
    assert np.isnan(crps(np.array([np.nan]), np.array([1.0])))
