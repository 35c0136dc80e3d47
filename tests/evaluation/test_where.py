"""Where a candidate helped: bins of windows by what the vehicle does, and which of them are notable."""

import math

import numpy as np
import pytest
from made_histories import history
from msgspec.structs import replace as changed

from insdvl_replay.core.dive_columns import DvlColumns, Floats, ReferenceColumns
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import BINS
from insdvl_replay.core.tables import WhereRow
from insdvl_replay.evaluation.drift import time_segments
from insdvl_replay.evaluation.interval import log_ratio_interval
from insdvl_replay.evaluation.sentences import where_line
from insdvl_replay.evaluation.where import (
    FEWEST_WINDOWS,
    motion_of,
    notable,
    pooled_where,
    where_between,
    where_table,
    windows_by_bin,
)
from insdvl_replay.geometry.rotation import mat_from_rpy

SECOND = 1_000_000_000
TIME_S = np.arange(1.0, 601.0)
TIME_NS = (TIME_S * SECOND).astype(np.int64)
ARM_M = 0.2
WALK_MPS = 0.002
RATE = np.deg2rad(9.0)
TURN_S = 20.0  # half a turn


def heading_rad(time_s: Floats) -> Floats:
    """Legs of 100 s with turns of 20 s by 180 deg between them."""
    within_s = np.clip(np.mod(time_s, 120.0) - 100.0, 0.0, TURN_S)
    return np.asarray(RATE * (np.floor(time_s / 120.0) * TURN_S + within_s))


def reference_of(
    heading: Floats, speed_mps: Floats | float = 1.0, down_mps: float = 0.0
) -> ReferenceColumns:
    k = len(heading)
    speeds = np.broadcast_to(speed_mps, (k,))
    velocity_n = np.stack(
        [speeds * np.cos(heading), speeds * np.sin(heading), np.full(k, down_mps)], axis=1
    )
    rpy = np.stack([np.zeros(k), np.zeros(k), heading], axis=1)
    return ReferenceColumns(TIME_NS[:k], np.zeros((k, 3)), velocity_n, mat_from_rpy(rpy))


TURNING = reference_of(heading_rad(TIME_S))
PINGS = DvlColumns(TIME_NS, velocity_d=np.ones((len(TIME_NS), 3)))


def filters(reference: ReferenceColumns) -> list[History]:
    """Baseline and candidate, whose own motion is that of the reference."""
    found = []
    for name in ("baseline", "aided"):
        own = history(name, np.ones(3))
        object.__setattr__(own, "time_ns", reference.time_ns)
        object.__setattr__(own, "velocity_n", reference.velocity_n)
        object.__setattr__(own, "mat_nb", reference.mat_nb)
        found.append(own)
    return found


def walked_m(time_s: Floats) -> Floats:
    """The position error of a filter whose velocity is off by 2 mm/s to the north, (k, 2)."""
    return np.stack([WALK_MPS * time_s, np.zeros_like(time_s)], axis=1)


def of_wrong_arm_m(time_s: Floats) -> Floats:
    """What a lever arm that is wrong by 0.2 m forward adds: the integral of w x l is the turned arm."""
    psi = heading_rad(time_s)
    return ARM_M * np.stack([np.cos(psi), np.sin(psi)], axis=1)


def drifts_of(error_m: Floats) -> Floats:
    segments = time_segments(TIME_NS, 30.0)
    return np.asarray(error_m[segments.last] - error_m[segments.first])


def table(
    reference: ReferenceColumns, drifts: dict[str, Floats], dvl: DvlColumns = PINGS
) -> dict[tuple[str, str], WhereRow]:
    rows = where_table("dive", filters(reference), drifts, TIME_NS, reference, dvl)
    return {(row.filter, row.bin): row for row in rows}


def bins_of(reference: ReferenceColumns, dvl: DvlColumns = PINGS) -> dict[str, set[float]]:
    """Return the starts of the windows in each bin, s."""
    segments = time_segments(TIME_NS, 30.0)
    motion = motion_of(TIME_NS, reference, filters(reference)[0])
    found = windows_by_bin(motion, dvl, segments)
    starts = TIME_S[segments.first]
    return {name: {*starts[inside & found.known[name]]} for name, inside in found.inside.items()}


# --- The bins.


def test_a_wrong_lever_arm_is_in_the_turns_as_the_turned_arm_says() -> None:
    before = drifts_of(walked_m(TIME_S))
    after = drifts_of(walked_m(TIME_S) + of_wrong_arm_m(TIME_S))
    rows = table(TURNING, {"baseline": before, "aided": after})

    # Window by window, in closed form.
    squares: dict[str, list[float]] = {"straight": [], "turns": [], "neither": []}
    for start_s in np.arange(1.0, 571.0, 5.0):
        end_s = start_s + 30.0
        first = heading_rad(np.array([start_s]))[0]
        last = heading_rad(np.array([end_s]))[0]
        north = WALK_MPS * 30.0 + ARM_M * (math.cos(last) - math.cos(first))
        east = ARM_M * (math.sin(last) - math.sin(first))
        name = "neither"
        if np.rad2deg(last - first) <= 15.0:
            name = "straight"
        elif np.rad2deg(last - first) >= 45.0:
            name = "turns"
        squares[name].append(north**2 + east**2)
    assert squares["neither"], "some windows are in no bin"
    walk_m = WALK_MPS * 30.0
    for name in ("straight", "turns"):
        own = np.sqrt(np.mean(squares[name]))
        others = [one for other in squares if other != name for one in squares[other]]
        rest = np.sqrt(np.mean(others))
        row = rows["aided", name]
        assert row.windows == len(squares[name])
        np.testing.assert_allclose(
            [row.baseline, row.value, row.rest_value, row.ratio, row.to_rest],
            [walk_m, own, rest, own / walk_m, own / rest],
            rtol=1e-9,
        )
    assert rows["aided", "turns"].ratio > 3.0
    assert rows["aided", "straight"].ratio == pytest.approx(1.0, abs=0.02)
    assert {name for _, name in rows} == {"straight", "turns"}
    assert rows["baseline", "turns"].ratio is None
    assert rows["baseline", "turns"].value == pytest.approx(walk_m)


def test_bins_are_by_what_the_vehicle_does_in_30_s() -> None:
    heading = np.zeros(600)
    speed = np.full(600, 1.0)
    speed[200:300] = 0.05
    speed[300:400] = 1.5
    speed[400:500] = 0.7
    found = bins_of(reference_of(heading, speed))
    assert {206.0, 266.0} <= found["hover"]
    assert not {171.0, 301.0} & found["hover"], "its mean speed is more than 0.1 m/s"
    assert {301.0, 366.0} <= found["fast"]
    assert {401.0, 466.0} <= found["slow"]
    assert not found["slow"] & found["hover"]
    assert not (found["turns"] | found["climbs"] | found["no_bottom_lock"] | found["near_bottom"])
    assert found["straight"].isdisjoint(found["hover"])

    sinking = bins_of(reference_of(heading, 1.0, down_mps=0.2))
    rising = bins_of(reference_of(heading, 1.0, down_mps=-0.2))
    assert len(sinking["climbs"]) == len(rising["climbs"]) == 114
    assert not sinking["fast"] | sinking["slow"], "at one speed nothing is fast or slow"


def test_yaw_in_waves_is_no_turn() -> None:
    waves = np.deg2rad(6.0) * np.sin(2.0 * np.pi * TIME_S / 11.0)
    found = bins_of(reference_of(waves))
    assert not found["turns"]
    assert len(found["straight"]) == 114


def test_a_turn_through_north_is_as_large_as_any_other() -> None:
    ahead = bins_of(reference_of(heading_rad(TIME_S) + np.deg2rad(170.0)))
    assert ahead["turns"] == bins_of(TURNING)["turns"]


@pytest.mark.parametrize("by_beams", [False, True])
def test_a_window_without_velocities_for_10_s_has_no_bottom_lock(by_beams: bool) -> None:
    lost = (TIME_S > 100.0) & (TIME_S <= 112.0)
    if by_beams:
        beams = np.ones((600, 4))
        beams[lost, :2] = np.nan
        dvl = DvlColumns(TIME_NS, beam_velocity_mps=beams)
    else:
        dvl = DvlColumns(TIME_NS[~lost], velocity_d=np.ones((588, 3)))
    found = bins_of(TURNING, dvl)["no_bottom_lock"]
    # The pause is from 100 to 113 s; a window has to hold 10 s of it.
    assert found == {start for start in np.arange(1.0, 571.0, 5.0) if 80.0 <= start <= 103.0}
    nothing = DvlColumns(TIME_NS[:0], velocity_d=np.empty((0, 3)))
    assert len(bins_of(TURNING, nothing)["no_bottom_lock"]) == 114


def test_the_altitude_is_that_of_the_pings_and_may_be_missing() -> None:
    altitude_m = np.full(600, 8.0)
    altitude_m[300:] = 2.0
    altitude_m[100:200] = np.nan
    dvl = DvlColumns(TIME_NS, velocity_d=np.ones((600, 3)), altitude_m=altitude_m)
    segments = time_segments(TIME_NS, 30.0)
    motion = motion_of(TIME_NS, TURNING, filters(TURNING)[0])
    found = windows_by_bin(motion, dvl, segments)
    starts = TIME_S[segments.first]
    assert {*starts[found.inside["near_bottom"]]} == {*np.arange(296.0, 571.0, 5.0)}
    unknown = {*starts[~found.known["near_bottom"]]}
    assert unknown == {*np.arange(101.0, 171.0, 5.0)}

    drift_m = drifts_of(walked_m(TIME_S))
    drifts = {"baseline": drift_m, "aided": 2.0 * drift_m}
    row = table(TURNING, drifts, dvl)["aided", "near_bottom"]
    assert (row.ratio, row.to_rest, row.windows) == (2.0, 1.0, 55)
    assert ("aided", "near_bottom") not in table(TURNING, drifts)


def test_the_baseline_gives_the_motion_that_the_reference_lacks() -> None:
    without = ReferenceColumns(
        TIME_NS, TURNING.position, np.full((600, 3), np.nan), np.full((600, 3, 3), np.nan)
    )
    motion = motion_of(TIME_NS, without, filters(TURNING)[0])
    expected = motion_of(TIME_NS, TURNING, filters(TURNING)[0])
    np.testing.assert_array_equal(motion.velocity_n, expected.velocity_n)
    np.testing.assert_array_equal(motion.heading_rad, expected.heading_rad)


def test_a_bin_with_few_windows_has_no_row() -> None:
    drift_m = drifts_of(walked_m(TIME_S))
    for windows in (FEWEST_WINDOWS - 1, FEWEST_WINDOWS):
        altitude_m = np.full(600, 8.0)
        altitude_m[: 5 * windows + 20] = 0.5
        dvl = DvlColumns(TIME_NS, velocity_d=np.ones((600, 3)), altitude_m=altitude_m)
        rows = table(TURNING, {"baseline": drift_m, "aided": drift_m}, dvl)
        assert (("aided", "near_bottom") in rows) == (windows == FEWEST_WINDOWS)


def test_windows_that_a_filter_lacks_count_for_neither() -> None:
    before = drifts_of(walked_m(TIME_S))
    after = 2.0 * before
    after[:40] = np.nan
    before[64:70] = np.nan
    row = table(TURNING, {"baseline": before, "aided": after})["aided", "turns"]
    whole = table(TURNING, {"baseline": after / 2.0, "aided": after})["aided", "turns"]
    assert row.ratio == 2.0
    assert row.windows < whole.windows
    assert not table(TURNING, {"aided": after}), "without the baseline there is nothing to compare"
    assert not table(TURNING, {})


def test_a_dive_without_turns_has_no_row_of_them() -> None:
    straight = reference_of(np.zeros(600), np.where(TIME_S < 300.0, 1.0, 2.0))
    drift_m = drifts_of(walked_m(TIME_S))
    rows = table(straight, {"baseline": drift_m, "aided": drift_m})
    assert {name for _, name in rows} == {"fast", "slow"}


# --- Over dives.


def row(bin_: str, ratio: float, to_rest: float, log: str = "dive", windows: int = 20) -> WhereRow:
    return WhereRow(
        log=log,
        filter="aided",
        bin=bin_,
        unit="m",
        baseline=1.0,
        value=ratio,
        rest_value=ratio / to_rest,
        ratio=ratio,
        to_rest=to_rest,
        windows=windows,
    )


def by_bin(rows: list[WhereRow]) -> dict[str, WhereRow]:
    return {found.bin: found for found in rows}


SPREAD = np.exp([-0.1, 0.04, 0.1, -0.04, 0.02])


def test_intervals_are_those_of_a_verdict_and_shared_by_holm() -> None:
    dives = [
        [row("straight", 1.0 * one, 1.0 / 1.5), row("turns", 1.5 * one, 1.5 * one)]
        for one in SPREAD
    ]
    found = by_bin(pooled_where(dives))
    # The smaller p has half of the error rate, the larger one all of it.
    turns = log_ratio_interval(np.log(1.5 * SPREAD), level=0.975)
    straight = log_ratio_interval(np.log(SPREAD), level=0.95)
    assert (found["turns"].low, found["turns"].high) == (turns.low, turns.high)
    assert (found["straight"].low, found["straight"].high) == (straight.low, straight.high)
    assert found["turns"].ratio == pytest.approx(1.5 * math.exp(0.004))
    assert (found["turns"].dives, found["turns"].windows) == (5, 100)
    assert found["turns"].stands_out
    assert not found["straight"].stands_out, "it is less bad than the rest, and not better"
    p = 2.0 * log_ratio_interval(np.log(1.5 * SPREAD)).p
    assert found["turns"].p_adjusted == pytest.approx(p)
    assert found["straight"].p_adjusted == 0.0
    assert [one.bin for one in pooled_where(dives)] == ["straight", "turns"]


def test_a_candidate_that_is_worse_everywhere_stands_out_nowhere() -> None:
    dives = [
        [row("straight", 1.5 * one, 0.99), row("turns", 1.5 * one, 1.01 * one**0.1)]
        for one in SPREAD
    ]
    found = pooled_where(dives)
    assert all(one.low > 1.05 for one in found)
    assert not notable(found)
    assert where_line(notable(found)) == ""


def test_a_difference_within_the_band_is_none() -> None:
    dives = [[row("turns", 1.04 + 0.0001 * number, 1.04)] for number in range(6)]
    [found] = pooled_where(dives)
    assert found.low > 1.03
    assert not found.stands_out
    assert found.p_adjusted == 1.0


def test_better_in_a_bin_stands_out_too_and_needs_no_hint() -> None:
    dives = [[row("slow", 0.6 * one, 0.6 * one)] for one in SPREAD]
    [found] = notable(pooled_where(dives))
    assert where_line([found]).startswith("better when slow: 0.60 (")
    assert "look at" not in where_line([found])


def test_the_sentence_begins_with_the_surest_bin() -> None:
    dives = [
        [row("turns", 1.5 * one, 1.5 * one), row("slow", 1.4 * one**2, 1.4 * one**2)]
        for one in SPREAD
    ]
    found = notable(pooled_where(dives))
    assert [one.bin for one in found] == ["turns", "slow"]
    line = where_line(found)
    assert line.startswith("worse in turns: 1.51 (1.")
    assert "; look at lever arm and delay. Also worse when slow: 1.4" in line


@pytest.mark.parametrize("bin_", BINS)
def test_each_bin_has_its_words(bin_: str) -> None:
    dives = [[row(bin_, 1.5 * one, 1.5 * one)] for one in SPREAD]
    line = where_line(notable(pooled_where(dives)))
    assert line.startswith("worse ")
    assert "; look at " in line


def test_two_dives_have_no_interval_and_one_has_its_own_numbers() -> None:
    two = pooled_where([[row("turns", 3.0, 3.0)], [row("turns", 3.0, 3.0)]])
    assert (two[0].ratio, two[0].low, two[0].p_adjusted) == pytest.approx(
        (3.0, math.nan, math.nan), nan_ok=True
    )
    assert not two[0].stands_out
    assert pooled_where([]) == []
    assert pooled_where([[], []]) == []
    unknown = changed(row("turns", 3.0, 3.0), ratio=None)
    assert pooled_where([[unknown]] * 3) == []


def test_vehicles_and_candidates_widen_as_they_do_for_a_verdict() -> None:
    logs = [0.3, 0.32, 0.34, 0.5, 0.52, 0.2]
    dives = [[row("turns", math.exp(one), math.exp(one))] for one in logs]
    vehicles = ["a", "a", "a", "b", "b", "c"]
    [found] = pooled_where(dives, vehicles=vehicles, level=0.975)
    expected = log_ratio_interval(logs, vehicles=vehicles, level=0.975)
    assert (found.low, found.high) == (expected.low, expected.high)
    # p is to be compared with 0.05, however many candidates share that.
    assert found.p_adjusted == pytest.approx(min(1.0, 2.0 * 2.0 * expected.p))


def test_p_below_one_twentieth_is_an_interval_beyond_the_band() -> None:
    rng = np.random.default_rng(5)
    seen = 0
    for _ in range(200):
        shift = rng.uniform(0.0, 0.6)
        dives = []
        for _ in range(5):
            ratios = np.exp(shift + rng.normal(0.0, 0.15, 3))
            bins = ("straight", "turns", "slow")
            dives.append([row(bin_, 1.0, one) for bin_, one in zip(bins, ratios, strict=True)])
        for found in pooled_where(dives):
            beyond = found.to_rest_low > 1.05 or found.to_rest_high < 1.0 / 1.05
            assert beyond == (found.p_adjusted < 0.05)
            seen += beyond
    assert seen > 50


@pytest.mark.parametrize("scatter", [0.1, 0.5])
def test_of_equal_pairs_that_differ_from_dive_to_dive_nothing_stands_out(scatter: float) -> None:
    rng = np.random.default_rng(17)
    archives = 200
    wrong = 0
    for _ in range(archives):
        dives = []
        for _ in range(6):
            whole = rng.normal(0.0, scatter)
            bins = rng.normal(0.0, 0.15, 4)
            rows = []
            for name, own in zip(("straight", "turns", "hover", "climbs"), bins, strict=True):
                rows.append(row(name, math.exp(whole + own), math.exp(own)))
            dives.append(rows)
        wrong += bool(notable(pooled_where(dives)))
    assert wrong <= 0.05 * archives


def test_new_over_old_is_of_the_same_windows() -> None:
    old = changed(row("turns", 1.0, 1.0), value=0.2, rest_value=0.1)
    new = changed(row("turns", 1.0, 1.0), value=0.3, rest_value=0.1)
    found = where_between(old, new)
    assert found is not None
    assert (found.baseline, found.value) == (0.2, 0.3)
    assert (found.ratio, found.to_rest) == pytest.approx((1.5, 1.5))
    assert where_between(changed(old, windows=19), new) is None


def test_a_diverged_filter_has_no_ratio() -> None:
    before = drifts_of(walked_m(TIME_S))
    rows = table(TURNING, {"baseline": before, "aided": np.full_like(before, np.inf)})
    assert all(not math.isfinite(one.ratio or math.nan) for one in rows.values())
    assert pooled_where([[*rows.values()]] * 3) == []
