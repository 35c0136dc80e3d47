"""Where the IMU was silent, the filters say that they do not know; nothing there looks more certain than it is."""

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from instants import instants

from insdvl_replay.core.config import Acceleration, Config, Dvl, Filter, Imu, Initial, Noise
from insdvl_replay.core.dive_columns import Dive, Floats, ImuColumns, TimeNs, seconds
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.states import BG, DEG, DV, PHI
from insdvl_replay.nav.timeline import Gaps, Timeline, build_timeline
from insdvl_replay.preparation.prepared import find_gaps
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.sim.dive import START_NS, exact_dive

SECOND = 1_000_000_000
GYRO_WHITE = 1e-5
CONFIG = Config(
    initial=Initial(uncertainty="settings"),
    noise=Noise(accel_white_mps_rts=2e-3, gyro_white_rad_rts=GYRO_WHITE),
    filters={
        "baseline": Filter(aiding=("velocity",)),
        "aided": Filter(aiding=("velocity", "acceleration"), acceleration=Acceleration(window=3)),
    },
)


@pytest.fixture(scope="module")
def turning() -> Dive:
    """An exact dive that turns at up to 17 deg/s from about 100 s on."""
    return exact_dive("figure-eight", duration_s=130.0, imu_rate_hz=50.0)


def times(*at_s: float) -> TimeNs:
    return START_NS + np.rint(np.array(at_s) * 1e9).astype(np.int64)


def silent(dive: Dive, from_s: float, to_s: float, *, pings_too: bool = False) -> Dive:
    """Take out what the IMU measured between two times, and what the DVL did."""

    def heard(time_ns: TimeNs) -> np.ndarray:
        at_s = seconds(time_ns, START_NS)
        return (at_s <= from_s) | (at_s >= to_s)

    imu, rows = dive.imu, heard(dive.imu.time_ns)
    kept = ImuColumns(imu.time_ns[rows], imu.specific_force_b[rows], imu.angular_rate_b[rows])
    if not pings_too:
        return replace(dive, imu=kept)
    pings = heard(dive.dvl.time_ns)
    assert dive.dvl.beam_velocity_mps is not None
    dvl = replace(
        dive.dvl,
        time_ns=dive.dvl.time_ns[pings],
        beam_velocity_mps=dive.dvl.beam_velocity_mps[pings],
    )
    return replace(dive, imu=kept, dvl=dvl)


def with_imu(**settings: object) -> Config:
    return msgspec.structs.replace(CONFIG, imu=Imu(**settings))  # type: ignore[arg-type]


def note(replay: Replay, code: str) -> Note:
    (found,) = (note for note in replay.notes if note.code == code)
    return found


def sd_at(replay: Replay, at_s: float, filter_row: int = 0) -> Floats:
    history = replay.histories[filter_row]
    row = np.searchsorted(history.time_ns, START_NS + round(at_s * 1e9), side="right") - 1
    return history.sd[row]


def heading_error(replay: Replay, at_s: float) -> float:
    """Turn about down from the reference to the baseline, rad."""
    history, reference = replay.histories[0], replay.dive.reference
    assert reference is not None
    time_ns = START_NS + round(at_s * 1e9)
    estimated = history.mat_nb[np.flatnonzero(history.time_ns == time_ns).item()]
    so = reference.mat_nb[np.flatnonzero(reference.time_ns == time_ns).item()]
    turn = estimated @ so.T
    return float(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))


# What is a gap


def test_pauses_up_to_the_limit_are_no_gaps() -> None:
    gaps = find_gaps(times(0.0, 0.5, 1.0, 1.500000001, 3.0), Imu(max_gap_s=0.5))
    np.testing.assert_array_equal(gaps.start_ns, times(1.0, 1.500000001))
    np.testing.assert_allclose(gaps.length_s, [0.500000001, 1.499999999], atol=1e-12)


@pytest.mark.parametrize("max_gap_s", [0.1, 0.3, 0.57, 0.6, 0.7])
def test_a_pause_of_the_very_limit_is_no_gap(max_gap_s: float) -> None:
    gaps = find_gaps(times(0.0, max_gap_s, 2.0 * max_gap_s + 1e-9), Imu(max_gap_s=max_gap_s))
    np.testing.assert_array_equal(gaps.start_ns, times(max_gap_s))


def test_density_gives_the_configured_deviation_over_the_whole_gap() -> None:
    settings = Imu(gap_accel_mps2=0.3, gap_rate_degps=2.0)
    gaps = find_gaps(times(0.0, 4.0), settings)
    variance = gaps.noise_density[0] * gaps.length_s[0]
    np.testing.assert_allclose(np.sqrt(variance[DV]), 0.3 * 4.0)
    np.testing.assert_allclose(np.sqrt(variance[PHI]), 2.0 * DEG * 4.0)
    assert not variance[6:].any(), "a gap teaches nothing about biases"
    hour = find_gaps(times(0.0, 3600.0), settings)
    np.testing.assert_allclose(np.sqrt(hour.noise_density[0, PHI] * 3600.0), np.pi)


def test_intervals_that_touch_a_gap_only_at_its_end_do_not_overlap_it() -> None:
    gaps = Gaps(times(10.0, 20.0), times(12.0, 25.0), np.zeros((2, 12)))
    from_ns, to_ns = (
        times(9, 9, 12, 11, 12, 25, 12, 0),
        times(10, 10.1, 20, 11.5, 20.1, 30, 25, 30),
    )
    assert gaps.overlap(from_ns, to_ns).tolist() == [
        False,
        True,
        False,
        True,
        True,
        False,
        True,
        True,
    ]
    at_ns = times(10, 10.5, 12, 15, 24.999, 25)
    assert gaps.overlap(at_ns, at_ns).tolist() == [False, True, False, False, True, False]


def test_longest_stretch_is_between_gaps_and_ends_of_the_span() -> None:
    gaps = Gaps(times(10.0, 20.0), times(12.0, 25.0), np.zeros((2, 12)))
    for span, kept in [
        ((0, 30), (0, 10)),
        ((4, 30), (12, 20)),
        ((0, 60), (25, 60)),
        ((11, 13), (12, 13)),
    ]:
        assert gaps.longest_stretch(*times(*span).tolist()) == tuple(times(*kept).tolist())


# The time line


def timeline_with_gap(from_s: float, to_s: float, *ping_s: float) -> Timeline:
    time_ns = times(*np.arange(0.0, from_s + 0.005, 0.01), *np.arange(to_s, to_s + 1.005, 0.01))
    imu = ImuColumns(time_ns, np.ones((len(time_ns), 3)), np.ones((len(time_ns), 3)))
    gaps = find_gaps(time_ns, Imu())
    return build_timeline(imu, times(*ping_s), times(0.5), int(time_ns[0]), int(time_ns[-1]), gaps)


@pytest.mark.parametrize(
    ("from_s", "to_s"),
    [(1.0, 4.5), (1.01, 4.53), (1.03, 4.51)],
    ids=["dates that floats hold", "floats would be early", "floats would be late"],
)
def test_every_interval_of_a_gap_knows_it_and_no_other(from_s: float, to_s: float) -> None:
    at = instants(timeline_with_gap(from_s, to_s, 0.7, 2.25, 4.9))
    inside = at.gap >= 0
    np.testing.assert_allclose(np.diff(at.time_s)[inside[1:]].sum(), to_s - from_s, atol=1e-9)
    assert at.time_s[inside].min() > from_s
    assert at.time_s[inside].max() == pytest.approx(to_s, abs=1e-9)
    assert np.diff(at.time_s).max() <= 1.0, "nodes of its own, a second apart at most"
    np.testing.assert_allclose(at.time_s[at.ping >= 0], [0.7, 2.25, 4.9], atol=1e-9)
    np.testing.assert_allclose(at.specific_force_b, 1.0)


# Growing


def test_uncertainty_grows_in_the_gap_as_configured(turning: Dive) -> None:
    whole = replay_dive(turning, CONFIG)
    gapped = replay_dive(silent(turning, 100.05, 104.45, pings_too=True), CONFIG)
    before, after = sd_at(gapped, 100.0), sd_at(gapped, 104.0)
    np.testing.assert_array_equal(before, sd_at(whole, 100.0))
    grown = np.sqrt(after[PHI.start + 2] ** 2 - before[PHI.start + 2] ** 2)
    seconds_unseen = 104.0 - 100.06
    expected = 5.0 * DEG * np.sqrt(seconds_unseen * (104.46 - 100.04))
    assert grown == pytest.approx(expected, rel=0.05)


def test_error_through_an_unseen_turn_stays_inside_three_sigma(turning: Dive) -> None:
    """The same dive with the growth switched off is many sigma wrong, so that the growth is what makes it honest."""
    gapped = silent(turning, 100.05, 112.05)
    sigmas = {}
    for name, config in (
        ("grown", CONFIG),
        ("blind", with_imu(gap_accel_mps2=0.0, gap_rate_degps=0.0)),
    ):
        replay = replay_dive(gapped, config)
        sigmas[name] = abs(heading_error(replay, 112.0)) / sd_at(replay, 112.0)[PHI.start + 2]
    assert sigmas["grown"] < 3.0
    assert sigmas["blind"] > 20.0


@pytest.mark.nightly
@pytest.mark.parametrize("pings_too", [False, True])
def test_hour_without_an_imu_is_never_confident(pings_too: bool) -> None:
    """Of a vehicle that all but drifts, as the settings say."""
    dive = exact_dive("straight", duration_s=3760.0, imu_rate_hz=20.0)
    replay = replay_dive(
        silent(dive, 60.03, 3659.98, pings_too=pings_too), with_imu(gap_rate_degps=0.02)
    )
    for row in range(2):
        sd = sd_at(replay, 3661.0, row)
        assert np.isfinite(replay.histories[row].sd).all()
        assert sd[PHI.start + 2] > 60.0 * DEG, "nobody knows the heading"
        assert (sd[BG] > 0.0).all()
    found = note(replay, "imu_long_gaps")
    assert (found.severity, found.count) == ("warning", 1)
    assert "longest 3600.0 s" in found.text


def test_gap_that_nothing_can_bridge_is_refused_and_can_be_split(turning: Dive) -> None:
    imu = turning.imu
    late = imu.time_ns + np.where(seconds(imu.time_ns, START_NS) > 50.0, 86_400 * SECOND, 0)
    dive = replace(turning, imu=replace(imu, time_ns=late))
    with pytest.raises(LogError, match=r"\b1 gap .*0\.5 s: .*50\.0 s, .*86400\.0 s") as e:
        replay_dive(dive, with_imu(gap_rate_degps=0.0))
    assert "imu.long_gaps=split" in e.value.hint


def test_gap_in_which_the_attitude_is_lost_splits_the_dive_whatever_is_configured(
    turning: Dive,
) -> None:
    """Where it may be off by more than a quarter turn errors no longer add up: 5 deg/s for 20 s, unlike for 12 s."""
    lost = silent(silent(turning, 30.0, 42.0, pings_too=True), 100.0, 120.0, pings_too=True)
    replay = replay_dive(lost, CONFIG)
    assert all(np.isfinite(history.sd).all() for history in replay.histories)
    split, bridged = note(replay, "imu_split"), note(replay, "imu_long_gaps")
    assert (split.severity, split.count, bridged.count) == ("warning", 1, 1)
    assert " 100 deg" in split.text
    assert "gap_rate_degps" in split.hint
    assert (
        seconds(replay.histories[0].time_ns, START_NS)[-1] < 100.1
        or seconds(replay.histories[0].time_ns, START_NS)[0] > 119.9
    )


# Splitting


def test_split_replays_the_longest_part_and_says_what_it_left_out(turning: Dive) -> None:
    gapped = silent(silent(turning, 30.0, 40.0), 100.0, 101.0)
    replay = replay_dive(gapped, with_imu(long_gaps="split"))
    assert (replay.start_ns, replay.end_ns) == tuple(times(40.0, 100.0).tolist())
    found = note(replay, "imu_split")
    assert (found.severity, found.count) == ("warning", 2)
    assert re.search(r"40\.0 .*100\.0 s .*70\.0 s", found.text)
    whole = replay_dive(silent(turning, 130.5, 131.0), with_imu(long_gaps="split"))
    assert not [n for n in whole.notes if n.code == "imu_split"]


# Aiding


def test_no_window_of_accelerations_spans_a_gap(turning: Dive) -> None:
    def accelerated(dive: Dive) -> set[int]:
        (found,) = (
            i
            for i in replay_dive(dive, CONFIG).histories[1].innovations
            if i.measurement == "acceleration"
        )
        return set(found.time_ns.tolist())

    pings_s = seconds(turning.dvl.time_ns, START_NS)
    row = int(np.searchsorted(pings_s, 50.0))
    gapped = silent(turning, pings_s[row] - 0.2, pings_s[row] + 0.8)
    lost = accelerated(turning) - accelerated(gapped)
    # The window of the third ping after the gap is the first that begins behind it.
    assert lost == set(turning.dvl.time_ns[row : row + 3].tolist())


def test_lever_arm_swings_unseen_at_pings_inside_a_gap(turning: Dive) -> None:
    config = Config(
        imu=Imu(gap_rate_degps=10.0),
        dvl=Dvl(lever_arm_m=(2.0, 0.0, 0.0)),
        noise=CONFIG.noise,
        filters=CONFIG.filters,
    )
    pings_s = seconds(turning.dvl.time_ns, START_NS)
    row = int(np.searchsorted(pings_s, 50.0))
    velocity = (
        replay_dive(silent(turning, pings_s[row] - 0.2, pings_s[row] + 0.8), config)
        .histories[0]
        .innovations[0]
    )
    before, inside = (
        velocity.sd[velocity.time_ns == turning.dvl.time_ns[at]][0] for at in (row - 1, row)
    )
    swing = 10.0 * DEG * 2.0
    assert (inside[1:] > swing).all()
    assert (before < 0.5 * swing).all()


def test_dive_without_gaps_is_unchanged_by_their_settings(turning: Dive) -> None:
    one, other = (
        replay_dive(turning, CONFIG),
        replay_dive(turning, with_imu(gap_accel_mps2=9.0, gap_rate_degps=90.0)),
    )
    for mine, theirs in zip(one.histories, other.histories, strict=True):
        np.testing.assert_array_equal(mine.sd, theirs.sd)
        np.testing.assert_array_equal(mine.velocity_n, theirs.velocity_n)
