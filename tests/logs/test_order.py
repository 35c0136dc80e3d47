"""Stamps that step back: messages are sorted where that is harmless, and not where the recorder's clock contradicts."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap_ros2.writer import Writer

from insdvl_replay.core.config import Config, Imu
from insdvl_replay.core.dive_columns import Dive, TimeNs
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.columns.tables import FEW_PLACES, find_order
from insdvl_replay.logs.formats.definitions import definition_text

START_NS = 1_700_000_000_000_000_000
STEP_NS = 10_000_000
SECOND_NS = 1_000_000_000


def steps(count: int) -> TimeNs:
    return STEP_NS * np.arange(count, dtype=np.int64)


# Which rows are right


def test_rows_in_order_stay_as_they_are() -> None:
    order = find_order(steps(10), steps(10))
    np.testing.assert_array_equal(order.rows, np.arange(10))
    assert (order.late.size, order.wrong.size) == (0, 0)


def test_messages_that_overtake_each_other_are_put_in_their_places() -> None:
    stamps = steps(100)
    stamps[[40, 41]] = stamps[[41, 40]]
    order = find_order(stamps, steps(100))
    np.testing.assert_array_equal(stamps[order.rows], steps(100))
    assert (order.late.tolist(), order.wrong.size, order.late_s) == ([41], 0, 0.01)


def test_parts_that_are_joined_in_another_order_are_sorted_whole() -> None:
    late = np.roll(steps(1000), 300)
    order = find_order(late - 5, late)
    np.testing.assert_array_equal(late[order.rows], steps(1000))
    assert (order.late.size, order.wrong.size) == (700, 0)


def test_without_a_recorders_clock_nothing_contradicts_the_stamps() -> None:
    order = find_order(steps(100)[::-1], np.zeros(100, np.int64))
    assert (order.rows.size, order.wrong.size) == (100, 0)


@pytest.mark.parametrize("off_ns", [-100 * SECOND_NS, 100 * SECOND_NS], ids=["back", "ahead"])
@pytest.mark.parametrize("count", [1, 3])
def test_single_wrong_stamps_are_left_out_and_no_others(off_ns: int, count: int) -> None:
    stamps = steps(1000)
    stamps[500 : 500 + count] += off_ns
    order = find_order(stamps, steps(1000))
    assert order.wrong.tolist() == list(range(500, 500 + count))
    np.testing.assert_array_equal(stamps[order.rows], np.delete(steps(1000), order.wrong))
    assert order.jump_s == 0.0


@pytest.mark.parametrize("places", [FEW_PLACES, FEW_PLACES + 1])
def test_limit_of_harmless_disorder(places: int) -> None:
    stamps = np.insert(np.delete(steps(100), 50), 50 + places, steps(100)[50])
    assert find_order(stamps, steps(100)).wrong.size == (places > FEW_PLACES)


def test_slow_sensors_are_not_sorted_by_whole_seconds() -> None:
    stamps = SECOND_NS * np.arange(20)
    stamps[[10, 12]] = stamps[[12, 10]]
    assert find_order(stamps, SECOND_NS * np.arange(20)).wrong.size == 2


@pytest.mark.parametrize("back_s", [0.3, 3.0])
def test_clock_that_is_set_back_is_measured(back_s: float) -> None:
    stamps = steps(1000)
    stamps[600:] -= round(back_s * 1e9)
    order = find_order(stamps, steps(1000))
    assert order.jump_s == pytest.approx(back_s, abs=1e-9)
    assert order.wrong.size == pytest.approx(100 * back_s, abs=1)
    kept = np.sort(order.rows)
    np.testing.assert_array_equal(kept, order.rows, "what is kept was recorded in its order")


@pytest.mark.parametrize("rows", [slice(0, 20), slice(980, 1000)], ids=["first", "last"])
def test_stamps_of_no_clock_at_an_end_are_left_out(rows: slice) -> None:
    stamps = START_NS + steps(1000)
    stamps[rows] += 7200 * SECOND_NS if rows.start else -START_NS
    order = find_order(stamps, START_NS + steps(1000))
    assert order.wrong.tolist() == list(range(1000))[rows]
    assert order.jump_s == 0.0


def test_pauses_that_the_recorder_saw_too_are_no_leaps() -> None:
    times = np.concatenate([steps(100), 7200 * SECOND_NS + steps(100)])
    assert find_order(times, times + SECOND_NS).wrong.size == 0


@pytest.mark.parametrize("seed", range(2))
def test_as_few_stamps_as_possible_are_wrong(seed: int) -> None:
    """Against the longest common subsequence with the sorted stamps, by the textbook's table."""
    stamps = np.random.default_rng(seed).permutation(60).astype(np.int64) * 100 * SECOND_NS
    ordered = np.sort(stamps)
    table = np.zeros((61, 61), np.int64)
    for i, stamp in enumerate(stamps):
        for j, other in enumerate(ordered):
            table[i + 1, j + 1] = (
                table[i, j] + 1 if stamp == other else max(table[i, j + 1], table[i + 1, j])
            )
    assert find_order(stamps, steps(60)).rows.size == table[-1, -1]


# In logs


def write(path: Path, stamps_ns: TimeNs, log_times_ns: TimeNs, dvl: int = 10) -> Path:
    def stamp(time_ns: int) -> dict[str, Any]:
        return {
            "stamp": {"sec": time_ns // SECOND_NS, "nanosec": time_ns % SECOND_NS},
            "frame_id": "",
        }

    imu_type, dvl_type = "sensor_msgs/msg/Imu", "geometry_msgs/msg/TwistStamped"
    with path.open("wb") as stream:
        writer = Writer(stream)
        imu, twist = (
            writer.register_msgdef(name, definition_text(name)) for name in (imu_type, dvl_type)
        )
        for i, (stamp_ns, log_ns) in enumerate(
            zip(stamps_ns.tolist(), log_times_ns.tolist(), strict=True)
        ):
            message: dict[str, Any] = {
                "header": stamp(START_NS + stamp_ns),
                "linear_acceleration": {"x": 0.001 * i, "y": 0.0, "z": -9.8},
                "angular_velocity": {"x": 0.0, "y": 1e-5 * i, "z": 0.01},
            }
            writer.write_message(
                "/imu", imu, message, log_time=START_NS + log_ns, publish_time=START_NS + log_ns
            )
        for i in range(dvl):
            log_ns = START_NS + 10 * STEP_NS * i
            message = {
                "header": stamp(log_ns),
                "twist": {"linear": {"x": 1.0 + 0.01 * i, "y": 0.0, "z": 0.0}},
            }
            writer.write_message("/dvl", twist, message, log_time=log_ns, publish_time=log_ns)
        writer.finish()
    return path


def read(path: Path, stamps_ns: TimeNs, config: Config | None = None) -> Dive:
    return read_dive(
        write(path / "dive.mcap", stamps_ns, steps(len(stamps_ns))), config or Config()
    )


def note_of(dive: Dive, code: str) -> Note:
    (note,) = [note for note in dive.notes if note.code == code]
    return note


def test_single_wrong_stamps_are_dropped_with_a_warning_and_the_key(tmp_path: Path) -> None:
    stamps = steps(200)
    stamps[120:123] -= 2 * SECOND_NS
    dive = read(tmp_path, stamps)
    note = note_of(dive, "imu_wrong_stamps")
    assert (note.count, note.severity, note.hint) == (3, "warning", 'imu.stamp = "log_time"')
    assert "the first 1.200 s after the first message; dropped" in note.text
    np.testing.assert_allclose(
        dive.imu.specific_force_b[:, 0],
        0.001 * np.delete(np.arange(200), [120, 121, 122]),
        rtol=0,
        atol=1e-12,
    )
    by_log = read(tmp_path, stamps, Config(imu=Imu(stamp="log_time")))
    assert "imu_wrong_stamps" not in {note.code for note in by_log.notes}
    assert len(by_log.imu.time_ns) == 200


def test_clock_that_is_set_back_is_refused(tmp_path: Path) -> None:
    stamps = steps(1000)
    stamps[600:] -= 2 * SECOND_NS
    with pytest.raises(
        LogError, match=r"/imu: .* log time is steady; .*; their clock was set back by 2\.000 s"
    ) as refused:
        read(tmp_path, stamps)
    assert refused.value.hint == 'imu.stamp = "log_time"'


def test_stamps_from_before_the_clock_was_set_are_dropped(tmp_path: Path) -> None:
    stamps = steps(1000)
    stamps[:20] -= START_NS
    note = note_of(read(tmp_path, stamps), "imu_wrong_stamps")
    assert note.count == 20
    assert "the first 0.000 s after the first message" in note.text


def test_stamps_that_are_wrong_all_the_time_are_refused(tmp_path: Path) -> None:
    stamps = steps(200)
    stamps[5::10] -= 2 * SECOND_NS
    with pytest.raises(
        LogError, match=r"/imu: 20 of 200 messages have stamps 'header' that jump while"
    ):
        read(tmp_path, stamps)


def test_harmless_disorder_is_no_warning(tmp_path: Path) -> None:
    stamps = steps(200)
    stamps[[120, 121]] = stamps[[121, 120]]
    dive = read(tmp_path, stamps)
    note = note_of(dive, "imu_out_of_order")
    assert (note.count, note.severity) == (1, "info")
    assert "the first 1.200 s after the first message" in note.text
    assert len(dive.imu.time_ns) == 200


def test_samples_that_share_a_stamp_are_reported_from_repeats(tmp_path: Path) -> None:
    dive = read(tmp_path, steps(200) // (2 * STEP_NS) * (2 * STEP_NS))
    note = note_of(dive, "imu_same_times")
    assert (note.count, note.severity) == (100, "warning")
    assert 'imu.stamp = "field.path"' in note.hint
    assert "imu_repeats" not in {note.code for note in dive.notes}


def test_stamps_that_most_samples_share_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        LogError, match=r"/imu: 150 of 200 messages have the time of the one before"
    ) as refused:
        read(tmp_path, steps(200) // (4 * STEP_NS) * (4 * STEP_NS))
    assert 'imu.stamp = "log_time"' in refused.value.hint


def test_stamps_in_bursts_are_reported(tmp_path: Path) -> None:
    jitter = np.random.default_rng(3).normal(0.0, 0.1 * STEP_NS, 200)
    regular = read(tmp_path, steps(200) + np.rint(jitter).astype(np.int64))
    assert "imu_bursts" not in {note.code for note in regular.notes}
    delivered = steps(200) // (3 * STEP_NS) * (3 * STEP_NS) + steps(200) % (3 * STEP_NS) // 20
    note = note_of(read(tmp_path, delivered), "imu_bursts")
    assert note.severity == "warning"
    assert "noise.accel_white_mps_rts" in note.hint
