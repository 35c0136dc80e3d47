"""Which dives are fitted and which are held out is decided in one place, for users and for what is found."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from insdvl_replay.calibration.division import LONGEST_S, By, Division, middle
from insdvl_replay.calibration.innovations import ReadDive
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import ImuColumns, seconds
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.sim.dive import simulate_dive

LENGTH_S = 40.0


@pytest.fixture(scope="module")
def read() -> ReadDive:
    dive = simulate_dive("static", seed=1, duration_s=LENGTH_S, imu_rate_hz=5.0)
    return ReadDive(dive, load_config())


def named(read: ReadDive, names: str) -> list[ReadDive]:
    return [ReadDive(replace(read.dive, name=name), read.config) for name in names]


def names(dives: Sequence[ReadDive]) -> str:
    return "".join(read.dive.name for read in dives)


@pytest.mark.parametrize(
    ("asked", "fitted", "held_out", "by"),
    [
        ([], "abcdefghij", "", By.NOTHING),
        (["c"], "abdefghij", "c", By.DIVES),
        # Three of ten, the last among them, three to four dives apart.
        (["0.3"], "abdefhi", "cgj", By.DIVES),
        (["0.01", "a"], "bcdefghi", "aj", By.DIVES),
    ],
)
def test_a_user_holds_out_names_or_a_share_evenly_spread(
    asked: list[str], fitted: str, held_out: str, by: By, read: ReadDive
) -> None:
    division = Division.asked(named(read, "abcdefghij"), asked)
    assert names(division.held_out) == held_out
    assert names(division.fitted) == fitted
    assert division.by == by


@pytest.mark.parametrize("asked", [["z"], ["1.5"], ["0"], ["a", "b", "c"], ["0.99"]])
def test_what_cannot_be_held_out_is_an_error(asked: list[str], read: ReadDive) -> None:
    with pytest.raises(ConfigError, match=r"hold out|held out"):
        Division.asked(named(read, "abc"), asked)


@pytest.mark.parametrize(
    ("pauses_s", "from_s"),
    [
        ([], 20.0),
        ([(20.1, 21.0)], 21.0),  # one sample would be left to find the level
        ([(19.0, 21.5)], 20.0),  # the next sample is far enough from the next pause
        ([(21.0, 22.0), (23.0, 24.0)], 24.0),
        ([(23.0, 24.0)], 20.0),
        ([(second + 0.1, second + 0.9) for second in range(20, 40)], 20.0),  # no place is better
    ],
)
def test_what_tests_a_fit_does_not_begin_just_before_a_pause(
    pauses_s: list[tuple[float, float]], from_s: float, read: ReadDive
) -> None:
    imu = read.dive.imu
    time_s = seconds(imu.time_ns, imu.time_ns[0])
    is_read = np.ones(len(time_s), bool)
    for begin_s, end_s in pauses_s:
        is_read &= (time_s < begin_s) | (time_s >= end_s)
    paused = replace(read, dive=replace(read.dive, imu=imu.rows(is_read)))
    division = Division.found([paused])
    assert division.held_out[0].config.span.start_s == pytest.approx(from_s, abs=0.01)
    assert division.fitted[0].config.span.end_s == pytest.approx(from_s, abs=0.01)


def test_what_tests_a_fit_begins_before_the_end_of_the_span(read: ReadDive) -> None:
    imu = read.dive.imu
    time_s = seconds(imu.time_ns, imu.time_ns[0])
    paused = replace(read.dive, imu=imu.rows((time_s < 10.1) | (time_s > 25.0)))
    division = Division.found([ReadDive(paused, load_config(overrides=["span.end_s=20"]))])
    assert division.held_out[0].config.span.start_s == pytest.approx(10.0, abs=0.01)
    assert division.held_out[0].config.span.end_s == pytest.approx(20.0, abs=0.01)


def test_a_number_may_be_the_name_of_a_dive(read: ReadDive) -> None:
    division = Division.asked(named(read, "123"), ["2"])
    assert (names(division.fitted), names(division.held_out)) == ("13", "2")


def test_dives_of_the_same_name_are_held_out_together(read: ReadDive) -> None:
    division = Division.asked(named(read, "aba"), ["a"])
    assert (names(division.fitted), names(division.held_out)) == ("b", "aa")


def test_of_several_dives_a_share_is_held_out_where_nobody_asks(read: ReadDive) -> None:
    dives = named(read, "abc")
    assert Division.found(dives) == Division.asked(dives, ["0.3"])


def spans_s(dives: Sequence[ReadDive]) -> list[tuple[float | None, float | None]]:
    return [(read.config.span.start_s, read.config.span.end_s) for read in dives]


def test_of_a_dive_alone_the_later_part_is_held_out(read: ReadDive) -> None:
    division = Division.found([read])
    assert division.by == By.TIME
    ((from_s, to_s),) = spans_s(division.fitted)
    ((later_s, end_s),) = spans_s(division.held_out)
    assert from_s == 0.0
    assert to_s == later_s == pytest.approx(LENGTH_S / 2.0)
    assert end_s == pytest.approx(LENGTH_S)
    exchanged = division.exchanged
    assert exchanged.fitted == division.held_out
    assert exchanged.held_out == division.fitted
    assert exchanged.by == By.TIME


def test_both_parts_get_other_settings(read: ReadDive) -> None:
    other: Config = load_config(overrides=["dvl.scale=1.1"])
    division = Division.asked(named(read, "abc"), ["c"]).with_config(other)
    scales = {each.config.dvl.scale for each in (*division.fitted, *division.held_out)}
    assert scales == {1.1}


def test_of_a_long_dive_the_middle_is_taken(read: ReadDive) -> None:
    assert middle(read) is read
    longer_s = LONGEST_S + 100.0
    time_ns = np.arange(round(5.0 * longer_s) + 1) * 200_000_000
    nothing = np.zeros((len(time_ns), 3))
    long = ReadDive(replace(read.dive, imu=ImuColumns(time_ns, nothing, nothing)), read.config)
    assert spans_s([middle(long)]) == [(50.0, LONGEST_S + 50.0)]


def test_a_part_that_is_not_replayed_is_neither_fitted_nor_held_out(read: ReadDive) -> None:
    """The longer side of a pause is replayed, so that it is what is divided."""
    time_ns = read.dive.imu.time_ns
    at_s = seconds(time_ns, int(time_ns[0]))
    later_ns = np.where(at_s > 10.0, 3_600_000_000_000, 0)
    paused = replace(read.dive, imu=replace(read.dive.imu, time_ns=time_ns + later_ns))
    division = Division.found([ReadDive(paused, read.config)])
    (fitted,) = division.fitted
    (held_out,) = division.held_out
    assert fitted.span_s == pytest.approx((3610.2, 3625.1))
    assert held_out.span_s == pytest.approx((3625.1, 3600.0 + LENGTH_S))
