"""A recorder whose clock was set in a dive: the longest side with one clock is used, and its messages are in order."""

from pathlib import Path

import numpy as np
import pytest
from rosbag_messages import START_NS, Message, header, write_log, xyz

from insdvl_replay.core.config import Config
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.columns.tables import with_one_clock
from insdvl_replay.logs.formats.recorder_clock import one_clock

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
    np.testing.assert_array_equal(with_one_clock(old_ns, log_ns), stamp_ns)


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
