"""Words on pieces of evidence: tried like a detector, on losses of which it is known which filter is better."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.tables import ConsistencyRow, EvidenceRow
from insdvl_replay.core.words import ConvergenceStatus
from insdvl_replay.evaluation.convergence import MeasuredConvergence
from insdvl_replay.evaluation.evidence import Measured, SquaredErrors, evidence_table
from insdvl_replay.evaluation.series import RatioInterval

TIMES, STARTS = 300, 16
PIECES = ("drift_30s", "drift_60s", "drift_100m", "velocity_along", "velocity_across", "level", "heading")


def errors(rng: np.random.Generator, rho: float = 0.5, starts: int = STARTS) -> Floats:
    """Errors that go on from time to time, of unit variance, shape (starts, times)."""
    drawn = rng.standard_normal((starts, TIMES))
    for k in range(1, TIMES):
        drawn[:, k] = rho * drawn[:, k - 1] + np.sqrt(1.0 - rho**2) * drawn[:, k]
    return drawn


def squared_errors(of_one: Floats, floor: float = 0.0) -> SquaredErrors:
    return SquaredErrors("m", of_one**2, 1, floor)


def evidence(
    accuracy: Mapping[str, tuple[SquaredErrors, SquaredErrors]] | None = None,
    outage: Mapping[str, tuple[Sequence[float], Sequence[float]]] | None = None,
    convergence: Mapping[str, MeasuredConvergence] | None = None,
    nis: tuple[ConsistencyRow, ...] = (),
) -> dict[str, EvidenceRow]:
    """Hold one candidate against the baseline; rows by quantity."""
    before, after = ({name: pair[i] for name, pair in (accuracy or {}).items()} for i in range(2))
    windows = [{name: np.array(pair[i]) for name, pair in (outage or {}).items()} for i in range(2)]
    measured = Measured(
        {"aided": (before, after)},
        {"aided": (windows[0], windows[1])},
        {"aided": convergence or {}},
    )
    return {row.quantity: row for row in evidence_table("dive", "baseline", ["aided"], measured, nis, ())}


def test_gain_and_loss_are_reported_with_their_numbers() -> None:
    rng = np.random.default_rng(1)
    common = errors(rng)
    rows = evidence(
        {
            "drift_30s": (squared_errors(common), squared_errors(0.5 * errors(rng))),
            "velocity_along": (squared_errors(common), squared_errors(2.0 * errors(rng))),
            "level": (squared_errors(common), squared_errors(1.01 * common)),
        }
    )
    assert [(row.quantity, row.verdict) for row in rows.values()] == [
        ("drift_30s", "better"),
        ("velocity_along", "worse"),
        ("level", "equivalent"),
    ]
    first = rows["drift_30s"]
    assert (first.log, first.filter, first.evidence, first.unit) == ("dive", "aided", "accuracy", "m")
    assert (first.starts, first.windows) == (STARTS, TIMES)
    assert first.baseline == pytest.approx(np.sqrt(np.mean(common[0] ** 2))), "that of the dive's own start"
    assert first.ratio == pytest.approx(0.5, rel=0.1), "that of all starts"


def test_values_are_of_this_dive_and_the_ratio_of_drawn_starts() -> None:
    """The dive's own start does not err: its levels are far smaller than those that random starts leave behind."""
    rng = np.random.default_rng(5)
    drawn, own = errors(rng), errors(rng, starts=1)[0]
    before, after = (squared_errors(factor * drawn)._replace(own=(factor * 0.1 * own) ** 2) for factor in (1.0, 0.5))
    row = evidence({"level": (before, after)})["level"]
    assert (row.baseline, row.ratio) == (pytest.approx(0.1 * np.sqrt(np.mean(own**2))), pytest.approx(0.5))
    assert row.starts == STARTS


def test_track_of_one_dive_decides_nothing() -> None:
    track = {"aided": {"position": (2.0, 1.0), "depth": (0.0, 0.1)}}
    rows = evidence_table("dive", "baseline", ["aided"], Measured(track=track), (), ())
    assert [(row.evidence, row.quantity, row.unit, row.verdict) for row in rows] == [
        ("track", "position", "m", "undecided"),
        ("track", "depth", "m", "undecided"),
    ]
    assert (rows[0].baseline, rows[0].value, rows[0].ratio, rows[0].effective_samples) == (2.0, 1.0, 0.5, 1.0)
    assert np.isnan([rows[0].low, rows[1].ratio]).all()


@pytest.mark.parametrize(("floor", "word"), [(0.9, "better"), (1.2, "undecided")])
def test_differences_below_what_the_reference_errs_by_are_none(floor: float, word: str) -> None:
    rng = np.random.default_rng(2)
    assert (
        evidence({"drift_30s": (squared_errors(errors(rng), floor), squared_errors(0.5 * errors(rng), floor))})[
            "drift_30s"
        ].verdict
        == word
    )


def equal_filters(rng: np.random.Generator) -> dict[str, tuple[SquaredErrors, SquaredErrors]]:
    return {quantity: (squared_errors(errors(rng)), squared_errors(errors(rng))) for quantity in PIECES}


@pytest.mark.nightly
def test_of_many_pieces_on_equal_filters_none_is_better_or_worse_by_chance() -> None:
    """Seven pieces a dive, each with independent errors: with words of 5 % each, every third dive would have one."""
    rng = np.random.default_rng(3)
    dives = [evidence(equal_filters(rng)) for _ in range(150)]
    decided = [any(row.verdict in {"better", "worse"} for row in rows.values()) for rows in dives]
    assert np.mean(decided) <= 0.07, "a p of 0.01 each, and the margin"
    assert all(len(rows) == len(PIECES) for rows in dives)


def test_the_number_that_decides_is_printed() -> None:
    rng = np.random.default_rng(4)
    pairs = {quantity: (squared_errors(errors(rng)), squared_errors(share * errors(rng)))
             for quantity, share in zip(PIECES, (0.5, 0.8, 0.9, 0.95, 1.0, 1.1, 1.3), strict=True)}  # fmt: skip
    for row in evidence(pairs).values():
        beyond = not 1.0 / 1.05 < row.ratio < 1.05
        assert (row.verdict in {"better", "worse"}) == (beyond and row.p < 0.01)


def outage(rng: np.random.Generator, share: float) -> tuple[SquaredErrors, SquaredErrors]:
    """Errors of which nearly all are in the last eighth but one of a dive of 80 to 480 s."""
    sizes = np.where((np.arange(TIMES) >= 0.75 * TIMES) & (np.arange(TIMES) < 0.875 * TIMES), 30.0, 1.0)
    before, after = (
        SquaredErrors("m", (sizes * factor * errors(rng)) ** 2, 1, 0.0, span_s=(80.0, 480.0)) for factor in (1.0, share)
    )
    return before, after


def test_one_stretch_decides_nothing_and_is_named() -> None:
    rng = np.random.default_rng(5)
    row = evidence({"drift_30s": outage(rng, 0.5)})["drift_30s"]
    assert row.verdict == "undecided"
    assert re.findall(r"\d+", row.why) == ["380", "430"]
    assert row.effective_samples < 2.5


def test_longer_segments_of_one_stretch_are_one_sample_too() -> None:
    rng = np.random.default_rng(6)
    smeared = squared_errors(errors(rng)), squared_errors(0.5 * errors(rng))
    rows = evidence({"drift_30s": outage(rng, 0.5), "drift_100m": smeared, "level": smeared})
    assert [row.verdict for row in rows.values()] == ["undecided", "undecided", "better"]
    assert "one stretch" in rows["drift_100m"].why


def test_a_copy_is_equivalent_however_noisy_the_reference_is() -> None:
    same = squared_errors(errors(np.random.default_rng(7)), floor=0.9)
    assert evidence({"drift_30s": (same, same)})["drift_30s"].verdict == "equivalent"


def test_outage_is_compared_window_by_window() -> None:
    drifts = [0.3, 0.5, 0.2, 0.4, 0.6, 0.3]
    far_off = [3.1, 5.0, 1.9, 4.1, 6.0, 2.9]
    rows = evidence(
        outage={
            "30s": (drifts, far_off),
            "60s": (drifts[:3], drifts[:3]),
            "120s": ([], []),
        }
    )
    assert list(rows) == ["outage_30s", "outage_60s"]
    far, few = rows.values()
    assert (far.evidence, far.unit, far.starts, far.windows, far.verdict) == ("outage", "m", 1, 6, "worse")
    assert far.ratio == pytest.approx(10.0, rel=0.02)
    assert far.baseline == pytest.approx(np.sqrt(np.mean(np.square(drifts))))
    assert few.verdict == "undecided"


def converged(ratio: float) -> MeasuredConvergence:
    ends = ratio, 0.9 * ratio, 1.1 * ratio, 0.92 * ratio, 1.08 * ratio
    interval = RatioInterval(*ends, 15.0, drawn_p=1.0 if ratio == 1.0 else 0.0)
    return MeasuredConvergence(0.01, 100.0, 100.0 * ratio, ConvergenceStatus.REACHED, interval)


@pytest.mark.parametrize(("ratio", "word"), [(0.5, "better"), (0.85, "undecided"), (1.2, "undecided"), (1.6, "worse")])
def test_convergence_has_to_differ_by_more_than_the_sensors_of_one_dive(ratio: float, word: str) -> None:
    row = evidence(convergence={"level": converged(ratio)})["convergence_level"]
    assert (row.evidence, row.unit, row.verdict, row.starts) == ("convergence", "s", word, 15)


@pytest.mark.parametrize(("high", "word"), [(1.04, "equivalent"), (3.66, "undecided")])
def test_times_that_a_few_starts_may_make_others_are_not_equivalent(high: float, word: str) -> None:
    found = converged(1.0)
    interval = found.interval._replace(low=0.99, high=high, low90=0.99, high90=1.02)
    found = found._replace(interval=interval)
    assert evidence(convergence={"level": found})["convergence_level"].verdict == word


def nis(filter_: str, mean: float, verdict: str) -> ConsistencyRow:
    return ConsistencyRow("dive", filter_, "velocity", 3, 99, 0, 3.0 * mean, 2.9, 3.1, verdict)


@pytest.mark.parametrize(
    ("before", "after", "word"),
    [
        ((10.0, "overconfident"), (1.05, "consistent"), "better"),
        ((1.0, "consistent"), (4.0, "overconfident"), "worse"),
        ((0.1, "conservative"), (0.2, "conservative"), "equivalent"),
        ((0.1, "conservative"), (1.0, "consistent"), "better"),
        ((0.5, "conservative"), (0.5, "conservative"), "equivalent"),
        ((0.1, "conservative"), (2.0, "overconfident"), "worse"),
    ],
)
def test_consistent_is_who_is_nearer_and_not_over_confident_instead(before: Any, after: Any, word: str) -> None:
    row = evidence(nis=(nis("baseline", *before), nis("aided", *after)))["nis"]
    assert (row.evidence, row.verdict) == ("consistency", word)
    assert (row.baseline, row.value) == pytest.approx((before[0], after[0]))


def test_what_a_filter_broke_down_too_early_for_is_no_evidence() -> None:
    """It has no drift over 30 s, as one has that fixes of another continent throw off in the first."""
    lost = {"velocity_along": SquaredErrors("m/s", np.ones((1, 50)), 1, 0.0)}
    whole = lost | {"drift_30s": SquaredErrors("m", np.ones((1, 50)), 1, 0.0)}
    measured = Measured({"aided": (whole, lost)})
    rows = evidence_table("dive", "baseline", ["aided"], measured, (), ())
    assert [row.quantity for row in rows] == ["velocity_along"]
