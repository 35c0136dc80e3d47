"""Intervals of the mean NIS against scipy's chi-square, and the verdict on filters that are honest or are not."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from frames import frame
from made_histories import GATE, history
from numpy.typing import NDArray
from scipy import stats

from insdvl_replay.core.config import Acceleration, Config, Dvl, Filter, Noise
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.core.words import Reason
from insdvl_replay.evaluation.consistency import (
    FEWEST_UPDATES,
    SMALL_EXCESS,
    chi_square_quantile,
    consistency_table,
    consistency_verdict,
    mean_interval,
)
from insdvl_replay.evaluation.notes import update_notes
from insdvl_replay.evaluation.sentences import why_in_spite
from insdvl_replay.evaluation.verdicts import diverged_filters
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import DvlErrors, ImuErrors

BEAM_SD_MPS = 0.005
WHITE = ImuErrors(accel_white_mps_rts=2e-3, gyro_white_rad_rts=1e-5)
NOISE = Noise(accel_white_mps_rts=2e-3, gyro_white_rad_rts=1e-5)


def judged(nis: Floats, used: Floats | NDArray[np.bool_] | None = None) -> Any:
    """Give the row of the whole measurement."""
    return frame(consistency_table("dive", (history("baseline", nis, used),), {})).iloc[0]


# --- Chi-square.


@pytest.mark.parametrize("dof", [1, 3, 12, 400])
@pytest.mark.parametrize("probability", [0.025, 0.5, 0.975, 0.999, 0.99999])
def test_quantile_is_scipys(probability: float, dof: int) -> None:
    assert chi_square_quantile(probability, dof) == pytest.approx(
        stats.chi2.ppf(probability, dof), rel=1e-9
    )


def test_probability_one_lets_everything_pass() -> None:
    assert chi_square_quantile(1.0, 3) == np.inf


@pytest.mark.parametrize("count", [1, 10, 424, 30_000])
@pytest.mark.parametrize("confidence", [0.95, 0.99])
def test_interval_of_the_mean_is_scipys(count: int, confidence: float) -> None:
    expected = np.array(stats.chi2.interval(confidence, 3 * count)) / count
    np.testing.assert_allclose(mean_interval(3, count, confidence), expected, rtol=1e-9)


def test_interval_holds_the_mean_of_19_in_20_consistent_filters() -> None:
    draws = np.random.default_rng(11).chisquare(3, (2000, 50))
    low, high = mean_interval(3, 50)
    inside = np.mean((draws.mean(axis=1) >= low) & (draws.mean(axis=1) <= high))
    # 2000 draws scatter by 0.5 %; three of these.
    assert inside == pytest.approx(0.95, abs=0.015)


# --- The table.


@pytest.mark.parametrize(
    ("mean", "word"),
    [
        (2.0, "consistent"),
        (3.0, "consistent"),
        (4.0, "consistent"),
        (4.001, "overconfident"),
        (1.999, "conservative"),
        (np.inf, "not finite"),
        (np.nan, "not finite"),
    ],
)
def test_verdict_between_2_and_4(mean: float, word: str) -> None:
    assert consistency_verdict(mean, 2.0, 4.0, dof=3)[0] == word


@pytest.mark.parametrize(
    ("mean", "word"), [(3.29, "consistent"), (3.31, "overconfident"), (2.69, "conservative")]
)
def test_verdict_asks_for_size_next_to_significance(mean: float, word: str) -> None:
    assert consistency_verdict(mean, 2.99, 3.01, dof=3)[0] == word


@pytest.mark.parametrize(
    ("mean_nis", "why"),
    [(3.0, ""), (3.25, Reason.NEAR), (2.75, Reason.NEAR), (3.5, ""), (2.5, ""), (np.nan, "")],
)
def test_consistent_is_not_said_outside_the_interval_without_the_reason(
    mean_nis: float, why: str
) -> None:
    row = judged(np.full(1000, mean_nis))
    outside = not row["low"] <= mean_nis <= row["high"]
    assert row["why"] == why
    assert (row["verdict"] == "consistent" and outside) == bool(why)
    assert f"within {SMALL_EXCESS:.0%}".replace("%", " %") in why_in_spite(Reason.NEAR)


@pytest.mark.parametrize(
    ("mean_nis", "word"),
    [(3.0, "consistent"), (6.0, "overconfident"), (1.0, "conservative"), (np.nan, "not finite")],
)
def test_verdict_of_a_filter(mean_nis: float, word: str) -> None:
    row = judged(np.full(100, mean_nis))
    assert row["mean_nis"] == pytest.approx(mean_nis, nan_ok=True)
    assert row["verdict"] == word
    np.testing.assert_allclose(
        [row["low"], row["high"]], np.array(stats.chi2.interval(0.95, 300)) / 100, rtol=1e-9
    )


def test_every_filter_and_measurement_has_a_row() -> None:
    baseline, other = (
        history("baseline", np.full(20, 3.0)),
        history("aided", np.full(30, 3.0), measurement="acceleration"),
    )
    aided = replace(other, innovations=baseline.innovations + other.innovations)
    table = frame(consistency_table("dive", (baseline, aided), {}))
    assert table.columns.tolist() == [
        "log", "filter", "measurement", "dof", "used", "rejected", "mean_nis", "low", "high", "verdict",
        "autocorrelation", "autocorrelation_limit", "whiteness", "why",
    ]  # fmt: skip
    expected = [
        ("baseline", "velocity", 20),
        ("aided", "velocity", 20),
        ("aided", "acceleration", 30),
    ]
    assert table[["filter", "measurement", "used"]].to_numpy().tolist() == [
        [name, row, used]
        for name, measurement, used in expected
        for row in (measurement, *(f"{measurement}_{axis}" for axis in "xyz"))
    ]
    assert set(table["log"]) == {"dive"}
    assert table["dof"].tolist() == [3, 1, 1, 1] * 3


def with_innovations(
    innovation_b: Floats, sd_b: Floats, used: NDArray[np.bool_] | None = None
) -> Any:
    """Give the rows of a velocity whose components are independent."""
    made = history("baseline", np.sum((innovation_b / sd_b) ** 2, axis=1), used)
    innovations = replace(made.innovations[0], innovation=innovation_b, sd=sd_b)
    table = frame(consistency_table("dive", (replace(made, innovations=(innovations,)),), {}))
    return table.set_index("measurement")


def test_axes_are_evaluated_each_by_its_own_variance() -> None:
    """Too sure along x and not sure enough along z make a mean that looks right."""
    rng, sd_b = np.random.default_rng(3), np.tile([0.1, 0.2, 0.3], (2000, 1))
    innovation_b = rng.standard_normal((2000, 3)) * sd_b * np.sqrt([1.9, 1.0, 0.1])
    table = with_innovations(innovation_b, sd_b)
    assert table.loc["velocity", "verdict"] == "consistent"
    assert table.loc["velocity_x":"velocity_z", "verdict"].tolist() == [
        "overconfident", "consistent", "conservative",
    ]  # fmt: skip
    # The mean of 2000 squares scatters by 3.2 %.
    np.testing.assert_allclose(
        table.loc["velocity_x":"velocity_z", "mean_nis"], [1.9, 1.0, 0.1], rtol=0.1
    )
    np.testing.assert_allclose(
        table.loc["velocity_x", ["low", "high"]].tolist(), mean_interval(1, 2000)
    )


def test_rejected_innovations_do_not_spoil_the_axes() -> None:
    innovation_b, used = np.random.default_rng(4).standard_normal((200, 3)), np.arange(200) != 80
    innovation_b[80] = 1e6
    table = with_innovations(innovation_b, np.ones((200, 3)), used)
    assert table["used"].tolist() == [199] * 4
    assert table["rejected"].tolist() == [1] * 4
    assert (table["verdict"] == "consistent").all()
    assert (table["whiteness"] == "white").all()


def test_rejected_innovations_count_as_much_as_the_gate_is() -> None:
    nis, used = np.full(100, 3.0), np.ones(100)
    nis[[7, 50]], used[[7, 50]] = 1e4, 0.0
    row = judged(nis, used)
    assert (row["used"], row["rejected"]) == (98, 2)
    assert row["mean_nis"] == pytest.approx((98 * 3.0 + 2 * GATE) / 100)
    assert (row["low"], row["high"]) == pytest.approx(mean_interval(3, 100))
    assert row["verdict"] == "consistent"


@pytest.mark.parametrize("used", [0, 5, 70])
def test_filter_that_rejects_what_it_meets_is_over_confident(used: int) -> None:
    nis = np.where(np.arange(100) < used, 1.0, 1e5)
    row = judged(nis, nis < GATE)
    assert (row["used"], row["rejected"], row["verdict"]) == (used, 100 - used, "overconfident")


def test_too_few_updates_are_not_evaluated() -> None:
    row = judged(np.full(FEWEST_UPDATES - 1, 3.0), np.zeros(FEWEST_UPDATES - 1))
    assert (row["used"], row["rejected"], row["verdict"]) == (
        0,
        FEWEST_UPDATES - 1,
        "insufficient data",
    )
    assert (
        row[["mean_nis", "low", "high", "autocorrelation", "autocorrelation_limit"]].isna().all()
    )
    assert row["whiteness"] == "insufficient data"
    assert judged(np.full(FEWEST_UPDATES, 3.0))["verdict"] == "consistent"


def test_innovations_that_are_not_finite_make_a_mean_that_is_not() -> None:
    nis = np.full(100, 3.0)
    nis[60:] = np.nan
    assert judged(nis, np.isfinite(nis))["verdict"] == "not finite"


@pytest.mark.parametrize(
    ("probability", "pings", "rejected", "dead"),
    [(0.9, 300, 51, False), (0.9, 300, 61, True), (0.99999, 9, 1, False), (0.99999, 9, 3, True)],
)
def test_what_a_gate_rejects_by_chance_makes_no_filter_dead(
    probability: float, pings: int, rejected: int, dead: bool
) -> None:
    made = history("one", np.full(pings, 3.0), np.arange(pings) >= rejected)
    innovations = replace(made.innovations[0], gate=chi_square_quantile(probability, 3))
    assert bool(diverged_filters((replace(made, innovations=(innovations,)),))) is dead


@pytest.mark.parametrize(
    ("probability", "reopen_after", "times", "dead"),
    [
        (0.99999, 5, 1, False),
        (0.99999, 5, 3, False),
        (0.99999, 5, 4, True),
        (0.99, 1, 5, False),
        (0.99, 1, 7, True),
    ],
)
def test_filter_that_loses_its_way_again_and_again_is_dead(
    probability: float, reopen_after: int, times: int, dead: bool
) -> None:
    made = history("one", np.full(300, 3.0))
    gate, reopened = chi_square_quantile(probability, 3), np.arange(300) < times
    innovations = replace(
        made.innovations[0], gate=gate, reopen_after=reopen_after, reopened=reopened
    )
    found = diverged_filters((replace(made, innovations=(innovations,)),))
    assert {name: re.findall(r"\d+", why) for name, why in found.items()} == (
        {"one": [str(times), "300"]} if dead else {}
    )


@pytest.mark.parametrize(
    ("pings", "times", "dead"), [(30, 1, False), (30, 2, True), (400, 4, False), (400, 5, True)]
)
def test_a_second_reset_is_too_many_in_a_short_dive_and_one_in_a_hundred_pings_in_a_long_one(
    pings: int, times: int, dead: bool
) -> None:
    made = history("one", np.full(pings, 3.0), np.ones(pings))
    innovations = replace(made.innovations[0], reopened=np.arange(pings) < times)
    assert bool(diverged_filters((replace(made, innovations=(innovations,)),))) is dead


def test_dead_filters_are_found() -> None:
    few, many = (
        history(name, np.full(100, 3.0), np.arange(100) >= n)
        for name, n in (("few", 10), ("many", 11))
    )
    broken = replace(
        history("broken", np.full(100, 3.0)), velocity_n=np.array([[0.0, np.nan, 0.0]])
    )
    blind = replace(history("blind", np.full(100, 3.0)), sd=np.full((1, 12), np.nan))
    only = history("only", np.full(100, 3.0), np.arange(100) >= 11, measurement="acceleration")
    gated = replace(few, filter="gated", innovations=few.innovations + only.innovations)
    found = diverged_filters((few, many, broken, blind, only, gated))
    assert list(found) == ["many", "broken", "blind", "only"]
    assert re.search(r"11 of 100 velocity\b", found["many"])
    assert re.search(r"11 of 100 acceleration\b", found["only"])
    assert all("0.0 s" in found[name] for name in ("broken", "blind"))


def test_gate_that_rejects_more_than_outliers_is_a_warning() -> None:
    kept = np.arange(100)
    few, many = (
        history("few", np.full(100, 3.0), kept >= 10),
        history("many", np.full(100, 3.0), kept >= 11),
    )
    (warning,) = update_notes((few, many))
    assert (warning.code, warning.severity, warning.count) == ("gate_rejects_many", "warning", 11)
    assert re.search(r"many .*11 of 100 velocity\b", warning.text)
    assert "filters.many.gate_probability" in warning.hint


def test_a_reopened_filter_is_reported_though_something_that_aids_it_was_never_met() -> None:
    made, (never,) = history("one", np.full(30, 3.0)), history("one", np.empty(0)).innovations
    set_again = replace(made.innovations[0], reopened=np.arange(30) == 4)
    (_, reopened) = update_notes(
        (replace(made, innovations=(set_again, replace(never, measurement="acceleration"))),)
    )
    assert (reopened.code, reopened.count) == ("gate_reopened", 1)


@pytest.mark.parametrize(
    ("factor", "wild", "told"),
    [
        (1.0, 0, False),
        (1.0, 1, False),
        (1.0, 20, False),
        (4.0, 0, True),
        (4.0, 20, True),
        (2.0, 0, False),
    ],
)
def test_a_sensor_contradicts_a_filter_by_most_of_its_readings(
    factor: float, wild: int, told: bool
) -> None:
    """And not by few that are far off; errors of so many times what the settings say."""
    nis = factor**2 * np.random.default_rng(3).chisquare(3, 200)
    nis[:wild] = 1e4
    codes = [note.code for note in update_notes((history("aided", nis, measurement="position"),))]
    assert codes == ["position_disagrees"] * told


# --- Filters on simulated dives.


@pytest.fixture(scope="module")
def dive() -> Dive:
    """White noise alone, of a size that the filters can be told."""
    noise = DvlErrors(
        beam_sd_mps=BEAM_SD_MPS, beam_bias_sd_mps=0.0, beam_scale_sd=0.0, beam_quantum_mps=0.0
    )
    return simulate_dive(
        "straight", duration_s=200.0, imu_rate_hz=20.0, seed=5, imu_errors=WHITE, dvl_errors=noise
    )


def replayed(
    dive: Dive, *, beam_sd_mps: float = BEAM_SD_MPS, gate_probability: float = 1.0
) -> Replay:
    filters = {
        "baseline": Filter(aiding=("velocity",), gate_probability=gate_probability),
        "aided": Filter(
            aiding=("velocity", "acceleration"),
            gate_probability=gate_probability,
            acceleration=Acceleration(),
        ),
    }
    return replay_dive(
        dive, Config(noise=NOISE, dvl=Dvl(beam_sd_mps=beam_sd_mps), filters=filters)
    )


def rows(replay: Replay) -> Any:
    """Give the rows of the measurements, without those of their axes."""
    table = frame(replay.tables.consistency)
    return table[table["dof"] == 3].set_index(["filter", "measurement"])


@pytest.mark.parametrize(
    ("factor", "word"),
    [(1.0, "consistent"), (0.5, "overconfident"), (2.0, "conservative")],
    ids=str,
)
def test_filter_that_knows_its_noise_is_consistent_and_one_that_does_not_is_found_out(
    dive: Dive, factor: float, word: str
) -> None:
    row = rows(replayed(dive, beam_sd_mps=factor * BEAM_SD_MPS)).loc["baseline", "velocity"]
    assert row["verdict"] == word
    assert row["used"] == 200


def test_outlier_is_rejected_counted_and_leaves_no_trace(dive: Dive) -> None:
    beams = dive.dvl.beam_velocity_mps
    vectors_d = dive.dvl.beam_vectors_d
    assert beams is not None
    assert vectors_d is not None
    spoilt, others = beams.copy(), np.arange(len(beams)) != 100
    spoilt[100] += vectors_d @ [1.0, 0.0, 0.0]
    with_outlier = replayed(
        replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=spoilt)), gate_probability=0.99999
    )
    left_out = replace(dive.dvl, time_ns=dive.dvl.time_ns[others], beam_velocity_mps=beams[others])
    without = replayed(replace(dive, dvl=left_out), gate_probability=0.99999)

    counted = rows(with_outlier)[["used", "rejected"]]
    assert counted.loc["baseline", "velocity"].tolist() == [199, 1]
    assert counted.loc["aided", "velocity"].tolist() == [199, 1]
    # Three windows hold the outlier; at 1 Hz the one that has it in its middle gives it no weight.
    assert counted.loc["aided", "acceleration"].tolist() == [196, 2]
    assert rows(without)["rejected"].tolist() == [0, 0, 0]

    ours, theirs = with_outlier.histories[0], without.histories[0]
    np.testing.assert_allclose(ours.velocity_n[-1], theirs.velocity_n[-1], atol=1e-6)
    np.testing.assert_allclose(ours.sd[-1], theirs.sd[-1], rtol=1e-6)
    aided, aided_without = with_outlier.histories[1], without.histories[1]
    np.testing.assert_array_less(
        np.abs(aided.velocity_n[-1] - aided_without.velocity_n[-1]), 0.1 * aided.sd[-1, :3]
    )


def test_outlier_without_a_gate_is_used(dive: Dive) -> None:
    beams = dive.dvl.beam_velocity_mps
    assert beams is not None
    spoilt = beams.copy()
    spoilt[100] += 0.5
    ungated = rows(replayed(replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=spoilt))))
    assert ungated.loc["baseline", "velocity"]["rejected"] == 0
    assert ungated.loc["baseline", "velocity"]["verdict"] == "overconfident"
