"""A recorder whose clock was set in a dive: the longest side with one clock is used, and its messages are in order."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import other_bags
import pytest
from rosbag_messages import START_NS, Message, header, write_log, xyz

from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.columns.tables import with_one_clock
from insdvl_replay.logs.formats.recorder_clock import one_clock, one_side

DAY_NS = 86_400 * 10**9


def steps(*parts: tuple[int, int, int]) -> np.ndarray:
    """Make log times of parts: first and last second, and by how many seconds the clock is ahead."""
    return np.concatenate(
        [(np.arange(10 * first, 10 * last) + 10 * ahead) * 10**8 for first, last, ahead in parts]
    )


@pytest.mark.parametrize(
    ("times", "span_s", "set_s"),
    [
        (steps((0, 90, 0), (90, 300, 10**9)), (10**9 + 90.0, 10**9 + 299.9), 89.9),
        (steps((0, 200, 10**9), (200, 300, 0)), (10**9, 10**9 + 199.9), 199.9),
        (
            steps((0, 10, 0), (10, 200, 10**6), (200, 300, 10**9)),
            (10**6 + 10.0, 10**6 + 199.9),
            9.9,
        ),
    ],
    ids=["forward", "back", "twice"],
)
def test_the_longest_side_of_a_step_is_found(
    times: np.ndarray, span_s: tuple[float, float], set_s: float
) -> None:
    found = one_clock([times, times[::5]])
    assert found is not None
    assert (found.first_ns * 1e-9, found.last_ns * 1e-9) == pytest.approx(span_s, abs=1e-6)
    assert found.set_s == pytest.approx(set_s, abs=1e-6)
    assert found.unused == np.count_nonzero(~found.holds(times)) + np.count_nonzero(
        ~found.holds(times[::5])
    )
    assert f"was set {set_s:.1f} s in" in found.note.text


def test_the_dive_is_found_between_damaged_times_at_both_ends_of_what_a_number_holds() -> None:
    ends = np.iinfo(np.int64)
    times = 10**18 + steps((0, 90, 0))
    found = one_clock([np.concatenate([times, [ends.min, ends.min + 5, ends.max]])])
    assert found is not None
    assert (found.first_ns, found.last_ns) == (times[0], times[-1])
    assert found.set_s == pytest.approx(89.9)
    assert found.unused == 3


def test_a_pause_of_hours_is_no_step() -> None:
    assert one_clock([steps((0, 90, 0), (90, 300, 7200))]) is None
    assert one_clock([np.empty(0, np.int64)]) is None


def test_stamps_of_messages_under_way_are_moved() -> None:
    log_ns = steps((90, 100, 10**9))
    stamp_ns = log_ns - 10**8
    old_ns = stamp_ns.copy()
    old_ns[:3] -= 10**18
    moved_ns = with_one_clock(old_ns, log_ns, ahead_ns=10**9)
    np.testing.assert_array_equal(moved_ns, stamp_ns)
    ahead_ns = stamp_ns.copy()
    ahead_ns[:3] += 2 * 10**9
    moved_ns = with_one_clock(ahead_ns, log_ns, ahead_ns=10**9)
    np.testing.assert_array_equal(moved_ns, stamp_ns)


def test_a_log_with_a_clock_that_is_set_is_read(tmp_path: Path) -> None:
    """The clock is set 4 s in; pings are logged 0.1 s late, so that one is stamped before and logged after it."""

    def on_clock(time_s: float) -> float:
        return time_s + (1e6 if time_s > 4.0 else 0.0)

    rows: list[Message] = []
    flying = {
        "linear_acceleration": xyz((0.1, 0.2, -9.8)),
        "angular_velocity": xyz((0.01, 0.02, 0.03)),
    }
    for i in range(1000):
        time_s = 0.01 * i
        stamped = {"header": header(on_clock(time_s - 0.025))}
        rows.append(("/imu", "sensor_msgs/msg/Imu", on_clock(time_s), stamped | flying))
    for i in range(1, 50):
        time_s = 0.2 * i
        velocity = xyz((1.0 + 0.01 * i, 0.1, 0.0))
        ping = {"header": header(on_clock(time_s)), "twist": {"linear": velocity}}
        rows.append(("/dvl", "geometry_msgs/msg/TwistStamped", on_clock(time_s + 0.1), ping))
    dive = read_dive(
        write_log(tmp_path / "set.mcap", sorted(rows, key=lambda row: row[2])), Config()
    )
    (note,) = [note for note in dive.notes if note.code == "clock_set"]
    assert "4.0 s in" in note.text
    first_ns = START_NS + round((1e6 + 3.98) * 1e9)
    assert dive.imu.time_ns[0] >= first_ns
    assert dive.dvl.time_ns[0] >= first_ns
    assert len(dive.imu.time_ns) == 599
    assert np.diff(dive.imu.time_ns).max() < 2e7
    assert not [
        note for note in dive.notes if "wrong_stamps" in note.code or "missing" in note.code
    ]


# Set back by less than a day

SECOND_NS = 10**9


def channels(*parts: tuple[int, int, int]) -> dict[int, np.ndarray]:
    """Make channels of 10, 2 and 1/60 Hz, of which the last is too slow to show a step of seconds."""
    times = steps(*parts)
    return {0: times, 1: times[::5] + 10**6, 2: times[7::600] + 2 * 10**6}


@pytest.mark.parametrize("back_s", [2, 30, 3600])
@pytest.mark.parametrize("set_s", [70, 190])
def test_the_longest_side_of_a_step_back_is_used_in_each_channel(back_s: int, set_s: int) -> None:
    times = channels((0, set_s, 10**6), (set_s, 300, 10**6 - back_s))
    side = one_side(times)
    assert side is not None
    assert side.back_ns * 1e-9 == pytest.approx(back_s, abs=0.11)
    assert side.set_s == pytest.approx(set_s, abs=0.61)
    is_first = set_s > 150
    assert side.rows[0] == ((0, 10 * set_s) if is_first else (10 * set_s, 3000))
    assert side.rows[1] == ((0, 2 * set_s) if is_first else (2 * set_s, 600))
    assert (2 in side.rows) == (back_s > 60)
    used = 0
    for channel_id, log_ns in times.items():
        held = side.holds_rows(channel_id, 0, log_ns)
        used += np.count_nonzero(held)
        recorded_s = (np.arange(log_ns.size) * {0: 0.1, 1: 0.5, 2: 60.0}[channel_id]) + 0.7 * (
            channel_id == 2
        )
        # None of the other side, and of the slow channel none at times that both sides have.
        assert np.all((recorded_s[held] < set_s) == is_first)
    assert side.unused == 3605 - used
    text = side.note.text
    assert "was set back" in text
    assert side.note.code == "clock_set"


def test_a_clock_that_is_set_back_twice_has_three_sides() -> None:
    side = one_side(channels((0, 60, 100), (60, 100, 70), (100, 300, 50)))
    assert side is not None
    assert side.rows == {0: (1000, 3000), 1: (200, 600)}
    assert len(side.others) == 2


def test_steps_that_are_nearly_alike_are_told_apart() -> None:
    """Both steps lead from about 150 s to about 130 s, and the second one is larger by a second."""
    side = one_side(channels((0, 150, 0), (150, 170, -19), (170, 300, -40)))
    assert side is not None
    assert side.rows[0] == (0, 1500)
    assert len(side.others) == 2


def shuffled(times: np.ndarray) -> np.ndarray:
    return np.random.default_rng(1).permutation(times)


def with_late(times: np.ndarray) -> np.ndarray:
    """Write one message two seconds late, and a batch of three seconds after the next five."""
    late = np.insert(np.delete(times, 100), 120, times[100])
    return np.concatenate([late[:300], late[330:380], late[300:330], late[380:]])


@pytest.mark.parametrize(
    "change",
    [
        shuffled,
        with_late,
        lambda times: np.roll(times, times.size // 3),
        lambda times: times[::-1],
        lambda times: np.sort(np.append(times, times[::2] - SECOND_NS)),
    ],
    ids=["shuffled", "late", "joined", "backwards", "sorted"],
)
def test_messages_in_another_order_are_no_sides(
    change: Callable[[np.ndarray], np.ndarray],
) -> None:
    assert one_side({0: change(steps((0, 300, 0))), 1: change(steps((0, 300, 0))[::5])}) is None


@pytest.mark.parametrize("back_s", [30, 3600])
def test_a_step_that_another_channel_does_not_show_is_not_of_the_recorder(back_s: int) -> None:
    set_back = steps((0, 70, 10**4), (70, 300, 10**4 - back_s))
    assert one_side({0: set_back, 1: set_back[::5]}) is not None
    assert one_side({0: set_back, 1: steps((0, 300, 10**4))[::5]}) is None


@pytest.mark.parametrize("row", [0, 1500, 2999])
@pytest.mark.parametrize("off_s", [-7200, 7200])
def test_a_single_message_with_a_wrong_time_is_no_side(row: int, off_s: int) -> None:
    times = steps((0, 300, 10**4))
    times[row] += off_s * SECOND_NS
    assert one_side({0: times, 1: steps((0, 300, 10**4))[::5]}) is None


def test_a_channel_that_pauses_at_the_step_hides_it_from_none() -> None:
    """The pause is as long as the step, so that the channel never goes back."""
    times = steps((0, 70, 100), (70, 300, 70))
    is_paused = (np.arange(times.size) >= 500) & (np.arange(times.size) < 900)
    side = one_side({0: times, 1: times[~is_paused][::5]})
    assert side is not None
    assert side.rows == {0: (700, 3000)}


def test_a_pause_of_an_hour_is_no_step_back() -> None:
    assert one_side(channels((0, 70, 0), (70, 300, 3600))) is None


def set_back_log(
    path: Path,
    back_s: float,
    *,
    copies: bool = False,
    begins_s: float = -1.0,
) -> Path:
    """Write a log whose clock is set back 8 s in; pings are logged 0.1 s late, one of them behind the step.

    Or one that was joined from the logs of two recorders, of which the second repeats messages of the first. Until it
    begins, its clock is days behind.
    """

    def on_clock(time_s: float) -> float:
        if time_s < begins_s:
            return time_s - 1e6
        return time_s - (back_s if time_s >= 8.0 and not copies else 0.0)

    rows: list[tuple[float, Message]] = []
    for i in range(2000):
        time_s = 0.01 * i
        stamped = {"header": header(on_clock(time_s - 0.002))}
        flying = {
            "linear_acceleration": xyz((0.001 * i, 0.2, -9.8)),
            "angular_velocity": xyz((0.01, 0.02, 0.03)),
        }
        message = ("/imu", "sensor_msgs/msg/Imu", on_clock(time_s), stamped | flying)
        rows.append((time_s, message))
    for i in range(1, 99):
        time_s = 0.2 * i - 0.05
        velocity = xyz((1.0 + 0.01 * i, 0.1, 0.0))
        ping = {"header": header(on_clock(time_s)), "twist": {"linear": velocity}}
        logged_s = on_clock(time_s + 0.1)
        rows.append((time_s + 0.1, ("/dvl", "geometry_msgs/msg/TwistStamped", logged_s, ping)))
    rows.sort(key=lambda row: row[0])
    if copies:
        first = [row for row in rows if row[0] < 8.0]
        rows = first + [row for row in rows if row[0] >= 8.0 - back_s]
    return write_log(path, [message for _, message in rows])


def test_a_log_with_a_clock_that_is_set_back_is_read_from_one_side(tmp_path: Path) -> None:
    dive = read_dive(set_back_log(tmp_path / "back.mcap", 5.0), Config())
    (note,) = [note for note in dive.notes if note.code == "clock_set"]
    assert "set back 5.0 s, 8.0 s in" in note.text
    np.testing.assert_allclose(
        dive.imu.specific_force_b[:, 0], 0.001 * np.arange(800, 2000), rtol=0, atol=1e-12
    )
    # The ping under way is stamped by the clock before, and is moved.
    assert dive.dvl.time_ns[0] == START_NS + round((7.95 - 5.0) * 1e9)
    np.testing.assert_allclose(
        dive.dvl.velocity_d[:, 0], 1.0 + 0.01 * np.arange(40, 99), rtol=0, atol=1e-12
    )
    codes = {note.code for note in dive.notes}
    assert not [code for code in codes if "same_times" in code or "wrong_stamps" in code]


def test_a_clock_that_is_set_by_days_and_then_back_is_read_from_one_side(tmp_path: Path) -> None:
    log = set_back_log(tmp_path / "both.mcap", 5.0, begins_s=2.0)
    dive = read_dive(log, Config())
    texts = [note.text for note in dive.notes if note.code == "clock_set"]
    assert len(texts) == 2
    assert "set 2.0 s in, from" in texts[0]
    assert "set back 5.0 s, 6.0 s in" in texts[1]
    np.testing.assert_allclose(
        dive.imu.specific_force_b[:, 0], 0.001 * np.arange(800, 2000), rtol=0, atol=1e-12
    )


def as_bag(log: Path) -> Path:
    return other_bags.bag(log.with_suffix(".bag"), log=log.read_bytes())


def as_sqlite(log: Path) -> Path:
    return other_bags.ros2_bag(log.with_suffix(""), log=log.read_bytes())


@pytest.mark.parametrize("convert", [as_bag, as_sqlite])
def test_bags_give_the_same_side(tmp_path: Path, convert: Callable[[Path], Path]) -> None:
    log = set_back_log(tmp_path / "back.mcap", 5.0)
    expected = read_dive(log, Config())
    dive = read_dive(convert(log), Config())
    assert "clock_set" in {note.code for note in dive.notes}
    np.testing.assert_array_equal(dive.imu.time_ns, expected.imu.time_ns)
    np.testing.assert_array_equal(dive.dvl.velocity_d, expected.dvl.velocity_d)


def test_logs_of_two_recorders_in_one_file_are_no_sides(tmp_path: Path) -> None:
    dive = read_dive(set_back_log(tmp_path / "copies.mcap", 5.0, copies=True), Config())
    assert "clock_set" not in {note.code for note in dive.notes}
    assert len(dive.imu.time_ns) == 2000
    assert len(dive.dvl.time_ns) == 98


def test_a_step_back_in_one_of_several_files_is_refused(tmp_path: Path) -> None:
    set_back_log(tmp_path / "a.mcap", 5.0)
    rows = [
        ("/gps", "sensor_msgs/msg/NavSatFix", 0.5 * i, {"header": header(0.5 * i)})
        for i in range(40)
    ]
    write_log(tmp_path / "b.mcap", rows)
    with pytest.raises(
        LogError, match=r"clock was set back 5\.0 s in this file, 8\.0 s in"
    ) as refused:
        read_dive([tmp_path / "a.mcap", tmp_path / "b.mcap"], Config())
    assert "insdvl-replay run" in refused.value.hint
    assert read_dive(tmp_path / "a.mcap", Config()).notes
