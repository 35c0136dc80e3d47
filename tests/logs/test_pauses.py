"""Pauses between samples, note by note: gaps, a clock that is set, and samples that come in bursts."""

import numpy as np
import pytest
from small_tables import nanoseconds, small_cleaner

from insdvl_replay.core.errors import Note
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.columns.clean import note_bursts, note_gaps

DAY_S = 86_400.0


def notes_of(note: object, steps_s: list[float], *more: object) -> list[Note]:
    cleaner = small_cleaner(np.concatenate([[0.0], np.cumsum(steps_s)]))
    note(cleaner, nanoseconds(steps_s), *more)  # type: ignore[operator]
    return cleaner.notes


@pytest.mark.parametrize("steps_s", [[], [1.0], [1.0] * 20, [0.8, 1.2] * 10])
def test_regular_samples_have_no_pauses(steps_s: list[float]) -> None:
    assert notes_of(note_gaps, steps_s, 10.0) == []
    assert notes_of(note_bursts, steps_s, "noise") == []


def test_a_gap_is_several_steps_and_no_warning_while_it_is_allowed() -> None:
    (note,) = notes_of(note_gaps, [*[0.01] * 50, 0.5, *[0.01] * 50], 1.0)
    assert (note.code, note.count, note.severity, note.hint) == ("imu_gaps", 1, Severity.INFO, "")
    assert "longest 0.500 s, total 0.500 s; 0 longer than 1 s" in note.text


def test_a_gap_longer_than_allowed_is_a_warning_with_the_key() -> None:
    (note,) = notes_of(note_gaps, [*[0.01] * 50, 2.0, 0.5, *[0.01] * 50], 1.0)
    assert (note.count, note.severity) == (2, Severity.WARNING)
    assert "imu.max_gap_s" in note.hint
    assert note.text.endswith("; the first 0.500 s after the first message")


def test_where_all_pauses_are_longer_than_allowed_each_is_a_gap() -> None:
    (note,) = notes_of(note_gaps, [2.0, 3.0], 1.0)
    assert (note.count, note.severity) == (2, Severity.WARNING)


@pytest.mark.parametrize(("step_s", "count"), [(DAY_S, 0), (DAY_S + 1.0, 1)])
def test_a_step_of_more_than_a_day_is_a_clock_that_was_set(step_s: float, count: int) -> None:
    notes = [
        note
        for note in notes_of(note_gaps, [1.0, step_s, 1.0], 10.0)
        if note.code == "imu_clock_set"
    ]
    assert [note.code for note in notes] == ["imu_clock_set"] * count
    assert all(
        "from 1970-01-01T00:00:01 to 1970-01-02T00:00:02 UTC" in note.text for note in notes
    )


def test_samples_that_come_in_threes_are_bursts() -> None:
    (note,) = notes_of(note_bursts, [0.001, 0.001, 0.298] * 20, "dvl.velocity_sd_mps")
    assert (note.code, note.count, note.severity) == ("imu_bursts", 40, Severity.WARNING)
    assert "else raise dvl.velocity_sd_mps until" in note.hint


def test_a_single_sample_soon_after_another_is_no_burst() -> None:
    assert notes_of(note_bursts, [*[0.1] * 30, 0.001, *[0.1] * 30], "noise") == []
