"""Windows lie where a dive has room for them, and the table says of each filter what it did in them."""

import numpy as np
import pytest
from msgspec.structs import replace

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, TimeNs
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.tables import layout_of
from insdvl_replay.evaluation.outage_test import (
    OutagePlan,
    OutageRow,
    OutageRun,
    OutageRuns,
    distance_along_m,
    outage_alarm,
    outage_curves,
    outage_run,
    outage_test_table,
    plan_outages,
    window_drifts,
    window_ends,
)

START_NS = 1_704_067_200_000_000_000
FIRST_PING_S = 0.3717


def at(*time_s: float) -> TimeNs:
    return START_NS + np.rint(np.array(time_s) * 1e9).astype(np.int64)


def pings(duration_s: float, rate_hz: float = 1.0) -> TimeNs:
    return at(*np.arange(FIRST_PING_S, duration_s, 1.0 / rate_hz))


def plan_of(
    ping_ns: TimeNs, duration_s: float, gaps_s: tuple[tuple[float, float], ...] = ()
) -> OutagePlan:
    def in_gap(from_ns: TimeNs, to_ns: TimeNs) -> np.ndarray:
        touched = [(from_ns < at(end)) & (to_ns > at(start)) for start, end in gaps_s]
        return np.any([np.zeros(len(from_ns), bool), *touched], axis=0)

    return plan_outages(ping_ns, in_gap, START_NS, int(at(duration_s)[0]))


def starts_s(plan: OutagePlan, rows: np.ndarray) -> list[float]:
    return [round(float(start) / NS_PER_S) for start in plan.ping_ns[rows] - START_NS]


# Windows


def test_windows_begin_after_the_burn_in_and_do_not_overlap() -> None:
    plan = plan_of(pings(1000.0), 1000.0)
    assert [windows.window_s for windows in plan.by_length] == [30, 60, 120, 300]
    thirty, sixty, _, three_hundred = plan.by_length
    assert starts_s(plan, thirty.first) == list(range(100, 941, 30))
    assert starts_s(plan, sixty.first) == list(range(100, 911, 60))
    assert starts_s(plan, three_hundred.first) == [100, 400]
    assert starts_s(plan, plan.shown.first) == list(range(100, 911, 30))
    for windows in (*plan.by_length, plan.shown):
        np.testing.assert_array_equal(windows.last - windows.first, windows.window_s)
        assert windows.left_out == 0


@pytest.mark.parametrize("hours", [1.0, 9.0, 24.0])
def test_windows_of_long_dives_are_a_hundred_at_most_and_over_the_whole_dive(hours: float) -> None:
    duration_s = 3600.0 * hours
    plan = plan_of(pings(duration_s), duration_s)
    for windows in (*plan.by_length, plan.shown):
        begun_s = starts_s(plan, windows.first)
        (step_s,) = set(np.diff(begun_s))
        assert step_s % min(windows.window_s, 30) == 0
        assert 51 <= len(begun_s) <= 100 or step_s == windows.window_s
        assert begun_s[-1] > duration_s - step_s - windows.window_s - 2.0
    first, last = plan.runs
    assert np.sum(last - first) < 1.5 * max(duration_s, 7200.0)


@pytest.mark.parametrize(
    ("duration_s", "lengths"),
    [
        (159.0, []),
        (160.0, [30]),
        (219.9, [30]),
        (220.0, [30, 60]),
        (424.0, [30, 60, 120]),
        (700.0, [30, 60, 120, 300]),
    ],
)
def test_dive_needs_room_for_two_windows(duration_s: float, lengths: list[int]) -> None:
    plan = plan_of(pings(duration_s), duration_s)
    assert [windows.window_s for windows in plan.by_length] == lengths


@pytest.mark.parametrize("rate_hz", [0.5, 1.0, 4.7, 23.0])
def test_every_window_is_run_once_as_far_as_the_longest_goes(rate_hz: float) -> None:
    plan = plan_of(pings(2000.0, rate_hz), 2000.0)
    first, last = plan.runs
    assert (np.diff(first) > 0).all()
    for windows in (*plan.by_length, plan.shown):
        run = np.searchsorted(first, windows.first)
        np.testing.assert_array_equal(first[run], windows.first)
        assert (last[run] >= windows.last).all()
    ends = {int(row) for windows in (*plan.by_length, plan.shown) for row in windows.last}
    assert set(last.tolist()) <= ends
    np.testing.assert_array_equal(plan.start_ns, plan.ping_ns[first])
    assert list(plan.windows_ns) == list(zip(plan.ping_ns[first], plan.ping_ns[last], strict=True))


def without(ping_ns: TimeNs, *spans_s: tuple[float, float]) -> TimeNs:
    gone = [(ping_ns >= at(start)) & (ping_ns < at(end)) for start, end in spans_s]
    return ping_ns[~np.any(gone, axis=0)]


def test_windows_with_an_outage_are_left_out_and_counted() -> None:
    plan = plan_of(without(pings(424.0), (110.0, 115.0)), 424.0)
    thirty, sixty, hundred_and_twenty = plan.by_length
    assert (starts_s(plan, thirty.first), thirty.left_out) == (list(range(130, 371, 30)), 1)
    assert (starts_s(plan, sixty.first), sixty.left_out) == ([160, 220, 280, 340], 1)
    assert (starts_s(plan, hundred_and_twenty.first), hundred_and_twenty.left_out) == ([220], 1)


@pytest.mark.parametrize(
    ("outage_s", "left_out"),
    [((97.0, 104.0), 1), ((126.0, 134.0), 2), ((128.0, 140.0), 2), ((391.0, 399.0), 1)],
)
def test_window_whose_end_has_no_ping_near_is_left_out(
    outage_s: tuple[float, float], left_out: int
) -> None:
    thirty, *_ = plan_of(without(pings(424.0), outage_s), 424.0).by_length
    assert (thirty.left_out, len(thirty.first)) == (left_out, 10 - left_out)


def test_single_lost_pings_are_no_outage() -> None:
    plan = plan_of(without(pings(424.0), *((s, s + 1.0) for s in range(110, 400, 7))), 424.0)
    assert [windows.left_out for windows in plan.by_length] == [0, 0, 0]


def test_windows_after_the_last_ping_of_all_are_left_out() -> None:
    thirty, *_ = plan_of(pings(300.0), 424.0).by_length
    assert (starts_s(plan_of(pings(300.0), 424.0), thirty.first), thirty.left_out) == (
        list(range(100, 251, 30)),
        4,
    )


def test_windows_with_a_gap_of_the_imu_are_left_out() -> None:
    thirty, *_ = plan_of(pings(424.0), 424.0, gaps_s=((165.0, 166.0),)).by_length
    assert thirty.left_out == 1


@pytest.mark.parametrize(
    "ping_ns", [at(), at(5.0), pings(400.0, 0.01)], ids=["none", "one", "rare"]
)
def test_pings_that_are_too_few_make_no_windows(ping_ns: TimeNs) -> None:
    plan = plan_of(ping_ns, 400.0)
    assert plan.by_length == ()
    assert list(plan.windows_ns) == []


# Drift


def test_innovations_are_turned_to_north_and_integrated() -> None:
    """Heading east, the filter runs ahead by 1 cm/s more each second: 1/2 a t^2 to the east."""
    east = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    time_ns = at(*np.arange(5.0))
    nothing = np.zeros((5, 3))
    innovation_b = np.column_stack([0.01 * np.arange(1, 5), np.zeros(4), np.zeros(4)])
    no, sd = np.zeros(4, bool), np.ones((4, 3))
    held_out = Innovations("velocity", "m/s", ("x", "y", "z"), time_ns[1:], time_ns[1:], sd, innovation_b, sd,
                           np.arange(4.0), no,
                           np.zeros(4), -1.0, 0, no)  # fmt: skip
    history = History("baseline", time_ns, no, nothing, nothing, np.tile(east, (5, 1, 1)), nothing, nothing,
                      np.ones((5, 12)), time_ns[:0], np.empty((0, 12, 12)), (held_out,))  # fmt: skip
    coast = outage_run(history)
    np.testing.assert_allclose(coast.drift_n[:, 1], 0.005 * np.arange(5.0) ** 2, atol=1e-15)
    np.testing.assert_allclose(coast.drift_n[:, [0, 2]], 0.0, atol=1e-15)
    np.testing.assert_allclose(coast.velocity_error_n[-1], [0.0, 0.04, 0.0], atol=1e-15)
    np.testing.assert_array_equal(coast.nis, [np.nan, 0.0, 1.0, 2.0, 3.0])
    # Minus the logarithm of a normal density of three axes whose covariance has the determinant 1.
    score = 0.5 * np.arange(4.0) + 1.5 * np.log(2.0 * np.pi)
    np.testing.assert_allclose(coast.minus_log_score, [np.nan, *score], rtol=1e-14)


def test_distance_is_that_of_the_dvl() -> None:
    velocity_b = np.tile([1.2, 0.0, 1.6], (11, 1))
    np.testing.assert_allclose(
        distance_along_m(at(*np.arange(0.0, 22.0, 2.0)), velocity_b), 4.0 * np.arange(11)
    )


DURATION_S = 424.0


def coasts_that_drift(**accel_mps2: Floats | float) -> OutageRuns:
    """Filters that accelerate northwards and half as much downwards, in each run by as much as is given."""
    ping_ns = pings(DURATION_S)
    plan = plan_of(ping_ns, DURATION_S)
    first, last = plan.runs

    def run(row: int, accel: float) -> OutageRun:
        time_s = np.arange(last[row] - first[row] + 1.0)
        moved_n = np.outer(time_s, [1.0, 0.0, 0.5])
        drift_n = 0.5 * accel * time_s[:, None] * moved_n
        nis, score = np.full(len(time_s), 6.0), np.full(len(time_s), -4.0)
        return OutageRun(time_s, accel * moved_n, drift_n, nis, score)

    of_filters = {name: np.broadcast_to(accel, len(first)) for name, accel in accel_mps2.items()}
    runs = {
        name: tuple(run(row, a) for row, a in enumerate(accel))
        for name, accel in of_filters.items()
    }
    return OutageRuns(plan, 2.0 * np.arange(len(ping_ns)), runs)


def rows_of(coasts: OutageRuns) -> dict[tuple[str, str], OutageRow]:
    rows = outage_test_table("dive", coasts)
    return {(row.filter, row.window_s): row for row in rows}


def test_rows_say_how_far_a_filter_drifts() -> None:
    rows = rows_of(coasts_that_drift(baseline=0.001, aided=0.0005))
    assert list(rows) == [
        (name, length) for length in ("30", "60", "120") for name in ("baseline", "aided")
    ]
    row = rows["baseline", "60"]
    assert (row.log, row.windows, row.left_out) == ("dive", 5, 0)
    assert [row.drift_median_m, row.drift_rms_m, row.drift_p95_m] == pytest.approx([1.8] * 3)
    assert row.drift_of_distance_pct == pytest.approx(1.5)
    assert row.end_velocity_mps == pytest.approx(0.06)
    assert row.vertical_median_m == pytest.approx(0.9)
    assert row.nis_per_dof == pytest.approx(2.0)
    assert np.isnan([row.ratio_to_baseline, row.windows_won_pct]).all()
    aided = rows["aided", "120"]
    assert (aided.ratio_to_baseline, aided.windows_won_pct) == (pytest.approx(0.5), 100.0)


@pytest.mark.parametrize("dof", [3, 30])
def test_alarm_is_rare_by_chance_and_sure_where_sigma_is_a_third_of_the_error(dof: int) -> None:
    """Of consistent filters NIS per dof is chi-square; with a third of the true noise it is nine times that."""
    rng, row = (
        np.random.default_rng(11),
        rows_of(coasts_that_drift(baseline=0.001))["baseline", "60"],
    )
    nis_per_dof = rng.chisquare(dof, 3000) / dof

    def rate(factor: float) -> float:
        rows = (replace(row, windows=dof // 3, nis_per_dof=factor * size) for size in nis_per_dof)
        return float(np.mean([bool(outage_alarm([one], ["baseline"])) for one in rows]))

    assert rate(1.0) < 0.003
    assert rate(9.0) > (0.99 if dof > 3 else 0.6)


def test_alarm_names_both_filters_and_the_length_that_is_furthest_off() -> None:
    rows = [
        replace(
            row,
            nis_per_dof={"30": 1.1, "60": 8.94, "120": 6.0}[window_s]
            / (1.0 if name == "aided" else 8.0),
        )
        for (name, window_s), row in rows_of(
            coasts_that_drift(baseline=0.001, aided=0.001)
        ).items()
    ]
    said = (
        " NIS / dof after 60 s without DVL: baseline 1.12, aided 8.94, expected 1. Raise [noise]."
    )
    assert outage_alarm(rows, ("baseline", "aided")) == said
    assert not outage_alarm(rows, ("baseline",))
    assert not outage_alarm(
        [replace(row, nis_per_dof=None) for row in rows], ("baseline", "aided")
    )
    unknown = [replace(row, nis_per_dof=None) if row.filter == "baseline" else row for row in rows]
    assert outage_alarm(unknown, ("baseline", "aided")) == said.replace("baseline 1.12, ", "")


def test_alarm_beyond_any_noise_is_geometry_where_innovations_under_way_are_consistent() -> None:
    rows = [
        replace(row, nis_per_dof=17.8)
        for row in rows_of(coasts_that_drift(baseline=0.001)).values()
    ]
    assert "dvl.mounting_rpy_deg" in outage_alarm(rows, ["baseline"], {"baseline": 1.1})
    assert "[noise]" in outage_alarm(rows, ["baseline"], {"baseline": 15.0})


def test_filters_are_paired_by_window() -> None:
    """The baseline drifts the more, the later; the candidate by a constant share of that, save in one window."""
    runs = len(coasts_that_drift(baseline=1.0).runs["baseline"])
    baseline = 1e-3 * np.arange(1.0, runs + 1.0)
    candidate = 0.8 * baseline
    candidate[0] = 2.0 * baseline[0]
    coasts = coasts_that_drift(baseline=baseline, aided=candidate)
    before, after = (
        window_ends(coasts, name, coasts.plan.by_length[0]).drift_m for name in coasts.runs
    )
    assert sorted(after / before) == pytest.approx([0.8] * (len(before) - 1) + [2.0])
    row = rows_of(coasts)["aided", "30"]
    assert row.ratio_to_baseline == pytest.approx(np.sqrt(np.sum(after**2) / np.sum(before**2)))
    assert row.windows_won_pct == pytest.approx(90.0)


def test_drift_in_a_window_has_its_direction() -> None:
    """Filters that drift as far north and south differ by both drifts together, and not by nothing."""
    coasts = coasts_that_drift(baseline=0.001, aided=-0.001)
    north, south = (window_drifts(coasts)[name]["30s"] for name in ("baseline", "aided"))
    assert north.shape == (rows_of(coasts)["baseline", "30"].windows, 2)
    np.testing.assert_allclose(np.linalg.norm(north - south, axis=1), 2.0 * 0.45, rtol=1e-6)


def test_filters_that_drift_alike_draw() -> None:
    assert (
        rows_of(coasts_that_drift(baseline=0.001, same=0.001))["same", "30"].windows_won_pct
        == 50.0
    )


def test_filter_that_is_lost_has_no_numbers_to_compare() -> None:
    rows = rows_of(coasts_that_drift(baseline=0.001, lost=np.nan))
    assert rows["baseline", "30"].drift_median_m == pytest.approx(0.45)
    row = rows["lost", "30"]
    assert np.isnan([row.drift_median_m, row.ratio_to_baseline, row.windows_won_pct]).all()


def test_filter_that_runs_away_is_compared_without_a_warning() -> None:
    row = rows_of(coasts_that_drift(baseline=0.001, far=1e200))["far", "30"]
    assert (row.drift_median_m, row.windows_won_pct) == (pytest.approx(4.5e202), 0.0)


def test_vehicle_at_rest_has_no_per_cent_of_its_way() -> None:
    moving = coasts_that_drift(baseline=0.001)
    row = rows_of(OutageRuns(moving.plan, 0.01 * moving.distance_m, moving.runs))["baseline", "30"]
    assert np.isnan(row.drift_of_distance_pct)
    assert row.drift_median_m == pytest.approx(0.45)


def test_windows_that_were_all_left_out_make_a_row_that_says_so() -> None:
    ping_ns = without(pings(424.0), *((s, s + 4.0) for s in range(110, 400, 30)))
    plan = plan_of(ping_ns, 424.0)
    coasts = OutageRuns(plan, np.arange(float(len(ping_ns))), {"baseline": (), "aided": ()})
    rows = rows_of(coasts)
    assert (rows["aided", "30"].windows, rows["aided", "30"].left_out) == (0, 10)
    assert np.isnan(rows["aided", "30"].drift_median_m)
    assert outage_curves(coasts) == {}


def test_drift_over_time_is_the_middle_and_the_edge_of_all_windows() -> None:
    runs = len(coasts_that_drift(baseline=1.0).runs["baseline"])
    coasts = coasts_that_drift(baseline=1e-3 * np.arange(runs))
    shown = outage_curves(coasts)["baseline"]
    accel = 1e-3 * np.searchsorted(coasts.plan.runs[0], coasts.plan.shown.first)
    np.testing.assert_allclose(shown.time_s, np.arange(61.0))
    np.testing.assert_allclose(
        shown.median_m, 0.5 * np.median(accel) * shown.time_s**2, atol=1e-12
    )
    np.testing.assert_allclose(
        shown.p95_m, 0.5 * np.quantile(accel, 0.95) * shown.time_s**2, atol=1e-12
    )


def test_curves_say_where_in_the_dive_each_window_is() -> None:
    coasts = coasts_that_drift(baseline=0.001, aided=0.0005)
    found = outage_curves(coasts)
    assert starts_s(coasts.plan, coasts.plan.shown.first) == [
        round((ns - START_NS) / 1e9) for ns in found["aided"].begin_ns
    ]
    np.testing.assert_allclose(found["baseline"].drift_m, 1.8)
    np.testing.assert_allclose(found["aided"].drift_m, 0.9)
    np.testing.assert_allclose(found["aided"].p95_m[-1], 0.9)
    short = plan_of(pings(150.0), 150.0)
    assert outage_curves(OutageRuns(short, np.arange(150.0), {"baseline": (), "aided": ()})) == {}


def test_the_row_type_is_a_table() -> None:
    layout = layout_of("outage", OutageRow)
    assert (layout.key, layout.primary) == ("window_s", "drift_median_m")
    assert layout.rows == ("30", "60", "120", "300")
    assert layout.baseline_too
