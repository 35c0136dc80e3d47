"""Rows of evidence on one dive: values and ratio of the same runs, how far the candidate acts, and no word."""

from collections.abc import Mapping

import numpy as np
import pytest

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.tables import ConsistencyRow, EvidenceRow
from insdvl_replay.core.words import ConvergenceStatus, Role
from insdvl_replay.evaluation.convergence import MeasuredConvergence
from insdvl_replay.evaluation.evidence import ErrorSeries, Measured, Pair, evidence_table

TIMES = 300
CONVERGED = MeasuredConvergence(0.01, 100.0, 80.0, ConvergenceStatus.REACHED)


def errors(rng: np.random.Generator, columns: int = 1, times: int = TIMES) -> Floats:
    return np.asarray(rng.standard_normal((times, columns)))


def pair_of(
    quantity: str, before: Floats, after: Floats, noise: float = 0.0, from_s: float = 0.0
) -> Pair:
    """Return both filters in one quantity."""
    first, second = (ErrorSeries("m", values, noise, from_s) for values in (before, after))
    return {quantity: first}, {quantity: second}


def rows_of(measured: Measured, nis: tuple[ConsistencyRow, ...] = ()) -> dict[str, EvidenceRow]:
    """Return the rows on one candidate by quantity."""
    return {
        row.quantity: row
        for row in evidence_table("dive", "baseline", ["aided"], measured, nis, ())
    }


def merged(*pairs: Pair) -> dict[str, Pair]:
    before: dict[str, ErrorSeries] = {}
    after: dict[str, ErrorSeries] = {}
    for one, other in pairs:
        before |= one
        after |= other
    return {"aided": (before, after)}


# --- Values, ratio, moves and acts.


def test_values_and_ratio_are_of_the_same_runs() -> None:
    rng = np.random.default_rng(1)
    before, after = errors(rng, 2), 0.5 * errors(rng, 2)
    row = rows_of(Measured(merged(pair_of("drift_60s", before, after))))["drift_60s"]
    assert (row.log, row.filter, row.evidence, row.unit) == ("dive", "aided", "accuracy", "m")
    assert row.baseline == pytest.approx(np.sqrt(np.mean(np.sum(before**2, axis=1))))
    assert row.value == pytest.approx(np.sqrt(np.mean(np.sum(after**2, axis=1))))
    assert row.ratio == pytest.approx(row.value / row.baseline)
    assert row.moves == pytest.approx(np.sqrt(np.mean(np.sum((after - before) ** 2, axis=1))))
    assert row.acts == pytest.approx(row.moves / row.baseline)
    assert (row.samples, row.starts, row.from_s) == (TIMES, 1, None)


def test_drawn_starts_change_no_row_but_those_of_convergence() -> None:
    rng = np.random.default_rng(2)
    accuracy = merged(pair_of("level", errors(rng), errors(rng)))
    alone = rows_of(Measured(accuracy))
    drawn = rows_of(Measured(accuracy, convergence={"aided": {"level": CONVERGED}}, drawn=15))
    assert drawn["level"] == alone["level"]
    assert [name for name in drawn if name not in alone] == ["convergence_level"]


def test_time_of_settling_and_noise_of_the_reference_are_told() -> None:
    row = rows_of(
        Measured(merged(pair_of("level", np.full((9, 1), 2.0), np.full((9, 1), 3.0), 1.0, 124.0)))
    )["level"]
    assert (row.from_s, row.reference_noise) == (124.0, pytest.approx(0.25))
    assert row.acts == pytest.approx(1.0 / np.sqrt(3.0)), "of the error without the noise"


def test_a_copy_has_no_effect_in_any_row() -> None:
    rng = np.random.default_rng(3)
    same = {name: errors(rng) for name in ("drift_60s", "level", "heading", "velocity_along")}
    accuracy = merged(*(pair_of(name, one, one.copy(), noise=0.9) for name, one in same.items()))
    track = merged(pair_of("position", errors(rng, 2), errors(rng, 2)))
    track["aided"] = (track["aided"][0], track["aided"][0])
    found = rows_of(Measured(accuracy, track=track))
    assert len(found) == 5
    assert {(row.ratio, row.moves, row.acts) for row in found.values()} == {(1.0, 0.0, 0.0)}


def test_baseline_without_an_error_has_no_ratio() -> None:
    row = rows_of(Measured(merged(pair_of("drift_60s", np.zeros((9, 2)), np.ones((9, 2))))))[
        "drift_60s"
    ]
    assert np.isnan([row.ratio, row.acts]).all()


@pytest.mark.filterwarnings("error")
def test_filter_that_runs_away_is_compared_without_a_warning() -> None:
    before = errors(np.random.default_rng(4), 2)
    row = rows_of(Measured(merged(pair_of("drift_60s", before, 1e200 * before))))["drift_60s"]
    assert row.ratio == np.inf


def test_what_a_filter_broke_down_too_early_for_is_no_evidence() -> None:
    """It has no drift over 30 s, as one has that fixes of another continent throw off in the first."""
    lost = {"velocity_along": ErrorSeries("m/s", np.ones((50, 1)))}
    whole = lost | {"drift_30s": ErrorSeries("m", np.ones((50, 2)))}
    assert [*rows_of(Measured({"aided": (whole, lost)}))] == ["velocity_along"]
    blind = whole | {"drift_30s": ErrorSeries("m", np.full((50, 2), np.nan))}
    assert [*rows_of(Measured({"aided": (whole, blind)}))] == ["velocity_along"]


# --- What each row may do.


def roles(measured: Measured) -> Mapping[str, str]:
    return {name: row.role for name, row in rows_of(measured).items()}


@pytest.mark.parametrize(("independent", "role"), [(True, Role.PRIMARY), (False, Role.SHOWN)])
def test_position_may_decide_by_an_independent_reference_alone(
    independent: bool, role: str
) -> None:
    rng = np.random.default_rng(5)
    track = merged(
        pair_of("position", errors(rng, 2), errors(rng, 2)),
        pair_of("depth", errors(rng), errors(rng)),
    )
    found = roles(Measured(track=track, independent=independent))
    assert found == {"position": role, "depth": Role.SHOWN}


@pytest.mark.parametrize(("windows", "role"), [(1, Role.SECONDARY), (2, Role.PRIMARY)])
def test_outage_may_decide_from_two_windows_on(windows: int, role: str) -> None:
    rng = np.random.default_rng(6)
    outage = merged(
        pair_of("outage_30s", errors(rng, 2, 5), errors(rng, 2, 5)),
        pair_of("outage_60s", errors(rng, 2, windows), errors(rng, 2, windows)),
        pair_of("outage_120s", errors(rng, 2, 5), errors(rng, 2, 5)),
    )
    assert roles(Measured(outage=outage)) == {
        "outage_30s": "primary",
        "outage_60s": role,
        "outage_120s": "shown",
    }


def test_of_the_errors_in_time_one_of_a_kind_may_warn() -> None:
    rng = np.random.default_rng(7)
    names = (
        "drift_30s", "drift_60s", "drift_100m", "velocity_along", "velocity_across", "depth_60s", "level", "heading",
    )  # fmt: skip
    found = roles(Measured(merged(*(pair_of(name, errors(rng), errors(rng)) for name in names))))
    warning = {name for name, role in found.items() if role == Role.SECONDARY}
    assert warning == {"drift_60s", "velocity_along", "velocity_across", "level", "heading"}
    assert {found[name] for name in found if name not in warning} == {Role.SHOWN}


def test_rows_of_the_track_are_in_their_order_with_the_ends() -> None:
    rng = np.random.default_rng(8)
    track = merged(
        pair_of("depth", errors(rng), errors(rng)),
        pair_of("position", errors(rng, 2), errors(rng, 2)),
    )
    ends = {
        "aided": {
            "position": (9.0, 9.0),
            "position_end": (2.0, 1.0),
            "position_end_pct": (0.0, 0.1),
        }
    }
    found = rows_of(Measured(track=track, ends=ends))
    assert [*found] == ["position", "position_end", "position_end_pct", "depth"]
    end = found["position_end"]
    assert (end.baseline, end.value, end.ratio, end.samples, end.acts) == (2.0, 1.0, 0.5, 1, None)
    assert np.isnan(found["position_end_pct"].ratio)
    assert found["position"].baseline != 9.0, "the track itself, where it is known"


# --- Outages, convergence and consistency.


def test_outage_is_compared_window_by_window_with_directions() -> None:
    north = np.array([[0.3, 0.0], [0.5, 0.0], [0.2, 0.0]])
    east = north[:, ::-1]
    row = rows_of(Measured(outage=merged(pair_of("outage_30s", north, east))))["outage_30s"]
    assert (row.evidence, row.unit, row.samples) == ("outage", "m", 3)
    assert row.ratio == pytest.approx(1.0)
    assert row.acts == pytest.approx(np.sqrt(2.0)), (
        "drifts of one size in two directions are not the same"
    )


def test_convergence_has_the_times_and_their_ratio() -> None:
    converged = {"velocity_h": CONVERGED._replace(candidate_s=np.nan), "level": CONVERGED}
    found = rows_of(Measured(convergence={"aided": converged}, drawn=15))
    assert [*found] == ["convergence_velocity", "convergence_level"]
    row = found["convergence_level"]
    assert (row.evidence, row.unit, row.role) == ("convergence", "s", "settling")
    assert (row.baseline, row.value, row.ratio) == (100.0, 80.0, pytest.approx(0.8))
    assert (row.starts, row.acts) == (15, None)
    assert np.isnan(found["convergence_velocity"].ratio), "it never settled"


def nis(filter_: str, mean: float, verdict: str) -> ConsistencyRow:
    return ConsistencyRow("dive", filter_, "velocity", 3, 99, 0, 3.0 * mean, 2.9, 3.1, verdict)


@pytest.mark.parametrize(
    ("before", "after", "ratio"), [(10.0, 2.0, 0.2), (0.1, 2.0, 0.2), (1.0, 4.0, 4.0)]
)
def test_consistency_compares_distances_from_one_and_decides_nothing(
    before: float, after: float, ratio: float
) -> None:
    row = rows_of(
        Measured(),
        (nis("baseline", before, "overconfident"), nis("aided", after, "overconfident")),
    )["nis"]
    assert (row.evidence, row.role) == ("consistency", "shown")
    assert (row.baseline, row.value) == pytest.approx((before, after))
    assert row.ratio == pytest.approx(ratio)
