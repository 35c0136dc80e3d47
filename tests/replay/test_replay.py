"""Whole replays of simulated dives: what comes out, what is counted, and what dives from the sea do to it."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from frames import frame, frames
from numpy.typing import NDArray

from insdvl_replay.core.config import Acceleration, Config, Dvl, Filter, Imu, Initial, Noise, Span
from insdvl_replay.core.dive_columns import (
    Dive,
    DvlColumns,
    Floats,
    ReferenceColumns,
    TimeNs,
    seconds,
)
from insdvl_replay.core.errors import ConfigError, LogError, Note
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.quantities import SETTLED
from insdvl_replay.core.states import STATES
from insdvl_replay.evaluation.consistency import FEWEST_UPDATES, SMALL_EXCESS
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.replay import Replay, replay_dive, replay_log
from insdvl_replay.sim.dive import START_NS, exact_dive, simulate_dive
from insdvl_replay.sim.sensor_errors import LostBeam

SECOND = 1_000_000_000
NOISE = Noise(accel_white_mps_rts=2e-3, gyro_white_rad_rts=2e-6)
VELOCITY = Filter(aiding=("velocity",))
Rows = Callable[[Floats], NDArray[np.bool_]]
"""Chooses rows by their seconds from the start of the dive."""
TABLES = ("improvement", "convergence", "reference_error", "consistency", "credibility", "evidence", "outage",
          "drift", "track_fit", "jumps", "assay", "where")  # fmt: skip


def aided(**settings: object) -> Filter:
    return Filter(aiding=("velocity", "acceleration"), acceleration=Acceleration(**settings))  # type: ignore[arg-type]


AS_SET = Initial(uncertainty="settings")  # the same for dives whose references differ


def config(filters: dict[str, Filter] | None = None, **sections: object) -> Config:
    chosen = filters or {"baseline": VELOCITY, "aided": aided()}
    return Config(noise=NOISE, filters=chosen, **{"initial": AS_SET, **sections})  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def straight() -> Dive:
    return simulate_dive("straight", duration_s=60.0, imu_rate_hz=50.0, seed=3)


@pytest.fixture(scope="module")
def turning() -> Dive:
    """An exact dive through turns at 17 deg/s."""
    return exact_dive("figure-eight", duration_s=130.0, imu_rate_hz=100.0)


def reference_of(dive: Dive) -> ReferenceColumns:
    assert dive.reference is not None
    return dive.reference


def beams_of(dive: Dive) -> Floats:
    assert dive.dvl.beam_velocity_mps is not None
    return dive.dvl.beam_velocity_mps


def since_start_s(time_ns: TimeNs) -> Floats:
    return seconds(time_ns, START_NS)


def with_reference(dive: Dive, keep: Rows) -> Dive:
    reference = reference_of(dive)
    rows = keep(since_start_s(reference.time_ns))
    chosen = ReferenceColumns(
        reference.time_ns[rows],
        reference.position[rows],
        reference.velocity_n[rows],
        reference.mat_nb[rows],
    )
    return replace(dive, reference=chosen)


def with_pings(dive: Dive, keep: Rows) -> Dive:
    rows = keep(since_start_s(dive.dvl.time_ns))
    return replace(
        dive,
        dvl=replace(
            dive.dvl, time_ns=dive.dvl.time_ns[rows], beam_velocity_mps=beams_of(dive)[rows]
        ),
    )


def without(dive: Dive, quantity: str) -> Dive:
    reference = reference_of(dive)
    missing = np.full_like(getattr(reference, quantity), np.nan)
    return replace(dive, reference=replace(reference, **{quantity: missing}))


def note(replay: Replay, code: str) -> Note:
    (found,) = (note for note in replay.notes if note.code == code)
    return found


def innovations_of(history: History, measurement: str) -> Innovations:
    (found,) = (entry for entry in history.innovations if entry.measurement == measurement)
    return found


def errors_of(replay: Replay) -> Any:
    return frame(replay.tables.reference_error).set_index(["filter", "quantity"])


def assert_same(one: Replay, other: Replay) -> None:
    for name in TABLES:
        pd.testing.assert_frame_equal(
            frames(one.tables)[name], frames(other.tables)[name], check_exact=True
        )
    for mine, theirs in zip(one.histories, other.histories, strict=True):
        np.testing.assert_array_equal(mine.position, theirs.position)
        np.testing.assert_array_equal(mine.sd, theirs.sd)


# --- A clean dive.


def test_exact_sensors_follow_the_exact_motion_through_sharp_turns(turning: Dive) -> None:
    replay = replay_dive(turning, config())
    table = errors_of(replay)
    assert table.loc[("aided", "position_h"), "final"] < 1e-3
    assert table.loc[("aided", "velocity_n"), "rmse"] < 2e-5
    assert table.loc[("aided", "heading"), "rmse"] < 1e-3
    assert table.loc["aided", "baseline_rmse"].tolist() == pytest.approx(
        table.loc["aided", "rmse"].tolist(), abs=1e-3
    )


@pytest.mark.parametrize("dvl_rate_hz", [1.0, 7.0])
def test_pings_between_samples_are_met_at_their_own_time(dvl_rate_hz: float) -> None:
    dive = exact_dive("figure-eight", duration_s=130.0, imu_rate_hz=50.0, dvl_rate_hz=dvl_rate_hz)
    filters = {"baseline": VELOCITY, "aided": aided(max_window_gap_s=2.5)}
    replay = replay_dive(dive, config(filters))
    # In the turns the body velocity changes by 0.27 m/s^2: the nearest sample, up to 10 ms off, would be 2 mm/s off.
    worst_mps = np.abs(innovations_of(replay.histories[0], "velocity").innovation).max()
    assert worst_mps < 1e-4
    assert np.abs(innovations_of(replay.histories[1], "acceleration").innovation).max() < 1e-3


def test_lever_arm_and_mounting_are_taken_into_account() -> None:
    mounted = {"lever_arm_m": (-1.2, 0.3, 0.4), "mounting_rpy_deg": (2.0, -3.0, 135.0)}
    dive = exact_dive("figure-eight", duration_s=130.0, imu_rate_hz=100.0, **mounted)  # type: ignore[arg-type]
    replay = replay_dive(dive, config(dvl=Dvl(**mounted)))  # type: ignore[arg-type]
    assert errors_of(replay).loc[("aided", "position_h"), "final"] < 1e-3
    assert np.abs(innovations_of(replay.histories[1], "velocity").innovation).max() < 1e-4
    misplaced = replay_dive(dive, config(dvl=Dvl(mounting_rpy_deg=(2.0, -3.0, 135.0))))
    assert np.abs(innovations_of(misplaced.histories[1], "velocity").innovation).max() > 0.05


def test_tables_have_a_row_for_every_state_quantity_and_measurement(straight: Dive) -> None:
    tables = frames(replay_dive(straight, config()).tables)
    assert tuple(tables) == TABLES
    assert tables["improvement"]["state"].tolist() == [state.id for state in STATES]
    assert tables["convergence"]["state"].tolist() == [state.id for state in STATES]
    assert len(tables["reference_error"]) == 9
    measurements = tables["consistency"].loc[tables["consistency"]["dof"] == 3, "measurement"]
    assert measurements.tolist() == ["velocity", "velocity", "acceleration"]
    settled = tables["credibility"]["quantity"].isin(SETTLED)
    assert set(tables["credibility"].loc[settled, "filter"]) == {"baseline"}
    assert settled.sum() == len(SETTLED)
    assert len(tables["credibility"]) == 2 * (12 + 4 + 1) + len(SETTLED)
    assert {name for table in tables.values() if len(table) for name in table["log"]} == {
        "straight"
    }


def test_history_holds_the_start_the_pings_the_reference_and_the_end(straight: Dive) -> None:
    replay = replay_dive(straight, config())
    times = {
        replay.start_ns,
        replay.end_ns,
        *straight.dvl.time_ns.tolist(),
        *reference_of(straight).time_ns.tolist(),
    }
    for history in replay.histories:
        assert history.time_ns.tolist() == sorted(times)
        assert not len(history.cov)


def test_kept_covariance_has_the_squares_of_the_sd_on_its_diagonal(straight: Dive) -> None:
    replay = replay_dive(straight, config(), keep_cov=True)
    for history in replay.histories:
        assert history.cov_ns.tolist() == reference_of(straight).time_ns.tolist()
        sd = history.sd[np.isin(history.time_ns, history.cov_ns)]
        np.testing.assert_allclose(
            np.sqrt(np.diagonal(history.cov, axis1=1, axis2=2)), sd, rtol=1e-15
        )
        np.testing.assert_array_equal(history.cov, np.swapaxes(history.cov, 1, 2))


def test_same_dive_gives_the_same_tables(straight: Dive) -> None:
    assert_same(replay_dive(straight, config()), replay_dive(straight, config()))


@pytest.mark.parametrize("samples", [0, 10**9])
def test_filters_in_threads_give_the_same_tables(
    samples: int, straight: Dive, monkeypatch: pytest.MonkeyPatch
) -> None:
    as_it_comes = replay_dive(straight, config())
    monkeypatch.setattr("insdvl_replay.preparation.run.WORTH_A_THREAD", samples)
    assert_same(replay_dive(straight, config()), as_it_comes)


def test_date_of_the_dive_does_not_matter(straight: Dive) -> None:
    shift_ns = -START_NS + 12_345_678_901
    reference, truth = reference_of(straight), straight.truth
    assert truth is not None
    moved = replace(
        straight,
        imu=replace(straight.imu, time_ns=straight.imu.time_ns + shift_ns),
        dvl=replace(straight.dvl, time_ns=straight.dvl.time_ns + shift_ns),
        reference=replace(reference, time_ns=reference.time_ns + shift_ns),
        truth=replace(truth, time_ns=truth.time_ns + shift_ns),
    )
    assert_same(replay_dive(straight, config()), replay_dive(moved, config()))


def test_log_is_replayed_like_the_dive_that_was_written_to_it(
    straight: Dive, tmp_path: Path
) -> None:
    single = beams_of(straight).astype(np.float32).astype(np.float64)  # what the message holds
    dive = replace(straight, dvl=replace(straight.dvl, beam_velocity_mps=single))
    path = tmp_path / "straight.mcap"
    write_dive(path, dive)
    from_log, from_dive = (
        frames(one.tables) for one in (replay_log(path, config()), replay_dive(dive, config()))
    )
    for name in TABLES:
        pd.testing.assert_frame_equal(from_log[name], from_dive[name], rtol=1e-9, atol=1e-5)


# --- Candidates.


def test_candidates_are_held_against_the_first_filter_by_name(straight: Dive) -> None:
    filters = {
        "plain": VELOCITY,
        "two": aided(window=2),
        "five": aided(window=5),
        "curved": aided(window=5, order=2),
        "published": aided(model="published", sd_mps2=0.103),
    }
    replay = replay_dive(straight, config(filters))
    assert [history.filter for history in replay.histories] == list(filters)
    for name in ("improvement", "convergence", "reference_error"):
        assert frames(replay.tables)[name]["filter"].unique().tolist() == [
            "two",
            "five",
            "curved",
            "published",
        ]
    updates = [
        len(innovations_of(history, "acceleration").nis) for history in replay.histories[1:]
    ]
    pings = len(straight.dvl.time_ns)
    assert updates == [pings - 1, pings - 4, pings - 4, pings - 2]
    for table in frames(replay.tables).values():
        assert not (table.get("status", pd.Series()) == "not finite").any()


def test_filter_does_not_depend_on_its_company(straight: Dive) -> None:
    alone = replay_dive(straight, config({"aided": aided()})).histories[0]
    beside = replay_dive(
        straight, config({"a": VELOCITY, "wide": aided(window=6), "aided": aided()})
    ).histories[2]
    np.testing.assert_array_equal(alone.sd, beside.sd)
    np.testing.assert_array_equal(alone.velocity_n, beside.velocity_n)


def test_filter_with_its_own_noise_predicts_otherwise(straight: Dive) -> None:
    noisy = Filter(aiding=("velocity",), accel_white_mps_rts=0.2, velocity_sd_mps=0.05)
    improvement = frame(
        replay_dive(straight, config({"baseline": VELOCITY, "noisy": noisy})).tables.improvement
    )
    states = improvement.set_index("state")
    assert (states["status"] == "worse").sum() >= 6
    # Closed form for the vertical on a level straight line: N / sqrt(T), here 0.2 m/s/sqrt(s) over 60 s.
    assert states.loc["ba_z", "sd"] == pytest.approx(0.2 / np.sqrt(60.0) / 9.80665e-3, rel=0.1)


@pytest.mark.parametrize("window", [40, 61, 200])
def test_window_as_long_as_the_dive_is_no_trouble(straight: Dive, window: int) -> None:
    replay = replay_dive(straight, config({"baseline": VELOCITY, "aided": aided(window=window)}))
    assert len(innovations_of(replay.histories[1], "acceleration").nis) == max(
        0, len(straight.dvl.time_ns) - window + 1
    )
    if window > len(straight.dvl.time_ns):
        np.testing.assert_array_equal(replay.histories[0].sd, replay.histories[1].sd)
        assert frame(replay.tables.consistency)["verdict"].iloc[-1] == "insufficient data"


# --- The span.


def test_pings_before_the_first_sample_are_counted_and_left_out(straight: Dive) -> None:
    late = straight.imu.time_ns >= START_NS + 5 * SECOND
    imu = replace(
        straight.imu,
        time_ns=straight.imu.time_ns[late],
        specific_force_b=straight.imu.specific_force_b[late],
        angular_rate_b=straight.imu.angular_rate_b[late],
    )
    replay = replay_dive(replace(straight, imu=imu), config())
    assert replay.start_ns == START_NS + 5 * SECOND
    assert note(replay, "dvl_outside_span").count == 5
    assert len(replay.velocities.time_ns) == len(straight.dvl.time_ns) - 5
    assert innovations_of(replay.histories[0], "velocity").time_ns[0] == straight.dvl.time_ns[5]


@pytest.mark.parametrize(
    ("span", "start_s", "end_s", "outside"),
    [
        (Span(), 0.0, 60.0, 0),
        (Span(start_s=10.0), 10.0, 60.0, 10),
        (Span(start_s=10.1), 10.2, 60.0, 10),
        (Span(end_s=30.011), 0.0, 30.011, 30),
        (Span(start_s=10.0, end_s=30.0), 10.0, 30.0, 40),
        (Span(start_s=-5.0, end_s=500.0), 0.0, 60.0, 0),
    ],
    ids=str,
)
def test_span_is_replayed_from_the_references_next_row(
    straight: Dive, span: Span, start_s: float, end_s: float, outside: int
) -> None:
    replay = replay_dive(straight, config(span=span))
    assert (replay.start_ns - START_NS, replay.end_ns - START_NS) == (
        round(start_s * SECOND),
        round(end_s * SECOND),
    )
    assert replay.histories[0].time_ns[[0, -1]].tolist() == [replay.start_ns, replay.end_ns]
    pings_ns = straight.dvl.time_ns[straight.dvl.time_ns <= replay.end_ns]
    last_ping_s = (pings_ns[-1] - replay.start_ns) / SECOND
    assert frame(replay.tables.convergence)["baseline_s"].unique().tolist() == pytest.approx(
        [last_ping_s]
    )
    assert [note.count for note in replay.notes if note.code == "dvl_outside_span"] == [
        outside
    ] * bool(outside)


@pytest.mark.parametrize(
    ("span", "told"),
    [
        (Span(start_s=60.0), "--start 60 s is at the end"),
        (Span(start_s=61.0), "--start 61 s is after the end"),
        (Span(start_s=1e300), "--start 1e+300 s is after the end"),
        (Span(end_s=0.0), "--end 0 s is at the start"),
        (Span(end_s=-1e300), "--end -1e+300 s is before the start"),
        (Span(start_s=20.0, end_s=10.0), "there is nothing between --start 20 s and --end 10 s"),
    ],
    ids=str,
)
def test_empty_span_is_refused_with_what_there_is(straight: Dive, span: Span, told: str) -> None:
    with pytest.raises(LogError) as caught:
        replay_dive(straight, config(span=span))
    assert caught.value.message == f"straight: {told}; the IMU covers 0 to 60.0 s"


# --- Logs that cannot be replayed.


@pytest.mark.parametrize("shift_s", [-1000, 1000])
def test_clocks_that_do_not_meet_are_refused(straight: Dive, shift_s: int) -> None:
    apart = replace(
        straight, dvl=replace(straight.dvl, time_ns=straight.dvl.time_ns + shift_s * SECOND)
    )
    with pytest.raises(LogError, match="straight: IMU and DVL ") as caught:
        replay_dive(apart, config())
    assert f"{shift_s + 0.3717:.1f} to" in caught.value.message
    assert "dvl.stamp" in caught.value.hint


def test_dvl_that_never_sees_the_seabed_is_refused(straight: Dive) -> None:
    blind = replace(
        straight,
        dvl=replace(straight.dvl, beam_velocity_mps=np.full_like(beams_of(straight), np.nan)),
    )
    with pytest.raises(LogError, match=r"straight: .*DVL.* 60 "):
        replay_dive(blind, config())


def test_reference_that_begins_after_the_last_ping_is_refused(straight: Dive) -> None:
    dive = with_pings(
        with_reference(straight, lambda time_s: time_s > 50.0), lambda time_s: time_s < 40.0
    )
    with pytest.raises(LogError, match=r"straight: .*DVL") as caught:
        replay_dive(dive, config())
    assert "reference.stamp" in caught.value.hint


def test_dive_without_reference_needs_to_be_reported_how_to_start(straight: Dive) -> None:
    alone = replace(straight, reference=None)
    with pytest.raises(LogError, match="no reference") as caught:
        replay_dive(alone, config())
    assert "initial.source=level" in caught.value.hint
    with pytest.raises(ConfigError, match="latitude"):
        replay_dive(alone, config(initial=Initial(source="level", heading_deg=30.0)))
    level = Initial(
        source="level", heading_deg=30.0, latitude_deg=32.8, longitude_deg=34.9, height_m=-20.0
    )
    replay = replay_dive(alone, config(initial=level))
    assert replay.errors == {}
    assert set(frame(replay.tables.reference_error)["status"]) == {"no reference"}
    ours, theirs = replay.histories[0], replay_dive(straight, config()).histories[0]
    np.testing.assert_allclose(ours.velocity_n[-1], theirs.velocity_n[-1], atol=0.02)


# --- References that are not whole.


def test_reference_that_covers_a_part_is_compared_there(straight: Dive) -> None:
    dive = with_reference(straight, lambda time_s: (time_s >= 12.0) & (time_s <= 40.0))
    replay = replay_dive(dive, config())
    assert (replay.start_ns - START_NS, replay.end_ns - START_NS) == (12 * SECOND, 60 * SECOND)
    assert note(replay, "dvl_outside_span").count == 12
    assert set(frame(replay.tables.reference_error)["samples"]) == {5 * 28}


@pytest.mark.parametrize(
    ("quantity", "missing", "code", "initial"),
    [
        (
            "velocity_n",
            ["velocity_n", "velocity_e", "velocity_d"],
            "start_velocity_dvl",
            Initial(),
        ),
        ("mat_nb", ["roll", "pitch", "heading"], "start_levelled", Initial(heading_deg=30.0)),
        (
            "position",
            ["position_h", "depth", "position_h_pct"],
            "start_position_configured",
            Initial(latitude_deg=32.8, longitude_deg=34.9, height_m=-20.0),
        ),
    ],
)
def test_reference_without_a_quantity_still_serves(
    straight: Dive, quantity: str, missing: list[str], code: str, initial: Initial
) -> None:
    replay = replay_dive(without(straight, quantity), config(initial=initial))
    assert note(replay, code).count == 1
    statuses = errors_of(replay).loc["aided"]["status"]
    assert statuses[statuses == "not in reference"].index.tolist() == missing
    whole = replay_dive(straight, config()).histories[0]
    np.testing.assert_allclose(replay.histories[0].velocity_n[-1], whole.velocity_n[-1], atol=0.02)


# --- Dives from the sea.


def test_outage_of_a_minute_is_bridged_and_predicted_to_be_worse() -> None:
    dive = simulate_dive(
        "straight", duration_s=150.0, imu_rate_hz=50.0, seed=3, outages=[(60.0, 120.0)]
    )
    replay = replay_dive(dive, config())
    assert note(replay, "dvl_no_velocity").count == 60
    history = replay.histories[1]
    time_s = since_start_s(history.time_ns)
    before, during, after = (int(np.searchsorted(time_s, at_s)) for at_s in (59.5, 119.5, 125.0))
    assert (history.sd[during, :3] > [5.0, 5.0, 1.5] * history.sd[before, :3]).all(), (
        "gravity holds the vertical best"
    )
    assert (history.sd[after, :3] < history.sd[during, :3] / 1.5).all()
    at_reference = replay.errors["aided"]
    within = since_start_s(at_reference.time_ns) < 120.0
    sd_mps = history.sd[np.searchsorted(history.time_ns, at_reference.time_ns), :3]
    assert (np.abs(at_reference.velocity_error_n[within]) < 4.0 * sd_mps[within]).all()
    # Windows do not reach across: two pings on each side fill the next one.
    assert (
        len(innovations_of(history, "acceleration").nis) == len(replay.velocities.time_ns) - 2 * 2
    )


def test_gap_in_the_pings_starts_a_new_window(straight: Dive) -> None:
    dive = with_pings(straight, lambda time_s: (time_s < 20.0) | (time_s > 24.0))
    acceleration = innovations_of(replay_dive(dive, config()).histories[1], "acceleration")
    missing = set(np.round(since_start_s(dive.dvl.time_ns) - 0.3717).astype(int).tolist()) - set(
        np.round(since_start_s(acceleration.time_ns) - 0.3717).astype(int).tolist()
    )
    assert missing == {0, 1, 24, 25}
    patient = replay_dive(
        dive, config({"baseline": VELOCITY, "aided": aided(max_window_gap_s=5.0)})
    ).histories[1]
    assert len(innovations_of(patient, "acceleration").nis) == len(acceleration.nis) + 2


def test_lost_beams_are_counted_and_cost_certainty(straight: Dive) -> None:
    lost = [LostBeam(1, 20.0, 40.0), LostBeam(3, 30.0, 35.0)]
    dive = simulate_dive("straight", duration_s=60.0, imu_rate_hz=50.0, seed=3, lost_beams=lost)
    replay = replay_dive(dive, config())
    assert note(replay, "dvl_three_beams").count == 15
    assert note(replay, "dvl_no_velocity").count == 5
    _, pings, same_pings = np.intersect1d(
        replay.velocities.time_ns, straight.dvl.time_ns, return_indices=True
    )
    sd_b = innovations_of(replay.histories[0], "velocity").sd[pings]
    whole_sd_b = innovations_of(replay_dive(straight, config()).histories[0], "velocity").sd[
        same_pings
    ]
    three = replay.velocities.beams_used == 3
    np.testing.assert_allclose(sd_b[:20], whole_sd_b[:20], rtol=1e-12)
    assert (sd_b[three, :2] > 1.2 * whole_sd_b[three, :2]).all()
    assert errors_of(replay).loc[("aided", "velocity_n"), "rmse"] < 0.02


def test_bad_beam_is_dropped_where_a_limit_is_set(straight: Dive) -> None:
    beams = beams_of(straight).copy()
    beams[30:33, 2] += 0.5
    spoilt = replace(straight, dvl=replace(straight.dvl, beam_velocity_mps=beams))
    checked = replay_dive(spoilt, config(dvl=Dvl(max_beam_residual_mps=0.1)))
    bad = note(checked, "dvl_bad_residual")
    assert bad.count == 3
    assert "0.1 m/s" in bad.text
    assert bad.severity == "info"
    unchecked = replay_dive(spoilt, config())
    assert not [note for note in unchecked.notes if note.code == "dvl_bad_residual"]
    rmse = [
        errors_of(replay).loc[("aided", "velocity_n"), "rmse"] for replay in (checked, unchecked)
    ]
    assert rmse[0] < 0.5 * rmse[1]


def test_limit_that_drops_most_pings_is_a_warning(straight: Dive) -> None:
    """The noise of a beam does it."""
    bad = note(
        replay_dive(straight, config(dvl=Dvl(max_beam_residual_mps=0.002))), "dvl_bad_residual"
    )
    assert (bad.count or 0) > 0.5 * len(straight.dvl.time_ns)
    assert bad.severity == "warning"
    assert "dvl.max_beam_residual_mps" in (bad.hint or "")
    with pytest.raises(LogError, match=r"beams .*\d+ .*1e-09 m/s"):
        replay_dive(straight, config(dvl=Dvl(max_beam_residual_mps=1e-9)))


def test_dvl_that_reports_velocities_replays_like_one_that_reports_beams(turning: Dive) -> None:
    vectors_d = turning.dvl.beam_vectors_d
    assert vectors_d is not None
    velocity_d = beams_of(turning) @ np.linalg.pinv(vectors_d).T
    reported = replay_dive(
        replace(turning, dvl=DvlColumns(turning.dvl.time_ns, velocity_d=velocity_d)), config()
    )
    solved = replay_dive(turning, config())
    for ours, theirs in zip(reported.histories, solved.histories, strict=True):
        np.testing.assert_allclose(ours.sd, theirs.sd, rtol=1e-9)
        np.testing.assert_allclose(ours.velocity_n, theirs.velocity_n, atol=1e-9)


def test_notes_of_the_log_stay_with_the_result(straight: Dive) -> None:
    noted = replace(straight, notes=(Note("imu_gaps", "two gaps", 2, "warning"),))
    assert replay_dive(noted, config()).notes[:1] == noted.notes


@pytest.mark.parametrize("rate_hz", [1.0, 20.0])
def test_what_a_filter_predicts_does_not_depend_on_the_references_rate(rate_hz: float) -> None:
    tables = [
        frames(
            replay_dive(
                exact_dive(
                    "figure-eight", duration_s=130.0, imu_rate_hz=50.0, reference_rate_hz=rate
                ),
                config(),
            ).tables
        )
        for rate in (5.0, rate_hz)
    ]
    for name in ("improvement", "convergence"):
        # A node at each reference time divides the intervals otherwise, which moves the fifth digit.
        predicted = [column for column in tables[0][name] if not column.startswith("measured")]
        pd.testing.assert_frame_equal(
            tables[0][name][predicted], tables[1][name][predicted], rtol=1e-4, atol=1e-3
        )


def test_predicted_end_is_the_last_ping_wherever_the_log_ends() -> None:
    dive = exact_dive("straight", duration_s=30.9, imu_rate_hz=50.0)
    tables = [
        frame(replay_dive(dive, config(span=Span(end_s=end_s))).tables.improvement)
        for end_s in (30.4, 30.9)
    ]
    pd.testing.assert_frame_equal(tables[0], tables[1], rtol=1e-6)


def test_aiding_that_never_happens_is_a_warning() -> None:
    dive = exact_dive("straight", duration_s=60.0, imu_rate_hz=50.0, dvl_rate_hz=0.2)
    replay = replay_dive(dive, config())
    assert note(replay, "aiding_without_updates").severity == "warning"
    assert "max_window_gap_s" in note(replay, "aiding_without_updates").hint


def test_breakdown_of_a_filter_is_reported_as_such_and_not_as_rejection(straight: Dive) -> None:
    replay = replay_dive(straight, config(initial=Initial(accel_bias_sd_mg=1e155)))
    assert {found.code for found in replay.notes if found.severity == "warning"} == {
        "filter_not_finite",
        "not_evaluated",
    }
    assert (frame(replay.tables.consistency)["rejected"] == 0).all()
    assert set(frame(replay.tables.improvement)["status"]) == {"not finite", "same"}, (
        "nothing is called improved"
    )


@pytest.mark.parametrize(("rate_hz", "severity"), [(5.0, ""), (1.0, "info"), (0.1, "warning")])
def test_reference_that_is_too_slow_for_the_turns_is_said_to_be(
    rate_hz: float, severity: str
) -> None:
    """The eight turns by 138.9 deg at 17 deg/s, once within 130 s, at 0.9 m/s."""
    dive = exact_dive(
        "figure-eight", duration_s=130.0, imu_rate_hz=50.0, reference_rate_hz=rate_hz
    )
    notes = [note for note in replay_dive(dive, config()).notes if note.code == "reference_slow"]
    assert [note.severity for note in notes] == [severity] * bool(severity)
    if severity == "info":
        assert re.search(r"\b1 s .*\b17 deg", notes[0].text)
        assert notes[0].count == pytest.approx(138.9 / 17.0, abs=2.0)
    if severity == "warning":
        assert re.search(r"\b10 s .*\b13\d", notes[0].text)
        assert "1.4 Hz" in notes[0].hint


def test_errors_of_a_long_dive_are_evaluated_at_fewer_times_by_the_same_p(
    straight: Dive, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = replay_dive(straight, config(), keep_cov=True)
    monkeypatch.setattr(
        "insdvl_replay.evaluation.evaluate.MOST_COVARIANCES", len(reference_of(straight).time_ns)
    )
    fewer = replay_dive(straight, config(), keep_cov=True)
    for before, after in zip(whole.histories, fewer.histories, strict=True):
        np.testing.assert_array_equal(
            after.cov_ns, before.cov_ns[::2], "two filters share the room"
        )
        np.testing.assert_array_equal(after.cov, before.cov[::2])
    before, after = (
        frame(replay.tables.credibility).set_index(["filter", "quantity"]).loc["aided"]
        for replay in (whole, fewer)
    )
    assert after.loc["all", "samples"] == before.loc["all", "samples"] // 2
    # What is worth ten samples within 3 % may be worth too few.
    np.testing.assert_allclose(after["effective_samples"], before["effective_samples"], rtol=0.06)
    clear = (before["effective_samples"] * before["dof"] / FEWEST_UPDATES - 1.0).abs() > 0.03
    assert clear.sum() == len(before) - 1
    assert after.loc[clear, "verdict"].tolist() == before.loc[clear, "verdict"].tolist()
    # Neighbouring errors are nearly the same, so that every second tells what all do, to what is too small to matter.
    np.testing.assert_allclose(after["mean_nees"], before["mean_nees"], rtol=SMALL_EXCESS)
    (note,) = (note for note in fewer.notes if note.code == "credibility_thinned")
    assert note.count == len(reference_of(straight).time_ns) // 2
    assert "credibility_thinned" not in {note.code for note in whole.notes}
    for name, table in frames(whole.tables).items():
        if name != "credibility":
            # NEES alone is of the fewer times.
            rtol = SMALL_EXCESS if name == "evidence" else 0.0
            of_p = table.get("quantity", pd.Series(index=table.index)) == "nees"
            pd.testing.assert_frame_equal(frames(fewer.tables)[name][~of_p], table[~of_p])
            pd.testing.assert_frame_equal(
                frames(fewer.tables)[name][of_p], table[of_p], rtol=rtol, atol=0.0
            )


def test_position_after_a_long_gap_of_the_imu_is_not_taken_for_a_result(straight: Dive) -> None:
    heard = (straight.imu.time_ns <= START_NS + 30 * SECOND) | (
        straight.imu.time_ns >= START_NS + 31 * SECOND
    )
    imu = replace(
        straight.imu,
        time_ns=straight.imu.time_ns[heard],
        specific_force_b=straight.imu.specific_force_b[heard],
        angular_rate_b=straight.imu.angular_rate_b[heard],
    )
    silent = replace(straight, imu=imu)
    replay = replay_dive(silent, config())
    statuses = errors_of(replay).loc["aided", "status"]
    assert statuses[statuses == "lost in gap"].index.tolist() == [
        "position_h",
        "depth",
        "position_h_pct",
    ]
    assert set(statuses) == {"compared", "lost in gap"}
    assert errors_of(replay).loc["aided", "rmse"].notna().all(), "the numbers stand"
    assert "(position" not in replay.verdicts["aided"].sentence
    patient = replay_dive(silent, config(imu=Imu(max_gap_s=2.0)))
    assert set(errors_of(patient).loc["aided", "status"]) == {"compared"}


def test_reference_that_sees_half_of_the_dive_is_a_warning(straight: Dive) -> None:
    half = with_reference(straight, lambda time_s: time_s <= 30.0)
    found = note(replay_dive(half, config()), "reference_coverage")
    assert found.severity == "warning"
    assert re.search(r"positions, heights, velocities and attitudes .*\b50 %", found.text)
    assert "reference_coverage" not in {
        found.code for found in replay_dive(straight, config()).notes
    }


def test_what_a_replay_keeps_of_a_dive_is_not_replayed_again() -> None:
    replay = replay_dive(exact_dive("straight", duration_s=20.0), Config())
    with pytest.raises(ValueError, match="IMU"):
        replay_dive(replay.dive, Config())
