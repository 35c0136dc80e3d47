"""Rows made clean, one rule at a time: which rows stay, and what is noted of the others."""

import numpy as np
import pytest
from small_tables import small_cleaner

from insdvl_replay.core.errors import LogError
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.columns.clean import Cleaner, is_few, same_rows

NAN = np.nan


def column(*values: float) -> np.ndarray:
    return np.array(values)[:, None]


def noted(cleaner: Cleaner) -> list[tuple[str, int, Severity]]:
    return [(note.code, note.count, note.severity) for note in cleaner.notes]


@pytest.mark.parametrize(
    ("count", "size", "few"), [(1, 1, True), (1, 3, True), (2, 39, False), (2, 40, True)]
)
def test_a_few_are_one_or_a_twentieth(count: int, size: int, few: bool) -> None:
    assert is_few(count, size) == few


def test_missing_numbers_are_the_same_as_missing_ones() -> None:
    one, other = (
        np.array([[1.0, NAN], [1.0, NAN], [NAN, NAN]]),
        np.array([[1.0, NAN], [1.0, 2.0], [NAN, NAN]]),
    )
    assert same_rows(one, other).tolist() == [True, False, True]


def test_what_is_clean_is_given_back_uncopied() -> None:
    cleaner, values = small_cleaner([0.0, 1.0, 2.0]), column(1.0, 2.0, 3.0)
    cleaner.keep_finite(values)
    assert cleaner.kept(values) is values
    assert cleaner.notes == []


def test_late_rows_are_sorted_and_counted() -> None:
    cleaner = small_cleaner([0.0, 0.1, 0.3, 0.2, 0.4], [0.0, 0.1, 0.2, 0.3, 0.4])
    assert cleaner.rows.tolist() == [0, 1, 3, 2, 4]
    assert noted(cleaner) == [("imu_out_of_order", 1, Severity.INFO)]
    assert "(by up to 0.100 s)" in cleaner.notes[0].text


def test_rows_without_a_finite_number_are_dropped_from_every_column() -> None:
    cleaner = small_cleaner([0.0, 1.0, 2.0, 3.0])
    cleaner.keep_finite(column(1.0, NAN, 3.0, 4.0), column(1.0, 2.0, 3.0, np.inf))
    assert cleaner.kept(column(5.0, 6.0, 7.0, 8.0)).ravel().tolist() == [5.0, 7.0]
    assert noted(cleaner) == [("imu_not_finite", 2, Severity.INFO)]


@pytest.mark.parametrize(
    ("lost", "severity"),
    [([1, 3], Severity.INFO), ([1, 2], Severity.WARNING), ([*range(0, 40, 2)], Severity.WARNING)],
)
def test_numbers_that_are_expected_may_be_missing_here_and_there(
    lost: list[int], severity: Severity
) -> None:
    cleaner, values = small_cleaner(range(60)), np.ones((60, 1))
    values[lost] = NAN
    cleaner.keep_finite(values, is_expected=True)
    assert noted(cleaner) == [("imu_not_finite", len(lost), severity)]


@pytest.mark.parametrize(
    ("count", "value", "kept", "said"),
    [
        (1, [999.999], 9, "(999.999)"),
        (5, [30.0, 31.0, 999.0, -40.0, 50.0], 5, "(30 to 999)"),
        (9, [999.0, -999.0, 88.888], 1, "(88.888 and 999)"),
        (6, [30.0, 31.0, 999.0], 10, ""),
    ],
)
def test_impossible_rows_are_dropped_unless_most_are_and_differ_so_that_the_unit_is_blamed(
    count: int, value: list[float], kept: int, said: str
) -> None:
    readings = np.resize(value, count)
    by_row = small_cleaner(range(10))
    by_row.keep_possible(np.arange(10) >= count, readings, "impossible samples")
    by_reading = small_cleaner(range(10))
    values = column(*readings, *[1.0] * (10 - count))
    left = by_reading.without_impossible(values, np.abs(values) > 20.0, "impossible angles")
    assert (by_row.rows.size, np.isfinite(left).sum()) == (kept, kept)
    for cleaner in (by_row, by_reading):
        assert noted(cleaner) == ([("imu_impossible", count, Severity.WARNING)] if said else [])
        assert not said or said in cleaner.notes[0].text


def test_of_rows_with_one_time_the_first_stays() -> None:
    cleaner = small_cleaner([0.0, 1.0, 1.0, 2.0])
    cleaner.drop_repeated_times(column(1.0, 2.0, 2.0, 3.0))
    assert cleaner.rows.tolist() == [0, 1, 3]
    assert noted(cleaner) == [("imu_repeats", 1, Severity.INFO)]


def test_several_stamped_together_are_a_warning() -> None:
    cleaner = small_cleaner([0.0, 1.0, 1.0, 2.0, 2.0, 3.0])
    cleaner.drop_repeated_times(column(*range(6)))
    assert cleaner.times.tolist() == [0, 1_000_000_000, 2_000_000_000, 3_000_000_000]
    assert noted(cleaner) == [("imu_same_times", 2, Severity.WARNING)]


def test_a_topic_that_is_mostly_stamped_together_is_refused() -> None:
    cleaner = small_cleaner([0.0, 0.0, 0.0, 1.0, 1.0])
    with pytest.raises(
        LogError, match="3 of 5 messages have the time of the one before"
    ) as refused:
        cleaner.drop_repeated_times(column(*range(5)))
    assert 'imu.stamp = "log_time"' in refused.value.hint


def test_repeated_values_are_dropped_where_they_follow_each_other() -> None:
    cleaner = small_cleaner(range(5))
    cleaner.drop_repeated_values(column(1.0, 1.0, NAN, NAN, 1.0))
    assert cleaner.rows.tolist() == [0, 2, 4]
    assert noted(cleaner) == [("imu_same_values", 2, Severity.INFO)]


@pytest.mark.parametrize(
    ("values", "missing"), [((NAN, 1.0, NAN), 2), ((NAN, NAN, NAN), 0), ((1.0, 1.0, 1.0), 0)]
)
def test_what_some_rows_lack_is_counted_and_what_all_lack_is_not(
    values: tuple[float, ...], missing: int
) -> None:
    cleaner = small_cleaner(range(3))
    cleaner.note_missing("velocities", column(*values))
    assert sum(note.count for note in cleaner.notes) == missing
    assert cleaner.rows.size == 3


def test_a_role_of_which_nothing_stays_is_refused_with_the_reasons() -> None:
    cleaner = small_cleaner(range(2))
    cleaner.keep_finite(column(NAN, NAN))
    with pytest.raises(
        LogError,
        match="no message of 2 can be used: imu: 2 messages hold a number that is not finite",
    ):
        cleaner.require_rows()


def test_notes_count_from_the_first_message_by_its_time() -> None:
    cleaner = small_cleaner([100.0, 101.0, 102.5, 103.0])
    cleaner.keep_finite(column(1.0, 2.0, NAN, 4.0))
    assert cleaner.notes[0].text.endswith("; the first 2.500 s after the first message")
