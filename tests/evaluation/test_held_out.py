"""Evidence by sensors that were withheld, in worlds in which it is known how far each filter drifts."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.quantities import DECIDERS, PRIMARIES, SECONDARIES
from insdvl_replay.core.states import STATES, states_with
from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.evaluation.consistency import consistency_table
from insdvl_replay.evaluation.evidence import (
    Measured,
    evidence_table,
    held_out_errors,
    held_out_track,
)

AXES = {"depth": (), "heading": (), "position": ("n", "e")}
FIXES_S = 3600


def history(name: str, sensor: str, apart: Floats, *, is_held_out: bool = True) -> History:
    """A filter that met a sensor once a second."""
    k, size = apart.shape
    time_ns = np.arange(k, dtype=np.int64) * 1_000_000_000
    none, gate = np.zeros(k, np.bool_), -1.0 if is_held_out else np.inf
    met = Innovations(
        f"held_out_{sensor}" if is_held_out else sensor, "m", AXES[sensor], time_ns, time_ns, apart, apart,
        np.ones((k, size)), np.ones(k), ~none if not is_held_out else none, np.zeros(k), gate, 0, none,
    )  # fmt: skip
    nothing = np.empty((0, 3))
    return History(
        name, time_ns[:0], none[:0], nothing, nothing, np.empty((0, 3, 3)), nothing, nothing, np.empty((0, 12)),
        time_ns[:0], np.empty((0, 12, 12)), (met,), states_with(("position",)),
    )  # fmt: skip


def walk(rng: np.random.Generator, step_m: float, size: int) -> Floats:
    return np.asarray(np.cumsum(step_m * rng.standard_normal((FIXES_S, size)), axis=0))


def row_of(sensor: str, baseline: Floats, candidate: Floats, noise_sd: float) -> EvidenceRow:
    pair = history("baseline", sensor, baseline), history("aided", sensor, candidate)
    before, after = (held_out_errors(met_by, {sensor: np.full(3, noise_sd)}) for met_by in pair)
    (row,) = evidence_table(
        "dive", "baseline", ["aided"], Measured(held_out={"aided": (before, after)}), (), ()
    )
    return row


def row_of_world(sensor: str, ratio: float, noise_sd: float, seed: int) -> EvidenceRow:
    """Drift half alike and half of one's own; the sensor's noise is in both."""
    rng, size = np.random.default_rng(seed), max(1, len(AXES[sensor]))
    alike, own, other = (walk(rng, 0.1 * np.sqrt(0.5), size) for _ in range(3))
    noise = noise_sd * rng.standard_normal((FIXES_S, size))
    return row_of(sensor, alike + own + noise, ratio * (alike + other) + noise, noise_sd)


@pytest.mark.parametrize("sensor", ["position", "depth"])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_ratio_of_the_drift_is_found(sensor: str, ratio: float) -> None:
    """Sixty minutes give the ratio to about a tenth; both drifts are half alike."""
    rows = [row_of_world(sensor, ratio, 0.05, seed) for seed in range(30)]
    assert np.exp(np.mean([np.log(row.ratio or np.nan) for row in rows])) == pytest.approx(
        ratio, rel=0.07
    )
    # The mean square of the difference of r (a + o) and a + w, where all three have a half each.
    acts = np.sqrt(0.5 * (ratio - 1.0) ** 2 + 0.5 * ratio**2 + 0.5)
    assert np.mean([row.acts or np.nan for row in rows]) == pytest.approx(acts, rel=0.1)


def test_noise_of_the_sensor_is_told_and_is_that_of_averaged_readings() -> None:
    """A walk of 0.1 m a second moves sqrt(60) 0.1 m a minute and axis; readings of 3 m are averaged over 5 s."""
    shares = [
        row_of_world("position", 0.9, 3.0, seed).reference_noise or np.nan for seed in range(30)
    ]
    noise, drift = 2.0 * 2.0 * 3.0**2 / 5.0, 2.0 * 60.0 * 0.01
    assert np.mean(shares) == pytest.approx(noise / (noise + drift), rel=0.1)


def test_rms_is_that_of_the_change_over_a_minute() -> None:
    """One drifts by a metre a minute north and the other by two east; a sawtooth of the noise is averaged away."""
    time_s, saw = np.arange(600.0), np.where(np.arange(600) % 2, 1.0, -1.0)
    north, east = (
        np.stack([time_s / 60.0, 0.0 * saw], axis=1),
        np.stack([0.0 * saw, time_s / 30.0], axis=1),
    )
    row = row_of("position", north + saw[:, None], east + saw[:, None], 0.1)
    assert (row.baseline, row.value) == (
        pytest.approx(1.0, abs=0.06),
        pytest.approx(2.0, abs=0.06),
    )
    assert (row.evidence, row.quantity, row.unit, row.starts) == (
        "held_out",
        "held_out_position",
        "m",
        1,
    )


def test_a_heading_is_taken_as_it_is_in_degrees() -> None:
    off = np.full((100, 1), np.deg2rad(3.0))
    row = row_of("heading", off, 2.0 * off, np.deg2rad(0.1))
    assert (row.baseline, row.value, row.unit) == (pytest.approx(3.0), pytest.approx(6.0), "deg")
    assert row.role == "secondary"


def whole(apart: Floats) -> History:
    """A filter that ran as long as it met fixes."""
    met = history("aided", "position", apart)
    return replace(met, time_ns=met.innovations[0].time_ns[[0, -1]])


def test_fixes_that_cover_the_dive_give_the_error_of_the_track() -> None:
    apart = np.tile([3.0, 4.0], (600, 1))
    track = held_out_track(whole(apart), {"position": np.full(3, 0.5)})
    assert [*track] == ["position"]
    np.testing.assert_allclose(track["position"].errors, np.tile([3.0, 4.0], (120, 1)))
    assert track["position"].noise == pytest.approx(np.sqrt(2.0 / 5.0) * 0.5), (
        "two axes, five readings each"
    )


def test_fixes_of_half_of_the_dive_give_no_track() -> None:
    met = whole(np.ones((600, 2)))
    (innovations,) = met.innovations
    missing = innovations.innovation.copy()
    missing[300:] = np.nan
    half = replace(met, innovations=(replace(innovations, innovation=missing),))
    assert held_out_track(half, {"position": np.full(3, 0.5)}) == {}


def test_a_depth_can_not_warn_and_what_was_used_is_no_evidence() -> None:
    may_warn = {name for kind in SECONDARIES.values() for name in kind}
    assert "held_out_position" in may_warn
    assert "held_out_depth" not in {*may_warn, *PRIMARIES}
    assert "held_out_depth" in DECIDERS, "settings may name it"
    aided = history("aided", "depth", np.ones((9, 1)), is_held_out=False)
    assert not held_out_errors(aided, {"depth": np.array([0.1])})


def consistency_of(sd: float, correlation_s: float, seed: int) -> tuple[str, str]:
    """Words on a filter whose differences from fixes have ``sd`` of its own standard deviations, and stay a while."""
    rng, share = np.random.default_rng(seed), np.exp(-1.0 / correlation_s)
    noise = np.sqrt(1.0 - share**2) * rng.standard_normal((FIXES_S, 2))
    start = np.concatenate([rng.standard_normal((1, 2)), noise[1:]])
    apart = sd * lfilter([1.0], [1.0, -share], start, axis=0)
    met = history("baseline", "position", apart)
    (innovations,) = met.innovations
    judged = replace(innovations, nis=(apart**2).sum(axis=1))
    row, *_ = consistency_table(
        "dive", (replace(met, innovations=(judged,)),), {"position": np.zeros(2) + 0.5}
    )
    return row.verdict, row.whiteness


def test_differences_that_stay_are_few_however_often_they_are_met() -> None:
    """By 3600 fixes as if each told something new, some 90 of 100 filters that are right were said to be wrong."""
    found = Counter(consistency_of(1.0, 60.0, seed) for seed in range(100))
    right = found["consistent", "correlated"] + found["insufficient data", "correlated"]
    assert right >= 85, found
    assert (
        Counter(consistency_of(1.0, 2000.0, seed)[0] for seed in range(100))["insufficient data"]
        >= 60
    )


def test_differences_that_are_too_large_are_found_all_the_same() -> None:
    assert Counter(consistency_of(2.0, 60.0, seed)[0] for seed in range(50))["overconfident"] >= 48


def test_a_filter_without_the_states_that_a_sensor_needs_does_not_tell_how_far_off_it_may_be() -> (
    None
):
    met = history("baseline", "position", np.ones((99, 2)))
    rows = consistency_table("dive", (replace(met, states=STATES),), {})
    assert [(row.verdict, np.isnan(row.mean_nis or 0.0), row.whiteness) for row in rows] == [
        ("not available", True, "correlated")
    ] * 3
    # A gauge of depth has a zero, too.
    assert (
        consistency_table("dive", (history("baseline", "depth", np.ones((99, 1))),), {})[0].verdict
        == "not available"
    )


@pytest.mark.parametrize(("noise", "verdict"), [(1.0, "insufficient data"), (0.5, "conservative")])
def test_an_error_that_stays_and_happens_to_be_small_is_no_over_caution(
    noise: float, verdict: str
) -> None:
    """S is twice the sensor's own variance: the other half is the position at the start, which is off by nothing."""
    apart = noise * np.random.default_rng(3).standard_normal((400, 2))
    met = history("baseline", "position", apart)
    (innovations,) = met.innovations
    sd = np.full((400, 2), np.sqrt(2.0))
    judged = replace(
        met, innovations=(replace(innovations, sd=sd, nis=np.sum((apart / sd) ** 2, axis=1)),)
    )
    rows = consistency_table("dive", (judged,), {"position": np.ones(2)})
    assert {row.verdict for row in rows} == {verdict}
