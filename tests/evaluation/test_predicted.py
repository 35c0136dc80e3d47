"""Improvement and convergence on histories small enough to check by hand, and the paper's own arithmetic."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from frames import frame

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.history import History
from insdvl_replay.core.states import NINE, STATES
from insdvl_replay.evaluation.convergence import (
    convergence_table,
    improvement_table,
    mean_over_nine,
    nearest_approach_s,
    nearest_over_nine,
    time_to_stay_below,
    unchanged_over_nine,
)
from insdvl_replay.evaluation.reference_errors import improvement_pct

SECOND = 1_000_000_000
PAPER_S = 424
"""Length of the paper's straight line."""


def history(name: str, sd: Floats, interval_s: float = 1.0) -> History:
    """A filter that believes ``sd``, shape (k,) for all states alike or (k, 12), SI units."""
    k = len(sd)
    wide = np.broadcast_to(sd[:, None] if sd.ndim == 1 else sd, (k, 12))
    times = 7 * SECOND + np.rint(np.arange(k) * interval_s * SECOND).astype(np.int64)
    nothing = np.zeros((k, 3))
    attitudes = np.tile(np.eye(3), (k, 1, 1))
    return History(
        name,
        times,
        np.ones(k, dtype=bool),
        nothing,
        nothing,
        attitudes,
        nothing,
        nothing,
        wide,
        times[:0],
        nothing,
        (),
    )


def row(table: pd.DataFrame, state: str) -> Any:
    return table[table["state"] == state].squeeze(axis=0)


# --- Improvement.


def test_improvement_compares_the_ends_in_shown_units() -> None:
    baseline, aided = np.full((2, 12), 5.0), np.full((2, 12), 7.0)
    for state in STATES:
        baseline[-1, state.index] = 4.0 * state.factor
        aided[-1, state.index] = 3.0 * state.factor
    table = frame(
        improvement_table("dive", (history("baseline", baseline), history("aided", aided)))
    )
    assert table.columns.tolist() == [
        "log", "filter", "state", "unit", "baseline_sd", "sd", "improvement_pct", "status",
    ]  # fmt: skip
    assert table["state"].tolist() == [state.id for state in STATES]
    assert table["unit"].tolist() == ["m/s"] * 3 + ["mrad"] * 3 + ["mg"] * 3 + ["deg/h"] * 3
    assert set(table["log"]) == {"dive"}
    assert set(table["filter"]) == {"aided"}
    assert set(table["status"]) == {"improved"}
    np.testing.assert_allclose(
        table[["baseline_sd", "sd", "improvement_pct"]], [[4.0, 3.0, 25.0]] * 12, rtol=1e-12
    )


@pytest.mark.parametrize(
    ("before", "after", "status", "pct"),
    [
        (4.0, 3.0, "improved", 25.0),
        (4.0, 5.0, "worse", -25.0),
        (4.0, 4.0, "same", 0.0),
        (1.0, 1.0 - 0.0004, "same", 0.04),
        (1.0, 1.0 - 0.0006, "improved", 0.06),
        (1.0, 1.0 + 0.0006, "worse", -0.06),
        (4.0, np.nan, "not finite", np.nan),
        (np.inf, 4.0, "not finite", np.nan),
        (0.0, 1.0, "not finite", np.nan),
    ],
)
def test_status_of_an_improvement(before: float, after: float, status: str, pct: float) -> None:
    table = frame(
        improvement_table(
            "d", (history("b", np.array([9.0, before])), history("a", np.array([9.0, after])))
        )
    )
    assert row(table, "ba_z")["status"] == status
    assert row(table, "ba_z")["improvement_pct"] == pytest.approx(pct, abs=1e-9, nan_ok=True)
    assert improvement_pct(before, after) == pytest.approx(pct, abs=1e-9, nan_ok=True)


def test_every_candidate_is_held_against_the_first() -> None:
    histories = tuple(
        history(name, np.array([9.0, end])) for name, end in (("a", 8.0), ("b", 4.0), ("c", 2.0))
    )
    improvement, convergence = (
        frame(improvement_table("d", histories)),
        frame(convergence_table("d", histories, {})),
    )
    assert (
        improvement["filter"].tolist() == convergence["filter"].tolist() == ["b"] * 12 + ["c"] * 12
    )
    assert improvement["improvement_pct"].to_numpy() == pytest.approx([50.0] * 12 + [75.0] * 12)


def test_baseline_alone_has_nothing_to_compare() -> None:
    alone = (history("baseline", np.ones(3)),)
    assert improvement_table("d", alone) == []
    assert convergence_table("d", alone, {}) == []


# --- Convergence.


@pytest.mark.parametrize(
    ("sd", "reached_s", "status"),
    [
        ([9.0, 8.0, 4.0, 3.0], 1.75, "reached"),
        ([9.0, 5.0, 4.0, 3.0], 1.0, "reached"),
        ([4.0, 6.0, 7.0, 3.0], 2.5, "reached"),
        ([9.0, 4.0, 7.0, 4.0], 2.0 + 2.0 / 3.0, "reached"),
        ([9.0, 8.0, 7.0, 5.0], 3.0, "reached"),
        ([5.0, 4.0, 3.0, 2.0], np.nan, "at_start"),
        ([9.0, 8.0, 7.0, 6.0], np.nan, "never"),
        ([4.0, 4.0, 4.0, 6.0], np.nan, "never"),
        ([9.0, np.nan, 4.0, 3.0], 2.0, "reached"),
        ([np.inf, 4.0, 4.0, 3.0], 1.0, "reached"),
        ([9.0, 8.0, 4.0, np.nan], np.nan, "never"),
    ],
    ids=[
        "between two samples",
        "at a sample",
        "starts below, rises, falls",
        "falls, rises, falls",
        "at the very end",
        "never above",
        "not in time",
        "rises at the end",
        "not a number until then",
        "infinite at the start",
        "not a number at the end",
    ],
)
def test_time_after_which_it_stays_at_or_below_5(
    sd: list[float], reached_s: float, status: str
) -> None:
    found_s, found = time_to_stay_below(np.arange(4.0), np.array(sd), 5.0)
    assert found == status
    assert found_s == pytest.approx(reached_s, abs=1e-12, nan_ok=True)


def test_target_that_is_not_a_number_is_never_reached() -> None:
    assert time_to_stay_below(np.arange(3.0), np.ones(3), np.nan)[1] == "never"


def test_convergence_counts_seconds_from_the_start() -> None:
    baseline = history("baseline", np.array([9.0, 8.0, 7.0, 6.0, 5.0]), interval_s=2.5)
    aided = history("aided", np.array([9.0, 6.0, 4.0, 3.0, 2.0]), interval_s=2.5)
    table = frame(convergence_table("dive", (baseline, aided), {}))
    assert table.columns.tolist() == [
        "log", "filter", "state", "unit", "target_sd", "baseline_s", "reached_s", "improvement_pct", "status",
        "measured_target", "measured_baseline_s", "measured_s", "measured_status", "unchanged_s",
        "nearest_approach_s", "nearest_approach_improvement_pct",
    ]  # fmt: skip
    for state in STATES:
        found = row(table, state.id)
        assert (found["log"], found["filter"], found["unit"], found["status"]) == (
            "dive",
            "aided",
            state.unit,
            "reached",
        )
        assert found["target_sd"] == pytest.approx(5.0 / state.factor)
        assert found["baseline_s"] == pytest.approx(10.0, abs=1e-9)
        assert found["reached_s"] == pytest.approx(3.75, abs=1e-9)
        assert found["improvement_pct"] == pytest.approx(62.5, abs=1e-9)


@pytest.mark.parametrize(
    ("sd", "status"), [([4.0, 3.0, 2.0], "at_start"), ([9.0, 8.0, 7.0], "never")]
)
def test_what_was_not_reached_has_no_time(sd: list[float], status: str) -> None:
    rows = convergence_table(
        "d", (history("b", np.array([9.0, 6.0, 5.0])), history("a", np.array(sd))), {}
    )
    table = frame(rows)
    assert set(table["status"]) == {status}
    assert table[["reached_s", "improvement_pct"]].isna().all(axis=None)
    assert mean_over_nine(rows, "a") == 0.0


def test_a_candidate_that_changes_nothing_is_as_much_sooner_as_the_baseline_itself_was() -> None:
    """As sure after two of four seconds as at the end, which is when the paper takes it to have converged."""
    baseline = history("baseline", np.array([9.0, 8.0, 5.0, 5.0, 5.0]))
    rows = convergence_table(
        "dive", (baseline, history("same", baseline.sd), history("aided", 0.9 * baseline.sd)), {}
    )
    assert [row.unchanged_s for row in rows] == pytest.approx([2.0] * len(rows))
    assert mean_over_nine(rows, "same") == unchanged_over_nine(rows, "same") == pytest.approx(50.0)
    assert (
        mean_over_nine(rows, "aided") > unchanged_over_nine(rows, "aided") == pytest.approx(50.0)
    )


# --- The nearest approach.


def test_nearest_approach_has_the_closed_form() -> None:
    """A hyperbola a/t is nearest to b where it crosses it, at a/b; a hill below the target, where it is highest."""
    time_s = np.linspace(0.0, 400.0, 4001)
    falling = 500.0 / np.maximum(time_s, 0.1)
    hill = 8.5 - 1e-5 * (time_s - 96.0) ** 2
    assert nearest_approach_s(time_s, falling, 2.0) == pytest.approx(250.0, abs=1e-9)
    assert nearest_approach_s(time_s, hill, 9.0) == pytest.approx(96.0, abs=1e-9)
    assert time_to_stay_below(time_s, hill, 9.0)[1] == "at_start"


def test_nearest_approach_passes_over_what_is_not_finite() -> None:
    assert nearest_approach_s(np.arange(4.0), np.array([np.nan, np.inf, 4.0, 3.0]), 5.0) == 2.0
    assert np.isnan(nearest_approach_s(np.arange(2.0), np.full(2, np.nan), 5.0))
    assert np.isnan(nearest_approach_s(np.arange(2.0), np.ones(2), np.nan))


def test_mean_of_the_nearest_approaches_is_over_the_nine_states() -> None:
    """Each state passes the baseline's last value after its own number of the ten seconds; velocities are left out."""
    times_s = np.arange(11.0)
    baseline = history("baseline", np.linspace(3.0, 2.0, 11))
    aided = np.repeat((12.0 - times_s)[:, None], 12, axis=1)
    for k, state in enumerate(NINE):
        aided[:, state.index] = 2.0 + np.abs(times_s - k)
    rows = convergence_table(
        "dive", (baseline, history("aided", aided), history("same", baseline.sd)), {}
    )
    found = {row.state: row for row in rows if row.filter == "aided"}
    assert [found[state.id].nearest_approach_s for state in NINE] == list(range(9))
    assert nearest_over_nine(rows, "aided") == pytest.approx(60.0)
    assert nearest_over_nine(rows, "same") == pytest.approx(0.0, abs=1e-12)


# --- The mean over nine states.


def test_mean_leaves_out_the_velocity_errors_and_the_other_filters() -> None:
    baseline, aided = np.full((2, 12), 4.0), np.full((2, 12), 2.0)
    aided[:, :3] = 4e9
    table = improvement_table(
        "d",
        (history("b", baseline), history("aided", aided), history("other", np.full((2, 12), 1.0))),
    )
    assert mean_over_nine(table, "aided") == pytest.approx(50.0)
    assert mean_over_nine(table, "other") == pytest.approx(75.0)


def test_state_that_became_worse_pulls_the_mean_down() -> None:
    aided = np.full((2, 12), 4.0)
    aided[-1, STATES[5].index] = 8.0
    table = improvement_table("d", (history("b", np.full((2, 12), 4.0)), history("aided", aided)))
    assert mean_over_nine(table, "aided") == pytest.approx(-100.0 / 9.0)


def test_mean_over_what_is_not_finite_is_not_a_number() -> None:
    aided = np.full((2, 12), 2.0)
    aided[-1, 11] = np.nan
    table = improvement_table("d", (history("b", np.full((2, 12), 4.0)), history("aided", aided)))
    assert np.isnan(mean_over_nine(table, "aided"))


# --- The paper's table.


@pytest.fixture(scope="module")
def printed(paper: Path) -> Any:
    return pd.read_csv(paper / "straight.csv").set_index("state")


@pytest.fixture(scope="module")
def papers_histories(printed: Any) -> tuple[History, History]:
    """Histories that end with the paper's standard deviations and pass the targets at the paper's times."""
    baseline, aided = np.ones((PAPER_S + 1, 12)), np.ones((PAPER_S + 1, 12))
    time_s = np.arange(PAPER_S + 1)
    for state in NINE:
        line = printed.loc[state.id]
        target, last = line["baseline_sd"] * state.factor, line["aided_sd"] * state.factor
        baseline[:, state.index] = np.linspace(2.0 * target, target, PAPER_S + 1)
        if np.isnan(line["reached_s"]):
            aided[:, state.index] = target * (1.0 + 1e-9)
        else:
            times_s = [0.0, line["reached_s"] / 2.0, line["reached_s"], PAPER_S]
            aided[:, state.index] = np.interp(
                time_s, times_s, [0.9 * target, 2.0 * target, target, last]
            )
    return history("baseline", baseline), history("aided", aided)


def test_papers_improvements_follow_from_its_standard_deviations(
    printed: Any, papers_histories: tuple[History, History]
) -> None:
    rows = improvement_table("straight", papers_histories)
    table = frame(rows)
    for state in NINE:
        found = row(table, state.id)
        published_pct = np.nan_to_num(printed.loc[state.id, "improvement_pct"])
        assert found["improvement_pct"] == pytest.approx(published_pct, abs=0.005), state.id
        assert found["status"] == ("improved" if published_pct else "same")
    assert mean_over_nine(rows, "aided") == pytest.approx(168.88 / 9.0, abs=0.002)


def test_papers_convergence_follows_from_its_times(
    printed: Any, papers_histories: tuple[History, History]
) -> None:
    rows = convergence_table("straight", papers_histories, {})
    table = frame(rows)
    for state in NINE:
        found, line = row(table, state.id), printed.loc[state.id]
        assert found["target_sd"] == pytest.approx(line["baseline_sd"], rel=1e-12)
        assert found["reached_s"] == pytest.approx(line["reached_s"], abs=1e-6, nan_ok=True)
        assert found["improvement_pct"] == pytest.approx(
            line["convergence_improvement_pct"], abs=0.01, nan_ok=True
        )
    assert row(table, "phi_d")["status"] == "never"
    assert mean_over_nine(rows, "aided") == pytest.approx(510.62 / 9.0, abs=0.005)
